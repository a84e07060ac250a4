"""The paper's figures and its table: one module each, found by its file.

The docstring of a module is the caption of the figure, in three paragraphs: title, finding, panels by letter. Its
function ``make(runs)`` runs the missing simulations and returns a ``Product``.
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
    """Words of a figure: its title, the finding that it shows, and the caption proper."""

    title: str
    shows: str
    text: str


@cache
def captions() -> dict[str, Caption]:
    """Captions of all figures by name, read without importing the modules."""
    by_name = {}
    for file in sorted(Path(__file__).parent.glob("[a-z]*.py")):
        words = ast.get_docstring(ast.parse(file.read_text(encoding="utf-8"))) or ""
        title, shows, text = (" ".join(part.split()) for part in words.split("\n\n"))
        by_name[file.stem] = Caption(title.rstrip("."), shows, text)
    return by_name


def make_figure(name: str, runs: Path) -> "Product":
    """Makes a figure, with the simulations that it needs."""
    product: Product = import_module(f"{__name__}.{name}").make(runs)
    return product
