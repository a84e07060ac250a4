"""Reading of scene files with settings, and of files of drives; each error message is one line."""

import re
import tomllib
from collections.abc import Iterable
from functools import cache
from math import nan
from pathlib import Path
from typing import Any

from drivers.base import paths, units
from drivers.base.errors import InputError, refuse_any
from drivers.base.files import read_file
from drivers.base.messages import model_at, shorten, validate
from drivers.scene.model import RIGID, Material, Scene
from drivers.scene.rules import named_materials, problems_of

NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_.-]{0,99}\.toml")
NAME_RULE = "at most 100 letters, digits, '-', '_' and '.', beginning with a letter or digit, then .toml"
LONG_KEY = re.compile(r"""(?:[\w"'-]{1,99}+[ \t]*+\.[ \t]*+){99}""")  # reading takes the square of the number of parts
# files of drives
HEADING = re.compile(r"\s*time_([^,]*),\s*(force|displacement)_([^,]*)")
SI = {"force": "N", "displacement": "m"}
LEAST_S, LARGEST = 1e-300, 1e9  # in SI units
HEADINGS = "two headings with units, such as time_us,force_mN or time_us,displacement_nm"
MAX_POINTS = 100_000
DERIVED = ("units", "name", "steps_per_sample", "samples")  # of a stored scene, beside the keys of files


def read_scene(source: str | Path, settings: tuple[str, ...] = ()) -> Scene:
    """Scene read from a file, with ``settings`` such as ``chain.count=60`` applied.

    Args:
        source: path of a scene file, or name of a scene in ``inputs/scenes``.
        settings: ``KEY=VALUE`` texts with the value in TOML or as plain text; an empty value removes the key.

    Raises:
        InputError: the file or a setting is wrong.
    """
    path = find_scene(source)
    where = paths.shown(path)
    data = read_toml(path)
    apply_settings(data, settings)
    if settings:
        where += f" with --set {shorten(' '.join(settings))}"
    return make_scene(data, path.stem, where, path.parent)


def make_scene(data: dict[str, Any], name: str, where: str, folder: Path = Path(), context: str | None = None) -> Scene:
    """Scene made from the tables of a scene file.

    Args:
        data: tables of the file; constants missing from ``materials`` are filled in, in place.
        name: name of the scene.
        where: file name used in messages.
        folder: folder to which paths in the scene are relative.
        context: ``units.SI`` if numbers may be without units, in SI units.

    Raises:
        InputError: a table is wrong.
    """
    _complete_own_materials(data)
    scene = validate(Scene, data, where, context=context)
    drive, run = scene.drive, scene.run
    if drive is not None and drive.file is not None:
        drive = drive.model_copy(update=_points(folder, drive.file, where))
    materials = library_materials() | scene.materials
    read = {"name": name, "file": where, "folder": folder, "drive": drive, "materials": materials}
    scene = scene.model_copy(update=read)
    refuse_any(where, problems_of(scene))
    used = {name: materials[name] for name in named_materials(scene).values() if name != RIGID}
    time_step = units.divided(run.sample_interval, scene.steps_per_sample)  # a decimal fraction of the interval
    return scene.model_copy(update={"materials": used, "run": run.model_copy(update={"time_step": time_step})})


def stored_scene(stored: dict[str, Any]) -> Scene:
    """Scene stored in the record of a run, in SI units; keys of other versions are ignored.

    Raises:
        ValueError, TypeError, AttributeError: the record contains no complete scene.
    """
    return Scene.model_validate(stored | {"file": stored.get("name")}, extra="ignore", context=units.SI)


def changed_scene(stored: dict[str, Any], settings: tuple[str, ...], where: str) -> Scene:
    """Scene as in ``stored_scene`` with settings applied.

    Raises:
        InputError: a setting is wrong.
    """
    data = {key: value for key, value in stored.items() if key not in DERIVED}
    apply_settings(data, settings)
    return make_scene(data, stored["name"], f"{where} with --set {shorten(' '.join(settings))}", context=units.SI)


def apply_settings(data: dict[str, Any], settings: Iterable[str]) -> None:
    """Apply settings, each ``KEY=VALUE``, to the tables of a scene file.

    Raises:
        InputError: a setting has another form, or its key does not exist.
    """
    for setting in settings:
        where = f"--set {setting}"
        path, equals, text = setting.partition("=")
        if not equals or not all(path.strip().split(".")):
            raise InputError(where, "", "not of the form KEY=VALUE; give a key and a value, such as chain.count=60")
        set_value(data, path.strip(), read_value(text), where)


def set_value(data: dict[str, Any], path: str, value: Any, where: str) -> None:
    """Set the value of a key such as ``chain.sensors.0.mass``; an empty text removes the key.

    Raises:
        InputError: the key does not exist.
    """
    *keys, last = path.split(".")
    here: Any = data
    for key in keys:
        here = here.setdefault(key, {}) if isinstance(here, dict) else here[_index(here, key, where, path)]
    if not isinstance(here, dict):
        here[_index(here, last, where, path)] = value
    elif value != "" or not (last in here or keys == ["materials"] or last in model_at(Scene, keys).model_fields):
        here[last] = value  # validation reports unknown keys
    else:
        here.pop(last, None)


