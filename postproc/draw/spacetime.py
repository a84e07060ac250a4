"""Contact forces of a whole chain against time: a wave is a slope, a reflection a fold."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd

from drivers.chain.chain import Array
from drivers.chain.trace import Trace
from postproc.draw.product import Product
from postproc.draw.style import force_colours, pyplot

SPACETIME = "spacetime"  # what the names of these figures end in
COLUMNS, ROWS = 400, 250  # cells at most: of more samples and contacts a cell shows the largest force
PANEL_IN = 1.9
GAMMA = 0.5  # a colour goes with the root of the force, so that what follows a wave is seen beside it
LEAST = 1e-6  # of the largest force: below it a contact counts as open
MICRO = 1e6


@dataclass(frozen=True)
class Panel:
    """One chain's forces, and what stands above them."""

    title: str
    trace: Trace


@dataclass(frozen=True)
class Cells:
    """Forces gathered into cells.

    Attributes:
        time_s: first sample of each column. Shape (columns,).
        contact: lowest contact of each row, counted from the wall. Shape (rows,).
        force_N: the largest in each cell. Shape (rows, columns).
    """

    time_s: Array
    contact: Array
    force_N: Array

    @property
    def largest_N(self) -> float:
        """What the scale of colours ends at; 1 N where there is no force."""
        return float(self.force_N.max(initial=0.0)) or 1.0

    @property
    def closed_N(self) -> Any:
        """The forces with open contacts masked. Shape (rows, columns)."""
        return np.ma.masked_less_equal(self.force_N, LEAST * self.largest_N)


def cells_of(trace: Trace, columns: int = COLUMNS, rows: int = ROWS) -> Cells:
    """A trace's forces in so many cells at most, all of a size but for the last ones."""
    samples, contacts = trace.force_N.shape
    over_time = np.arange(0, samples, -(-samples // columns))
    over_contacts = np.arange(0, contacts, -(-contacts // rows))
    force = np.maximum.reduceat(np.maximum.reduceat(trace.force_N, over_time, axis=0), over_contacts, axis=1)
    return Cells(trace.time_s[over_time], over_contacts + 1.0, force.T)


def draw_spacetime(panels: Sequence[Panel], width_in: float) -> Any:
    """A panel for each chain, each with its own scale of force; white beyond a run's end. Returns a figure."""
    figure, axes = pyplot().subplots(
        len(panels),
        1,
        figsize=(width_in, 0.5 + PANEL_IN * len(panels)),
        squeeze=False,
        sharex=True,
        layout="constrained",
    )
    for axis, panel in zip(axes[:, 0], panels, strict=True):
        _draw(axis, panel)
    axes[-1, 0].set_xlim(0, max(float(panel.trace.time_s[-1]) for panel in panels) * MICRO)
    axes[-1, 0].set_xlabel("time since impact (µs)")
    return figure


def spacetime_product(panels: Sequence[Panel], width_in: float) -> Product:
    """The figure with the numbers in its cells."""
    tables = []
    for panel in panels:
        cells = cells_of(panel.trace)
        names = [f"contact_{contact:.0f}_N" for contact in cells.contact]
        table = pd.DataFrame(cells.force_N.T, columns=names)
        table.insert(0, "time_s", cells.time_s)
        table.insert(0, "chain", panel.title)
        tables.append(table)
    return Product(draw_spacetime(panels, width_in), pd.concat(tables, ignore_index=True))


def _draw(axis: Any, panel: Panel) -> None:
    from matplotlib.colors import PowerNorm
    from matplotlib.ticker import MaxNLocator

    trace, cells = panel.trace, cells_of(panel.trace)
    contacts = trace.force_N.shape[1]
    width = (trace.time_s[-1] - trace.time_s[0]) / max(len(trace.time_s) - 1, 1) * -(-len(trace.time_s) // COLUMNS)
    deep = -(-contacts // ROWS)
    extent = (
        float(cells.time_s[0]) * MICRO, float(cells.time_s[-1] + width) * MICRO,
        0.5, float(cells.contact[-1]) + deep - 0.5,
    )  # fmt: skip
    image = axis.imshow(
        cells.closed_N, cmap=force_colours(), norm=PowerNorm(GAMMA, 0, cells.largest_N), origin="lower", aspect="auto",
        extent=extent, interpolation="none",
    )  # fmt: skip
    axis.set(ylim=(0.5, contacts + 0.5), ylabel="contact")
    axis.grid(visible=False)
    axis.yaxis.set_major_locator(MaxNLocator(integer=True, nbins=5, min_n_ticks=1))
    axis.set_title(panel.title, loc="left")
    bar = axis.figure.colorbar(image, ax=axis, pad=0.02, aspect=16, ticks=MaxNLocator(nbins=5))
    bar.set_label("force (N); grey: none")
    bar.outline.set_linewidth(0.5)
    bar.solids.set_rasterized(True)
