"""Figures of studies from their tables: curves, a column against another, histograms, tornado charts."""

import re
from collections.abc import Mapping, Sequence
from itertools import cycle, product
from math import ceil, floor, log10
from textwrap import fill
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from matplotlib.ticker import LogFormatter
from pandas.api.types import is_numeric_dtype

from drivers.base import units
from drivers.base.errors import InputError
from drivers.engines import REFERENCE
from drivers.scene.settings import unit_of
from postproc.draw.plot import COLUMN_IN, GREY, PAGE_IN, Product, colour_map, line_of, marker_of, pyplot
from postproc.read.observables import describe

SEED = "seed"  # column of random draws, which are scatter and not an axis
LESS, MORE = "#56b4e9", "#d55e00"  # bars of a tornado chart
DASHES = ("-", (0, (5, 1.5)), (0, (1, 1.2)), (0, (4, 1, 1, 1)), (0, (8, 2)), (0, (3, 1, 1, 1, 1, 1)))
MARKERS = "osD^v<>"  # filled ones, of curves; engines have open ones
LOG_RATIO = 30  # of the largest to the smallest varied value: larger ratios get a logarithmic scale
MAX_CURVES = 8  # that differ in more than colour, and are named in the legend
MAX_CHARACTERS = 24  # of a text value; of all texts on an axis, longer ones are turned
MIN_VALUES = 4  # of a power law with a curvature that has an error
BINS = 15
PANEL_IN, LINE_IN, TEXT_IN = 2.2, 0.16, 0.8  # heights of a panel, of a line of text, of turned texts
WRAP = 32  # characters per line of an axis label
CHARACTERS_PER_IN = 15


class Label(NamedTuple):
    """Label of a quantity and its SI unit; the unit is empty for a plain number."""

    words: str
    unit: str

    def axis(self, values: pd.Series) -> tuple[str, float]:
        """Label of an axis for values in SI units, and the factor from SI units to the unit on the axis."""
        unit, factor, largest = self.unit, 1.0, values.abs().max() if is_numeric_dtype(values) else 0
        if unit and "/" not in unit and largest > 0:
            power = floor(log10(largest)) // 3 * 3
            number, _, unit = units.quantity(10.0**power, unit).partition(" ")
            factor = 10.0 ** round(log10(float(number)) - power)
        return fill(f"{self.words} ({_plain(unit)})" if unit else self.words, WRAP), factor

    def value(self, value: Any) -> str:
        """Text of a value in SI units, with four digits; long texts are cut, and a removed key is ``none``."""
        if pd.isna(value):
            return "none"
        if not isinstance(value, float):
            text = str(value)
            return text if len(text) <= MAX_CHARACTERS else f"{text[: MAX_CHARACTERS - 1]}…"
        shown = float(f"{value:.4g}")
        return _plain(units.quantity(shown, self.unit)) if self.unit else f"{shown:g}"


def observable_label(name: str) -> Label:
    """Label of an observable, named with or without its unit."""
    observable = describe(name)
    match = observable.match(name)
    words = observable.words.format(**match.groupdict() if match else {})
    words = words.replace("pct", "\u00a0%").replace("_", " ").replace(" at wall", " at the wall")
    return Label(words, observable.unit)


def key_label(name: str, key: str) -> Label:
    """Label of a column of a study, which holds the values of a scene key; a name of its own is used if it has one.

    Constants of materials are named in full.
    """
    words = re.sub(r"materials\.(.+)\.(.+)", r"\2 of \1", key if key.startswith("materials.") else name)
    for short, full in {"chain.": "bead ", "youngs": "Young's", "poisson": "Poisson's"}.items():
        words = words.replace(short, full)
    return Label(re.sub("[._]", " ", words), unit_of(key))


def _plain(text: str) -> str:
    """A unit or quantity with the signs µ and ² instead of ``u`` and ``^2``."""
    return re.sub(r"\bu(?=[a-zA-Z])", "µ", text).replace("^2", "²")


def observable_columns(table: pd.DataFrame) -> list[str]:
    """Columns of the observables, which are the last ones."""
    return list(table.loc[:, "force_error_share":].columns[1:])


