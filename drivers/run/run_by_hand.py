"""Decks to be run by hand, with their scene, and their import as run folders, unchanged or after changes."""

import hashlib
import shutil
from collections.abc import Iterator
from difflib import SequenceMatcher
from pathlib import Path
from textwrap import shorten
from typing import Any

from drivers.base import paths
from drivers.base.errors import InputError, RunError
from drivers.base.files import DamagedError, read_sealed, write_sealed
from drivers.base.progress import say
from drivers.chain.case import Case
from drivers.chain.trace import finite_part
from drivers.engines import load_engine
from drivers.run.guard import reason_to_fail, unstable, wrong_start
from drivers.run.run import description_of, move_into_place, provenance
from drivers.run.run_folder import (
    NOT_ASSESSED,
    RECORD,
    EndedRun,
    RunRecord,
    folder_name,
    in_si,
    is_run,
    record_of,
    write_run,
)
from drivers.run.workplaces import workplace
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

    The output is read as that of the case. A run that is unstable has failed and keeps its forces; so has one that has
    another start or energy without a change of its deck.

    Args:
        source: folder with the deck, whose files have the names of the engine's decks, and the raw output.
        case: case of the deck before changes.
        engine_name: name of the engine.
        runs: folder of all run folders.

    Raises:
        InputError: a file of the deck is missing or no text.
        RunError: the output is missing or cannot be read; nothing is kept.
    """
    engine = load_engine(engine_name, "--engine")
    deck = engine.deck_by_hand(engine.render(case))
    found = {name: _text_of(source / name) for name in deck.files}
    first, *_ = deck.files  # its first line is the command of an installed build
    edits = [line for name, text in deck.files.items() for line in _edits(name, text, found[name], name == first)]
    present = [source / name for name in (*deck.files, *deck.raw) if (source / name).is_file()]
    newest = max((source / name).stat().st_mtime for name in deck.files)
    for old in (file for file in present if file.name in deck.raw and file.stat().st_mtime < newest):
        say(f"{paths.shown(old)}: older than the deck; run the deck again if it has been changed since")
    try:
        trace = engine.read(case, source)
    except RunError as error:
        raise RunError(f"{paths.shown(source)}: {error}") from error
    # a changed deck may have another start and another energy than the scene
    reason = unstable(case, trace) if edits else reason_to_fail(case, trace) or wrong_start(case, trace)
    unknown: dict[str, Any] = dict.fromkeys(("wall_s", "cpu_s", "loop_s", "memory_bytes"))
    digest = hashlib.sha256(f"{BY_HAND}\0{engine_name}".encode())
    for file in present:
        digest.update(file.read_bytes())
    home, record = (
        runs / engine_name,
        RunRecord(
            identity=digest.hexdigest()[:12],
            engine=engine_name,
            engine_version=BY_HAND,
            executable="",
            build_sha256="",
            status="failed" if reason else "done",
            reason=reason or "",
            deck_sha256=hashlib.sha256(repr(found).encode()).hexdigest(),
            command=engine.command_by_hand(deck),
            bodies=case.chain.bodies,
            files={},
            edits=edits,
            **unknown,
            **NOT_ASSESSED,
            **description_of(case),
            **provenance(),
        ),
    )
    with workplace(home) as place:
        folder = place / "run"
        folder.mkdir()
        for name in deck.files:
            shutil.copyfile(source / name, folder / name)
        record = write_run(folder, record, finite_part(trace), state=True)
        target = home / folder_name(case.scene.name, record.layout, record.identity)
        move_into_place(folder, target, None)
    return EndedRun(target, record)


def _text_of(path: Path) -> str:
    try:
        return path.read_text()
    except (OSError, ValueError) as error:
        found = error.strerror if isinstance(error, OSError) else "no text"
        allowed = "a file of the deck, as beads render writes it, perhaps changed"
        raise InputError(paths.shown(path), "", found or "", allowed) from error


def _edits(name: str, rendered: str, found: str, command_first: bool) -> Iterator[str]:
    """Differences of a file from the rendered one, by line, such as ``chain.in:41: timestep 1e-07 -> timestep 2e-07``.

    The first line is left out if it is the command.
    """
    old, new = rendered.splitlines()[command_first:], found.splitlines()[command_first:]
    same_length = len(old) == len(new)
    blocks = [("", i, i + 1, i, i + 1) for i in range(len(old)) if old[i] != new[i]] if same_length else None
    for tag, start, end, begin, stop in blocks or SequenceMatcher(None, old, new, autojunk=False).get_opcodes():
        if tag != "equal":
            pair = (" / ".join(map(str.strip, lines)) for lines in (old[start:end], new[begin:stop]))
            was, now = (shorten(text, WIDTH, placeholder=" ...") or "nothing" for text in pair)
            yield f"{name}:{begin + 1 + command_first}: {was} -> {now}"
