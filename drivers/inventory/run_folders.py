"""Runs of a folder: listed, found by scene, engine and settings, and by names without a hash."""

import json
import os
import sys
import time
from collections import Counter
from collections.abc import Iterable, Sequence
from contextlib import suppress
from dataclasses import fields
from fnmatch import fnmatchcase
from math import isclose
from pathlib import Path
from typing import Any

from drivers.base import paths
from drivers.base.errors import InputError, one_line
from drivers.base.text_table import text_table
from drivers.base.units import to_si
from drivers.run.run_folder import DAMAGED, FOLDER_NAME, EndedRun, RunRecord, in_si, read_record
from drivers.scene.model import Scene
from drivers.scene.read_scene import read_scene, read_value
from drivers.scene.settings import DERIVED, FREE_TEXT, look_up, setting_text, settings_between, unit_of, unplanned

NO_PHYSICS = (*FREE_TEXT, "title", "name")  # keys of a scene that change no number
UNREADABLE = "a record that is damaged or of another version"
RECORDED = "run.record"  # key of the files to be written, which changes no run
ROUNDING = 1e-12
Json = dict[str, Any]


def key_of(run: EndedRun) -> tuple[str, str]:
    """Engine, and scene with all settings; for a damaged run the name of its folder."""
    return run.record.engine, json.dumps(_physics(run.resolved), sort_keys=True) if run.resolved else run.folder.name


def _physics(part: Any) -> Any:
    if isinstance(part, dict):  # a table may be a material of such a name
        return {key: _physics(value) for key, value in part.items() if key not in NO_PHYSICS or isinstance(value, dict)}
    return [_physics(value) for value in part] if isinstance(part, list) else part


def _content(scene: Json) -> str:
    """Text of a scene that is the same for equal physics, gauges and accuracy; empty for no scene."""
    if not scene:
        return ""
    tables = {key: value for key, value in unplanned(scene).items() if key not in DERIVED}
    run = {key: value for key, value in tables["run"].items() if f"run.{key}" != RECORDED}
    return json.dumps(_physics(tables | {"run": run}), sort_keys=True)


def _keys(run: EndedRun) -> tuple[str, str]:
    """Content of a run's scene, and its name in the record; a run is found by either."""
    return _content(run.resolved), run.record.scene_name


def _asked_keys(source: str, base: Json) -> list[str]:
    """Keys of the runs of a scene: the content ``base`` of its file, if there is one, then its name."""
    return [*filter(None, [_content(base)]), _name_of(source)]


def kept_runs(runs: Path) -> list[EndedRun]:
    """All runs of a folder, damaged ones among them, the newest last; other folders are ignored."""
    read = (_read(folder) for folder in runs.glob("[!.]*/[!.]*"))
    return sorted(filter(None, read), key=lambda run: (run.ended, run.folder))


def _read(folder: Path) -> EndedRun | None:
    """Run of a folder; None without a record and without the name of a run."""
    record = read_record(folder)
    if record and (run := EndedRun(folder, record)).resolved:
        return run
    named = FOLDER_NAME.fullmatch(folder.name)
    return EndedRun(folder, _damaged_record(folder.parent.name, named[1])) if named and folder.is_dir() else None


def _damaged_record(engine: str, scene: str) -> RunRecord:
    """Record in place of one that cannot be read: engine and scene by the names of the folders, no other values."""
    values: dict[str, Any] = dict.fromkeys(field.name for field in fields(RunRecord))
    values |= {
        "engine": engine,
        "engine_version": "not known",
        "build_sha256": "",
        "scene_name": scene,
        "status": DAMAGED,
        "reason": UNREADABLE,
        "scene": {},
        "files": {},
    }
    return RunRecord(**values)


