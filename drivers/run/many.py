"""Runs many cases side by side, one engine process per core."""

import sys
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path

from drivers.base import paths
from drivers.base.errors import RunError
from drivers.base.processes import all_stopped, cores
from drivers.chain.case import Case
from drivers.engines import load_engine
from drivers.limits.refusal import refuse
from drivers.run.finished import EndedRun
from drivers.run.run import run_case


def run_many(jobs: Sequence[tuple[Case, str]], runs: Path = paths.RUNS) -> list[EndedRun]:
    """Runs pairs of a case and an engine, in their order; what is done is found.

    Equal decks run once: scenes that differ in their sensors alone share a folder, whose record is that of the last.

    Raises:
        RunError: an engine is not installed; what was under way has ended.
    """
    from tqdm import tqdm

    keys = [(engine, load_engine(engine).render(case).sha256) for case, engine in jobs]
    different = dict(zip(keys, jobs, strict=True))
    with workers(cores()) as pool:
        under_way = {key: pool.submit(run_case, *job, runs) for key, job in different.items()}
        bar = tqdm(under_way.items(), unit="run", leave=False, disable=None, file=sys.stderr)
        ended = {key: future.result() for key, future in bar}
    return [ended[key] for key in keys]


def run_all_done(jobs: Sequence[tuple[Case, str]], runs: Path = paths.RUNS) -> list[EndedRun]:
    """As ``run_many``, where every run is needed.

    Raises:
        InputError: a case cannot end well on its engine; nothing has been run.
        RunError: a run failed; the others are done all the same.
    """
    for case, engine in jobs:
        refuse(case, engine)
    ended = run_many(jobs, runs)
    failures = [
        f"{case.scene.file}: {engine} {run.record.status}: {run.record.reason}"
        for (case, engine), run in zip(jobs, ended, strict=True)
        if not run.done
    ]
    if failures:
        raise RunError(failures[0] + (f" (and {len(failures) - 1} more)" if len(failures) > 1 else ""))
    return ended


@contextmanager
def workers(count: int) -> Iterator[ThreadPoolExecutor]:
    """Threads that wait for engines: an error lets those under way end, an interrupt kills them."""
    with ThreadPoolExecutor(max_workers=count) as pool:
        try:
            yield pool
        except (KeyboardInterrupt, SystemExit):
            with all_stopped():
                pool.shutdown(cancel_futures=True)
            raise
        except BaseException:
            pool.shutdown(cancel_futures=True)
            raise
