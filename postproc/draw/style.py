"""How figures look: the same colour for the same engine everywhere (Okabe-Ito, safe for the colour-blind)."""

from functools import cache
from io import StringIO
from typing import Any

import numpy as np

from drivers.engines import REFERENCE, Style, engine_names, load_engine

MICRO = 1e6
COLUMN_IN = 3.5  # a journal's column
PAGE_IN = 7.1  # its page of two columns
FAINT = "#555555"
OPEN = "#e4e7ea"  # where there is no contact
# quantities of the paper's figures, told apart in grey by their lines
FIRST: dict[str, Any] = {"color": "#0072b2", "ls": (0, (5, 1.5)), "lw": 1.0}  # F_1, the contact that a wave meets first
SECOND: dict[str, Any] = {"color": "#d55e00", "ls": (0, (4, 1, 1, 1)), "lw": 1.0}  # F_2
AVERAGE: dict[str, Any] = {"color": "black", "ls": "-", "lw": 1.2}  # of both; any force that a gauge shows
DAMPED: dict[str, Any] = {"color": "#009e73", "ls": (0, (3, 1)), "lw": 1.2}  # the same with dissipation
QUOTED: dict[str, Any] = {"color": "#a34800", "ls": (0, (1, 1.2)), "lw": 1.0}  # levels and rates that the paper states
GREYS = ("#222222", "#666666", "#999999")  # codes, where a figure is of quantities
# engines without a style of their own, and further builds of a code, get these in the order of their names
SPARE = (
    Style("#882255", dashes=(0, (5, 1, 1, 1, 1, 1)), marker="p"),
    Style("#e69f00", dashes=(0, (3, 1)), marker="v"),
    Style("#117733", dashes=(0, (1, 1)), marker="*", size=6.0),
    Style("#332288", dashes=(0, (4, 1, 1, 1)), marker="h"),
    Style("#56b4e9", dashes=(0, (8, 3)), marker="<"),
    Style("#999933", dashes=(0, (6, 1, 1, 1)), marker="+", size=6.0),
)


@cache
def line_of(engine: str) -> Style:
    """The style of an engine: that of its adapter, of whose builds the first has it, or the next of ``SPARE``.

    Names that are no engine's have the last of ``SPARE``.
    """
    own: dict[str, Style] = {}
    for found in sorted(map(load_engine, engine_names()), key=lambda found: found.entry.adapter != found.name):
        if found.style and found.style not in own.values():
            own[found.name] = found.style
    plain = [name for name in engine_names() if name not in own]
    return own.get(engine) or SPARE[plain.index(engine) % len(SPARE) if engine in plain else -1]


def marker_of(engine: str) -> dict[str, Any]:
    """Plot keywords for an engine's points: nested, so that equal points stay visible."""
    style = line_of(engine)
    return {"marker": style.marker, "ms": style.size, "mew": 1.1, "mfc": "none", "color": style.colour}


def grey_of(engine: str) -> dict[str, Any]:
    """Plot keywords for an engine's points where colours stand for quantities: its own marker, in grey."""
    codes = [name for name in engine_names() if name != REFERENCE]
    level = GREYS[codes.index(engine) % len(GREYS)] if engine in codes else GREYS[0]
    return marker_of(engine) | {"color": level, "ls": "none"}


def letter_panel(axis: Any, letter: str, words: str = "") -> None:
    """Letters a panel as the paper does, with a few words: above its upper left corner, in line with the axis."""
    axis.set_title(f"({letter})  {words}".rstrip(), loc="left")


def drawing_order(engines: list[str]) -> list[str]:
    """Engines from the widest line to the finest, so that none hides another."""
    return sorted(engines, key=lambda engine: -line_of(engine).width)


@cache
def force_colours() -> Any:
    """Colours from no force to the largest: ever darker, also for the colour-blind and in print; open contacts grey."""
    from matplotlib import colormaps
    from matplotlib.colors import ListedColormap

    return ListedColormap(colormaps["magma_r"](np.linspace(0.0, 0.92, 256)), "force", bad=OPEN)


def finish_bar(bar: Any, label: str) -> None:
    """Labels a colour bar of forces, with a thin frame."""
    bar.set_label(label)
    bar.outline.set_linewidth(0.5)
    bar.solids.set_rasterized(True)
    bar.ax.grid(visible=False)


@cache
def pyplot() -> Any:
    """Matplotlib's pyplot, set up once: no display, text as text, thin axes."""
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
    """A figure as an SVG file's text; the figure is closed."""
    plt = pyplot()
    buffer = StringIO()
    with plt.rc_context({"svg.hashsalt": "figure"}):
        figure.savefig(buffer, format="svg", bbox_inches="tight", metadata={"Date": None})
    plt.close(figure)
    return buffer.getvalue()
