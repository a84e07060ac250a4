"""Figures: their style, the numbers that they draw, their files, and spacetime diagrams of chains.

There is one colour per engine in all figures (Okabe-Ito palette, safe for the colour-blind).

A spacetime diagram shows the contact forces against time and contact: a wave is a slope, a reflection a fold.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache
from io import StringIO
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from drivers.base.files import whole_file
from drivers.chain.chain import Array
from drivers.chain.trace import CONTACT, Trace
from drivers.engines import engine_names, load_engine

MICRO = 1e6
COLUMN_IN = 3.5  # width of a journal column
PAGE_IN = 7.1  # width of a page of two columns
GREY = "#555555"
OPEN_CONTACT = "#e4e7ea"
# perceptually uniform maps of matplotlib, and the share of each that is used
COLOUR_MAPS = {"force": ("magma_r", 0.92), "change": ("RdBu_r", 1.0), "value": ("plasma", 0.64)}
DPI = 200
METADATA = {"png": {"Software": None}, "svg": {"Date": None}}  # no dates
FORCES = CONTACT, "contact", "force (N)"
CHANGES = "contact_{}_change_N", "contact", "change from static force (N)"
SPACETIME = "spacetime"  # ending of the names of spacetime diagrams
COLUMNS, ROWS = 400, 250  # largest numbers of cells; a cell shows the largest of its forces
PANEL_IN = 1.9
GAMMA = 0.5  # colours scale with the root of the force, so that weak waves after a strong one are visible
OPEN_SHARE = 1e-6  # of the largest force: contacts with less are drawn as open
LOADED_SHARE = 0.2  # of the largest change of a force: with a larger static force the changes are drawn
# quantities of the paper's figures; the line styles distinguish them in grey print
FIRST: dict[str, Any] = {"color": "#0072b2", "ls": (0, (5, 1.5)), "lw": 1.0}  # F_1, the contact that a wave meets first
SECOND: dict[str, Any] = {"color": "#d55e00", "ls": (0, (4, 1, 1, 1)), "lw": 1.0}  # F_2
AVERAGE: dict[str, Any] = {"color": "black", "ls": "-", "lw": 1.2}  # mean of both; any gauge force
DAMPED: dict[str, Any] = {"color": "#009e73", "ls": (0, (3, 1)), "lw": 1.2}  # the same with dissipation
QUOTED: dict[str, Any] = {"color": "#a34800", "ls": (0, (1, 1.2)), "lw": 1.0}  # levels and rates stated in the paper
GREYS = ("#222222", "#666666", "#999999")  # codes in figures whose colours are quantities
CIRCLE: dict[str, Any] = {"marker": "o", "mfc": "none", "mew": 0.8, "color": GREYS[0], "ls": "none"}  # equal codes
PLAIN: dict[str, Any] = {"lw": 1.3, "ls": "-", "marker": "^", "ms": 5.0}  # what the style of an engine leaves out
# styles of engines without a style of their own and of further builds of a code, in the order of their names
EXTRA_STYLES: tuple[dict[str, Any], ...] = (
    {"color": "#882255", "ls": (0, (5, 1, 1, 1, 1, 1)), "marker": "p"},
    {"color": "#e69f00", "ls": (0, (3, 1)), "marker": "v"},
    {"color": "#117733", "ls": (0, (1, 1)), "marker": "*", "ms": 6.0},
    {"color": "#332288", "ls": (0, (4, 1, 1, 1)), "marker": "h"},
    {"color": "#56b4e9", "ls": (0, (8, 3)), "marker": "<"},
    {"color": "#999933", "ls": (0, (6, 1, 1, 1)), "marker": "+", "ms": 6.0},
)


@cache
def _style_of(engine: str) -> dict[str, Any]:
    """Style of an engine: its adapter's for the build of the same name, else one of ``EXTRA_STYLES`` by its place."""
    names, own = engine_names(), None
    if engine in names and (build := load_engine(engine)).entry.adapter == engine:
        own = build.style
    place = names.index(engine) if engine in names else -1
    return {**PLAIN, **(own or EXTRA_STYLES[place % len(EXTRA_STYLES)])}


def line_of(engine: str) -> dict[str, Any]:
    """Plot keywords for the line of an engine."""
    return {key: _style_of(engine)[key] for key in ("color", "lw", "ls")}


def marker_of(engine: str) -> dict[str, Any]:
    """Plot keywords for the points of an engine; sizes are nested, so that equal points stay visible."""
    return {"mew": 1.1, "mfc": "none"} | {key: _style_of(engine)[key] for key in ("color", "marker", "ms")}


