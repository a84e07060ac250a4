"""Run folders: the record, the forces, the positions and the gauges of a run, written, found and read back.

No other module knows the names and formats of these files. The record ``run.json`` holds its own digest and those of
the other files, so each file that is read back is as it was written, or is refused by name.
"""

import hashlib
import os
import re
import shutil
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from drivers.base import paths
from drivers.base.errors import InputError
from drivers.base.files import arrow_in, read_checked, read_sealed, sha256_of, whole_file, write_sealed
from drivers.base.progress import say
from drivers.chain.case import Layout, read_layout
from drivers.chain.trace import FORCE_COLUMNS, STATE_COLUMNS, Trace, fields_in, table_of_trace
from drivers.scene.model import Scene
from drivers.scene.read_scene import stored_scene

RECORD, FORCES, STATE, SENSORS = "run.json", "forces.parquet", "state.parquet", "sensors.csv"
ORIGIN = "of a run (run it again with --rerun)"
CONTENTS = {FORCES: f"the forces {ORIGIN}", STATE: f"the positions {ORIGIN}", SENSORS: f"the gauge signals {ORIGIN}"}
FOLDER_NAME = re.compile(r"(.+?)(-[0-9a-f]{6})?-([0-9a-f]{12})(-failed)?")  # scene, layout, identity of the run
# options for values that rarely repeat: 30 % smaller and faster than the defaults
COMPRESSED: dict[str, Any] = {"compression": "zstd", "use_dictionary": False, "use_byte_stream_split": True}
TIME_TOLERANCE = 1e-12  # of a sample time
DAMAGED = "damaged"  # status of a run whose record cannot be read
ALLOWED_FOLDER = "a run folder, or its name, as beads runs prints it"
NOT_ASSESSED: dict[str, Any] = dict.fromkeys(
    ("error_budget", "error_note", "exact_to", "exact_until_s", "warnings", "accuracy")
)


@dataclass(frozen=True)
class RunRecord:
    """Record of a run, the content of ``run.json`` besides its digest; times in seconds.

    ``error_budget``, ``error_note``, ``exact_to``, ``exact_until_s``, ``warnings`` and ``accuracy``
    are None until ``validation.accuracy.budget`` has assessed the run.

    Attributes:
        identity: digest of engine, build and deck, with which the name of the folder ends.
        engine: name of the engine.
        engine_version: version line of the build.
        executable: command of the build, with the paths of its programs.
        build_sha256: digest of programs and libraries (``drivers.run.build``); empty for in-repo engines.
        scene_name: name of the scene.
        status: ``done``, ``failed`` or ``timeout``; ``damaged`` if it cannot be read.
        reason: reason of a failure; else empty.
        scene: complete scene in SI units.
        layout: properties of the chain for post-processing (``drivers.chain.case.Layout``).
        elements: modelling elements, each in or out with its reason.
        deck_sha256: digest of the deck.
        command: command of the deck.
        time_step_s, steps, bodies: time step, number of time steps and of bodies.
        wall_s, cpu_s: wall and CPU time of the process; for a process that runs many decks, of this deck alone.
        loop_s: time in the code's time loop.
        memory_bytes: peak memory; unknown, as the times, for an imported run.
        files: digests of the files that are read back, by name.
        error_budget: parts of the errors of the force and of observables (``validation.accuracy.budget``).
        error_note: parts that could not be measured, with the reason.
        exact_to: error of the exact motion until ``exact_until_s``, divided by the largest change of force; None for
            three-dimensional chains.
        warnings: reasons why a finished run is of little use.
        accuracy: ``asked``, ``predicted`` and ``measured`` error by quantity, measured None if the exact motion is not
            known; None without an accuracy.
        edits: differences of an imported run's deck from the scene's; None for a run of this project.
        host, commit, dirty, lock_sha256: machine, commit of the checkout, True if it had local changes (new files
            outside the packages do not count), digest of the lock file.
    """

    identity: str
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
    wall_s: float | None
    cpu_s: float | None
    loop_s: float | None
    memory_bytes: int | None
    files: dict[str, str]
    error_budget: list[dict[str, Any]] | None
    error_note: str | None
    exact_to: float | None
    exact_until_s: float | None
    warnings: list[str] | None
    accuracy: dict[str, dict[str, float | None]] | None
    host: str
    commit: str
    dirty: bool
    lock_sha256: str
    edits: list[str] | None = None

    def described(self, described: dict[str, Any]) -> "RunRecord":
        """Record of the same run for another scene, not yet assessed."""
        files = {name: digest for name, digest in self.files.items() if name != SENSORS}
        return replace(self, **described, **NOT_ASSESSED, files=files)

    def write(self, folder: Path) -> None:
        """Write the record into the run folder."""
        write_sealed(folder / RECORD, asdict(self), indent=2)


