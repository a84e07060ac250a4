"""What a figure module makes: a figure and the numbers in it, written side by side."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pandas as pd

from drivers.whole_file import whole_file
from postproc.style import pyplot

DPI = 200
METADATA = {"png": {"Software": None}, "svg": {"Date": None}}  # nothing that changes from day to day


@dataclass(frozen=True)
class Product:
    """A figure with its numbers.

    Attributes:
        figure: of matplotlib.
        table: the plotted numbers, units in the column names.
        more: further tables by what is added to the name.
    """

    figure: Any
    table: pd.DataFrame
    more: dict[str, pd.DataFrame] = field(default_factory=dict)


def write_product(product: Product, name: str, folder: Path) -> list[Path]:
    """Writes ``name.svg``, ``name.png``, ``name.csv`` and further tables, each whole or not at all."""
    plt = pyplot()
    folder.mkdir(parents=True, exist_ok=True)
    written = []
    for added, table in {"": product.table, **product.more}.items():
        written.append(folder / f"{name}{added}.csv")
        with whole_file(written[-1]) as draft:
            table.to_csv(draft, index=False)
    for ending, metadata in METADATA.items():
        written.append(folder / f"{name}.{ending}")
        with whole_file(written[-1]) as draft, plt.rc_context({"svg.hashsalt": name}):
            product.figure.savefig(draft, format=ending, dpi=DPI, bbox_inches="tight", metadata=metadata)
    plt.close(product.figure)
    return written
