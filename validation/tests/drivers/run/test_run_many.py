"""Tests of many runs: in order, in parallel, interrupted, and on servers as by hand."""

import os
import signal
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest

from drivers.base import processes
from drivers.base.processes import all_stopped, run_command
from drivers.chain.trace import digest_of
from drivers.engines import REFERENCE, VERLET, load_engine
from drivers.run.compute import compute
from drivers.run.run import run_case, run_many
from drivers.run.run_folder import open_run
from drivers.run.session import end_all
from validation.tests.helpers.commands import BEADS
from validation.tests.helpers.runs import need
from validation.tests.helpers.scenes import SceneWriter, StandIn, case_of

CODE = "lammps"


def test_order_is_kept_and_equal_decks_run_once(scene_file: SceneWriter, tmp_path: Path) -> None:
    path = scene_file()
    cases = [case_of(path, f"striker.speed={speed} m/s") for speed in (3, 1, 2, 1)]
    ended = run_many([(case, VERLET) for case in cases], tmp_path)
    assert [run.record.scene["striker"]["speed"] for run in ended] == [3, 1, 2, 1]
    assert ended[1].folder == ended[3].folder
    assert len(list((tmp_path / VERLET).glob("[!.]*"))) == 3


def test_interrupt_ends_all_and_leaves_no_folder(scene_file: SceneWriter, tmp_path: Path) -> None:
    need(CODE)
    runs, places = tmp_path / "runs", tmp_path / "temporary"
    places.mkdir()
    step = ("--unsafe", "--set", "run.time_step=0.1 ns")
    words = map(str, (*BEADS, "run", scene_file(duration="100 ms"), "--engine", CODE, *step, "--runs", runs))
    process = subprocess.Popen([*words], stderr=subprocess.PIPE, text=True, env=os.environ | {"TMPDIR": str(places)})
    until = time.monotonic() + 60
    while not [*places.glob("bead-chains-*/.*/*/case/chain.*"), *runs.glob("*/.*/run/chain.*")]:
        assert process.poll() is None
        assert time.monotonic() < until
        time.sleep(0.05)
    time.sleep(0.3)
    process.send_signal(signal.SIGTERM)
    _, said = process.communicate(timeout=60)
    assert process.returncode == 130
    assert said.strip().splitlines()[-1] == "interrupted"
    assert not [path for path in (runs / CODE).iterdir() if path.is_dir()]
    assert not [*places.glob("[!o]*")]  # Open MPI leaves a folder
    running = subprocess.run(["pgrep", "-f", str(tmp_path)], capture_output=True, text=True, check=False).stdout
    assert not [pid for pid in running.split() if int(pid) != os.getpid()]


