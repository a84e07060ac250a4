"""Planning of studies: facts of all cases, and the time that the missing rows will take."""

from collections.abc import Iterator, Sequence
from functools import partial

from drivers.base.progress import counted
from drivers.batch.study_cases import CHUNK, Batch, CaseFacts, Request, opened
from drivers.run.execute import Place, execute

WORKER_COSTS = ("start_s", "engine_s", "workflow_s", "reference_s")  # they add up to a worker's time
MIN_PARALLEL_CASES = 500  # from this number on, workers share the planning


def validate_cases(batch: Batch, workers: int) -> None:
    """Read or compute the facts of all cases of a study, by several workers if it is large.

    The facts of each chunk of cases are kept when they are computed, so that planning continues after a kill.

    Raises:
        InputError: a case is wrong or refused.
    """
    left = [chunk for chunk in batch.chunks() if not batch.recall_facts(chunk)]
    under_way: Iterator[tuple[Sequence[int], list[CaseFacts]]]
    if len(left) * CHUNK < MIN_PARALLEL_CASES or workers == 1:
        under_way = ((chunk, batch.keep_facts(chunk)) for chunk in left)
    else:
        under_way = execute(partial(_keep_facts, batch.request), left, Place(workers, processes=True))
    with counted("cases validated", sum(map(len, left)), "case") as count:
        for chunk, facts in under_way:
            batch.known.update(zip(chunk, facts, strict=True))
            count(len(chunk))


def _keep_facts(request: Request, chunk: Sequence[int]) -> list[CaseFacts]:
    return opened(request).keep_facts(chunk)


def expected_s(batch: Batch, todo: dict[str, list[int]]) -> float | None:
    """Expected time in s of one worker for some cases by engine; None without any finished row.

    A row costs a constant plus a time proportional to bodies times steps; both are fitted to stored rows.
    """
    import numpy as np
    from scipy.optimize import nnls

    seconds = 0.0
    for engine, numbers in todo.items():
        if not numbers:
            continue
        rows = [row for row in batch.store.rows.values() if row.engine == engine and row.cost.get("engine_s")]
        if not rows:
            return None
        spent = np.array([sum(row.cost[name] or 0.0 for name in WORKER_COSTS) for row in rows])
        work = np.array([float(row.work) for row in rows])
        scale = work.max() or 1.0
        constant, rate = 0.0, spent.mean()
        if np.ptp(work):
            constant, rate = nnls(np.column_stack([np.ones(len(work)), work / scale]), spent)[0]
        seconds += float(sum(constant + rate * batch.facts(number).work / scale for number in numbers))
    return seconds
