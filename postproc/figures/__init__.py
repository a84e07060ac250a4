"""The paper's figures and its table: a module each, found by its file.

The first line of a module says what it shows. Its ``make(runs)`` runs what is not done and returns a ``Product``.
"""

import ast
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from postproc.draw.product import Product


def figures() -> dict[str, str]:
    """First lines of all figures, by name; none is imported."""
    files = sorted(Path(__file__).parent.glob("[a-z]*.py"))
    lines = {file.stem: ast.get_docstring(ast.parse(file.read_text(encoding="utf-8"))) or "" for file in files}
    return {name: text.partition("\n")[0].rstrip(".") for name, text in lines.items()}


def make_figure(name: str, runs: Path) -> "Product":
    """A figure, with what it needs run."""
    product: Product = import_module(f"{__name__}.{name}").make(runs)
    return product
