"""Figures of studies from their tables: curves, a column against another, histograms, tornado charts."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import cycle, product
from math import floor, log10
from textwrap import fill
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.cm import ScalarMappable
from matplotlib.ticker import LogFormatter
from pandas.api.types import is_numeric_dtype

from drivers.base import units
from drivers.base.errors import InputError
from drivers.engines import REFERENCE
from drivers.scene.settings import unit_of
from postproc.draw.product import Product
from postproc.draw.style import COLUMN_IN, GREY, PAGE_IN, finish_bar, grey_of, pyplot, value_colours
from postproc.read.observables import describe, without_unit

SEED = "seed"  # column of random draws, which are scatter and not an axis
TEXTS = ["engine", "status", "reason"]  # columns that are on no axis
LESS, MORE = "#56b4e9", "#d55e00"  # bars of a tornado chart
COLOURS = ("#0072b2", "#d55e00", "#009e73", "black", "#cc79a7", "#a34800", "#56b4e9")
DASHES = ("-", (0, (5, 1.5)), (0, (1, 1.2)), (0, (4, 1, 1, 1)), (0, (8, 2)), (0, (3, 1, 1, 1, 1, 1)))
MARKERS = "osD^v<>"
LOG_RATIO = 30  # of the largest to the smallest varied value: larger ratios get a logarithmic scale
MAX_CURVES = 8  # each with a colour of its own
MAX_TEXT_TICKS = 60
MAX_CHARACTERS = 24  # of a text value; of all texts on an axis, longer ones are turned
MIN_ROWS = 3  # of a power law
BINS = 15
PANEL_IN, LINE_IN, TEXT_IN = 2.2, 0.16, 0.8  # heights of a panel, of a line of text, of turned texts
WRAP = 32  # characters per line of an axis label
CHARACTERS_PER_IN = 15
MATERIALS = "materials."
KEYS = (  # scene keys with a label of their own; other keys are labelled by the name of their column
    (r"materials\.(.+)\.youngs_modulus", r"Young's modulus of \1"),
    (r"materials\.(.+)\.poisson_ratio", r"Poisson's ratio of \1"),
    (r"materials\.(.+)\.density", r"density of \1"),
    (r"chain\.count", "number of beads"),
    (r"chain\.(material|diameter|mass)", r"bead \1"),
    (r"chain\.mass_scatter", "scatter of the bead masses"),
    (r"chain\.sensors\.\d+\.mass", "sensor mass"),
    (r"contact\.restitution", "coefficient of restitution"),
    (r"contact\.friction", "friction between beads"),
    (r"tube\.friction", "friction at the tube"),
    (r"sensor\.time_constant", "time constant of the gauges"),
    (r"run\.(.+)", r"\1"),
)


@dataclass(frozen=True)
class Label:
    """Label of a quantity and its SI unit; the unit is empty for a plain number."""

    words: str
    unit: str

    def axis(self, largest: float) -> tuple[str, float]:
        """Label of an axis up to ``largest`` in SI units, and the factor from SI units to the unit on the axis."""
        unit, factor = self.unit, 1.0
        if unit == "kg":
            unit, factor = "g", 1e3
        elif unit in units.PREFIXED and "/" not in unit and largest > 0:
            power = min(max(floor(log10(largest)) // 3 * 3, min(units.PREFIXES)), max(units.PREFIXES))
            power = 0 if largest >= 0.1 and power < 0 else power
            unit, factor = units.PREFIXES[power] + unit, 10.0**-power
        return f"{self.words} ({_plain(unit)})" if unit else self.words, factor

    def value(self, value: object) -> str:
        """Text of a value in SI units, with four digits."""
        if not isinstance(value, float):
            return str(value)
        shown = float(f"{value:.4g}")
        return _plain(units.quantity(shown, self.unit)) if self.unit else f"{shown:g}"


def observable_label(name: str) -> Label:
    """Label of an observable, named with or without its unit."""
    observable = describe(name)
    match = observable.match(name)
    parts = {}
    if match:
        parts = {field: text.replace("pct", "\u00a0%").replace("_", " ") for field, text in match.groupdict().items()}
    if parts.get("gauge") == "wall":
        parts["gauge"] = "the wall"
    return Label(observable.words.format(**parts), observable.unit)


def key_label(name: str, key: str) -> Label:
    """Label of a column of a study, which holds the values of a scene key; a name of its own is used if it has one.

    Moduli, Poisson's ratios and densities are named in full.
    """
    for pattern, words in KEYS if name == key or key.startswith(MATERIALS) else ():
        if match := re.fullmatch(pattern, key):
            return Label(match.expand(words).replace("_", " "), unit_of(key))
    return Label(re.sub("[._]", " ", name), unit_of(key))


def _plain(text: str) -> str:
    """A unit or quantity with the signs µ and ² instead of ``u`` and ``^2``."""
    return re.sub(r"\bu(?=[a-zA-Z])", "µ", text).replace("^2", "²")


def swept_columns(table: pd.DataFrame) -> list[str]:
    """Columns of the varied values: between the number of the case and the engine."""
    return [*map(str, table.loc[:, :"engine"].columns[1:-1])]


def observable_columns(table: pd.DataFrame) -> list[str]:
    """Columns of the observables, which are the last ones."""
    return list(table.loc[:, "force_error_share":].columns[1:])


def column_of(table: pd.DataFrame, given: str, option: str, columns: Mapping[str, str], *, numbers: bool) -> str:
    """Column of a table by its name with or without the unit; ``columns`` has those of varied keys by such names.

    Raises:
        InputError: The table has no such column, or it has texts although ``numbers`` are needed.
    """
    allowed = [*map(str, table.select_dtypes("number") if numbers else table.drop(columns=TEXTS))]
    names = {without_unit(name): name for name in allowed} | {**columns} | {name: name for name in allowed}
    if names.get(given) not in allowed:
        raise InputError(option, "", f'"{given}"', f"{'numbers' if numbers else 'columns'}: {', '.join(allowed)}")
    return names[given]


def draw_study(
    table: pd.DataFrame, title: str, names: Sequence[str], where: str, keys: Mapping[str, Label],
    x: str = "", *, joined: bool = True, log: bool = False, fitted: bool = False,
) -> Product:  # fmt: skip
    """A panel per column against the varied column with most values, a line per combination of the other columns.

    Lines show the reference, or without it the first engine; markers show the other engines. With random draws and
    other axes, lines join the means; random draws alone are shown as a histogram. Columns without a value get a note
    and no panel.

    Args:
        table: Table of the study.
        title: Title of the figure.
        names: Columns of numbers on the y axes; observables unless ``x`` is given.
        where: File or options that name the columns.
        keys: Labels of the varied columns.
        x: Another column on the x axes. Lines follow the varied column with most values; random draws have no lines.
        joined: False for points without lines.
        log: True for logarithmic axes, without the rows that are not above zero.
        fitted: True for power laws.

    Raises:
        InputError: The table lacks an observable, one is given twice, no finished row has a number on both axes, or
            too few have for a power law.
    """
    if not x:
        _must_have(table, names, where)
    done, swept = table[table["status"] == "done"].reset_index(drop=True), swept_columns(table)
    numeric = [name for name in swept if is_numeric_dtype(table[name])]
    axes_of_draws = [name for name in numeric if name != SEED] or numeric or swept
    longest = max(axes_of_draws, key=lambda name: table[name].nunique(), default="")
    across = x or longest
    order = "" if not joined or (x and SEED in swept) else across if across in swept else longest
    labels = {name: observable_label(name) for name in (across, *names)} | {**keys}
    at = done.get(across, pd.Series(dtype=float))
    texts = [] if is_numeric_dtype(at) else [_words({across: value}, labels, named=False) for value in at.unique()]
    turned = len("".join(texts)) > MAX_CHARACTERS
    seen = done[[*names]].where(at.notna() | bool(texts))
    drawn = seen.where(seen > 0).where(at > 0) if log else seen
    shown = [name for name in names if drawn[name].notna().any()]
    if not shown:
        lacking = f"no finished row has both{', above zero' * log}"
        raise InputError(where, "", lacking if x else "a varied key and a finished case are needed")
    notes = [f"{name}: no panel, since no run shows it" for name in names if name not in shown]
    if left_out := int((seen.count() - drawn.count()).sum()):
        notes.append(f"{left_out} rows are not above zero, so not on logarithmic axes")
    numbers = done[[*dict.fromkeys(["case", *swept, "engine", across, *shown])]].assign(**drawn[shown])
    counts = numbers.groupby(order or "case", dropna=False).nunique(dropna=False).max()
    others = [name for name in swept if name not in (order, SEED) and counts[name] > 1]
    figure, axes = _panels(shown, title, turned=turned)
    legend, step = "", -(-len(texts) // MAX_TEXT_TICKS)
    if order == SEED:
        _draw_scatter(axes, numbers, labels)
    else:
        numbers, legend = _draw_curves(axes, numbers, across, order, others, labels)
    for name, axis in axes.items():
        if texts:
            axis.set_xticks(range(0, len(texts), step), texts[::step], rotation=90 * turned, fontsize=7)
        if log:
            axis.set(xscale="log", yscale="log")
            for ticks in (axis.xaxis, axis.yaxis):  # plain numbers, since powers of ten overlap within a decade
                ticks.set_major_formatter("{x:g}")
                ticks.set_minor_formatter(LogFormatter())
        if fitted:
            notes += _draw_power_laws(axis, numbers, across, name, others, labels)
    _finish(figure, axes, seen, legend)
    return Product(figure, numbers, notes=notes)


def _engines(numbers: pd.DataFrame) -> list[str]:
    """Engines of some rows, the reference first; lines show the first one."""
    return sorted(map(str, numbers["engine"].unique()), key=lambda engine: engine != REFERENCE)


def _axis(label: Label, values: pd.Series) -> tuple[str, float]:
    """Label of an axis, and the factor from SI units to the unit on the axis."""
    words, factor = label.axis(float(values.abs().max())) if is_numeric_dtype(values) else (label.words, 1.0)
    return fill(words, WRAP), factor


def _draw_scatter(axes: Mapping[str, Any], numbers: pd.DataFrame, labels: Mapping[str, Label]) -> None:
    """Histograms of random draws by the first engine, counts of the other engines as markers."""
    engines = _engines(numbers)
    for name, axis in axes.items():
        words, factor = _axis(labels[name], numbers[name])
        edges = np.histogram_bin_edges(factor * numbers[name].dropna(), BINS)
        for engine in engines:
            values = factor * numbers[name][numbers["engine"] == engine].dropna()
            counts, _ = np.histogram(values, edges)
            if engine == engines[0]:
                axis.stairs(counts, edges, color=COLOURS[0], label=engine)
                axis.set_title(f"mean ± s.d. {values.mean():.5g} ± {values.std():.2g}", loc="right")
            else:
                axis.plot((edges[1:] + edges[:-1]) / 2, counts, label=engine, **grey_of(engine))
        low = -0.04 * axis.get_ylim()[1]  # so that markers at 0 are not cut
        axis.set(xlabel=words, ylabel="draws", ylim=(low, None))


def _draw_curves(
    axes: Mapping[str, Any], numbers: pd.DataFrame, x: str, order: str, others: list[str], labels: Mapping[str, Label]
) -> tuple[pd.DataFrame, str]:
    """Draws a line of the first engine for each combination of ``others``, and markers of engines but the reference.

    Lines follow the varied column ``order``, have gaps at NaN and join the means of random draws; without ``order``,
    and between texts, there are points only.

    Returns:
        The numbers, with means over draws, and the title of the legend.
    """
    first, draws = _engines(numbers)[0], bool(order) and SEED in numbers
    means = numbers[[*axes]]
    if draws:
        means = numbers.groupby([order, *others, "engine"], dropna=False)[[*axes]].transform("mean")
        numbers = numbers.join(means.add_suffix("_mean"))
    of_first = numbers[numbers["engine"] == first]
    curves = [rows for _, rows in of_first.groupby([*others, "engine"], dropna=False, sort=False)]
    sets = pd.concat([rows[others].head(1) for rows in curves])
    looks, title = _looks([*axes.values()], sets, labels, f"mean of draws, {first}" if draws else first)
    small = {"ms": 2.0, "mew": 0.5} if len(curves) > MAX_CURVES else {}
    plain = {"marker": "o", "ms": 3.0, "lw": 1.1}
    line = bool(order) and is_numeric_dtype(numbers[order]) and is_numeric_dtype(numbers[x])
    words, factor = _axis(labels[x], numbers[x])
    places = pd.Series(pd.factorize(numbers[x], use_na_sentinel=False)[0], numbers.index)
    at = factor * numbers[x] if is_numeric_dtype(numbers[x]) else places
    for name, axis in axes.items():
        label, factor = _axis(labels[name], numbers[name])
        axis.set(xlabel=words, ylabel=label, xscale=_scale(at))
        axis.update_datalim([(at.min(), 0), (at.max(), 0)], updatey=False)
        for look, rows in zip(looks, curves, strict=True):
            rows = rows.drop_duplicates(order) if draws else rows
            y = factor * means.loc[(rows.sort_values(order) if line else rows).index, name]
            alone = y.notna() & y.shift().isna() & y.shift(-1).isna()  # between gaps, where a line shows nothing
            marked = np.flatnonzero(alone | (not line or x != order)).tolist()
            form = ({} if line else {"ls": "none"}) | ({} if marked else {"marker": "None"})
            axis.plot(at[y.index], y, markevery=marked, **plain | look | small | form)
        for engine, rows in numbers.groupby("engine", sort=False):
            if engine != REFERENCE:
                axis.plot(at[rows.index], factor * rows[name], label=engine, **grey_of(str(engine)) | small)
    return numbers, title


def _looks(
    axes: list[Any], sets: pd.DataFrame, labels: Mapping[str, Label], name: str
) -> tuple[list[dict[str, Any]], str]:
    """Plot keywords of each curve, and the title of the legend; ``sets`` has a row of varied values for each curve.

    Many curves are coloured by value. Values of one number get a colour bar and the entry ``name`` in the legend; all
    other values are entries.
    """
    few, number = len(sets) <= MAX_CURVES, sets.select_dtypes("number").dropna(axis="columns")
    if not few and sets.shape[1] == number.shape[1] == 1:
        words, factor = _axis(labels[str(number.columns[0])], number.iloc[:, 0])
        scale: Any = ScalarMappable(cmap=value_colours())
        scale.norm = _scale(number.iloc[:, 0])
        colours = scale.to_rgba(factor * number.iloc[:, 0])
        finish_bar(axes[0].figure.colorbar(scale, ax=axes, pad=0.02, aspect=30), words)
        axes[0].plot([], [], color=GREY, lw=1.1, label=name)
        return [{"label": name, "color": colour} for colour in colours], ""
    colours = cycle(COLOURS) if few else value_colours()(np.linspace(0, 1, len(sets)))
    entries = [_words(values, labels, named=few) or name for values in sets.to_dict("records")]
    looks = zip(entries, colours, cycle(DASHES), cycle(MARKERS), strict=False)
    title = "" if few else ", ".join(labels[str(key)].words for key in sets)
    return [dict(zip(("label", "color", "ls", "marker"), look, strict=True)) for look in looks], title


def _words(values: Mapping[Any, Any], labels: Mapping[str, Label], *, named: bool = True) -> str:
    """Short text of varied values by column, with the columns if ``named``; a removed key has none."""
    texts = {key: "none" if pd.isna(value) else labels[key].value(value) for key, value in values.items()}
    cut = {key: f"{text[: MAX_CHARACTERS - 1]}…" for key, text in texts.items() if len(text) > MAX_CHARACTERS}
    return ", ".join(f"{labels[key].words * named} {text}".strip() for key, text in (texts | cut).items())


def _scale(values: pd.Series) -> str:
    """Scale of an axis of varied values."""
    return "log" if values.min() > 0 and values.max() / values.min() > LOG_RATIO else "linear"


def _draw_power_laws(
    axis: Any, numbers: pd.DataFrame, x: str, y: str, others: list[str], labels: Mapping[str, Label]
) -> list[str]:
    """Draws ``y = C x^n`` for each curve of each engine, by least squares of the logarithms; returns a line for each.

    More than eight curves, or curves with too few points, get one for each engine.

    Raises:
        InputError: An engine has less than three rows with both columns above zero, or all at one x.
    """
    from scipy.stats import linregress

    (_, x_factor), (_, y_factor) = (_axis(labels[name], numbers[name]) for name in (x, y))
    lines, above = [], (numbers[[x, y]] > 0).all(axis=1)
    points = numbers[x].where(above).groupby([numbers[name] for name in ["engine", *others]], dropna=False).nunique()
    if points.min() < MIN_ROWS or len(numbers[others].drop_duplicates()) > MAX_CURVES:
        others = []
    for (engine, *_), rows in numbers.groupby(["engine", *others], dropna=False, sort=False):
        name = ", ".join(filter(None, [str(engine), _words(rows.iloc[0][others].to_dict(), labels)]))
        fitted = rows[above[rows.index]]
        if len(fitted) < MIN_ROWS or fitted[x].nunique() == 1:
            found = f"{name} has {len(fitted)} rows with {x} and {y} above zero"
            raise InputError("--power-law", "", found, f"at least {MIN_ROWS} rows, with different {x}")
        fit = linregress(np.log(fitted[x]), np.log(fitted[y]))
        power, constant = f"x^{fit.slope:.4g}", np.exp(fit.intercept)
        left = f"; {len(rows) - len(fitted)} left out, not seen or not above zero" if len(fitted) < len(rows) else ""
        law = f"{y} = {constant:.4g} {power}, exponent {fit.slope:.4g} ± {fit.stderr:.2g}"
        lines.append(f"{name}: {law} ({len(fitted)} rows{left})")
        places = np.geomspace(fitted[x].min(), fitted[x].max(), 100)
        look = {"color": grey_of(str(engine))["color"], "ls": (0, (6, 3)), "lw": 1.2}
        axis.plot(x_factor * places, y_factor * constant * places**fit.slope, label=f"{name}: {power}", **look)
    return lines


def draw_tornado(
    table: pd.DataFrame, title: str, observables: Sequence[str], where: str, keys: Mapping[str, Label]
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
    bars = []
    for (_, row), given in product(rows.iloc[1:].iterrows(), swept_columns(table)):
        if row[given] == base[given] or not isinstance(row[given], float | int) or not base[given]:
            continue
        change = row[given] / base[given] - 1
        for name in observable_columns(table):
            if base[name] and np.isfinite([row[name], base[name]]).all():
                share = row[name] / base[name] - 1
                bars.append((name, given, change, share, share / change))
    columns = ["observable", "input", "input_change_share", "observable_change_share", "elasticity"]
    changes = pd.DataFrame(bars, columns=columns)  # of the first engine
    shown = [name for name in observables if name in set(changes["observable"])]
    if not shown:
        raise InputError(where, "axis", "no number was varied in a finished case")
    figure, axes = _panels(shown, title, 2, 0.7 + LINE_IN * changes["input"].nunique())
    for name, axis in axes.items():
        of_panel = changes[changes["observable"] == name]
        inputs = list(of_panel["observable_change_share"].abs().groupby(of_panel["input"]).max().sort_values().index)
        for change, part in of_panel.groupby((100 * of_panel["input_change_share"]).round(6)):
            places = [inputs.index(given) for given in part["input"]]
            look = {"color": LESS if change < 0 else MORE, "label": f"input {change:+g} %"}
            axis.barh(places, 100 * part["observable_change_share"], height=0.7, **look)
        axis.set_yticks(range(len(inputs)), [keys[given].words for given in inputs], fontsize=7)
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
    width_in, rows = PAGE_IN if columns > 1 or turned else COLUMN_IN, -(-len(names) // columns)
    words = fill(title, int(CHARACTERS_PER_IN * width_in))
    height_in = rows * (height_in + TEXT_IN * turned) + LINE_IN * (words.count("\n") + 2)
    figure = pyplot().figure(figsize=(width_in, height_in), layout="constrained")
    figure.suptitle(words, fontsize=8)
    return figure, {name: figure.add_subplot(rows, columns, place) for place, name in enumerate(names, 1)}


def _finish(figure: Any, axes: Mapping[str, Any], rows: pd.DataFrame, title: str = "") -> None:
    """Adds the number of rows without the value of a panel, and a legend in as many columns as fit."""
    entries: dict[str, Any] = {}
    for name, axis in axes.items():
        if unseen := int(rows[name].isna().sum()):
            words = f"{axis.get_title(loc='right')}\nnot seen in {unseen} of {len(rows)} runs".strip()
            axis.set_title(words, loc="right", fontsize=7)
        for handle, label in zip(*axis.get_legend_handles_labels(), strict=True):
            entries.setdefault(label, handle)
    columns = max(1, min(len(entries), int(CHARACTERS_PER_IN * figure.get_figwidth() / (max(map(len, entries)) + 7))))
    figure.set_figheight(figure.get_figheight() + LINE_IN * (-(-len(entries) // columns) + bool(title)))
    look: dict[str, Any] = {"loc": "outside lower center", "fontsize": 7, "title": title or None, "title_fontsize": 7}
    figure.legend(entries.values(), entries, ncols=columns, **look)


def _must_have(table: pd.DataFrame, observables: Sequence[str], where: str) -> None:
    if not observables:
        raise InputError(where, "figure", "missing key: the observables to draw")
    if len({*observables}) < len(observables):
        raise InputError(where, "figure", "an observable twice", "each observable once")
    known = observable_columns(table)
    for name in (name for name in observables if name not in known):
        raise InputError(where, "figure", f'"{name}"', f"observables of the table: {', '.join(known) or 'none yet'}")
