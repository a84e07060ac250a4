"""Workers: run cases of a study into the store; safe to be killed at any moment and to be run twice.

On this machine they are processes that live as long as the batch.
"""

import multiprocessing
import os
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass, field
from functools import cache
from multiprocessing import connection, forkserver
from pathlib import Path
from pkgutil import resolve_name
from tempfile import TemporaryFile
from typing import Any

from drivers.base.errors import RunError
from drivers.base.progress import following
from drivers.batch.store import WORK, Outbox, Row, Store
from drivers.batch.study import read_study, select
from drivers.batch.study_cases import Request, Setup, Steps, StudyCase, StudyPlan, facts_of, plan_of, set_up
from drivers.chain.trace import Trace, digest_of
from drivers.engines import REFERENCE, load_engine
from drivers.engines._entries import use_entries
from drivers.run.guard import checked_trace
from drivers.run.run import default_limit_s
from drivers.run.session import Session, served_by
from drivers.run.workplaces import lease, workplace

CHUNK = 64  # cases in a chunk, at most
PROBE_BYTES = 1 << 20
POLL_S = 0.2
RETRY_S = 2.0  # between looks at what another batch is at work on
EXIT_LIMIT_S = 10.0  # for workers that are asked to end
LIBRARIES = ("scipy.interpolate", "scipy.signal")  # that rows are made with, loaded once for all workers
QUIET = "ignore:resource_tracker"  # after a kill the system has semaphores to clear up, and would say so
MAX_DEATHS = 5  # of workers in a row, without a row done
PLAN_CHUNK = 250
MANY_TO_PLAN = 500  # cases; from here on, workers share the planning

_work: tuple[Setup, Store, Any]  # of a worker process; the last: how many numbers all workers have taken up


class WorkersKilledError(RunError):
    """Workers, or what they are forked from, were killed from outside."""


@dataclass
class _Result:
    """A case on one engine, not yet a row; ``cost`` in seconds by what they were spent on."""

    trace: Trace | None = None
    status: str = "done"
    reason: str = ""
    cost: dict[str, float | None] = field(default_factory=dict)


def run_cases(
    setup: Setup, chunks: Iterable[Sequence[int]], engines: Sequence[str], store: Store, retry_before: float = 0.0
) -> list[int]:
    """Runs what is not done of some cases of a study.

    The cases of a chunk are planned and leased together; engines that are not installed are left out; failures that
    ended before ``retry_before`` are run again.

    Returns:
        The cases of which another live process works on a row.

    Raises:
        OSError: the disk is full, or something else is wrong with the runs folder.
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
            store.refresh()  # what others finished before the lease
            free = {identity for identity in free if to_run(store, identity, retry_before)}
            for each in cases:
                for name in each.wanted(free):  # they start side by side
                    for engine in {name, REFERENCE} & set(each.runs):
                        with suppress(OSError):
                            session_of(engine).start()
            for each in cases:
                for name in each.wanted(free - ran):
                    box.add(runner.row(each, name))
                    ran.add(each.identities[name])
            box.flush()  # before the lease is given up
            others = {each for each in missing - free - ran if to_run(store, each, retry_before)}
            left += [each.number for each in cases if others & set(each.identities.values())]
    return left


def to_run(store: Store, identity: str, retry_before: float) -> bool:
    """Whether a row is missing, or is a failure to be tried again."""
    row = store.rows.get(identity)
    return row is None or (not row.done and row.ended < retry_before)


def run_slice(request: Request, part: int, parts: int) -> list[Row]:
    """Runs what is not done of part I of N of a study, and returns its rows when all is done or failed.

    The one door for schedulers. Safe to be called twice, to be killed, and to be called again; every case of the slice
    is validated first.

    Raises:
        InputError: the study or a case of the slice is wrong.
        OSError: the disk is full, or something else is wrong with the runs folder.
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
        if left:  # another process is at work on them
            time.sleep(POLL_S)
    store.refresh()
    return [row for name in selection.engines for each in identities if (row := store.rows.get(each.get(name, "")))]


