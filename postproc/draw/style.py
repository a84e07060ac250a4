"""Style of figures: one colour per engine in all figures (Okabe-Ito palette, safe for the colour-blind)."""

from collections.abc import Mapping
from functools import cache
from io import StringIO
from typing import Any

import numpy as np

from drivers.engines import engine_names, load_engine

MICRO = 1e6
COLUMN_IN = 3.5  # width of a journal column
PAGE_IN = 7.1  # width of a page of two columns
GREY = "#555555"
OPEN_CONTACT = "#e4e7ea"
# perceptually uniform maps of matplotlib, and the share of each that is used
COLOUR_MAPS = {"force": ("magma_r", 0.92), "change": ("RdBu_r", 1.0), "value": ("plasma", 0.64)}
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
