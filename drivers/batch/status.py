"""What a batch tells while it runs and afterwards: one bar, a line per failure, counts, and the time to expect."""

import sys
from typing import Any

from drivers.batch.store import Row, Store
from drivers.batch.study import Study
from drivers.batch.study_plan import Plan

SPENT = ("start_s", "engine_s", "workflow_s", "reference_s")  # of a worker's time


class Progress:
    """A bar over the rows that are awaited; quiet where nobody looks on."""

    def __init__(self, study: Study, plan: Plan, awaited: set[str], store: Store) -> None:
        from tqdm import tqdm

        self.study = study
        self.numbers = {identity: n for some in plan.identities.values() for n, identity in enumerate(some, start=1)}
        self.awaited = awaited
        self.store = store
        self.bar: Any = tqdm(total=len(awaited), unit="row", leave=False, disable=None, file=sys.stderr)

    def update(self) -> None:
        """Takes up what has been finished since."""
        for row in self.store.refresh():
            if row.identity in self.awaited:
                self.awaited.discard(row.identity)
                self.bar.update()
                if not row.done and not self.bar.disable:  # else the summary tells it
                    self.bar.write(told(self.study.label(self.numbers[row.identity]), row), file=sys.stderr)

    def close(self) -> None:
        """Takes the bar away."""
        self.bar.close()


def told(label: str, row: Row) -> str:
    """A failed row of a case in one line."""
    return f"{label}: {row.engine} {row.status}: {row.reason}"


def states_on(engine: str, study: Study, plan: Plan, store: Store, running: set[str]) -> list[tuple[int, str]]:
    """Number and state of each case on an engine."""
    if engine not in plan.identities:
        return [(number, "not installed") for number in range(1, study.count + 1)]
    found = []
    for number, identity in enumerate(plan.identities[engine], start=1):
        row = store.rows.get(identity)
        if row is not None:
            state = "done" if row.done else "failed"
        elif identity in running:
            state = "running"
        elif store.was_run(study.name, engine, study.label(number)):
            state = "stale"
        else:
            state = "to do"
        found.append((number, state))
    return found


def expected_s(plan: Plan, store: Store, engine: str, places: list[int]) -> float | None:
    """Seconds of one worker that some cases will take, from what the store's rows have cost; None without any.

    A row costs so much by itself and so much per body and step; both are fitted, neither is negative.
    """
    if not places:
        return 0.0
    rows = [row for row in store.rows.values() if row.engine == engine and row.cost.get("engine_s")]
    if not rows:
        return None
    import numpy as np
    from scipy.optimize import nnls

    spent = np.array([sum(row.cost[name] or 0.0 for name in SPENT) for row in rows])
    work = np.array([float(row.work) for row in rows])
    scale = work.max()
    if np.ptp(work) == 0:
        each, rate = 0.0, float(spent.mean() / scale) if scale else 0.0
    else:
        each, rate = nnls(np.column_stack([np.ones(len(work)), work / scale]), spent)[0]
        rate /= scale
    return float(sum(each + rate * plan.work[place] for place in places))


def in_words(seconds: float) -> str:
    """A time as people say it."""
    if seconds < 100:
        return f"{seconds:.2g} s"
    return f"{seconds / 60:.0f} min" if seconds < 6000 else f"{seconds / 3600:.1f} h"
