"""Reads scene files and says in one line what is wrong with them."""

import tomllib
from collections.abc import Callable, Iterator
from difflib import get_close_matches
from pathlib import Path
from typing import Any, TypeVar

from pydantic import BaseModel, ValidationError

from drivers import paths
from drivers.errors import InputError
from drivers.sampling import steps_per_sample
from drivers.scene import RIGID, Bead, Material, Scene, SceneFile, Sensor
from drivers.units import NotAllowedError

Model = TypeVar("Model", bound=BaseModel)
NAME_RULE = "a name of letters, digits, '-', '_' and '.', beginning with a letter or digit"
MAX_VALUES = 200_000_000  # samples x contacts: 1.6 GB of doubles


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
        _lay_over(data, setting)
    library = read_toml(paths.MATERIALS)
    _complete_own_materials(data, library)
    file = validate(SceneFile, data, where)
    for complaint in _refused(file):
        raise InputError(where, *complaint)
    materials = _materials(file, library, where)
    every, time_step = steps_per_sample(file.run.sample_interval, file.run.time_step, where)
    samples = _whole_samples(file, where)
    scene = Scene.model_construct(
        **{key: getattr(file, key) for key in SceneFile.model_fields}
        | {
            "materials": materials,
            "run": file.run.model_copy(update={"time_step": time_step}),
            "name": path.stem,
            "steps_per_sample": every,
            "samples": samples,
        }
    )
    for complaint in _contradictions(scene):
        raise InputError(where, *complaint)
    return scene


def find_scene(source: str | Path) -> Path:
    """The path of a scene file, given by path or by the name of one in ``inputs/scenes``."""
    path = Path(source)
    if path.suffix != ".toml" and path.name == str(source) and not path.exists():
        path = paths.SCENES / f"{source}.toml"
        if not path.is_file():
            known = ", ".join(sorted(p.stem for p in paths.SCENES.glob("*.toml")))
            raise InputError(str(source), "", "no such scene", f"a path to a .toml file, or one of {known}")
    if path.suffix != ".toml":
        raise InputError(str(source), "", f'a file ending in "{path.suffix}"', "a scene file, ending in .toml")
    stem = path.stem
    if not stem[:1].isalnum() or not stem.isascii() or not all(c.isalnum() or c in "-_." for c in stem):
        raise InputError(str(source), "", f"the scene name {stem!r}", NAME_RULE)
    if len(stem) > 100:
        raise InputError(str(source), "", f"a scene name of {len(stem)} characters", "at most 100")
    return path


def read_toml(path: Path) -> dict[str, Any]:
    """The tables of a TOML file.

    Raises:
        InputError: it cannot be read, is no UTF-8 or no TOML.
    """
    where = paths.shown(path)
    try:
        return tomllib.loads(path.read_bytes().decode("utf-8"))
    except OSError as error:
        raise InputError(where, "", error.strerror or str(error), "a readable scene file") from error
    except UnicodeDecodeError as error:
        raise InputError(where, "", f"byte 0x{error.object[error.start]:02x} at {error.start}", "UTF-8 text") from error
    except (tomllib.TOMLDecodeError, RecursionError) as error:
        raise InputError(where, "", str(error) or "tables nested too deep", "TOML") from error


def validate(model: type[Model], data: object, where: str, prefix: str = "") -> Model:
    """``data`` as a ``model``; the first complaint becomes an InputError."""
    try:
        return model.model_validate(data)
    except ValidationError as failure:
        first = failure.errors(include_url=False)[0]
        more = failure.error_count() - 1
        path = [part for part in first["loc"] if part not in ("[key]", "float", "dict[str,float]")]
        key = prefix + ".".join(str(part) for part in path)
        found, allowed = _told(first, model, path)
        raise InputError(where, key, found, allowed + (f" (and {more} more to mend)" if more else "")) from None


