"""Decks to be run by hand, with their scene, and their import as run folders, unchanged or after changes."""

import hashlib
from collections.abc import Iterator
from dataclasses import replace
from difflib import unified_diff
from pathlib import Path
from textwrap import shorten

from drivers.base import paths
from drivers.base.errors import InputError, RunError
from drivers.base.files import DamagedError, read_file, read_sealed, write_sealed
from drivers.base.processes import workplace
from drivers.base.progress import say
from drivers.chain.case import Case
from drivers.chain.trace import finite_part
from drivers.engines import load_engine
from drivers.run.build import Build
from drivers.run.compute import Computed
from drivers.run.guard import checked, compared, unstable
from drivers.run.run import move_into_place, record_of_end
from drivers.run.run_folder import RECORD, EndedRun, folder_name, in_si, is_run, record_of, write_run
from drivers.scene.model import Scene
from drivers.scene.read_scene import stored_scene

SCENE = "scene.json"  # next to the deck
BY_HAND = "run by hand"  # version of the build, which is not known
WIDTH = 80  # characters of a changed line in the record


def write_scene(folder: Path, scene: Scene) -> None:
    """Write the scene of a deck next to it, where ``scene_of`` reads it when the deck has been run by hand."""
    write_sealed(folder / SCENE, in_si(scene), indent=2)


def scene_of(folder: Path) -> Scene:
    """Scene of a run folder, or of a folder with a deck.

    Raises:
        InputError: there is none, or it is damaged or of another version.
    """
    path = folder / (RECORD if is_run(folder) else SCENE)
    try:
        scene = record_of(folder).scene if is_run(folder) else read_sealed(path, "the scene of a deck")
        return stored_scene(scene)
    except FileNotFoundError:
        raise InputError(paths.shown(path), "", "no such file; give the scene of the deck by --scene") from None
    except (TypeError, ValueError, AttributeError) as error:
        raise DamagedError(paths.shown(path), "", "a scene of another version", "one of this version") from error


def import_run(source: Path, case: Case, engine_name: str, runs: Path = paths.RUNS) -> EndedRun:
    """Make a run folder of a folder with a deck and its raw output; the record holds the differences of the deck.

    The output is read as that of the case. A run that is unstable has failed and keeps its forces; so has one that is
    not that of its scheme without a change of its deck.

    Args:
        source: folder with the deck, whose files have the names of the engine's decks, and the raw output.
        case: case of the deck before changes.
        engine_name: name of the engine.
        runs: folder of all run folders.

    Raises:
        InputError: a file of the deck is missing or no text.
        RunError: the output is missing or cannot be read; nothing is kept.
    """
    engine, home = load_engine(engine_name, "--engine"), runs / engine_name
    deck = engine.deck_by_hand(engine.render(case))
    edited = {name: _text_of(source / name) for name in deck.files}
    edits = [line for name, text in deck.files.items() for line in _edits(name, text, edited[name])]
    raw = [source / name for name in deck.raw if (source / name).is_file()]
    for file in source.iterdir():
        if file.exists() and not (file.is_file() or file.is_dir()):  # a reader of output would wait for ever
            raise InputError(paths.shown(file), "", "no regular file", "files and folders")
    newest = max((source / name).stat().st_mtime for name in edited)
    for file in raw:
        if file.stat().st_mtime < newest:
            say(f"{paths.shown(file)}: older than the deck; run the deck again if it has been changed since")
    try:
        trace = engine.read(case, source)
    except RunError as error:
        raise RunError(f"{paths.shown(source)}: {error}") from error
    fault = None
    try:
        if not edits:
            trace = compared(case, engine, checked(case, trace))
        elif reason := unstable(case, trace):  # a changed deck may have another motion than the scene
            fault = RunError(reason)
    except RunError as error:
        fault = error
    digest = hashlib.sha256(repr((engine_name, edited)).encode() + b"".join(file.read_bytes() for file in raw))
    ended = Computed(trace, fault, wall_s=0.0, cpu_s=0.0, memory_bytes=0, loop_s=None)
    deck = replace(deck, files=edited)
    record = record_of_end(case, engine, Build((), BY_HAND, ""), deck, ended)
    record = replace(record, identity=digest.hexdigest()[:12], edits=edits, wall_s=None, cpu_s=None, memory_bytes=None)
    with workplace(home) as place:
        folder = place / "run"
        folder.mkdir()
        deck.write(folder)
        record = write_run(folder, record, finite_part(trace), state=True)
        target = home / folder_name(case.scene.name, record.layout, record.identity)
        move_into_place(folder, target, None)
    return EndedRun(target, record)


def _text_of(path: Path) -> str:
    allowed = "a file of the deck, as beads render writes it, perhaps changed"
    try:
        return read_file(path, allowed).decode()
    except (FileNotFoundError, ValueError) as error:
        found = "no such file" if isinstance(error, FileNotFoundError) else f"no readable text: {error}"
        raise InputError(paths.shown(path), "", found, allowed) from error


def _edits(name: str, rendered: str, edited: str) -> Iterator[str]:
    """Lines of a file that differ from the rendered one, as of ``diff``; the first may be the command of a build."""
    _, *old = rendered.splitlines()
    _, *new = edited.splitlines() or [""]
    for line in unified_diff(old, new, n=0, lineterm=""):
        if line[0] in "+-" and line not in ("--- ", "+++ "):
            yield f"{name}: {shorten(line, WIDTH, placeholder=' ...')}"
