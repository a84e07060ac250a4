"""Runs that ended, with their records in ``run.json``: written, found, or read back from their folders."""

import json
import platform
from dataclasses import asdict, dataclass, field
from functools import cache, cached_property
from pathlib import Path
from typing import Any

import numpy as np

from drivers.base import paths
from drivers.base.errors import InputError
from drivers.base.files import sha256_of, whole_file
from drivers.base.processes import git
from drivers.chain.case import Layout, read_layout
from drivers.chain.trace import FORCES, Trace, read_forces

FILE = "run.json"
UNASSESSED: dict[str, Any] = dict.fromkeys(
    ("error_budget", "error_note", "exact_to", "exact_until_s", "warnings", "step_limit_s", "accuracy")
)
BUILD_NOT_KNOWN = {"executable": "", "build_sha256": ""}  # in records that are older than these keys


@dataclass(frozen=True)
class RunRecord:
    """The record of one run; times in seconds.

    What ``validation.accuracy.assess`` adds is None until a run that is done has been assessed: ``error_budget``,
    ``error_note``, ``exact_to``, ``exact_until_s``, ``warnings``, ``step_limit_s``, ``accuracy``.

    Attributes:
        engine_version: line with which its build introduces itself.
        executable: command that started it, with the paths of its programs.
        build_sha256: digest of its programs and libraries (``drivers.run.build``); empty of this repository's engines.
        status: ``done``, ``failed`` or ``timeout``; ``reason`` says why in the latter cases.
        scene: resolved, in SI units.
        layout: what post-processing needs to know of the chain (``drivers.chain.case.Layout``).
        elements: modelling elements, each in or out with its reason.
        wall_s, cpu_s: of the whole process; of a case in a process that serves many, of the case alone.
        loop_s: of the engine's own time loop.
        error_budget: parts of the error of the force and of what gauges show (``validation.accuracy.budget``).
        error_note: what of it could not be measured, and why.
        exact_to: measured error of the exact motion itself until ``exact_until_s``, of the largest change; None too of
            three-dimensional chains.
        warnings: of a run that is done and of little use.
        step_limit_s: the predicted stability limit of the time step; None too where no contact closes.
        accuracy: by quantity what was ``asked``, ``predicted`` and ``measured``; None too where none is asked for.
        forces_sha256: of ``forces.parquet``, so that a damaged one is not taken for done; empty where there is none.
    """

    engine: str
    engine_version: str
    executable: str
    build_sha256: str
    scene_name: str
    status: str
    reason: str
    scene: dict[str, Any]
    layout: dict[str, Any]
    elements: list[dict[str, Any]]
    deck_sha256: str
    command: str
    time_step_s: float
    steps: int
    bodies: int
    wall_s: float
    cpu_s: float
    loop_s: float | None
    memory_bytes: int
    forces_sha256: str
    error_budget: list[dict[str, Any]] | None
    error_note: str | None
    exact_to: float | None
    exact_until_s: float | None
    warnings: list[str] | None
    step_limit_s: float | None
    accuracy: dict[str, dict[str, float]] | None
    host: str
    commit: str
    dirty: bool
    lock_sha256: str

    def write(self, folder: Path) -> None:
        """Writes ``run.json`` into the run folder."""
        with whole_file(folder / FILE) as draft:
            draft.write_text(json.dumps(asdict(self), indent=2) + "\n")


def read_record(folder: Path) -> RunRecord | None:
    """The record of a run folder; None where there is none that can be read."""
    try:
        record = RunRecord(**BUILD_NOT_KNOWN | json.loads((folder / FILE).read_text()))
        for part in record.error_budget or ():
            shares = [share for key, share in part.items() if key not in ("quantity", "where")]
            if not (isinstance(part["quantity"], str) and all(isinstance(share, float | int) for share in shares)):
                raise ValueError("an error budget of something else")
    except (OSError, ValueError, LookupError, TypeError, AttributeError, RecursionError):
        return None
    return record


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
    allowed = "a run folder, or its name, as python -m drivers runs prints it"
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


def find_run(home: Path, identity: str, layout: dict[str, Any]) -> EndedRun | None:
    """A run that ended, looked up by its hash, whatever its name: done before failed, of this layout before others."""
    found = [EndedRun(folder, record) for folder in home.glob(f"[!.]*-{identity}") if (record := read_record(folder))]
    return max(found, key=lambda run: (run.done, run.record.layout == layout), default=None)


@cache
def provenance() -> dict[str, Any]:
    """Host, commit, whether the work tree differs from it, and the lock file's digest."""
    commit = git("rev-parse", "HEAD")
    return {
        "host": f"{platform.node()}, {platform.system()} {platform.machine()}, Python {platform.python_version()}",
        "commit": commit or "unknown",
        "dirty": bool(git("status", "--porcelain")),
        "lock_sha256": sha256_of(paths.LOCK) if paths.LOCK.exists() else "",
    }
