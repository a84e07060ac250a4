"""How figures look: the same colour for the same engine everywhere (Okabe-Ito, safe for the colour-blind)."""

from dataclasses import dataclass
from functools import cache
from io import StringIO
from typing import Any

import numpy as np

COLUMN_IN = 3.5  # a journal's column
FAINT = "#555555"
OPEN = "#e4e7ea"  # where there is no contact


@dataclass(frozen=True)
class Line:
    """How the curve of one engine is drawn."""

    colour: str
    width: float
    dashes: Any


_LINES = {
    "reference": Line("#b3b3b3", 3.2, "-"),
    "verlet": Line("#009e73", 1.1, (0, (1, 2))),
    "liggghts": Line("#0072b2", 1.3, "-"),
    "yade": Line("#d55e00", 1.3, (0, (4, 3))),
}
_OTHER = Line("#cc79a7", 1.3, (0, (6, 2, 1, 2)))


def line_of(engine: str) -> Line:
    """The line of an engine; a new one gets the spare colour until it has its own."""
    return _LINES.get(engine, _OTHER)


def marker_of(engine: str) -> dict[str, Any]:
    """Plot keywords for an engine's points: nested, so that equal points stay visible."""
    sizes = {"reference": ("o", 8.0), "liggghts": ("s", 4.5), "yade": ("x", 4.0)}
    shape, size = sizes.get(engine, ("^", 5.0))
    return {"marker": shape, "ms": size, "mew": 1.1, "mfc": "none", "color": line_of(engine).colour}


def drawing_order(engines: list[str]) -> list[str]:
    """Engines from the widest line to the finest, so that none hides another."""
    return sorted(engines, key=lambda engine: -line_of(engine).width)


@cache
def force_colours() -> Any:
    """Colours from no force to the largest: ever darker, also for the colour-blind and in print; open contacts grey."""
    from matplotlib import colormaps
    from matplotlib.colors import ListedColormap

    return ListedColormap(colormaps["magma_r"](np.linspace(0.0, 0.92, 256)), "force", bad=OPEN)


@cache
def pyplot() -> Any:
    """Matplotlib's pyplot, set up once: no display, text as text, thin axes."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    plt.rcParams.update(
        {
            "font.size": 8,
            "axes.titlesize": 8,
            "axes.spines.top": False,
            "axes.spines.right": False,
            "axes.linewidth": 0.7,
            "axes.grid": True,
            "grid.linewidth": 0.4,
            "grid.alpha": 0.5,
            "legend.frameon": False,
            "svg.fonttype": "none",
            "path.simplify_threshold": 0.2,
        }
    )
    return plt


def svg_of(figure: Any) -> str:
    """A figure as an SVG file's text; the figure is closed."""
    plt = pyplot()
    buffer = StringIO()
    with plt.rc_context({"svg.hashsalt": "figure"}):
        figure.savefig(buffer, format="svg", bbox_inches="tight", metadata={"Date": None})
    plt.close(figure)
    return buffer.getvalue()
