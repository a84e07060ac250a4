"""Runs a case on an engine into a run folder, once: what is done is found again by its hash."""

import hashlib
import json
import math
import os
import shutil
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

from drivers.base import paths
from drivers.base.decks import Deck
from drivers.base.errors import RunError
from drivers.base.files import sha256_of, whole_file
from drivers.base.processes import UNKNOWN_VERSION, Outcome, run_command
from drivers.chain.case import Case
from drivers.chain.trace import FORCES, STATE, Trace, read_forces, write_forces, write_state
from drivers.engines import Engine, load_engine
from drivers.limits.refusal import refuse
from drivers.run.guard import checked_trace
from drivers.run.record import RunRecord, provenance, read_record

LEAST_LIMIT_S = 60.0
LATER = "not measured yet"
_asking_version = threading.Lock()
SECONDS_PER_BODY_AND_STEP = 5e-6  # ten times what the slowest engine needs: beyond it, a run hangs


@dataclass(frozen=True)
class EndedRun:
    """A run that ended, well or badly, and its folder.

    Attributes:
        refused: what there is of the trace of a run that just failed, which no folder keeps.
    """

    folder: Path
    record: RunRecord
    refused: Trace | None = field(default=None, compare=False, repr=False)

    @property
    def missed(self) -> str | None:
        """What it missed of the accuracy its scene asks for."""
        beyond = [
            f"{name} is off by {each['measured']:.3g}, asked were {each['asked']:g}"
            for name, each in (self.record.accuracy or {}).items()
            if not each["measured"] <= each["asked"]
        ]
        return "; ".join(beyond) or None

    @property
    def done(self) -> bool:
        """Whether its numbers count."""
        return self.record.status == "done"


def default_limit_s(case: Case) -> float:
    """Time limit of a run."""
    return LEAST_LIMIT_S + SECONDS_PER_BODY_AND_STEP * case.chain.bodies * case.scene.steps


def run_case(
    case: Case,
    engine_name: str,
    runs: Path = paths.RUNS,
    *,
    rerun: bool = False,
    limit_s: float | None = None,
    unsafe: bool = False,
    measured: bool = True,
) -> EndedRun:
    """Runs a case, or finds it done; its errors are measured and recorded.

    A run that failed before is tried again; ``unsafe`` runs what guards refuse. The folder appears under its name only
    when it is complete. Without ``measured`` errors are left for whoever asks for the run next: of three-dimensional
    runs they cost more than the run.

    Raises:
        RunError: the engine is not installed.
        InputError: it cannot end well (``drivers.limits.refusal``).
    """
    if not unsafe:
        refuse(case, engine_name)
    engine = load_engine(engine_name)
    executable = engine.find()
    if executable is None:
        raise RunError(f"not installed; it comes with {engine.how_to_get}")
    deck = engine.render(case)
    home = runs / engine_name
    version = known_version(engine, executable, home)
    identity = run_identity(engine_name, version, deck)
    found = find_run(home, identity)
    if found and found.done and not rerun and _has_all(found, case):
        return _told_again(found, case, measured)
    with _workplace(home, identity) as folder:
        for name, text in deck.files.items():
            (folder / name).write_text(text)
        outcome = run_command(
            deck.command_with(executable), folder, limit_s or default_limit_s(case), **engine.variables
        )
        record = _record(case, engine_name, engine, version, deck, outcome, folder)
        trace = refused = None
        try:
            trace = checked_trace(case, engine, outcome, folder)
        except RunError as error:
            refused = error.trace
            record = replace(record, status=error.status, reason=str(error))
        for name in deck.raw:
            _remove(folder / name)
        if trace is not None:
            _write_products(case, trace, folder)
            errors = _errors(case, engine_name, trace) if measured else {"error_note": LATER}
            record = replace(record, forces_sha256=sha256_of(folder / FORCES), **errors)
        record.write(folder)
        faster = find_run(home, identity)  # another process may have been
        if faster and faster.done and not rerun and _has_all(faster, case):
            return _told_again(faster, case, measured)
        target = home / f"{case.scene.name}-{identity}"
        spared = faster and faster.done and record.status != "done"
        if spared:  # what is done stays
            target = target.with_name(f"{target.name}-failed")
        _move_into_place(folder, target, None if spared or not faster else faster.folder)
    return EndedRun(target, record, refused)


def run_identity(engine_name: str, version: str, deck: Deck) -> str:
    """Digest of all that determines the numbers of a run."""
    return hashlib.sha256(f"{engine_name}\0{version}\0{deck.sha256}".encode()).hexdigest()[:12]


def find_run(home: Path, identity: str) -> EndedRun | None:
    """A run that ended, looked up by its hash alone, under whatever name."""
    for folder in home.glob(f"[!.]*-{identity}"):
        record = read_record(folder)
        if record is not None:
            return EndedRun(folder, record)
    return None


def _told_again(found: EndedRun, case: Case, measured: bool) -> EndedRun:
    """A run found for a scene of the same physics: its record and its sensors become those of the scene asked for."""
    told = json.loads(json.dumps(_description(case)))
    asked = case.plan.asked if case.plan else None
    before = found.record.accuracy
    asked_before = {name: share["asked"] for name, share in before.items()} if before else None
    same = all(getattr(found.record, key) == value for key, value in told.items()) and asked == asked_before
    if same and not (measured and found.record.error_note == LATER):
        return found
    from postproc.read.sensors import write_sensors

    trace = read_forces(found.folder / FORCES)
    unmeasured: dict[str, Any] = {"error_budget": [], "error_note": LATER, "accuracy": None}
    errors = _errors(case, found.record.engine, trace) if measured else unmeasured
    record = replace(found.record, **told, **errors)
    with whole_file(found.folder / "sensors.csv") as draft:
        write_sensors(case.layout, trace, draft)
    record.write(found.folder)
    return EndedRun(found.folder, record)