def draw_study(
    table: pd.DataFrame, title: str, names: Sequence[str], where: str, keys: Mapping[str, Label],
    x: str = "", *, joined: bool = True, log: bool = False, fitted: bool = False,
) -> Product:  # fmt: skip
    """A panel per column against the varied column with most values, a curve per combination of the other columns.

    Curves are those of the reference, or without it of the first engine; open markers of the same colour show the other
    engines. With random draws and other axes, lines join the means; random draws alone are shown as histograms. Columns
    without a value get a note and no panel.

    Args:
        table: Table of the study.
        title: Title of the figure.
        names: Columns of numbers on the y axes; observables unless ``x`` is given.
        where: File or options that name the columns.
        keys: Labels of the varied columns.
        x: Another column on the x axes. Lines follow the varied column with most values; random draws have no lines.
        joined: False for points without lines.
        log: True for logarithmic axes, without the rows that are not above zero.
        fitted: True for power laws instead of lines between points, with a note on each.

    Raises:
        InputError: The table lacks an observable, no finished row has a number on both axes, or too few have for a
            power law.
    """
    names = names if x else _known(table, names, where)
    done = table[table["status"] == "done"].reset_index(drop=True)
    swept = [name for name in keys if name in table]
    fixed = [name for name in swept if name != SEED] or swept
    numeric = [name for name in fixed if is_numeric_dtype(table[name])]
    longest = max(numeric or fixed, key=lambda name: table[name].nunique(), default="case")
    across = x or longest
    order = "case" if not joined or (x and SEED in swept) else across if across in swept else longest
    if is_numeric_dtype(done[across]):
        done[[*names]] = done[[*names]].where(done[across].notna())
    above = done[(done[[across, *names]] > 0).all(axis=1)] if log else done
    shown = [name for name in names if above[name].notna().any()]
    if not (shown and swept):
        lacking = f"no finished row has both{', above zero' * log}"
        raise InputError(where, "", lacking if x else "a varied key and a finished case are needed")
    notes = [f"{name}: no panel, since no run shows it" for name in names if name not in shown]
    if log and (left_out := int(done[[*names]].notna().all(axis=1).sum()) - len(above)):
        notes.append(f"{left_out} rows are not above zero, so not on logarithmic axes")
    numbers = above[[*dict.fromkeys(["case", *swept, "engine", across, *shown])]]
    labels = {name: observable_label(name) for name in (across, *names)} | {**keys}
    texts = [] if is_numeric_dtype(numbers[across]) else [*map(labels[across].value, numbers[across].unique())]
    turned = len("".join(texts)) > MAX_CHARACTERS
    figure, axes = _panels(shown, title, turned=turned)
    legend = ""
    if order == SEED:
        _draw_scatter(axes, numbers, labels)
    else:
        numbers, laws, legend = _draw_curves(axes, numbers, across, order, labels, swept, fitted=fitted)
        notes += laws
    for axis in axes.values():
        if texts:
            axis.set_xticks(range(len(texts)), texts, rotation=90 * turned, fontsize=7)
        if log:
            axis.set(xscale="log", yscale="log")
            for ticks in (axis.xaxis, axis.yaxis):  # plain numbers, since powers of ten overlap within a decade
                ticks.set(major_formatter="{x:g}", minor_formatter=LogFormatter())
    _finish(figure, axes, done, legend)
    return Product(figure, numbers, notes=notes)


def _engines(numbers: pd.DataFrame) -> list[str]:
    """Engines of some rows, the reference first; curves are those of the first one."""
    return sorted(map(str, numbers["engine"].unique()), key=lambda engine: engine != REFERENCE)


def _draw_scatter(axes: Mapping[str, Any], numbers: pd.DataFrame, labels: Mapping[str, Label]) -> None:
    """Histograms of random draws by engine, and mean and deviation of those of the first one."""
    engines = _engines(numbers)
    for name, axis in axes.items():
        words, factor = labels[name].axis(numbers[name])
        draws = [factor * numbers[name][numbers["engine"] == engine].dropna() for engine in engines]
        edges = np.histogram_bin_edges(pd.concat(draws), BINS)
        for engine, values in zip(engines, draws, strict=True):
            axis.hist(values, edges, histtype="step", label=engine, **line_of(engine))
        axis.set_title(f"mean ± s.d. {draws[0].mean():.5g} ± {draws[0].std():.2g}", loc="right")
        axis.set(xlabel=words, ylabel="draws")


