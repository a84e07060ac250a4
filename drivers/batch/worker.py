"""Workers: run cases of a study and store their rows; may be killed at any moment and run several times.

On this machine workers are processes that end with the batch.
"""

import multiprocessing
import os
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import Future, ProcessPoolExecutor, ThreadPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass, field
from functools import cache
from multiprocessing import connection, forkserver
from pathlib import Path
from tempfile import TemporaryFile
from typing import Any

from drivers.base.errors import RunError
from drivers.base.progress import following
from drivers.batch.store import WORK, Outbox, Store, StudyRow
from drivers.batch.study import read_study, select
from drivers.batch.study_cases import Request, Setup, Steps, StudyCase, StudyPlan, facts_of, plan_of, set_up
from drivers.chain.trace import Trace, digest_of
from drivers.engines import REFERENCE, load_engine
from drivers.engines._entries import use_entries
from drivers.run.guard import checked_trace
from drivers.run.run import default_limit_s
from drivers.run.session import Session, served_by
from drivers.run.workplaces import lease, workplace

CHUNK = 64  # largest number of cases in a chunk
PROBE_BYTES = 1 << 20
POLL_INTERVAL_S = 0.2
RETRY_INTERVAL_S = 2.0  # while another batch works on the remaining cases
EXIT_LIMIT_S = 10.0  # for workers that are asked to end
LIBRARIES = ("scipy.interpolate", "scipy.signal")  # imported once for all workers
WARNING_FILTER = "ignore:resource_tracker"  # after a kill, Python would warn of leaked semaphores
MAX_DEATHS = 5  # of workers in a row, without a finished row
PLAN_CHUNK = 25  # facts of so many cases fit into one write; a worker killed between two writes would block the batch
MIN_PARALLEL_CASES = 500  # from this number on, workers share the planning

_work: tuple[Setup, Store, Any]  # of a worker process; the last is the number of cases taken by all workers


class WorkersKilledError(RunError):
    """Workers or their fork server were killed from outside."""


@dataclass
class _Result:
    """Result of a case on one engine; ``cost`` is time in s by activity."""

    trace: Trace | None = None
    status: str = "done"
    reason: str = ""
    cost: dict[str, float | None] = field(default_factory=dict)


def run_cases(
    setup: Setup, chunks: Iterable[Sequence[int]], engines: Sequence[str], store: Store, retry_before: float = 0.0
) -> list[int]:
    """Run the unfinished rows of some cases of a study.

    The cases of a chunk are planned and leased together. Engines that are not installed are skipped. Failures that
    ended before ``retry_before`` are run again.

    Returns:
        Numbers of the cases with a row on which another process is working.

    Raises:
        OSError: the disk is full or the runs folder cannot be written to.
    """
    names = [name for name in engines if name in setup.builds]
    left: list[int] = []
    with (
        workplace(store.folder / WORK) as place,
        Outbox(store.folder, place) as box,
        _sessions(place) as session_of,
    ):
        runner = _Runner(setup, session_of)
        ran: set[str] = set()
        for numbers in chunks:
            cases = [setup.case(number) for number in numbers]
            store.refresh()
            asked = {each.identities[name] for each in cases for name in names}
            missing = {identity for identity in asked if to_run(store, identity, retry_before)}
            free = lease(place, missing) if missing else set()
            store.refresh()  # rows finished by others before the lease
            free = {identity for identity in free if to_run(store, identity, retry_before)}
            for each in cases:
                for name in each.wanted(free):  # all engines start in parallel
                    for engine in {name, REFERENCE} & set(each.runs):
                        with suppress(OSError):
                            session_of(engine).start()
            for each in cases:
                for name in each.wanted(free - ran):
                    box.add(runner.row(each, name))
                    ran.add(each.identities[name])
            box.flush()  # before the lease ends
            others = {each for each in missing - free - ran if to_run(store, each, retry_before)}
            left += [each.number for each in cases if others & set(each.identities.values())]
    return left


def to_run(store: Store, identity: str, retry_before: float) -> bool:
    """True if a row is missing, or is a failure to be run again."""
    row = store.rows.get(identity)
    return row is None or (not row.done and row.ended < retry_before)


def run_slice(request: Request, part: int, parts: int) -> list[StudyRow]:
    """Run the unfinished rows of part I of N of a study and return all rows of the part.

    Schedulers call this function. It may be called several times and killed at any moment. Every case of the part is
    validated first.

    Raises:
        InputError: the study or a case of the part is wrong.
        OSError: the disk is full or the runs folder cannot be written to.
    """
    if request.entries:
        use_entries(request.entries)
    study, store = read_study(request.source, request.engines), Store(request.runs)
    selection = select(study, request.engines, request.patterns)
    setup = set_up(study, selection.engines, request.runs, request.steps)
    left = list(selection.slice_of(part, parts))
    identities = [setup.case(number).identities for number in left]
    while left:
        chunks = [left[start : start + CHUNK] for start in range(0, len(left), CHUNK)]
        left = run_cases(setup, chunks, selection.engines, store, request.retry_before)
        if left:  # another process works on them
            time.sleep(POLL_INTERVAL_S)
    store.refresh()
    return [row for name in selection.engines for each in identities if (row := store.rows.get(each.get(name, "")))]


