"""Runs of cases on engines: each has a run folder, and a finished run is found again by its hash.

A deck that a person ran by hand, unchanged or after changes, is imported as a run folder.
"""

import json
import platform
import re
import shlex
import shutil
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import asdict, replace
from difflib import unified_diff
from functools import cache, lru_cache
from pathlib import Path
from textwrap import shorten
from typing import Any

from drivers.base import paths
from drivers.base.decks import Deck
from drivers.base.errors import InputError, RunError
from drivers.base.files import sha256_in, sha256_of
from drivers.base.processes import git, local_changes, workplace
from drivers.base.terminal import following, say
from drivers.chain.case import ALL_DIGITS, Case
from drivers.chain.trace import Trace, finite_part
from drivers.engines import Engine, load_engine
from drivers.engines._raw_output import LARGEST_DECK, files_of
from drivers.limits import inability, refuse
from drivers.run.build import Build, build_of
from drivers.run.compute import Computed, compute
from drivers.run.execute import execute
from drivers.run.run_folder import SCENE, EndedRun, RunRecord, find_run, for_scene, in_si, move_into_place, write_run
from drivers.run.scheme import COMPARED, checked, compared, known_of, unstable, wrong_start

BY_HAND = "run by hand"  # version of the build, which is not known
A_DECK = "a file of the deck, as beads render writes it, perhaps changed; or --dump FILE of a deck of your own"
WIDTH = 200  # characters of a changed line in the record
FEW_DIGITS = 5  # of an output: with fewer nothing is left to be judged
COMMANDS = re.compile(rb"^[ \t]*(units|timestep|pair_style|read_data|create_atoms|Atoms)\b", re.MULTILINE)
LOGS = (b"LIGGGHTS (", b"LAMMPS (")  # their beginnings

Words = tuple[str, ...]


def run_case(
    case: Case,
    engine_name: str,
    runs: Path = paths.RUNS,
    *,
    rerun: bool = False,
    limit_s: float | None = None,
    own_process: bool | None = None,
) -> EndedRun:
    """Run a case, or find a finished run of it.

    A failed or damaged run is tried again; a failed one keeps its forces as far as its output can be read. The run
    folder appears under its name only when it is complete. A finished run of another scene with the same deck is reused
    with a new record.

    Args:
        case: the case.
        engine_name: name of the engine.
        runs: folder of all run folders.
        rerun: True to run again even if a finished run exists.
        limit_s: time limit in s; None for ``drivers.chain.schemes.default_limit_s``.
        own_process: False for a server; see ``compute``.

    Raises:
        RunError: the engine is not installed.
    """
    engine, home = load_engine(engine_name), runs / engine_name
    build, deck = build_of(engine), _deck(case, engine_name)
    identity, described = run_identity(engine_name, build, deck.sha256), _description(case)
    layout = described["layout"]
    keeps_state = "state" in case.scene.run.record
    known = None if rerun else find_run(home, identity, layout)
    if known and known.is_complete(state=keeps_state):
        return for_scene(known, described)
    for line in known.damage() if known else ():
        say(f"{line}: run again")
    with workplace(home) as place:
        folder = place / "run"
        folder.mkdir()
        ended = compute(
            case, engine_name, build=build, deck=deck, limit_s=limit_s, folder=folder, own_process=own_process
        )
        for raw in (folder / name for name in (*deck.raw, *deck.logs)):  # files or folders
            shutil.rmtree(raw, ignore_errors=True)
            raw.unlink(missing_ok=True)
        trace, failed = ended.trace, ended.fault is not None
        if ended.fault and ended.fault.partial is not None:
            trace = finite_part(ended.fault.partial)
        record = record_of_end(case, engine, build, deck, ended)
        record = write_run(folder, record, trace, state=keeps_state or failed)  # to see how it went wrong
        known = find_run(home, identity, layout)
        if known and not rerun and known.is_complete(state=keeps_state):  # by another process
            return for_scene(known, described)
        target = home / record.folder_name
        former = known if known and known.record.layout == layout else None
        if former and former.done and failed:  # a failed run does not replace a finished one
            target, former = target.with_name(f"{target.name}-failed"), None
        move_into_place(folder, target, former)
    return EndedRun(target, record)


