"""Settings by which one scene differs from another, as ``--set`` takes them, with units as people write them."""

import json
from collections.abc import Iterator
from functools import cache
from typing import Any, get_args

from pydantic import BaseModel

from drivers.base import paths, units
from drivers.scene.model import Material, SceneFile
from drivers.scene.read_scene import read_toml

DERIVED = ("units", "name", "steps_per_sample", "samples")  # no keys of a scene file
FREE_TEXT = ("source",)
STEP = "run.time_step"


def settings_between(scene: dict[str, Any], base: dict[str, Any]) -> dict[str, str]:
    """Settings that turn one scene into another, by key; an empty text leaves the key out.

    Args:
        scene: in SI units, as ``Scene.model_dump(mode="json", exclude_none=True)`` gives it.
        base: another, such as that of the scene file.
    """
    own = scene.get("materials", {})
    base = base | {"materials": {name: base.get("materials", {}).get(name) or _library().get(name) for name in own}}
    changed = {key: value for key, _, value in differences(_as_asked(base), _as_asked(scene)) if key != "title"}
    if isinstance(step := changed.get(STEP), float):  # stored as the exact part of the sample interval
        changed[STEP] = float(f"{step:.12g}")
    return {key: setting_text(key, value) for key, value in changed.items()}


def _as_asked(scene: dict[str, Any]) -> dict[str, Any]:
    """A scene without the time step, where that was chosen for its accuracy."""
    if "accuracy" not in scene["run"]:
        return scene
    return scene | {"run": {key: value for key, value in scene["run"].items() if key != "time_step"}}


@cache
def _library() -> dict[str, Any]:
    """The shipped materials in SI units."""
    materials = read_toml(paths.MATERIALS)
    return {name: Material.model_validate(each).model_dump(exclude_none=True) for name, each in materials.items()}


def differences(one: Any, other: Any, path: str = "") -> Iterator[tuple[str, Any, Any]]:
    """Keys in which scenes differ with both values; of what one of both lacks as a whole: one line."""
    if isinstance(one, dict) and isinstance(other, dict):
        for key in dict.fromkeys([*one, *other]):
            if key not in (FREE_TEXT if path else DERIVED):
                yield from differences(one.get(key), other.get(key), f"{path}.{key}" if path else key)
    elif isinstance(one, list) and isinstance(other, list) and len(one) == len(other):
        for place, values in enumerate(zip(one, other, strict=True)):
            yield from differences(*values, f"{path}.{place}")
    elif one != other:
        yield path, one, other


def setting_text(key: str, value: Any) -> str:
    """A value in SI units as it stands after the ``=`` of a setting."""
    if value is None or isinstance(value, str):
        return value or ""
    unit = unit_of(key)
    return units.quantity(value, unit) if unit and isinstance(value, float) else _toml(key, value)


def _toml(key: str, value: Any) -> str:
    if isinstance(value, dict):
        table = {name: each for name, each in value.items() if name not in FREE_TEXT}
        return "{" + ", ".join(f"{name}={_toml(f'{key}.{name}', each)}" for name, each in table.items()) + "}"
    if isinstance(value, list):
        return "[" + ", ".join(_toml(f"{key}.{place}", each) for place, each in enumerate(value)) + "]"
    return json.dumps(units.quantity(value, unit) if isinstance(value, float) and (unit := unit_of(key)) else value)


@cache
def unit_of(key: str) -> str:
    """The SI unit of the quantity at a scene's key; empty where it has none."""
    model: Any = SceneFile
    unit = ""
    for part in key.split("."):
        field = model.model_fields.get(part) if model else None
        unit = ""
        if field is not None:  # else a place in a list, or the free name of a material: the same model goes on
            parts = [*field.metadata, *_parts_of(field.annotation)]
            unit = next((each.unit for each in parts if isinstance(each, units.InUnit)), "")
            model = next((each for each in parts if isinstance(each, type) and issubclass(each, BaseModel)), None)
    return unit


def _parts_of(annotation: Any) -> list[Any]:
    """An annotation with its metadata, and those of all that it is made of."""
    return [annotation, *(part for each in get_args(annotation) for part in _parts_of(each))]


def look_up(tables: Any, key: str) -> Any:
    """What stands at a key of a file's tables, or of a scene; None where there is nothing."""
    for part in key.split("."):
        if isinstance(tables, dict):
            tables = tables.get(part)
        elif isinstance(tables, (list, tuple)):
            known = part.isascii() and part.isdecimal() and int(part) < len(tables)
            tables = tables[int(part)] if known else None
        else:
            tables = getattr(tables, part, None) if isinstance(tables, BaseModel) else None
    return tables
