"""Progress on the standard error: step number, title, units done, time left.

On a terminal a bar; elsewhere a line for each step and a further line every few seconds.
"""

import os
import sys
import threading
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any, TextIO, TypeVar

from drivers.base.errors import printable

Item = TypeVar("Item")
MAX_SILENCE_S = 2.0
REFRESH_S = 0.5


@dataclass(eq=False)
class _Task:
    """Running task: ``done`` of ``total`` units since ``began``, with its bar, and the standard error at its start."""

    what: str
    total: int | None
    unit: str
    bar: Any
    began: float = field(default_factory=time.perf_counter)
    done: int = 0
    stream: TextIO = field(default_factory=lambda: sys.stderr)

    def __str__(self) -> str:
        """Progress as a line of text."""
        took_s = time.perf_counter() - self.began
        if self.total is None:
            return f"{self.what}: {took_s:.0f} s so far"
        left = f", about {in_words(took_s * (self.total - self.done) / self.done)} left" if self.done else ""
        return f"{self.what}: {self.done} of {self.total} {self.unit}s in {took_s:.0f} s{left}"


_under_way: list[_Task] = []
_depth = 0  # nesting of steps
_last_line = 0.0
_lock = threading.RLock()
_news = threading.Event()


def say(line: str, stream: TextIO | None = None) -> None:
    """Print a line to the standard error or another stream, above the bars."""
    global _last_line
    from tqdm import tqdm

    stream = stream or sys.stderr
    with _lock:
        tqdm.write(printable(line), file=stream)
        stream.flush()
        _last_line = time.perf_counter()


@contextmanager
def step(what: str, number: int, of: int) -> Iterator[None]:
    """Show one step of a command, with a line at its start if ``of`` is above 1."""
    global _depth
    if of > 1:
        say(f"{'  ' * _depth}step {number} of {of}: {what}")
    _depth += of > 1
    try:
        with counted(what):
            yield
    finally:
        _depth -= of > 1


@contextmanager
def counted(
    what: str, total: int | None = None, unit: str = "run", *, bar: bool = True
) -> Iterator[Callable[..., None]]:
    """Show a task without a line at its start; yields a function that counts units. Without ``bar`` it prints lines."""
    global _last_line
    from tqdm import tqdm

    what = printable(what)
    look: dict[str, Any] = {
        "leave": False,
        "dynamic_ncols": True,
        "file": sys.stderr,
        "disable": not (bar and _watched()),
    }
    shown = tqdm(total=total, desc=what, unit=unit, bar_format="{desc}: {elapsed}" if total is None else None, **look)
    task = _Task(what, total, unit, shown)
    with _lock:
        if not _under_way:
            _last_line = time.perf_counter()
        if not any(thread.name == __name__ for thread in threading.enumerate()):
            threading.Thread(target=_keep_talking, name=__name__, daemon=True).start()
        _under_way.append(task)
    _news.set()

    def count(units: int = 1) -> None:
        task.done += units
        shown.update(units)

    try:
        yield count
    finally:
        with _lock:
            _under_way.remove(task)
        shown.close()


def _watched() -> bool:
    """True if the standard error is a terminal with a size; recorders may have none, and show no bar."""
    try:
        return sys.stderr.isatty() and all(os.get_terminal_size(sys.stderr.fileno()))
    except (OSError, AttributeError, ValueError):
        return False


def following(items: Iterable[Item], what: str, total: int | None = None, unit: str = "run") -> Iterator[Item]:
    """Yield items and count them as progress."""
    with counted(what, total, unit) as count:
        for item in items:
            yield item
            count()


def _keep_talking() -> None:
    """Refresh the bars, or print the progress of the innermost task; runs for ever in its own thread."""
    while True:
        time.sleep(REFRESH_S)
        with _lock:
            task = _under_way[-1] if _under_way else None
            if task is None:
                _news.clear()
            elif not task.bar.disable:
                for running in _under_way:
                    running.bar.refresh()
            elif time.perf_counter() - _last_line > MAX_SILENCE_S - REFRESH_S:
                say(f"{'  ' * _depth}{task}", _under_way[0].stream)  # tests may have replaced the standard error
        if task is None:
            _news.wait()


def in_words(seconds: float) -> str:
    """Duration as text, such as ``12 ms``, ``20 s``, ``5 min``, ``2.0 h``."""
    if seconds < 99.5:
        return f"{seconds:.2g} s" if seconds >= 0.0995 else f"{1e3 * seconds:.2g} ms"
    return f"{seconds / 60:.0f} min" if seconds < 6000 else f"{seconds / 3600:.1f} h"