def _description(case: Case) -> dict[str, Any]:
    """What a record says of the scene, none of which the numbers depend on beyond the deck."""
    return {
        "scene_name": case.scene.name,
        "scene": {"units": "SI"} | case.scene.model_dump(mode="json", exclude_none=True),
        "layout": asdict(case.layout),
        "elements": [asdict(element) for element in case.elements],
        "time_step_s": case.scene.time_step_s,
        "steps": case.scene.steps,
    }


def _errors(case: Case, engine: str, trace: Trace) -> dict[str, Any]:
    """The error budget, what was kept of the accuracy asked for, and what to be warned of."""
    from drivers.limits.stable_step import predicted_limit
    from validation.accuracy.budget import error_budget, measured_errors
    from validation.accuracy.run_warnings import warnings_of

    parts, note = error_budget(case, engine, trace)
    accuracy: dict[str, dict[str, float]] | None = None
    if case.plan:
        measured = measured_errors(case, trace, case.plan.asked)
        accuracy = {
            name: {"asked": share, "predicted": case.plan.predicted[name], "measured": measured[name]}
            for name, share in case.plan.asked.items()
        }
    limit = predicted_limit(case.chain, float(case.sample_times_s[-1]))
    return {
        "error_budget": parts,
        "error_note": note,
        "warnings": warnings_of(case, engine, trace),
        "step_limit_s": limit if math.isfinite(limit) else None,
        "accuracy": accuracy,
    }


def _has_all(found: EndedRun, case: Case) -> bool:
    """Whether the run's files are there and its forces as they were written."""
    wanted = [FORCES, "sensors.csv"] + ([STATE] if "state" in case.scene.run.record else [])
    there = all((found.folder / name).exists() for name in wanted)
    return there and sha256_of(found.folder / FORCES) == found.record.forces_sha256


def _write_products(case: Case, trace: Trace, folder: Path) -> None:
    from postproc.read.sensors import write_sensors

    write_forces(trace, folder / FORCES)
    write_sensors(case.layout, trace, folder / "sensors.csv")
    if "state" in case.scene.run.record:
        write_state(trace, folder / STATE)


def _remove(path: Path) -> None:
    if path.is_dir():
        shutil.rmtree(path)
    else:
        path.unlink(missing_ok=True)


def _record(
    case: Case, name: str, engine: Engine, version: str, deck: Deck, outcome: Outcome, folder: Path
) -> RunRecord:
    return RunRecord(
        engine=name,
        engine_version=version,
        status="done",
        reason="",
        deck_sha256=deck.sha256,
        command=" ".join(deck.command),
        bodies=case.chain.bodies,
        wall_s=round(outcome.wall_s, 4),
        cpu_s=round(outcome.cpu_s, 4),
        loop_s=engine.loop_seconds(_text(folder / "stdout.txt")),
        memory_bytes=outcome.memory_bytes,
        forces_sha256="",
        error_budget=[],
        error_note="",
        warnings=[],
        step_limit_s=None,
        accuracy=None,
        **_description(case),
        **provenance(),
    )


def _text(path: Path) -> str:
    return path.read_text(errors="replace")


def known_version(engine: Engine, executable: Path, home: Path) -> str:
    """The engine's version, asked once per executable and noted in its ``home``: asking costs a start-up."""
    with _asking_version:
        return _noted_version(engine, executable, home)


def _noted_version(engine: Engine, executable: Path, home: Path) -> str:
    if not executable.exists() or str(executable) == sys.executable:
        return engine.version(executable)
    status = executable.stat()
    key = f"{executable.resolve()} {status.st_size} {status.st_mtime_ns}"
    note = home / ".version.json"
    try:
        known = json.loads(note.read_text())
        if known["executable"] == key:
            return str(known["version"])
    except (OSError, ValueError, KeyError, TypeError):
        pass
    version = engine.version(executable)
    if version == UNKNOWN_VERSION:
        return version  # ask again next time: it may have been mended
    home.mkdir(parents=True, exist_ok=True)
    with whole_file(note) as draft:
        draft.write_text(json.dumps({"executable": key, "version": version}))
    return version


@contextmanager
def _workplace(home: Path, identity: str) -> Iterator[Path]:
    """A folder to work in, gone afterwards unless it was moved into place; leftovers of the dead are cleared."""
    home.mkdir(parents=True, exist_ok=True)
    for leftover in home.glob(f".{'?' * len(identity)}.*"):
        if leftover.is_dir() and not _alive(leftover.suffix[1:].partition("-")[0]):
            shutil.rmtree(leftover, ignore_errors=True)
    folder = home / f".{identity}.{os.getpid()}-{threading.get_ident()}"
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir()
    try:
        yield folder
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def _alive(process: str) -> bool:
    try:
        os.kill(int(process), 0)
    except (ValueError, ProcessLookupError):
        return False
    except PermissionError:
        pass
    return True


def _move_into_place(folder: Path, target: Path, former: Path | None) -> None:
    """Moves a complete folder to its name; a former run of the same hash gives way, and is there until then."""
    asides = []
    for place, old in enumerate({former, target} - {None}):
        assert old is not None
        aside = folder.with_name(f"{folder.name}-former{place}")
        try:
            old.rename(aside)
        except FileNotFoundError:
            continue  # there is none, or another process was faster
        asides.append(aside)
    try:
        folder.rename(target)
    except OSError:
        if read_record(target) is None:
            raise
    for aside in asides:
        shutil.rmtree(aside, ignore_errors=True)
