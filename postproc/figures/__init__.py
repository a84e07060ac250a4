"""The paper's figures and its table: a module each, found by its file.

A module's docstring is its caption, wherever one is shown: a title in the first line, below it the panels by letter.
Its ``make(runs)`` runs what is not done and returns a ``Product``.
"""

import ast
from dataclasses import dataclass
from functools import cache
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from postproc.draw.product import Product


@dataclass(frozen=True)
class Caption:
    """Words to a figure."""

    title: str
    text: str


@cache
def captions() -> dict[str, Caption]:
    """Captions of all figures, by name; none is imported."""
    found = {}
    for file in sorted(Path(__file__).parent.glob("[a-z]*.py")):
        words = ast.get_docstring(ast.parse(file.read_text(encoding="utf-8"))) or ""
        title, _, text = words.partition("\n")
        found[file.stem] = Caption(title.rstrip("."), " ".join(text.split()))
    return found


def make_figure(name: str, runs: Path) -> "Product":
    """A figure, with what it needs run."""
    product: Product = import_module(f"{__name__}.{name}").make(runs)
    return product
