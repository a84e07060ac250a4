"""What a figure module makes: a figure and the numbers in it, written side by side."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pandas as pd

from drivers.base.files import whole_file
from drivers.chain.trace import Trace
from postproc.draw.spacetime import SPACETIME, draw_spacetime, spacetime_table
from postproc.draw.style import COLUMN_IN, pyplot

DPI = 200
METADATA = {"png": {"Software": None}, "svg": {"Date": None}}  # nothing that changes from day to day


@dataclass(frozen=True)
class Product:
    """A figure with its numbers.

    Attributes:
        figure: of matplotlib.
        table: the plotted numbers, units in the column names.
        chains: by title, what is drawn beside it against time and place.
    """

    figure: Any
    table: pd.DataFrame
    chains: Mapping[str, Trace] = field(default_factory=dict)


def spacetime_product(chains: Mapping[str, Trace], width_in: float = COLUMN_IN) -> Product:
    """Forces of chains by title against time and place, with the numbers in the cells."""
    return Product(draw_spacetime(chains, width_in), spacetime_table(chains))


def write_product(product: Product, name: str, folder: Path) -> list[Path]:
    """Writes ``name.csv``, ``name.png`` and ``name.svg``, each whole or not at all, and its chains beside them."""
    folder.mkdir(parents=True, exist_ok=True)
    table = folder / f"{name}.csv"
    with whole_file(table) as draft:
        product.table.to_csv(draft, index=False)
    written = [table, *write_figure(product.figure, name, folder)]
    if product.chains:
        written += write_product(spacetime_product(product.chains), f"{name}-{SPACETIME}", folder)
    return written


def write_figure(figure: Any, name: str, folder: Path) -> list[Path]:
    """Writes ``name.png`` and ``name.svg``, each whole or not at all, and closes the figure."""
    plt = pyplot()
    written = [folder / f"{name}.{ending}" for ending in METADATA]
    for path, (ending, metadata) in zip(written, METADATA.items(), strict=True):
        with whole_file(path) as draft, plt.rc_context({"svg.hashsalt": name}):
            figure.savefig(draft, format=ending, dpi=DPI, bbox_inches="tight", metadata=metadata)
    plt.close(figure)
    return written
