"""The table of a study, a row per case and engine, and the table of what the rows cost."""

from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any

import pandas as pd

from drivers.base.files import whole_file
from drivers.batch.store import Row, Store
from drivers.batch.study import Study
from drivers.batch.study_cases import StudyPlan

COSTS = ("start_s", "engine_s", "loop_s", "workflow_s", "reference_s")  # the last: exact forces, for the error


def tables(study: Study, plan: StudyPlan, store: Store) -> tuple[pd.DataFrame, pd.DataFrame]:
    """The numbers, which depend on nothing but the study, and the costs, which differ from run to run."""
    by_engine = {name: plan.rows_of(store, name) for name in study.engines}
    rows = [(place, name, by_engine[name][place]) for place in range(study.count) for name in study.engines]
    found = [row for _, _, row in rows]
    keys: dict[str, list[Any]] = {"case": [place + 1 for place, _, _ in rows]}
    keys |= {name: [values[place] for place, _, _ in rows] for name, values in plan.values.items()}
    keys |= {"engine": [name for _, name, _ in rows]}
    absent = {name: "to do" if name in plan.identities else "not installed" for name in study.engines}
    numbers = keys | {
        "status": [row.status if row else absent[name] for _, name, row in rows],
        "reason": [row.reason if row else "" for row in found],
        "force_error_share": [row.force_error if row else None for row in found],
    }
    for name in _observed(found):
        if any(fnmatchcase(name, glob) for glob in study.file.observables):
            numbers[name] = [row.values.get(name) if row else None for row in found]
    costs = {"case": keys["case"], "engine": keys["engine"], "bodies_times_steps": [plan.work[p] for p, _, _ in rows]}
    costs |= {name: [row.cost[name] if row else None for row in found] for name in COSTS}
    return _frame(numbers, set(plan.values)), _frame(costs, set())


def unmatched(study: Study, plan: StudyPlan, store: Store) -> list[str]:
    """Patterns of observables that nothing is called like, as far as anything has been observed."""
    names = _observed([row for engine in plan.identities for row in plan.rows_of(store, engine)])
    return [glob for glob in study.file.observables if names and not any(fnmatchcase(name, glob) for name in names)]


def _observed(rows: list[Row | None]) -> list[str]:
    """Names of all observables of some rows, in the order in which they come."""
    return list(dict.fromkeys(name for row in rows if row for name in row.values))


def write_tables(study: Study, plan: StudyPlan, store: Store, results: Path) -> list[Path]:
    """Writes ``<study>.parquet`` and ``.csv``, and the costs beside them, each whole or not at all."""
    results.mkdir(parents=True, exist_ok=True)
    written = []
    for table, name in zip(tables(study, plan, store), (study.name, f"{study.name}-cost"), strict=True):
        for ending, write in (("parquet", table.to_parquet), ("csv", table.to_csv)):
            written.append(results / f"{name}.{ending}")
            with whole_file(written[-1]) as draft:
                write(draft, index=False)
    return written


def _frame(columns: dict[str, list[Any]], free: set[str]) -> pd.DataFrame:
    """A table of numbers; of the ``free`` columns those that hold any text hold nothing else."""
    texts = {"engine", "status", "reason"}
    for name in free:
        if any(isinstance(value, (str, bool)) for value in columns[name]):
            texts.add(name)
            columns[name] = [value if value is None else str(value) for value in columns[name]]
    return pd.DataFrame(
        {
            name: pd.Series(values, dtype=str if name in texts else None if name in {"case", *free} else float)
            for name, values in columns.items()
        }
    )
