"""Slices of a study on a Dask cluster or as a Slurm job array."""

import math
import os
import shlex
import signal
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from concurrent.futures import CancelledError
from contextlib import ExitStack
from dataclasses import dataclass
from itertools import groupby
from pathlib import Path
from typing import Any

from drivers.base import paths
from drivers.base.errors import InputError, RunError
from drivers.batch.store import Store
from drivers.batch.study import Selection, Study
from drivers.batch.study_cases import Request
from drivers.batch.worker import CHUNK, run_slice, waiting_for_all

LOCAL = "local"  # instead of an address: a Dask cluster on this machine
CONNECT_LIMIT_S = 5
SLICES_PER_THREAD = 4  # several, to balance the load
RETRIES = 3  # of a slice whose worker died
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


def check_dask(address: str) -> None:
    """Check that a Dask cluster is available.

    Raises:
        InputError: ``distributed`` is not installed, or no scheduler answers.
    """
    try:
        from distributed import Client
    except ImportError as error:
        raise InputError("--dask", "", "the package distributed is not installed; make cluster installs it") from error
    try:
        if address != LOCAL:
            Client(address, timeout=CONNECT_LIMIT_S).close()
    except (OSError, ValueError) as error:
        problem = "no scheduler answers; give the address of a running one, such as tcp://10.0.0.1:8786"
        raise InputError(f"--dask {address}", "", problem) from error


def run_on_dask(address: str, request: Request, selection: Selection, todo: list[int], workers: int) -> Iterator[None]:
    """Run the slices with unfinished cases; yields repeatedly until all have ended.

    ``address`` is the address of a scheduler, or ``local`` for a temporary cluster of ``workers`` processes. All Dask
    workers need access to the runs folder, whose path is absolute.

    Raises:
        RunError: a slice failed as a whole.
    """
    from distributed import Client, LocalCluster

    with ExitStack() as stack:
        client: Any
        if address == LOCAL:
            former = signal.signal(signal.SIGINT, signal.SIG_IGN)  # its processes must ignore Ctrl-C
            cluster = stack.enter_context(
                LocalCluster(n_workers=workers, threads_per_worker=1, dashboard_address=None, silence_logs=50)
            )
            signal.signal(signal.SIGINT, former)
            client = stack.enter_context(Client(cluster))
        else:
            client = stack.enter_context(Client(address, timeout=CONNECT_LIMIT_S))
        threads = max(1, sum(client.nthreads().values()))
        parts = max(SLICES_PER_THREAD * threads, math.ceil(len(selection.numbers) / CHUNK))
        executor = client.get_executor(pure=False, retries=RETRIES)
        stack.callback(executor.shutdown, wait=False)  # does not wait after an error or Ctrl-C
        futures = [executor.submit(run_slice, request, part, parts) for part in selection.slices_with_work(todo, parts)]
        try:
            yield from waiting_for_all(futures)
        except CancelledError as lost:
            raise RunError("the connection to the cluster was lost; finished rows are kept") from lost
        except (InputError, RunError, OSError):
            raise
        except Exception as error:
            raise RunError(f"a slice failed on the cluster: {type(error).__name__}: {error}") from error


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


def job_script(
    request: Request,
    study: Study,
    selection: Selection,
    todo: list[int],
    store: Store,
    parts: int,
    lines: Sequence[str],
) -> JobScript:
    """Script of a job array for the slices with unfinished cases.

    ``lines`` are inserted before its command, lines with #SBATCH first.
    """
    command = [sys.executable, "-m", "drivers", "batch", str(study.path), "--runs", str(store.runs.resolve())]
    command += [word for name in selection.engines for word in ("--engine", name)]
    command += [word for pattern in request.patterns for word in ("--only", pattern)]
    command += ["--retry"] if request.retry_before else []
    entries = shlex.quote(os.pathsep.join(map(str, request.entries)))
    lines = [
        *sorted(lines, key=lambda line: not line.startswith("#SBATCH")),
        f"export {paths.ENGINES_VARIABLE}={entries}",
    ]
    folder = (store.folder / FOLDER).resolve()
    slices = selection.slices_with_work(todo, parts)
    return JobScript(
        folder / f"{study.name}.sh",
        SCRIPT.format(
            count=f"{len(todo)} case{'s' * (len(todo) > 1)}",
            study=study.where,
            engines=", ".join(selection.engines),
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