class _Runner:
    """Makes rows of cases; engines, and time steps, share the exact forces of the last case asked for."""

    def __init__(self, setup: Setup, session_of: Callable[[str], Session]) -> None:
        self._setup = setup
        self._session_of = session_of
        self._exact: dict[str, _Result] = {}

    def row(self, case: StudyCase, name: str) -> Row:
        """A case on an engine, with its error against the exact forces; where these fail it fails, to be retried.

        Of three-dimensional cases there are no exact forces.
        """
        result, steps = self._exact_result(case) if name == REFERENCE else self._run(case, name), self._setup.steps
        began = time.perf_counter()
        force_error, values, digest = None, {}, ""
        if name != REFERENCE and result.trace is not None and REFERENCE in case.runs:
            exact = self._exact_result(case)
            result.cost["reference_s"] = time.perf_counter() - began
            began = time.perf_counter()
            if exact.trace is None:
                result.status, result.reason = exact.status, f"no exact forces to count its error by: {exact.reason}"
            else:
                force_error = float(resolve_name(steps.residual)(result.trace, exact.trace).max())
        if result.trace is not None:
            values, digest = resolve_name(steps.observe)(case.case.layout, result.trace), digest_of(result.trace)
        workflow_s = (result.cost["workflow_s"] or 0.0) + time.perf_counter() - began
        return Row(
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
        """A case on an engine; if it kills a process that served others, or that did not start, it gets another."""
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
    """Raises OSError where the disk is full, which is no fault of the case."""
    try:
        with TemporaryFile(dir=folder) as probe:
            os.posix_fallocate(probe.fileno(), 0, PROBE_BYTES)
    except OSError as error:
        raise OSError(error.errno, error.strerror, str(folder)) from error


@contextmanager
def _sessions(folder: Path) -> Iterator[Callable[[str], Session]]:
    """Sessions by engine, made when first asked for, ended afterwards."""
    with ExitStack() as stack:

        @cache
        def session_of(name: str) -> Session:
            (folder / name).mkdir()
            return stack.enter_context(served_by(name, folder / name))

        yield session_of


def get_ready(steps: Steps) -> multiprocessing.context.ForkServerContext:
    """Starts what workers are forked from, with all that they need loaded, without waiting for it."""
    context = multiprocessing.get_context("forkserver")
    modules = (run_cases.__module__, steps.plan.partition(":")[0], *steps.observing, *LIBRARIES)
    context.set_forkserver_preload(["drivers.base.ends_with_parent", *modules])
    if QUIET not in sys.warnoptions:
        sys.warnoptions.append(QUIET)
    forkserver.ensure_running()
    return context


@contextmanager
def worker_pool(workers: int, setup: Setup, store: Store) -> Iterator[ProcessPoolExecutor]:
    """Worker processes for a study; whatever happens here, they end with it.

    Raises:
        RunError: one was killed, or what they are forked from.
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
        # only now: a worker that is stopped while it reads the pool's farewell leaves half of it to the next
        pool.shutdown(wait=False, cancel_futures=True)
        if isinstance(error, (BrokenProcessPool, EOFError, ConnectionError)):
            raise WorkersKilledError("workers were killed; what is done is kept") from error
        raise
    pool.shutdown()


def plan_side_by_side(setup: Setup, store: Store, workers: int) -> StudyPlan:
    """The plan of the whole study; an InputError where a case makes no scene, or none that can end well."""
    numbers = range(1, setup.study.count + 1)
    if len(numbers) < MANY_TO_PLAN or workers == 1:
        return plan_of(setup, (facts_of(setup, number) for number in numbers))
    with worker_pool(workers, setup, store) as pool:
        facts = pool.map(_facts, numbers, chunksize=PLAN_CHUNK)
        return plan_of(setup, following(facts, "cases validated", len(numbers), "case"))


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
        except WorkersKilledError:
            store.refresh()
            deaths = 0 if len(store.rows) > known else deaths + 1
            if deaths == MAX_DEATHS:
                raise
            time.sleep(POLL_S)  # what was killed needs a moment to be gone: until then it looks alive, but refuses work


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
    parent = multiprocessing.parent_process()
    if parent is not None:
        threading.Thread(target=_end_with, args=(parent.sentinel,), daemon=True).start()
    _work = setup, Store(runs), taken
    signal.signal(signal.SIGTERM, _end)  # last: until here there is nothing to leave in order


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
