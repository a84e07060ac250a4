"""Runs cases of a study into the store; safe to be killed at any moment and to be run twice."""

import errno
import os
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path

from drivers.base.errors import RunError
from drivers.batch.leases import WORK, workplace
from drivers.batch.outbox import outbox
from drivers.batch.store import Row, Store, plain
from drivers.batch.study import Study
from drivers.batch.study_cases import REFERENCE, Planned, plan_case
from drivers.chain.trace import Trace, digest_of
from drivers.engines import load_engine
from drivers.run.guard import checked_trace
from drivers.run.run import default_limit_s
from drivers.run.session import Session

CHUNK = 64  # cases in a chunk, at most
PROBE_BYTES = 1 << 20


@dataclass
class _Result:
    """A case on one engine, not yet a row."""

    trace: Trace | None = None
    status: str = "done"
    reason: str = ""
    cost: dict[str, float | None] = field(default_factory=dict)


def run_cases(
    study: Study,
    chunks: Iterable[Sequence[int]],
    engines: tuple[str, ...],
    versions: dict[str, str],
    store: Store,
    retry_before: float = 0.0,
) -> list[int]:
    """Runs what is not done of some cases of a study.

    Args:
        study: the study.
        chunks: numbers of the cases, from 1; those of a chunk are planned and claimed together.
        engines: on which to run them; those not installed are left out.
        versions: of the engines that are, and of the reference.
        store: of the runs folder.
        retry_before: failures that ended before this time are run again.

    Returns:
        The cases of which another live process works on a row.

    Raises:
        OSError: the disk is full, or something else is wrong with the runs folder.
    """
    names = [name for name in engines if name in versions]
    left: list[int] = []
    with (
        workplace(store.folder / WORK) as place,
        outbox(store.folder, place.folder) as box,
        _sessions(place.folder) as session_of,
    ):
        exact = _Exact(study, session_of)
        ran: set[str] = set()
        for numbers in chunks:
            planned = [plan_case(study, number, versions) for number in numbers]
            store.refresh()
            asked = {each.identities[name] for each in planned for name in names}
            missing = {identity for identity in asked if to_run(store, identity, retry_before)}
            free = place.claim(missing) if missing else set()
            store.refresh()  # what others finished before the claim
            free = {identity for identity in free if to_run(store, identity, retry_before)}
            for each in planned:
                for name in each.wanted(free):  # they start side by side
                    for engine in (name, REFERENCE) if each.exact else (name,):
                        with suppress(OSError):
                            session_of(engine).start()
            for each in planned:
                for name in each.wanted(free - ran):
                    box.add(_run_row(study, each, name, session_of, exact))
                    ran.add(each.identities[name])
            box.flush()  # before the claim is given up
            others = {each for each in missing - free - ran if to_run(store, each, retry_before)}
            left += [each.number for each in planned if others & set(each.identities.values())]
    return left


def to_run(store: Store, identity: str, retry_before: float) -> bool:
    """Whether a row is missing, or is a failure to be tried again."""
    row = store.rows.get(identity)
    return row is None or (not row.done and row.ended < retry_before)


class _Exact:
    """The exact forces of the last case asked for: engines, and time steps, share them."""

    def __init__(self, study: Study, session_of: Callable[[str], Session]) -> None:
        self._study = study
        self._session_of = session_of
        self._of = ""
        self._result = _Result()

    def of(self, planned: Planned) -> _Result:
        """Those of a case."""
        if self._of != planned.runs[REFERENCE]:
            self._result = _run(self._study, planned, REFERENCE, self._session_of(REFERENCE))
            self._of = planned.runs[REFERENCE]
        return self._result


def _run_row(study: Study, planned: Planned, name: str, session_of: Callable[[str], Session], exact: _Exact) -> Row:
    """A case on an engine, with its error against the exact forces; where these fail it fails, so that it is retried.

    Of three-dimensional cases there are none.
    """
    if name == REFERENCE:
        result = exact.of(planned)
        return _row(study, planned, name, result, None, time.perf_counter())
    result = _run(study, planned, name, session_of(name))
    if result.trace is None or not planned.exact:
        return _row(study, planned, name, result, None, time.perf_counter())
    began = time.perf_counter()
    truth = exact.of(planned)
    result.cost["reference_s"] = time.perf_counter() - began
    began = time.perf_counter()
    force_error = None
    if truth.trace is None:
        result.status, result.reason = truth.status, f"no exact forces to count its error by: {truth.reason}"
    else:
        from postproc.read.residual import residual

        force_error = float(residual(result.trace, truth.trace).max())
    return _row(study, planned, name, result, force_error, began)


def _row(study: Study, planned: Planned, engine: str, result: _Result, force_error: float | None, began: float) -> Row:
    from postproc.read.observables import observe

    trace = result.trace
    values = plain(observe(planned.case.layout, trace)) if trace is not None else {}
    workflow_s = (result.cost["workflow_s"] or 0.0) + time.perf_counter() - began
    return Row(
        identity=planned.identities[engine],
        run=planned.runs[engine],
        study=study.name,
        label=planned.label,
        engine=engine,
        status=result.status,
        reason=result.reason,
        values=values,
        force_error=force_error,
        trace_sha256=digest_of(trace) if trace is not None else "",
        work=planned.work,
        cost=result.cost | {"workflow_s": workflow_s},
        ended=time.time(),
    )


def _run(study: Study, planned: Planned, name: str, session: Session) -> _Result:
    """A case on an engine; if it kills a process that has served others, or that did not start, it gets another."""
    result = _run_once(study, planned, name, session)
    if result.status == "failed" and session.ended and session.served != 1:
        result = _run_once(study, planned, name, session)
    return result


def _run_once(study: Study, planned: Planned, name: str, session: Session) -> _Result:
    began, starting = time.perf_counter(), session.start_s
    engine, case, deck = load_engine(name), planned.case, planned.deck(name)
    result = _Result()
    outcome = session.run(deck, study.limit_s or default_limit_s(case))
    loop_s = engine.loop_seconds((session.case / "stdout.txt").read_text(errors="replace"))
    try:
        result.trace = checked_trace(case, engine, outcome, session.case)
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
    made: dict[str, Session] = {}
    with ExitStack() as stack:

        def session_of(name: str) -> Session:
            if name not in made:
                engine = load_engine(name)
                executable = engine.find()
                assert executable is not None
                home = folder / name
                home.mkdir()
                made[name] = Session(engine, executable, home)
                stack.callback(made[name].close)
            return made[name]

        yield session_of
