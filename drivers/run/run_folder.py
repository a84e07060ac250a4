"""Run folders: the record, the forces, the positions and the gauges of a run, written, found and read back.

No other module knows the names and formats of these files. The record ``run.json`` holds its own digest and those of
the other files, so each file that is read back is as it was written, or is refused by name.
"""

import json
import os
import re
import shutil
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import asdict, dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

from drivers.base import paths
from drivers.base.errors import InputError
from drivers.base.files import ALTERED, arrow_in, read_file, read_sealed, sha256_in, sha256_of, whole_file, write_sealed
from drivers.base.processes import workplace
from drivers.base.terminal import say
from drivers.chain.case import ALL_DIGITS, Layout, read_layout
from drivers.chain.trace import FORCE_COLUMNS, STATE_COLUMNS, Trace, fields_in, table_of_trace
from drivers.scene.model import Scene
from drivers.scene.read_scene import changed_scene, stored_scene

RECORD, FORCES, STATE, SENSORS = "run.json", "forces.parquet", "state.parquet", "sensors.csv"
SCENE = "scene.json"  # next to a deck
ORIGIN = "of a run (run it again with --rerun)"
CONTENTS = {FORCES: f"the forces {ORIGIN}", STATE: f"the positions {ORIGIN}", SENSORS: f"the gauge signals {ORIGIN}"}
FOLDER_NAME = re.compile(r"(.+?)(-[0-9a-f]{6})?-([0-9a-f]{12})(-failed)?")  # scene, layout, identity of the run
# options for values that rarely repeat: 30 % smaller and faster than the defaults
COMPRESSED: dict[str, Any] = {"compression": "zstd", "use_dictionary": False, "use_byte_stream_split": True}
DAMAGED = "damaged"  # status of a run whose record cannot be read
ALLOWED_FOLDER = "a run folder, or its name, as beads runs prints it"
NOT_ASSESSED: dict[str, Any] = dict.fromkeys(
    ("error_budget", "error_note", "exact_to", "exact_until_s", "warnings", "accuracy")
)


