"""Tests of studies on engines that are not installed on the submitting machine; Slurm is replaced by scripts."""

import json
import os
import subprocess
from dataclasses import replace
from pathlib import Path

import pandas as pd
import pytest

from drivers.base import paths
from drivers.batch.job_array import most_tasks
from drivers.batch.store import Store, StudyRow, _name_of
from drivers.batch.study_cases import opened
from drivers.engines import load_engine
from drivers.run.build import build_of
from validation.commands.batch_commands import request_of
from validation.tests.helpers.commands import beads, beads_process
from validation.tests.helpers.scenes import SPEEDS, EnginesWriter, StandIn, StudyWriter

LOAD = ("--slurm-line", "module load dem")


def batch(study: Path, runs: Path, *words: str | Path) -> subprocess.CompletedProcess[str]:
    return beads("batch", study, "--runs", runs, "--results", runs.parent / f"{runs.name}-results", *words)


def table(runs: Path) -> pd.DataFrame:
    return pd.read_parquet(runs.parent / f"{runs.name}-results" / "study.parquet")


def status(study: Path, runs: Path) -> str:
    done = beads("status", study, "--runs", runs)
    assert done.returncode == 0, done.stderr
    return done.stdout


def run_with_module(study: Path, runs: Path, folder: Path, *words: str) -> subprocess.CompletedProcess[str]:
    """Run the rows of a study as its job does, where the engine exists."""
    path = f"{folder}:{os.environ['PATH']}"
    return beads_process("batch", study, "--runs", runs, "--slice", "1/1", *words, PATH=path)


@pytest.fixture
def slurm(stand_in: StandIn) -> None:
    """Commands of Slurm that run the first task of an array immediately, as job 7."""
    run = '$(head -n 1 "$2" | cut -c 3-) "$2" >"$(dirname "$2")/study-7_1.txt" 2>&1'  # by the program of its first line
    stand_in("sbatch", f"SLURM_ARRAY_TASK_ID=1 {run}\necho 7\n")
    stand_in("squeue", "exit 0\n")
    stand_in("scontrol", "exit 1\n")


@pytest.fixture
def study(study_file: StudyWriter, modules: Path) -> Path:
    """A study of two cases on an installed engine and on one that exists in the job alone."""
    return study_file(SPEEDS.format(2), "verlet", "by-module")


@pytest.mark.usefixtures("slurm")
def test_an_engine_may_exist_in_the_job_alone(study: Path, modules: Path, tmp_path: Path) -> None:
    runs, here = tmp_path / "runs", tmp_path / "here"
    done = batch(study, runs, "--slurm", "--wait", *LOAD)
    assert (done.returncode, done.stderr) == (0, "")
    assert "not installed here, assumed to exist in the job: by-module\n" in done.stdout
    assert done.stdout.endswith("4 of 4 rows done\n")
    assert batch(study, runs).returncode == 0  # without the engine the rows of the job still count
    again = batch(study, runs, "--slurm", "--wait", *LOAD)
    assert (again.returncode, "job 7" in again.stdout) == (0, False)
    words = ("batch", study, "--runs", here, "--results", tmp_path / "here-results")
    assert beads_process(*words, PATH=f"{modules}:{os.environ['PATH']}").returncode == 0
    pd.testing.assert_frame_equal(table(runs), table(here), check_exact=True)
    assert {row.identity for row in Store(runs).refresh()} == {row.identity for row in Store(here).refresh()}


@pytest.mark.usefixtures("slurm")
@pytest.mark.parametrize("lines", [("--slurm-line", "module load typo"), ()], ids=["failing", "none"])
def test_a_job_without_its_module_leaves_the_rows_to_do(lines: tuple[str, ...], study: Path, tmp_path: Path) -> None:
    runs = tmp_path / "runs"
    done = batch(study, runs, "--slurm", "--wait", *lines)
    assert done.returncode == 1
    said = (runs / "batch" / ".slurm" / "study-7_1.txt").read_text()
    if lines:
        assert said == "module: typo not found\n"
        assert "verlet     2 to do\nby-module  2 to do\n" in done.stdout
    else:
        assert "by-module: not installed; it comes with module load dem (looked for lmp-of-module of " in said
        assert "verlet     2 done\nby-module  2 to do\n" in done.stdout
    assert "output in " in done.stdout
    assert batch(study, runs, "--slurm", "--wait", *LOAD).returncode == 0