def select(
    kept: Sequence[EndedRun], scenes: Iterable[str], engines: Iterable[str], settings: Sequence[str]
) -> list[EndedRun]:
    """Select runs by scenes (name or file), engines and settings ``KEY=VALUE``; an empty selector takes all.

    Runs of a scene have the content of its file, or its name in their record. Values may be globs. Of several values of
    one key any may match; all keys have to match.

    Raises:
        InputError: no run matches.
    """
    selected = list(kept)
    by_scene = {scene: _asked_keys(scene, _base_of(scene)) for scene in scenes}
    by_engine = {engine: [engine] for engine in engines}
    for what, asked in (("scene", by_scene), ("engine", by_engine)):
        keys = {run.folder: _keys(run) if what == "scene" else (run.record.engine,) for run in kept if asked}
        for name, wanted in asked.items():
            if not any(key in wanted for of_run in keys.values() for key in of_run):
                known = sorted({of_run[-1] for of_run in keys.values()})
                names = ", ".join(known) or "none, since the folder has no runs"
                raise InputError("runs", what, f'no run of "{name}"; allowed: {names}')
        any_of = {key for wanted in asked.values() for key in wanted}
        selected = [run for run in selected if not asked or not any_of.isdisjoint(keys[run.folder])]
    by_key: dict[str, list[str]] = {}
    for setting in settings:
        key, equals, value = setting.partition("=")
        if not equals:
            raise InputError(f"--set {setting}", "", "not of the form KEY=VALUE, such as 'striker.speed=2 m/s'")
        by_key.setdefault(key.strip(), []).append(value.strip())
    for key, values in by_key.items():
        selected = [run for run in selected if run.resolved and any(_has(run.resolved, key, value) for value in values)]
    if settings and not selected:
        allowed = "values of existing runs, as listed by beads runs"
        raise InputError(f"--set {' --set '.join(settings)}", "", f"matches no run; allowed: {allowed}")
    return selected


def _name_of(source: str) -> str:
    """Name of a scene, given by name or file."""
    return Path(source.removesuffix(".toml")).name


def _has(scene: Json, key: str, asked: str) -> bool:
    """True if the scene's value at a key equals or matches the value asked for."""
    value = look_up(scene, key)
    if fnmatchcase(setting_text(key, value), asked) or (asked and read_value(asked) == value):
        return True
    with suppress(ValueError, TypeError):
        return isclose(to_si(asked, unit_of(key)), value, rel_tol=ROUNDING)
    return False


def first_scene(*sources: str) -> Scene | None:
    """Scene of the first of some sources, names or paths as of ``read_scene``, that can be read; None if none can."""
    for source in sources:
        with suppress(InputError):
            return read_scene(source)
    return None


def _base_of(source: str) -> Json:
    """Scene of a shipped file, of a file in the present folder, or at a path, in SI units; empty if unreadable."""
    scene = first_scene(source, f"{source}.toml")
    return in_si(scene) if scene else {}


def _newest(kept: Iterable[EndedRun]) -> dict[tuple[str, str], EndedRun]:
    """Newest finished run by engine and key, as ``yade:fig4`` names it; runs of decks changed by hand have no name."""
    named = (run for run in kept if not (run.trouble or run.record.edits))
    return {(run.record.engine, key): run for run in named for key in _keys(run)}


def _newest_of(newest: dict[tuple[str, str], EndedRun], engine: str, keys: Iterable[str]) -> EndedRun | None:
    """Newest run of an engine with the first key that any run has."""
    return next((newest[engine, key] for key in keys if (engine, key) in newest), None)


