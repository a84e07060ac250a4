"""Tests of killed batches: no row is lost, and no process or file remains."""

import os
import random
import re
import shutil
import signal
import subprocess
import time
from pathlib import Path

import numpy as np
import pytest

from drivers.batch.study_cases import Batch, CaseFacts, Request, opened
from drivers.batch.study_plan import validate_cases
from drivers.run.execute import EXIT_LIMIT_S
from validation.tests.drivers.batch.test_batch import batch, stored, table_bytes
from validation.tests.helpers.commands import BEADS, without_progress
from validation.tests.helpers.runs import need
from validation.tests.helpers.scenes import SPEEDS, StudyWriter


@pytest.mark.long
def test_killed_at_random_moments(study_file: StudyWriter, tmp_path: Path) -> None:
    """SIGKILL of the whole process group, at least twenty times; the table is that of an undisturbed run."""
    need("liggghts")
    path = study_file(SPEEDS.format(250), "liggghts", "verlet")
    words = [*BEADS, "batch", str(path), "--results", str(tmp_path / "runs-results")]
    runs, moments, kills, kept = tmp_path / "runs", random.Random(5), 0, 0
    leaders: list[int] = []
    while kills < 22:
        process = subprocess.Popen(
            [*words, "--runs", str(runs)], start_new_session=True, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE
        )
        try:
            process.wait(moments.uniform(0.3, 3.2))
            assert process.returncode == 0, process.stderr and process.stderr.read()
            kept = 0
            shutil.rmtree(runs / "batch")  # finished too early: start again for the remaining kills
        except subprocess.TimeoutExpired:
            os.killpg(process.pid, signal.SIGKILL)
            process.wait()
            leaders.append(process.pid)
            kills += 1
            rows = len(stored(runs))
            assert rows >= kept, "rows were lost"
            kept = rows
    assert batch(path, runs).returncode == 0
    assert batch(path, tmp_path / "undisturbed").returncode == 0
    assert table_bytes(runs) == table_bytes(tmp_path / "undisturbed")
    assert not list((runs / "batch" / ".work").glob("*@*"))
    time.sleep(0.5)
    assert not [left for leader in leaders for left in _processes_of(leader, tmp_path)]


def _processes_of(leader: int, folder: Path) -> list[str]:
    """Commands of processes of a session, and of processes in a folder, since engines have sessions of their own."""
    found = []
    for process in Path("/proc").glob("[0-9]*"):
        try:
            session = int((process / "stat").read_text().rpartition(")")[2].split()[3])
            if session == leader or str((process / "cwd").resolve()).startswith(str(folder)):
                found.append((process / "cmdline").read_text())
        except OSError:
            continue
    return [command for command in found if command]  # processes that have ended have none


@pytest.mark.parametrize("request_to_end", [signal.SIGKILL, signal.SIGTERM, signal.SIGHUP])
@pytest.mark.parametrize("helpers", [1, 3, pytest.param(None, marks=pytest.mark.long)])
def test_helpers_do_not_outlive_a_killed_batch(
    request_to_end: signal.Signals, helpers: int | None, study_file: StudyWriter, tmp_path: Path
) -> None:
    """The fork server, also while it still imports modules; workers, also while they plan; and their engines."""
    path, runs = study_file(SPEEDS.format(3000), "verlet"), tmp_path / "runs"
    words = [*BEADS, "batch", str(path), "--runs", str(runs), "--results", str(tmp_path)]
    process = subprocess.Popen(
        words, start_new_session=True, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True
    )
    until = time.monotonic() + 60
    while time.monotonic() < until and not (
        sum("forkserver" in each for each in _processes_of(process.pid, runs)) >= helpers if helpers else stored(runs)
    ):
        time.sleep(0.05)
    process.send_signal(request_to_end)  # to it alone, not its group
    process.wait(timeout=EXIT_LIMIT_S)  # a worker that has to be waited for takes longer
    until = time.monotonic() + 5  # a fork server notices the end when its imports are done
    while _processes_of(process.pid, runs) and time.monotonic() < until:
        time.sleep(0.05)
    assert not _processes_of(process.pid, runs)
    assert process.stderr is not None
    assert re.fullmatch(r"(interrupted(: \d+ of 3000 rows done; .*)?\n)?", without_progress(process.stderr.read()))