def _told(error: Any, model: type[BaseModel], path: list[int | str]) -> tuple[str, str]:
    """What was found and what is allowed, in words, from one of pydantic's errors."""
    if error["type"] == "extra_forbidden":
        keys = _keys_at(model, path[:-1])
        close = get_close_matches(str(path[-1]), keys, 1)
        return "an unknown key", f"did you mean {close[0]}?" if close else ", ".join(keys)
    if error["type"] == "missing":
        return "nothing", "this key is needed"
    found = _short(error["input"])
    cause = error.get("ctx", {}).get("error")
    if isinstance(cause, NotAllowedError):
        return found, str(cause)
    expected: dict[str, Callable[[dict[str, Any]], str]] = {
        "int_type": lambda _: "a whole number",
        "float_type": lambda _: "a plain number",
        "string_type": lambda _: "text in quotes",
        "finite_number": lambda _: "a finite number",
        "model_type": lambda _: "a table",
        "dict_type": lambda _: "a table",
        "tuple_type": lambda _: "a list",
        "greater_than": lambda c: f"above {c['gt']:g}",
        "greater_than_equal": lambda c: f"{c['ge']:g} or more",
        "less_than": lambda c: f"below {c['lt']:g}",
        "less_than_equal": lambda c: f"at most {c['le']:g}",
        "literal_error": lambda c: str(c["expected"]),
        "string_pattern_mismatch": lambda _: "letters, digits, '-' and '_', beginning with a letter",
        "string_too_long": lambda c: f"at most {c['max_length']} characters",
    }
    describe = expected.get(error["type"])
    return found, describe(error.get("ctx", {})) if describe else str(error["msg"])


def _short(value: object) -> str:
    text = f'"{value}"' if isinstance(value, str) else repr(value)
    return text if len(text) <= 60 else text[:57] + "..."


def _keys_at(model: type[BaseModel], path: list[int | str]) -> list[str]:
    """The keys that a table may have, following ``path`` down the models."""
    for part in path:
        if isinstance(part, int) or part not in model.model_fields:
            continue  # an entry of a list, or the free name of a material: the same model goes on
        found = _models_in(model.model_fields[part].annotation)
        model = found[0] if found else model
    return sorted(model.model_fields)


def _models_in(annotation: Any) -> list[type[BaseModel]]:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return [annotation]
    return [found for part in getattr(annotation, "__args__", ()) for found in _models_in(part)]


def _lay_over(data: dict[str, Any], setting: str) -> None:
    """Sets one ``path=value`` in the tables of a scene file."""
    where = f"--set {setting}"
    path, equals, text = setting.partition("=")
    keys = path.strip().split(".")
    if not equals or not all(keys):
        raise InputError(where, "", "no path=value", "a key of the scene and its value, such as chain.count=60")
    here: Any = data
    for key in keys[:-1]:
        here = _step_into(here, key, where)
    last = keys[-1]
    if isinstance(here, list):
        here[_index(here, last, where)] = _value(text)
    elif not isinstance(here, dict):
        raise InputError(where, path, "a key below a plain value", "a key of a table")
    elif text.strip():
        here[last] = _value(text)
    else:
        here.pop(last, None)


def _step_into(here: Any, key: str, where: str) -> Any:
    if isinstance(here, list):
        return here[_index(here, key, where)]
    if isinstance(here, dict):
        return here.setdefault(key, {})
    raise InputError(where, key, "a key below a plain value", "a key of a table")


def _index(entries: list[Any], key: str, where: str) -> int:
    if not key.isdecimal() or int(key) >= len(entries):
        raise InputError(where, key, f"no such entry among {len(entries)}", "a place in the list, counted from 0")
    return int(key)


def _value(text: str) -> Any:
    try:
        return tomllib.loads(f"value = {text}")["value"]
    except tomllib.TOMLDecodeError:
        return text.strip()


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
            materials[name] = validate(Material, library[name], paths.shown(paths.MATERIALS), f"{name}.")
        elif name != RIGID or key != "wall.material":
            known = sorted({*library, *file.materials} | ({RIGID} if key == "wall.material" else set()))
            raise InputError(where, key, f'"{name}"', f"{', '.join(known)}, or a [materials.{name}] of the scene's own")
    return materials


def _whole_samples(file: SceneFile, where: str) -> int:
    run = file.run
    ratio = run.duration / run.sample_interval
    if ratio < 1 - 1e-9:
        raise InputError(
            where, "run.duration", f"{run.duration:g} s", f"at least one sample_interval ({run.sample_interval:g} s)"
        )
    if ratio * (file.chain.count + 1) > MAX_VALUES:
        allowed = f"at most {MAX_VALUES:,} samples times contacts: a longer interval or a shorter run"
        raise InputError(
            where, "run.sample_interval", f"{ratio:.3g} samples of {file.chain.count + 1} contacts", allowed
        )
    return int(ratio * (1 + 1e-12) + 1e-9) + 1


Complaint = tuple[str, str, str]