class _Runner:
    """Makes rows of cases; consecutive rows of a case share the run of the reference."""

    def __init__(self, setup: Setup, session_of: Callable[[str], Session]) -> None:
        self._setup = setup
        self._session_of = session_of
        self._exact: dict[str, _Result] = {}

    def row(self, case: StudyCase, name: str) -> StudyRow:
        """Row of a case on an engine, with its error against the reference.

        If the reference fails, the row fails, too. Three-dimensional cases have no reference and no error.
        """
        result, steps = self._exact_result(case) if name == REFERENCE else self._run(case, name), self._setup.steps
        began = time.perf_counter()
        force_error, digest = None, ""
        values: Mapping[str, float] = {}
        if name != REFERENCE and result.trace is not None and REFERENCE in case.runs:
            exact = self._exact_result(case)
            result.cost["reference_s"] = time.perf_counter() - began
            began = time.perf_counter()
            if exact.trace is None:
                result.status, result.reason = (
                    exact.status,
                    f"the reference failed, so the error is unknown: {exact.reason}",
                )
            else:
                force_error = float(steps.residual(result.trace, exact.trace).max())
        if result.trace is not None:
            values, digest = steps.observe(case.case.layout, result.trace), digest_of(result.trace)
        workflow_s = (result.cost["workflow_s"] or 0.0) + time.perf_counter() - began
        return StudyRow(
            identity=case.identities[name],
            run=case.runs[name],
            study=self._setup.study.name,
            label=case.label,
            engine=name,
            status=result.status,
            reason=result.reason,
            values={observable: float(value) for observable, value in values.items()},
            force_error=force_error,
            trace_sha256=digest,
            work=case.work,
            cost=result.cost | {"workflow_s": workflow_s},
            ended=time.time(),
        )

    def _exact_result(self, case: StudyCase) -> _Result:
        run = case.runs[REFERENCE]
        if run not in self._exact:
            self._exact = {run: self._run(case, REFERENCE)}
        return self._exact[run]

    def _run(self, case: StudyCase, name: str) -> _Result:
        """Run a case on an engine, a second time in a new process if it ended one that had served other cases."""
        session = self._session_of(name)
        result = self._run_once(case, name, session)
        if result.status == "failed" and session.ended and session.served != 1:
            result = self._run_once(case, name, session)
        return result

    def _run_once(self, case: StudyCase, name: str, session: Session) -> _Result:
        began, starting = time.perf_counter(), session.start_s
        engine, result = load_engine(name), _Result()
        deck = case.kept_decks.get(name) or engine.render(case.case)
        outcome = session.run(deck, self._setup.study.file.limit or default_limit_s(case.case, engine))
        loop_s = engine.loop_seconds((session.case / "stdout.txt").read_text(errors="replace"))
        try:
            result.trace = checked_trace(case.case, engine, outcome, session.case)
        except RunError as error:
            _disk_has_room(session.case)
            result.status, result.reason = error.status, str(error)
        start_s = session.start_s - starting
        workflow_s = time.perf_counter() - began - outcome.wall_s - start_s
        result.cost = {"start_s": start_s, "engine_s": outcome.wall_s, "loop_s": loop_s, "workflow_s": workflow_s}
        result.cost["reference_s"] = 0.0
        return result


def _disk_has_room(folder: Path) -> None:
    """Raise OSError if the disk is full, which is not a failure of the case."""
    try:
        with TemporaryFile(dir=folder) as probe:
            os.posix_fallocate(probe.fileno(), 0, PROBE_BYTES)
    except OSError as error:
        raise OSError(error.errno, error.strerror, str(folder)) from error


@contextmanager
def _sessions(folder: Path) -> Iterator[Callable[[str], Session]]:
    """Yield a function that returns the session of an engine; all sessions end with the context."""
    with ExitStack() as stack:

        @cache
        def session_of(name: str) -> Session:
            (folder / name).mkdir()
            return stack.enter_context(served_by(name, folder / name))

        yield session_of


def get_ready(steps: Steps) -> multiprocessing.context.ForkServerContext:
    """Start the fork server of the workers, with their modules loaded, without waiting for it."""
    context = multiprocessing.get_context("forkserver")
    modules = [function.__module__ for function in (run_cases, steps.plan, steps.observe, steps.residual)]
    context.set_forkserver_preload([*modules, *LIBRARIES])
    if WARNING_FILTER not in sys.warnoptions:
        sys.warnoptions.append(WARNING_FILTER)
    forkserver.ensure_running()
    return context


