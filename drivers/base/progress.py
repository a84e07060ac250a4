"""Progress on the terminal: which step, what it does, how long it is likely to take.

A bar where somebody watches; elsewhere a line for each step, and one now and then while it lasts. Estimates are what
the step took the last time on this machine, or what ``inputs/durations.toml`` has of another.
"""

import json
import os
import sys
import threading
import time
import tomllib
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from typing import Any, TypeVar

from drivers.base import paths
from drivers.base.files import whole_file

Item = TypeVar("Item")
NOTE = ".durations.json"  # in the runs folder
QUIET_S = 4.0  # the longest time without a word
REFRESH_S = 0.5


@dataclass(eq=False)
class _Task:
    """What is under way: ``done`` of ``total`` units since ``began``; with its bar."""

    what: str
    total: int | None
    unit: str
    bar: Any
    began: float = field(default_factory=time.perf_counter)
    done: int = 0

    def __str__(self) -> str:
        """How far it is, for a line of its own."""
        took_s = time.perf_counter() - self.began
        if self.total is None:
            return f"{self.what}: {took_s:.0f} s so far"
        left = f", about {in_words(took_s * (self.total - self.done) / self.done)} left" if self.done else ""
        return f"{self.what}: {self.done} of {self.total} {self.unit}s in {took_s:.0f} s{left}"


_under_way: list[_Task] = []
_depth = 0  # of steps within steps
_last_word = 0.0
_lock = threading.RLock()
_news = threading.Event()


def say(line: str) -> None:
    """Prints a line to the standard error, above the bars."""
    global _last_word
    from tqdm import tqdm

    with _lock:
        tqdm.write(line, file=sys.stderr)
        sys.stderr.flush()
        _last_word = time.perf_counter()


@contextmanager
def step(what: str, number: int = 1, of: int = 1, *, total: int | None = None, unit: str = "run") -> Iterator[Any]:
    """One of some steps: a line when it begins, unless it is alone; yields the function that counts its units."""
    global _depth
    expected, began = _expected(what), time.perf_counter()
    if of > 1:
        say(f"{'  ' * _depth}step {number} of {of}: {what}{expected}")
        expected = ""
    _depth += of > 1
    try:
        with counted(f"{what}{expected}", total, unit) as count:
            yield count
    finally:
        _depth -= of > 1
    _note(what, time.perf_counter() - began)


@contextmanager
def counted(what: str, total: int | None = None, unit: str = "run") -> Iterator[Callable[[], None]]:
    """Something that takes a while, without a line of its own; yields the function that counts a unit of it."""
    global _last_word
    from tqdm import tqdm

    look: dict[str, Any] = {"leave": False, "dynamic_ncols": True, "file": sys.stderr, "disable": not _watched()}
    bar = tqdm(total=total, desc=what, unit=unit, bar_format="{desc}: {elapsed}" if total is None else None, **look)
    task = _Task(what, total, unit, bar)
    with _lock:
        if not _under_way:
            _last_word = time.perf_counter()
        if not any(thread.name == __name__ for thread in threading.enumerate()):
            threading.Thread(target=_keep_talking, name=__name__, daemon=True).start()
        _under_way.append(task)
    _news.set()

    def count() -> None:
        task.done += 1
        bar.update()

    try:
        yield count
    finally:
        with _lock:
            _under_way.remove(task)
        bar.close()


def _watched() -> bool:
    """Whether a terminal shows the standard error; recorders have some without a size, where no bar is seen."""
    try:
        return sys.stderr.isatty() and all(os.get_terminal_size(sys.stderr.fileno()))
    except (OSError, AttributeError, ValueError):
        return False


def following(items: Iterable[Item], what: str, total: int | None = None, unit: str = "run") -> Iterator[Item]:
    """Items as they come, counted."""
    with counted(what, total, unit) as count:
        for item in items:
            yield item
            count()


def _keep_talking() -> None:
    """Keeps bars moving, or says now and then how far the innermost task is; for ever, in a thread of its own."""
    while True:
        time.sleep(REFRESH_S)
        with _lock:
            task = _under_way[-1] if _under_way else None
            if task is None:
                _news.clear()
            elif not task.bar.disable:
                for each in _under_way:
                    each.bar.refresh()
            elif time.perf_counter() - _last_word > QUIET_S - REFRESH_S:
                say(f"{'  ' * _depth}{task}")
        if task is None:
            _news.wait()


def in_words(seconds: float) -> str:
    """A time as people say it."""
    if seconds < 100:
        return f"{seconds:.2g} s"
    return f"{seconds / 60:.0f} min" if seconds < 6000 else f"{seconds / 3600:.1f} h"


def _noted() -> dict[str, float]:
    with suppress(OSError, ValueError):
        return {str(what): float(seconds) for what, seconds in json.loads((paths.RUNS / NOTE).read_text()).items()}
    return {}


def _expected(what: str) -> str:
    here = _noted().get(what)
    if here is not None:
        return f" (about {in_words(here)}, an estimate by the last time)"
    elsewhere = tomllib.loads(paths.DURATIONS.read_text()).get(what)
    return f" (about {in_words(elsewhere)}, an estimate by another machine)" if elsewhere else ""


def _note(what: str, seconds: float) -> None:
    with suppress(OSError):  # a place where nobody may write: there is no estimate the next time
        paths.RUNS.mkdir(parents=True, exist_ok=True)
        with whole_file(paths.RUNS / NOTE) as draft:
            draft.write_text(json.dumps(_noted() | {what: round(seconds, 1)}, indent=1))
