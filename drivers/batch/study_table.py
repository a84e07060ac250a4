"""Tables of a study: one row for each case and engine, and the costs of these rows."""

from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any

import pandas as pd
from pyarrow.lib import ArrowException

from drivers.base import paths
from drivers.base.errors import InputError, RunError
from drivers.base.files import csv_of, parquet_in, read_sealed_file, sealed_file
from drivers.base.progress import say
from drivers.batch.store import StudyRow
from drivers.batch.study import read_study
from drivers.batch.study_cases import Batch

# times in s; the last one is that of the reference, for the error
COSTS = ("start_s", "engine_s", "loop_s", "workflow_s", "reference_s")
CASES = "cases_sha256"  # attribute of the table
FINISHED = ("done", "failed", "timeout")  # states of a row that has been run


def tables(batch: Batch) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Table of the numbers, which depend on the study only, and table of the costs, which vary between runs."""
    study = batch.study
    by_engine = {name: batch.rows_of(name) for name in study.engines}
    rows = [(place, name, by_engine[name][place]) for place in range(study.count) for name in study.engines]
    stored = [row for _, _, row in rows]
    keys: dict[str, list[Any]] = {"case": [place + 1 for place, _, _ in rows]}
    keys |= {name: [values[place] for place, _, _ in rows] for name, values in batch.values.items()}
    keys |= {"engine": [name for _, name, _ in rows]}
    absent = {name: "to do" if name in batch.runnable else "not installed" for name in study.engines}
    numbers = keys | {
        "status": [row.status if row else absent[name] for _, name, row in rows],
        "reason": [row.reason if row else "" for row in stored],
        "force_error_share": [row.force_error if row else None for row in stored],
    }
    for name in _observed(stored):
        if name in batch.values:
            raise InputError(study.where, "axis", f'"{name}", the name of an observable', "another name of the column")
        if any(fnmatchcase(name, glob) for glob in study.file.observables):
            numbers[name] = [row.values.get(name) if row else None for row in stored]
    work = [batch.facts(place + 1).work for place, _, _ in rows]
    costs = {"case": keys["case"], "engine": keys["engine"], "bodies_times_steps": work}
    costs |= {name: [row.cost[name] if row else None for row in stored] for name in COSTS}
    table = _frame(numbers, set(batch.values))
    table.attrs[CASES] = study.cases_sha256
    return table, _frame(costs, set())


def unmatched(batch: Batch) -> list[str]:
    """Patterns that match no observable of the rows; empty if there are no rows."""
    names = _observed([row for engine in batch.builds for row in batch.rows_of(engine)])
    patterns = batch.study.file.observables
    return [glob for glob in patterns if names and not any(fnmatchcase(name, glob) for name in names)]


def _observed(rows: list[StudyRow | None]) -> list[str]:
    """Names of all observables of some rows, in order of appearance."""
    return list(dict.fromkeys(name for row in rows if row for name in row.values))


def not_shown(batch: Batch) -> list[str]:
    """Lines on the observables of the table that some finished rows do not show, with the reason."""
    study, explain = batch.study, batch.request.not_shown
    rows = [row for engine in study.engines for row in batch.rows_of(engine) if row and row.done]
    names = [name for name in _observed([*rows]) if any(fnmatchcase(name, glob) for glob in study.file.observables)]
    return explain(names, [row.values for row in rows]) if explain else []


def write_tables(batch: Batch, results: Path) -> list[Path]:
    """Write the tables ``STUDY`` and ``STUDY-cost`` as ``.parquet`` and ``.csv``, each atomically.

    Raises:
        RunError: rows are to do or not installed, and the existing table has more rows done.
    """
    results.mkdir(parents=True, exist_ok=True)
    made, written, study = tables(batch), [], batch.study
    unfinished = not made[0]["status"].isin(FINISHED).all()
    done, done_before = _rows_done(made[0]), _rows_done_before(results / f"{study.name}.parquet")
    if unfinished and done < done_before:
        place = paths.shown(results / f"{study.name}.csv")
        raise RunError(
            f"table {place} kept: it has {done_before} rows done, this batch {done} of {len(made[0])}; "
            "--results DIR writes another table"
        )
    for table, name in zip(made, (study.name, f"{study.name}-cost"), strict=True):
        written += [results / f"{name}.parquet", results / f"{name}.csv"]
        with sealed_file(written[-2]) as draft:
            table.to_parquet(draft, index=False)
        with sealed_file(written[-1]) as draft:
            draft.write_bytes(csv_of(table))
    return written


def _read_table(path: Path, study: str | Path) -> pd.DataFrame:
    """Table of a batch; raises as ``read_study_table``, and FileNotFoundError."""
    allowed = f"the table that beads batch {study} writes"
    try:
        return parquet_in(read_sealed_file(path, allowed))
    except (ValueError, ArrowException) as error:
        raise InputError(paths.shown(path), "", "a damaged table", allowed) from error


def _rows_done_before(path: Path) -> int:
    """Rows done in the table of an earlier batch; 0 if it is missing or damaged."""
    try:
        return _rows_done(_read_table(path, path.stem))
    except FileNotFoundError:
        return 0
    except InputError as error:
        say(f"{error}: written again")
        return 0


def _rows_done(table: pd.DataFrame) -> int:
    return int((table["status"] == "done").sum())


def read_study_table(study: str | Path, results: str | Path | None = None) -> pd.DataFrame:
    """Read the table that a batch has written for a study, as its file is now.

    Args:
        study: Name of a study in ``inputs/studies``, or path of a study file.
        results: Folder of the tables; by default ``results/`` of the checkout.

    Returns:
        DataFrame: One row per case and engine: ``case``, the varied values in SI units, ``engine``, ``status``,
            ``reason``, ``force_error_share`` and the observables, whose names end in their units; NaN where a run
            does not show one.

    Raises:
        InputError: There is no study or no table of it, the table is damaged, or the cases have changed since;
            ``beads batch STUDY`` writes it.

    Examples:
        >>> table = read_study_table("wall-material", results=tables)
        >>> done = table[table["status"] == "done"]
        >>> print(done.groupby("wall.material")["wall_peak_N"].max().round(2).to_dict())
        {'brass': 16.37, 'glass': 16.33, 'ptfe': 14.37, 'rigid': 16.4, 'steel': 16.39}
    """
    path = Path(results or paths.RESULTS) / f"{Path(study).name.removesuffix('.toml')}.parquet"
    try:
        table = _read_table(path, study)
    except FileNotFoundError:
        raise InputError(paths.shown(path), "", f"table not found; run beads batch {study}") from None
    if table.attrs.get(CASES) != read_study(study).cases_sha256:
        raise InputError(
            paths.shown(path), "", f"a table of other cases than the study has now; run beads batch {study}"
        )
    return table


def _frame(columns: dict[str, list[Any]], free: set[str]) -> pd.DataFrame:
    """Table of numbers; a column of ``free`` that contains any text is converted to text."""
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
