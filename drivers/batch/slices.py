"""The one door for schedulers: a slice of a study, run in this process."""

import time
from collections.abc import Sequence
from pathlib import Path

from drivers.batch.selection import select
from drivers.batch.store import Row, Store
from drivers.batch.study import read_study
from drivers.batch.study_cases import versions_of
from drivers.batch.study_plan import plan_part
from drivers.batch.worker import CHUNK, run_cases

POLL_S = 0.5


def run_slice(
    source: Path,
    part: int,
    parts: int,
    runs: Path,
    *,
    engines: Sequence[str] = (),
    patterns: Sequence[str] = (),
    retry: bool = False,
) -> list[Row]:
    """Runs what is not done of part I of N of a study, and returns when all of it is done or failed.

    Safe to be called twice, to be killed, and to be called again; every case of the slice is validated first.

    Args:
        source: path of the study file.
        part: from 1 to ``parts``.
        parts: into how many the selected cases are dealt.
        runs: the runs folder, the same for all parts.
        engines: of the study; all where there are none.
        patterns: that select cases; all where there are none.
        retry: run failed cases again.

    Returns:
        The rows of the slice.

    Raises:
        InputError: the study or a case of the slice is wrong.
        OSError: the disk is full, or something else is wrong with the runs folder.
    """
    retry_before = time.time() if retry else 0.0
    study, store = read_study(source), Store(runs)
    selection = select(study, engines, patterns)
    numbers = selection.slice_of(part, parts)
    versions = versions_of(selection.engines, runs)
    plan = plan_part(study, numbers, versions)
    left = list(numbers)
    while left:
        chunks = [left[start : start + CHUNK] for start in range(0, len(left), CHUNK)]
        left = run_cases(study, chunks, selection.engines, versions, store, retry_before)
        if left:  # another process is at work on them
            time.sleep(POLL_S)
    store.refresh()
    return [row for name in selection.engines if name in versions for row in plan.rows_of(store, name) if row]
