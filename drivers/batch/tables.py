"""Tables of a study: one row for each case and engine, and the costs of these rows."""

from dataclasses import replace
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any

import pandas as pd

from drivers.base import paths
from drivers.base.errors import InputError
from drivers.base.files import whole_file
from drivers.base.progress import say
from drivers.batch.rows import Batch, Request, opened
from drivers.batch.store import Store, StudyRow
from drivers.engines import engine_names

# times in s; the last one is that of the reference, for the error
COSTS = ("start_s", "engine_s", "loop_s", "workflow_s", "reference_s")
Row = tuple[int, str, StudyRow | None]  # number of the case, engine, row


def rows_of(batch: Batch, store: Store, *, stale: bool = False) -> list[Row]:
    """Rows of all cases of a study on all its engines, None for missing ones; with ``stale`` also stale ones."""
    numbers = range(1, batch.study.count + 1)
    by_engine = {name: batch.rows(store, name, numbers, stale=stale) for name in batch.study.engines}
    return [(number, name, by_engine[name].get(number)) for number in numbers for name in batch.study.engines]


def tables(batch: Batch, rows: list[Row]) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Table of the numbers, which depend on the study only, and table of the costs, which vary between runs.

    Raises:
        InputError: the name of a column is that of an observable.
    """
    study, stored = batch.study, [row for *_, row in rows]
    values = [study.values(number) for number, *_ in rows]
    varied = {name: [row[name] for row in values] for name in values[0]}
    absent = {name: "to do" if name in batch.runnable else "not installed" for name in study.engines}
    keys = {"case": [number for number, *_ in rows], **varied, "engine": [name for _, name, _ in rows]}
    numbers = keys | {
        "status": [row.status if row else absent[name] for _, name, row in rows],
        "reason": [row.reason if row else "" for row in stored],
        "force_error_share": [row.force_error_share if row else None for row in stored],
    }
    for name in shown(batch, stored):
        if name in varied:
            raise InputError(study.where, "axis", f'"{name}", the name of an observable', "another name of the column")
        numbers[name] = [row.values.get(name) if row else None for row in stored]
    costs = {"case": keys["case"], "engine": keys["engine"]}
    costs |= {name: [getattr(row, name, None) for row in stored] for name in ("bodies_times_steps", *COSTS)}
    return _frame(numbers, set(varied)), _frame(costs, set())


def observed(rows: list[StudyRow | None]) -> list[str]:
    """Names of all observables of some rows, in order of appearance."""
    return list(dict.fromkeys(name for row in rows if row for name in row.values))


def shown(batch: Batch, rows: list[StudyRow | None]) -> list[str]:
    """Names of the observables of some rows that the study selects."""
    return [name for name in observed(rows) if any(fnmatchcase(name, glob) for glob in batch.study.file.observables)]


def write_tables(batch: Batch, rows: list[Row], results: Path) -> list[Path]:
    """Write the tables ``STUDY`` and ``STUDY-cost`` as ``.parquet`` and ``.csv``, each atomically."""
    results.mkdir(parents=True, exist_ok=True)
    name, written = batch.study.name, []
    for table, stem in zip(tables(batch, rows), (name, f"{name}-cost"), strict=True):
        written += [results / f"{stem}.parquet", results / f"{stem}.csv"]
        with whole_file(written[-2]) as draft:
            table.to_parquet(draft, index=False)
        with whole_file(written[-1]) as draft:
            table.to_csv(draft, index=False)
    return written


def read_study_table(study: str | Path, runs: str | Path | None = None) -> pd.DataFrame:
    """Read the rows of a study, as its file is now, from the database that batches write.

    The engines are those of the study, and further ones with rows. Rows of an earlier version of the program or of an
    engine count; a line on stderr tells their number.

    Args:
        study: Name of a study in ``inputs/studies``, or path of a study file.
        runs: Runs folder with the database; by default ``runs/`` of the checkout.

    Returns:
        DataFrame: One row per case and engine: ``case``, the varied values in SI units, ``engine``, ``status``,
            ``reason``, ``force_error_share`` and the observables, whose names end in their units; NaN where a run
            does not show one.

    Raises:
        InputError: There is no such study, there are no rows of it, or the database is damaged; ``beads batch STUDY``
            runs its cases.

    Examples:
        >>> table = read_study_table("wall-material", runs=runs)
        >>> done = table[table["status"] == "done"]
        >>> print(done.groupby("wall.material")["wall_peak_N"].max().round(2).to_dict())
        {'brass': 16.37, 'glass': 16.33, 'ptfe': 14.37, 'rigid': 16.4, 'steel': 16.39}
    """
    request = Request(study, Path(runs or paths.RUNS))
    swept = opened(request).study
    cases = [swept.case_sha256(number) for number in range(1, swept.count + 1)]
    with Store(request.runs) as store:
        further = [name for name in engine_names() if name not in swept.engines and store.states(name, cases)]
        batch = opened(replace(request, engines=tuple(further)))
        rows = rows_of(batch, store, stale=True)
    present = [row for *_, row in rows if row]
    if store.damaged:
        say(f"{len(store.damaged)} damaged rows in {paths.shown(store.common)} do not count; beads batch {study}")
    if not present:
        where = paths.shown(store.common)
        raise InputError(where, "", f"no rows of the study {batch.study.name} as it is now; run beads batch {study}")
    stale = sum(row.program != batch.programs[row.engine] for row in present)
    if stale:
        say(f"{stale} of {len(rows)} rows are of an earlier version of the program or an engine; beads batch {study}")
    return tables(batch, rows)[0]


def _is_number(value: Any) -> bool:
    """True for a number that a column of numbers can hold, and for a missing one."""
    return value is None or isinstance(value, float) or (type(value) is int and abs(value) < 2**63)


def _frame(columns: dict[str, list[Any]], free: set[str]) -> pd.DataFrame:
    """Table of numbers; a column of ``free`` with anything else is converted to text."""
    texts = {"engine", "status", "reason"}
    for name in free:
        if not all(map(_is_number, columns[name])):
            texts.add(name)
            columns[name] = [value if value is None else str(value) for value in columns[name]]
    return pd.DataFrame(
        {
            name: pd.Series(values, dtype=str if name in texts else None if name in {"case", *free} else float)
            for name, values in columns.items()
        }
    )