def test_a_slice_without_its_engine_fails_and_runs_the_others(study: Path, tmp_path: Path) -> None:
    runs = tmp_path / "runs"
    done = batch(study, runs, "--slice", "1/1")
    assert (done.returncode, done.stdout) == (1, "slice 1/1: 2 rows done, 0 failed\n")
    assert done.stderr.startswith("by-module: not installed; it comes with module load dem ")
    assert status(study, runs) == "verlet     2 done\nby-module  2 not installed\n"
    chosen = batch(study, runs, "--slice", "1/1", "--engine", "verlet")
    assert (chosen.returncode, chosen.stderr) == (0, "")


def test_rows_of_an_older_deck_are_stale_without_the_engine(study: Path, modules: Path, tmp_path: Path) -> None:
    runs = tmp_path / "runs"
    assert run_with_module(study, runs, modules, "--only", "striker.speed=0.5*").returncode == 0
    assert status(study, runs) == "verlet     1 done, 1 to do\nby-module  1 done, 1 not installed\n"
    assert run_with_module(study, runs, modules).returncode == 0
    study.write_text(f'set = {{ "chain.count" = 4 }}\n{study.read_text()}')
    assert status(study, runs) == "verlet     2 stale\nby-module  2 stale\n"
    planned = batch(study, runs, "--slurm", "--dry-run").stdout
    assert "verlet     0 done, 2 to do" in planned
    assert "by-module  0 done, 2 to do" in planned
    assert "by-module  0 done, 2 not installed" in batch(study, runs, "--dry-run").stdout