def record_of(folder: Path) -> RunRecord:
    """Record of a run folder.

    Raises:
        InputError: there is none, it is damaged, or it belongs to another run.
    """
    path = folder / RECORD
    try:
        record = RunRecord(**read_sealed(path, "the record of a run"))
        read_layout(record.layout)
    except (FileNotFoundError, NotADirectoryError):
        raise InputError(paths.shown(folder), RECORD, "no record of a run", ALLOWED_FOLDER) from None
    except (TypeError, LookupError) as error:
        allowed = "the record of a run of this version"
        raise InputError(paths.shown(path), "", "a record of another version", allowed) from error
    named = FOLDER_NAME.fullmatch(folder.name)
    if named and named[3] != record.identity:
        found = f"the record of the run {record.identity}"
        raise InputError(paths.shown(path), "", found, f"the record of {named[3]}, as the folder is named")
    return record


def read_record(folder: Path) -> RunRecord | None:
    """Record of a run folder; None if it cannot be read."""
    try:
        return record_of(folder)
    except InputError:
        return None


def in_si(scene: Scene) -> dict[str, Any]:
    """Scene in SI units, as JSON values, without keys that are not given."""
    return scene.model_dump(mode="json", exclude_none=True, warnings=False)


@dataclass(frozen=True)
class EndedRun:
    """Finished, failed or damaged run with its folder."""

    folder: Path
    record: RunRecord

    @property
    def name(self) -> str:
        """``ENGINE:SCENE``, which several runs may have."""
        return f"{self.record.engine}:{self.record.scene_name}"

    @property
    def done(self) -> bool:
        """True if the run succeeded."""
        return self.record.status == "done"

    @property
    def trouble(self) -> str:
        """Reason why the run has no numbers, from its record and its list of files; empty if it has numbers."""
        record = self.record
        if not self.done:
            return record.reason if record.status == DAMAGED else f"{record.status}: {record.reason}"
        lost = [name for name in record.files if name not in self.stats and name != SENSORS]
        return f"{lost[0]}: found no such file" if lost else ""

    @property
    def missed(self) -> str | None:
        """Message on quantities that miss the scene's accuracy; None if there are none, or before the assessment."""
        beyond = [
            f"{name} has an error of {errors['measured']:.3g}, at most {errors['asked']:g} is allowed"
            for name, errors in (self.record.accuracy or {}).items()
            if (errors["measured"] or 0.0) > (errors["asked"] or 0.0)
        ]
        return "; ".join(beyond) or None

    @cached_property
    def resolved(self) -> dict[str, Any]:
        """Complete scene in SI units, as this version has it; empty if the scene of the record is not complete."""
        try:
            return in_si(stored_scene(self.record.scene))
        except (TypeError, ValueError, LookupError, AttributeError):
            return {}

    @cached_property
    def stats(self) -> dict[str, os.stat_result]:
        """Size and dates of the files, by name; empty if the folder has been removed meanwhile."""
        with suppress(OSError), os.scandir(self.folder) as entries:
            return {entry.name: entry.stat() for entry in entries}
        return {}

    @property
    def size(self) -> int:
        """Total size of the files in bytes."""
        return sum(stat.st_size for stat in self.stats.values())

    @property
    def ended(self) -> float:
        """Date of the record, else of the newest file, in seconds of Unix time; 0 without files."""
        dates = {name: stat.st_mtime for name, stat in self.stats.items()}
        return dates.get(RECORD, max(dates.values(), default=0.0))

    @cached_property
    def layout(self) -> Layout:
        """Layout of the chain, for post-processing."""
        return read_layout(self.record.layout)

    @property
    def forces_sha256(self) -> str:
        """Digest of the forces of a finished run."""
        return self.record.files[FORCES]

    @property
    def has_forces(self) -> bool:
        """True if the run kept forces, as a failed run does if its output can be read."""
        return FORCES in self.record.files

    @property
    def has_state(self) -> bool:
        """True if the run kept positions and velocities."""
        return STATE in self.record.files

    @cached_property
    def trace(self) -> Trace:
        """Trace without positions and velocities; of a failed run the samples before its first fault in the output.

        Raises:
            InputError: the file is missing, damaged or of another scene.
        """
        scene, record = self.record.scene, self.record
        with self._refused(FORCES):
            trace = Trace(**fields_in(arrow_in(self._content(FORCES)), FORCE_COLUMNS, record.bodies))
            times = np.arange(scene["samples"], dtype=float) * (scene["steps_per_sample"] * record.time_step_s)
            times = times if self.done else times[: len(trace.time_s)]
        shape = (len(times), record.bodies)
        if trace.force_N.shape != shape or not np.allclose(trace.time_s, times, rtol=TIME_TOLERANCE, atol=0):
            last_s = trace.time_s.max(initial=0.0)
            found = "forces of {} samples and {} contacts until {:g} s".format(*trace.force_N.shape, last_s)
            allowed = f"forces of the record's scene, {shape[0]} samples and {shape[1]} contacts until {times[-1]:g} s"
            raise InputError(paths.shown(self.folder / FORCES), "", found, allowed)
        return trace

    @cached_property
    def state(self) -> Trace:
        """Trace with positions and velocities, bit for bit.

        Raises:
            InputError: the run kept none, they are damaged, or their times differ from those of the forces.
        """
        path, record = self.folder / STATE, self.record
        if not self.has_state:
            name = record.scene_name
            scene = name if (paths.SCENES / f"{name}.toml").is_file() else f"{name}.toml"
            again = f"""beads run {scene} --engine {record.engine} --set run.record='["forces", "state"]'"""
            found = f"file not found: the run kept no positions; this command makes a run with positions: {again}"
            raise InputError(paths.shown(path), "", found)
        with self._refused(STATE):
            state = fields_in(arrow_in(self._content(STATE)), STATE_COLUMNS, record.bodies)
        if not np.array_equal(state["time_s"], self.trace.time_s):
            raise InputError(paths.shown(path), "time_s", "other times", f"the times of {FORCES}")
        return replace(self.trace, **state)

    @contextmanager
    def _refused(self, name: str) -> Iterator[None]:
        """Turn errors of reading a file that another version wrote into a message of one line."""
        try:
            yield
        except InputError:
            raise
        except Exception as error:  # pyarrow raises many kinds
            found = f"a damaged file ({type(error).__name__}: {error})"
            raise InputError(paths.shown(self.folder / name), "", found, CONTENTS[name]) from error

    def _content(self, name: str) -> bytes:
        """Content of a file as it was written."""
        path = self.folder / name
        try:
            return read_checked(path, self.record.files.get(name, ""), CONTENTS[name])
        except (FileNotFoundError, NotADirectoryError):
            raise InputError(paths.shown(path), "", "no such file", CONTENTS[name]) from None

    def damage(self, *names: str) -> Iterator[str]:
        """Messages on the files, of those named or else of all, that are not as they were written."""
        for name in names or self.record.files:
            try:
                self._content(name)
            except InputError as error:
                yield str(error)

    def is_complete(self, *, state: bool) -> bool:
        """True if the run is done and its forces, and with ``state`` its positions, are as they were written."""
        wanted = (FORCES, STATE) if state else (FORCES,)
        return self.done and not any(self.damage(*wanted))

    @property
    def has_sensors(self) -> bool:
        """True if the gauge signals are there as they were written."""
        return not any(self.damage(SENSORS))

    def with_sensors(self, signals: bytes, **changes: Any) -> "EndedRun":
        """The run with its gauge signals and changes of its record, both written to the folder."""
        path = self.folder / SENSORS
        for line in self.damage(SENSORS) if SENSORS in self.record.files else ():
            say(f"{line}: written again")
        with whole_file(path) as draft:
            draft.write_bytes(signals)
            digest = sha256_of(draft)
        record = replace(self.record, **changes, files=self.record.files | {SENSORS: digest})
        record.write(self.folder)
        return replace(self, record=record)

    def copy_to(self, folder: Path, record: RunRecord) -> None:
        """Copy a run with another record, without its gauge signals."""
        shutil.copytree(self.folder, folder, ignore=shutil.ignore_patterns(SENSORS))
        record.write(folder)


