"""The paper's figures and its table: one module each, found by its file.

The docstring of a module is the caption of the figure, in three paragraphs: title, finding, panels by letter. Its
function ``make(runs)`` runs the missing simulations and returns a ``Product``. A figure of one's own is a file of the
same shape at any place; its title is enough.
"""

import ast
from functools import cache
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from drivers.base import paths
from drivers.base.errors import InputError

if TYPE_CHECKING:
    from postproc.draw.plot import Product


class Caption(NamedTuple):
    """Words of a figure: its title, the finding that it shows, and the caption proper."""

    title: str
    shows: str = ""
    text: str = ""


def caption_of(file: Path) -> Caption:
    """Caption in the docstring of a file, which is not executed.

    Raises:
        InputError: There is no such file, it is not Python, or its docstring is no caption.
    """
    where = paths.shown(file)
    try:
        words = ast.get_docstring(ast.parse(file.read_bytes(), file.name)) or ""
    except (OSError, SyntaxError, ValueError) as error:
        raise InputError(where, "", f"cannot be read ({error})") from error
    title, *more = (" ".join(part.split()) for part in words.split("\n\n"))
    if not title or len(more) > 2:
        allowed = "the caption: title, then, after empty lines, finding and panels if the figure has them"
        raise InputError(where, "docstring", f"{len(more) + bool(title)} paragraphs", allowed)
    return Caption(title.rstrip("."), *more)


@cache
def captions() -> dict[str, Caption]:
    """Captions of all figures by name."""
    return {file.stem: caption_of(file) for file in sorted(Path(__file__).parent.glob("[a-z]*.py"))}


def make_figure(name: str, runs: Path) -> "Product":
    """Makes a figure, with the simulations that it needs."""
    product: Product = import_module(f"{__name__}.{name}").make(runs)
    return product
