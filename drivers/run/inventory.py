"""Existing runs: listed, found by scene, engine and settings, and removed if no command would use them."""

import shlex
import shutil
import time
from collections import Counter
from collections.abc import Iterable, Sequence
from contextlib import suppress
from fnmatch import fnmatchcase
from math import isclose
from pathlib import Path
from typing import Any

from drivers.base import paths
from drivers.base.errors import InputError, RunError, one_line
from drivers.base.processes import UNKNOWN_VERSION
from drivers.base.terminal import text_table
from drivers.base.units import to_si
from drivers.chain.case import build_case
from drivers.engines import engine_names, load_engine
from drivers.run.build import build_of
from drivers.run.run import run_identity
from drivers.run.run_folder import FOLDER_NAME, EndedRun, any_run, in_si, is_run
from drivers.scene.model import Scene
from drivers.scene.read_scene import find_scene, read_scene, stored_scene
from drivers.scene.settings import look_up, setting_text, settings_between, unit_of

RECORDED = "run.record"  # key of the files to be written, which changes no number
ROWS = "batch.sqlite"  # rows of batches
ROUNDING = 1e-12


def kept_runs(runs: Path) -> list[EndedRun]:
    """All runs of a folder, damaged ones among them, the newest last; other folders are ignored."""
    folders = [folder for folder in runs.glob("[!.]*/[!.]*") if folder.is_dir()]
    kept = [any_run(folder) for folder in folders if is_run(folder) or FOLDER_NAME.fullmatch(folder.name)]
    return sorted(kept, key=lambda run: (run.ended, run.folder))


def scene_now(source: str) -> Scene | None:
    """Scene as its file is now, by the name of a shipped one or by its path, with or without ``.toml``.

    None if there is no such file.

    Raises:
        InputError: the file is wrong.
    """
    for asked in (source, f"{source}.toml"):
        with suppress(InputError):
            if (path := find_scene(asked)).exists():
                break
    else:
        return None
    return read_scene(path)


def _differences(run: EndedRun, scene: Scene) -> str:
    """Settings of a run that differ from a scene, as text, without those that change no number."""
    between = settings_between(run.resolved, in_si(scene))
    return ", ".join(f"{key}={value}" for key, value in between.items() if key != RECORDED)


def _newest(kept: Sequence[EndedRun], engine: str, name: str, scene: Scene | None) -> EndedRun | None:
    """Newest finished run of a scene or, without one, of those recorded under a name."""
    finished = (run for run in reversed(kept) if run.record.engine == engine and not (run.trouble or run.record.edits))
    wanted = (run for run in finished if (not _differences(run, scene) if scene else run.record.scene_name == name))
    return next(wanted, None)


def _name_of(source: str) -> str:
    """Name of a scene, given by name or file."""
    return Path(source.removesuffix(".toml")).name


def run_folder(name: str | Path, runs: Path = paths.RUNS) -> Path:
    """Run folder by its path, or by ``ENGINE:SCENE``: the newest finished run of the scene as its file is now.

    The run has the physics, gauges and accuracy of the file, whatever it was called, and no deck changed by hand. A
    name without a file, as of a scene in another folder, is that of the newest finished run recorded under it.

    Raises:
        InputError: no such run; the message says how to make it. Or the file of the scene is wrong.
    """
    engine, colon, source = str(name).partition(":")
    if not colon or Path(name).exists():
        return Path(name)
    kept, scene, scene_name = kept_runs(runs), scene_now(source), _name_of(source)
    if newest := _newest(kept, engine, scene_name, scene):
        return newest.folder
    if scene is None or engine not in engine_names():
        allowed = ", ".join(sorted({run.name for run in kept if run.done})) or "a run folder; no run is done there"
        raise InputError(str(name), "", f"no such run in {paths.shown(runs)}", allowed)
    found = f"no finished run of {scene.file} as it is now"
    if former := next((run for run in reversed(kept) if run.name == f"{engine}:{scene_name}"), None):
        found += f", but {paths.shown(former.folder)} with {former.trouble or _differences(former, scene)}"
    place = "" if runs == paths.RUNS else f" --runs {shlex.quote(paths.shown(runs))}"
    command = f"beads run {shlex.quote(scene.file)} --engine {engine}{place}"
    raise InputError(str(name), "", found, f"a run folder, or this name after {command}")


def select(
    kept: Sequence[EndedRun], scenes: Iterable[str], engines: Sequence[str], settings: Sequence[str]
) -> list[EndedRun]:
    """Select runs by the recorded names of their scenes, by engines and by settings; an empty selector takes all.

    All settings ``KEY=VALUE`` have to match; a value may be a glob.

    Raises:
        InputError: no run matches.
    """
    names = {*map(_name_of, scenes)}
    selected = [
        run
        for run in kept
        if (not names or run.record.scene_name in names)
        and (not engines or run.record.engine in engines)
        and all(_has(run.resolved, setting) for setting in settings)
    ]
    if (asked := [*names, *engines, *settings]) and not selected:
        known = ", ".join(sorted({run.name for run in kept})) or "none, since the folder has no runs"
        raise InputError("runs", "", f"no run of {', '.join(asked)}", known)
    return selected


