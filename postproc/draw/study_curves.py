"""Curves of a study, one for each combination of the other varied values; many curves are coloured by value."""

from collections.abc import Mapping
from textwrap import fill
from typing import Any

import numpy as np
import pandas as pd
from pandas.api.types import is_numeric_dtype

from drivers.engines import REFERENCE
from postproc.draw.style import GREY, finish_bar, grey_of, value_colours
from postproc.read.labels import Label

SEED = "seed"  # column of random draws, which are scatter and not an axis
COLOURS = ("#0072b2", "#d55e00", "#009e73", "black", "#cc79a7", "#a34800", "#56b4e9")
DASHES = ("-", (0, (5, 1.5)), (0, (1, 1.2)), (0, (4, 1, 1, 1)), (0, (8, 2)), (0, (3, 1, 1, 1, 1, 1)))
MARKERS = "osD^v<>"
LOG_RATIO = 30  # of the largest to the smallest varied value: larger ratios get a logarithmic scale
MAX_CURVES = 8  # each with a colour of its own
MAX_TEXT_TICKS = 60
MAX_CHARACTERS = 24  # of a text value; of all ticks of a panel, else they are turned
WRAP = 32  # characters per line of an axis label


def swept_columns(table: pd.DataFrame) -> list[str]:
    """Columns of the varied values: between the number of the case and the engine."""
    names = list(table.columns)
    return names[1 : names.index("engine")]


def longest_axis(table: pd.DataFrame) -> str:
    """Varied column with most values; a number if there is one, random draws only if there is no other."""
    swept = swept_columns(table)
    numeric = [name for name in swept if is_numeric_dtype(table[name])]
    names = [name for name in numeric if name != SEED] or numeric or swept
    return max(names, key=lambda name: table[name].nunique())


def baseline_of(done: pd.DataFrame) -> str:
    """Engine that lines show: the reference, or without it the first one."""
    engines = [str(engine) for engine in done["engine"].unique()]
    return REFERENCE if REFERENCE in engines else engines[0]


def draw_curves(
    axes: Mapping[str, Any], numbers: pd.DataFrame, x: str, order: str, labels: Mapping[str, Label]
) -> tuple[pd.DataFrame, str]:
    """Draws a line of the baseline and markers of other engines for each combination of the other varied columns.

    Lines have gaps where an observable is NaN. With random draws they join the means, if x is a varied column.

    Args:
        axes: Axes by the column on their y axis.
        numbers: Finished rows of the table with the drawn columns.
        x: Column on all x axes.
        order: Varied column along a line; empty for points without lines.
        labels: Label of each column.

    Returns:
        The numbers, with means over draws, and the title of the legend.
    """
    swept, numbers = swept_columns(numbers), numbers.reset_index(drop=True)
    others = _varying(numbers, order, [name for name in swept if name != SEED]) if order else []
    of_baseline = baseline = baseline_of(numbers)
    mean = {name: name for name in axes}
    if SEED in swept and order:
        of_baseline, mean = f"mean of draws, {baseline}", {name: f"{name}_mean" for name in axes}
        groups = numbers.groupby([order, *others, "engine"], dropna=False, sort=False)
        numbers = numbers.assign(**{mean[name]: groups[name].transform("mean") for name in axes})
    parts = [part for _, part in numbers.groupby(others or (lambda _: 0), dropna=False, sort=False)]
    looks, title, bar = _looks(pd.concat([part[others].head(1) for part in parts], ignore_index=True), labels)
    first, small = next(iter(axes.values())), {"ms": 2.0, "mew": 0.5} if len(parts) > MAX_CURVES else {}
    if bar:
        finish_bar(first.figure.colorbar(bar, ax=[*axes.values()], pad=0.02, aspect=30), title)
    places = _mark_x([*axes.values()], numbers[x], labels[x])
    line = is_numeric_dtype(numbers[x]) and order  # text values have no line between them
    for number, (part, look) in enumerate(zip(parts, looks, strict=True)):
        words = look.pop("label") or (of_baseline if not number else None)
        if bar and words:  # the bar explains the colours, so the legend has grey lines
            first.plot([], [], label=words, **look | {"color": GREY})
        for engine, own in part.groupby("engine", sort=False):
            rows = own.sort_values(order) if line else own
            for name, axis in axes.items():
                factor = labels[name].axis(float(numbers[name].abs().max()))[1]
                if engine == baseline:
                    dots = rows if mean[name] == name else rows.drop_duplicates(order)
                    x_y = places[dots.index], dots[mean[name]] * factor
                    alone = _alone(x_y[0] + x_y[1]) if line and x == order else slice(None)
                    marker = (
                        {"marker": "o" if line else MARKERS[number % len(MARKERS)], "ms": 3, "markevery": alone}
                        if alone
                        else {}
                    )
                    axis.plot(*x_y, label=None if bar else words, **look | marker | ({} if line else {"ls": "none"}))
                if engine != REFERENCE:
                    once = str(engine) if not number and words != engine else None
                    axis.plot(places[rows.index], rows[name] * factor, label=once, **grey_of(str(engine)) | small)
    return numbers, "" if bar else title


