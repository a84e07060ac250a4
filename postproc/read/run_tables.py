"""Tables of a finished run for notebooks and scripts: observables, contact forces, gauge signals."""

from collections.abc import Callable
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from pyarrow.csv import CSVWriter
from pyarrow.parquet import ParquetWriter

from drivers.base import paths
from drivers.base.errors import InputError
from drivers.base.files import whole_file
from drivers.chain.trace import BALANCES, BORE, BORE_FRICTION, CONTACT, Trace, part_of, table_of
from drivers.run.run_folder import EndedRun
from postproc.read import observables
from postproc.read.signals import sensor_signals

BLOCK = 1_000_000  # rows of a long table that are in memory together


def observe(run: EndedRun, levels: tuple[float, ...] = observables.LEVELS) -> "pd.Series[float]":
    """Observables of a run: peaks, arrival times, speeds, widths, reflections, energies.

    ``beads observables --definitions`` prints the definition of each.

    Args:
        run: A run from ``drivers.run_scene`` or ``drivers.open_run``.
        levels: Shares of the peak, between 0 and 1, at which durations and widths are cut.

    Returns:
        Series: Values in SI units by name; each name ends in its unit (``wall_peak_N``, ``speed_9_to_5_m_s``). Widths
            are in bead diameters. NaN where the run does not show the observable.

    Raises:
        InputError: The forces of the run are missing or damaged.

    Examples:
        >>> print(observe(run)["wall_peak_N"].round(2))
        16.37
    """
    return pd.Series(observables.observe(run.layout, run.trace, levels), name=run.record.scene_name)


def errors(run: EndedRun) -> pd.DataFrame:
    """Errors of a run: of forces, energy, momentum and every observable of the waves, relative to its true value.

    The true value is that of the scene as written, with all its elements.

    A run is assessed by ``validation.assess``, and by the commands ``run``, ``compare`` and ``report``.

    Args:
        run: A run from ``drivers.run_scene`` or ``drivers.open_run``.

    Returns:
        DataFrame: One row per quantity, named as in ``observe`` without the unit. ``whole`` is the signed error, the
            sum of ``model``, ``rounding``, ``truncation``, ``sampling`` and ``elements``, the effect of elements that
            the accuracy of the scene left out; ``where`` is contact and time of the largest error of the forces, the
            energy or the momentum.

    Raises:
        InputError: The run has not been assessed.

    Examples:
        >>> import validation
        >>> case, _ = validation.plan("fig4")
        >>> list(errors(validation.assess(run, case)).columns)
        ['whole', 'model', 'rounding', 'truncation', 'sampling', 'elements', 'where']
    """
    parts = ["whole", "model", "rounding", "truncation", "sampling", "elements"]
    if run.record.error_budget is None:
        raise InputError(paths.shown(run.folder), "", "no errors yet: call validation.assess(run, case) first")
    table = pd.DataFrame(run.record.error_budget, columns=["quantity", *parts, "where"])
    return table.fillna(dict.fromkeys(parts, 0.0)).set_index("quantity")


def forces(run: EndedRun, *, long: bool = False) -> pd.DataFrame:
    """Contact forces, energies and momentum of a run against time, a column for each contact of any chain.

    Args:
        run: A run from ``drivers.run_scene`` or ``drivers.open_run``.
        long: One row per sample and contact, with the contact forces alone.

    Returns:
        DataFrame: One row per sample, with ``time_s`` as index. ``contact_j_N`` is the force in contact j, which lies
            under body j, counted from the wall; compression is positive. If ``long``, the columns are ``time_s``,
            ``contact`` and ``force_N``.

    Raises:
        InputError: The forces of the run are missing or damaged.

    Examples:
        >>> print(forces(run)["contact_1_N"].max().round(2))
        16.37
    """
    return _long_forces(run.trace) if long else _wide_forces(run.trace)


def _long_forces(trace: Trace) -> pd.DataFrame:
    samples, contacts = trace.force_N.shape
    numbers = np.tile(np.arange(1, contacts + 1, dtype=np.int32), samples)
    columns = {"time_s": np.repeat(trace.time_s, contacts), "contact": numbers, "force_N": trace.force_N.ravel()}
    return pd.DataFrame(columns, copy=False)


def _wide_forces(trace: Trace) -> pd.DataFrame:
    balances = {name: getattr(trace, name) for name in BALANCES}
    columns = {CONTACT: trace.force_N, BORE: trace.bore_N, **balances, BORE_FRICTION: trace.bore_friction_N}
    there = {name: np.atleast_2d(values.T) for name, values in columns.items() if values is not None}
    named = {name.format(body): row for name, rows in there.items() for body, row in enumerate(rows, start=1)}
    return pd.DataFrame(named, pd.Index(trace.time_s, name="time_s"))


def write_table(run: EndedRun, path: Path, *, long: bool) -> Path:
    """Write the table of ``forces`` as Parquet or CSV, whole or not at all, ``long`` in blocks of samples.

    Parquet has units and scene in its metadata, and the usual compression, which R and Matlab read.

    Args:
        run: A run from ``drivers.run_scene`` or ``drivers.open_run``.
        path: File to be written, ``.parquet`` or ``.csv``; an older one is replaced.
        long: One row per sample and contact.

    Returns:
        Path: The file.

    Raises:
        InputError: The name of the file has another ending, or the forces of the run are missing or damaged.
    """
    writers: dict[str, Callable[..., Any]] = {".csv": CSVWriter, ".parquet": ParquetWriter}
    if path.suffix not in writers:
        raise InputError(str(path), "", f'the ending "{path.suffix}"', " or ".join(writers))
    samples, contacts = run.trace.force_N.shape
    block = max(1, BLOCK // contacts)
    parts = [part_of(run.trace, slice(start, start + block)) for start in range(0, samples, block)]
    frames = map(_long_forces, parts) if long else [_wide_forces(run.trace).reset_index()]
    tables = (table_of({str(name): values.to_numpy() for name, values in f.items()}, run.record.about) for f in frames)
    first = next(tables)
    with whole_file(path) as draft, writers[path.suffix](draft, first.schema) as writer:
        for table in chain([first], tables):
            writer.write_table(table)
    return path


def gauges(run: EndedRun) -> pd.DataFrame:
    """Forces that the gauges of a run show against time.

    Args:
        run: A run from ``drivers.run_scene`` or ``drivers.open_run``.

    Returns:
        DataFrame: One row per sample, with ``time_s`` as index; a column for each gauge, ``bead_9_N``, ...,
            ``wall_N``. A sensor bead shows the mean of its two contact forces, behind the electronics of the scene's
            ``sensor.time_constant``.

    Raises:
        InputError: The forces of the run are missing or damaged.

    Examples:
        >>> list(gauges(run).columns)
        ['bead_9_N', 'bead_5_N', 'wall_N']
    """
    columns = {f"{name}_N": signal for name, signal in sensor_signals(run.layout, run.trace).items()}
    return pd.DataFrame(columns, index=pd.Index(run.trace.time_s, name="time_s"))