def _draw_curves(
    axes: Mapping[str, Any], numbers: pd.DataFrame, x: str, order: str, labels: Mapping[str, Label], swept: list[str],
    *, fitted: bool,
) -> tuple[pd.DataFrame, list[str], str]:  # fmt: skip
    """Draws a curve for each combination of the other varied values; lines join the means of random draws.

    Curves differ in colour, dashes and filled markers, many only in colour, and the legend names some of them. Power
    laws replace the lines, one for each curve and engine; many curves, or curves of too few points, get one for each
    engine.

    Returns:
        The numbers, with means over draws, a line on each power law, and the title of the legend.
    """
    counts = numbers.groupby(order, dropna=False).nunique(dropna=False).max()
    others = [name for name in swept if name not in (order, SEED) and counts[name] > 1]
    engines, draws, means = _engines(numbers), order != "case" and SEED in swept, numbers[[*axes]]
    if draws:
        means = numbers.groupby([order, *others, "engine"], dropna=False)[[*axes]].transform("mean")
        numbers = numbers.join(means.add_suffix("_mean"))
    words, factor = labels[x].axis(numbers[x])
    at, along = factor * _places(numbers[x]), _places(numbers[order])
    in_order = all(is_numeric_dtype(numbers[name]) for name in others)
    curves = [rows for _, rows in numbers.groupby(others, dropna=False, sort=in_order)] if others else [numbers]
    first, many = f"mean of draws, {engines[0]}" if draws else engines[0], len(curves) > MAX_CURVES
    titles = [", ".join(labels[name].value(rows[name].iloc[0]) for name in others) or first for rows in curves]
    colours, size = colour_map("value")(np.linspace(0, 1, len(curves))), 0.4 if many else 1.0
    forms = zip(colours, cycle("-" if many else DASHES), cycle("o" if many else MARKERS), strict=False)
    looks = [{"color": colour, "ls": dash, "marker": form, "ms": 2.5 * size, "lw": 1} for colour, dash, form in forms]
    points = {engine: marker_of(engine) | {"ls": "none", "mew": 0.7 * size} for engine in engines[not draws :]}
    line = {"ls": "none"} if fitted or order == "case" else {}
    for name, axis in axes.items():
        label, y_factor = labels[name].axis(numbers[name])
        axis.set(xlabel=words, ylabel=label, xscale="log" if 0 < at.min() < at.max() / LOG_RATIO else "linear")
        for look, rows in zip(looks, curves, strict=True):
            joined = along[rows.index[rows["engine"] == engines[0]]].drop_duplicates().sort_values().index
            axis.plot(at[joined], y_factor * means.loc[joined, name], **look | line)
            for engine, form in points.items():
                form = form | {"color": look["color"], "ms": 1.5 * size * form["ms"]}
                places = rows.index[rows["engine"] == engine]
                axis.plot(at[places], y_factor * numbers.loc[places, name], **form)
    notes, exponents, groups = list[str](), dict[str, str](), [*zip(titles, looks, curves, strict=True)]
    if many or numbers.groupby(["engine", *others], dropna=False)[x].nunique().min() < MIN_VALUES:
        groups = [(first, looks[0], numbers)]
    for (title, look, rows), engine in product(groups if fitted else (), engines):
        curve = engine if title == first else f"{engine}, {title}"
        places, law, power, note = _power_law(rows[rows["engine"] == engine], x, name, curve)
        axis.plot(factor * places, y_factor * law, **look | {"marker": "None"})
        exponents.setdefault(title, f": x^{power:.4g}")
        notes.append(note)
    step = ceil(len(curves) / MAX_CURVES)
    entries: dict[str, Any] = dict(zip(titles[::step], looks[::step], strict=True))
    entries |= {first: looks[0] if titles == [first] else {"marker": "o", "ms": 2.5, "lw": 1}}
    for label, look in (entries | {engine: form | {"color": GREY} for engine, form in points.items()}).items():
        axis.plot([], [], label=label + exponents.get(label, ""), **{"color": GREY} | look)
    return numbers, notes, ", ".join(labels[name].words for name in others) + f", one in {step}" * many


