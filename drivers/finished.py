"""Finished runs, read back from their folders."""

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

from drivers.errors import InputError
from drivers.layout import Layout, read_layout
from drivers.record import FILE, RunRecord, read_record
from drivers.trace import Trace, read_forces


@dataclass(frozen=True)
class FinishedRun:
    """A run that is done, with its numbers."""

    folder: Path
    record: RunRecord
    layout: Layout

    @cached_property
    def trace(self) -> Trace:
        """The force trace; the state is not in it."""
        return read_forces(self.folder / "forces.parquet")


def open_run(folder: Path) -> FinishedRun:
    """The run in a folder.

    Raises:
        InputError: there is none, or it is not done.
    """
    record = read_record(folder)
    if record is None:
        raise InputError(str(folder), FILE, "no record of a run", "a run folder, as python -m drivers run prints it")
    if record.status != "done":
        raise InputError(str(folder), FILE, f"a run that {record.status}: {record.reason}", "a run that is done")
    return FinishedRun(folder, record, read_layout(record.layout))