def test_the_build_is_that_of_the_newest_row_done(
    study: Path, modules: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A failed row of a broken build hides no row done; a changed command has no rows."""
    runs = tmp_path / "runs"
    assert run_with_module(study, runs, modules).returncode == 0
    with monkeypatch.context() as loaded:
        loaded.setenv("PATH", f"{modules}:{os.environ['PATH']}")
        installed = build_of(load_engine("by-module"))
    done = max((row for row in Store(runs).refresh() if row.engine == "by-module"), key=lambda row: row.ended)
    assert done.build == installed.identity
    broken = replace(done, identity="b", status="failed", build=done.build.replace(installed.version, "broken"))
    put(runs, replace(broken, ended=done.ended + 1))
    assert opened(request_of(study, runs)).builds["by-module"].identity == installed.identity
    put(runs, replace(broken, identity="n", status="done", ended=done.ended + 2))
    assert opened(request_of(study, runs)).builds["by-module"].version == "broken"
    other = tmp_path / "other-engines.toml"
    other.write_text('[by-module]\nadapter = "lammps"\ncommand = "lmp-of-module -log none"\n')
    monkeypatch.setenv(paths.ENGINES_VARIABLE, str(other))
    assert opened(request_of(study, runs)).builds["by-module"].version == "unknown"


def test_rows_stored_without_a_build_still_count(study: Path, modules: Path, tmp_path: Path) -> None:
    runs = tmp_path / "runs"
    assert run_with_module(study, runs, modules).returncode == 0
    rows = [vars(row) for row in Store(runs).refresh()]
    for file in (runs / "batch").glob("*.jsonl"):
        file.unlink()
    put(runs, *({key: value for key, value in row.items() if key != "build"} for row in rows))
    done = beads("status", study, "--runs", runs)
    assert (done.stdout, done.stderr) == ("verlet     2 done\nby-module  2 stale\n", "")


def put(runs: Path, *rows: StudyRow | dict[str, object]) -> None:
    """Store rows."""
    texts = (json.dumps(row if isinstance(row, dict) else vars(row)) for row in rows)
    content = "".join(f"{text}\n" for text in texts).encode()
    (runs / "batch" / _name_of(content)).write_bytes(content)


@pytest.mark.usefixtures("slurm")
def test_failed_rows_of_a_job_are_run_again(study: Path, modules: Path, tmp_path: Path) -> None:
    runs, program = tmp_path / "runs", modules / "lmp-of-module"
    works = program.read_text()
    program.write_text(works.replace("exec", 'case "$*" in *-in*) exit 3 ;; esac\nexec'))
    done = batch(study, runs, "--slurm", "--wait", *LOAD)
    assert done.returncode == 1
    assert "by-module  2 failed\n" in done.stdout
    assert "2 failed; --retry runs them again" in done.stderr
    assert "job 7" not in batch(study, runs, "--slurm", "--wait", *LOAD).stdout
    program.write_text(works)
    again = batch(study, runs, "--slurm", "--wait", "--retry", *LOAD)
    assert (again.returncode, again.stderr) == (0, "")


def test_the_script_and_the_site_s_limit_of_arrays(
    study_file: StudyWriter, tmp_path: Path, stand_in: StandIn, monkeypatch: pytest.MonkeyPatch
) -> None:
    study, runs = study_file(SPEEDS.format(9), "verlet"), tmp_path / "runs"
    stand_in("scontrol", 'test "$*" = "show config" && echo "MaxArraySize            = 5"\n')
    words = ("--slurm", "--dry-run", "--slurm-line", "module load dem", "--slurm-line", "#SBATCH --mem=2G")
    planned = batch(study, runs, *words, "--slices", "8").stdout
    assert "8 tasks cut to 4, the limit of job arrays here (MaxArraySize)\n" in planned
    lines = planned[planned.index("#!") :].splitlines()
    assert lines[0] == "#!/bin/bash -l"
    assert "#SBATCH --array=1-4" in lines
    commands = [line for line in lines[1:] if not line.startswith("#")]
    assert commands[0] == "set -e"
    assert "module load dem" in commands
    assert lines.index("#SBATCH --mem=2G") < lines.index("set -e")
    assert batch(study, runs).returncode == 0
    again = batch(study, runs, *words, "--slices", "3").stdout
    assert "#SBATCH --array=1-3\n" in again
    assert again.endswith("; all rows are done, so without --dry-run it is not submitted\n")
    stand_in("scontrol", "exit 1\n")
    assert most_tasks() == 1000
    monkeypatch.setenv("PATH", "/nowhere")
    assert most_tasks() == 1000


@pytest.mark.usefixtures("slurm")
def test_a_program_found_here_is_found_in_the_job(
    study_file: StudyWriter, modules: Path, tmp_path: Path, stand_in: StandIn, engines_file: EnginesWriter
) -> None:
    """Login profiles may replace PATH."""
    (tmp_path / "home" / ".bash_profile").write_text("PATH=/usr/bin:/bin\n")
    stand_in("lmp-here", 'exec lmp "$@"\n')
    engines_file('[here]\nadapter = "lammps"\ncommand = "lmp-here"\n')
    done = batch(study_file(SPEEDS.format(2), "here"), tmp_path / "runs", "--slurm", "--wait")
    assert (done.returncode, "assumed" in done.stdout) == (0, False), done.stderr


def test_an_engine_of_the_job_refuses_cases_before_the_job(modules: Path, tmp_path: Path) -> None:
    study = tmp_path / "study.toml"
    study.write_text('scene = "fig4-tube"\nengines = ["verlet", "by-module"]\n')
    done = batch(study, tmp_path / "runs", "--slurm", "--dry-run")
    assert (done.returncode, done.stderr.count("\n")) == (2, 1)
    assert 'found "by-module" for a scene with ' in done.stderr
