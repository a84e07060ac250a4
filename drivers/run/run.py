"""Running cases on engines: each run gets a run folder, and a finished run is found again by its hash."""

import hashlib
import json
import shutil
import threading
from collections import defaultdict
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from contextlib import contextmanager, suppress
from dataclasses import asdict, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from drivers.base import paths
from drivers.base.decks import Deck
from drivers.base.errors import RunError
from drivers.base.files import sha256_of
from drivers.base.kept import kept
from drivers.base.processes import EndedProcess, all_stopped, cores, run_command
from drivers.base.progress import following
from drivers.chain.case import Case, build_case
from drivers.chain.trace import FORCES, SENSORS, STATE, Trace, digest_of, write_forces, write_state
from drivers.engines import Engine, load_engine
from drivers.limits.refusal import refuse
from drivers.run.build import Build, build_of
from drivers.run.finished import NOT_ASSESSED, EndedRun, RunRecord, find_run, provenance, read_record
from drivers.run.guard import checked_trace
from drivers.run.session import lent
from drivers.run.workplaces import workplace
from drivers.scene.read_scene import read_scene

PROBE = ("fig4", ("run.duration=20 us", "run.time_step=0.1 us"))  # short run that tests servers
MIN_LIMIT_S = 60.0
SECONDS_PER_BODY_AND_STEP = 5e-6  # ten times the cost of the slowest engine


_server_test = threading.Lock()


def default_limit_s(case: Case, engine: Engine) -> float:
    """Time limit of a run: given by the engine's entry, or in proportion to bodies times steps."""
    return engine.entry.time_limit_s or MIN_LIMIT_S + SECONDS_PER_BODY_AND_STEP * case.chain.bodies * case.scene.steps


def run_case(
    case: Case,
    engine_name: str,
    runs: Path = paths.RUNS,
    *,
    rerun: bool = False,
    limit_s: float | None = None,
    served: bool = False,
) -> EndedRun:
    """Run a case, or find a finished run of it.

    A failed run is tried again. The run folder appears under its name only when it is complete. A finished run of
    another scene with the same deck is reused with a new record.

    Args:
        case: the case.
        engine_name: name of the engine.
        runs: folder of all run folders.
        rerun: True to run again even if a finished run exists.
        limit_s: time limit in s; None for ``default_limit_s``.
        served: True to use a process that runs many decks; a run that fails there is repeated in its own process.

    Raises:
        RunError: the engine is not installed.
    """
    engine, home = load_engine(engine_name), runs / engine_name
    build = build_of(engine, home)
    deck = engine.render(case)
    identity = run_identity(engine_name, build, deck.sha256)
    layout = _description(case)["layout"]
    target = home / f"{case.scene.name}-{hashlib.sha256(repr(layout).encode()).hexdigest()[:6]}-{identity}"
    found = find_run(home, identity, layout)
    if found and not rerun and _is_complete(found, case):
        return refresh_record(found, case, target)
    with workplace(home) as place:
        folder, limit_s = place / "run", limit_s or default_limit_s(case, engine)
        folder.mkdir()
        served = served and serves_alike(engine, build)
        outcome, trace, fault = _tried(case, engine, build, deck, folder, limit_s, served=served)
        if served and fault and fault.status != "timeout":
            shutil.rmtree(folder)
            folder.mkdir()
            outcome, trace, fault = _tried(case, engine, build, deck, folder, limit_s, served=False)
        record = _record(case, engine, build, deck, outcome, folder)
        if fault:
            record = replace(record, status=fault.status, reason=str(fault))
        else:
            assert trace is not None
            write_forces(trace, folder / FORCES)
            if "state" in case.scene.run.record:
                write_state(trace, folder / STATE)
            record = replace(record, forces_sha256=sha256_of(folder / FORCES))
        for raw in (folder / name for name in deck.raw):
            if raw.is_dir():
                shutil.rmtree(raw)
            else:
                raw.unlink(missing_ok=True)
        record.write(folder)
        faster = find_run(home, identity, layout)  # by another process
        if faster and not rerun and _is_complete(faster, case):
            return refresh_record(faster, case, target)
        own = faster if faster and faster.record.layout == layout else None
        kept = own and own.done and record.status != "done"
        if kept:  # a failed run does not replace a finished one
            target = target.with_name(f"{target.name}-failed")
        _move_into_place(folder, target, own.folder if own and not kept else None)
    return EndedRun(target, record, fault.partial if fault else None)


