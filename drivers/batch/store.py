"""Finished rows, many to a file; a file is written whole, named by its digest, and never changed.

Rows on their way to the store wait a second at most, however long the next case takes.
"""

import hashlib
import json
import os
import threading
from dataclasses import dataclass
from pathlib import Path

from drivers.run.workplaces import show_alive

ENDING = ".jsonl"
COMMIT_S = 1.0
WORK = ".work"  # below its folder: where workplaces are


@dataclass(frozen=True)
class Row:
    """One case on one engine.

    Attributes:
        identity: of all that determines the row; ``run``: of the run, as run folders have it.
        study, label: for whom it was run, under which values: a row of the same label and another identity is stale.
        status: ``done``, ``failed`` or ``timeout``; ``reason`` says why in the latter cases.
        values: observables by name.
        force_error: largest force difference from the exact forces, over the largest change of force; None for these.
        trace_sha256: digest of the forces and energies.
        work: bodies times steps.
        cost: seconds by what they were spent on.
        ended: when it was run, in seconds of Unix time.
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

    @property
    def done(self) -> bool:
        """Whether its numbers count."""
        return self.status == "done"


class Store:
    """All rows of a runs folder; files are read once, so that looking again costs little.

    Attributes:
        rows: by identity; of several, one that is done, or else the last.
        labels: study, engine and label of each row there has been, whatever its identity.
        damaged: files that are not as this version writes them; their rows do not count.
    """

    def __init__(self, runs: Path) -> None:
        self.runs = runs
        self.folder = runs / "batch"
        self.rows: dict[str, Row] = {}
        self.damaged: set[str] = set()
        self._read: set[str] = set()
        self.labels: set[tuple[str, str, str]] = set()

    def refresh(self) -> list[Row]:
        """Reads what is new; the new rows."""
        names = {file.name for file in self.folder.glob(f"*{ENDING}")}
        fresh: list[Row] = []
        for name in sorted(names - self._read):
            self._read.add(name)
            content = (self.folder / name).read_bytes()
            try:
                if _name_of(content) != name:
                    raise ValueError("not as it was written")
                fresh += [Row(**json.loads(line)) for line in content.splitlines()]
            except (ValueError, TypeError):  # damaged, or rows of another version
                self.damaged.add(name)
        for row in fresh:
            known = self.rows.get(row.identity)
            if known is None or (row.done, row.ended) > (known.done, known.ended):
                self.rows[row.identity] = row
            self.labels.add((row.study, row.engine, row.label))
        return fresh


def _name_of(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()[:24] + ENDING


class Outbox:
    """Collects rows at a workplace and commits them every second, many to a file; empty after its block."""

    def __init__(self, store: Path, place: Path) -> None:
        self._store = store
        self._place = place
        self._rows: list[Row] = []
        self._lock = threading.Lock()
        self._error: OSError | None = None
        self._through = threading.Event()
        self._thread = threading.Thread(target=self._keep_flushing, daemon=True)

    def __enter__(self) -> "Outbox":
        """Begins to commit."""
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        """Commits what is left, whatever happened."""
        self._through.set()
        self._thread.join()
        self.flush()

    def add(self, row: Row) -> None:
        """Takes a row; an OSError where earlier ones could not be committed."""
        with self._lock:
            if self._error is not None:
                raise self._error
            self._rows.append(row)

    def flush(self) -> None:
        """Commits what there is in one file that is there whole or not at all, even after the power went.

        Raises:
            OSError: the disk is full, or something else is wrong with the runs folder.
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
        while not self._through.wait(COMMIT_S):
            try:
                show_alive(self._place)
                self.flush()
            except OSError as error:
                self._error = error
                return