def _places(values: pd.Series) -> pd.Series:
    """Numbers as they are, and the places of texts in order of appearance."""
    codes, _ = pd.factorize(values, use_na_sentinel=False)
    return values if is_numeric_dtype(values) else pd.Series(codes, values.index)


def _power_law(rows: pd.DataFrame, x: str, y: str, name: str) -> tuple[Any, Any, float, str]:
    """Power law ``y = C x^n`` by least squares of the logarithms, and what a quadratic term adds.

    With ``ln y = a + b ln x + c (ln x)^2`` the local exponent is ``b + 2 c ln x``. The law bends if the curvature ``c``
    is beyond two of its standard errors and changes the exponent in the digits that are printed.

    Returns:
        x and y of the law, its exponent, and a line on it that says where the local exponent is within the error of
        ``n``.

    Raises:
        InputError: Both columns are above zero at less than four values of ``x``.
    """
    fitted = rows[(rows[[x, y]] > 0).all(axis=1)]
    if (count := fitted[x].nunique()) < MIN_VALUES:
        found = f"{name} has {count} values of {x} with {x} and {y} above zero"
        raise InputError("--power-law", "", found, f"at least {MIN_VALUES}")
    log_x, log_y = np.log(fitted[[x, y]].to_numpy(float)).T
    middle, ends = log_x.mean(), np.array([log_x.min(), log_x.max()])
    (power, start), spread = np.polyfit(log_x - middle, log_y, 1, cov=True)
    (curvature, slope, _), bent_spread = np.polyfit(log_x - middle, log_y, 2, cov=True)
    error, curvature_error = np.sqrt([spread[0, 0], bent_spread[0, 0]])
    (low, high), constant = np.exp(ends), np.exp(start - power * middle)
    lowest, highest = (f"{exponent:.4g}" for exponent in slope + 2 * curvature * (ends - middle))
    holds = f"holds from {low:.3g} to {high:.3g}"
    if abs(curvature) > 2 * curvature_error and lowest != highest:
        within = np.sort((power - slope + np.array([-error, error])) / (2 * curvature)) + middle
        reach = "{:.3g} to {:.3g}".format(*np.exp(np.clip(within, *ends)))
        holds = f"bends: exponent from {lowest} at {low:.3g} to {highest} at {high:.3g}, within its error from {reach}"
    left = len(rows) - len(fitted)
    left_out = f"; {left} left out, not seen or not above zero" if left else ""
    law = f"{y} = {constant:.4g} x^{power:.4g}, exponent {power:.4g} ± {error:.2g}"
    note = f"{name}: {law}, curvature {curvature:.2g} ± {curvature_error:.2g}; {holds} ({len(fitted)} rows{left_out})"
    places = np.geomspace(low, high, 100)
    return places, constant * places**power, power, note


