"""Figures of a study from its table: curves over the varied values, or a tornado chart of sensitivities."""

from collections.abc import Mapping
from itertools import product
from textwrap import fill
from typing import Any

import numpy as np
import pandas as pd
from pandas.api.types import is_numeric_dtype

from drivers.base.errors import InputError
from postproc.draw.power_law import draw_power_laws, make_logarithmic
from postproc.draw.product import Product
from postproc.draw.study_curves import COLOURS, MAX_CURVES, SEED, WRAP, baseline_of, draw_curves, swept_columns
from postproc.draw.style import COLUMN_IN, GREY, PAGE_IN, grey_of, pyplot
from postproc.read.labels import Label, observable_label
from postproc.read.observables import without_unit

TEXTS = ("engine", "status", "reason")  # columns that are on no axis
LESS, MORE = "#56b4e9", "#d55e00"  # bars of a tornado chart
BINS = 15
PANEL_IN, LINE_IN, TEXT_IN = 2.2, 0.16, 0.8  # heights of a panel, of a line of text, of turned texts
CHARACTERS_PER_IN = 15


def observable_columns(table: pd.DataFrame) -> list[str]:
    """Columns of the observables, which are the last ones."""
    names = list(table.columns)
    return names[names.index("force_error_share") + 1 :]


def column_of(table: pd.DataFrame, given: str, option: str, columns: Mapping[str, str], *, numbers: bool) -> str:
    """Column of a table by its name with or without the unit; ``columns`` has those of varied keys by such names.

    Raises:
        InputError: The table has no such column, or it has texts although ``numbers`` are needed.
    """
    fit = (name for name in map(str, table) if is_numeric_dtype(table[name]) or not numbers)
    allowed = [name for name in fit if name not in TEXTS]
    names = {without_unit(name): name for name in allowed} | {**columns} | {name: name for name in allowed}
    if names.get(given) not in allowed:
        raise InputError(option, "", f'"{given}"', f"{'numbers' if numbers else 'columns'}: {', '.join(allowed)}")
    return names[given]


def draw_study(
    table: pd.DataFrame, title: str, observables: tuple[str, ...], where: str, keys: Mapping[str, Label]
) -> Product:
    """A panel per observable against the varied column with most values, a line per combination of the other columns.

    Lines show the reference, or without it the first engine; markers show the other engines. With random draws and
    other axes, lines join the means; random draws alone are shown as a histogram. Observables without a value get a
    note and no panel.

    Raises:
        InputError: The table lacks an observable, one is given twice, no case is done, or no value was found.
    """
    _must_have(table, observables, where)
    done, across = table[table["status"] == "done"], _longest_axis(table)
    shown = tuple(name for name in observables if done[name].notna().any())
    if not across or not shown:
        raise InputError(where, "", "a varied key and a finished case are needed")
    numbers, legend = done[["case", *swept_columns(table), "engine", *shown]], ""
    figure, axes = _panels(shown, title, across=table[across])
    labels = {name: observable_label(name) for name in shown} | {**keys}
    if across == SEED:
        _draw_scatter(axes, done)
    else:
        numbers, legend = draw_curves(axes, numbers, across, across, labels)
    _finish(figure, axes, done, labels, legend)
    notes = [f"{name}: no panel, since no run shows it" for name in observables if name not in shown]
    return Product(figure, numbers, notes=notes)


def draw_relation(
    table: pd.DataFrame, title: str, x: str, y: str, keys: Mapping[str, Label],
    *, joined: bool = True, log: bool = False, fitted: bool = False,
) -> Product:  # fmt: skip
    """A column of numbers against another column, with lines and markers as in ``draw_study``.

    Args:
        table: Table of the study.
        title: Title of the figure.
        x: Column on the x axis.
        y: Column on the y axis.
        keys: Labels of the varied columns.
        joined: False for points without lines. Random draws have none.
        log: True for logarithmic axes, without the rows that are not above zero.
        fitted: True for a power law of each engine.

    Raises:
        InputError: No finished row has both values, or too few rows have for a fit.
    """
    done, swept = table[table["status"] == "done"], swept_columns(table)
    done = done.assign(**{y: done[y].where(done[x].notna())})
    above = (done[[x, y]] > 0).all(axis=1) if log else done[y].notna()
    if not above.any():
        raise InputError(f"--x {x} --y {y}", "", f"no finished row has both{', above zero' * log}")
    figure, axes = _panels((y,), title, across=table[x])
    labels = {name: observable_label(name) for name in (x, y)} | {**keys}
    order = "" if SEED in swept or not joined else x if x in swept else _longest_axis(table)
    numbers = done[list(dict.fromkeys(["case", *swept, "engine", x, y]))]
    numbers, legend = draw_curves(axes, numbers.assign(**{y: done[y].where(above)}), x, order, labels)
    left_out = int((done[y].notna() & ~above).sum())
    notes = [f"{left_out} rows are not above zero, so not on logarithmic axes"] if left_out else []
    if log:
        make_logarithmic(axes[y])
    if fitted:
        factors = [labels[name].axis(float(numbers[name].abs().max()))[1] for name in (x, y)]
        notes += draw_power_laws(axes[y], done, x, y, *factors)
    _finish(figure, axes, done, labels, legend)
    return Product(figure, numbers, notes=notes)


def _longest_axis(table: pd.DataFrame) -> str:
    """Varied column with most values, a number if there is one, and random draws last; empty if nothing varies."""
    swept = swept_columns(table)
    numeric = [name for name in swept if is_numeric_dtype(table[name])]
    names = [name for name in numeric if name != SEED] or numeric or swept
    return max(names, key=lambda name: table[name].nunique(), default="")


