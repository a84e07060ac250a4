"""Tables of a study: one row for each case and engine, and the costs of these rows."""

from collections.abc import Iterable, Sequence
from dataclasses import replace
from fnmatch import fnmatchcase
from pathlib import Path

import pandas as pd

from drivers.base import paths
from drivers.base.errors import InputError
from drivers.base.files import whole_file
from drivers.base.terminal import say
from drivers.batch.rows import Batch, Row, rows_of
from drivers.batch.store import Store, StudyRow
from drivers.engines import engine_names

# times in s; the last one is that of the reference, for the error
COSTS = ("start_s", "engine_s", "loop_s", "workflow_s", "reference_s")


def tables(batch: Batch, rows: Sequence[Row]) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Table of the numbers, which depend on the study only, and table of the costs, which vary between runs."""
    values = pd.DataFrame([vars(row) for _, row in rows])
    texts, costs = ["engine", "status", "reason"], ["bodies_times_steps", *COSTS]
    values = values.astype(dict.fromkeys(texts, str) | dict.fromkeys(["force_error_share", *costs], float))
    cases = pd.DataFrame({"case": [number for number, _ in rows]})
    varied = pd.DataFrame([batch.study.values(number) for number in cases["case"]]).apply(_numbers_or_texts)
    numbers = [cases, varied, values[[*texts, "force_error_share"]], observables(batch, [row for _, row in rows])]
    return pd.concat(numbers, axis=1), pd.concat([cases, values[["engine", *costs]]], axis=1)


def observables(batch: Batch, rows: Iterable[StudyRow]) -> pd.DataFrame:
    """Observables of some rows that the study selects, in order of appearance."""
    table, globs = pd.DataFrame([row.values for row in rows], dtype=float), batch.study.file.observables
    return table[[name for name in map(str, table) if any(fnmatchcase(name, glob) for glob in globs)]]


def _numbers_or_texts(column: pd.Series) -> pd.Series:
    """Column of numbers; any other one, also of truth values or numbers beyond 64 bits, as texts."""
    if column.dtype.kind in "if" or column.isna().all():
        return column
    return column.map(str, na_action="ignore").astype(str)


def write_tables(batch: Batch, rows: Sequence[Row], results: Path) -> list[Path]:
    """Write the tables ``STUDY`` and ``STUDY-cost`` as ``.parquet`` and ``.csv``, each atomically."""
    results.mkdir(parents=True, exist_ok=True)
    name, written = batch.study.name, []
    for table, stem in zip(tables(batch, rows), (name, f"{name}-cost"), strict=True):
        for ending, write in (("parquet", table.to_parquet), ("csv", table.to_csv)):
            written.append(results / f"{stem}.{ending}")
            with whole_file(written[-1]) as draft:
                write(draft, index=False)
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
    batch = Batch(study, Path(runs or paths.RUNS))
    cases = batch.study.digests(range(1, batch.study.count + 1))
    with Store(batch.runs) as store:
        with_rows = {engine for _, engine in store.states(cases, {})}
        batch = replace(batch, selected=tuple(name for name in engine_names() if name in with_rows))
        rows = rows_of(batch, store, stale=True)
    present = [row for _, row in rows if row.program]
    if store.damaged:
        say(f"{len(store.damaged)} damaged rows in {paths.shown(store.common)} do not count; beads batch {study}")
    if not present:
        where = paths.shown(store.common)
        raise InputError(where, "", f"no rows of the study {batch.study.name} as it is now; run beads batch {study}")
    stale = sum(row.program != batch.programs[row.engine] for row in present)
    if stale:
        say(f"{stale} of {len(rows)} rows are of an earlier version of the program or an engine; beads batch {study}")
    return tables(batch, rows)[0]
