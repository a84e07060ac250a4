"""Store of finished rows, many to a file; files are written atomically, named by their digest, and never changed.

A finished row is stored within a second.
"""

import hashlib
import json
import os
import threading
from dataclasses import dataclass
from pathlib import Path

from drivers.run.workplaces import show_alive

ENDING = ".jsonl"
COMMIT_INTERVAL_S = 1.0
WORK = ".work"  # folder of the workplaces, in the store's folder


@dataclass(frozen=True)
class StudyRow:
    """Row of the table: one case on one engine.

    Attributes:
        identity: digest of everything that determines the row.
        run: digest of everything that determines the run, as in names of run folders.
        study, label: study and case; a row of the same label with another identity is stale.
        engine: name of the engine.
        status: ``done``, ``failed`` or ``timeout``.
        reason: reason of a failure; else empty.
        values: observables by name.
        force_error: largest error of the force divided by the largest change of force; None for the reference.
        trace_sha256: digest of forces and energies.
        work: bodies times steps.
        cost: time in s by activity.
        ended: time of the end, in seconds of Unix time.
        build: identity of the build (``Build.identity``); empty in rows that were stored without it.
    """

    identity: str
    run: str
    study: str
    label: str
    engine: str
    status: str
    reason: str
    values: dict[str, float]
    force_error: float | None
    trace_sha256: str
    work: int
    cost: dict[str, float | None]
    ended: float
    build: str = ""

    @property
    def done(self) -> bool:
        """True if the run succeeded."""
        return self.status == "done"


class Store:
    """All rows of a runs folder; each file is read once.

    Attributes:
        runs: the runs folder.
        folder: folder of the store.
        rows: rows by identity; finished rows take precedence over failed ones, later rows over earlier ones.
        labels: study, engine and label of all rows.
        damaged: files that are damaged or of another version; their rows do not count.
    """

    def __init__(self, runs: Path) -> None:
        self.runs = runs
        self.folder = runs / "batch"
        self.rows: dict[str, StudyRow] = {}
        self.damaged: set[str] = set()
        self._read: set[str] = set()
        self.labels: set[tuple[str, str, str]] = set()

    def refresh(self) -> list[StudyRow]:
        """Read new files and return their rows."""
        names = {file.name for file in self.folder.glob(f"*{ENDING}")}
        fresh: list[StudyRow] = []
        for name in sorted(names - self._read):
            self._read.add(name)
            try:
                file = self.folder / name
                content = file.read_bytes() if file.is_file() else b""
                if _name_of(content) != name:
                    raise ValueError("damaged")
                fresh += [_row(line) for line in content.splitlines()]
            except (OSError, ValueError, TypeError, RecursionError):  # damaged, no file, or rows of another version
                self.damaged.add(name)
        for row in fresh:
            known = self.rows.get(row.identity)
            if known is None or (row.done, row.ended) > (known.done, known.ended):
                self.rows[row.identity] = row
            self.labels.add((row.study, row.engine, row.label))
        return fresh


def _row(line: bytes) -> StudyRow:
    row = StudyRow(**json.loads(line))
    parts = ((row.values, dict), (row.cost, dict), (row.ended, float), (row.work, int), (row.build, str))
    if not all(isinstance(part, kind) for part, kind in parts):
        raise ValueError("a row of another version")
    return row


def _name_of(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()[:24] + ENDING


class Outbox:
    """Collector of rows, which commits them to the store every second, and at the end of its ``with`` block."""

    def __init__(self, store: Path, place: Path) -> None:
        self._store = store
        self._place = place
        self._rows: list[StudyRow] = []
        self._lock = threading.Lock()
        self._error: OSError | None = None
        self._through = threading.Event()
        self._thread = threading.Thread(target=self._keep_flushing, daemon=True)

    def __enter__(self) -> "Outbox":
        """Start the thread that commits."""
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        """Commit the remaining rows, also after an error."""
        self._through.set()
        self._thread.join()
        self.flush()

    def add(self, row: StudyRow) -> None:
        """Add a row; OSError if earlier rows could not be committed."""
        with self._lock:
            if self._error is not None:
                raise self._error
            self._rows.append(row)

    def flush(self) -> None:
        """Commit all rows in one file, atomically and synced to the disk.

        Raises:
            OSError: the disk is full or the runs folder cannot be written to.
        """
        with self._lock:
            content = "".join(f"{json.dumps(vars(row))}\n" for row in self._rows).encode()
            if not content:
                return
            draft = self._place / "draft"
            with open(draft, "wb") as file:
                file.write(content)
                file.flush()
                os.fsync(file.fileno())
            draft.replace(self._store / _name_of(content))
            handle = os.open(self._store, os.O_RDONLY)
            try:
                os.fsync(handle)
            finally:
                os.close(handle)
            self._rows = []

    def _keep_flushing(self) -> None:
        while not self._through.wait(COMMIT_INTERVAL_S):
            try:
                show_alive(self._place)
                self.flush()
            except OSError as error:
                self._error = error
                return
