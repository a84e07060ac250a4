"""Progress of a batch: one bar, a line per failure, the state of each case, and the time to expect."""

import sys
from collections.abc import Iterator

from drivers.batch.store import Row, Store
from drivers.batch.study import Study
from drivers.batch.study_cases import StudyPlan

SPENT = ("start_s", "engine_s", "workflow_s", "reference_s")  # of a worker's time


def follow(under_way: Iterator[None], study: Study, plan: StudyPlan, awaited: set[str], store: Store) -> None:
    """Shows a bar over the rows that are awaited while a batch is under way; quiet where nobody looks on."""
    from tqdm import tqdm

    numbers = {identity: n for some in plan.identities.values() for n, identity in enumerate(some, start=1)}
    with tqdm(total=len(awaited), unit="row", leave=False, disable=None, file=sys.stderr) as bar:

        def update() -> None:
            for row in store.refresh():
                if row.identity in awaited:
                    awaited.discard(row.identity)
                    bar.update()
                    if not row.done and not bar.disable:  # else the summary tells it
                        bar.write(failure_line(study.label(numbers[row.identity]), row), file=sys.stderr)

        for _ in under_way:
            update()
        update()


def failure_line(label: str, row: Row) -> str:
    """A failed row of a case in one line."""
    return f"{label}: {row.engine} {row.status}: {row.reason}"


def states_on(engine: str, study: Study, plan: StudyPlan, store: Store, running: set[str]) -> dict[int, str]:
    """State of each case on an engine, by its number."""
    if engine not in plan.identities:
        return dict.fromkeys(range(1, study.count + 1), "not installed")

    def state(number: int, identity: str) -> str:
        row = store.rows.get(identity)
        if row is not None:
            return "done" if row.done else "failed"
        if identity in running:
            return "running"
        return "stale" if store.was_run(study.name, engine, study.label(number)) else "to do"

    return {number: state(number, each) for number, each in enumerate(plan.identities[engine], start=1)}


def expected_s(plan: StudyPlan, store: Store, todo: dict[str, list[int]]) -> float | None:
    """Seconds of one worker that some cases will take, by engine; None where nothing tells.

    A row costs so much by itself and so much per body and step; both are fitted to what the store's rows have cost,
    neither is negative.
    """
    import numpy as np
    from scipy.optimize import nnls

    seconds = 0.0
    for engine, numbers in todo.items():
        if not numbers:
            continue
        rows = [row for row in store.rows.values() if row.engine == engine and row.cost.get("engine_s")]
        if not rows:
            return None
        spent = np.array([sum(row.cost[name] or 0.0 for name in SPENT) for row in rows])
        work = np.array([float(row.work) for row in rows])
        scale = work.max() or 1.0
        each, rate = 0.0, spent.mean()
        if np.ptp(work):
            each, rate = nnls(np.column_stack([np.ones(len(work)), work / scale]), spent)[0]
        seconds += float(sum(each + rate * plan.work[number - 1] / scale for number in numbers))
    return seconds


def in_words(seconds: float) -> str:
    """A time as people say it."""
    if seconds < 100:
        return f"{seconds:.2g} s"
    return f"{seconds / 60:.0f} min" if seconds < 6000 else f"{seconds / 3600:.1f} h"
