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
MAX_CHARACTERS = 24  # of a text value; of all texts on an axis, longer ones are turned
WRAP = 32  # characters per line of an axis label


def swept_columns(table: pd.DataFrame) -> list[str]:
    """Columns of the varied values: between the number of the case and the engine."""
    names = list(table.columns)
    return names[1 : names.index("engine")]


def baseline_of(done: pd.DataFrame) -> str:
    """Engine that lines show: the reference, or without it the first one."""
    engines = [str(engine) for engine in done["engine"].unique()]
    return REFERENCE if REFERENCE in engines else engines[0]


def draw_curves(
    axes: Mapping[str, Any], numbers: pd.DataFrame, x: str, order: str, labels: Mapping[str, Label]
) -> tuple[pd.DataFrame, str]:
    """Draws a line of the baseline and markers of the other engines for each combination of the other varied columns.

    Args:
        axes: Axes by the column on their y axis. Lines have gaps where it is NaN.
        numbers: Finished rows of the table with the drawn columns.
        x: Column on all x axes.
        order: Varied column along a line, which joins the means of random draws; empty for points without lines.
        labels: Label of each column.

    Returns:
        The numbers, with means over draws, and the title of the legend.
    """
    swept, numbers, baseline = swept_columns(numbers), numbers.reset_index(drop=True), baseline_of(numbers)
    others = _varying(numbers, order, [name for name in swept if name != SEED]) if order else []
    draws = SEED in swept and order
    mean = {name: f"{name}_mean" if draws else name for name in axes}
    if draws:
        groups = numbers.groupby([order, *others, "engine"], dropna=False, sort=False)
        numbers = numbers.assign(**{mean[name]: groups[name].transform("mean") for name in axes})
    parts = [part for _, part in numbers.groupby(others or (lambda _: 0), dropna=False, sort=False)]
    looks, title, bar = _looks(pd.concat([part[others].head(1) for part in parts], ignore_index=True), labels)
    looks[0]["label"] = looks[0]["label"] or (f"mean of draws, {baseline}" if draws else baseline)
    first, small = next(iter(axes.values())), {"ms": 2.0, "mew": 0.5} if len(parts) > MAX_CURVES else {}
    if bar:
        finish_bar(first.figure.colorbar(bar, ax=[*axes.values()], pad=0.02, aspect=30), title)
    places = _mark_x([*axes.values()], numbers[x], labels[x])
    line = bool(order) and all(
        is_numeric_dtype(numbers[name]) for name in (x, order)
    )  # text values have no line between them
    for number, (part, look) in enumerate(zip(parts, looks, strict=True)):
        words = look.pop("label")
        if bar and words:  # the bar explains the colours, so the legend has grey lines
            first.plot([], [], label=words, **look | {"color": GREY})
        for engine, own in part.groupby("engine", sort=False):
            rows = own.sort_values(order) if line else own
            for name, axis in axes.items():
                factor = labels[name].axis(float(numbers[name].abs().max()))[1]
                if engine == baseline:
                    dots = rows.drop_duplicates(order) if draws else rows
                    y = dots[mean[name]] * factor
                    marked = _between_gaps(places[dots.index] + y) if line and x == order else slice(None)
                    shape = {
                        "marker": "o" if line else MARKERS[number % len(MARKERS)],
                        "ms": small.get("ms", 3),
                        "markevery": marked,
                    }
                    look |= {} if line else {"ls": "none"}
                    axis.plot(places[dots.index], y, label="" if bar else words, **look | (shape if marked else {}))
                if engine != REFERENCE:
                    once = str(engine) if not number and words != engine else ""
                    axis.plot(places[rows.index], rows[name] * factor, label=once, **grey_of(str(engine)) | small)
    return numbers, "" if bar else title


