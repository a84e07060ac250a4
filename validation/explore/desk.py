"""Work of a live page in a process of its own, so that nothing blocks the page and all of it ends with the page."""

import time
from collections import deque
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from functools import partial
from math import inf
from threading import Lock
from typing import Any

from drivers.base.errors import RunError
from drivers.run.execute import Worker

PATIENCE_S = 1.0  # a wish that has taken longer is ended for a newer one
ENDED = RunError("the computation was ended")

Wish = tuple[Callable[[Any], Any], Any, Callable[[Any], None]]


class Desk:
    """A worker process that does one thing after another; of wishes that wait it does the newest alone."""

    def __init__(self, call: Callable[[Callable[[], None]], Any]) -> None:
        """``call`` calls a function in the thread of the page."""
        self._call = call
        self._waiting = deque[Wish](maxlen=1)
        self._thread = ThreadPoolExecutor(1)
        self._lock = Lock()
        self._worker: Worker | None = None
        self._began_s = inf  # of the wish under way
        self._closed = False

    def ask(self, work: Callable[[Any], Any], item: Any, then: Callable[[Any], None]) -> None:
        """Ask for the result of a function of an item; ``then`` gets it, or the error, unless a newer wish comes."""
        self._waiting.append((work, item, then))
        if time.perf_counter() - self._began_s > PATIENCE_S:
            self._stop()
        self._thread.submit(self._serve)

    def result(self, work: Callable[[Any], Any], item: Any, then: Callable[[Any], None] | None = None) -> Future[Any]:
        """Result of a function of an item, or its error, after all work under way; ``then`` gets it as well."""
        return self._thread.submit(self._do, work, item, then)

    def close(self) -> None:
        """End the process and what it does; what waits is not done."""
        with self._lock:
            self._closed = True
        self._thread.shutdown(wait=False, cancel_futures=True)
        self._stop()

    def _stop(self) -> None:
        with self._lock:
            worker, self._worker = self._worker, None
        if worker is not None:
            worker.end()

    def _serve(self) -> None:
        """Do the newest wish, unless another call has done it."""
        if self._waiting:
            wish, self._began_s = self._waiting.popleft(), time.perf_counter()
            self._do(*wish)
            self._began_s = inf

    def _do(self, work: Callable[[Any], Any], item: Any, then: Callable[[Any], None] | None) -> Any:
        """Result of a function of an item, or its error; by a new process if others have ended that of the desk."""
        result: Any = ENDED
        for _ in range(2):
            with self._lock:
                if self._closed:
                    return ENDED
                worker = self._worker = self._worker or Worker()
            try:
                _, result = worker.answer(work, item)
                break
            except (EOFError, OSError, ValueError):
                if self._worker is not worker:  # ended for a newer wish, or by ``close``
                    return ENDED
                self._stop()
        if then is not None and not self._closed:
            self._call(partial(then, result))
        return result
