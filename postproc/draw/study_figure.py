"""Figures of a study, drawn from its table: curves over what is swept, or a tornado of sensitivities."""

from itertools import product
from typing import Any

import numpy as np
import pandas as pd

from drivers.base.errors import InputError
from drivers.engines import REFERENCE
from postproc.draw.product import Product
from postproc.draw.style import COLUMN_IN, FAINT, line_of, marker_of, pyplot

LESS, MORE = "#56b4e9", "#d55e00"  # a tornado's bars
MARKERS = "osD^vPX*"
DECADES = 30  # ratio of swept values from which on their axis is logarithmic
SHAPES = {
    "s": "squares", "x": "crosses", "^": "triangles", "D": "diamonds", "+": "plus signs", "p": "pentagons",
    "h": "hexagons", "*": "stars", "v": "triangles upside down", "<": "triangles to the left",
}  # fmt: skip


def swept_columns(table: pd.DataFrame) -> list[str]:
    """The columns of the swept values: between the case's number and the engine."""
    names = list(table.columns)
    return names[1 : names.index("engine")]


def observable_columns(table: pd.DataFrame) -> list[str]:
    """The columns of the observables, behind everything else."""
    names = list(table.columns)
    return names[names.index("force_error_share") + 1 :]


def draw_study(table: pd.DataFrame, title: str, observables: tuple[str, ...], where: str) -> Product:
    """Observables, a panel each, against the swept column with most values, a curve for each set of the others.

    For random draws: how they scatter. A table that lacks one of the observables is an InputError.
    """
    _must_have(table, observables, where)
    swept, done = swept_columns(table), table[table["status"] == "done"]
    if not swept or done.empty:
        raise InputError(where, "", "nothing swept, or nothing done", "a finished batch of a study with axes")
    numeric = [name for name in swept if pd.api.types.is_numeric_dtype(table[name])]
    across = max(numeric or swept, key=lambda name: table[name].nunique())
    figure, axes = _panels(observables, 2, 2.5)
    if across == "seed":
        for name, axis in axes.items():
            for engine, values in done.groupby("engine", sort=False)[name]:
                line, told = line_of(str(engine)), f"{engine}: {values.mean():.5g} ± {values.std():.2g}"
                look = {"color": line.colour, "lw": line.width, "ls": line.dashes, "label": told}
                axis.hist(values, bins=15, histtype="step", **look)
            axis.set(xlabel=name, ylabel="draws")
            axis.legend(fontsize=6)
        figure.suptitle(title, fontsize=8)
    else:
        others = [name for name in swept if name != across and table.groupby(across)[name].nunique().max() > 1]
        groups: Any = done.groupby(others, dropna=False, sort=False) if others else [((), done)]
        for place, (values, part) in enumerate(groups):  # a colour each: lines of the reference, the codes' markers
            for engine, own in part.groupby("engine", sort=False):
                rows = own.sort_values(across) if across in numeric else own
                look = marker_of(str(engine)) | {"ls": "none"}
                if engine == REFERENCE:
                    look = {"color": f"C{place}", "lw": 1.0, "marker": MARKERS[place % len(MARKERS)], "ms": 3}
                    words = (f"{value:.4g}" if isinstance(value, float) else str(value) for value in values)
                    look["label"] = ", ".join(f"{other} {word}" for other, word in zip(others, words, strict=True))
                for name, axis in axes.items():
                    axis.plot(rows[across], rows[name], **look)
        for name, axis in axes.items():
            axis.set(xlabel=across, ylabel=name)
            if across in numeric and done[across].min() > 0 and done[across].max() / done[across].min() > DECADES:
                axis.set_xscale("log")
        if others:
            axes[observables[0]].legend(fontsize=6, loc="best")
        codes = [str(engine) for engine in done["engine"].unique() if engine != REFERENCE]
        marks = "".join(f", {code}: {SHAPES.get(line_of(code).marker, 'markers')}" for code in codes)
        figure.suptitle(f"{title}\nlines: {REFERENCE}; {marks.removeprefix(', ')}" if codes else title, fontsize=8)
    return Product(figure, done[["case", *swept, "engine", *observables]])


def draw_tornado(table: pd.DataFrame, title: str, observables: tuple[str, ...], where: str) -> Product:
    """How far each input moves each observable: one panel for each that is asked for, all of them in the numbers.

    Takes what ``draw_study`` takes, with a table of a study whose axes were varied one by one, the base first; one
    without its base is an InputError too.
    """
    _must_have(table, observables, where)
    engine = table["engine"].iloc[0]
    rows = table[(table["engine"] == engine) & (table["status"] == "done")]
    if rows.empty or rows["case"].iloc[0] != 1:
        raise InputError(where, "", f"no base case done on {engine}", "a finished batch")
    base = rows.iloc[0]
    found = []
    for (_, row), given in product(rows.iloc[1:].iterrows(), swept_columns(table)):
        if row[given] == base[given] or not isinstance(row[given], float | int) or not base[given]:
            continue
        change = row[given] / base[given] - 1
        for name in observable_columns(table):
            if base[name] and np.isfinite([row[name], base[name]]).all():
                share = row[name] / base[name] - 1
                found.append((name, given, change, share, share / change))
    columns = ["observable", "input", "input_change_share", "observable_change_share", "elasticity"]
    changes = pd.DataFrame(found, columns=columns)  # by the first engine, and their ratios
    if changes.empty:
        raise InputError(where, "axis", "no number that was varied", "a finished batch with numbers varied one by one")
    figure, axes = _panels(observables, min(2, len(observables)), 0.7 + 0.17 * changes["input"].nunique())
    for name, axis in axes.items():
        rows = changes[changes["observable"] == name]
        inputs = list(rows["observable_change_share"].abs().groupby(rows["input"]).max().sort_values().index)
        colours = np.where(rows["input_change_share"] > 0, MORE, LESS)
        places = [inputs.index(given) for given in rows["input"]]
        axis.barh(places, 100 * rows["observable_change_share"], color=colours, height=0.7)
        axis.set_yticks(range(len(inputs)), inputs, fontsize=7)
        axis.axvline(0, color=FAINT, lw=0.7)
        axis.set(title=name, xlabel="change, %")
        axis.grid(axis="y", visible=False)
    shares = sorted({round(100 * share, 6) for share in changes["input_change_share"]})
    bars = [pyplot().Rectangle((0, 0), 1, 1, color=LESS if share < 0 else MORE) for share in shares]
    axes[observables[0]].legend(bars, [f"input {share:+g} %" for share in shares], fontsize=6, loc="lower right")
    figure.suptitle(title, fontsize=8)
    return Product(figure, changes)


def _panels(names: tuple[str, ...], columns: int, height_in: float) -> tuple[Any, dict[str, Any]]:
    """A figure of panels of that height, and its axes by name."""
    rows = -(-len(names) // columns)
    size = (2 * COLUMN_IN, rows * height_in)
    figure, axes = pyplot().subplots(rows, columns, figsize=size, squeeze=False, layout="constrained")
    for axis in axes.flat[len(names) :]:
        axis.set_visible(False)
    return figure, dict(zip(names, axes.flat, strict=False))


def _must_have(table: pd.DataFrame, observables: tuple[str, ...], where: str) -> None:
    if not observables:
        raise InputError(where, "figure", "nothing", "the observables to draw")
    known = observable_columns(table)
    for name in (name for name in observables if name not in known):
        raise InputError(where, "figure", f'"{name}"', f"observables of the table: {', '.join(known) or 'none yet'}")