def draw_codes(axis: Any, points: Mapping[str, tuple[Any, Any]], size: float = 4.0) -> None:
    """Draws points of codes by their markers in grey, and one open circle if all coincide within half of its size.

    Args:
        axis: Axes with their final limits and scales.
        points: x and y by code.
        size: Size of the markers in points.
    """
    places = [axis.transData.transform(np.transpose(xy)) for xy in points.values()]
    equal = len(places) > 1 and np.ptp(places, axis=0).max(initial=0.0) < size / 2 * axis.figure.dpi / 72
    for group in [[*points]] if equal else [[code] for code in points]:
        grey = {"color": GREYS[engine_names().index(group[0]) % len(GREYS)], "ls": "none"}
        form = CIRCLE if equal else marker_of(group[0]) | grey
        names = ", ".join(load_engine(code).in_print for code in group)
        axis.plot(*points[group[0]], **form | {"ms": size, "label": names})


def letter_panel(axis: Any, letter: str, words: str = "") -> None:
    """Adds the letter and title of a panel above its upper left corner."""
    axis.set_title(f"({letter})  {words}".rstrip(), loc="left")


def drawing_order(engines: list[str]) -> list[str]:
    """Engines from the widest to the thinnest line, so that none hides another."""
    return sorted(engines, key=lambda engine: -line_of(engine)["lw"])


@cache
def colour_map(quantity: str) -> Any:
    """Colour map of a force, darker for larger ones also in grey print, of its change, or of a varied value.

    Values have a contrast of 3 or more on white; masked values are light grey.
    """
    from matplotlib import colormaps
    from matplotlib.colors import ListedColormap

    name, end = COLOUR_MAPS[quantity]
    return ListedColormap(colormaps[name](np.linspace(0.0, end, 256)), quantity, bad=OPEN_CONTACT)


def finish_bar(bar: Any, label: str) -> None:
    """Labels a colour bar and gives it a thin frame."""
    bar.set_label(label)
    bar.outline.set_linewidth(0.5)
    bar.solids.set_rasterized(True)
    bar.ax.grid(visible=False)