def run_many(jobs: Sequence[tuple[Case, str]], runs: Path = paths.RUNS, *, unsafe: bool = False) -> list[EndedRun]:
    """Run pairs of a case and an engine, or find finished runs; results in the order of ``jobs``.

    Equal decks run once, and the largest cases run first. Several decks of a code run on servers.

    Args:
        jobs: cases with the names of their engines.
        runs: folder of all run folders.
        unsafe: True to run also what would be refused.

    Raises:
        InputError: a case without a finished run is refused on its engine; nothing has been run.
        RunError: an engine is not installed.
    """
    to_run = [] if unsafe else [(case, engine) for case, engine in jobs if not is_done(case, engine, runs)]
    for case, engine in following(to_run, "cases checked", len(to_run), "case"):
        refuse(case, engine)
    keys = [(engine, _deck(case, engine).sha256) for case, engine in jobs]
    different = dict(zip(keys, jobs, strict=True))
    largest_first = sorted(different, key=lambda key: -different[key][0].work)
    decks = Counter(engine for engine, _ in different)

    def run(key: tuple[str, str]) -> EndedRun:
        return run_case(*different[key], runs, own_process=None if decks[key[0]] == 1 else False)

    ended = dict(following(execute(run, largest_first), "engines", len(different)))
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
    ended = run_many(jobs, runs)
    failures = [
        f"{case.scene.file}: {engine} {run.record.status}: {run.record.reason}"
        for (case, engine), run in zip(jobs, ended, strict=True)
        if not run.done
    ]
    if failures:
        raise RunError(failures[0] + (f" (and {len(failures) - 1} more)" if len(failures) > 1 else ""))
    return ended


def is_done(case: Case, engine_name: str, runs: Path) -> bool:
    """True if there is a finished run of a case on an engine."""
    engine = load_engine(engine_name)
    if engine.find() is None or inability(case, engine_name):  # whose deck cannot be rendered
        return False
    identity = run_identity(engine_name, build_of(engine), _deck(case, engine_name).sha256)
    run = find_run(runs / engine_name, identity, {})
    return run is not None and run.done


@lru_cache(maxsize=4)
def _deck(case: Case, engine_name: str) -> Deck:
    """Deck of a case; the last ones are kept, since that of a million beads takes seconds."""
    return load_engine(engine_name).render(case)


def run_identity(engine_name: str, build: Build, deck_sha256: str) -> str:
    """Digest of engine, build and deck, which determine the numbers of a run."""
    return sha256_in(f"{engine_name}\0{build.identity}\0{deck_sha256}")[:12]


def _description(case: Case) -> dict[str, Any]:
    """Keys of the record that describe the scene, as JSON values."""
    described = {
        "scene_name": case.scene.name,
        "scene": {"units": "SI"} | in_si(case.scene),
        "layout": asdict(case.layout),
        "elements": [asdict(element) for element in case.elements],
        "time_step_s": case.scene.time_step_s,
        "steps": case.scene.steps,
    }
    return dict(json.loads(json.dumps(described)))


def record_of_end(case: Case, engine: Engine, build: Build, deck: Deck, ended: Computed) -> RunRecord:
    """Record of a run that ended, not yet assessed."""
    return RunRecord(
        identity=run_identity(engine.name, build, deck.sha256),
        engine=engine.name,
        engine_version=build.version,
        executable=" ".join(build.command),
        build_sha256=build.sha256,
        status=ended.fault.status if ended.fault else "done",
        reason=str(ended.fault) if ended.fault else "",
        deck_sha256=deck.sha256,
        command=shlex.join(engine.by_hand(deck).command),
        bodies=case.chain.bodies,
        wall_s=round(ended.wall_s, 4) or None,
        cpu_s=round(ended.cpu_s, 4) or None,
        loop_s=ended.loop_s,
        memory_bytes=ended.memory_bytes or None,
        files={},
        **_description(case),
        **provenance(),
    )


@cache
def provenance() -> dict[str, Any]:
    """Machine, commit, changes of the work tree, and digest of the lock file."""
    commit, lock = git("rev-parse", "HEAD"), paths.ROOT / "requirements.lock"
    return {
        "host": f"{platform.node()}, {platform.system()} {platform.machine()}, Python {platform.python_version()}",
        "commit": commit or "unknown",
        "dirty": local_changes(),
        "lock_sha256": sha256_of(lock) if lock.exists() else "",
    }


