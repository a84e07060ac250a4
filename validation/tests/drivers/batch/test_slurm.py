"""Tests of studies on a Slurm of one machine, started here on loopback and stopped afterwards (make test-slurm)."""

import os
import signal
import subprocess
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from drivers.batch.store import Store
from validation.tests.drivers.batch.test_batch import batch, table_bytes
from validation.tests.helpers.commands import beads
from validation.tests.helpers.scenes import SPEEDS, StudyWriter

pytestmark = pytest.mark.slurm

DURATION = 'set = { "run.duration" = "6 ms" }'  # a case then takes some tenths of a second

CONF = """
ClusterName=one
SlurmctldHost={host}(127.0.0.1)
SlurmUser=root
SlurmdUser=root
AuthType=auth/munge
AuthInfo=socket={home}/munge.socket
CredType=cred/munge
StateSaveLocation={home}/state
SlurmdSpoolDir={home}/spool
SlurmctldPidFile={home}/ctld.pid
SlurmdPidFile={home}/d.pid
SlurmctldLogFile={home}/ctld.log
SlurmdLogFile={home}/d.log
ProctrackType=proctrack/linuxproc
TaskPlugin=task/none
SelectType=select/cons_tres
SelectTypeParameters=CR_Core
JobAcctGatherType=jobacct_gather/none
AccountingStorageType=accounting_storage/none
MpiDefault=none
ReturnToService=2
NodeName={host} NodeAddr=127.0.0.1 CPUs={cpus} RealMemory=1000 State=UNKNOWN
PartitionName=main Nodes={host} Default=YES MaxTime=INFINITE State=UP
"""


@pytest.fixture(scope="module")
def slurm(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    """Slurm cluster on this machine; returns its configuration file."""
    home = tmp_path_factory.mktemp("slurm")
    host = os.uname().nodename.split(".")[0]
    conf = home / "slurm.conf"
    conf.write_text(CONF.format(host=host, home=home, cpus=os.cpu_count()))
    for folder in ("state", "spool"):
        (home / folder).mkdir()
    key = home / "munge.key"
    key.write_bytes(os.urandom(128))
    key.chmod(0o600)
    files = {"key-file": "key", "socket": "socket", "pid-file": "pid", "log-file": "log", "seed-file": "seed"}
    munged = [
        "munged",
        "--foreground",
        "--force",
        *(f"--{option}={home}/munge.{name}" for option, name in files.items()),
    ]
    servers = []
    try:
        for words in (munged, ["slurmctld", "-D", "-f", str(conf)], ["slurmd", "-D", "-f", str(conf)]):
            with (home / f"{words[0]}.txt").open("wb") as said:
                servers.append(subprocess.Popen(words, start_new_session=True, stdout=said, stderr=said))
        os.environ["SLURM_CONF"] = str(conf)
        _wait_for(lambda: "idle" in _said("sinfo", "--noheader", "--format=%T"))
        yield str(conf)
    finally:
        os.environ.pop("SLURM_CONF", None)
        for server in reversed(servers):
            os.killpg(server.pid, signal.SIGKILL)
            server.wait()


def _said(*words: str) -> str:
    return subprocess.run(words, capture_output=True, text=True, check=False).stdout


def _wait_for(happened: Callable[[], bool], seconds: float = 60) -> None:
    until = time.monotonic() + seconds
    while not happened():
        assert time.monotonic() < until, "it did not happen in time"
        time.sleep(0.2)


def test_an_array_runs_what_is_missing_and_makes_the_same_table(
    slurm: str, study_file: StudyWriter, tmp_path: Path
) -> None:
    study, here, there = study_file(SPEEDS.format(12), "reference", "verlet"), tmp_path / "here", tmp_path / "there"
    assert batch(study, here).returncode == 0
    for part in ("1/4", "4/4"):
        assert batch(study, there, "--slice", part).returncode == 0
    done = batch(study, there, "--slurm", "--wait", "--slices", "4")
    assert done.returncode == 0, done.stderr
    assert "#SBATCH --array=2-3\n" in (there / "batch" / ".slurm" / "study.sh").read_text()
    assert table_bytes(there) == table_bytes(here)
    again = batch(study, there, "--slurm", "--wait")
    assert (again.returncode, "job" in again.stdout) == (0, False)


def test_a_failing_task_leaves_its_rows_to_do(
    slurm: str, study_file: StudyWriter, modules: Path, tmp_path: Path
) -> None:
    study, runs = study_file(SPEEDS.format(12), "verlet", "by-module"), tmp_path / "runs"
    failed = batch(study, runs, "--slurm", "--wait", "--slices", "3", "--slurm-line", "module load typo")
    assert failed.returncode == 1
    assert "verlet     12 to do\nby-module  12 to do\n" in failed.stdout
    outputs = [file.read_text() for file in (runs / "batch" / ".slurm").glob("study-*.txt")]
    assert outputs == ["module: typo not found\n"] * 3


def test_a_second_job_shares_the_work_of_a_running_one(
    slurm: str, study_file: StudyWriter, modules: Path, tmp_path: Path
) -> None:
    """The submitting machine has no such engine; the first job is killed, and the second one takes up its rows."""
    study, runs = study_file(SPEEDS.format(80), "by-module", top=DURATION), tmp_path / "runs"
    words = ("--slurm", "--slices", "1", "--slurm-line", "module load dem")
    job = batch(study, runs, *words).stdout.split("job ")[-1].partition(":")[0]
    _wait_for(lambda: any((runs / "batch").glob("*.jsonl")))
    assert batch(study, runs, *words).returncode == 0
    _wait_for(lambda: _said("squeue", "--noheader", "--format=%T") == "RUNNING\n" * 2)
    state = beads("status", study, "--runs", runs).stdout
    assert " done" in state
    assert " claimed" in state
    subprocess.run(["scancel", "--signal=KILL", "--full", job], check=True)
    subprocess.run(["scancel", job], check=True)
    _wait_for(lambda: not _said("squeue", "--noheader"))
    assert beads("status", study, "--runs", runs).stdout == "by-module  80 done\n"
    assert len(Store(runs).refresh()) == 80