def _draw_scatter(axes: Mapping[str, Any], done: pd.DataFrame) -> None:
    """Histograms of random draws by the first engine, counts of the other engines as markers."""
    for name, axis in axes.items():
        factor = observable_label(name).axis(float(done[name].abs().max()))[1]
        edges = np.histogram_bin_edges(done[name].dropna() * factor, BINS)
        for engine, values in done.groupby("engine", sort=False)[name]:
            counts, _ = np.histogram(values.dropna() * factor, edges)
            if engine == baseline_of(done):
                axis.stairs(counts, edges, color=COLOURS[0], label=engine)
                spread = f"{values.mean() * factor:.5g} ± {values.std() * factor:.2g}"
                axis.set_title(f"mean ± s.d. {spread}", loc="right")
            else:
                axis.plot((edges[1:] + edges[:-1]) / 2, counts, label=engine, **grey_of(str(engine)))
        axis.set_ylim(bottom=-0.04 * axis.get_ylim()[1])  # so that markers at 0 are not cut


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
        own = changes[changes["observable"] == name]
        inputs = list(own["observable_change_share"].abs().groupby(own["input"]).max().sort_values().index)
        colours = np.where(own["input_change_share"] > 0, MORE, LESS)
        places = [inputs.index(given) for given in own["input"]]
        axis.barh(places, 100 * own["observable_change_share"], color=colours, height=0.7)
        axis.set_yticks(range(len(inputs)), [keys[given].words for given in inputs], fontsize=7)
        axis.axvline(0, color=GREY, lw=0.7)
        axis.set_xlabel(fill(f"change of the {observable_label(name).words} (%)", WRAP))
        axis.grid(axis="y", visible=False)
    shares = sorted({round(100 * share, 6) for share in changes["input_change_share"]})
    bars = [pyplot().Rectangle((0, 0), 1, 1, color=LESS if share < 0 else MORE) for share in shares]
    _count_unseen(axes, rows)
    _legend(figure, bars, [f"input {share:+g} %" for share in shares])
    notes = [f"{name}: no panel, since no run shows its change" for name in observables if name not in shown]
    return Product(figure, changes, notes=notes)


def _panels(
    names: tuple[str, ...], title: str, columns: int = 3, height_in: float = PANEL_IN, across: pd.Series | None = None
) -> tuple[Any, dict[str, Any]]:
    """A figure with a title, and its axes by name; its width depends on the number of panels and the texts on x."""
    many_texts = across is not None and not is_numeric_dtype(across) and across.nunique() > MAX_CURVES
    columns = 1 if many_texts else 2 if len(names) == 4 else min(columns, len(names))
    width_in, rows = PAGE_IN if columns > 1 or many_texts else COLUMN_IN, -(-len(names) // columns)
    words = fill(title, int(CHARACTERS_PER_IN * width_in))
    height_in = rows * (height_in + TEXT_IN * many_texts) + LINE_IN * (words.count("\n") + 2)
    figure = pyplot().figure(figsize=(width_in, height_in), layout="constrained")
    figure.suptitle(words, fontsize=8)
    return figure, {name: figure.add_subplot(rows, columns, place) for place, name in enumerate(names, 1)}


def _finish(figure: Any, axes: Mapping[str, Any], done: pd.DataFrame, labels: Mapping[str, Label], title: str) -> None:
    """Adds names of axes, the number of runs that do not show an observable, and a legend with a title."""
    for name, axis in axes.items():
        label = fill(labels[name].axis(float(done[name].abs().max()))[0], WRAP)
        axis.set(**{"ylabel": label} if axis.get_xlabel() else {"xlabel": label, "ylabel": "draws"})
    _count_unseen(axes, done)
    entries = list(zip(*next(iter(axes.values())).get_legend_handles_labels(), strict=True))
    entries.sort(key=lambda entry: entry[0].get_linestyle() == "None")  # markers last
    handles, words = map(list, zip(*entries, strict=True))
    _legend(figure, handles, words, title)


def _count_unseen(axes: Mapping[str, Any], done: pd.DataFrame) -> None:
    """Adds the number of runs that do not show an observable below the title of its panel."""
    for name, axis in axes.items():
        if unseen := int(done[name].isna().sum()):
            words = f"{axis.get_title(loc='right')}\nnot seen in {unseen} of {len(done)} runs".strip()
            axis.set_title(words, loc="right", fontsize=7)


def _legend(figure: Any, handles: list[Any], words: list[str], title: str = "") -> None:
    """Adds a legend below all panels, in as many columns as fit."""
    widest = max(map(len, words)) + 7
    columns = max(1, min(len(words), int(CHARACTERS_PER_IN * figure.get_figwidth() / widest)))
    lines = -(-len(words) // columns) + bool(title)
    figure.set_figheight(figure.get_figheight() + LINE_IN * lines)
    look: dict[str, Any] = {"loc": "outside lower center", "fontsize": 7, "title": title or None, "title_fontsize": 7}
    figure.legend(handles, words, ncols=columns, **look)


def _must_have(table: pd.DataFrame, observables: tuple[str, ...], where: str) -> None:
    if not observables:
        raise InputError(where, "figure", "missing key: the observables to draw")
    if len({*observables}) < len(observables):
        raise InputError(where, "figure", "an observable twice", "each observable once")
    known = observable_columns(table)
    for name in (name for name in observables if name not in known):
        raise InputError(where, "figure", f'"{name}"', f"observables of the table: {', '.join(known) or 'none yet'}")
