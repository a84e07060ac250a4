"""Work of a live page in a process of its own, so that nothing blocks the page and all of it ends with the page."""

import time
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from functools import partial
from math import inf
from typing import Any

from drivers.base.errors import RunError
from drivers.run.execute import Worker

PATIENCE_S = 1.0  # a wish that has taken longer is ended for a newer one
ENDED = RunError("the computation was ended")

Then = Callable[[Any], None]


class Desk:
    """A worker process that does one thing after another; of wishes that wait it does the newest alone."""

    def __init__(self, call: Callable[[Callable[[], None]], Any]) -> None:
        """``call`` calls a function in the thread of the page."""
        self._call = call
        self._thread = ThreadPoolExecutor(1)
        self._worker = Worker()
        self._wish: Future[Any] = Future()
        self._began_s = inf  # of the work under way
        self._closed = False

    def ask(self, work: Callable[[Any], Any], item: Any, then: Then) -> None:
        """Ask for the result of a function of an item; ``then`` gets it, or the error, unless a newer wish comes."""
        self._wish.cancel()  # if it waits
        if self._wish.running() and time.perf_counter() - self._began_s > PATIENCE_S:
            self._worker, slow = Worker(), self._worker
            slow.end()
        self._wish = self.result(work, item, then)

    def result(self, work: Callable[[Any], Any], item: Any, then: Then | None = None) -> Future[Any]:
        """Result of a function of an item, or its error, after all work under way; ``then`` gets it as well."""
        return self._thread.submit(self._do, work, item, then)

    def close(self) -> None:
        """End the process and what it does; what waits is not done."""
        self._closed = True
        self._thread.shutdown(wait=False, cancel_futures=True)
        self._worker.end()

    def _do(self, work: Callable[[Any], Any], item: Any, then: Then | None) -> Any:
        """Result of a function of an item, or its error; by a new process if others have ended that of the desk."""
        result: Any = ENDED
        self._began_s = time.perf_counter()
        for _ in range(2):
            worker = self._worker
            try:
                _, result = worker.answer(work, item)
                break
            except (EOFError, OSError, ValueError):
                if self._closed or self._worker is not worker:  # ended by ``close``, or for a newer wish
                    return ENDED
                self._worker = Worker()
        if then is not None and not self._closed:
            self._call(partial(then, result))
        return result
