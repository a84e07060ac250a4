"""Tests of studies on engines that are not installed on the submitting machine; Slurm is replaced by scripts."""

import os
import shlex
import shutil
import subprocess
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pandas as pd
import pytest

from drivers.base import paths
from drivers.batch.job_array import most_tasks
from drivers.batch.store import Store
from drivers.run.build import Build
from validation.commands.batch_commands import batch_of
from validation.tests.drivers.batch.test_batch import batch, sql, table
from validation.tests.helpers.commands import beads
from validation.tests.helpers.runs import need
from validation.tests.helpers.scenes import SPEEDS, StandIn, StudyWriter

IDENTITIES = "SELECT identity FROM rows"
LOAD = ("--slurm-line", "module load dem")

RunWithModule = Callable[..., subprocess.CompletedProcess[str]]


def status(study: Path, runs: Path) -> str:
    counted = beads("status", study, "--runs", runs)
    assert (counted.returncode, counted.stderr) == (0, "")
    return counted.stdout


@pytest.fixture
def study(study_file: StudyWriter, modules: Path) -> Path:
    """A study of two cases on an installed engine and on one that exists in the job alone."""
    return study_file(SPEEDS.format(2), "verlet", "by-module")


@pytest.fixture
def run_with_module(modules: Path, monkeypatch: pytest.MonkeyPatch) -> RunWithModule:
    """Runs the rows of a study as its job does, where the engine exists."""

    def run(study: Path, runs: Path, *words: str) -> subprocess.CompletedProcess[str]:
        with monkeypatch.context() as loaded:
            loaded.setenv("PATH", f"{modules}:{os.environ['PATH']}")
            return beads("batch", study, "--runs", runs, "--slice", "1/1", *words)

    return run


@pytest.mark.long
def test_an_engine_may_exist_in_the_job_alone(
    study: Path, run_with_module: RunWithModule, stand_in: StandIn, tmp_path: Path
) -> None:
    """The first job fails for a wrong module and leaves all rows to do; the next one makes the table of this machine.

    Scripts in place of Slurm run the first task of an array immediately, as job 7.
    """
    run = '$(head -n 1 "$2" | cut -c 3-) "$2" >"$(dirname "$2")/study-7_1.txt" 2>&1'  # by the program of its first line
    stand_in("sbatch", f"SLURM_ARRAY_TASK_ID=1 {run}\necho 7\n")
    stand_in("squeue", "exit 0\n")
    stand_in("scontrol", "exit 1\n")
    runs, here = tmp_path / "runs", tmp_path / "here"
    failed = batch(study, runs, "--slurm", "--wait", "--slurm-line", "module load typo")
    assert failed.returncode == 1
    assert (runs / ".slurm" / "study-7_1.txt").read_text() == "module: typo not found\n"
    assert "verlet     2 to do\nby-module  2 to do\n" in failed.stdout
    assert "output in " in failed.stdout
    done = batch(study, runs, "--slurm", "--wait", *LOAD)
    assert (done.returncode, done.stderr.count("\n")) == (0, 1)
    assert done.stderr.startswith("by-module: not installed; it comes with module load dem ")
    assert done.stdout.endswith("verlet     2 done\nby-module  2 done\n")
    again = batch(study, runs, "--slurm", "--wait", *LOAD)  # nothing to do, so no job
    assert (again.returncode, "job 7" in again.stdout) == (0, False)
    assert run_with_module(study, here).returncode == 0
    assert batch(study, here).returncode == 0  # without the engine its finished rows still count
    pd.testing.assert_frame_equal(table(runs), table(here), check_exact=True)
    assert len({*sql(runs, IDENTITIES)}) == 4
    assert {*sql(runs, IDENTITIES)} == {*sql(here, IDENTITIES)}


