"""What a figure module makes: a figure and the numbers in it, written side by side."""

import os
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pandas as pd

from postproc.style import pyplot

DPI = 200


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
        written.append(_whole(folder / f"{name}{added}.csv", lambda draft, t=table: t.to_csv(draft, index=False)))
    with plt.rc_context({"svg.hashsalt": name}):
        for ending, metadata in (("png", {"Software": None}), ("svg", {"Date": None})):
            written.append(
                _whole(
                    folder / f"{name}.{ending}",
                    lambda draft, e=ending, m=metadata: product.figure.savefig(
                        draft, format=e, dpi=DPI, bbox_inches="tight", metadata=m
                    ),
                )
            )
    plt.close(product.figure)
    return written


def _whole(path: Path, write: Callable[[Path], Any]) -> Path:
    draft = path.with_name(f".{path.name}.{os.getpid()}")
    try:
        write(draft)
        draft.replace(path)
    finally:
        draft.unlink(missing_ok=True)
    return path
