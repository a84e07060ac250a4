"""One column of a study's table against another, with fitted power laws."""

from collections.abc import Mapping
from textwrap import fill
from typing import Any

import numpy as np
import pandas as pd
from pandas.api.types import is_numeric_dtype

from drivers.base.errors import InputError
from postproc.draw.product import Product
from postproc.draw.study_curves import SEED, WRAP, draw_curves, longest_axis, swept_columns
from postproc.draw.study_figure import finish, panels
from postproc.draw.style import grey_of
from postproc.read.labels import Label, observable_label
from postproc.read.observables import without_unit

TEXTS = ("engine", "status", "reason")  # columns that are on no axis
MIN_ROWS = 3  # of a fit


def column_of(table: pd.DataFrame, given: str, option: str, columns: Mapping[str, str], *, texts: bool) -> str:
    """Column of a study's table by its name with or without the unit.

    Args:
        table: Table of a study.
        given: Name of the column.
        option: Option for messages.
        columns: Columns of the varied keys by their names without unit.
        texts: True to allow a varied key with text values.

    Raises:
        InputError: The table has no such column.
    """
    allowed = [name for name in table if name not in TEXTS and (texts or is_numeric_dtype(table[name]))]
    names = {without_unit(name): name for name in allowed} | {**columns} | {name: name for name in allowed}
    if names.get(given) not in allowed:
        raise InputError(option, "", f'"{given}"', f"{'columns' if texts else 'numbers'}: {', '.join(allowed)}")
    return names[given]


def draw_relation(
    table: pd.DataFrame, title: str, x: str, y: str, keys: Mapping[str, Label], *, joined: bool, log: bool, fitted: bool
) -> Product:
    """One column against another: a line through the points of the reference, and markers of the other engines.

    Args:
        table: Table of a study.
        title: Title of the figure.
        x: Column on the x axis; numbers if ``log`` or ``fitted``.
        y: Column of numbers on the y axis.
        keys: Labels of the varied columns.
        joined: False for points without lines. Random draws have none.
        log: True for logarithmic axes, without the rows that are not above zero.
        fitted: True for a power law of each engine.

    Raises:
        InputError: No finished row has both values, or too few have for a fit.
    """
    swept, done = swept_columns(table), table[table["status"] == "done"]
    seen = done[[x, y]].notna().all(axis=1)
    above = (done[[x, y]] > 0).all(axis=1) if log or fitted else seen
    if not seen.any() or (log and not above.any()):
        raise InputError(f"--x {x} --y {y}", "", f"no finished row with both{' above zero' if log else ''}")
    numbers = done[list(dict.fromkeys(["case", *swept, "engine", x, y]))]
    numbers = numbers.assign(**{y: numbers[y].where(above if log else seen)})
    figure, axes = panels((y,), title, across=table[x])
    labels = {name: observable_label(name) for name in (x, y)} | {**keys}
    order = (x if x in swept else longest_axis(table)) if joined and swept and SEED not in swept else ""
    numbers, legend = draw_curves(axes, numbers, x, order, labels)
    words, factor = labels[y].axis(float(numbers[y].abs().max()))
    axes[y].set_ylabel(fill(words, WRAP))
    notes = [f"{(seen & ~above).sum()} rows are not above zero, so not on the logarithmic axes"]
    notes = notes if log and (seen & ~above).any() else []
    x_factor = labels[x].axis(float(done[x].abs().max()))[1] if fitted else 1.0
    for engine, rows in done.groupby("engine", sort=False) if fitted else ():
        own = rows[above[rows.index]]
        constant, exponent, error = _power_law(own[x], own[y], str(engine))
        left = f"; {len(rows) - len(own)} not above zero or not seen" if len(own) < len(rows) else ""
        notes.append(
            f"{engine}: {y} = {constant:.4g} x^{exponent:.4g}, exponent {exponent:.4g} ± {error:.1g} "
            f"({len(own)} rows{left})"
        )
        ends = np.geomspace(own[x].min(), own[x].max(), 100)
        look = {"color": grey_of(str(engine))["color"], "ls": (0, (6, 3)), "lw": 0.9}
        axes[y].plot(ends * x_factor, constant * ends**exponent * factor, label=f"{engine}: x^{exponent:.4g}", **look)
    for which in "xy" if log else "":
        _make_logarithmic(axes[y], which)
    finish(figure, axes, done.assign(**{y: done[y].where(seen)}), legend)
    return Product(figure, numbers, notes=notes)


def _power_law(x: pd.Series, y: pd.Series, engine: str) -> tuple[float, float, float]:
    """Constant, exponent and its standard error of ``y = C x^n``, by least squares of the logarithms."""
    from scipy.stats import linregress

    if len(x) < MIN_ROWS or x.nunique() == 1:
        found = f"{len(x)} rows of {engine} above zero with {x.nunique()} different x"
        raise InputError("--power-law", "", found, f"at least {MIN_ROWS} rows and 2 different x")
    fit = linregress(np.log(x), np.log(y))
    return float(np.exp(fit.intercept)), float(fit.slope), float(fit.stderr)


def _make_logarithmic(axis: Any, which: str) -> None:
    """Makes the x or y axis logarithmic; within a decade its ticks are plain numbers, since powers overlap."""
    from matplotlib.ticker import MaxNLocator, NullFormatter, ScalarFormatter

    axis.set(**{f"{which}scale": "log"})
    low, high = axis.get_xlim() if which == "x" else axis.get_ylim()
    if high / low < 10:
        ticks = axis.xaxis if which == "x" else axis.yaxis
        ticks.set_major_locator(MaxNLocator(4))
        ticks.set_major_formatter(ScalarFormatter())
        ticks.set_minor_formatter(NullFormatter())