def draw_tornado(
    table: pd.DataFrame, title: str, observables: Sequence[str], where: str, keys: Mapping[str, Label]
) -> Product:
    """Tornado chart: change of each observable by each input, a panel per observable; the table has all observables.

    The table is of a study whose axes were varied one by one, with the base as the first case.

    Raises:
        InputError: As ``draw_study``, or the base case is missing.
    """
    observables, known = _known(table, observables, where), observable_columns(table)
    engine = table["engine"].iloc[0]
    rows = table[(table["engine"] == engine) & (table["status"] == "done")]
    if rows.empty or rows["case"].iloc[0] != 1:
        raise InputError(where, "", f"the base case is not done on {engine}")
    inputs = [name for name in keys if name in table and is_numeric_dtype(table[name])]
    shares = rows[["case", *inputs, *known]].astype(float).set_index("case")
    shares = (shares / shares.iloc[0] - 1).where(np.isfinite)
    varied, seen = (
        shares[part].rename_axis(columns=name).stack().dropna().rename(f"{name}_change_share").reset_index(name)
        for part, name in ((inputs, "input"), (known, "observable"))
    )
    changes = varied[varied["input_change_share"] != 0].merge(seen, on="case")
    changes = changes[["observable", *varied, "observable_change_share"]].reset_index(drop=True)
    changes["elasticity"] = changes["observable_change_share"] / changes["input_change_share"]
    shown = [name for name in observables if name in set(changes["observable"])]
    if not shown:
        raise InputError(where, "axis", "no number was varied in a finished case")
    figure, axes = _panels(shown, title, 2, 0.7 + LINE_IN * changes["input"].nunique())
    for name, axis in axes.items():
        part = 100 * changes[changes["observable"] == name].set_index("input").drop(columns="observable")
        part["input_change_share"] = part["input_change_share"].round(6)
        order = part["observable_change_share"].abs().groupby("input").max().sort_values().index.to_list()
        for change, bars in part.groupby("input_change_share"):
            look = {"color": LESS if change < 0 else MORE, "label": f"input {change:+g} %"}
            axis.barh([*map(order.index, bars.index)], bars["observable_change_share"], height=0.7, **look)
        axis.set_yticks(range(len(order)), [keys[given].words for given in order], fontsize=7)
        axis.axvline(0, color=GREY, lw=0.7)
        axis.set_xlabel(fill(f"change of the {observable_label(name).words} (%)", WRAP))
        axis.grid(axis="y", visible=False)
    _finish(figure, axes, rows)
    notes = [f"{name}: no panel, since no run shows its change" for name in observables if name not in shown]
    return Product(figure, changes, notes=notes)


def _panels(
    names: Sequence[str], title: str, columns: int = 3, height_in: float = PANEL_IN, *, turned: bool = False
) -> tuple[Any, dict[str, Any]]:
    """A figure with a title, and its axes by name; turned texts on the x axes need the width of a page."""
    columns = 1 if turned else min(columns, 2 if len(names) == 4 else len(names))
    width_in, rows = PAGE_IN if columns > 1 or turned else COLUMN_IN, ceil(len(names) / columns)
    words = fill(title, int(CHARACTERS_PER_IN * width_in))
    height_in = rows * (height_in + TEXT_IN * turned) + LINE_IN * (words.count("\n") + 2)
    figure = pyplot().figure(figsize=(width_in, height_in), layout="constrained")
    figure.suptitle(words, fontsize=8)
    return figure, {name: figure.add_subplot(rows, columns, place) for place, name in enumerate(names, 1)}


def _finish(figure: Any, axes: Mapping[str, Any], rows: pd.DataFrame, title: str = "") -> None:
    """Adds the number of rows without the value of a panel, and a legend below in as many columns as fit."""
    entries: dict[str, Any] = {}
    for name, axis in axes.items():
        if unseen := int(rows[name].isna().sum()):
            words = f"{axis.get_title(loc='right')}\nnot seen in {unseen} of {len(rows)} runs".strip()
            axis.set_title(words, loc="right", fontsize=7)
        handles, labels = axis.get_legend_handles_labels()
        entries |= dict(zip(labels, handles, strict=True))
    columns = max(1, min(len(entries), int(CHARACTERS_PER_IN * figure.get_figwidth() / (max(map(len, entries)) + 7))))
    figure.set_figheight(figure.get_figheight() + LINE_IN * (ceil(len(entries) / columns) + bool(title)))
    look: dict[str, Any] = {"loc": "outside lower center", "fontsize": 7, "title": title, "title_fontsize": 7}
    figure.legend(entries.values(), entries, ncols=columns, **look)


def _known(table: pd.DataFrame, observables: Sequence[str], where: str) -> list[str]:
    """Observables of a figure, each once, all in the table."""
    known = observable_columns(table)
    for name in observables or ["no observables"]:
        if name not in known:
            raise InputError(where, "figure", name, f"observables of the table: {', '.join(known) or 'none yet'}")
    return [*dict.fromkeys(observables)]