def test_processes_are_killed_only_within_all_stopped(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(processes, "_running", {})  # servers of other tests live on
    with ThreadPoolExecutor() as pool:
        slow = pool.submit(run_command, ("sleep", "60"), tmp_path, 100.0)
        time.sleep(0.5)
        with all_stopped():
            with pytest.raises(KeyboardInterrupt):
                slow.result(timeout=10)
            with pytest.raises(KeyboardInterrupt):
                run_command(("sleep", "60"), tmp_path, 100.0)
    assert run_command(("true",), tmp_path, 100.0).code == 0


@pytest.mark.long
def test_simultaneous_runs_of_one_case_share_a_folder(scene_file: SceneWriter, tmp_path: Path) -> None:
    """In processes and in threads; all can read it meanwhile."""
    path, runs = scene_file(), tmp_path / "runs"
    words = [*map(str, (*BEADS, "run", path, "--engine", VERLET, "--runs", runs))]
    process = subprocess.Popen(words, stdout=subprocess.PIPE, text=True)
    with ThreadPoolExecutor(3) as pool:
        ended = [*pool.map(lambda _: run_case(case_of(path), VERLET, runs), range(3))]
    assert {len(open_run(run.folder).trace.time_s) for run in ended} == {301}
    folders = {run.folder for run in ended} | {Path(process.communicate(timeout=100)[0].strip())}
    assert (process.returncode, folders) == (0, {*(runs / VERLET).iterdir()})
    assert len(folders) == 1


def test_reading_a_run_starts_no_threads(scene_file: SceneWriter, tmp_path: Path) -> None:
    """Threads of Arrow that still work when the interpreter ends abort the process."""
    ended = run_case(case_of(scene_file(duration="0.02 ms")), VERLET, tmp_path)
    script = (
        "import sys, psutil, pyarrow.parquet; from pathlib import Path; from drivers.run.run_folder import open_run;"
        "before = psutil.Process().num_threads(); open_run(Path(sys.argv[1])).trace;"
        "sys.exit(psutil.Process().num_threads() - before)"
    )
    assert subprocess.run([sys.executable, "-c", script, str(ended.folder)], check=False).returncode == 0


def test_served_run_equals_one_in_its_own_process(scene_file: SceneWriter, tmp_path: Path) -> None:
    need(CODE)
    cases = [case_of(scene_file(), f"striker.speed={speed} m/s") for speed in (1, 2)]
    end_all()  # an idle session keeps the memory of the cases of other tests
    for case, served in zip(cases, run_many([(case, CODE) for case in cases], tmp_path / "served"), strict=True):
        alone = run_case(case, CODE, tmp_path / "alone")
        assert served.folder.name == alone.folder.name
        assert served.forces_sha256 == alone.forces_sha256
        assert {file.name for file in served.folder.iterdir()} == {file.name for file in alone.folder.iterdir()}
        assert served.record.command == alone.record.command
        assert served.record.loop_s is not None
        assert (served.record.cpu_s or 0.0) > 0
        assert served.record.memory_bytes == pytest.approx(alone.record.memory_bytes, rel=0.5)


@pytest.mark.parametrize(
    ("engine", "scene", "setting"),
    [(REFERENCE, "two-spheres", "contact.restitution=0.8"), (VERLET, "fig4-tube", "run.duration=0.1 ms")],
)
def test_in_repo_engine_gives_the_bits_of_its_deck(engine: str, scene: str, setting: str) -> None:
    case = case_of(scene, setting)
    here, by_hand = compute(case, engine).done, compute(case, engine, by_hand=True).done
    assert digest_of(here) == digest_of(by_hand)
    assert here.height_m is not None
    assert by_hand.height_m is not None
    assert np.array_equal(here.height_m, by_hand.height_m)


def test_served_run_that_fails_is_repeated_in_its_own_process(scene_file: SceneWriter, tmp_path: Path) -> None:
    """It leaves the other runs alone."""
    unstable, stable = case_of(scene_file(), "run.time_step=50 us", "run.sample_interval=50 us"), case_of(scene_file())
    served, done = run_many([(unstable, VERLET), (stable, VERLET)], tmp_path / "served")
    alone = run_case(unstable, VERLET, tmp_path / "alone")
    assert done.done
    assert served.record.status == alone.record.status == "failed"
    assert served.record.reason == alone.record.reason
    assert (served.folder / "stderr.txt").read_text() == (alone.folder / "stderr.txt").read_text()


def test_script_that_looks_at_decks_serves_none(stand_in: StandIn, scene_file: SceneWriter, tmp_path: Path) -> None:
    need(CODE)
    engine, case = load_engine(CODE), case_of(scene_file())
    command, deck = engine.find(), engine.render(case)
    assert command is not None
    stand_in(engine.program, f'[ -e {next(iter(deck.files))} ] && exit 3\nexec {command[-1]} "$@"\n')
    (ended,) = run_many([(case, CODE)], tmp_path / "runs")
    assert ended.record.reason.startswith("exit code 3")


def test_a_worker_ends_in_order_if_its_signal_comes_in_a_callback() -> None:
    """Python drops exceptions of callbacks of weak references, so the worker signals itself again."""
    script = (
        "import os, signal, sys, time, weakref; from drivers.run import execute\n"
        "sys.unraisablehook = execute._end_again\n"
        "signal.signal(signal.SIGTERM, execute._end)\n"
        "class Thing: pass\n"
        "thing = Thing()\n"
        "reference = weakref.ref(thing, lambda _: (os.kill(os.getpid(), signal.SIGTERM), time.sleep(0.01)))\n"
        "del thing\n"
        "time.sleep(20)\n"
        "sys.exit(1)"
    )
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, check=False, timeout=60)
    assert (done.returncode, done.stderr) == (0, b"")
