"""Runs for tests: finished, failed, blown up."""

import os
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from drivers.base.files import read_sealed, sha256_of, write_sealed
from drivers.chain.case import SIDEWAYS, Case
from drivers.chain.trace import Trace
from drivers.engines import codes, load_engine
from drivers.limits import refuse
from drivers.run.run import run_case
from drivers.run.run_folder import FORCES, RECORD, EndedRun, record_of
from validation.accuracy.budget import assess, budget_of
from validation.accuracy.plan import planned_case
from validation.checks import Check
from validation.compare.comparison import ComparedScene, EngineSelection, compare_cases, missing
from validation.tests.helpers.scenes import case_of

TUBE_CODES = [name for name in codes() if load_engine(name).models >= SIDEWAYS]


def run_and_compare(
    source: str | Path,
    settings: tuple[str, ...] = (),
    *,
    runs: Path,
    asked: EngineSelection | None = None,
    unsafe: bool = False,
) -> ComparedScene:
    """Compared runs of one scene."""
    engines = (asked or EngineSelection()).names
    (compared,) = compare_cases([planned_case(source, *settings)], engines, runs, unsafe=unsafe)
    return compared


def need(engine: str) -> None:
    """Skip a test whose engine is not installed; fail it in CI, unless the engine is optional."""
    code = load_engine(engine)
    _need(engine, there=code.find() is not None, optional=code.entry.optional)


def need_program(name: str) -> None:
    """Skip a test whose program is not installed; fail it in CI."""
    _need(name, there=shutil.which(name) is not None)


def _need(name: str, *, there: bool, optional: bool = False) -> None:
    if not there and not optional and os.environ.get("CI"):
        pytest.fail(f"{name} is not installed, but required in CI")
    if not there:
        pytest.skip(f"{name} is not installed")


def finished(case: Case, engine: str, runs: Path) -> EndedRun:
    """Finished run of a case on an engine; the test fails if the run does."""
    need(engine)
    result = assessed(case, engine, runs)
    assert result.done, result.record.reason
    return result


def assessed(case: Case, engine: str, runs: Path) -> EndedRun:
    """Assessed run of a case; InputError if the case is refused."""
    refuse(case, engine)
    return assess(run_case(case, engine, runs), case)


def edit_record(folder: Path, **changes: Any) -> None:
    """Change keys of a record, which is sealed again; None removes a key."""
    record = read_sealed(folder / RECORD, "") | changes
    gone = {key for key, value in changes.items() if value is None}
    write_sealed(folder / RECORD, {key: value for key, value in record.items() if key not in gone})


def edit_table(folder: Path, change: Callable[[pd.DataFrame], pd.DataFrame], name: str = FORCES) -> None:
    """Change a table of a run, whose record is sealed again."""
    change(pd.read_parquet(folder / name)).to_parquet(folder / name)
    files = read_sealed(folder / RECORD, "")["files"]
    edit_record(folder, files=files | {name: sha256_of(folder / name)})


def add_force(table: pd.DataFrame, sample: int, contact: int, force_N: float) -> pd.DataFrame:
    """Table of forces with a change of a single force."""
    force = table[f"contact_{contact}_N"].to_numpy(copy=True)
    force[sample] += force_N
    return table.assign(**{f"contact_{contact}_N": force})


def checks_of(case: Case, runs: dict[str, EndedRun], absent: dict[str, str]) -> list[Check]:
    """Checks of finished runs by engine, from their traces in memory, and of absent engines with the reasons."""
    budgets = [budget_of(case, engine, run.trace) for engine, run in runs.items()]
    return [*missing(case, absent), *(check for budget in budgets for check in budget.checks)]


def blown_up(trace: Trace, sample: int) -> Trace:
    """Trace that blows up from a sample: too large in the wave, then NaN."""
    force = trace.force_N.copy()
    force[sample:, np.argmax(force[sample])] = 1e200
    force[sample + 2 :] = np.nan
    return replace(trace, force_N=force)


def failing_run(scene: Path, engine: str, runs: Path, limit_s: float = 60) -> tuple[str, str]:
    """Status and reason of a run that has to fail, after checking its run folder."""
    result = run_case(case_of(scene), engine, runs, limit_s=limit_s)
    stored = record_of(result.folder)
    assert (stored.status, stored.reason) == (result.record.status, result.record.reason)
    if FORCES in result.record.files:  # written before the fault
        assert np.isfinite(result.trace.force_N).all()
    assert not result.has_sensors
    assert [folder.name for folder in (runs / engine).iterdir() if folder.name[0] != "."] == [result.folder.name]
    return result.record.status, result.record.reason
