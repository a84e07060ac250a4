"""Plans of studies: the identity of every row, the state of the rows, the time that the missing rows will take."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

from drivers.base.kept import keep, recall
from drivers.base.progress import counted
from drivers.batch.store import WORK, StudyRow
from drivers.batch.study import column_name, value_at
from drivers.batch.study_cases import Batch, Request, opened
from drivers.run.execute import Place, execute
from drivers.run.workplaces import leased

STATES = ("done", "failed", "timeout", "stale", "claimed", "to do", "not installed")  # of a row
WORKER_COSTS = ("start_s", "engine_s", "workflow_s", "reference_s")  # they add up to a worker's time
CHUNK = 25  # facts of so many cases fit into one write; a worker killed between two writes would block the batch
MIN_PARALLEL_CASES = 500  # from this number on, workers share the planning

Facts = tuple[list[str], int, list[Any]]  # of a case: identities by engine, work, varied values


@dataclass(frozen=True)
class StudyPlan:
    """All cases of a study, in order, with the stored rows.

    Attributes:
        batch: the batch.
        identities: identity of each case's row, by installed engine.
        work: bodies times steps of each case.
        values: varied values in SI units of each case, by column.
    """

    batch: Batch
    identities: dict[str, list[str]]
    work: list[int]
    values: dict[str, list[Any]]

    def rows_of(self, engine: str) -> list[StudyRow | None]:
        """Rows of an engine in the order of the cases; None for missing rows."""
        rows = self.batch.store.rows
        return [rows.get(identity) for identity in self.identities.get(engine, [""] * len(self.work))]

    def todo(self) -> dict[str, list[int]]:
        """Numbers of the selected cases to run, by engine; without engines that are not installed."""
        batch = self.batch
        return {
            name: [number for number in batch.numbers if batch.is_to_run(self.identities[name][number - 1])]
            for name in batch.engines
            if name in self.identities
        }

    def progress(self) -> str:
        """Number of rows done in the whole table, as text."""
        study = self.batch.study
        rows = [row for name in study.engines for row in self.rows_of(name)]
        return f"{sum(row is not None and row.done for row in rows)} of {study.count * len(study.engines)} rows done"

    def states(self) -> dict[str, dict[int, str]]:
        """States of all cases by engine and number, as named in ``STATES``."""
        study, store = self.batch.study, self.batch.store
        claimed = leased(store.folder / WORK)

        def state(name: str, number: int) -> str:
            if name not in self.identities:
                return "not installed"
            identity = self.identities[name][number - 1]
            row = store.rows.get(identity)
            if row is not None:
                return row.status
            if identity in claimed:
                return "claimed"
            return "stale" if (study.name, name, study.label(number)) in store.labels else "to do"

        numbers = range(1, study.count + 1)
        return {name: {number: state(name, number) for number in numbers} for name in self.batch.engines}


def planned(batch: Batch, workers: int) -> StudyPlan:
    """Plan of the whole study, by several workers if it is large.

    The facts of each chunk of cases are kept when they are computed, so that planning continues after a kill.

    Raises:
        InputError: a case is wrong or refused.
    """
    numbers: Sequence[int] = range(1, batch.study.count + 1)
    chunks = [numbers[start : start + CHUNK] for start in range(0, len(numbers), CHUNK)]
    facts: dict[Sequence[int], list[Facts]] = {}
    for chunk in chunks:
        if (known := recall(_key_of(batch, chunk))) is not None:
            facts[chunk] = known
    left = [chunk for chunk in chunks if chunk not in facts]
    under_way: Iterator[tuple[Sequence[int], list[Facts]]]
    if len(left) * CHUNK < MIN_PARALLEL_CASES or workers == 1:
        under_way = ((chunk, _facts_of(batch, chunk)) for chunk in left)
    else:
        under_way = execute(partial(_facts_in_worker, batch.request), left, Place(workers, processes=True))
    with counted("cases validated", sum(map(len, left)), "case") as count:
        for chunk, found in under_way:
            facts[chunk] = found
            count(len(chunk))
    identities, work, values = zip(*(each for chunk in chunks for each in facts[chunk]), strict=True)
    columns = [column_name(name, key) for name, key in batch.study.columns.items()]
    return StudyPlan(
        batch,
        {name: list(each) for name, each in zip(batch.builds, zip(*identities, strict=True), strict=True)},
        list(work),
        {name: list(each) for name, each in zip(columns, zip(*values, strict=True), strict=True)},
    )


def _facts_in_worker(request: Request, numbers: Sequence[int]) -> list[Facts]:
    return _facts_of(opened(request, whole=True), numbers)


def _facts_of(batch: Batch, numbers: Sequence[int]) -> list[Facts]:
    """Facts of consecutive cases, computed and kept; an identity is empty if the engine cannot model the case."""
    facts: list[Facts] = []
    for number in numbers:
        case = batch.case(number)
        identities = [case.identities.get(name, "") for name in batch.builds]
        values = [value_at(case.case.scene, key) for key in batch.study.columns.values()]
        facts.append((identities, case.case.work, values))
    return list(keep(_key_of(batch, numbers), facts))


def _key_of(batch: Batch, numbers: Sequence[int]) -> list[Any]:
    return ["cases of a study", batch.digest, numbers[0], numbers[-1]]


def expected_s(plan: StudyPlan, todo: dict[str, list[int]]) -> float | None:
    """Expected time in s of one worker for some cases by engine; None without any finished row.

    A row costs a constant plus a time proportional to bodies times steps; both are fitted to stored rows.
    """
    import numpy as np
    from scipy.optimize import nnls

    seconds = 0.0
    for engine, numbers in todo.items():
        if not numbers:
            continue
        rows = [row for row in plan.batch.store.rows.values() if row.engine == engine and row.cost.get("engine_s")]
        if not rows:
            return None
        spent = np.array([sum(row.cost[name] or 0.0 for name in WORKER_COSTS) for row in rows])
        work = np.array([float(row.work) for row in rows])
        scale = work.max() or 1.0
        each, rate = 0.0, spent.mean()
        if np.ptp(work):
            each, rate = nnls(np.column_stack([np.ones(len(work)), work / scale]), spent)[0]
        seconds += float(sum(each + rate * plan.work[number - 1] / scale for number in numbers))
    return seconds
