"""What a figure module makes: a figure and the numbers in it, written side by side."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pandas as pd

from drivers.base.files import whole_file
from postproc.draw.style import pyplot

DPI = 200
METADATA = {"png": {"Software": None}, "svg": {"Date": None}}  # nothing that changes from day to day


@dataclass(frozen=True)
class Product:
    """A figure with its numbers.

    Attributes:
        figure: of matplotlib.
        table: the plotted numbers, units in the column names.
        beside: further figures that go with it, by what their names end in.
    """

    figure: Any
    table: pd.DataFrame
    beside: Mapping[str, "Product"] = field(default_factory=dict)


def write_product(product: Product, name: str, folder: Path) -> list[Path]:
    """Writes ``name.csv``, ``name.png`` and ``name.svg``, each whole or not at all, and what goes beside them."""
    folder.mkdir(parents=True, exist_ok=True)
    table = folder / f"{name}.csv"
    with whole_file(table) as draft:
        product.table.to_csv(draft, index=False)
    written = [table, *write_figure(product.figure, name, folder)]
    for ending, other in product.beside.items():
        written += write_product(other, f"{name}-{ending}", folder)
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
