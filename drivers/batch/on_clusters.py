"""Slices of a study on a Dask cluster, through the executor of ``distributed``, or as a Slurm job array."""

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
from itertools import groupby
from typing import Any

from drivers.base import paths
from drivers.base.errors import InputError, RunError
from drivers.batch.store import Store
from drivers.batch.study import Selection, Study
from drivers.batch.study_cases import Request
from drivers.batch.worker import CHUNK, run_slice, waiting_for_all

LOCAL = "local"  # a Dask cluster of one's own
CONNECT_S = 5
SLICES_PER_THREAD = 4  # so that a slow slice does not keep the others waiting
RETRIES = 3  # of a slice of which the worker died
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
{lines}
cd {root} || exit 1
exec {command} --slice "$SLURM_ARRAY_TASK_ID/{parts}"
"""


def check_dask(address: str) -> None:
    """Refuses a cluster that cannot be had, before anything is written.

    Raises:
        InputError: ``distributed`` is not installed, or no scheduler answers.
    """
    try:
        from distributed import Client
    except ImportError as error:
        raise InputError("--dask", "", "no distributed package", "an environment with it: make cluster") from error
    try:
        if address != LOCAL:
            Client(address, timeout=CONNECT_S).close()
    except (OSError, ValueError) as error:
        allowed = "the address of a running scheduler, such as tcp://10.0.0.1:8786"
        raise InputError(f"--dask {address}", "", "nobody who answers", allowed) from error


def run_on_dask(address: str, request: Request, selection: Selection, todo: list[int], workers: int) -> Iterator[None]:
    """Runs the slices that have something to do, and yields now and then until all are through.

    The address is of a scheduler, or ``local`` for a cluster of ``workers`` processes that lives as long as this. All
    Dask workers have to see the request's runs folder; its paths are absolute.

    Raises:
        RunError: a slice failed as a whole.
    """
    from distributed import Client, LocalCluster

    with ExitStack() as stack:
        client: Any
        if address == LOCAL:
            former = signal.signal(signal.SIGINT, signal.SIG_IGN)  # its processes leave Ctrl-C to this one
            cluster = stack.enter_context(
                LocalCluster(n_workers=workers, threads_per_worker=1, dashboard_address=None, silence_logs=50)
            )
            signal.signal(signal.SIGINT, former)
            client = stack.enter_context(Client(cluster))
        else:
            client = stack.enter_context(Client(address, timeout=CONNECT_S))
        threads = max(1, sum(client.nthreads().values()))
        parts = max(SLICES_PER_THREAD * threads, math.ceil(len(selection.numbers) / CHUNK))
        executor = client.get_executor(pure=False, retries=RETRIES)
        stack.callback(executor.shutdown, wait=False)  # after an error or Ctrl-C nobody waits for the rest
        futures = [executor.submit(run_slice, request, part, parts) for part in selection.slices_with_work(todo, parts)]
        try:
            yield from waiting_for_all(futures)
        except CancelledError as lost:
            raise RunError("the cluster was lost; what is done is kept") from lost
        except (InputError, RunError, OSError):
            raise
        except Exception as error:
            raise RunError(f"a slice failed on the cluster: {type(error).__name__}: {error}") from error


def parts_for(cases: int, expected_s: float | None) -> int:
    """Into how many tasks to deal cases that will take so long altogether."""
    wanted = math.ceil(cases / CHUNK) if expected_s is None else math.ceil(expected_s / SECONDS_PER_TASK)
    return max(1, min(wanted, cases, MAX_TASKS))


def submit(
    request: Request,
    study: Study,
    selection: Selection,
    todo: list[int],
    store: Store,
    parts: int,
    lines: Sequence[str],
) -> str:
    """Submits a job array, its script below the runs folder, of the tasks with something to do; the job's number.

    ``lines`` come before the script's command, those for Slurm first.

    Raises:
        RunError: Slurm refuses it.
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
            lines="\n".join(lines),
            root=shlex.quote(str(paths.ROOT)),
            command=shlex.join(command),
            parts=parts,
        )
    )
    done = subprocess.run(["sbatch", "--parsable", str(path)], capture_output=True, text=True, check=False)
    if done.returncode != 0:
        raise RunError(f"sbatch refused {paths.shown(path)}: {done.stderr.strip() or done.stdout.strip()}")
    job = done.stdout.strip().partition(";")[0]
    print(f"job {job}: {paths.shown(path)}", flush=True)
    return job


def waiting_for(job: str) -> Iterator[None]:
    """Yields now and then until Slurm has no task of the job any more.

    Raises:
        RunError: Slurm does not answer.
    """
    words = ["squeue", "--noheader", "--jobs", job, "--format=%T"]
    failures = 0
    while failures < MAX_FAILURES:
        done = subprocess.run(words, capture_output=True, text=True, check=False)
        if (done.returncode == 0 and not done.stdout.strip()) or "Invalid job id" in done.stderr:
            return  # through, or so long ago that Slurm forgot it
        failures = failures + 1 if done.returncode else 0
        time.sleep(POLL_S)
        yield
    raise RunError(f"job {job}: squeue does not answer: {done.stderr.strip()}")


def _ranges(numbers: list[int]) -> str:
    """Numbers as Slurm lists them: ``1-4,7,9-10``."""
    runs = [[number for _, number in run] for _, run in groupby(enumerate(numbers), lambda each: each[1] - each[0])]
    return ",".join(f"{run[0]}-{run[-1]}" if len(run) > 1 else str(run[0]) for run in runs)
