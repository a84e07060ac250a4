"""Plans of studies: the identity of every row, the state of the rows, the time that the missing rows will take."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

from drivers.base.progress import counted
from drivers.batch.store import WORK, StudyRow
from drivers.batch.study import column_name
from drivers.batch.study_cases import CHUNK, Batch, CaseFacts, Request, opened
from drivers.run.execute import Place, execute
from drivers.run.workplaces import leased

STATES = ("done", "failed", "timeout", "stale", "claimed", "to do", "not installed")  # of a row
WORKER_COSTS = ("start_s", "engine_s", "workflow_s", "reference_s")  # they add up to a worker's time
MIN_PARALLEL_CASES = 500  # from this number on, workers share the planning


@dataclass(frozen=True)
class StudyPlan:
    """Facts of all cases of a study, in order, with the stored rows."""

    batch: Batch
    facts: list[CaseFacts]

    @property
    def values(self) -> dict[str, list[Any]]:
        """Varied values of all cases in SI units, by column with its unit."""
        columns = [column_name(name, key) for name, key in self.batch.study.columns.items()]
        return {name: [facts.values[place] for facts in self.facts] for place, name in enumerate(columns)}

    def rows_of(self, engine: str) -> list[StudyRow | None]:
        """Rows of an engine in the order of the cases; None for missing rows."""
        return [self.batch.store.rows.get(facts.identities.get(engine, "")) for facts in self.facts]

    def todo(self) -> dict[str, list[int]]:
        """Numbers of the selected cases to run, by engine; without engines that are not runnable."""
        return {name: self.missing(name) for name in self.batch.engines if name in self.batch.runnable}

    def missing(self, engine: str) -> list[int]:
        """Numbers of the selected cases without a row of an engine, or with a failure to be run again."""
        is_to_run = self.batch.is_to_run
        return [number for number in self.batch.numbers if is_to_run(self.facts[number - 1].identities[engine])]

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
            identity = self.facts[number - 1].identities[name]
            row = store.rows.get(identity)
            if row is not None:
                return row.status
            if identity in claimed:
                return "claimed"
            if (study.name, name, study.label(number)) in store.labels:
                return "stale"
            return "to do" if name in self.batch.runnable else "not installed"

        numbers = range(1, study.count + 1)
        return {name: {number: state(name, number) for number in numbers} for name in self.batch.engines}


def planned(batch: Batch, workers: int) -> StudyPlan:
    """Plan of the whole study, by several workers if it is large.

    The facts of each chunk of cases are kept when they are computed, so that planning continues after a kill.

    Raises:
        InputError: a case is wrong or refused.
    """
    chunks = batch.chunks()
    facts = {chunk: kept for chunk in chunks if (kept := batch.kept_facts(chunk)) is not None}
    left = [chunk for chunk in chunks if chunk not in facts]
    under_way: Iterator[tuple[Sequence[int], list[CaseFacts]]]
    if len(left) * CHUNK < MIN_PARALLEL_CASES or workers == 1:
        under_way = ((chunk, batch.keep_facts(chunk)) for chunk in left)
    else:
        under_way = execute(partial(_keep_facts, batch.request), left, Place(workers, processes=True))
    with counted("cases validated", sum(map(len, left)), "case") as count:
        for chunk, found in under_way:
            facts[chunk] = found
            count(len(chunk))
    return StudyPlan(batch, [each for chunk in chunks for each in facts[chunk]])


def _keep_facts(request: Request, chunk: Sequence[int]) -> list[CaseFacts]:
    return opened(request).keep_facts(chunk)


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
        seconds += float(sum(each + rate * plan.facts[number - 1].work / scale for number in numbers))
    return seconds
