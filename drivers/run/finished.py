"""Finished runs and their records in ``run.json``: writing, finding, reading."""

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
from drivers.base.processes import git, local_changes
from drivers.chain.case import Layout, read_layout
from drivers.chain.trace import FORCES, Trace, read_forces

FILE = "run.json"
NOT_ASSESSED: dict[str, Any] = dict.fromkeys(
    ("error_budget", "error_note", "exact_to", "exact_until_s", "warnings", "step_limit_s", "accuracy")
)
BUILD_NOT_KNOWN = {"executable": "", "build_sha256": ""}  # records older than these keys


@dataclass(frozen=True)
class RunRecord:
    """Record of a run, the content of ``run.json``; times in seconds.

    ``error_budget``, ``error_note``, ``exact_to``, ``exact_until_s``, ``warnings``, ``step_limit_s`` and ``accuracy``
    are None until ``validation.accuracy.assess`` has assessed the run.

    Attributes:
        engine: name of the engine.
        engine_version: version line of the build.
        executable: command of the build, with the paths of its programs.
        build_sha256: digest of programs and libraries (``drivers.run.build``); empty for in-repo engines.
        scene_name: name of the scene.
        status: ``done``, ``failed`` or ``timeout``.
        reason: reason of a failure; else empty.
        scene: complete scene in SI units.
        layout: properties of the chain for post-processing (``drivers.chain.case.Layout``).
        elements: modelling elements, each in or out with its reason.
        deck_sha256: digest of the deck.
        command: command of the deck.
        time_step_s, steps, bodies: time step, number of time steps and of bodies.
        wall_s, cpu_s: wall and CPU time of the process; for a process that runs many decks, of this deck alone.
        loop_s: time in the code's time loop.
        memory_bytes: peak memory.
        forces_sha256: digest of ``forces.parquet``, to detect damage; empty for a failed run.
        error_budget: parts of the errors of the force and of observables (``validation.accuracy.budget``).
        error_note: parts that could not be measured, with the reason.
        exact_to: error of the exact motion until ``exact_until_s``, over the largest change of force; None for
            three-dimensional chains.
        warnings: reasons why a finished run is of little use.
        step_limit_s: predicted stability limit of the time step; None if no contact closes.
        accuracy: ``asked``, ``predicted`` and ``measured`` error by quantity; None without an accuracy.
        host, commit, dirty, lock_sha256: machine, commit of the checkout, True if it had local changes (new files
            outside the packages do not count), digest of the lock file.
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
        """Write ``run.json`` into the run folder."""
        with whole_file(folder / FILE) as draft:
            draft.write_text(json.dumps(asdict(self), indent=2) + "\n")


def read_record(folder: Path) -> RunRecord | None:
    """Record of a run folder; None if missing or damaged."""
    try:
        record = RunRecord(**BUILD_NOT_KNOWN | json.loads((folder / FILE).read_text()))
        for part in record.error_budget or ():
            shares = [share for key, share in part.items() if key not in ("quantity", "where")]
            if not (isinstance(part["quantity"], str) and all(isinstance(share, float | int) for share in shares)):
                raise ValueError("not an error budget")
    except (OSError, ValueError, LookupError, TypeError, AttributeError, RecursionError):
        return None
    return record


@dataclass(frozen=True)
class EndedRun:
    """Finished or failed run with its folder.

    Attributes:
        partial_trace: samples of a run that just failed; they are not stored in the folder.
    """

    folder: Path
    record: RunRecord
    partial_trace: Trace | None = field(default=None, compare=False, repr=False)

    @property
    def done(self) -> bool:
        """True if the run succeeded."""
        return self.record.status == "done"

    @property
    def missed(self) -> str | None:
        """Message on quantities that miss the scene's accuracy; None if there are none, or before the assessment."""
        beyond = [
            f"{name} has an error of {each['measured']:.3g}, allowed are {each['asked']:g}"
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
        """Trace of a finished run, without positions and velocities.

        Raises:
            InputError: the file is missing or damaged.
        """
        path = self.folder / FORCES
        try:
            trace = read_forces(path)
            if trace.time_s[0] != 0 or not (np.diff(trace.time_s) > 0).all() or not trace.force_N.size:
                raise ValueError("sample times that do not increase from 0")
            return trace
        except Exception as error:  # pyarrow raises many kinds of errors for damaged files
            found = "no such file" if isinstance(error, FileNotFoundError) else "a damaged file"
            raise InputError(paths.shown(path), "", found, "the forces of a run (run it again with --rerun)") from error


def open_run(folder: Path) -> EndedRun:
    """Open a finished run by its folder.

    Raises:
        InputError: no run in the folder, or one that failed.
    """
    record = read_record(folder)
    allowed = "a run folder, or its name, as beads runs prints it"
    if record is None:
        unread = "a record that is damaged or of another version"
        found = unread if (folder / FILE).exists() else "no record of a run"
        raise InputError(str(folder), FILE, found, allowed)
    if record.status != "done":
        raise InputError(str(folder), FILE, f"a run that {record.status}: {record.reason}", "a run that is done")
    run = EndedRun(folder, record)
    try:
        run.layout  # noqa: B018 - detects a damaged layout here
    except (TypeError, KeyError) as error:
        raise InputError(str(folder), FILE, "a damaged record", allowed) from error
    return run


def find_run(home: Path, identity: str, layout: dict[str, Any]) -> EndedRun | None:
    """Find a run by its hash; finished runs before failed ones, runs with this layout before others."""
    found = [EndedRun(folder, record) for folder in home.glob(f"[!.]*-{identity}") if (record := read_record(folder))]
    return max(found, key=lambda run: (run.done, run.record.layout == layout), default=None)


@cache
def provenance() -> dict[str, Any]:
    """Machine, commit, changes of the work tree, and digest of the lock file."""
    commit = git("rev-parse", "HEAD")
    return {
        "host": f"{platform.node()}, {platform.system()} {platform.machine()}, Python {platform.python_version()}",
        "commit": commit or "unknown",
        "dirty": local_changes(),
        "lock_sha256": sha256_of(paths.LOCK) if paths.LOCK.exists() else "",
    }
