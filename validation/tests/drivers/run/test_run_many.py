"""Tests of many runs: in order, in parallel, interrupted, and on servers as by hand."""

import os
import shutil
import signal
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import numpy as np
import psutil
import pytest

from drivers.base.errors import RunError
from drivers.base.processes import STDOUT, all_stopped, run_command
from drivers.chain.trace import digest_of
from drivers.engines import REFERENCE, VERLET
from drivers.run import compute as computing
from drivers.run.compute import compute
from drivers.run.execute import Place, execute
from drivers.run.run import run_case, run_many
from drivers.run.run_folder import open_run
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
    while not [*runs.glob("*/.*/run/chain.*")]:
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


def test_a_server_gives_the_bits_of_an_own_process(scene_file: SceneWriter) -> None:
    need(CODE)
    for speed in (1, 2):
        case = case_of(scene_file(), f"striker.speed={speed} m/s")
        served, alone = compute(case, CODE), compute(case, CODE, own_process=True)
        assert digest_of(served.done) == digest_of(alone.done)
        assert served.loop_s is not None
        assert alone.cpu_s > 0 == served.cpu_s


def test_many_runs_of_a_code_share_servers(scene_file: SceneWriter, tmp_path: Path) -> None:
    """Their folders are those of runs in processes of their own, except for CPU time and memory."""
    need(CODE)
    cases = [case_of(scene_file(), f"striker.speed={speed} m/s") for speed in (1, 2, 3)]
    for case, served in zip(cases, run_many([(case, CODE) for case in cases], tmp_path / "many"), strict=True):
        alone = run_case(case, CODE, tmp_path / "alone")
        assert digest_of(served.trace) == digest_of(alone.trace)
        assert [path.name for path in sorted(served.folder.iterdir())] == [
            path.name for path in sorted(alone.folder.iterdir())
        ]
        assert (served.record.cpu_s, served.record.memory_bytes) == (None, None)
        assert alone.record.cpu_s is not None
        assert served.record.loop_s is not None
        assert (served.folder / STDOUT).read_text().count("Loop time") == 1


@pytest.mark.parametrize(
    ("engine", "scene", "setting"),
    [(REFERENCE, "two-spheres", "contact.restitution=0.8"), (VERLET, "fig4-tube", "run.duration=0.1 ms")],
)
def test_in_repo_engine_gives_the_bits_of_its_deck(engine: str, scene: str, setting: str) -> None:
    case = case_of(scene, setting)
    here, alone = compute(case, engine).done, compute(case, engine, own_process=True).done
    assert digest_of(here) == digest_of(alone)
    assert here.height_m is not None
    assert alone.height_m is not None
    assert np.array_equal(here.height_m, alone.height_m)


def test_a_served_case_that_fails_leaves_the_others_alone(scene_file: SceneWriter) -> None:
    need(CODE)
    unstable, stable = case_of(scene_file(), "run.time_step=50 us", "run.sample_interval=50 us"), case_of(scene_file())
    before, failed, after = (compute(case, CODE) for case in (stable, unstable, stable))
    assert str(failed.fault) == str(compute(unstable, CODE, own_process=True).fault)
    assert digest_of(before.done) == digest_of(after.done)


def test_a_build_that_is_no_server_runs_each_deck_in_its_own_process(
    stand_in: StandIn, scene_file: SceneWriter, tmp_path: Path
) -> None:
    """A script that passes no input on; one start of a server shows it."""
    need(CODE)
    count, real = tmp_path / "count", shutil.which("lmp")
    stand_in("lmp", f'case "$*" in *-h*) ;; *) echo >> {count} ;; esac\nexec {real} "$@" < /dev/null')
    computing._idle.clear()
    for runs in (2, 3):
        assert compute(case_of(scene_file()), CODE).done.time_s.size
        assert count.read_text().count("\n") == runs


