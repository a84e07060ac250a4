"""Tests of the ways to compute a case: served and in this process as by hand, also failures."""

import os
import signal
from pathlib import Path

import numpy as np
import pytest

from drivers.chain.trace import digest_of
from drivers.engines import REFERENCE, VERLET, codes, installed_codes, load_engine
from drivers.run import session
from drivers.run.build import build_of
from drivers.run.compute import compute
from drivers.run.run import run_case, run_many
from drivers.run.session import end_all, lent
from validation.tests.helpers.runs import need
from validation.tests.helpers.scenes import SceneWriter, StandIn, case_of

CODE = "lammps"


@pytest.mark.parametrize(
    "engine", [pytest.param(name, marks=() if name == VERLET else pytest.mark.long) for name in (*codes(), VERLET)]
)
def test_a_served_run_equals_one_in_its_own_process(engine: str, scene_file: SceneWriter, tmp_path: Path) -> None:
    need(engine)
    cases = [case_of(scene_file(), f"striker.speed={speed} m/s") for speed in (1, 2, 3)]
    end_all()  # an idle session keeps the memory of the cases of other tests
    served = run_many([(case, engine) for case in cases], tmp_path / "served")
    for case, one in zip(cases, served, strict=True):
        alone = run_case(case, engine, tmp_path / "alone")
        assert one.folder.name == alone.folder.name
        assert one.forces_sha256 == alone.forces_sha256
        assert {file.name for file in one.folder.iterdir()} == {file.name for file in alone.folder.iterdir()}
        assert one.record.command == alone.record.command
        assert one.record.loop_s is not None
        assert (one.record.cpu_s or 0.0) > 0
        assert one.record.memory_bytes == pytest.approx(alone.record.memory_bytes, rel=0.5)


def test_an_in_repo_engine_gives_the_same_bits_in_this_process_and_by_hand(scene_file: SceneWriter) -> None:
    path = scene_file()
    for settings in (
        (),
        ("contact.restitution=0.8",),
        ("contact.dissipation=power", "contact.gamma=0.1", "contact.alpha=1.75"),
    ):
        case = case_of(path, *settings)
        for name in (VERLET, REFERENCE):
            here, by_hand = compute(case, name).done, compute(case, name, by_hand=True).done
            assert digest_of(here) == digest_of(by_hand)
            assert here.height_m is not None
            assert np.array_equal(here.height_m, by_hand.height_m)  # type: ignore[arg-type]
    tube = case_of("fig4-tube", "run.duration=0.1 ms")
    assert digest_of(compute(tube, VERLET).done) == digest_of(compute(tube, VERLET, by_hand=True).done)


def test_a_served_run_that_fails_is_repeated_in_its_own_process(scene_file: SceneWriter, tmp_path: Path) -> None:
    case = case_of(scene_file(), "run.time_step=50 us", "run.sample_interval=50 us")
    (served,) = run_many([(case, VERLET)], tmp_path / "served")
    alone = run_case(case, VERLET, tmp_path / "alone")
    assert served.record.status == alone.record.status == "failed"
    assert served.record.reason == alone.record.reason
    assert (served.folder / "stderr.txt").read_text() == (alone.folder / "stderr.txt").read_text()


@pytest.mark.long
def test_a_script_that_looks_at_decks_serves_none(stand_in: StandIn, scene_file: SceneWriter, tmp_path: Path) -> None:
    for name in installed_codes():
        engine, case = load_engine(name), case_of(scene_file())
        command, deck = engine.find(), engine.render(case)
        assert command is not None
        stand_in(engine.program, f'[ -e {next(iter(deck.files))} ] && exit 3\nexec {command[-1]} "$@"\n')
        (ended,) = run_many([(case, name)], tmp_path / "runs")
        assert ended.record.reason.startswith("exit code 3")


def test_a_process_that_was_killed_is_followed_by_another(scene_file: SceneWriter, tmp_path: Path) -> None:
    need(CODE)
    end_all()
    engine = load_engine(CODE)
    build = build_of(engine)
    first, second = (case_of(scene_file(), f"striker.speed={speed} m/s") for speed in (1, 2))
    assert run_case(first, CODE, tmp_path, by_hand=False).done
    with lent(engine, build) as lent_one:
        assert lent_one._process is not None
        former = lent_one._process.pid
    os.kill(former, signal.SIGKILL)
    assert run_case(second, CODE, tmp_path, by_hand=False).done
    with lent(engine, build) as same:
        assert same is lent_one
        assert same._process is None or same._process.pid != former
    folder = same.folder
    end_all()
    assert not folder.exists()
    assert not any(session._idle.values())
