"""Comparison of two runs, on the command line and in numbers."""

import shutil
from collections.abc import Callable
from pathlib import Path

import pytest

from drivers.base.errors import InputError
from validation.checks import FAIL, PASS
from validation.compare.pair import Pair, compare_pair, compare_runs, different_keys, open_pair
from validation.tests.helpers.commands import beads
from validation.tests.helpers.runs import edit_record, finished, need
from validation.tests.helpers.scenes import SceneWriter, case_of

FolderOf = Callable[..., Path]


@pytest.fixture
def run_of(shared_runs: Path) -> FolderOf:
    """Returns the folder of a run, made once a session."""

    def folder(engine: str, scene: str | Path, *settings: str) -> Path:
        return finished(case_of(scene, *settings), engine, shared_runs).folder

    return folder


def pair_of(first: Path, second: Path) -> Pair:
    return compare_pair(*open_pair(first, second))


def keys_of(pair: Pair) -> list[str]:
    return different_keys(pair.first.run.record.scene, pair.second.run.record.scene)


def red(pair: Pair) -> set[str]:
    return {check.quantity for check in pair.checks if check.verdict == FAIL}


def test_same_scheme_same_step_is_judged_by_rounding(run_of: FolderOf) -> None:
    need("liggghts")
    pair = pair_of(run_of("verlet", "fig4"), run_of("liggghts", "fig4"))
    limits = {check.quantity: check.limit for check in pair.checks}
    assert limits["force"] == 1e-9
    assert set(limits) == {"force", "energy", "momentum", "bead_9_peak", "bead_5_peak", "wall_peak", "speed_9_to_5"}
    assert {check.verdict for check in pair.checks} == {PASS}
    assert keys_of(pair) == []


@pytest.mark.parametrize(("engine", "step"), [("verlet", "1 us"), ("reference", "0.1 us")])
def test_the_difference_of_the_schemes_explains_another_step_and_no_other_mass(
    run_of: FolderOf, engine: str, step: str
) -> None:
    pair = pair_of(run_of("verlet", "fig4"), run_of(engine, "fig4", f"run.time_step={step}"))
    assert not pair.missed
    force = pair.checks[0]
    assert force.value < force.limit == 2e-9
    assert "beyond the difference of the schemes" in force.reason
    assert pair.parted[1e-6]
    heavier = run_of(engine, "fig4", f"run.time_step={step}", "chain.mass=0.12258 g")
    assert {"force", "momentum", "wall_peak", "speed_9_to_5"} <= red(pair_of(run_of("verlet", "fig4"), heavier))


@pytest.mark.parametrize(("setting", "samples"), [("sample_interval=0.5 us", 301), ("duration=0.2 ms", 201)])
def test_common_sample_times(setting: str, samples: int, run_of: FolderOf, scene_file: SceneWriter) -> None:
    folders = [run_of("verlet", scene_file()), run_of("verlet", scene_file(), f"run.{setting}")]
    for pair in (pair_of(*folders), pair_of(*reversed(folders))):
        assert len(pair.first.trace.time_s) == len(pair.second.trace.time_s) == samples
        assert pair.first.case.sample_times_s == pytest.approx(pair.second.trace.time_s)
        assert pair.checks[0].value == 0  # the same steps, looked at more often or for longer
        assert not pair.missed


def test_a_chaotic_pair_is_judged_up_to_its_horizon(run_of: FolderOf) -> None:
    need("liggghts")
    long = ("run.duration=20 ms", "run.sample_interval=5 us")
    pair = pair_of(run_of("verlet", "fig4", *long), run_of("liggghts", "fig4", *long))
    assert "where rounding alone explains" in pair.until
    assert not pair.missed
    assert 12e3 < float(pair.parted[1e-2].split()[-2]) < 20e3  # µs: beyond the horizon, so not judged


@pytest.mark.parametrize(("engine", "limit"), [("yade", 3e-2), ("verlet", 1e-4)])
def test_codes_in_a_tube_may_differ_by_their_laws_of_friction(engine: str, limit: float, run_of: FolderOf) -> None:
    pair = pair_of(*(run_of(name, "fig5-tube", "run.duration=40 us") for name in (engine, "liggghts")))
    assert not pair.missed
    assert pair.checks[0].limit == limit


def test_on_the_command_line(run_of: FolderOf) -> None:
    verlet, other = str(run_of("verlet", "fig4")), str(run_of("verlet", "fig4", "wall.material=alumina"))
    good = beads("compare", verlet, run_of("verlet", "fig4", "run.time_step=1 us"))
    assert (good.returncode, good.stderr) == (0, "")
    for words in (
        "pass: all ",
        "time step 1e-06 s, 800 steps, 801 samples, commit ",
        "the scenes differ in run.time_step: 0.1 us against 1 us",
        "allowed: beyond the difference of the schemes at the two time steps",
        "forces differ by more than 0.001 of the largest change: first in contact 5 at 465 µs",
        "error budget",
    ):
        assert words in good.stdout
    bad = beads("compare", verlet, other)
    assert (bad.returncode, bad.stderr) == (1, "")
    assert bad.stdout.startswith("FAIL: larger differences than allowed in force, energy, momentum, wall_peak")
    assert "the scenes differ in wall.material: brass against alumina" in bad.stdout
    for given, found in (([verlet], "exactly two runs"), ([verlet, other, "--set", "seed=1"], "--set")):
        wrong = beads("compare", *given)
        assert (wrong.returncode, len(wrong.stderr.splitlines())) == (2, 1)
        assert found in wrong.stderr


def test_runs_that_cannot_be_compared(run_of: FolderOf, scene_file: SceneWriter, tmp_path: Path) -> None:
    good = run_of("verlet", scene_file())
    for folder in (tmp_path / "empty", tmp_path / "batch"):
        folder.mkdir()
    (tmp_path / "batch" / "part.jsonl").write_text("{}\n")
    failed, foreign = (Path(shutil.copytree(good, tmp_path / name)) for name in ("failed", "foreign"))
    edit_record(failed, status="failed", reason="unstable", files={})
    edit_record(foreign, engine="abacus")
    rarer = ("run.sample_interval=0.5 us", "run.duration=0.1 ms")
    for folder, found in (
        (good.parent / "." / good.name, "both are the same run"),
        (tmp_path / "empty", "no record of a run"),
        (good.parent, "a folder of runs"),
        (tmp_path / "batch", "the store of a batch"),
        (failed, "failed: unstable"),
        (foreign, 'engine: found "abacus"'),
        (run_of("verlet", scene_file(), "run.sample_interval=0.7 us"), r"run\.sample_interval"),
        (run_of("verlet", scene_file(), *rarer), r"run\.sample_interval"),
        (run_of("verlet", scene_file(count=3)), "6 contacts against 4"),
        (run_of("verlet", scene_file(duration="2 us")), "4 or more"),
    ):
        with pytest.raises(InputError, match=found):
            compare_runs(good, folder)