def _tried(
    case: Case, engine: Engine, build: Build, deck: Deck, folder: Path, limit_s: float, *, served: bool
) -> tuple[EndedProcess, Trace | None, RunError | None]:
    """Run a deck in a folder; return the end of its process, and the trace or the error."""
    if served:
        with lent(engine, build.command, build.sha256) as session:
            outcome = session.run(engine.deck_by_hand(deck), limit_s)
            for file in session.case.iterdir():
                shutil.move(file, folder)
    else:
        engine.deck_by_hand(deck).write(folder)
        outcome = run_command(engine.started(deck, build.command), folder, limit_s, **engine.environment)
    try:
        return outcome, checked_trace(case, engine, outcome, folder), None
    except RunError as error:
        return outcome, None, error


def serves_alike(engine: Engine, build: Build) -> bool:
    """True if a build as a server gives the same bits as alone, tested once for each build by a short run."""
    if engine.in_repository:
        return True
    with _server_test:
        return bool(kept(["serves alike", engine.name, build.identity], lambda: _same_when_served(engine, build)))


def _same_when_served(engine: Engine, build: Build) -> bool:
    case = build_case(read_scene(*PROBE))
    deck, traces = engine.render(case), []
    for served in (False, True):
        with TemporaryDirectory() as folder:
            limit_s = default_limit_s(case, engine)
            _, trace, _ = _tried(case, engine, build, deck, Path(folder), limit_s, served=served)
            traces.append(trace)
    alone, other = traces
    return alone is not None and other is not None and digest_of(alone) == digest_of(other)


def run_many(jobs: Sequence[tuple[Case, str]], runs: Path = paths.RUNS, *, alone: bool = False) -> list[EndedRun]:
    """Run pairs of a case and an engine, or find finished runs; results in the order of ``jobs``.

    Equal decks run once, and the largest cases run first. One process runs many decks, unless ``alone`` requires a
    process for each run of a code, as started by hand.

    Raises:
        RunError: an engine is not installed.
    """
    keys = [(engine, load_engine(engine).render(case).sha256) for case, engine in jobs]
    different = sorted(dict(zip(keys, jobs, strict=True)).items(), key=lambda each: -each[1][0].work)
    with workers(cores()) as pool:
        under_way = {
            key: pool.submit(run_case, case, name, runs, served=not alone or load_engine(name).in_repository)
            for key, (case, name) in different
        }
        bar = following(as_completed(under_way.values()), "engines", len(under_way))
        for future in bar:
            future.result()
    ended = {key: future.result() for key, future in under_way.items()}
    return [
        run_case(case, engine, runs) if run.done and run.layout != case.layout else run  # other gauges: found again
        for (case, engine), run in zip(jobs, map(ended.__getitem__, keys), strict=True)
    ]


def run_all_done(jobs: Sequence[tuple[Case, str]], runs: Path = paths.RUNS) -> list[EndedRun]:
    """Like ``run_many``, but all runs have to succeed.

    Raises:
        InputError: a case is refused on its engine; nothing has been run.
        RunError: a run failed; the other runs are finished.
    """
    refuse_all(jobs)
    ended = run_many(jobs, runs)
    failures = [
        f"{case.scene.file}: {engine} {run.record.status}: {run.record.reason}"
        for (case, engine), run in zip(jobs, ended, strict=True)
        if not run.done
    ]
    if failures:
        raise RunError(failures[0] + (f" (and {len(failures) - 1} more)" if len(failures) > 1 else ""))
    return ended


