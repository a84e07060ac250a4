"""Contact forces of a whole chain against time: a wave is a slope, a reflection a fold."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd

from drivers.chain.chain import Array
from drivers.chain.trace import Trace
from postproc.draw.style import COLUMN_IN, MICRO, finish_bar, force_colours, pyplot

SPACETIME = "spacetime"  # what the names of these figures end in
COLUMNS, ROWS = 400, 250  # cells at most: of more samples and contacts a cell shows the largest force
PANEL_IN = 1.9
GAMMA = 0.5  # a colour goes with the root of the force, so that what follows a wave is seen beside it
LEAST = 1e-6  # of the largest force: below it a contact counts as open


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


def draw_spacetime(chains: Mapping[str, Trace], width_in: float = COLUMN_IN) -> Any:
    """A panel for each chain by title, each with its own scale of force; white beyond a run's end. Returns a figure."""
    size = (width_in, 0.5 + PANEL_IN * len(chains))
    figure, axes = pyplot().subplots(len(chains), 1, figsize=size, squeeze=False, sharex=True, layout="constrained")
    for axis, (title, trace) in zip(axes[:, 0], chains.items(), strict=True):
        _draw(axis, title, trace)
    last_s = max(float(trace.time_s[-1]) for trace in chains.values())
    axes[-1, 0].set(xlim=(0, last_s * MICRO), xlabel="time since impact (µs)")
    return figure


def spacetime_table(chains: Mapping[str, Trace]) -> pd.DataFrame:
    """The numbers in the cells of ``draw_spacetime``, a row per chain and time."""
    tables = []
    for title, trace in chains.items():
        cells = cells_of(trace)
        table = pd.DataFrame(cells.force_N.T, columns=[f"contact_{contact:.0f}_N" for contact in cells.contact])
        table.insert(0, "time_s", cells.time_s)
        table.insert(0, "chain", title)
        tables.append(table)
    return pd.concat(tables, ignore_index=True)


def _draw(axis: Any, title: str, trace: Trace) -> None:
    from matplotlib.colors import PowerNorm
    from matplotlib.ticker import MaxNLocator

    cells, (samples, contacts) = cells_of(trace), trace.force_N.shape
    width_s = (trace.time_s[-1] - trace.time_s[0]) / max(samples - 1, 1) * -(-samples // COLUMNS)
    right, top = float(cells.time_s[-1] + width_s) * MICRO, float(cells.contact[-1]) + -(-contacts // ROWS) - 0.5
    image = axis.imshow(
        cells.closed_N, cmap=force_colours(), norm=PowerNorm(GAMMA, 0, cells.largest_N), origin="lower", aspect="auto",
        extent=(float(cells.time_s[0]) * MICRO, right, 0.5, top), interpolation="none",
    )  # fmt: skip
    axis.set(ylim=(0.5, contacts + 0.5), ylabel="contact")
    axis.grid(visible=False)
    axis.yaxis.set_major_locator(MaxNLocator(integer=True, nbins=5, min_n_ticks=1))
    axis.set_title(title, loc="left")
    bar = axis.figure.colorbar(image, ax=axis, pad=0.02, aspect=16, ticks=MaxNLocator(nbins=5))
    finish_bar(bar, "force (N); grey: none")