def test_an_interrupt_while_a_worker_starts_prints_nothing() -> None:
    script = (
        "import os, signal; from drivers.run import execute\n"
        "start = execute.start\n"
        "def interrupted(*words, **streams):\n"
        "    os.kill(os.getpid(), signal.SIGINT)\n"
        "    return start(*words, **streams)\n"
        "execute.start = interrupted\n"
        "signal.signal(signal.SIGINT, signal.default_int_handler)\n"
        "try:\n"
        "    [*execute.execute(abs, [1], execute.Place(1, processes=True))]\n"
        "except KeyboardInterrupt:\n"
        "    print('interrupted')"
    )
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, check=False, timeout=60)
    assert (done.stdout, done.stderr) == (b"interrupted\n", b"")


def test_an_item_whose_worker_is_killed_is_begun_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """With the result of the next worker, or after several an error; whatever the present folder holds."""
    monkeypatch.chdir(tmp_path)
    Path("traceback.py").write_text("raise SystemExit")
    place = Place(1, processes=True)
    killed = f"import os, pathlib; first = pathlib.Path({str(tmp_path / 'first')!r})\n"
    once = f"{killed}if not first.exists():\n    first.touch()\n    os.kill(os.getpid(), 9)"
    assert [*execute(exec, [once], place)] == [(once, None)]
    with pytest.raises(RunError, match="workers were killed"):
        [*execute(exec, [f"{killed}os.kill(os.getpid(), 9)"], place)]
    began = time.monotonic()
    with pytest.raises(ZeroDivisionError):
        [*execute(exec, ["import time; time.sleep(60)", "1 / 0"], replace(place, workers=2))]
    assert time.monotonic() < began + 50
    assert [*execute(exec, ["import tempfile; assert tempfile.tempdir"], place)]  # not tried with a file


def _relatives(seconds: float) -> tuple[int, int]:
    """Numbers of the parent and of the process."""
    time.sleep(seconds)
    return os.getppid(), os.getpid()


def test_workers_are_forked_from_one_process_that_may_be_killed() -> None:
    place = Place(2, processes=True)
    (parent, one), (same, other) = (numbers for _, numbers in execute(_relatives, [0.5, 0.5], place))
    assert parent == same != os.getpid()
    assert one != other
    os.kill(parent, signal.SIGKILL)
    while any(map(psutil.pid_exists, (parent, one, other))):  # workers end with it
        time.sleep(0.01)
    (_, (another, _)) = next(execute(_relatives, [0.0], place))
    assert another != parent


def test_a_worker_ends_at_once_and_says_nothing() -> None:
    script = (
        "import psutil, time; from drivers.run.execute import Worker; from threading import Timer\n"
        "Worker().end()  # before it has begun\n"
        "worker = Worker(); assert worker.answer(abs, -1) == (True, 1)\n"
        "Timer(0.5, worker.end).start(); began = time.monotonic()\n"
        "try: worker.answer(time.sleep, 60)\n"
        "except (EOFError, OSError): print(time.monotonic() - began < 30)\n"
        "time.sleep(0.5); print(psutil.Process(worker._process).status())"
    )
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, check=False, timeout=60)
    assert (done.stdout, done.stderr) == (b"True\nzombie\n", b"")


def test_a_process_that_ends_leaves_no_places(scene_file: SceneWriter, tmp_path: Path) -> None:
    """Of its servers, and of its workers."""
    need(CODE)
    script = (
        "import sys; from drivers.run.compute import compute; from drivers.run.execute import Place, execute\n"
        "from validation.tests.helpers.scenes import case_of\n"
        f"assert compute(case_of(sys.argv[1]), '{CODE}').done\n"
        "[*execute(exec, [sys.argv[2]], Place(1, processes=True))]"
    )
    left = (
        "import builtins; from drivers.base.processes import workplace; builtins.left = workplace(); left.__enter__()"
    )
    places = tmp_path / "places"
    places.mkdir()
    words = [sys.executable, "-c", script, str(scene_file()), left]
    assert subprocess.run(words, check=False, env=os.environ | {"TMPDIR": str(places)}).returncode == 0
    assert [*places.iterdir()] == []