def _refused(file: SceneFile) -> Iterator[Complaint]:
    """What the scene contract knows and this version cannot run yet; and the choice of time_step or accuracy."""
    run, chain = file.run, file.chain
    if (run.time_step is None) == (run.accuracy is None):
        found = "neither time_step nor accuracy" if run.time_step is None else "both time_step and accuracy"
        yield "run", found, "exactly one of the two"
    if run.accuracy is not None:
        yield "run.accuracy", _short(run.accuracy), "not supported yet: give run.time_step instead"
    if chain.lateral_offset is not None:
        yield "chain.lateral_offset", f"{chain.lateral_offset:g} m", "not supported yet: chains are exactly straight"
    if file.contact.restitution < 1:
        yield "contact.restitution", f"{file.contact.restitution:g}", "not supported yet: 1 (no dissipation)"
    if file.sensor is not None:
        yield "sensor.time_constant", f"{file.sensor.time_constant:g} s", "not supported yet: leave [sensor] out"


def _contradictions(scene: Scene) -> Iterator[Complaint]:
    """Parts of the scene that do not go together."""
    chain, striker, wall, tube = scene.chain, scene.striker, scene.wall, scene.tube
    count = chain.count
    if "forces" not in scene.run.record:
        yield "run.record", _short(list(scene.run.record)), 'a list with "forces" in it'
    lists: dict[str, tuple[Sensor | Bead, ...]] = {"sensors": chain.sensors, "bead": chain.bead}
    for what, entries in lists.items():
        seen: set[int] = set()
        for i, entry in enumerate(entries):
            key = f"chain.{what}.{i}.from_wall"
            if entry.from_wall > count:
                yield (
                    key,
                    str(entry.from_wall),
                    f"1 to {count}, the chain's beads" if count else "none: the chain has no beads",
                )
            if entry.from_wall in seen:
                yield key, f"{entry.from_wall} twice", "each bead once"
            seen.add(entry.from_wall)
    weighed = {bead.from_wall for bead in chain.bead if bead.mass is not None}
    for i, sensor in enumerate(chain.sensors):
        if sensor.mass is not None and sensor.from_wall in weighed:
            yield (
                f"chain.sensors.{i}.mass",
                f"a mass for bead {sensor.from_wall} here and in chain.bead",
                "one of the two",
            )
    if count == 0:
        if striker is None or wall is None:
            yield "chain.count", "0", "1 or more, unless a striker meets a wall"
        if chain.precompression:
            yield "chain.precompression", f"{chain.precompression:g} N", "nothing: there is no top bead to press on"
    if striker is not None:
        yield from _striker_contradictions(scene)
    if count and chain.mass is None and scene.materials[chain.material].density is None:
        yield "chain.mass", "nothing", f"a mass, or a density in [materials.{chain.material}]"
    for i, bead in enumerate(chain.bead):
        unlike = bead.mass is None and (bead.material is not None or bead.diameter is not None)
        if unlike and scene.materials[bead.material or chain.material].density is None:
            yield (
                f"chain.bead.{i}.mass",
                "nothing",
                f"a mass, or a density in [materials.{bead.material or chain.material}]",
            )
    if chain.mass_scatter and chain.mass_scatter * 8 >= (chain.mass or float("inf")):
        yield "chain.mass_scatter", f"{chain.mass_scatter:g} kg", "less than an eighth of the bead's mass"
    if tube is not None:
        widest = max([chain.diameter, *(bead.diameter for bead in chain.bead if bead.diameter)])
        if count and tube.inner_diameter < widest:
            yield "tube.inner_diameter", f"{tube.inner_diameter:g} m", f"at least the beads' {widest:g} m"


def _striker_contradictions(scene: Scene) -> Iterator[Complaint]:
    striker = scene.striker
    assert striker is not None
    if striker.shape == "flat":
        if striker.diameter is not None:
            yield "striker.diameter", f"{striker.diameter:g} m", "nothing: a flat striker has no diameter"
        if striker.mass is None:
            yield "striker.mass", "nothing", "a mass: a flat striker has no volume to take it from"
        if scene.chain.count == 0:
            yield "striker.shape", '"flat"', '"sphere": a flat striker on a flat wall is no Hertz contact'
        return
    if striker.diameter is None:
        yield "striker.diameter", "nothing", "the diameter of the sphere"
    if striker.mass is None and scene.materials[striker.material].density is None:
        yield "striker.mass", "nothing", f"a mass, or a density in [materials.{striker.material}]"
