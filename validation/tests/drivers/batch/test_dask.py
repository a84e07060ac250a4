"""Tests of studies on a Dask cluster: a scheduler and two workers on loopback."""

import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest

from drivers.batch.store import Store
from validation.tests.helpers.commands import BEADS, beads
from validation.tests.helpers.scenes import SPEEDS, StudyWriter

pytestmark = pytest.mark.long


@dataclass(frozen=True)
class Cluster:
    """Address of the scheduler, and the workers."""

    address: str
    workers: list[subprocess.Popen[bytes]]


@pytest.fixture
def cluster(tmp_path: Path) -> Iterator[Cluster]:
    """A scheduler and two workers, stopped afterwards."""
    said = tmp_path / "scheduler.txt"
    started = []

    def start(program: str, *words: str, log: Path) -> subprocess.Popen[bytes]:
        command = [sys.executable, "-m", f"distributed.cli.{program}", "--no-dashboard", *words]
        with log.open("wb") as output:
            started.append(subprocess.Popen(command, stdout=output, stderr=output, start_new_session=True))
        return started[-1]

    try:
        start("dask_scheduler", "--host", "127.0.0.1", "--port", "0", log=said)
        address = str(_wait_for(lambda: re.search(r"Scheduler at: +(tcp://[0-9.:]+)", said.read_text()))[1])
        options = (address, "--nthreads", "1", "--no-nanny", "--local-directory", str(tmp_path / "dask"))
        workers = [start("dask_worker", *options, log=tmp_path / f"worker{i}.txt") for i in (1, 2)]
        yield Cluster(address, workers)
    finally:
        for process in started:
            os.killpg(process.pid, signal.SIGKILL)
            process.wait()


def _wait_for(found: Callable[[], re.Match[str] | None]) -> re.Match[str]:
    until = time.monotonic() + 30
    while time.monotonic() < until:
        if match := found():
            return match
        time.sleep(0.1)
    raise AssertionError("it did not happen in time")


def test_a_worker_killed_in_the_middle(cluster: Cluster, study_file: StudyWriter, tmp_path: Path) -> None:
    path, runs, here = study_file(SPEEDS.format(100), "reference", "verlet"), tmp_path / "runs", tmp_path / "here"
    words = ["batch", str(path), "--dask", cluster.address, "--runs", str(runs), "--results", str(tmp_path)]
    process = subprocess.Popen([*BEADS, *words], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    until = time.monotonic() + 60
    while not (rows := len(Store(runs).refresh())) and time.monotonic() < until:
        time.sleep(0.05)
    os.killpg(cluster.workers[0].pid, signal.SIGKILL)
    assert 0 < rows < 200
    printed, complaints = process.communicate(timeout=120)
    assert process.returncode == 0, complaints
    assert "verlet     100 done" in printed
    local = beads("batch", path, "--dask", "--runs", here, "--results", here)  # on a cluster of its own
    assert (local.returncode, "reference  100 done" in local.stdout) == (0, True), local.stderr
    assert (tmp_path / "study.parquet").read_bytes() == (here / "study.parquet").read_bytes()
