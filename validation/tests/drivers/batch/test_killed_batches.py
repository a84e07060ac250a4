"""Tests of killed batches and full disks: no row is lost, and no process or file remains."""

import os
import random
import shutil
import signal
import subprocess
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path
from typing import TypeVar

import psutil
import pytest

from drivers.run import execute
from validation.tests.drivers.batch.test_batch import batch, batch_here, sql, stored, table, table_bytes
from validation.tests.helpers.commands import BEADS, beads, without_progress
from validation.tests.helpers.runs import need
from validation.tests.helpers.scenes import SPEEDS, SceneWriter, StandIn, StudyWriter

Result = TypeVar("Result")


def start(path: Path, runs: Path, **changes: str) -> subprocess.Popen[str]:
    """Start a batch in a session of its own, with changed variables of the environment."""
    return subprocess.Popen(
        [*BEADS, "batch", str(path), "--runs", str(runs), "--results", str(runs.parent / f"{runs.name}-results")],
        start_new_session=True,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
        env=os.environ | changes,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),  # tests begun with & do not hear Ctrl-C
    )


def workers_of(process: subprocess.Popen[str]) -> list[psutil.Process]:
    """Worker processes of a batch."""
    found = []
    for child in psutil.Process(process.pid).children(recursive=True):
        with suppress(psutil.Error):
            if child.cmdline()[1:4] == ["-P", "-m", execute.__name__]:
                found.append(child)
    return found


def said_by(process: subprocess.Popen[str]) -> str:
    """Standard error of a process that has ended."""
    return without_progress(process.communicate(timeout=20)[1])


def wait_for(happened: Callable[[], Result | None], seconds: float = 60) -> Result:
    until = time.monotonic() + seconds
    while not (result := happened()):
        assert time.monotonic() < until, "it did not happen in time"
        time.sleep(0.05)
    return result


def processes_of(leader: int, folder: Path) -> list[str]:
    """Commands of processes of a session, and of processes in a folder, since engines have sessions of their own."""
    commands = []
    for process in Path("/proc").glob("[0-9]*"):
        try:
            session = int((process / "stat").read_text().rpartition(")")[2].split()[3])
            if session == leader or str((process / "cwd").resolve()).startswith(str(folder)):
                commands.append((process / "cmdline").read_text())
        except OSError:
            continue
    return [command for command in commands if command]  # processes that have ended have none


@pytest.mark.long
def test_killed_at_random_moments(study_file: StudyWriter, tmp_path: Path) -> None:
    """SIGKILL of the whole process group, again and again; the table is that of an undisturbed run."""
    need("liggghts")
    path = study_file(SPEEDS.format(100), "liggghts", "verlet")
    runs, moments, kept = tmp_path / "runs", random.Random(5), 0
    leaders: list[int] = []
    while len(leaders) < 5:
        process = start(path, runs)
        try:
            process.wait(moments.uniform(0.3, 3.2))
            assert process.returncode == 0, said_by(process)
            kept = 0
            shutil.rmtree(runs)  # finished too early: start again for the remaining kills
        except subprocess.TimeoutExpired:
            os.killpg(process.pid, signal.SIGKILL)
            process.wait()
            leaders.append(process.pid)
            rows = len(stored(runs))
            assert rows >= kept, "rows were lost"
            kept = rows
    assert batch(path, runs).returncode == 0
    assert batch_here(path, tmp_path / "undisturbed").returncode == 0
    assert table_bytes(runs) == table_bytes(tmp_path / "undisturbed")
    assert sql(runs, "SELECT * FROM claims") == []
    assert [file.name for file in runs.iterdir()] == ["batch.sqlite"]
    wait_for(lambda: not any(processes_of(leader, tmp_path) for leader in leaders), 20)


def test_workers_do_not_outlive_a_killed_batch(study_file: StudyWriter, tmp_path: Path) -> None:
    process = start(study_file(SPEEDS.format(600), "verlet"), tmp_path / "runs")
    workers = wait_for(lambda: found if len(found := workers_of(process)) >= 2 else None)
    process.kill()  # it alone, not its group, while workers plan
    assert psutil.wait_procs(workers, 20)[1] == []
    assert said_by(process) == ""


def test_a_signal_to_all_processes_leaves_no_files(study_file: StudyWriter, tmp_path: Path) -> None:
    """As of a terminal that is closed: workers leave their folders and those of engines."""
    need("lammps")
    path, runs, places = study_file(SPEEDS.format(300), "lammps"), tmp_path / "runs", tmp_path / "places"
    places.mkdir()
    process = start(path, runs, TMPDIR=str(places))
    wait_for(lambda: [*places.glob(".bead-chains-*/case/*")])
    os.killpg(process.pid, signal.SIGHUP)
    assert process.wait(timeout=10) == 130
    assert said_by(process) == f"interrupted: {len(stored(runs))} of 300 rows done; the same command continues\n"
    assert not [place for place in places.iterdir() if not place.name.startswith("ompi.")]  # of a killed Open MPI
    assert sql(runs, "SELECT * FROM claims") == []
    assert [file.name for file in runs.iterdir()] == ["batch.sqlite"]


@pytest.mark.long
def test_killed_workers_cost_nothing(study_file: StudyWriter, tmp_path: Path) -> None:
    runs = tmp_path / "runs"
    process, kills = start(study_file(SPEEDS.format(60), "verlet"), runs), 0
    while process.poll() is None:
        for found in workers_of(process) if kills < 2 else ():
            found.kill()
            kills += 1
        time.sleep(0.3)
    assert (process.returncode, said_by(process)) == (0, "")
    assert kills
    assert stored(runs) == [*range(1, 61)]


@pytest.fixture
def small_disk(tmp_path: Path) -> Iterator[Path]:
    """File system of three megabytes."""
    place = tmp_path / "disk"
    place.mkdir()
    mount = ["mount", "-t", "tmpfs", "-o", "size=3m", "tmpfs", str(place)]
    if subprocess.run(mount, capture_output=True, check=False).returncode:
        pytest.skip("mounting a small file system needs more rights")
    yield place
    subprocess.run(["umount", "-l", place], check=True)


def test_a_full_disk_ends_the_batch(study_file: StudyWriter, small_disk: Path) -> None:
    path, runs = study_file(SPEEDS.format(20), "verlet"), small_disk / "runs"
    free = shutil.disk_usage(small_disk).free
    (small_disk / "ballast").write_bytes(b"\0" * (free - 20_000))
    done = batch(path, runs)
    assert (done.returncode, done.stderr.count("\n")) == (1, 1)
    assert "No space left on device" in done.stderr
    (small_disk / "ballast").unlink()
    again = batch(path, runs)
    assert again.returncode == 0, again.stderr
    assert set(table(runs)["status"]) == {"done"}


def test_a_disk_that_temporary_files_fill_during_a_run_counts_as_full(
    stand_in: StandIn, scene_file: SceneWriter, small_disk: Path
) -> None:
    """As those of Open MPI, which are gone when the code has ended."""
    need("liggghts")
    took, real = small_disk / "temporary", shutil.which("liggghts")
    stand_in("liggghts", f'head -c 2900k /dev/zero > {took}; {real} "$@"; code=$?; rm {took}; exit $code')
    done = beads("run", scene_file(duration="0.5 ms"), "--engine", "liggghts", "--runs", small_disk / "runs")
    assert done.returncode == 1
    assert "No space left on device" in done.stderr