def _index(entries: Any, key: str, where: str, path: str) -> int:
    """Index in a list, from the text of a key; ``path`` is the whole key, for the message."""
    if not isinstance(entries, list):
        raise InputError(where, path, "unknown key; only tables and lists have keys")
    if not (key.isascii() and key.isdecimal() and len(key) < 9) or int(key) >= len(entries):
        raise InputError(where, path, f"unknown index; the list has {len(entries)} entries, counted from 0")
    return int(key)


def read_value(text: str) -> Any:
    """Value of a TOML text, or the text itself if it is not valid TOML."""
    try:
        table = tomllib.loads(f"value = {text}")
    except (ValueError, RecursionError):
        table = {}
    return table["value"] if list(table) == ["value"] else text.strip()


def find_scene(source: str | Path) -> Path:
    """Path of a scene file, from a path or a name in ``inputs/scenes``."""
    return find_input(source, paths.SCENES, "scene")


def find_input(source: str | Path, home: Path, what: str) -> Path:
    """Path of a TOML file, from a path or a name in the folder ``home``.

    Args:
        source: path or name.
        home: folder of the named files.
        what: kind of file, for messages: scene or study.

    Raises:
        InputError: the name does not exist, or the file name is not allowed.
    """
    path = Path(source)
    if path.suffix != ".toml" and path.name == str(source) and not path.is_file():
        path = home / f"{source}.toml"
        if not path.is_file():
            known = ", ".join(sorted(p.stem for p in home.glob("*.toml")))
            raise InputError(str(source), "", f"{what} not found; give the path of a .toml file, or one of {known}")
    if not NAME.fullmatch(path.name):
        raise InputError(str(source), "", f"a {what} file named {shorten(path.name)}", NAME_RULE)
    return path


def read_toml(path: Path) -> dict[str, Any]:
    """Tables of a TOML file.

    Raises:
        InputError: the file cannot be read, or does not contain TOML in UTF-8.
    """
    where = paths.shown(path)
    try:
        text = read_file(path, "a TOML file").decode("utf-8")
        if LONG_KEY.search(text):
            raise ValueError("a key of a hundred parts")
        return tomllib.loads(text)
    except FileNotFoundError as error:
        raise InputError(where, "", "file not found") from error
    except UnicodeDecodeError as error:
        raise InputError(where, "", f"byte 0x{error.object[error.start]:02x} at {error.start}", "UTF-8 text") from error
    except (ValueError, RecursionError) as error:  # TOMLDecodeError, and numbers too long to read
        raise InputError(where, "", f"not valid TOML: {error or 'too many nested tables'}") from error


@cache
def library() -> dict[str, Any]:
    """Tables of ``inputs/materials.toml``."""
    return read_toml(paths.MATERIALS)


@cache
def library_materials() -> dict[str, Material]:
    """Materials of ``inputs/materials.toml``."""
    return {name: validate(Material, table, paths.MATERIALS, f"{name}.") for name, table in library().items()}


def _complete_own_materials(data: dict[str, Any]) -> None:
    """Fill in constants missing from the scene's materials, from library materials of the same name."""
    materials = data.get("materials")
    if not isinstance(materials, dict):
        return  # reported by validation
    for name, table in materials.items():
        if isinstance(table, dict) and name in library():
            materials[name] = {key: value for key, value in library()[name].items() if key != "source"} | table


def _points(folder: Path, name: str, where: str) -> dict[str, tuple[float, ...]]:
    """Times and values of the file of a drive by key of ``DriveTable``, in SI units; lines with # are comments.

    Args:
        folder: folder of the scene file.
        name: path of the file relative to the folder.
        where: scene as messages name it.

    Raises:
        InputError: the file is missing or has no such table of numbers, times do not increase from 0 on, or a first
            displacement is not 0.
    """
    path = folder / name
    shown = paths.shown(path)
    try:
        lines = enumerate(read_file(path, "a CSV file").decode("utf-8-sig").splitlines(), 1)
    except FileNotFoundError as error:
        found, allowed = f"no such file: {shown}", f"a CSV file, relative to {paths.shown(folder)}"
        raise InputError(where, "drive.file", found, allowed) from error
    except ValueError as error:
        raise InputError(shown, "", f"a file that cannot be read: {error}", "CSV text in UTF-8") from error
    (first, heading), *rows = [row for row in lines if row[1].strip() and not row[1].startswith("#")] or [(1, "")]
    match = HEADING.fullmatch(heading)
    try:
        time_unit, kind, unit = match.groups() if match else ("", "force", "")
        factors = units.to_si(f"1 {time_unit}", "s"), units.to_si(f"1 {unit}", SI[kind])
    except ValueError as error:
        raise InputError(shown, f"line {first}", shorten(heading), HEADINGS) from error
    if not 2 <= len(rows) <= MAX_POINTS:
        raise InputError(shown, "", f"{len(rows)} rows of numbers", f"2 to {MAX_POINTS:,} rows")
    points, last = list[tuple[float, float]](), -LEAST_S
    for n, line in rows:
        try:
            time, value = (float(cell) * factor for cell, factor in zip(line.split(","), factors, strict=True))
        except ValueError:
            time = value = nan
        if not (last < time < LARGEST and abs(value) < LARGEST):
            raise InputError(shown, f"line {n}", shorten(line), "two numbers, times that increase from 0")
        points.append((time, value))
        last = time
    if kind == "displacement" and points[0][1] != 0:
        raise InputError(shown, kind, f"{points[0][1]:g} m first", "0 first, the displacement at time 0")
    times, values = zip(*points, strict=True)
    return {"time_s": times, f"{kind}_{SI[kind]}": values}
