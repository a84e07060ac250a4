"""Slices of a study on a Dask cluster, through the executor interface of ``distributed``."""

import math
import signal
from collections.abc import Iterator
from concurrent.futures import CancelledError, wait
from contextlib import ExitStack
from typing import Any

from drivers.base.errors import InputError, RunError
from drivers.batch.study import Selection
from drivers.batch.study_cases import Request
from drivers.batch.worker import CHUNK, run_slice

LOCAL = "local"
CONNECT_S = 5
POLL_S = 0.2
SLICES_PER_THREAD = 4  # so that a slow slice does not keep the others waiting
RETRIES = 3  # of a slice of which the worker died


def run_on_dask(address: str, request: Request, selection: Selection, todo: list[int], workers: int) -> Iterator[None]:
    """Runs the slices that have something to do, and yields now and then until all are through.

    Args:
        address: of a scheduler, or ``local`` for a cluster of ``workers`` processes that lives as long as this.
        request: the study, on a runs folder that all Dask workers have to see; its paths are absolute.
        selection: what is asked for of it.
        todo: numbers of the cases that are not done.
        workers: of a local cluster.

    Raises:
        InputError: ``distributed`` is not installed, or no scheduler answers.
        RunError: a slice failed as a whole.
    """
    try:
        from distributed import Client, LocalCluster
    except ImportError as error:
        raise InputError("--dask", "", "no distributed package", "an environment with it: make cluster") from error
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
            try:
                client = stack.enter_context(Client(address, timeout=CONNECT_S))
            except (OSError, ValueError) as error:
                allowed = "the address of a running scheduler, such as tcp://10.0.0.1:8786"
                raise InputError(f"--dask {address}", "", "nobody who answers", allowed) from error
        threads = max(1, sum(client.nthreads().values()))
        parts = max(SLICES_PER_THREAD * threads, math.ceil(len(selection.numbers) / CHUNK))
        executor = client.get_executor(pure=False, retries=RETRIES)
        stack.callback(executor.shutdown, wait=False)  # after an error or Ctrl-C nobody waits for the rest
        waiting = {executor.submit(run_slice, request, part, parts) for part in selection.slices_with_work(todo, parts)}
        while waiting:
            ended, waiting = wait(waiting, POLL_S)
            for future in ended:
                _raise_error_of(future)
            yield


def _raise_error_of(future: Any) -> None:
    try:
        error = future.exception()
    except CancelledError as lost:
        raise RunError("the cluster was lost; what is done is kept") from lost
    if isinstance(error, (InputError, RunError, OSError)):
        raise error
    if error is not None:
        raise RunError(f"a slice failed on the cluster: {type(error).__name__}: {error}") from error
