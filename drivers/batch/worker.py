"""Runs cases of a study into the store; safe to be killed at any moment and to be run twice."""

import errno
import os
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from pkgutil import resolve_name

from drivers.base.errors import RunError
from drivers.batch.store import WORK, Outbox, Row, Store
from drivers.batch.study import read_study, select
from drivers.batch.study_cases import REFERENCE, Request, Setup, StudyCase, set_up
from drivers.chain.trace import Trace, digest_of
from drivers.engines import load_engine
from drivers.run.guard import checked_trace
from drivers.run.run import default_limit_s
from drivers.run.session import Session, served_by
from drivers.run.workplaces import lease, workplace

CHUNK = 64  # cases in a chunk, at most
PROBE_BYTES = 1 << 20
POLL_S = 0.5


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

    Args:
        setup: the study with the installed engines.
        chunks: numbers of the cases, from 1; those of a chunk are planned and leased together.
        engines: on which to run them; those not installed are left out.
        store: of the runs folder.
        retry_before: failures that ended before this time are run again.

    Returns:
        The cases of which another live process works on a row.

    Raises:
        OSError: the disk is full, or something else is wrong with the runs folder.
    """
    names = [name for name in engines if name in setup.versions]
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
                    for engine in (name, REFERENCE) if each.exact else (name,):
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
    retry_before = time.time() if request.retry else 0.0
    study, store = read_study(request.source), Store(request.runs)
    selection = select(study, request.engines, request.patterns)
    setup = set_up(study, selection.engines, request.runs, request.steps)
    left = list(selection.slice_of(part, parts))
    identities = [setup.case(number).identities for number in left]
    while left:
        chunks = [left[start : start + CHUNK] for start in range(0, len(left), CHUNK)]
        left = run_cases(setup, chunks, selection.engines, store, retry_before)
        if left:  # another process is at work on them
            time.sleep(POLL_S)
    store.refresh()
    return [row for name in selection.engines for each in identities if (row := store.rows.get(each.get(name, "")))]


class _Runner:
    """Makes rows of cases; engines, and time steps, share the exact forces of the last case asked for."""

    def __init__(self, setup: Setup, session_of: Callable[[str], Session]) -> None:
        self._setup = setup
        self._session_of = session_of
        self._exact_of = ""
        self._exact = _Result()

    def row(self, case: StudyCase, name: str) -> Row:
        """A case on an engine, with its error against the exact forces; where these fail it fails, to be retried.

        Of three-dimensional cases there are no exact forces.
        """
        result, steps = self._exact_result(case) if name == REFERENCE else self._run(case, name), self._setup.steps
        began = time.perf_counter()
        force_error, values, digest = None, {}, ""
        if name != REFERENCE and result.trace is not None and case.exact:
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
        if self._exact_of != case.runs[REFERENCE]:
            self._exact = self._run(case, REFERENCE)
            self._exact_of = case.runs[REFERENCE]
        return self._exact

    def _run(self, case: StudyCase, name: str) -> _Result:
        """A case on an engine; if it kills a process that served others, or that did not start, it gets another."""
        session = self._session_of(name)
        result = self._run_once(case, name, session)
        if result.status == "failed" and session.ended and session.served != 1:
            result = self._run_once(case, name, session)
        return result

    def _run_once(self, case: StudyCase, name: str, session: Session) -> _Result:
        began, starting = time.perf_counter(), session.start_s
        engine, deck, result = load_engine(name), case.deck(name), _Result()
        outcome = session.run(deck, self._setup.study.file.limit or default_limit_s(case.case))
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
    """A full disk is no fault of the case.

    Raises:
        OSError: it is full.
    """
    probe = folder / "probe"
    try:
        with open(probe, "wb") as file:
            file.write(b"\0" * PROBE_BYTES)
            file.flush()
            os.fsync(file.fileno())
    except OSError as error:
        raise OSError(error.errno or errno.ENOSPC, error.strerror, str(folder)) from error
    finally:
        probe.unlink(missing_ok=True)


@contextmanager
def _sessions(folder: Path) -> Iterator[Callable[[str], Session]]:
    """Sessions by engine, made when first asked for, ended afterwards."""
    with ExitStack() as stack:

        @cache
        def session_of(name: str) -> Session:
            (folder / name).mkdir()
            return stack.enter_context(served_by(name, folder / name))

        yield session_of
