"""Products of figure modules: a figure with its numbers, and spacetime diagrams of its chains.

A spacetime diagram shows the contact forces against time and contact: a wave is a slope, a reflection a fold.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from drivers.base.files import csv_of, sealed_file
from drivers.chain.chain import Array
from drivers.chain.trace import Trace
from postproc.draw.style import COLUMN_IN, MICRO, finish_bar, force_colours, pyplot

DPI = 200
METADATA = {"png": {"Software": None}, "svg": {"Date": None}}  # no dates
SPACETIME = "spacetime"  # ending of the names of spacetime diagrams
COLUMNS, ROWS = 400, 250  # largest numbers of cells; a cell shows the largest of its forces
PANEL_IN = 1.9
GAMMA = 0.5  # colours scale with the root of the force, so that weak waves after a strong one are visible
OPEN_SHARE = 1e-6  # of the largest force: contacts with less are drawn as open


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
    folder.mkdir(parents=True, exist_ok=True)
    table = folder / f"{name}.csv"
    with sealed_file(table) as draft:
        draft.write_bytes(csv_of(product.table))
    written = [table, *write_figure(product.figure, name, folder)]
    if product.chains:
        written += write_product(draw_spacetime(product.chains), f"{name}-{SPACETIME}", folder)
    return written


def write_figure(figure: Any, name: str, folder: Path) -> list[Path]:
    """Writes ``name.png`` and ``name.svg``, each whole or not at all, and closes the figure."""
    plt = pyplot()
    written = [folder / f"{name}.{ending}" for ending in METADATA]
    figure.draw_without_rendering()  # one layout for both files
    figure.set_layout_engine("none")
    edges = figure.get_tightbbox().padded(plt.rcParams["savefig.pad_inches"])
    for path, (ending, metadata) in zip(written, METADATA.items(), strict=True):
        with sealed_file(path) as draft, plt.rc_context({"svg.hashsalt": name}):
            figure.savefig(draft, format=ending, dpi=DPI, bbox_inches=edges, metadata=metadata)
    plt.close(figure)
    return written


def cells_of(trace: Trace, columns: int = COLUMNS, rows: int = ROWS) -> tuple[Array, Array, Array]:
    """Forces of a trace in at most ``rows`` by ``columns`` cells of equal size, except the last ones.

    Returns:
        Time of the first sample of each column in s, lowest contact of each row counted from the wall, and the largest
        force in each cell in N, of shape (rows, columns).
    """
    samples, contacts = trace.force_N.shape
    over_time = np.arange(0, samples, -(-samples // columns))
    over_contacts = np.arange(0, contacts, -(-contacts // rows))
    force = np.maximum.reduceat(np.maximum.reduceat(trace.force_N, over_time, axis=0), over_contacts, axis=1)
    return trace.time_s[over_time], over_contacts + 1.0, force.T


def draw_spacetime(chains: Mapping[str, Trace], width_in: float = COLUMN_IN) -> Product:
    """Spacetime diagram with a panel for each chain, each with its own scale of force; white after the end of a run.

    The table holds the forces of the cells, a row per chain and time.
    """
    from matplotlib.colors import PowerNorm
    from matplotlib.ticker import MaxNLocator

    tables = []
    size = (width_in, 0.5 + PANEL_IN * len(chains))
    figure, axes = pyplot().subplots(len(chains), 1, figsize=size, squeeze=False, sharex=True, layout="constrained")
    for axis, (title, trace) in zip(axes[:, 0], chains.items(), strict=True):
        time_s, contact, force_N = cells_of(trace)
        samples, contacts = trace.force_N.shape
        width_s = (trace.time_s[-1] - trace.time_s[0]) / max(samples - 1, 1) * -(-samples // COLUMNS)
        right, top = float(time_s[-1] + width_s) * MICRO, float(contact[-1]) + -(-contacts // ROWS) - 0.5
        largest_N = float(force_N.max(initial=0.0)) or 1.0  # without any force the scale ends at 1 N
        closed = np.ma.masked_less_equal(force_N, OPEN_SHARE * largest_N)
        image = axis.imshow(
            closed, cmap=force_colours(), norm=PowerNorm(GAMMA, 0, largest_N), origin="lower", aspect="auto",
            extent=(float(time_s[0]) * MICRO, right, 0.5, top), interpolation="none",
        )  # fmt: skip
        axis.set(ylim=(0.5, contacts + 0.5), ylabel="contact")
        axis.grid(visible=False)
        axis.yaxis.set_major_locator(MaxNLocator(integer=True, nbins=5, min_n_ticks=1))
        axis.set_title(title, loc="left")
        bar = figure.colorbar(image, ax=axis, pad=0.02, aspect=16, ticks=MaxNLocator(nbins=5))
        finish_bar(bar, "force (N), square-root scale;\ngrey: none")
        table = pd.DataFrame(force_N.T, columns=[f"contact_{number:.0f}_N" for number in contact])
        table.insert(0, "time_s", time_s)
        table.insert(0, "chain", title)
        tables.append(table)
    last_s = max(float(trace.time_s[-1]) for trace in chains.values())
    axes[-1, 0].set(xlim=(0, last_s * MICRO), xlabel="time since impact (µs)")
    return Product(figure, pd.concat(tables, ignore_index=True))