def _has(scene: dict[str, Any], setting: str) -> bool:
    """True if a scene has the value of a setting, or one that matches it."""
    key, equals, asked = map(str.strip, setting.partition("="))
    if not equals:
        raise InputError(f"--set {setting}", "", "not of the form KEY=VALUE, such as 'striker.speed=2 m/s'")
    value = look_up(scene, key)
    text = setting_text(key, value)
    with suppress(ValueError, TypeError):
        return isclose(to_si(asked, unit_of(key)), value, rel_tol=ROUNDING)
    return text == asked or fnmatchcase(text, asked)


def print_runs(runs: Path, scenes: Sequence[str], engines: Sequence[str], settings: Sequence[str]) -> None:
    """Print one line for each run, the newest last, and the total size.

    A line begins with ``ENGINE:SCENE`` where this finds the run, else with its folder.
    """
    kept = kept_runs(runs)
    chosen = select(kept, scenes, engines, settings)
    now = dict[str, Scene | None]()
    for name in {run.record.scene_name for run in chosen}:
        with suppress(InputError):  # a wrong file is no reason to list no runs
            now[name] = scene_now(name)
    pairs = {(run.record.engine, run.record.scene_name) for run in chosen}
    named = [_newest(kept, engine, name, now.get(name)) for engine, name in pairs]
    home, rows = Path(paths.shown(runs)), []  # following links takes long
    for run in chosen:
        record, scene = run.record, now.get(run.record.scene_name)
        remarks = [
            "found no scene file of this name" if not scene else _differences(run, scene) if run.resolved else "",
            "deck changed by hand" * bool(record.edits),
            run.trouble.removeprefix(f"{record.status}: "),
        ]
        shown = run.name if run in named else str(home / run.folder.relative_to(runs))
        when = time.strftime("%Y-%m-%d %H:%M", time.localtime(run.ended))
        remark = one_line("; ".join(filter(None, remarks)))
        rows.append((shown, record.scene_name, record.engine, when, _size_text([run]), record.status, remark))
    for line in text_table(rows):
        print(line)
    counts = ", ".join(f"{count} {status}" for status, count in sorted(Counter(row[5] for row in rows).items()))
    plural = "s" * (len(chosen) != 1)
    print(f"{len(chosen)} run{plural}{f' ({counts})' * bool(counts)}: {_size_text(chosen)}")
    if (runs / ROWS).is_file():
        print(f"{home / ROWS}: rows of batches: {(runs / ROWS).stat().st_size / 1e6:,.1f} MB")


def _size_text(runs: Iterable[EndedRun]) -> str:
    """Size of runs as text, such as ``1.2 MB``."""
    size = sum(run.size for run in runs)
    return f"{size / 1e3:,.0f} kB" if size < 1e6 else f"{size / 1e6:,.1f} MB"


def prune(
    runs: Path, scenes: Sequence[str], engines: Sequence[str], settings: Sequence[str], *, dry_run: bool = False
) -> None:
    """Remove runs of a selection that are not done or whose identity is not today's; print a line for each.

    Today's identity is that of the installed build and of the deck of the stored scene; it is unknown, and a finished
    run stays, if the engine is not installed or not known here. Imported runs, which no command makes again, and
    folders that have been renamed stay as well. With ``dry_run`` nothing is removed.
    """
    selected, removed = select(kept_runs(runs), scenes, engines, settings), list[EndedRun]()
    done = "would remove" if dry_run else "removed"
    for run in selected:
        if why := _why_unused(any_run(run.folder)):  # another process may have repeated it since
            if not dry_run:
                shutil.rmtree(run.folder, ignore_errors=True)
            removed.append(run)
            print(one_line(f"{done} {paths.shown(run.folder)}: ", why))
    print(f"{done} {len(removed)} of {len(selected)} runs: {_size_text(removed)}")


def _why_unused(run: EndedRun) -> str:
    """Reason to remove a run; empty to keep it."""
    record = run.record
    if record.edits is not None or not FOLDER_NAME.fullmatch(run.folder.name):
        return ""
    if run.trouble:
        return run.trouble
    with suppress(InputError, RunError):  # not installed, or the scene is refused today
        engine = load_engine(record.engine)
        build, deck = build_of(engine), engine.render(build_case(stored_scene(record.scene)))
        today = run_identity(record.engine, build, deck.sha256)
        if build.version != UNKNOWN_VERSION and today != record.identity:
            return "of another build or deck than today's"
    return ""