def _looks(sets: pd.DataFrame, labels: Mapping[str, Label]) -> tuple[list[dict[str, Any]], str, Any]:
    """Plot keywords of each curve; title of the legend or the colour bar; colours by value for a bar, or None.

    Many curves are coloured by the number with most values if dashes suffice for the other columns. If not, the colours
    follow the order of the curves, and the legend lists all curves. ``sets`` has a row of varied values for each curve.
    """
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import LogNorm, Normalize

    names, title, bar, dashes = [*map(str, sets)], "", None, [*range(len(sets))]
    colours: Any = [COLOURS[place % len(COLOURS)] for place in dashes]
    if len(sets) > MAX_CURVES:
        title, colours = ", ".join(labels[name].words for name in names), value_colours()(np.linspace(0, 1, len(sets)))
        numeric = [name for name in names if is_numeric_dtype(sets[name]) and sets[name].notna().all()]
        by = max(numeric, key=lambda name: sets[name].nunique(), default="")
        rest = _varying(sets, by, names)
        codes = sets.groupby(rest or (lambda _: 0), dropna=False, sort=False).ngroup()
        if by and codes.max() < len(DASHES):
            title, factor = labels[by].axis(float(sets[by].abs().max()))
            ends = factor * sets[by].min(), factor * sets[by].max()
            bar = ScalarMappable((LogNorm if _is_wide(*ends) else Normalize)(*ends), value_colours())
            names, dashes, colours = rest, [*codes], bar.to_rgba(factor * sets[by].to_numpy())
    looks = []
    for place, row in enumerate(sets.to_dict("records")):
        keys = ["" if title and not bar else f"{labels[name].words} " for name in names]
        texts = [f"{key}{_text(labels[name], row[name])}" for key, name in zip(keys, names, strict=True)]
        label = ", ".join(texts) if dashes[place] not in dashes[:place] else ""
        looks.append({"label": label, "color": colours[place], "ls": DASHES[dashes[place] % len(DASHES)], "lw": 1.1})
    return looks, title, bar


def _is_wide(low: float, high: float) -> bool:
    return low > 0 and high / low > LOG_RATIO


def _varying(table: pd.DataFrame, by: str, names: list[str]) -> list[str]:
    """Columns with several values in rows of equal ``by``."""
    groups = table.groupby(by or (lambda _: 0), dropna=False)
    return [name for name in names if name != by and groups[name].nunique(dropna=False).max() > 1]


def _text(label: Label, value: Any) -> str:
    """Short text of a value; a removed key has none."""
    text = "none" if pd.isna(value) else label.value(value)
    return text if len(text) <= MAX_CHARACTERS else f"{text[: MAX_CHARACTERS - 1]}…"


def _between_gaps(values: pd.Series) -> list[int]:
    """Places of single numbers between gaps, which a line does not show."""
    seen = np.isfinite(np.pad(values.to_numpy(float), 1, constant_values=np.nan))
    return [int(place) for place in np.flatnonzero(seen[1:-1] & ~seen[:-2] & ~seen[2:])]


def _mark_x(axes: list[Any], values: pd.Series, label: Label) -> pd.Series:
    """Labels x axes and gives them a scale and the range of the values; returns the places of the values."""
    numeric, words = is_numeric_dtype(values), label.words
    places = pd.Series(pd.factorize(values, use_na_sentinel=False)[0], values.index)
    if numeric:
        words, factor = label.axis(float(values.abs().max()))
        places = values * factor
    texts = [] if numeric else [_text(label, text) for text in values.unique()]
    step = -(-len(texts) // MAX_TEXT_TICKS)
    for axis in axes:
        axis.set_xlabel(fill(words, WRAP))
        axis.update_datalim([(places.min(), 0), (places.max(), 0)], updatey=False)
        if _is_wide(places.min(), places.max()) and numeric:
            axis.set_xscale("log")
        if texts:
            turned = 90 if sum(map(len, texts)) > MAX_CHARACTERS else 0
            axis.set_xticks(range(0, len(texts), step), texts[::step], rotation=turned, fontsize=7)
    return places
