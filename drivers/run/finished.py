"""Finished runs, read back from their folders."""

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np

from drivers.base import paths
from drivers.base.errors import InputError
from drivers.chain.layout import Layout, read_layout
from drivers.chain.trace import FORCES, Trace, read_forces
from drivers.run.record import FILE, RunRecord, read_record


@dataclass(frozen=True)
class FinishedRun:
    """A run that is done, with its numbers."""

    folder: Path
    record: RunRecord
    layout: Layout

    @cached_property
    def trace(self) -> Trace:
        """The force trace; the state is not in it.

        Raises:
            InputError: the file is missing or damaged.
        """
        path = self.folder / FORCES
        try:
            trace = read_forces(path)
            if trace.time_s[0] != 0 or not (np.diff(trace.time_s) > 0).all() or not trace.force_N.size:
                raise ValueError("sample times that do not rise from 0")
            return trace
        except Exception as error:  # a damaged file can make pyarrow raise almost anything
            found = "no such file" if isinstance(error, FileNotFoundError) else "a damaged file"
            raise InputError(paths.shown(path), "", found, "the forces of a run (run it again with --rerun)") from error


def open_run(folder: Path) -> FinishedRun:
    """The run in a folder.

    Raises:
        InputError: there is none, or it is not done.
    """
    record = read_record(folder)
    allowed = "a run folder, as python -m drivers run prints it"
    if record is None:
        unread = "a record that is damaged or of another version"
        found = unread if (folder / FILE).exists() else "no record of a run"
        raise InputError(str(folder), FILE, found, allowed)
    if record.status != "done":
        raise InputError(str(folder), FILE, f"a run that {record.status}: {record.reason}", "a run that is done")
    try:
        layout = read_layout(record.layout)
    except (TypeError, KeyError) as error:
        raise InputError(str(folder), FILE, "a damaged record", allowed) from error
    return FinishedRun(folder, record, layout)
