"""Runs many cases side by side, one engine process per core."""

import os
import sys
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from drivers import paths
from drivers.case import Case
from drivers.engines import load_engine
from drivers.process import stop_all
from drivers.run import EndedRun, run_case


def run_many(jobs: Sequence[tuple[Case, str]], runs: Path = paths.RUNS) -> list[EndedRun]:
    """Runs pairs of a case and an engine, in their order; equal decks run once, what is done is found.

    Raises:
        RunError: an engine is not installed.
    """
    from tqdm import tqdm

    keys = [(engine, load_engine(engine).render(case).sha256) for case, engine in jobs]
    different = dict(zip(keys, jobs, strict=True))
    with ThreadPoolExecutor(max_workers=_cores()) as pool:
        try:
            under_way = {key: pool.submit(run_case, *job, runs) for key, job in different.items()}
            bar = tqdm(under_way.items(), unit="run", leave=False, disable=None, file=sys.stderr)
            ended = {key: future.result() for key, future in bar}
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            stop_all()
            raise
    return [ended[key] for key in keys]


def _cores() -> int:
    """How many cores this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