def folder_name(scene: str, layout: dict[str, Any], identity: str) -> str:
    """Name of a run folder, as ``FOLDER_NAME`` matches it."""
    return f"{scene}-{hashlib.sha256(repr(layout).encode()).hexdigest()[:6]}-{identity}"


def write_run(folder: Path, record: RunRecord, trace: Trace | None, *, state: bool) -> RunRecord:
    """Write trace and record of a run into its folder, with ``state`` also positions; returns the record."""
    from pyarrow.parquet import write_table

    kept = {FORCES: FORCE_COLUMNS} | ({STATE: STATE_COLUMNS} if state else {})
    tables = {} if trace is None else {name: table_of_trace(trace, columns) for name, columns in kept.items()}
    for name, table in tables.items():
        write_table(table, folder / name, **COMPRESSED)
    record = replace(record, files={name: sha256_of(folder / name) for name in tables})
    record.write(folder)
    return record


def is_run(folder: Path) -> bool:
    """True if a folder has the record of a run, readable or not."""
    return (folder / RECORD).exists()


def open_run(folder: Path, *, failed: bool = False) -> EndedRun:
    """Open a finished run by its folder; with ``failed`` also a failed run that kept its forces.

    Raises:
        InputError: no run in the folder, one that is damaged, or one that failed.
    """
    run = EndedRun(folder, record_of(folder))
    if not run.done and not (failed and run.has_forces):
        allowed = "a run that is done, or one that kept its forces" if failed else "a run that is done"
        raise InputError(str(folder), RECORD, run.trouble, allowed)
    return run


def find_run(home: Path, identity: str, layout: dict[str, Any]) -> EndedRun | None:
    """Find a run by its hash; finished runs before failed ones, runs with this layout before others."""
    runs = [EndedRun(folder, record) for folder in _folders(home, identity) if (record := read_record(folder))]
    return max(runs, key=lambda run: (run.done, run.record.layout == layout), default=None)


def damage_of(home: Path, identity: str) -> Iterator[str]:
    """Messages on damaged files of the runs of a hash."""
    for folder in _folders(home, identity):
        try:
            yield from EndedRun(folder, record_of(folder)).damage()
        except InputError as error:
            yield str(error)


def _folders(home: Path, identity: str) -> Iterator[Path]:
    return home.glob(f"[!.]*-{identity}")
