"""Slices of a study as a Slurm job array."""

import os
import re
import shlex
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from itertools import groupby
from math import ceil
from pathlib import Path

from drivers.base import paths
from drivers.base.errors import RunError
from drivers.batch.rows import CHUNK, Batch
from drivers.chain.case import Case
from drivers.engines import load_engine

MAX_ARRAY_SIZE = 1001  # Slurm's default
SECONDS_PER_TASK = 60.0  # shorter tasks are dominated by the scheduler
POLL_INTERVAL_S = 2.0
MAX_FAILURES = 30  # of squeue in a row
FOLDER = ".slurm"  # in the runs folder
LEAST_TIME_S = 600.0  # of a task: its start from a network file system may take minutes
LEAST_BYTES, BYTES_PER_VALUE = 1.5e9, 400.0  # memory of a worker and a code, and for each body and sample
OUTPUT = "{study}-{job}_{task}.txt"

SCRIPT = """\
#!/bin/bash -l
# {count} of {study} on {engines}; may be submitted again at any time: finished cases are not run again
#SBATCH --job-name={name}
#SBATCH --array={array}
#SBATCH --output={output}
#SBATCH --time={minutes}
#SBATCH --mem={megabytes}M
{options}set -e
export PATH={path}"$PATH"
{lines}export {variable}={entries}
cd {root}
exec {command} --slice "$SLURM_ARRAY_TASK_ID/{parts}"
"""


def parts_for(cases: int, expected_s: float | None) -> int:
    """Number of tasks for a number of cases with an expected total time."""
    wanted = ceil(cases / CHUNK) if expected_s is None else ceil(expected_s / SECONDS_PER_TASK)
    return max(1, min(wanted, cases))


def most_tasks() -> int:
    """Largest number of tasks that this site allows in a job array; Slurm's default if ``scontrol`` does not say."""
    size = re.search(r"^MaxArraySize\s*=\s*(\d+)", subprocess.getoutput("scontrol show config"), re.MULTILINE)
    return max(1, (int(size[1]) if size else MAX_ARRAY_SIZE) - 1)  # indices begin at 0, tasks at 1


def memory_bytes(case: Case) -> float:
    """Memory of a worker that runs a case and compares it with its scheme and the exact motion."""
    return LEAST_BYTES + BYTES_PER_VALUE * case.chain.bodies * case.scene.samples


def job_script(
    batch: Batch, todo: list[int], parts: int, lines: Sequence[str], limit_s: float, memory: float
) -> tuple[Path, str, int]:
    """File and text of the script of a job array for the slices with unfinished cases, and the number of its tasks.

    ``lines`` are inserted before its command, those with #SBATCH before all commands, as Slurm requires; they replace
    the time limit ``limit_s`` in s of a task and its ``memory`` in bytes. The folders of the programs
    of engines that are installed here are added to the PATH of the login profile.
    """
    request, study = batch.request, batch.study
    command = [str(Path(sys.executable).with_name("beads")), "batch", str(study.path)]
    command += ["--runs", str(request.runs.resolve())]
    command += [word for name in batch.engines for word in ("--engine", name)]
    command += [word for pattern in request.patterns for word in ("--only", pattern)]
    command += ["--retry"] if request.retry else []
    folder = (request.runs / FOLDER).resolve()
    codes = [name for name in batch.here if not load_engine(name).in_repository]
    programs = [word for name in codes for word in batch.builds[name].command if "/" in word]
    unfinished = set(todo)
    slices = [part for part in range(1, parts + 1) if not unfinished.isdisjoint(batch.slice_of(part, parts))]
    text = SCRIPT.format(
        count=f"{len(todo)} case{'s' * (len(todo) > 1)}",
        study=study.where,
        engines=", ".join(batch.engines),
        name=shlex.quote(f"beads-{study.name}"),
        array=_ranges(slices),
        output=shlex.quote(str(folder / OUTPUT.format(study=study.name, job="%A", task="%a"))),
        options="".join(f"{line}\n" for line in lines if line.startswith("#SBATCH")),
        path="".join(f"{shlex.quote(folder)}:" for folder in dict.fromkeys(str(Path(p).parent) for p in programs)),
        minutes=ceil(max(limit_s, LEAST_TIME_S) / 60),
        megabytes=ceil(memory / 1e8) * 100,
        lines="".join(f"{line}\n" for line in lines if not line.startswith("#SBATCH")),
        variable=paths.ENGINES_VARIABLE,
        entries=shlex.quote(os.pathsep.join(map(str, request.entries))),
        root=shlex.quote(str(paths.ROOT)),
        command=shlex.join(command),
        parts=parts,
    )
    return folder / f"{study.name}.sh", text, len(slices)


def submit(path: Path, text: str) -> str:
    """Write the script of a job array below the runs folder, submit it, and return the job's number.

    Raises:
        RunError: sbatch refused the script.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text)
    done = subprocess.run(["sbatch", "--parsable", str(path)], capture_output=True, text=True, check=False)
    if done.returncode != 0:
        raise RunError(f"sbatch refused {paths.shown(path)}: {done.stderr.strip() or done.stdout.strip()}")
    job = done.stdout.strip().partition(";")[0]
    output = path.with_name(OUTPUT.format(study=path.stem, job=job, task="*"))
    print(f"job {job}: {paths.shown(path)}, output in {paths.shown(output)}", flush=True)
    return job


def waiting_for(job: str) -> Iterator[None]:
    """Yield repeatedly until all tasks of a Slurm job have ended.

    Raises:
        RunError: squeue does not answer.
    """
    command = ["squeue", "--noheader", "--jobs", job, "--format=%T"]
    failures = 0
    while failures < MAX_FAILURES:
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        if (done.returncode == 0 and not done.stdout.strip()) or "Invalid job id" in done.stderr:
            return  # ended; Slurm may have forgotten the job
        failures = failures + 1 if done.returncode else 0
        time.sleep(POLL_INTERVAL_S)
        yield
    raise RunError(f"job {job}: squeue does not answer: {done.stderr.strip()}")


def _ranges(numbers: list[int]) -> str:
    """Numbers in Slurm's format, such as ``1-4,7,9-10``."""
    runs = [[number for _, number in run] for _, run in groupby(enumerate(numbers), lambda pair: pair[1] - pair[0])]
    return ",".join(f"{run[0]}-{run[-1]}" if len(run) > 1 else str(run[0]) for run in runs)