def run_folder(name: str | Path, runs: Path = paths.RUNS) -> Path:
    """Run folder by its path, or by ``ENGINE:SCENE``: the newest finished run of the scene as its file is.

    If there is no such run or no such file, the newest run recorded as the scene is used, with a line on stderr.

    Raises:
        InputError: no such run.
    """
    engine, colon, source = str(name).partition(":")
    if not colon or Path(name).exists():
        return Path(name)
    scene, base, newest = _name_of(source), _base_of(source), _newest(kept_runs(runs))
    newest_run = _newest_of(newest, engine, _asked_keys(source, base))
    if newest_run is None:
        known = sorted({run.name for run in newest.values()})
        near = [run_name for run_name in known if run_name.startswith(f"{engine}:")]
        near = near or [run_name for run_name in known if run_name.endswith(f":{scene}")] or known
        allowed = ", ".join(near) or "a run folder; no run is done there"
        raise InputError(str(name), "", f"no such run in {paths.shown(runs)}; allowed: {allowed}")
    if differs := _difference(newest_run, base):
        why = f"{scene}.toml has not been run as it is" if base else differs
        which = f"differs by {differs}" if base else f"is the newest run recorded as {scene}"
        print(one_line(f"{name}: {why}; using {paths.shown(newest_run.folder)}, which ", which), file=sys.stderr)
    return newest_run.folder


def _difference(run: EndedRun, base: Json) -> str:
    """Settings that differ from the scene file, as text; ``run.record`` is ignored, since it changes no number."""
    if not base or not run.resolved:
        return "found no scene file of this name" if run.resolved else ""
    return ", ".join(f"{key}={value}" for key, value in settings_between(run.resolved, base).items() if key != RECORDED)


def print_runs(runs: Path, scenes: Sequence[str], engines: Sequence[str], settings: Sequence[str]) -> None:
    """Print one line for each run, the newest last, and the total size."""
    kept = kept_runs(runs)
    chosen, newest = select(kept, scenes, engines, settings), _newest(kept)
    bases = {source: _base_of(source) for source in {*scenes, *(run.record.scene_name for run in chosen)}}
    asked = {source: _asked_keys(source, base) for source, base in bases.items()}
    home, rows = Path(paths.shown(runs)), []  # following links takes long
    for run in chosen:
        engine, scene, keys = run.record.engine, run.record.scene_name, _keys(run)
        named = [source for source in (*scenes, scene) if _newest_of(newest, engine, asked[source]) == run]
        source = next(source for key in keys for source in scenes or [scene] if key in asked[source])
        differs = "" if keys[0] in asked[source] else _difference(run, bases[source])
        trouble = run.trouble.removeprefix(f"{run.record.status}: ")  # the status has a column
        row = (
            f"{engine}:{named[0]}" if named else str(home / run.folder.relative_to(runs)),
            scene,
            engine,
            time.strftime("%Y-%m-%d %H:%M", time.localtime(run.ended)),
            size_text(run.size),
            run.record.status,
            one_line("; ".join(filter(None, (differs, "deck changed by hand" * bool(run.record.edits), trouble)))),
        )
        rows.append(row)
    for line in text_table(rows):
        print(line)
    states = Counter(row[5] for row in rows)
    counts = ", ".join(f"{count} {state}" for state, count in sorted(states.items()))
    plural = "s" * (len(rows) != 1)
    print(f"{len(rows)} run{plural}{f' ({counts})' * bool(counts)}: {size_text(sum(run.size for run in chosen))}")
    if batches := batches_text(runs):
        print(batches)


def batches_text(runs: Path) -> str:
    """Number and size of the rows of batches, as text; empty if there are none."""
    file = runs / "batch.sqlite"
    return f"{paths.shown(file)}: rows of batches: {size_text(file.stat().st_size)}" if file.exists() else ""


def size_below(folder: Path) -> int:
    """Total size in bytes of all files below a folder; files removed meanwhile do not count."""
    size = 0
    for place, _, names in os.walk(folder):
        for name in names:
            with suppress(OSError):
                size += os.stat(os.path.join(place, name)).st_size  # noqa: PTH118, PTH116 - in a third of the time
    return size


def size_text(size: float) -> str:
    """Size in bytes as text, such as ``1.2 MB``."""
    power = 1 if size < 1e6 else 2 if size < 1e9 else 3
    return f"{size / 1000**power:,.{0 if power == 1 else 1}f} {('kB', 'MB', 'GB')[power - 1]}"
