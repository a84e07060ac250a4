"""Figures of a study from its table: curves over the varied values, or a tornado chart of sensitivities."""

from collections.abc import Mapping
from itertools import product
from textwrap import fill
from typing import Any

import numpy as np
import pandas as pd

from drivers.base.errors import InputError
from drivers.engines import REFERENCE
from postproc.draw.product import Product
from postproc.draw.style import COLUMN_IN, GREY, PAGE_IN, grey_of, pyplot
from postproc.read.labels import Label, observable_label

SEED = "seed"  # column of random draws, which are scatter and not an axis
LESS, MORE = "#56b4e9", "#d55e00"  # bars of a tornado chart
COLOURS = ("#0072b2", "#d55e00", "#009e73", "black", "#cc79a7", "#a34800", "#56b4e9")
DASHES = ("-", (0, (5, 1.5)), (0, (1, 1.2)), (0, (4, 1, 1, 1)), (0, (8, 2)), (0, (3, 1, 1, 1, 1, 1)))
MARKERS = "osD^v<>"
LOG_RATIO = 30  # of the largest to the smallest varied value: larger ratios get a logarithmic axis
BINS = 15
PANEL_IN, LINE_IN = 2.2, 0.16  # heights of a panel and of a line of text
WRAP = 32  # characters per line of an axis label
CHARACTERS_PER_IN = 15


def swept_columns(table: pd.DataFrame) -> list[str]:
    """Columns of the varied values: between the number of the case and the engine."""
    names = list(table.columns)
    return names[1 : names.index("engine")]


def observable_columns(table: pd.DataFrame) -> list[str]:
    """Columns of the observables, which are the last ones."""
    names = list(table.columns)
    return names[names.index("force_error_share") + 1 :]


def draw_study(
    table: pd.DataFrame, title: str, observables: tuple[str, ...], where: str, keys: Mapping[str, Label]
) -> Product:
    """A panel per observable against the varied column with most values, a line per combination of the other columns.

    Lines show the reference, or without it the first engine; markers show the other engines. With random draws and
    other axes, lines join the means; random draws alone are shown as a histogram. Observables without a value get no
    panel.

    Raises:
        InputError: The table lacks an observable, one is given twice, no case is done, or no value was found.
    """
    _must_have(table, observables, where)
    swept, done = swept_columns(table), table[table["status"] == "done"]
    shown = tuple(name for name in observables if done[name].notna().any())
    if not swept or not shown:
        raise InputError(where, "", "a varied key and a finished case are needed")
    numeric = [name for name in swept if pd.api.types.is_numeric_dtype(table[name])]
    axes_of_draws = [name for name in numeric if name != SEED] or numeric or swept
    across = max(axes_of_draws, key=lambda name: table[name].nunique())
    engines = [str(engine) for engine in done["engine"].unique()]
    baseline = REFERENCE if REFERENCE in engines else engines[0]
    numbers = done[["case", *swept, "engine", *shown]]
    figure, axes = _panels(shown, title)
    if across == SEED:
        _draw_scatter(axes, done, baseline)
    else:
        numbers = _draw_curves(axes, numbers, across, baseline, keys)
    for name, axis in axes.items():
        label = fill(observable_label(name).axis(float(done[name].abs().max()))[0], WRAP)
        axis.set(**{"xlabel": label, "ylabel": "draws"} if across == SEED else {"ylabel": label})
    entries = list(zip(*next(iter(axes.values())).get_legend_handles_labels(), strict=True))
    entries.sort(key=lambda entry: entry[0].get_linestyle() == "None")  # markers last
    _legend(figure, *map(list, zip(*entries, strict=True)))
    return Product(figure, numbers)


def _draw_scatter(axes: Mapping[str, Any], done: pd.DataFrame, baseline: str) -> None:
    """Histograms of random draws by the first engine, counts of the other engines as markers."""
    for name, axis in axes.items():
        factor = observable_label(name).axis(float(done[name].abs().max()))[1]
        edges = np.histogram_bin_edges(done[name].dropna() * factor, BINS)
        for engine, values in done.groupby("engine", sort=False)[name]:
            counts, _ = np.histogram(values.dropna() * factor, edges)
            if engine == baseline:
                axis.stairs(counts, edges, color=COLOURS[0], label=engine)
                spread = f"{values.mean() * factor:.5g} ± {values.std() * factor:.2g}"
                axis.set_title(f"mean ± s.d. {spread}", loc="right")
            else:
                axis.plot((edges[1:] + edges[:-1]) / 2, counts, label=engine, **grey_of(str(engine)))
        axis.set_ylim(bottom=-0.04 * axis.get_ylim()[1])  # so that markers at 0 are not cut


