"""Tests of parallel runs."""

import os
import signal
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from drivers.base.errors import RunError
from drivers.base.processes import all_stopped, run_command
from drivers.run.run import run_case, run_many
from drivers.run.run_folder import open_run
from validation.tests.helpers.runs import need
from validation.tests.helpers.scenes import SceneWriter, case_of

SLOW = """
import sys
from drivers.chain.case import build_case
from drivers.scene.read_scene import read_scene
from drivers.run.run import run_many
from validation.commands.beads import run_main
from pathlib import Path
def main():
    settings = [(f"striker.speed={v} m/s", "run.time_step=0.1 ns") for v in (1, 2, 3, 4)]
    cases = [build_case(read_scene(sys.argv[1], each)) for each in settings]
    run_many([(case, sys.argv[3]) for case in cases], Path(sys.argv[2]))
    return 0
run_main(main)
"""


def test_order_is_kept_and_equal_decks_run_once(scene_file: SceneWriter, tmp_path: Path) -> None:
    path = scene_file()
    cases = [case_of(path, f"striker.speed={speed} m/s") for speed in (3, 1, 2, 1)]
    ended = run_many([(case, "verlet") for case in cases], tmp_path)
    speeds = [each.record.scene["striker"]["speed"] for each in ended]
    assert speeds == [3, 1, 2, 1]
    assert ended[1].folder == ended[3].folder
    assert len(list((tmp_path / "verlet").glob("[!.]*"))) == 3


def test_a_failed_run_leaves_the_others_alone(scene_file: SceneWriter, tmp_path: Path) -> None:
    path = scene_file()
    good, unstable = case_of(path), case_of(path, "run.time_step=50 us", "run.sample_interval=50 us")
    ended = run_many([(unstable, "verlet"), (good, "verlet")], tmp_path)
    assert [each.done for each in ended] == [False, True]


@pytest.mark.parametrize("engine", ["verlet", "lammps"])
def test_an_interrupt_ends_all_and_leaves_no_folder(engine: str, scene_file: SceneWriter, tmp_path: Path) -> None:
    need(engine)
    for request in (signal.SIGINT, signal.SIGTERM):
        runs, places = tmp_path / request.name, tmp_path / f"{request.name}-temporary"
        places.mkdir()
        words = (sys.executable, "-c", SLOW, str(scene_file(duration="100 ms")), str(runs), engine)
        variables = os.environ | {"TMPDIR": str(places)}
        process = subprocess.Popen(words, stderr=subprocess.PIPE, text=True, preexec_fn=hear_interrupts, env=variables)
        until = time.monotonic() + 60
        while time.monotonic() < until and not [
            *places.glob("bead-chains-*/.*/*/case/chain.*"),
            *runs.glob("*/.*/run/chain.*"),
        ]:
            time.sleep(0.05)
        time.sleep(0.3)
        process.send_signal(request)
        _, said = process.communicate(timeout=60)
        assert process.returncode == 130
        assert said.strip().splitlines()[-1] == "interrupted"
        assert not [path for path in (runs / engine).iterdir() if path.is_dir()]
        assert not [*places.glob("[!o]*")]  # Open MPI leaves a folder
        running = subprocess.run(["pgrep", "-f", str(tmp_path)], capture_output=True, text=True, check=False).stdout
        assert not [pid for pid in running.split() if int(pid) != os.getpid()]


def hear_interrupts() -> None:
    """Restore Ctrl-C, which a shell disables for tests in the background."""
    signal.signal(signal.SIGINT, signal.default_int_handler)


def test_an_engine_that_is_missing_is_an_error_and_later_runs_are_unharmed(
    scene_file: SceneWriter, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    case = case_of(scene_file())
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(RunError, match="not installed"):
        run_many([(case, "yade")], tmp_path)
    assert run_many([(case, "verlet")], tmp_path)[0].done


def test_processes_are_killed_only_within_all_stopped(tmp_path: Path) -> None:
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
def test_the_same_case_in_several_threads_and_processes(scene_file: SceneWriter, tmp_path: Path) -> None:
    """The later ones find the finished run, and all can read it meanwhile."""
    path = scene_file(duration="0.02 ms")
    script = (
        "import sys; from pathlib import Path; from validation.tests.drivers.run.test_run_many import run_and_read;"
        "run_and_read(Path(sys.argv[1]), Path(sys.argv[2]))"
    )
    others = [subprocess.Popen([sys.executable, "-c", script, str(path), str(tmp_path)]) for _ in range(2)]
    with ThreadPoolExecutor(3) as pool:
        for future in [pool.submit(run_and_read, path, tmp_path) for _ in range(3)]:
            future.result()
    assert [other.wait(timeout=100) for other in others] == [0, 0]
    assert len(list((tmp_path / "verlet").iterdir())) == 3


def run_and_read(path: Path, runs: Path) -> None:
    """Run three cases and read each trace immediately."""
    for speed in (1, 2, 3):
        ended = run_case(case_of(path, f"striker.speed={speed} m/s"), "verlet", runs)
        assert ended.done, ended.record.reason
        assert len(open_run(ended.folder).trace.time_s) == 21


def test_reading_a_run_starts_no_threads(scene_file: SceneWriter, tmp_path: Path) -> None:
    """Threads of Arrow that still work when the interpreter ends abort the process."""
    ended = run_case(case_of(scene_file(duration="0.02 ms")), "verlet", tmp_path)
    script = (
        "import sys, psutil, pyarrow.parquet; from pathlib import Path; from drivers.run.run_folder import open_run;"
        "before = psutil.Process().num_threads(); open_run(Path(sys.argv[1])).trace;"
        "sys.exit(psutil.Process().num_threads() - before)"
    )
    assert subprocess.run([sys.executable, "-c", script, str(ended.folder)], check=False).returncode == 0
