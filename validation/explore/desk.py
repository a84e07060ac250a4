"""Work of a live page in a process of its own, so that nothing blocks the page and all of it ends with the page."""

import time
from collections import deque
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from functools import partial
from math import inf
from typing import Any

from drivers.base.errors import RunError
from drivers.run.execute import Worker, get_ready, idle_worker
from validation.explore.views import view_of

PATIENCE_S = 1.0  # work that has taken longer is ended for newer work

Wish = tuple[Callable[[Any], Any], Any, Callable[[Any], None]]


class Desk:
    """A worker process that does one thing after another; of wishes that wait it does the newest alone."""

    def __init__(self, call: Callable[[Callable[[], None]], Any]) -> None:
        """``call`` calls a function in the thread of the page."""
        self._call = call
        self._waiting = deque[Wish](maxlen=1)
        self._thread = ThreadPoolExecutor(1)
        self._worker: Worker | None = None
        self._began_s = inf
        self._closed = False

    def ask(self, work: Callable[[Any], Any], item: Any, then: Callable[[Any], None]) -> None:
        """Ask for the result of a function of an item; ``then`` gets it, or the error, unless a newer wish comes."""
        self._waiting.append((work, item, then))
        if time.perf_counter() - self._began_s > PATIENCE_S:
            self._stop()
        self._thread.submit(self._serve)

    def result(self, work: Callable[[Any], Any], item: Any) -> Future[Any]:
        """Result of a function of an item, or its error, after all work under way."""
        return self._thread.submit(self._done, work, item)

    def close(self) -> None:
        """End the process and what it does."""
        self._closed = True
        self._waiting.clear()
        self._stop()
        self._thread.shutdown(wait=False)

    def _stop(self) -> None:
        worker, self._worker = self._worker, None
        if worker is not None:
            worker.end()

    def _serve(self) -> None:
        """Do the newest wish, unless another call has done it."""
        if self._waiting:
            work, item, then = self._waiting.popleft()
            result = self._done(work, item)
            if not self._closed and not (self._waiting and isinstance(result, RunError)):
                self._call(partial(then, result))

    def _done(self, work: Callable[[Any], Any], item: Any) -> Any:
        """Result of a function of an item, or its error."""
        if self._worker is None:
            self._worker = idle_worker()
            get_ready(1, view_of)  # for the next page
        worker, self._began_s = self._worker, time.perf_counter()
        try:
            return worker.answer(work, item)[1]
        except (EOFError, OSError, ValueError):  # ended, here or by others
            self._worker = None
            return RunError("the computation was ended")
        finally:
            self._began_s = inf
