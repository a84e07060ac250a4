"""Products of figure modules: a figure with its numbers, and spacetime diagrams of its chains.

A spacetime diagram shows the contact forces against time and contact: a wave is a slope, a reflection a fold.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from drivers.base.files import whole_file
from drivers.chain.chain import Array
from drivers.chain.trace import CONTACT, Trace
from postproc.draw.style import COLUMN_IN, MICRO, colour_map, finish_bar, pyplot

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
