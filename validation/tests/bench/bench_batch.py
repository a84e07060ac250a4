"""Cost of batches: many cases in one process against a process for each case."""

import contextlib
import io
import os
import tempfile
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pandas as pd

from drivers.base.processes import run_command
from drivers.batch.rows import WORKER_COSTS
from drivers.chain.case import build_case
from drivers.engines import installed_codes, load_engine
from drivers.run.execute import Place
from drivers.scene.read_scene import read_scene
from validation.commands.batch_answers import run_study, status
from validation.commands.batch_commands import batch_of, functions

WORKERS = 2
SINGLE_CASES = 12
CODE_CASES, IN_REPO_CASES = 300, 3000
LISTED = 10_000

STUDY = """
scene = "fig4"
engines = [{engines}]
set = {{ "run.time_step" = "0.1 us" }}
[[axis]]
key = "striker.speed"
from = "1.9 m/s"
to = "2.1 m/s"
count = {cases}
"""


def bench_batch() -> None:
    """Print cases per second on Fig. 4 at 0.1 us, the workflow's share, and the time to list many cases."""
    print(
        f"\nbatches of Fig. 4 at 0.1 us on {WORKERS} workers, including start, tables and errors against the reference"
    )
    print(f"{'engine':<20} {'cases':>6} {'a process each':>15} {'in a batch':>12} {'ratio':>6} {'workflow':>9}")
    for name in installed_codes():
        alone = _rate_alone(name)
        rate, share = _rate_in_batch((name,), CODE_CASES)
        print(f"{name:<20} {CODE_CASES:6} {alone:13.1f}/s {rate:10.0f}/s {rate / alone:6.1f} {share:9.0%}")
    for names in (("verlet",), ("reference",), ("reference", "verlet")):
        rate, share = _rate_in_batch(names, IN_REPO_CASES)
        print(f"{', '.join(names):<20} {IN_REPO_CASES:6} {'':>15} {rate:10.0f}/s {'':>6} {share:9.0%}")
    print(f"status of {LISTED} finished cases: {_listing_s():.2f} s")


def _rate_alone(name: str) -> float:
    """Cases per second with an engine process for each, without rendering, reading or storing."""
    engine = load_engine(name)
    build = engine.find()
    assert build is not None
    deck = engine.render(build_case(read_scene("fig4", ("run.time_step=0.1 us",))))
    with tempfile.TemporaryDirectory() as home, ThreadPoolExecutor(WORKERS) as pool:
        folders = [Path(home, str(number)) for number in range(SINGLE_CASES)]
        for folder in folders:
            folder.mkdir()
            deck.write(folder)
        command = engine.started(deck, build)
        began = time.perf_counter()
        list(pool.map(lambda folder: run_command(command, folder, 60.0, **engine.environment), folders))
        return SINGLE_CASES / (time.perf_counter() - began)


def _rate_in_batch(names: tuple[str, ...], cases: int) -> tuple[float, float]:
    """Rows per second of a whole batch, and the workflow's share of the workers' time."""
    with tempfile.TemporaryDirectory() as home:
        study = _study(Path(home), names, cases)
        began = time.perf_counter()
        _quietly(study, Path(home))
        took = time.perf_counter() - began
        spent = pd.read_parquet(Path(home, "bench-cost.parquet"))
        own = spent["workflow_s"].sum()
        return len(spent) / took, own / spent[list(WORKER_COSTS)].sum().sum()


def _listing_s() -> float:
    """Time of ``status`` in s, from a database with rows of many cases."""
    with tempfile.TemporaryDirectory() as home:
        study = _study(Path(home), ("verlet",), LISTED)
        _quietly(study, Path(home))
        began = time.perf_counter()
        with contextlib.redirect_stdout(io.StringIO()):
            status(batch_of(study, Path(home, "runs")), every=True)
        return time.perf_counter() - began


def _study(home: Path, names: tuple[str, ...], cases: int) -> Path:
    path = home / "bench.toml"
    path.write_text(STUDY.format(engines=", ".join(f'"{name}"' for name in names), cases=cases))
    return path


def _quietly(study: Path, home: Path) -> None:
    with open(os.devnull, "w") as nowhere, contextlib.redirect_stdout(nowhere):
        batch = batch_of(study, home / "runs", **functions())
        code = run_study(batch, home, Place(WORKERS, processes=True))
    if code:
        raise RuntimeError("a case of the benchmark failed")
