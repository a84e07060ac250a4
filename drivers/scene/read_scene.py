"""Reads scene files, with settings laid over them, and says in one line what is wrong with them."""

import tomllib
from functools import cache
from pathlib import Path
from typing import Any

from drivers.base import paths
from drivers.base.errors import InputError, refuse_any
from drivers.base.messages import keys_at, shorten, validate
from drivers.scene.model import (
    RIGID,
    Bead,
    Chain,
    Contact,
    Gauge,
    Material,
    Part,
    Run,
    Scene,
    SceneFile,
    Sensor,
    Striker,
    Tube,
    Wall,
)  # fmt: skip
from drivers.scene.scene_rules import choices, contradictions

NAME_RULE = "a name of letters, digits, '-', '_' and '.', beginning with a letter or digit"
WHOLE = 1e-9  # relative: a step written with ten digits still divides its interval
MAX_STEPS = 2**31 - 1  # LIGGGHTS counts no further
MAX_VALUES = 200_000_000  # samples x contacts: 1.6 GB of doubles
PARTS: dict[str, type[Part]] = {"striker": Striker, "wall": Wall, "tube": Tube, "contact": Contact, "sensor": Gauge}


def read_scene(source: str | Path, settings: tuple[str, ...] = ()) -> Scene:
    """The scene of a file, with ``settings`` such as ``chain.count=60`` laid over it.

    Args:
        source: path of a scene file, or the name of one in ``inputs/scenes``.
        settings: ``path=value`` pairs; the value is TOML, or plain text; an empty one leaves the key out.

    Raises:
        InputError: anything wrong with the file or the settings.
    """
    path = find_scene(source)
    where = paths.shown(path)
    data = read_toml(path)
    for setting in settings:
        lay_over(data, setting)
    if settings:
        where += f" with --set {shorten(' '.join(settings))}"
    return make_scene(data, read_toml(paths.MATERIALS), path.stem, where, path.parent)


def make_scene(data: dict[str, Any], library: dict[str, Any], name: str, where: str, folder: Path = Path()) -> Scene:
    """The scene of a file's tables.

    Args:
        data: the tables; materials of the scene's own are completed in place.
        library: the tables of ``inputs/materials.toml``.
        name: the scene's name.
        where: the scene as messages name it.
        folder: from which paths in it are seen.

    Raises:
        InputError: anything wrong with it.
    """
    _complete_own_materials(data, library)
    file = validate(SceneFile, data, where)
    refuse_any(where, choices(file))
    materials = _materials(file, library, where)
    every, time_step = _steps_per_sample(file.run.sample_interval, file.run.time_step, where)
    samples = _whole_samples(file, where)
    scene = Scene.model_construct(
        **{key: getattr(file, key) for key in SceneFile.model_fields}
        | {
            "materials": materials,
            "run": file.run.model_copy(update={"time_step": time_step}),
            "name": name,
            "file": where,
            "folder": folder,
            "steps_per_sample": every,
            "samples": samples,
        }
    )
    if scene.steps > MAX_STEPS:
        found = f"{time_step:g} s, which makes {scene.steps:.3g} steps"
        raise InputError(where, "run.time_step", found, f"at most {MAX_STEPS:.3g} steps")
    refuse_any(where, contradictions(scene))
    return scene


def stored_scene(stored: dict[str, Any]) -> Scene:
    """The scene of ``run.json``: in SI units and checked before it ran, so taken as it is.

    Raises:
        TypeError, KeyError, AttributeError: it is no such scene.
    """
    chain = dict(stored["chain"])
    chain["sensors"] = tuple(Sensor.model_construct(**sensor) for sensor in chain.get("sensors", ()))
    chain["bead"] = tuple(Bead.model_construct(**bead) for bead in chain.get("bead", ()))
    run = stored["run"]
    tables: dict[str, Any] = {
        name: part.model_construct(**stored[name]) for name, part in PARTS.items() if name in stored
    }
    tables |= {
        "chain": Chain.model_construct(**chain),
        "run": Run.model_construct(**(run | {"record": tuple(run["record"])})),
        "materials": {name: Material.model_construct(**own) for name, own in stored["materials"].items()},
    }
    kept = {name: value for name, value in stored.items() if name != "units"}
    return Scene.model_construct(**(kept | tables | {"file": stored["name"]}))


def lay_over(data: dict[str, Any], setting: str) -> None:
    """Sets one ``path=value`` in the tables of a scene file.

    Raises:
        InputError: there is no such place.
    """
    where = f"--set {setting}"
    path, equals, text = setting.partition("=")
    if not equals or not all(path.strip().split(".")):
        raise InputError(where, "", "no path=value", "a key of the scene and its value, such as chain.count=60")
    set_value(data, path.strip(), read_value(text), where)


def set_value(data: dict[str, Any], path: str, value: Any, where: str) -> None:
    """Sets the value at a path such as ``chain.sensors.0.mass``; an empty text leaves the key out.

    Raises:
        InputError: there is no such place.
    """
    *keys, last = path.split(".")
    here: Any = data
    for key in keys:
        here = here.setdefault(key, {}) if isinstance(here, dict) else here[_place_in(here, key, where, key)]
    if not isinstance(here, dict):
        here[_place_in(here, last, where, path)] = value
    elif value != "" or not (last in here or keys == ["materials"] or last in keys_at(SceneFile, keys)):
        here[last] = value  # an unknown key is left to validation
    else:
        here.pop(last, None)


