"""Runs that ended, found or read back from their folders."""

from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path

import numpy as np

from drivers.base import paths
from drivers.base.errors import InputError
from drivers.chain.layout import Layout, read_layout
from drivers.chain.trace import FORCES, Trace, read_forces
from drivers.run.record import FILE, RunRecord, read_record


@dataclass(frozen=True)
class EndedRun:
    """A run that ended, well or badly, and its folder.

    Attributes:
        partial_trace: what there is of the trace of a run that just failed, which no folder keeps.
    """

    folder: Path
    record: RunRecord
    partial_trace: Trace | None = field(default=None, compare=False, repr=False)

    @property
    def done(self) -> bool:
        """Whether its numbers count."""
        return self.record.status == "done"

    @property
    def missed(self) -> str | None:
        """Quantities that miss the accuracy its scene asks for, in words; None before it is assessed."""
        beyond = [
            f"{name} is off by {each['measured']:.3g}, asked were {each['asked']:g}"
            for name, each in (self.record.accuracy or {}).items()
            if not each["measured"] <= each["asked"]
        ]
        return "; ".join(beyond) or None

    @cached_property
    def layout(self) -> Layout:
        """Layout of the chain, for post-processing."""
        return read_layout(self.record.layout)

    @cached_property
    def trace(self) -> Trace:
        """The force trace of a run that is done; the state is not in it.

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


def open_run(folder: Path) -> EndedRun:
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
    run = EndedRun(folder, record)
    try:
        run.layout  # noqa: B018 - read once here, so that a damaged one is told at once
    except (TypeError, KeyError) as error:
        raise InputError(str(folder), FILE, "a damaged record", allowed) from error
    return run


def find_run(home: Path, identity: str) -> EndedRun | None:
    """A run that ended, looked up by its hash alone, under whatever name."""
    for folder in home.glob(f"[!.]*-{identity}"):
        record = read_record(folder)
        if record is not None:
            return EndedRun(folder, record)
    return None