def test_the_build_is_that_of_the_newest_row_done(
    study: Path, run_with_module: RunWithModule, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A failed row of a broken build hides no row done; a changed command has no rows."""
    runs = tmp_path / "runs"
    assert run_with_module(study, runs, "--only", "*=0.5*").returncode == 0
    with Store(runs) as store:
        (done,) = store.newest("by-module", 2)

    def build() -> Build:
        return batch_of(study, runs).builds["by-module"]

    installed = build()
    assert installed.identity == done.build
    broken = replace(done, status="failed", build=done.build.replace(installed.version, "broken"))
    with Store(runs) as store:
        store.finish(replace(broken, case_sha256="b", ended=done.ended + 1))
        assert build() == installed
        store.finish(replace(broken, case_sha256="n", status="done", ended=done.ended + 2))
        assert build().version == "broken"
    other = tmp_path / "other-engines.toml"
    other.write_text('[by-module]\nadapter = "lammps"\ncommand = "lmp-of-module -log none"\n')
    monkeypatch.setenv(paths.ENGINES_VARIABLE, str(other))
    assert build().version == "unknown"


def test_the_script_and_the_site_s_limit_of_arrays(study_file: StudyWriter, tmp_path: Path, stand_in: StandIn) -> None:
    """Codes that are found here are found in the job, whose login profile may replace PATH."""
    need("lammps")
    study, runs = study_file(SPEEDS.format(9), "verlet", "lammps"), tmp_path / "runs"
    stand_in("lmp", f'exec {shutil.which("lmp")} "$@"\n')
    stand_in("scontrol", 'test "$*" = "show config" && echo "MaxArraySize            = 5"\n')
    words = ("--slurm", "--dry-run", "--retry", *LOAD, "--slurm-line", "#SBATCH --mem=2G")
    planned = batch(study, runs, *words, "--slices", "8").stdout
    assert "8 tasks cut to 4, the limit of job arrays here (MaxArraySize)\n" in planned
    lines = planned[planned.index("#!") :].splitlines()
    assert lines[0] == "#!/bin/bash -l"
    assert "#SBATCH --array=1-4" in lines
    commands = [line for line in lines[1:] if not line.startswith("#")]
    assert commands[:3] == ["set -e", f'export PATH={shlex.quote(str(tmp_path / "bin"))}:"$PATH"', "module load dem"]
    limits = [lines.index(f"#SBATCH --{limit}") for limit in ("time=10", "mem=800M", "mem=2G")]  # the last one counts
    assert sorted(limits) == limits
    assert limits[-1] < lines.index("set -e")
    assert next(line for line in commands if line.startswith("exec ")).endswith(
        '--retry --slice "$SLURM_ARRAY_TASK_ID/4"'
    )
    for part in ("1/3", "3/3"):
        assert batch(study, runs, "--slice", part).returncode == 0
    assert "#SBATCH --array=2\n" in batch(study, runs, *words, "--slices", "3").stdout
    assert batch(study, runs, "--slice", "2/3").returncode == 0
    again = batch(study, runs, *words, "--slices", "3").stdout
    assert "#SBATCH --array=1-3\n" in again
    assert again.endswith("; nothing submitted\n")
    stand_in("scontrol", "exit 1\n")
    assert most_tasks() == 1000


def test_rows_of_an_absent_engine_wait_and_count(study: Path, run_with_module: RunWithModule, tmp_path: Path) -> None:
    runs = tmp_path / "runs"
    done = batch(study, runs, "--slice", "1/1")
    assert (done.returncode, done.stdout) == (1, "slice 1/1\nverlet     2 done\nby-module  2 not installed\n")
    assert done.stderr.startswith("by-module: not installed; it comes with module load dem ")
    whole = batch(study, runs)
    assert (whole.returncode, "by-module  2 not installed" in whole.stdout) == (1, True)
    assert list(table(runs)["status"]) == ["done", "not installed"] * 2
    assert run_with_module(study, runs, "--only", "striker.speed=0.5*").returncode == 0
    assert status(study, runs) == "verlet     2 done\nby-module  1 done, 1 not installed\n"
    assert run_with_module(study, runs).returncode == 0
    study.write_text(f'set = {{ "chain.count" = 4 }}\n{study.read_text()}')
    assert status(study, runs) == "verlet     2 to do\nby-module  2 not installed\n"
    assert "by-module  2 to do" in batch(study, runs, "--slurm", "--dry-run").stdout
    assert "by-module  2 not installed" in batch(study, runs, "--dry-run").stdout


def test_an_engine_of_the_job_refuses_cases_before_the_job(modules: Path, tmp_path: Path) -> None:
    study = tmp_path / "study.toml"
    law = '{ "contact.dissipation" = "hunt-crossley", "contact.slowness" = "0.2 s/m" }'
    study.write_text(f'scene = "fig4"\nengines = ["verlet", "by-module"]\nset = {law}\n')
    done = batch(study, tmp_path / "runs", "--slurm", "--dry-run")
    assert (done.returncode, done.stderr.count("\n")) == (2, 1)
    assert 'contact.dissipation: found "hunt-crossley"; allowed: on by-module' in done.stderr
