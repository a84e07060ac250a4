"""Output for a terminal: tables, paths, and progress on the standard error.

Progress is title, units done, time taken and left of the innermost task under way. On a terminal it is one line that is
rewritten. Elsewhere it is a line each minute, and one at the end of a task that took longer; short tasks have none.
"""

import sys
import threading
import time
from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from contextlib import contextmanager
from functools import cache
from io import StringIO
from itertools import zip_longest
from math import inf
from pathlib import Path
from typing import Any, TypeVar

from drivers.base import paths
from drivers.base.errors import printable

Item = TypeVar("Item")
REFRESH_S, SILENCE_S = 1.0, 60.0  # time between lines on a terminal and elsewhere
COUNTED = "{desc}: {n_fmt} of {total_fmt} {unit}s in {elapsed}, {remaining} left"
_under_way: list[Any] = []  # the innermost task is last


def say(line: str) -> None:
    """Print a line to the standard error, above the line that is rewritten."""
    from tqdm import tqdm

    tqdm.write(printable(line), file=sys.stderr)


@contextmanager
def counted(what: str, total: int | None = None, unit: str = "run") -> Iterator[Callable[..., Any]]:
    """Show a task; yields a function that counts units."""
    from tqdm import tqdm  # commands that only print tables need not load it

    file = sys.stderr if _watched() else StringIO()
    look = COUNTED if total else "{desc}: {elapsed}"
    bar = tqdm(desc=printable(what), total=total, unit=unit, bar_format=look, file=file, position=0, nrows=2, delay=inf)
    _under_way.append(bar)
    _keep_talking()
    try:
        yield bar.update
    finally:
        _under_way.remove(bar)
        bar.clear()
        if file is not sys.stderr and bar.format_dict["elapsed"] >= SILENCE_S:
            say(str(bar))
        bar.close()


def following(items: Iterable[Item], what: str, total: int | None = None, unit: str = "run") -> Iterator[Item]:
    """Yield items and count them as progress."""
    with counted(what, total, unit) as count:
        for item in items:
            yield item
            count()


@cache
def _keep_talking() -> None:
    """Start the thread that shows the innermost task, also while it counts nothing; tqdm's own thread does not."""

    def talk() -> None:
        while True:
            time.sleep(REFRESH_S if _watched() else SILENCE_S)
            for bar in _under_way[-1:]:
                bar.refresh() if _watched() else say(str(bar))

    threading.Thread(target=talk, daemon=True).start()


def _watched() -> bool:
    """True if the standard error is a terminal; it may have been closed at the end of the program."""
    return not sys.stderr.closed and sys.stderr.isatty()


def in_words(seconds: float) -> str:
    """Duration as text, such as ``12 ms``, ``20 s``, ``5 min``, ``2.0 h``."""
    if seconds < 99.5:
        return f"{seconds:.2g} s" if seconds >= 0.0995 else f"{1e3 * seconds:.2g} ms"
    return f"{seconds / 60:.0f} min" if seconds < 6000 else f"{seconds / 3600:.1f} h"


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


def print_paths(written: Iterable[Path]) -> None:
    """Print the paths of written files, each as soon as it is written."""
    for path in written:
        print(paths.shown(path), flush=True)