def _draw_curves(
    axes: Mapping[str, Any], numbers: pd.DataFrame, across: str, baseline: str, keys: Mapping[str, Label]
) -> pd.DataFrame:
    """Draws a line for each combination of the other varied columns; returns the numbers, with means over draws."""
    swept = swept_columns(numbers)
    others = [
        name for name in swept if name not in (across, SEED) and numbers.groupby(across)[name].nunique().max() > 1
    ]
    means = {name: f"{name}_mean" if SEED in swept else name for name in axes}
    if SEED in swept:
        groups = numbers.groupby([across, *others, "engine"], dropna=False, sort=False)
        numbers = numbers.assign(**{means[name]: groups[name].transform("mean") for name in axes})
    of_baseline = f"mean of draws, {baseline}" if SEED in swept else baseline
    is_number = pd.api.types.is_numeric_dtype(numbers[across])
    label, scale = keys[across].axis(float(numbers[across].abs().max())) if is_number else (keys[across].words, 1.0)
    sets: Any = numbers.groupby(others, dropna=False, sort=False) if others else [((), numbers)]
    for place, (values, part) in enumerate(sets):
        words = ", ".join(
            f"{keys[name].words} {keys[name].value(value)}" for name, value in zip(others, values, strict=True)
        )
        look = {"color": COLOURS[place % len(COLOURS)], "ls": DASHES[place % len(DASHES)], "lw": 1.1}
        if not is_number:  # text values have no line between them
            look |= {"ls": "none", "marker": MARKERS[place % len(MARKERS)], "ms": 3}
        for engine, own in part.groupby("engine", sort=False):
            rows = own.sort_values(across) if is_number else own
            for name, axis in axes.items():
                factor = observable_label(name).axis(float(numbers[name].abs().max()))[1]
                x = rows[across] * scale if is_number else rows[across]
                if engine == baseline:
                    axis.plot(x, rows[means[name]] * factor, label=words or of_baseline, **look)
                if engine != REFERENCE:
                    label_once = str(engine) if not place and (words or of_baseline) != engine else None
                    axis.plot(x, rows[name] * factor, label=label_once, **grey_of(str(engine)))
    low, high = (numbers[across].min(), numbers[across].max()) if is_number else (0, 0)
    for axis in axes.values():
        axis.set_xlabel(fill(label, WRAP))
        if low > 0 and high / low > LOG_RATIO:
            axis.set_xscale("log")
    return numbers


def draw_tornado(
    table: pd.DataFrame, title: str, observables: tuple[str, ...], where: str, keys: Mapping[str, Label]
) -> Product:
    """Tornado chart: change of each observable by each input, a panel per observable; the table has all observables.

    The table is of a study whose axes were varied one by one, with the base as the first case.

    Raises:
        InputError: As ``draw_study``, or the base case is missing.
    """
    _must_have(table, observables, where)
    engine = table["engine"].iloc[0]
    rows = table[(table["engine"] == engine) & (table["status"] == "done")]
    if rows.empty or rows["case"].iloc[0] != 1:
        raise InputError(where, "", f"the base case is not done on {engine}")
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
    changes = pd.DataFrame(found, columns=columns)  # of the first engine
    shown = tuple(name for name in observables if name in set(changes["observable"]))
    if not shown:
        raise InputError(where, "axis", "no number was varied in a finished case")
    figure, axes = _panels(shown, title, columns=2, height_in=0.7 + LINE_IN * changes["input"].nunique())
    for name, axis in axes.items():
        rows = changes[changes["observable"] == name]
        inputs = list(rows["observable_change_share"].abs().groupby(rows["input"]).max().sort_values().index)
        colours = np.where(rows["input_change_share"] > 0, MORE, LESS)
        places = [inputs.index(given) for given in rows["input"]]
        axis.barh(places, 100 * rows["observable_change_share"], color=colours, height=0.7)
        axis.set_yticks(range(len(inputs)), [keys[given].words for given in inputs], fontsize=7)
        axis.axvline(0, color=GREY, lw=0.7)
        axis.set_xlabel(fill(f"change of the {observable_label(name).words} (%)", WRAP))
        axis.grid(axis="y", visible=False)
    shares = sorted({round(100 * share, 6) for share in changes["input_change_share"]})
    bars = [pyplot().Rectangle((0, 0), 1, 1, color=LESS if share < 0 else MORE) for share in shares]
    _legend(figure, bars, [f"input {share:+g} %" for share in shares])
    return Product(figure, changes)


def _panels(
    names: tuple[str, ...], title: str, columns: int = 3, height_in: float = PANEL_IN
) -> tuple[Any, dict[str, Any]]:
    """A figure with a title, and its axes by name; its width depends on the number of panels."""
    columns = 2 if len(names) == 4 else min(columns, len(names))
    width_in, rows = PAGE_IN if columns > 1 else COLUMN_IN, -(-len(names) // columns)
    words = fill(title, int(CHARACTERS_PER_IN * width_in))
    height_in = rows * height_in + LINE_IN * (words.count("\n") + 2)
    figure = pyplot().figure(figsize=(width_in, height_in), layout="constrained")
    figure.suptitle(words, fontsize=8)
    return figure, {name: figure.add_subplot(rows, columns, place) for place, name in enumerate(names, 1)}


def _legend(figure: Any, handles: list[Any], words: list[str]) -> None:
    """Adds a legend below all panels, in as many columns as fit."""
    widest = max(map(len, words)) + 7
    columns = max(1, min(len(words), int(CHARACTERS_PER_IN * figure.get_figwidth() / widest)))
    lines = -(-len(words) // columns)
    figure.set_figheight(figure.get_figheight() + LINE_IN * lines)
    figure.legend(handles, words, loc="outside lower center", ncols=columns, fontsize=7)


def _must_have(table: pd.DataFrame, observables: tuple[str, ...], where: str) -> None:
    if not observables:
        raise InputError(where, "figure", "missing key: the observables to draw")
    if len({*observables}) < len(observables):
        raise InputError(where, "figure", "an observable twice", "each observable once")
    known = observable_columns(table)
    for name in (name for name in observables if name not in known):
        raise InputError(where, "figure", f'"{name}"', f"observables of the table: {', '.join(known) or 'none yet'}")
