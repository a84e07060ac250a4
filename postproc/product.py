"""What a figure module makes: a figure and the numbers in it, written side by side."""

import os
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

import pandas as pd

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
    tables = {"": product.table, **product.more}
    written = [_whole(folder / f"{name}{added}.csv", partial(_write_table, table)) for added, table in tables.items()]
    with plt.rc_context({"svg.hashsalt": name}):
        written += [_whole(folder / f"{name}.{ending}", partial(_draw, product.figure, ending)) for ending in METADATA]
    plt.close(product.figure)
    return written


def _write_table(table: pd.DataFrame, path: Path) -> None:
    table.to_csv(path, index=False)


def _draw(figure: Any, ending: str, path: Path) -> None:
    figure.savefig(path, format=ending, dpi=DPI, bbox_inches="tight", metadata=METADATA[ending])


def _whole(path: Path, write: Callable[[Path], Any]) -> Path:
    draft = path.with_name(f".{path.name}.{os.getpid()}")
    try:
        write(draft)
        draft.replace(path)
    finally:
        draft.unlink(missing_ok=True)
    return path