def _looks(sets: pd.DataFrame, labels: Mapping[str, Label]) -> tuple[list[dict[str, Any]], str, Any]:
    """Plot keywords of each curve; title of the legend or the colour bar; colours for a bar, or None.

    Many curves are coloured by the number with most values if dashes suffice for the other columns. If not, the colours
    follow the order of the curves, and the legend lists all curves.

    Args:
        sets: Values of the columns that differ between curves, a row for each curve.
        labels: Label of each column.
    """
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import LogNorm, Normalize

    count, listed, title, bar = len(sets), [*sets], "", None
    colours: Any = [COLOURS[place % len(COLOURS)] for place in range(count)]
    dashes = pd.Series(range(count))
    if count > MAX_CURVES:
        colours, title = value_colours()(np.linspace(0, 1, count)), ", ".join(labels[name].words for name in sets)
        numeric = [name for name in sets if is_numeric_dtype(sets[name]) and sets[name].notna().all()]
        by = max(numeric, key=lambda name: sets[name].nunique(), default="")
        rest = _varying(sets, by, listed)
        found = sets.groupby(rest or (lambda _: 0), dropna=False, sort=False).ngroup()
        if by and found.max() < len(DASHES):
            title, factor = labels[by].axis(float(sets[by].abs().max()))
            low, high = factor * sets[by].min(), factor * sets[by].max()
            norm = LogNorm if low > 0 and high / low > LOG_RATIO else Normalize
            bar = ScalarMappable(norm(low, high), value_colours())
            colours, dashes, listed = bar.to_rgba(factor * sets[by]), found, rest
    looks = []
    for place, row in sets.iterrows():
        words = [
            f"{'' if title and not bar else labels[name].words} {_text(labels[name], row[name])}" for name in listed
        ]
        first = not bar or not (dashes[:place] == dashes[place]).any()
        label = ", ".join(map(str.strip, words)) if first else ""
        looks.append({"label": label, "color": colours[place], "ls": DASHES[dashes[place] % len(DASHES)], "lw": 1.1})
    return looks, title, bar


def _varying(table: pd.DataFrame, by: str, names: list[str]) -> list[str]:
    """Columns with several values in rows of equal ``by``."""
    groups = table.groupby(by or (lambda _: 0), dropna=False)
    return [name for name in names if name != by and groups[name].nunique(dropna=False).max() > 1]


def _text(label: Label, value: object) -> str:
    """Short text of a value; a key that is removed has none."""
    text = "none" if pd.isna(value) else label.value(value)
    return text if len(text) <= MAX_CHARACTERS else f"{text[: MAX_CHARACTERS - 1]}…"


def _alone(values: pd.Series) -> list[int]:
    """Places of numbers between gaps, which a line does not show."""
    seen = np.isfinite(np.pad(values.to_numpy(float), 1, constant_values=np.nan))
    return [int(place) for place in np.flatnonzero(seen[1:-1] & ~seen[:-2] & ~seen[2:])]


def _mark_x(axes: list[Any], values: pd.Series, label: Label) -> pd.Series:
    """Labels the x axes of a column and sets their scale; returns the places of the values on it."""
    numeric = is_numeric_dtype(values)
    words, factor = label.axis(float(values.abs().max())) if numeric else (label.words, 1.0)
    for axis in axes:
        axis.set_xlabel(fill(words, WRAP))
    if numeric:
        if values.min() > 0 and values.max() / values.min() > LOG_RATIO:
            for axis in axes:
                axis.set_xscale("log")
        places = values * factor
        for axis in axes:  # the same range, also where few values are seen
            axis.update_datalim([(places.min(), 0), (places.max(), 0)], updatey=False)
        return places
    codes, texts = pd.factorize(values, use_na_sentinel=False)
    shown = [_text(label, text) for text in texts]
    turned = 90 if sum(map(len, shown)) > MAX_CHARACTERS else 0
    step = -(-len(shown) // MAX_TEXT_TICKS)
    for axis in axes:
        axis.set_xticks(range(0, len(shown), step), shown[::step], rotation=turned, fontsize=7)
    return pd.Series(codes, values.index)