@cache
def pyplot() -> Any:
    """Matplotlib's pyplot, set up once: no display, text kept as text in SVG, thin axes."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    matplotlib.rc("font", size=8)
    matplotlib.rc("axes", titlesize=8, linewidth=0.7, grid=True)
    matplotlib.rc("axes.spines", top=False, right=False)
    matplotlib.rc("grid", linewidth=0.4, alpha=0.5)
    matplotlib.rc("legend", frameon=False)
    matplotlib.rc("svg", fonttype="none")
    matplotlib.rc("path", simplify_threshold=0.2)
    matplotlib.rc("savefig", pad_inches=0.02)
    return plt


def svg_of(figure: Any) -> str:
    """SVG text of a figure, which is then closed."""
    plt = pyplot()
    buffer = StringIO()
    with plt.rc_context({"svg.hashsalt": "figure"}):
        figure.savefig(buffer, format="svg", bbox_inches="tight", metadata={"Date": None})
    plt.close(figure)
    return buffer.getvalue()


@dataclass(frozen=True)
class Product:
    """A figure with its numbers."""

    figure: Any  # a matplotlib figure
    table: pd.DataFrame  # the plotted numbers, units in the column names
    chains: Mapping[str, Trace] = field(default_factory=dict)  # traces by title, for a spacetime diagram
    notes: Sequence[str] = ()  # lines to print

    def with_rows(self, *tables: pd.DataFrame) -> "Product":
        """The product with more rows in its table."""
        return replace(self, table=pd.concat([self.table, *tables], ignore_index=True))


def write_product(product: Product, name: str, folder: Path) -> list[Path]:
    """Writes ``name.csv``, ``name.png`` and ``name.svg``, each whole or not at all, and the spacetime diagram."""
    written = [write_table(product.table, name, folder), *write_figure(product.figure, name, folder)]
    if product.chains:
        written += write_product(draw_spacetime(product.chains), f"{name}-{SPACETIME}", folder)
    return written


def write_table(table: pd.DataFrame, name: str, folder: Path) -> Path:
    """Writes ``name.csv``, whole or not at all."""
    folder.mkdir(parents=True, exist_ok=True)
    with whole_file(path := folder / f"{name}.csv") as draft:
        table.to_csv(draft, index=False)
    return path


def write_figure(figure: Any, name: str, folder: Path) -> list[Path]:
    """Writes ``name.png`` and ``name.svg``, each whole or not at all, and closes the figure."""
    plt = pyplot()
    written = [folder / f"{name}.{ending}" for ending in METADATA]
    figure.draw_without_rendering()  # one layout for both files
    figure.set_layout_engine(None)
    edges = figure.get_tightbbox().padded(plt.rcParams["savefig.pad_inches"])
    for path, (ending, metadata) in zip(written, METADATA.items(), strict=True):
        with whole_file(path) as draft, plt.rc_context({"svg.hashsalt": name}):
            figure.savefig(draft, format=ending, dpi=DPI, bbox_inches=edges, metadata=metadata)
    plt.close(figure)
    return written


def cells_of(time_s: Array, values: Array, *, signed: bool = False) -> tuple[Array, Array, Array]:
    """Values at all contacts or bodies in at most ``ROWS`` by ``COLUMNS`` cells of equal size, except the last ones.

    Args:
        time_s: Sample times. Shape (samples,).
        values: A quantity of each contact or body. Shape (samples, places).
        signed: True for values of both signs; then a cell has the value of the largest magnitude.

    Returns:
        Time of the first sample of each column in s, lowest place of each row counted from the wall, and the largest
        value in each cell, of shape (rows, columns).
    """
    samples, places = values.shape
    over_time = np.arange(0, samples, -(-samples // COLUMNS))
    over_places = np.arange(0, places, -(-places // ROWS))
    cells = np.maximum.reduceat(np.maximum.reduceat(values, over_time, axis=0), over_places, axis=1)
    if signed:
        lowest = -cells_of(time_s, -values)[2].T
        cells = np.where(cells >= -lowest, cells, lowest)
    return time_s[over_time], over_places + 1.0, cells.T


def draw_cells(
    axis: Any, title: str, time_s: Array, values: Array, names: tuple[str, str, str], ticks: Any = None
) -> pd.DataFrame:
    """Draws a quantity against time and place in the chain, with a colour bar; white after the end of a run.

    Args:
        axis: Axes.
        title: Title of the panel.
        time_s: Sample times. Shape (samples,).
        values: Quantity of each contact or body. Shape (samples, places).
        names: Pattern of its columns in the table, words at the axis along the chain, words at the colour bar.
            ``CHANGES`` have colours of both signs.
        ticks: Formatter of matplotlib of the numbers at the colour bar; None for its default.

    Returns:
        The values of the cells, a row per time.
    """
    from matplotlib.colors import FuncNorm, PowerNorm
    from matplotlib.ticker import MaxNLocator

    (column, place, words), signed = names, names == CHANGES
    start_s, number, cells = cells_of(time_s, values, signed=signed)
    samples, places = values.shape
    width_s = (time_s[-1] - time_s[0]) / max(samples - 1, 1) * -(-samples // COLUMNS)
    right, top = float(start_s[-1] + width_s) * MICRO, float(number[-1]) + -(-places // ROWS) - 0.5
    size = np.abs(cells) if signed else cells
    largest = float(size.max(initial=0.0)) or 1.0  # without any force the scale ends at 1 N
    root = (lambda x: np.sign(x) * np.abs(x) ** GAMMA, lambda x: np.sign(x) * np.abs(x) ** (1 / GAMMA))
    norm = FuncNorm(root, -largest, largest) if signed else PowerNorm(GAMMA, 0, largest)
    colours = colour_map("change" if signed else "force")
    image = axis.imshow(
        np.ma.masked_where(size <= OPEN_SHARE * largest, cells), cmap=colours, norm=norm, origin="lower",
        extent=(float(start_s[0]) * MICRO, right, 0.5, top), interpolation="none", aspect="auto",
    )  # fmt: skip
    axis.set(ylim=(0.5, places + 0.5), ylabel=place)
    axis.grid(visible=False)
    axis.yaxis.set_major_locator(MaxNLocator(integer=True, nbins=5, min_n_ticks=1))
    axis.set_title(title, loc="left")
    bar = axis.figure.colorbar(image, ax=axis, pad=0.02, aspect=16, ticks=MaxNLocator(nbins=5), format=ticks)
    finish_bar(bar, f"{words},\nsquare-root scale; grey: none")
    table = pd.DataFrame(cells.T, columns=[column.format(int(each)) for each in number])
    table.insert(0, "time_s", start_s)
    return table


def shown_forces(trace: Trace) -> tuple[Array, bool]:
    """Forces of all contacts, or their changes since time 0 and True if the static force would hide these."""
    changes = trace.force_N - trace.force_N[0]
    signed = bool(trace.force_N[0].max() > LOADED_SHARE * np.abs(changes).max())
    return (changes, True) if signed else (trace.force_N, False)


def draw_spacetime(chains: Mapping[str, Trace], width_in: float = COLUMN_IN) -> Product:
    """Spacetime diagram with a panel for each chain, each with its own scale of force; white after the end of a run.

    The changes since time 0 are drawn if the static force would hide them. The table holds the values of the cells, a
    row per chain and time.
    """
    tables = []
    size = (width_in, 0.5 + PANEL_IN * len(chains))
    figure, axes = pyplot().subplots(len(chains), 1, figsize=size, squeeze=False, sharex=True, layout="constrained")
    for axis, (title, trace) in zip(axes[:, 0], chains.items(), strict=True):
        values, signed = shown_forces(trace)
        table = draw_cells(axis, title, trace.time_s, values, CHANGES if signed else FORCES)
        table.insert(0, "chain", title)
        tables.append(table)
    last_s = max(float(trace.time_s[-1]) for trace in chains.values())
    axes[-1, 0].set(xlim=(0, last_s * MICRO), xlabel="time since impact (µs)")
    return Product(figure, pd.concat(tables, ignore_index=True))
