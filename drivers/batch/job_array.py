"""Slices of a study as a Slurm job array."""

import math
import os
import shlex
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import groupby
from pathlib import Path

from drivers.base import paths
from drivers.base.errors import RunError
from drivers.batch.study_cases import Batch
from drivers.batch.study_rows import CHUNK

MAX_TASKS = 1000  # Slurm's default limit of an array
SECONDS_PER_TASK = 60.0  # shorter tasks are dominated by the scheduler
POLL_INTERVAL_S = 2.0
MAX_FAILURES = 30  # of squeue in a row
FOLDER = ".slurm"

SCRIPT = """\
#!/bin/sh
# {count} of {study} on {engines}; may be submitted again at any time: finished cases are not run again
#SBATCH --job-name={name}
#SBATCH --array={array}
#SBATCH --output={output}
{lines}
cd {root} || exit 1
exec {command} --slice "$SLURM_ARRAY_TASK_ID/{parts}"
"""


def parts_for(cases: int, expected_s: float | None) -> int:
    """Number of tasks for a number of cases with an expected total time."""
    wanted = math.ceil(cases / CHUNK) if expected_s is None else math.ceil(expected_s / SECONDS_PER_TASK)
    return max(1, min(wanted, cases, MAX_TASKS))


@dataclass(frozen=True)
class JobScript:
    """Script of a Slurm job array: its file, its text and the number of its tasks."""

    path: Path
    text: str
    tasks: int


def job_script(batch: Batch, todo: list[int], parts: int, lines: Sequence[str]) -> JobScript:
    """Script of a job array for the slices with unfinished cases.

    ``lines`` are inserted before its command, lines with #SBATCH first.
    """
    request, study = batch.request, batch.study
    command = [str(Path(sys.executable).with_name("beads")), "batch", str(study.path)]
    command += ["--runs", str(batch.store.runs.resolve())]
    command += [word for name in batch.engines for word in ("--engine", name)]
    command += [word for pattern in request.patterns for word in ("--only", pattern)]
    command += ["--retry"] if request.retry else []
    entries = shlex.quote(os.pathsep.join(map(str, request.entries)))
    lines = [
        *sorted(lines, key=lambda line: not line.startswith("#SBATCH")),
        f"export {paths.ENGINES_VARIABLE}={entries}",
    ]
    folder = (batch.store.folder / FOLDER).resolve()
    unfinished = set(todo)
    slices = [part for part in range(1, parts + 1) if not unfinished.isdisjoint(batch.slice_of(part, parts))]
    return JobScript(
        folder / f"{study.name}.sh",
        SCRIPT.format(
            count=f"{len(todo)} case{'s' * (len(todo) > 1)}",
            study=study.where,
            engines=", ".join(batch.engines),
            name=shlex.quote(f"beads-{study.name}"),
            array=_ranges(slices),
            output=shlex.quote(str(folder / f"{study.name}-%A_%a.txt")),
            lines="\n".join(lines),
            root=shlex.quote(str(paths.ROOT)),
            command=shlex.join(command),
            parts=parts,
        ),
        len(slices),
    )


def submit(script: JobScript) -> str:
    """Write the script of a job array below the runs folder, submit it, and return the job's number.

    Raises:
        RunError: sbatch refused the script.
    """
    script.path.parent.mkdir(parents=True, exist_ok=True)
    script.path.write_text(script.text)
    done = subprocess.run(["sbatch", "--parsable", str(script.path)], capture_output=True, text=True, check=False)
    if done.returncode != 0:
        raise RunError(f"sbatch refused {paths.shown(script.path)}: {done.stderr.strip() or done.stdout.strip()}")
    job = done.stdout.strip().partition(";")[0]
    print(f"job {job}: {paths.shown(script.path)}", flush=True)
    return job


def waiting_for(job: str) -> Iterator[None]:
    """Yield repeatedly until all tasks of a Slurm job have ended.

    Raises:
        RunError: squeue does not answer.
    """
    words = ["squeue", "--noheader", "--jobs", job, "--format=%T"]
    failures = 0
    while failures < MAX_FAILURES:
        done = subprocess.run(words, capture_output=True, text=True, check=False)
        if (done.returncode == 0 and not done.stdout.strip()) or "Invalid job id" in done.stderr:
            return  # ended; Slurm may have forgotten the job
        failures = failures + 1 if done.returncode else 0
        time.sleep(POLL_INTERVAL_S)
        yield
    raise RunError(f"job {job}: squeue does not answer: {done.stderr.strip()}")


def _ranges(numbers: list[int]) -> str:
    """Numbers in Slurm's format, such as ``1-4,7,9-10``."""
    runs = [[number for _, number in run] for _, run in groupby(enumerate(numbers), lambda each: each[1] - each[0])]
    return ",".join(f"{run[0]}-{run[-1]}" if len(run) > 1 else str(run[0]) for run in runs)
