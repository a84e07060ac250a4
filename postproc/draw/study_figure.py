"""Figures of a study, drawn from its table: curves over what is swept, or a tornado of sensitivities."""

from typing import Any

import numpy as np
import pandas as pd

from drivers.base.errors import InputError
from postproc.draw.product import Product
from postproc.draw.style import COLUMN_IN, FAINT, line_of, marker_of, pyplot

LESS, MORE = "#56b4e9", "#d55e00"  # a tornado's bars
MARKERS = "osD^vPX*"


def swept_columns(table: pd.DataFrame) -> list[str]:
    """The columns of the swept values: between the case's number and the engine."""
    names = list(table.columns)
    return names[1 : names.index("engine")]


def observable_columns(table: pd.DataFrame) -> list[str]:
    """The columns of the observables, behind everything else."""
    names = list(table.columns)
    return names[names.index("force_error_share") + 1 :]


def draw_study(table: pd.DataFrame, title: str, observables: tuple[str, ...], where: str) -> Product:
    """Observables against the swept column with most values, a curve for each set of the others.

    Args:
        table: of a study.
        title: of the figure.
        observables: one panel each.
        where: the study as messages name it.

    Raises:
        InputError: the table lacks one of the observables.
    """
    _must_have(table, observables, where)
    swept = swept_columns(table)
    if not swept or not (table["status"] == "done").any():
        raise InputError(where, "", "nothing swept, or nothing done", "a finished batch of a study with axes")
    numeric = [name for name in swept if pd.api.types.is_numeric_dtype(table[name])]
    counts = {name: table[name].nunique() for name in numeric or swept}
    across = max(counts, key=lambda name: counts[name])
    others = [name for name in swept if name != across and table.groupby(across)[name].nunique().max() > 1]
    plt = pyplot()
    size = (2 * COLUMN_IN, 2.5 * ((len(observables) + 1) // 2))
    figure, axes = plt.subplots((len(observables) + 1) // 2, 2, figsize=size, squeeze=False, layout="constrained")
    done = table[table["status"] == "done"]
    groups = list(done.groupby(others, dropna=False, sort=False)) if others else [((), done)]
    for axis, name in zip(axes.flat, observables, strict=False):
        if across == "seed":
            _draw_spread(axis, done, name)
            continue
        for place, (values, part) in enumerate(groups):
            for engine, rows in part.groupby("engine", sort=False):
                ordered = rows.sort_values(across) if across in numeric else rows
                _draw_curve(axis, ordered, across, name, str(engine), place, _label(others, values))
        axis.set(xlabel=across, ylabel=name)
        if across in numeric and _spans_decades(done[across]):
            axis.set_xscale("log")
    for axis in axes.flat[len(observables) :]:
        axis.set_visible(False)
    if others and across != "seed":
        axes.flat[0].legend(fontsize=6, loc="best")
    figure.suptitle(title if across == "seed" else _subtitle(title, done), fontsize=8)
    return Product(figure, done[["case", *swept, "engine", *observables]])


def draw_tornado(table: pd.DataFrame, title: str, observables: tuple[str, ...], where: str) -> Product:
    """How far each input moves each observable: one panel for each that is asked for, all of them in the numbers.

    Args:
        table: of a study whose axes were varied one by one; its first case is the base.
        title: of the figure.
        observables: one panel each.
        where: the study as messages name it.

    Raises:
        InputError: the table lacks one of the observables or its base.
    """
    _must_have(table, observables, where)
    changes = sensitivities(table, where)
    if changes.empty:
        raise InputError(where, "axis", "no number that was varied", "a finished batch with numbers varied one by one")
    plt = pyplot()
    columns = min(2, len(observables))
    lines = -(-len(observables) // columns)
    inputs = changes["input"].nunique()
    figure, axes = plt.subplots(
        lines, columns, figsize=(2 * COLUMN_IN, lines * (0.7 + 0.17 * inputs)), squeeze=False, layout="constrained"
    )
    for axis, name in zip(axes.flat, observables, strict=False):
        rows = changes[changes["observable"] == name]
        widest = rows.groupby("input")["observable_change_share"].agg(lambda values: np.abs(values).max()).sort_values()
        for height, given in enumerate(widest.index):
            for _, row in rows[rows["input"] == given].iterrows():
                colour = MORE if row["input_change_share"] > 0 else LESS
                axis.barh(height, 100 * row["observable_change_share"], color=colour, height=0.7)
        axis.set_yticks(range(len(widest)), list(widest.index), fontsize=7)
        axis.axvline(0, color=FAINT, lw=0.7)
        axis.set(title=name, xlabel="change, %")
        axis.grid(axis="y", visible=False)
    for axis in axes.flat[len(observables) :]:
        axis.set_visible(False)
    shares = sorted({round(100 * share, 6) for share in changes["input_change_share"]})
    bars = [plt.Rectangle((0, 0), 1, 1, color=LESS if share < 0 else MORE) for share in shares]
    axes.flat[0].legend(bars, [f"input {share:+g} %" for share in shares], fontsize=6, loc="lower right")
    figure.suptitle(title, fontsize=8)
    return Product(figure, changes)


def sensitivities(table: pd.DataFrame, where: str) -> pd.DataFrame:
    """Relative change of each observable for each change of an input, and their ratio, by the first engine.

    Raises:
        InputError: the base case is not done.
    """
    engine = table["engine"].iloc[0]
    rows = table[(table["engine"] == engine) & (table["status"] == "done")]
    if rows.empty or rows["case"].iloc[0] != 1:
        raise InputError(where, "", f"no base case done on {engine}", "a finished batch")
    base = rows.iloc[0]
    found: list[dict[str, Any]] = []
    for _, row in rows.iloc[1:].iterrows():
        for given in swept_columns(table):
            if row[given] == base[given] or not isinstance(row[given], float | int) or not base[given]:
                continue
            change = row[given] / base[given] - 1
            for name in observable_columns(table):
                if not base[name] or not np.isfinite(row[name]) or not np.isfinite(base[name]):
                    continue
                share = row[name] / base[name] - 1
                found.append(
                    {
                        "observable": name,
                        "input": given,
                        "input_change_share": change,
                        "observable_change_share": share,
                        "elasticity": share / change,
                    }
                )
    return pd.DataFrame(found)


def _must_have(table: pd.DataFrame, observables: tuple[str, ...], where: str) -> None:
    known = observable_columns(table)
    for name in observables:
        if name not in known:
            raise InputError(
                where, "figure", f'"{name}"', f"observables of the table: {', '.join(known) or 'none yet'}"
            )
    if not observables:
        raise InputError(where, "figure", "nothing", "the observables to draw")


def _draw_curve(axis: Any, rows: pd.DataFrame, across: str, name: str, engine: str, place: int, label: str) -> None:
    reference = engine == "reference"
    if reference:
        axis.plot(rows[across], rows[name], color=f"C{place}", lw=1.0, marker=MARKERS[place % len(MARKERS)], ms=3)
        axis.lines[-1].set_label(label)
    else:
        style = marker_of(engine) | {"color": line_of(engine).colour}
        axis.plot(rows[across], rows[name], ls="none", **style)


def _draw_spread(axis: Any, rows: pd.DataFrame, name: str) -> None:
    """How an observable scatters over random draws, on each engine."""
    for engine, values in rows.groupby("engine", sort=False)[name]:
        line = line_of(str(engine))
        told = f"{engine}: {values.mean():.5g} ± {values.std():.2g}"
        axis.hist(values, bins=15, histtype="step", color=line.colour, lw=line.width, ls=line.dashes, label=told)
    axis.set(xlabel=name, ylabel="draws")
    axis.legend(fontsize=6)


def _label(names: list[str], values: Any) -> str:
    values = values if isinstance(values, tuple) else (values,)
    told = (f"{value:.4g}" if isinstance(value, float) else str(value) for value in values)
    return ", ".join(f"{name} {value}" for name, value in zip(names, told, strict=True))


def _spans_decades(values: pd.Series) -> bool:
    return bool(values.min() > 0 and values.max() / values.min() > 30)


def _subtitle(title: str, table: pd.DataFrame) -> str:
    codes = [engine for engine in table["engine"].unique() if engine != "reference"]
    return f"{title}\nlines: reference; {', '.join(codes)}: squares, crosses" if codes else title
