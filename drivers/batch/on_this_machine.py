"""Workers on this machine: processes that live as long as the batch."""

import multiprocessing
import os
import signal
import threading
import time
from collections.abc import Iterator, Sequence
from concurrent.futures import Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from multiprocessing import connection, forkserver
from pathlib import Path
from typing import Any

from drivers.base.errors import RunError
from drivers.batch.store import Store
from drivers.batch.study_cases import Setup, Steps, StudyPlan, facts_of, plan_of
from drivers.batch.worker import CHUNK, run_cases

POLL_S = 0.2
RETRY_S = 2.0  # between looks at what another batch is at work on
EXIT_LIMIT_S = 10.0  # for workers that are asked to end
MAX_DEATHS = 3  # of workers in a row, without a row done
PLAN_CHUNK = 250
MANY_TO_PLAN = 500  # cases; from here on, workers share the planning

_work: tuple[Setup, Store, Any]  # of a worker process; the last: how many numbers all workers have taken up


def get_ready(steps: Steps) -> multiprocessing.context.ForkServerContext:
    """Starts what workers are forked from, with all that they need loaded, without waiting for it."""
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload([run_cases.__module__, steps.plan.partition(":")[0], *steps.observing])
    forkserver.ensure_running()
    return context


@contextmanager
def worker_pool(workers: int, setup: Setup, store: Store) -> Iterator[ProcessPoolExecutor]:
    """Worker processes for a study; whatever happens here, they end with it."""
    context = get_ready(setup.steps)
    pool = ProcessPoolExecutor(workers, context, _begin, (setup, store.runs, context.Value("q", 0)))
    try:
        yield pool
    except BaseException:
        processes = multiprocessing.active_children()
        for process in processes:
            process.terminate()
        for process in processes:
            process.join(EXIT_LIMIT_S)
        # only now: a worker that is stopped while it reads the pool's farewell leaves half of it to the next
        pool.shutdown(wait=False, cancel_futures=True)
        raise
    pool.shutdown()


def plan_side_by_side(setup: Setup, store: Store, workers: int) -> StudyPlan:
    """The plan of the whole study, which validates every case.

    Raises:
        InputError: one of the cases makes no scene, or none that can end well.
    """
    from tqdm import tqdm

    numbers = range(1, setup.study.count + 1)
    if len(numbers) < MANY_TO_PLAN or workers == 1:
        return plan_of(setup, (facts_of(setup, number) for number in numbers))
    with worker_pool(workers, setup, store) as pool:
        facts = pool.map(_facts, numbers, chunksize=PLAN_CHUNK)
        bar = tqdm(facts, total=len(numbers), unit="case", desc="validating", leave=False, disable=None)
        return plan_of(setup, bar)


def run_locally(
    setup: Setup, numbers: Sequence[int], engines: Sequence[str], store: Store, workers: int, retry_before: float
) -> Iterator[None]:
    """Runs cases side by side, and yields now and then until all are through.

    Raises:
        RunError: workers die again and again.
        OSError: the disk is full, or something else is wrong with the runs folder.
    """
    deaths = 0
    while numbers:
        known = len(store.rows)
        try:
            with worker_pool(workers, setup, store) as pool:
                futures = [pool.submit(_run, numbers, workers, engines, retry_before) for _ in range(workers)]
                yield from waiting_for_all(futures)
            numbers = [number for future in futures for number in future.result()]
            if numbers:  # another batch is at work on them
                time.sleep(RETRY_S)
        except BrokenProcessPool as error:
            store.refresh()
            deaths = 0 if len(store.rows) > known else deaths + 1
            if deaths == MAX_DEATHS:
                raise RunError(f"workers were killed {deaths} times; what is done is kept") from error


def waiting_for_all(futures: list[Future[Any]]) -> Iterator[None]:
    """Yields until all are through; the first error ends it."""
    waiting = set(futures)
    while waiting:
        ended, waiting = wait(waiting, POLL_S)
        for future in ended:
            future.result()
        yield


def _begin(setup: Setup, runs: Path, taken: Any) -> None:
    """A worker's first act: it leaves Ctrl-C to the batch, ends in order when asked to, and never outlives it."""
    global _work
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, _end)
    parent = multiprocessing.parent_process()
    if parent is not None:
        threading.Thread(target=_end_with, args=(parent.sentinel,), daemon=True).start()
    _work = setup, Store(runs), taken


def _end_with(sentinel: int) -> None:
    """Ends this worker, and so its engines, when the batch has died without a word."""
    connection.wait([sentinel])
    os.kill(os.getpid(), signal.SIGKILL)


def _end(*_: object) -> None:
    """Leaves what is under way, so that its engines are ended and its rows kept."""
    raise SystemExit


def _run(numbers: Sequence[int], workers: int, engines: Sequence[str], retry_before: float) -> list[int]:
    """Takes up chunk after chunk of the numbers that all workers share; those left to another batch."""
    setup, store, taken = _work
    try:
        return run_cases(setup, _chunks(numbers, workers, taken), engines, store, retry_before)
    except SystemExit:
        os._exit(1)  # everything is closed: the pool must not hand out more, nor say a word


def _chunks(numbers: Sequence[int], workers: int, taken: Any) -> Iterator[Sequence[int]]:
    """Chunks that get smaller towards the end, so that all workers end at about the same time."""
    while True:
        with taken.get_lock():
            start = taken.value
            size = max(1, min(CHUNK, (len(numbers) - start) // (4 * workers)))
            taken.value = start + size
        if start >= len(numbers):
            return
        yield numbers[start : start + size]


def _facts(number: int) -> tuple[list[str], int, list[Any]]:
    return facts_of(_work[0], number)