@contextmanager
def worker_pool(workers: int, setup: Setup, store: Store) -> Iterator[ProcessPoolExecutor]:
    """Worker processes for a study, which end with the context.

    Raises:
        RunError: a worker or the fork server was killed.
    """
    context = get_ready(setup.steps)
    pool = ProcessPoolExecutor(workers, context, _begin, (setup, store.runs, context.Value("q", 0)))
    try:
        yield pool
    except BaseException as error:
        processes = multiprocessing.active_children()
        for process in processes:
            process.terminate()
        for process in processes:
            process.join(EXIT_LIMIT_S)
        # after the workers have ended: one that is stopped while it reads from the pool's queue would damage the queue
        pool.shutdown(cancel_futures=True)
        if isinstance(error, (BrokenProcessPool, EOFError, ConnectionError)):
            raise WorkersKilledError("workers were killed; finished rows are kept") from error
        raise
    pool.shutdown()


def _submitted(
    pool: ProcessPoolExecutor, function: Callable[..., Any], tasks: Iterable[tuple[Any, ...]]
) -> list[Future[Any]]:
    """Futures of a function for several tuples of its arguments.

    Workers start in another thread, since a signal interrupts the main thread: a worker that gets half of its setup
    prints a traceback.
    """
    with ThreadPoolExecutor(1) as thread:
        return thread.submit(lambda: [pool.submit(function, *task) for task in tasks]).result()


def plan_side_by_side(setup: Setup, store: Store, workers: int) -> StudyPlan:
    """Plan of the whole study, by several workers if it is large; InputError if a case is wrong or refused."""
    numbers = range(1, setup.study.count + 1)
    if len(numbers) < MIN_PARALLEL_CASES or workers == 1:
        return plan_of(setup, (facts_of(setup, number) for number in numbers))
    with worker_pool(workers, setup, store) as pool:
        parts = [(numbers[start : start + PLAN_CHUNK],) for start in range(0, len(numbers), PLAN_CHUNK)]
        futures = _submitted(pool, _facts, parts)
        facts = (found for future in futures for found in future.result())
        return plan_of(setup, following(facts, "cases validated", len(numbers), "case"))


def run_locally(
    setup: Setup, numbers: Sequence[int], engines: Sequence[str], store: Store, workers: int, retry_before: float
) -> Iterator[None]:
    """Run cases on several workers; yields repeatedly until all have ended.

    Raises:
        RunError: workers were killed repeatedly.
        OSError: the disk is full or the runs folder cannot be written to.
    """
    deaths = 0
    while numbers:
        known = len(store.rows)
        try:
            with worker_pool(workers, setup, store) as pool:
                futures = _submitted(pool, _run, [(numbers, workers, engines, retry_before)] * workers)
                yield from waiting_for_all(futures)
            numbers = [number for future in futures for number in future.result()]
            if numbers:  # another batch works on them
                time.sleep(RETRY_INTERVAL_S)
        except WorkersKilledError:
            store.refresh()
            deaths = 0 if len(store.rows) > known else deaths + 1
            if deaths == MAX_DEATHS:
                raise
            time.sleep(POLL_INTERVAL_S)  # killed processes look alive for a moment


def waiting_for_all(futures: list[Future[Any]]) -> Iterator[None]:
    """Yield repeatedly until all futures have ended; raises their first error."""
    waiting = set(futures)
    while waiting:
        ended, waiting = wait(waiting, POLL_INTERVAL_S)
        for future in ended:
            future.result()
        yield


def _begin(setup: Setup, runs: Path, taken: Any) -> None:
    """Initialize a worker: it ignores Ctrl-C, and dies at SIGTERM or with the batch."""
    global _work
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    parent = multiprocessing.parent_process()
    if parent is not None:
        threading.Thread(target=_end_with, args=(parent.sentinel,), daemon=True).start()
    _work = setup, Store(runs), taken


def _end_with(sentinel: int) -> None:
    """Kill this worker, and so its engines, when the batch dies."""
    connection.wait([sentinel])
    os.kill(os.getpid(), signal.SIGKILL)


def _end(*_: object) -> None:
    """Leave all contexts, so that engines are ended and rows stored; the pool may send SIGTERM again meanwhile."""
    signal.signal(signal.SIGTERM, signal.SIG_IGN)
    raise SystemExit


def _run(numbers: Sequence[int], workers: int, engines: Sequence[str], retry_before: float) -> list[int]:
    """Run chunks of the shared numbers; return the numbers left to another batch. It ends in order at SIGTERM."""
    setup, store, taken = _work
    try:
        signal.signal(signal.SIGTERM, _end)
        return run_cases(setup, _chunks(numbers, workers, taken), engines, store, retry_before)
    except SystemExit:
        os._exit(1)  # everything is closed: the pool must not submit more, or print


def _chunks(numbers: Sequence[int], workers: int, taken: Any) -> Iterator[Sequence[int]]:
    """Chunks that get smaller towards the end, so that all workers end at the same time."""
    while True:
        with taken.get_lock():
            start = taken.value
            size = max(1, min(CHUNK, (len(numbers) - start) // (4 * workers)))
            taken.value = start + size
        if start >= len(numbers):
            return
        yield numbers[start : start + size]


def _facts(numbers: Sequence[int]) -> list[tuple[list[str], int, list[Any]]]:
    return [facts_of(_work[0], number) for number in numbers]
