"""Tables of text in a terminal."""

from collections.abc import Collection, Iterable, Sequence
from itertools import zip_longest

from drivers.base.errors import printable


def text_table(rows: Iterable[Sequence[str]], right: Collection[int] = ()) -> list[str]:
    """Lines of a table, each column as wide as its longest cell, two spaces apart.

    Args:
        rows: cells of each line, the heading first; a row may be shorter than others.
        right: places of the columns to align right, counted from 0.
    """
    table = [tuple(printable(cell, lines=False) for cell in row) for row in rows]
    widths = [max(map(len, column)) for column in zip_longest(*table, fillvalue="")]
    return [
        "  ".join(f"{cell:{'>' if place in right else '<'}{widths[place]}}" for place, cell in enumerate(row)).rstrip()
        for row in table
    ]
