"""Slices of a study as a Slurm job array."""

import math
import shlex
import shutil
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

from drivers.base import paths
from drivers.base.errors import InputError, RunError
from drivers.batch.store import Store
from drivers.batch.study import Selection, Study
from drivers.batch.worker import CHUNK

MAX_TASKS = 1000  # Slurm's own limit of an array, unless its administrator raised it
SECONDS_PER_TASK = 60.0  # a shorter one is not worth the scheduler's trouble
POLL_S = 2.0
MAX_FAILURES = 30  # of squeue, in a row
FOLDER = ".slurm"

SCRIPT = """\
#!/bin/sh
# {count} of {study} on {engines}; submit again at any time: what is done is not run again
#SBATCH --job-name={name}
#SBATCH --array={array}
#SBATCH --output={output}
cd {root} || exit 1
exec {command} --slice "$SLURM_ARRAY_TASK_ID/{parts}"
"""


def parts_for(cases: int, expected_s: float | None) -> int:
    """Into how many tasks to deal cases that will take so long altogether."""
    wanted = math.ceil(cases / CHUNK) if expected_s is None else math.ceil(expected_s / SECONDS_PER_TASK)
    return max(1, min(wanted, cases, MAX_TASKS))


def write_script(study: Study, selection: Selection, todo: list[int], store: Store, parts: int, *, retry: bool) -> Path:
    """The job array's script, below the runs folder, with the tasks that have something to do."""
    command = [sys.executable, "-m", "drivers", "batch", str(study.path), "--runs", str(store.runs.resolve())]
    command += [word for name in selection.engines for word in ("--engine", name)]
    command += [word for pattern in selection.patterns for word in ("--only", pattern)]
    command += ["--retry"] if retry else []
    folder = (store.folder / FOLDER).resolve()
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / f"{study.name}.sh"
    path.write_text(
        SCRIPT.format(
            count=f"{len(todo)} case{'s' * (len(todo) > 1)}",
            study=study.where,
            engines=", ".join(selection.engines),
            name=shlex.quote(f"beads-{study.name}"),
            array=_ranges(selection.slices_with_work(todo, parts)),
            output=shlex.quote(str(folder / f"{study.name}-%A_%a.txt")),
            root=shlex.quote(str(paths.ROOT)),
            command=shlex.join(command),
            parts=parts,
        )
    )
    return path


def must_have_slurm() -> None:
    """Refuses to go on without Slurm.

    Raises:
        InputError: there is no ``sbatch``.
    """
    if shutil.which("sbatch") is None:
        raise InputError("--slurm", "", "no sbatch", "a machine that submits to Slurm")


def submit(script: Path) -> str:
    """Submits a script; the number of the job.

    Raises:
        RunError: Slurm refuses it.
    """
    done = subprocess.run(["sbatch", "--parsable", str(script)], capture_output=True, text=True, check=False)
    if done.returncode != 0:
        raise RunError(f"sbatch refused {paths.shown(script)}: {done.stderr.strip() or done.stdout.strip()}")
    return done.stdout.strip().partition(";")[0]


def waiting_for(job: str) -> Iterator[None]:
    """Yields now and then until Slurm has no task of the job any more.

    Raises:
        RunError: Slurm does not answer.
    """
    words = ["squeue", "--noheader", "--jobs", job, "--format=%T"]
    failures = 0
    while failures < MAX_FAILURES:
        done = subprocess.run(words, capture_output=True, text=True, check=False)
        if done.returncode == 0:
            failures = 0
            if not done.stdout.strip():
                return
        elif "Invalid job id" in done.stderr:
            return  # ended so long ago that Slurm forgot it
        else:
            failures += 1
        time.sleep(POLL_S)
        yield
    raise RunError(f"job {job}: squeue does not answer: {done.stderr.strip()}")


def _ranges(numbers: list[int]) -> str:
    """Numbers as Slurm lists them: ``1-4,7,9-10``."""
    runs: list[list[int]] = []
    for number in numbers:
        if runs and number == runs[-1][-1] + 1:
            runs[-1][1:] = [number]
        else:
            runs.append([number])
    return ",".join("-".join(map(str, run)) for run in runs)