def _place_in(entries: Any, key: str, where: str, path: str) -> int:
    if not isinstance(entries, list):
        raise InputError(where, path, "a key below a plain value", "a key of a table")
    if not (key.isascii() and key.isdecimal() and len(key) < 9) or int(key) >= len(entries):
        raise InputError(where, key, f"no such entry among {len(entries)}", "a place in the list, counted from 0")
    return int(key)


def read_value(text: str) -> Any:
    """A value as TOML has it, or else plain text."""
    try:
        table = tomllib.loads(f"value = {text}")
    except (ValueError, RecursionError):
        table = {}
    return table["value"] if list(table) == ["value"] else text.strip()


def find_scene(source: str | Path) -> Path:
    """The path of a scene file, given by path or by the name of one in ``inputs/scenes``."""
    return find_input(source, paths.SCENES, "scene")


def find_input(source: str | Path, home: Path, what: str) -> Path:
    """The path of a TOML file, given by path or by the name of one in its ``home``.

    Raises:
        InputError: there is no such name, or the file's name is no name.
    """
    path = Path(source)
    if path.suffix != ".toml" and path.name == str(source) and not path.is_file():
        path = home / f"{source}.toml"
        if not path.is_file():
            known = ", ".join(sorted(p.stem for p in home.glob("*.toml")))
            raise InputError(str(source), "", f"no such {what}", f"a path to a .toml file, or one of {known}")
    if path.suffix != ".toml":
        raise InputError(str(source), "", f'a file ending in "{path.suffix}"', f"a {what} file, ending in .toml")
    stem = path.stem
    if not stem[:1].isalnum() or not stem.isascii() or not all(c.isalnum() or c in "-_." for c in stem):
        raise InputError(str(source), "", f"the {what} name {stem!r}", NAME_RULE)
    if len(stem) > 100:
        raise InputError(str(source), "", f"a {what} name of {len(stem)} characters", "at most 100")
    return path


def read_toml(path: Path) -> dict[str, Any]:
    """The tables of a TOML file.

    Raises:
        InputError: it cannot be read, is no UTF-8 or no TOML.
    """
    where = paths.shown(path)
    if path.exists() and not path.is_file():
        raise InputError(where, "", "a directory" if path.is_dir() else "no regular file", "a readable TOML file")
    try:
        return tomllib.loads(path.read_bytes().decode("utf-8"))
    except OSError as error:
        raise InputError(where, "", error.strerror or str(error), "a readable TOML file") from error
    except UnicodeDecodeError as error:
        raise InputError(where, "", f"byte 0x{error.object[error.start]:02x} at {error.start}", "UTF-8 text") from error
    except (ValueError, RecursionError) as error:  # TOMLDecodeError, and numbers too long to read
        raise InputError(where, "", str(error) or "tables nested too deep", "TOML") from error


def _complete_own_materials(data: dict[str, Any], library: dict[str, Any]) -> None:
    """Fills what the scene's own materials leave out from the library's material of that name."""
    own = data.get("materials")
    if not isinstance(own, dict):
        return  # validation says so
    for name, table in own.items():
        if isinstance(table, dict) and name in library:
            own[name] = {key: value for key, value in library[name].items() if key != "source"} | table


def _materials(file: SceneFile, library: dict[str, Any], where: str) -> dict[str, Material]:
    """The materials that the scene names, its own before the library's."""
    named = {"chain.material": file.chain.material}
    named |= {f"chain.bead.{i}.material": bead.material for i, bead in enumerate(file.chain.bead) if bead.material}
    for part in ("striker", "wall", "tube"):
        table = getattr(file, part)
        if table is not None:
            named[f"{part}.material"] = table.material
    materials = {}
    for key, name in named.items():
        if name in file.materials:
            materials[name] = file.materials[name]
        elif name in library:
            materials[name] = validate(Material, library[name], _shown(paths.MATERIALS, Path.cwd()), f"{name}.")
        elif name != RIGID or key != "wall.material":
            known = sorted({*library, *file.materials} | ({RIGID} if key == "wall.material" else set()))
            raise InputError(where, key, f'"{name}"', f"{', '.join(known)}, or a [materials.{name}] of the scene's own")
    return materials


@cache
def _shown(path: Path, _: Path) -> str:
    """A path as a person would type it in a folder: looked up once, since links on the way are followed."""
    return paths.shown(path)


def _steps_per_sample(interval_s: float, step_s: float | None, where: str) -> tuple[int, float]:
    """Steps from one sample to the next, and the time step as the exact part of the interval.

    Without a time step, which is then to be chosen, the interval itself.

    Raises:
        InputError: the step does not divide the interval; the nearest that does is named.
    """
    if step_s is None:
        return 1, interval_s
    ratio = interval_s / step_s
    every = max(1, round(ratio))
    if abs(ratio - every) > WHOLE * every:
        found = f"{step_s:g} s, which does not divide run.sample_interval = {interval_s:g} s"
        raise InputError(where, "run.time_step", found, f'for instance "{interval_s / every * 1e6:.12g} us"')
    return every, step_s if step_s * every == interval_s else interval_s / every


def _whole_samples(file: SceneFile, where: str) -> int:
    run = file.run
    ratio = run.duration / run.sample_interval
    if ratio < 1 - 1e-9:
        allowed = f"at least one sample_interval ({run.sample_interval:g} s)"
        raise InputError(where, "run.duration", f"{run.duration:g} s", allowed)
    contacts = file.chain.count + 1
    if ratio * contacts > MAX_VALUES:
        allowed = f"at most {MAX_VALUES:,} samples times contacts: a longer interval or a shorter run"
        raise InputError(where, "run.sample_interval", f"{ratio:.3g} samples of {contacts} contacts", allowed)
    return int(ratio * (1 + 1e-12) + 1e-9) + 1
