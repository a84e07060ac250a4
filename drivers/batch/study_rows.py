"""Rows of a study: cases are run and their rows stored, by any number of processes, each of which may be killed."""

import time
from collections.abc import Callable, Iterator, Sequence
from functools import partial

from drivers.base.errors import RunError
from drivers.batch.store import WORK, Outbox, Store, StudyRow
from drivers.batch.study_cases import Batch, Request, opened
from drivers.chain.case import Case
from drivers.chain.trace import digest_of, residual
from drivers.engines import REFERENCE
from drivers.run.compute import Computed, compute
from drivers.run.execute import Place, WorkersKilledError, execute
from drivers.run.workplaces import lease, workplace

CHUNK = 64  # largest number of cases in a chunk
RETRY_INTERVAL_S = 2.0  # while another batch works on the remaining cases
MAX_DEATHS = 5  # of workers in a row, without a finished row


def run_all(request: Request, numbers: Sequence[int], place: Place, store: Store, tick: Callable[[], None]) -> None:
    """Run the unfinished rows of cases, until they are stored by this or another batch.

    Args:
        request: the study.
        numbers: numbers of the cases.
        place: worker processes or a Dask cluster.
        store: store of the rows.
        tick: function called several times a second.

    Raises:
        RunError: workers were killed repeatedly.
        OSError: the disk is full or the runs folder cannot be written to.
    """
    deaths = 0
    while numbers:
        known = len(store.rows)
        try:
            under_way = execute(partial(run_rows, request), _chunks(numbers, place.workers), place, tick)
            numbers = [number for _, left in under_way for number in left]
            if numbers:  # another batch works on them
                time.sleep(RETRY_INTERVAL_S)
        except WorkersKilledError:
            store.refresh()
            deaths = 0 if len(store.rows) > known else deaths + 1
            if deaths == MAX_DEATHS:
                raise
            time.sleep(RETRY_INTERVAL_S / 10)  # killed processes look alive for a moment


def _chunks(numbers: Sequence[int], workers: int) -> Iterator[Sequence[int]]:
    """Chunks that get smaller towards the end, so that all workers end at the same time."""
    start = 0
    while start < len(numbers):
        size = max(1, min(CHUNK, (len(numbers) - start) // (4 * (workers or 1))))
        yield numbers[start : start + size]
        start += size


def run_slice(request: Request, numbers: Sequence[int]) -> list[StudyRow]:
    """Run the unfinished rows of some cases in this process and return all their rows.

    Every case is validated first.

    Raises:
        InputError: the study or a case is wrong.
        OSError: the disk is full or the runs folder cannot be written to.
    """
    batch = opened(request)
    identities = [batch.facts(number).identities for number in numbers]
    left = list(numbers)
    while left := run_rows(request, left):  # another process works on them
        time.sleep(RETRY_INTERVAL_S)
    batch.store.refresh()
    rows = batch.store.rows
    return [row for name in batch.engines for identity in identities if (row := rows.get(identity.get(name, "")))]


def run_rows(request: Request, numbers: Sequence[int]) -> list[int]:
    """Run the unfinished rows of some cases of a study.

    Cases are planned and leased in chunks. Engines that are not installed are skipped.

    Returns:
        Numbers of the cases with a row on which another process is working.

    Raises:
        OSError: the disk is full or the runs folder cannot be written to.
    """
    batch, store = opened(request), opened(request).store
    left: list[int] = []
    with workplace(store.folder / WORK) as place, Outbox(store.folder, place) as box:
        exact: dict[str, Computed] = {}
        for start in range(0, len(numbers), CHUNK):
            identities = {number: batch.facts(number).identities for number in numbers[start : start + CHUNK]}
            store.refresh()
            asked = {
                of_case[name] for of_case in identities.values() for name in batch.engines if name in batch.runnable
            }
            missing = {identity for identity in asked if batch.is_to_run(identity)}
            free = lease(place, missing) if missing else set()
            store.refresh()  # rows finished by others before the lease
            free = {identity for identity in free if batch.is_to_run(identity)}
            ran: set[str] = set()
            for number, of_case in identities.items():
                wanted = [name for name, identity in of_case.items() if identity in free - ran]
                if not wanted:
                    continue
                case = batch.case(number)
                for name in wanted:
                    box.add(_row(batch, number, case, name, exact))
                    ran.add(of_case[name])
            box.flush()  # before the lease ends
            others = {identity for identity in missing - free if batch.is_to_run(identity)}
            left += [number for number, of_case in identities.items() if others & {*of_case.values()}]
    return left


def _row(batch: Batch, number: int, case: Case, name: str, exact: dict[str, Computed]) -> StudyRow:
    """Row of a case on an engine, with its error against the reference.

    If the reference fails, the row fails, too. Three-dimensional cases have no reference and no error. ``exact`` holds
    the last run of the reference, which consecutive rows may share.
    """
    began = time.perf_counter()
    request, facts = batch.request, batch.facts(number)

    def run(engine: str) -> Computed:
        return compute(case, engine, build=batch.builds[engine], limit_s=batch.study.file.limit)

    def reference() -> Computed:
        if facts.runs[REFERENCE] not in exact:
            exact.clear()
            exact[facts.runs[REFERENCE]] = run(REFERENCE)
        return exact[facts.runs[REFERENCE]]

    ended = reference() if name == REFERENCE else run(name)
    trace, fault, reference_s = ended.trace, ended.fault, 0.0
    force_error = None
    if name != REFERENCE and trace is not None and REFERENCE in facts.runs:
        before = time.perf_counter()
        truth = reference()
        reference_s = time.perf_counter() - before
        if truth.trace is None:
            assert truth.fault is not None
            fault = RunError(f"the reference failed, so the error is unknown: {truth.fault}", truth.fault.status)
        else:
            force_error = float(residual(trace, truth.trace).max())
    values = {} if trace is None else request.observe(case.layout, trace)
    digest = "" if trace is None else digest_of(trace)
    cost = {"start_s": ended.start_s, "engine_s": ended.wall_s, "loop_s": ended.loop_s, "reference_s": reference_s}
    workflow_s = time.perf_counter() - began - ended.start_s - ended.wall_s - reference_s
    return StudyRow(
        identity=facts.identities[name],
        run=facts.runs[name],
        study=batch.study.name,
        label=batch.study.label(number),
        engine=name,
        status=fault.status if fault else "done",
        reason=str(fault) if fault else "",
        values={observable: float(value) for observable, value in values.items()},
        force_error=force_error,
        trace_sha256=digest,
        work=case.work,
        cost=cost | {"workflow_s": max(workflow_s, 0.0)},
        ended=time.time(),
        build=batch.builds[name].identity,
    )