def refuse_all(jobs: Sequence[tuple[Case, str]]) -> None:
    """Check all jobs for refusals, in parallel; InputError for the first refused job."""
    engines: dict[Case, list[str]] = defaultdict(list)
    for case, engine in jobs:
        engines[case].append(engine)

    def look_at(case: Case) -> None:
        for engine in engines[case]:
            refuse(case, engine)

    with workers(cores()) as pool:
        for _ in following(pool.map(look_at, engines), "cases checked", len(engines), "case"):
            pass


@contextmanager
def workers(count: int) -> Iterator[ThreadPoolExecutor]:
    """Threads that wait for engines; an error lets running engines finish, an interrupt kills them."""
    with ThreadPoolExecutor(max_workers=count) as pool:
        try:
            yield pool
        except (KeyboardInterrupt, SystemExit):
            with all_stopped():
                pool.shutdown(cancel_futures=True)
            raise
        except BaseException:
            pool.shutdown(cancel_futures=True)
            raise


def run_identity(engine_name: str, build: Build, deck_sha256: str) -> str:
    """Digest of engine, build and deck, which determine the numbers of a run."""
    return hashlib.sha256(f"{engine_name}\0{build.identity}\0{deck_sha256}".encode()).hexdigest()[:12]


def refresh_record(found: EndedRun, case: Case, target: Path) -> EndedRun:
    """Give a run found for another scene with the same deck the record of this case, not yet assessed.

    If the gauges differ, the run is copied to ``target``, since ``sensors.csv`` depends on them.
    """
    described = _description(case)
    if all(getattr(found.record, key) == value for key, value in described.items()):
        return found
    record = replace(found.record, **described, **NOT_ASSESSED)
    if found.record.layout == record.layout:
        record.write(found.folder)
        return EndedRun(found.folder, record)
    with workplace(target.parent) as place:
        shutil.copytree(found.folder, place / "run", ignore=shutil.ignore_patterns(SENSORS))
        record.write(place / "run")
        _move_into_place(place / "run", target, None)
    return EndedRun(target, record)


def _description(case: Case) -> dict[str, Any]:
    """Keys of the record that describe the scene, as JSON values."""
    described = {
        "scene_name": case.scene.name,
        "scene": {"units": "SI"} | case.scene.model_dump(mode="json", exclude_none=True),
        "layout": asdict(case.layout),
        "elements": [asdict(element) for element in case.elements],
        "time_step_s": case.scene.time_step_s,
        "steps": case.scene.steps,
    }
    return dict(json.loads(json.dumps(described)))


def _is_complete(found: EndedRun, case: Case) -> bool:
    """True if the run is done, its files exist and its forces are undamaged."""
    wanted = [FORCES, STATE] if "state" in case.scene.run.record else [FORCES]
    there = found.done and all((found.folder / name).exists() for name in wanted)
    return there and sha256_of(found.folder / FORCES) == found.record.forces_sha256


def _record(case: Case, engine: Engine, build: Build, deck: Deck, outcome: EndedProcess, folder: Path) -> RunRecord:
    return RunRecord(
        engine=engine.name,
        engine_version=build.version,
        executable=" ".join(build.command),
        build_sha256=build.sha256,
        status="done",
        reason="",
        deck_sha256=deck.sha256,
        command=engine.command_by_hand(deck),
        bodies=case.chain.bodies,
        wall_s=round(outcome.wall_s, 4),
        cpu_s=round(outcome.cpu_s, 4),
        loop_s=engine.loop_seconds((folder / "stdout.txt").read_text(errors="replace")),
        memory_bytes=outcome.memory_bytes,
        forces_sha256="",
        **NOT_ASSESSED,
        **_description(case),
        **provenance(),
    )


def _move_into_place(folder: Path, target: Path, former: Path | None) -> None:
    """Move a complete folder to its name; an older run of the same hash stays until then."""
    for number, old in enumerate({former or target, target}):
        with suppress(FileNotFoundError):  # no older run, or another process was faster
            old.rename(folder.with_name(f"former{number}"))
    try:
        folder.rename(target)
    except OSError:
        if read_record(target) is None:
            raise
