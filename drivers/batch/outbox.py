"""Rows on their way to the store: none waits longer than a second, however long the next case takes."""

import os
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from drivers.batch.leases import ALIVE
from drivers.batch.store import Row, commit

COMMIT_S = 1.0


class Outbox:
    """Collects rows and commits them every second, many to a file."""

    def __init__(self, store: Path, workplace: Path) -> None:
        self._store = store
        self._workplace = workplace
        self._rows: list[Row] = []
        self._lock = threading.Lock()
        self._error: OSError | None = None

    def add(self, row: Row) -> None:
        """Takes a row.

        Raises:
            OSError: rows could not be committed.
        """
        with self._lock:
            if self._error is not None:
                raise self._error
            self._rows.append(row)

    def flush(self) -> None:
        """Commits what there is, now.

        Raises:
            OSError: the disk is full, or something else is wrong with the runs folder.
        """
        with self._lock:
            commit(self._rows, self._store, self._workplace)
            self._rows = []

    def keep_flushing(self, until: threading.Event) -> None:
        """Commits every second and shows that the workplace is alive."""
        while not until.wait(COMMIT_S):
            try:
                os.utime(self._workplace / ALIVE)
                self.flush()
            except OSError as error:
                self._error = error
                return


@contextmanager
def outbox(store: Path, workplace: Path) -> Iterator[Outbox]:
    """An outbox that is empty afterwards, whatever happens."""
    box, through = Outbox(store, workplace), threading.Event()
    thread = threading.Thread(target=box.keep_flushing, args=(through,), daemon=True)
    thread.start()
    try:
        yield box
    finally:
        through.set()
        thread.join()
        box.flush()