def import_run(
    source: Path, case: Case, engine_name: str, runs: Path = paths.RUNS, dump: Path | None = None, columns: Words = ()
) -> EndedRun:
    """Make a run folder of a folder with a deck and its raw output; the record holds the differences of the deck.

    The output is read as that of the case. A run that is unstable has failed and keeps its forces; so has one that is
    not that of its scheme without a change of its deck.

    Args:
        source: folder with the deck and the raw output. A deck of other files than the engine's is one's own.
        case: case of the deck before changes.
        engine_name: name of the engine.
        runs: folder of all run folders.
        dump: output of a deck of one's own, in any folder; None for that of the engine's decks.
        columns: names of its columns in the words of the engine's decks; none for those that the dump has.

    Raises:
        InputError: a file of the deck is missing.
        RunError: the output is missing or cannot be read; nothing is kept.
    """
    engine, home = load_engine(engine_name, "--engine"), runs / engine_name
    read = engine.read_dump
    if dump and read is None:
        raise InputError("--dump", "", f"the engine {engine_name}", "an engine that writes dumps, as lammps, liggghts")
    if cannot := inability(case, engine_name):
        raise cannot
    deck = engine.render(case)
    for file in source.iterdir():
        if file.exists() and not (file.is_file() or file.is_dir()):  # a reader of output would wait for ever
            raise InputError(paths.shown(file), "", "no regular file", "files and folders")
    if dump and not (source / SCENE).exists():  # which render writes
        files = {file.name: file.read_text(errors="replace") for file in source.iterdir() if _is_deck(file)}
        edits = [f"a deck of one's own: {', '.join(sorted(files)) or 'not given'}"]
    else:
        if lost := [source / name for name in deck.files if not (source / name).is_file()]:
            raise InputError(paths.shown(lost[0]), "", "no such file", A_DECK)
        files = {name: (source / name).read_bytes().decode(errors="replace") for name in deck.files}
        edits = [line for name, text in deck.files.items() for line in _edits(name, text, files[name])]
    newest = max(((source / name).stat().st_mtime for name in files), default=0.0)
    raw = files_of(dump) if dump else [source / name for name in deck.raw if (source / name).is_file()]
    for file in raw:
        if file.exists() and file.stat().st_mtime < newest:
            say(f"{paths.shown(file)}: older than the deck; run the deck again if it has been changed since")
    try:
        trace, digits = read(case, dump, columns) if dump and read else (engine.read(case, source), ALL_DIGITS)
    except RunError as error:
        raise RunError(f"{paths.shown(dump.parent if dump else source)}: {error}") from error
    case = replace(case, digits=digits)
    edits += [*_untold(case, trace), *filter(None, [wrong_start(case, trace) if edits else None])]
    reason = unstable(case, trace)  # a changed deck may have another motion than the scene
    fault = RunError(reason) if reason else None
    try:
        trace = trace if edits else compared(case, engine, checked(case, trace))
    except RunError as error:
        fault = error
    content = b"".join(file.read_bytes() for file in raw)
    identity = sha256_in(repr((engine_name, deck.sha256, files, columns)).encode() + content)[:12]
    ended = Computed(trace, fault, wall_s=0.0, cpu_s=0.0, memory_bytes=0, loop_s=None)
    record = record_of_end(case, engine, Build((), BY_HAND, ""), replace(deck, files=files or deck.files), ended)
    record = replace(record, identity=identity, edits=edits, digits=digits)
    with workplace(home) as place:
        folder = place / "run"
        folder.mkdir()
        replace(deck, files=files).write(folder)
        record = write_run(folder, record, finite_part(trace), state=trace.height_m is not None)
        target = home / record.folder_name
        move_into_place(folder, target)
    return EndedRun(target, record)


def _is_deck(file: Path) -> bool:
    """True if a file of a folder is part of a deck of LAMMPS or LIGGGHTS, and no log."""
    text = file.read_bytes() if file.is_file() and file.stat().st_size < LARGEST_DECK else b""
    return bool(COMMANDS.search(text)) and not text.startswith(LOGS)


def _untold(case: Case, trace: Trace) -> Iterator[str]:
    """Sentences on what an output does not tell; RunError if it tells too little."""
    if lost := [name for name, values in (("z", trace.height_m), ("vz", trace.velocity_m_s)) if values is None]:
        missing = [quantity for quantity in COMPARED if quantity not in known_of(trace)]
        yield f"no column {' and '.join(lost)}: {' and '.join(missing)} cannot be judged"
    least = FEW_DIGITS if case.chain.straight else ALL_DIGITS - 2
    if case.digits < least:
        raise RunError(f"output of {case.digits} digits; {least} or more can be judged: dump_modify format writes them")
    if case.digits < ALL_DIGITS - 2:
        yield f"output of {case.digits} digits: what they may change is not judged; dump_modify format writes more"


def _edits(name: str, rendered: str, edited: str) -> Iterator[str]:
    """Lines of a file that differ from the rendered one by more than spaces; the first may name another build."""
    old, new = ([*filter(None, (_plain(name, line) for line in text.splitlines()[1:]))] for text in (rendered, edited))
    for line in unified_diff(old, new, n=0, lineterm=""):
        if line[0] in "+-" and line not in ("--- ", "+++ "):
            yield f"{name}: {shorten(line, WIDTH, placeholder=' ...')}"


def _plain(name: str, line: str) -> str:
    """Line without needless spaces; those before a statement of Python have a meaning."""
    indent = line[: len(line) - len(line.lstrip())] if name.endswith(".py") else ""
    return indent + " ".join(line.split()) if line.strip() else ""