@dataclass(frozen=True, kw_only=True)
class RunRecord:
    """Record of a run, the content of ``run.json`` besides its digest.

    ``error_budget``, ``error_note``, ``exact_to``, ``exact_until_s``, ``warnings`` and ``accuracy``
    are None until ``validation.accuracy.budget`` has assessed the run. ``beads keys run`` prints the attributes.

    Attributes:
        identity: digest of engine, build and deck, with which the name of the folder ends.
        engine: name of the engine.
        engine_version: version line of the build.
        executable: command of the build, with the paths of its programs.
        build_sha256: digest of programs and libraries; empty for in-repo engines.
        scene_name: name of the scene.
        status: done, failed or timeout; damaged if it cannot be read.
        reason: reason of a failure; else empty.
        scene: complete scene in SI units.
        layout: properties of the chain for post-processing.
        elements: modelling elements, each in or out with its reason.
        deck_sha256: digest of the deck.
        command: command of the deck.
        time_step_s: time step in s.
        steps: number of time steps.
        bodies: number of bodies.
        wall_s: wall time of the process in s; on a server that of this deck alone; unknown for an imported run.
        cpu_s: CPU time of the process in s; unknown on a server and for an imported run.
        loop_s: time in the code's time loop in s.
        memory_bytes: peak memory in bytes; unknown on a server and for an imported run.
        files: digests of the files that are read back, by name.
        error_budget: parts of the errors of the force and of observables.
        error_note: parts that could not be measured, with the reason.
        exact_to: error until exact_until_s against the exact motion, divided by the largest change of force; none for
            three-dimensional chains.
        exact_until_s: end of that comparison in s.
        warnings: reasons why a finished run is of little use.
        accuracy: asked, predicted and measured error by quantity; measured is none if the exact motion is not known.
        host: name of the machine.
        commit: commit of the checkout.
        dirty: true if the checkout had local changes; new files outside the packages do not count.
        lock_sha256: digest of the lock file.
        edits: differences of an imported run's deck from the scene's; none for a run of this project.
        digits: significant digits of its output.
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
    error_budget: list[dict[str, Any]] | None = None
    error_note: str | None = None
    exact_to: float | None = None
    exact_until_s: float | None = None
    warnings: list[str] | None = None
    accuracy: dict[str, dict[str, float | None]] | None = None
    host: str
    commit: str
    dirty: bool
    lock_sha256: str
    edits: list[str] | None = None
    digits: int = ALL_DIGITS

    @property
    def about(self) -> dict[str, str]:
        """Metadata of the tables of the run, with the complete scene as JSON; pandas shows the others as ``attrs``."""
        named = {"scene": self.scene_name, "title": self.scene.get("title", ""), "engine": self.engine}
        return named | {"scene_si": json.dumps(self.scene), "PANDAS_ATTRS": json.dumps(named)}

    @property
    def folder_name(self) -> str:
        """Name of the run folder, as ``FOLDER_NAME`` matches it."""
        return f"{self.scene_name}-{sha256_in(repr(self.layout))[:6]}-{self.identity}"

    def write(self, folder: Path) -> None:
        """Write the record into the run folder."""
        write_sealed(folder / RECORD, asdict(self), indent=2)


def record_of(folder: Path) -> RunRecord:
    """Record of a run folder.

    Raises:
        InputError: there is none, or it is damaged.
    """
    path = folder / RECORD
    try:
        record = RunRecord(**read_sealed(path, "the record of a run"))
        read_layout(record.layout)
        stored_scene(record.scene)
    except (FileNotFoundError, NotADirectoryError):
        raise InputError(paths.shown(folder), RECORD, "no record of a run", ALLOWED_FOLDER) from None
    except (TypeError, ValueError, LookupError, AttributeError) as error:
        allowed = "the record of a run of this version"
        raise InputError(paths.shown(path), "", "a record of another version", allowed) from error
    return record


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

    @cached_property
    def resolved(self) -> dict[str, Any]:
        """Complete scene in SI units, as this version has it; empty for a damaged record."""
        return in_si(stored_scene(self.record.scene)) if self.record.scene else {}

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
    def has_state(self) -> bool:
        """True if the run kept positions and velocities."""
        return STATE in self.record.files

    @cached_property
    def trace(self) -> Trace:
        """Trace without positions and velocities; of a failed run the samples before its first fault in the output.

        Raises:
            InputError: the file is missing, damaged or of another run.
        """
        return Trace(**fields_in(arrow_in(self._content(FORCES)), FORCE_COLUMNS, self.record.bodies))

    @cached_property
    def state(self) -> Trace:
        """Trace with positions and velocities, bit for bit.

        Raises:
            InputError: the run kept none, or they are damaged or of another run.
        """
        record = self.record
        if not self.has_state:
            name = record.scene_name
            scene = name if (paths.SCENES / f"{name}.toml").is_file() else f"{name}.toml"
            again = f"""beads run {scene} --engine {record.engine} --set run.record='["forces", "state"]'"""
            found = f"file not found: the run kept no positions; this command makes a run with positions: {again}"
            raise InputError(paths.shown(self.folder / STATE), "", found)
        return replace(self.trace, **fields_in(arrow_in(self._content(STATE)), STATE_COLUMNS, record.bodies))

    def _content(self, name: str) -> bytes:
        """Content of a file as it was written; read once, so that what was checked is what is parsed."""
        path = self.folder / name
        try:
            content = read_file(path, CONTENTS[name])
        except (FileNotFoundError, NotADirectoryError):
            raise InputError(paths.shown(path), "", "no such file", CONTENTS[name]) from None
        if sha256_in(content) != self.record.files.get(name):
            raise InputError(paths.shown(path), "", ALTERED, CONTENTS[name])
        return content

    def damage(self, *names: str) -> Iterator[str]:
        """Messages on a damaged record, and on the files, of those named or else of all, that were altered."""
        if self.record.status == DAMAGED:
            yield self.record.reason
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
        for line in self.damage(SENSORS) if SENSORS in self.record.files else ():
            say(f"{line}: written again")
        with whole_file(self.folder / SENSORS) as draft:
            draft.write_bytes(signals)
        files = self.record.files | {SENSORS: sha256_in(signals)}
        record = replace(self.record, **changes, files=files)
        record.write(self.folder)
        return replace(self, record=record)


def write_run(folder: Path, record: RunRecord, trace: Trace | None, *, state: bool) -> RunRecord:
    """Write trace and record of a run into its folder, with ``state`` also positions; returns the record."""
    from pyarrow.parquet import write_table

    kept = {FORCES: FORCE_COLUMNS} | ({STATE: STATE_COLUMNS} if state else {})
    tables = {name: table_of_trace(trace, columns, record.about) for name, columns in kept.items()} if trace else {}
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
    if not run.done and not (failed and FORCES in run.record.files):
        allowed = "a run that is done, or one that kept its forces" if failed else "a run that is done"
        raise InputError(str(folder), RECORD, run.trouble, allowed)
    return run


def any_run(folder: Path) -> EndedRun:
    """Run of a folder; one without a readable record is damaged, and known by the names of its folders."""
    try:
        return EndedRun(folder, record_of(folder))
    except InputError as error:
        named = FOLDER_NAME.fullmatch(folder.name)
        scene, identity = (named[1], named[3]) if named else (folder.name, "")
        known = {"engine": folder.parent.name, "scene_name": scene, "identity": identity, "reason": str(error)}
        unknown: dict[str, Any] = dict.fromkeys(RunRecord.__annotations__) | {"files": {}, "scene": {}}
        return EndedRun(folder, RunRecord(**unknown | known | {"status": DAMAGED}))


def find_run(home: Path, identity: str, layout: dict[str, Any]) -> EndedRun | None:
    """Find a run by its hash; finished runs before failed and damaged ones, runs with this layout before others."""
    found = map(any_run, home.glob(f"[!.]*-{identity}"))
    runs = [run for run in found if run.record.identity == identity]  # not that of another in a renamed folder
    return max(
        runs, key=lambda run: (run.done, run.record.status != DAMAGED, run.record.layout == layout), default=None
    )


def for_scene(run: EndedRun, description: dict[str, Any]) -> EndedRun:
    """Run of the same deck, perhaps made for another scene, with a record that describes this one, not yet assessed.

    If the gauges differ, the run is copied, since the stored gauge signals depend on them.
    """
    record = replace(run.record, **description)
    if record == run.record:
        return run
    files = {name: digest for name, digest in record.files.items() if name != SENSORS}
    record = replace(record, **NOT_ASSESSED, files=files)
    if run.record.layout == record.layout:
        record.write(run.folder)
        return EndedRun(run.folder, record)
    target = run.folder.with_name(record.folder_name)
    with workplace(target.parent) as place:
        shutil.copytree(run.folder, place / "run", ignore=shutil.ignore_patterns(SENSORS))
        record.write(place / "run")
        move_into_place(place / "run", target)
    return EndedRun(target, record)


def move_into_place(folder: Path, target: Path, former: EndedRun | None = None) -> None:
    """Move a complete folder to its name; an older run, perhaps of another name, stays until then."""
    for old in {former.folder if former else target, target}:
        with suppress(FileNotFoundError):
            old.rename(folder.with_name(f"former-{old.name}"))
    try:
        folder.rename(target)
    except OSError:  # another process was faster
        if not is_run(target):
            raise


def write_scene(folder: Path, scene: Scene) -> None:
    """Write the scene of a deck next to it, where ``scene_of`` reads it when the deck has been run by hand."""
    write_sealed(folder / SCENE, in_si(scene), indent=2)


def scene_of(folder: Path, settings: tuple[str, ...] = ()) -> Scene:
    """Scene of a run folder, or of a folder with a deck, with settings applied.

    Raises:
        InputError: there is none, it is damaged or of another version, or a setting is wrong.
    """
    path = folder / (RECORD if is_run(folder) else SCENE)
    try:
        stored = read_sealed(path, "the scene of a deck")
        stored = stored.get("scene", stored)
        scene = stored_scene(stored)
        return changed_scene(stored, settings, paths.shown(path)) if settings else scene
    except FileNotFoundError:
        raise InputError(paths.shown(path), "", "no such file; give the scene of the deck by --scene") from None
    except (TypeError, ValueError, AttributeError) as error:
        raise InputError(paths.shown(path), "", "a scene of another version", "one of this version") from error
