"""Runs cases of a study into the store; safe to be killed at any moment and to be run twice."""

import errno
import os
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass, field
from itertools import chain
from pathlib import Path

from drivers.batch.claims import WORK, Workplace, workplace
from drivers.batch.planned import REFERENCE, Planned, plan_case, versions_of
from drivers.batch.store import Row, Store, commit, plain
from drivers.batch.study import Study
from drivers.engines import load_engine
from drivers.errors import RunError
from drivers.guard import checked_trace
from drivers.run import default_limit_s
from drivers.session import Session
from drivers.trace import Trace, digest_of

CHUNK = 64  # cases in a chunk, at most
COMMIT_S = 1.0  # rows are not kept back for longer: a kill loses no more than that, and the case in flight
PROBE_BYTES = 1 << 20


@dataclass
class _Result:
    """A case on one engine, not yet a row."""

    trace: Trace | None = None
    status: str = "done"
    reason: str = ""
    cost: dict[str, float | None] = field(default_factory=dict)


def run_cases(
    study: Study, chunks: Iterable[Sequence[int]], engines: tuple[str, ...], store: Store, retry_before: float = 0.0
) -> list[int]:
    """Runs what is not done of some cases of a study.

    Args:
        study: the study.
        chunks: numbers of the cases, from 1; those of a chunk are planned and claimed together.
        engines: on which to run them; those not installed are left out.
        store: of the runs folder.
        retry_before: failures that ended before this time are run again.

    Returns:
        The cases of which another live process works on a row.

    Raises:
        OSError: the disk is full, or something else is wrong with the runs folder.
    """
    versions = versions_of(engines, store.runs)
    wanted_engines = [name for name in engines if name in versions]
    left: list[int] = []
    with workplace(store.folder / WORK) as place, _sessions(place.folder) as session_of:
        for numbers in chunks:
            planned = [plan_case(study, number, versions) for number in numbers]
            left += _run_chunk(study, planned, wanted_engines, store, place, session_of, retry_before)
    return left


def to_run(store: Store, identity: str, retry_before: float) -> bool:
    """Whether a row is missing, or is a failure to be tried again."""
    row = store.rows.get(identity)
    return row is None or (not row.done and row.ended < retry_before)


def _run_chunk(
    study: Study,
    planned: list[Planned],
    engines: list[str],
    store: Store,
    place: Workplace,
    session_of: Callable[[str], Session],
    retry_before: float,
) -> list[int]:
    store.refresh()
    missing = [
        p.identities[name] for p in planned for name in engines if to_run(store, p.identities[name], retry_before)
    ]
    free = set(place.claim(missing)) if missing else set()
    store.refresh()  # what others finished before the claim
    free = {identity for identity in free if to_run(store, identity, retry_before)}
    if free:
        for name in {*engines, REFERENCE}:  # they start side by side
            with suppress(OSError):
                session_of(name).start()
    rows: list[Row] = []
    committed = time.monotonic()
    try:
        for row in chain.from_iterable(_run_case(study, each, free, session_of) for each in planned):
            rows.append(row)
            if time.monotonic() - committed > COMMIT_S:
                commit(rows, store.folder, place.folder)
                rows, committed = [], time.monotonic()
    finally:
        commit(rows, store.folder, place.folder)
    others = set(missing) - free - set(store.rows)
    return [each.number for each in planned if others & set(each.identities.values())]


def _run_case(study: Study, planned: Planned, wanted: set[str], session_of: Callable[[str], Session]) -> Iterator[Row]:
    """The rows of a case of which the identities are wanted; the exact forces are computed once for all."""
    exact: _Result | None = None
    for name in (name for name, identity in planned.identities.items() if identity in wanted):
        if name == REFERENCE:
            result = exact = exact or _run(study, planned, name, session_of(name))
        else:
            result = _run(study, planned, name, session_of(name))
            began = time.perf_counter()
            exact = exact or _run(study, planned, REFERENCE, session_of(REFERENCE))
            result.cost["reference_s"] = time.perf_counter() - began
        began = time.perf_counter()
        force_error = None
        if name != REFERENCE and result.trace is not None and exact.trace is not None:
            from postproc.residual import residual

            force_error = float(residual(result.trace, exact.trace).max())
        yield _row(study, planned, name, result, force_error, began)


def _row(study: Study, planned: Planned, engine: str, result: _Result, force_error: float | None, began: float) -> Row:
    from postproc.observables import observe

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
    """A case on an engine; if it kills a process that has served others, it gets another one to itself."""
    result = _run_once(study, planned, name, session)
    if result.status == "failed" and session.ended and session.served > 1:
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
