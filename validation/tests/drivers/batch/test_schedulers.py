"""Tests of studies on a Dask cluster and on a Slurm of one machine, started on loopback and stopped afterwards."""

import os
import signal
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest

from validation.tests.drivers.batch.test_batch import batch, batch_here, results_of, stored, table_bytes
from validation.tests.drivers.batch.test_killed_batches import wait_for
from validation.tests.helpers.commands import BEADS, beads
from validation.tests.helpers.scenes import SPEEDS, StudyWriter

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
        wait_for(lambda: "idle" in _said("sinfo", "--noheader", "--format=%T"))
        yield str(conf)
    finally:
        os.environ.pop("SLURM_CONF", None)
        for server in reversed(servers):
            os.killpg(server.pid, signal.SIGKILL)
            server.wait()


def _said(*words: str) -> str:
    return subprocess.run(words, capture_output=True, text=True, check=False).stdout


@pytest.mark.long
def test_tables_are_the_same_wherever_the_rows_are_run(study_file: StudyWriter, tmp_path: Path) -> None:
    """Byte for byte: on a Dask cluster of which a worker is killed, on one of the batch itself, here, in slices."""
    from distributed import LocalCluster

    path, killed = study_file(SPEEDS.format(100), "reference", "verlet"), tmp_path / "killed"
    with LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None) as cluster:
        words = ("batch", path, "--dask", cluster.scheduler_address, "--runs", killed, "--results", results_of(killed))
        process = subprocess.Popen(
            [*BEADS, *map(str, words)], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
        )
        rows = wait_for(lambda: len(stored(killed)))
        os.kill(cluster.workers[0].pid, signal.SIGKILL)
        assert rows < 200
        printed, complaints = process.communicate(timeout=120)
    assert process.returncode == 0, complaints
    assert "verlet     100 done" in printed
    right = table_bytes(killed)
    ways = {"dask": ["--dask"], "here": [""], "slices": ["--slice 2/3", "--slice 3/3", "--slice 1/3", ""]}
    for place, options in ways.items():
        runs = tmp_path / place
        for option in options:
            done = batch(path, runs, *option.split())
            assert done.returncode == 0, done.stderr
        assert table_bytes(runs) == right, place
        assert stored(runs) == [*range(1, 201)], place


@pytest.mark.slurm
def test_a_second_job_shares_the_work_of_a_running_one(
    slurm: str, study_file: StudyWriter, modules: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The submitting machine has no such engine; the first job is killed, and the second one takes up its rows.

    The tables are those of a local batch.
    """
    study, runs = study_file(SPEEDS.format(80), "by-module", top=DURATION), tmp_path / "runs"
    words = ("--slurm", "--slices", "1", "--slurm-line", "module load dem")
    job = batch(study, runs, *words).stdout.split("job ")[-1].partition(":")[0]
    wait_for(lambda: stored(runs))
    second = batch(study, runs, *words, "--slices", "2")
    assert second.returncode == 0, second.stderr
    assert "#SBATCH --array=1-2\n" in (runs / ".slurm" / "study.sh").read_text()
    wait_for(lambda: _said("squeue", "--noheader", "--format=%T").count("RUNNING\n") == 2)
    state = beads("status", study, "--runs", runs).stdout
    assert " done" in state
    assert " claimed" in state
    subprocess.run(["scancel", "--signal=KILL", "--full", job], check=True)
    subprocess.run(["scancel", job], check=True)
    wait_for(lambda: not _said("squeue", "--noheader"))
    assert beads("status", study, "--runs", runs).stdout == "by-module  80 done\n"
    assert len(stored(runs)) == 80
    monkeypatch.setenv("PATH", f"{modules}:{os.environ['PATH']}")
    for place in (runs, tmp_path / "here"):
        assert batch_here(study, place).returncode == 0
    assert table_bytes(runs) == table_bytes(tmp_path / "here")