@pytest.mark.parametrize("request_to_end", [signal.SIGTERM, signal.SIGHUP])
def test_a_signal_to_all_processes_leaves_no_files(
    request_to_end: signal.Signals, study_file: StudyWriter, tmp_path: Path
) -> None:
    """As of a scheduler or of a terminal that is closed: workers leave their folders and those of engines."""
    need("lammps")
    path, runs, places = study_file(SPEEDS.format(1000), "lammps"), tmp_path / "runs", tmp_path / "places"
    places.mkdir()
    process = subprocess.Popen(
        [*BEADS, "batch", str(path), "--runs", str(runs), "--results", str(tmp_path)],
        start_new_session=True,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
        env=os.environ | {"TMPDIR": str(places)},
    )
    until = time.monotonic() + 60
    while not [*places.glob("bead-chains-*/*/*/case/*")] and time.monotonic() < until:
        time.sleep(0.02)
    os.killpg(process.pid, request_to_end)
    _, said = process.communicate(timeout=20)
    assert process.returncode == 130
    assert re.fullmatch(r"interrupted: \d+ of 1000 rows done; .*\n", without_progress(said))
    assert not [place for place in places.iterdir() if not place.name.startswith("ompi.")]  # of a killed Open MPI
    assert not [*(runs / "batch" / ".work").glob("*@*")]


@pytest.mark.long
def test_a_killed_fork_server_costs_nothing(study_file: StudyWriter, tmp_path: Path) -> None:
    path, runs = study_file(SPEEDS.format(60), "verlet"), tmp_path / "runs"
    words = [*BEADS, "batch", str(path), "--runs", str(runs), "--results", str(tmp_path)]
    process = subprocess.Popen(words, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)
    kills = 0
    while process.poll() is None:
        children = Path(f"/proc/{process.pid}/task/{process.pid}/children").read_text().split()
        for child in children if kills < 2 else ():
            if b"forkserver" in Path(f"/proc/{child}/cmdline").read_bytes():
                os.kill(int(child), signal.SIGKILL)
                kills += 1
        time.sleep(0.3)
    assert process.stderr is not None
    assert (process.wait(), without_progress(process.stderr.read())) == (0, "")
    assert kills
    assert set(stored(runs).values()) == {1}
    assert len(stored(runs)) == 60


@pytest.mark.long
def test_interrupted_in_order(study_file: StudyWriter, tmp_path: Path) -> None:
    path, runs = study_file(SPEEDS.format(3000), "verlet"), tmp_path / "runs"
    words = [*BEADS, "batch", str(path), "--runs", str(runs), "--results", str(tmp_path)]
    process = subprocess.Popen(
        words,
        start_new_session=True,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),  # tests begun with & do not hear Ctrl-C
    )
    until = time.monotonic() + 60
    while not stored(runs) and time.monotonic() < until:
        time.sleep(0.1)
    process.send_signal(signal.SIGINT)
    _, errors = process.communicate(timeout=20)
    count = len(stored(runs))
    said = f"interrupted: {count} of 3000 rows done; the same command continues\n"
    assert (process.returncode, without_progress(errors)) == (130, said)
    assert stored(runs)
    time.sleep(0.5)
    assert not _processes_of(process.pid, runs)


def test_planning_survives_a_kill(study_file: StudyWriter, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The facts of finished parts are kept, and not computed again."""
    path, built = study_file(SPEEDS.format(60), "verlet"), list[int]()
    request = Request(path, tmp_path / "runs", lambda case: case, lambda *_: {}, lambda *_: np.zeros(1))
    batch = opened(request)
    assert [*batch.slice_of(2, 20)] == [2, 22, 42]
    computed = Batch.computed_facts

    def facts(self: Batch, number: int) -> CaseFacts:
        if number == 40 and not built.count(40):
            built.append(40)
            raise KeyboardInterrupt
        built.append(number)
        return computed(self, number)

    monkeypatch.setattr(Batch, "computed_facts", facts)
    with pytest.raises(KeyboardInterrupt):
        validate_cases(batch, 1)
    assert built == [*range(1, 41)]
    built[:] = [40]
    validate_cases(batch, 1)
    assert built == [40, *range(26, 61)]
    facts_before = dict(batch.known)
    assert [*facts_before] == [*range(1, 61)]
    validate_cases(batch, 1)
    assert batch.known == facts_before
    assert len(built) == 36
