"""Keys of scenes: their units and values, and differences between scenes as settings of ``--set``."""

import json
from collections.abc import Iterator, Mapping, Sequence
from functools import cache
from typing import Any

from pydantic import BaseModel

from drivers.base import units
from drivers.base.messages import model_at, parts_of
from drivers.scene.model import Scene
from drivers.scene.read_scene import DERIVED, library_materials

FREE_TEXT = ("source",)


def settings_between(scene: dict[str, Any], base: dict[str, Any]) -> dict[str, str]:
    """Settings that change the scene ``base`` to ``scene``, by key; an empty text removes the key.

    Both scenes are in SI units, as given by ``Scene.model_dump(mode="json", exclude_none=True)``.
    """
    known = {name: material.model_dump(exclude_none=True) for name, material in library_materials().items()}
    known |= base.get("materials", {})
    base = base | {"materials": {name: known.get(name) for name in scene.get("materials", {})}}
    pair = unplanned(base), unplanned(scene)
    return {key: setting_text(key, value) for key, _, value in differences(*pair) if key != "title"}


def unplanned(scene: dict[str, Any]) -> dict[str, Any]:
    """Scene without its time step if the step was planned for an accuracy."""
    if "accuracy" not in scene["run"]:
        return scene
    return scene | {"run": {key: value for key, value in scene["run"].items() if key != "time_step"}}


def differences(first: Any, second: Any, path: str = "") -> Iterator[tuple[str, Any, Any]]:
    """Keys whose values differ between two scenes, with both values; a table missing in one scene is one key."""
    if isinstance(first, dict) and isinstance(second, dict):
        for key in dict.fromkeys([*first, *second]):
            if key not in (FREE_TEXT if path else DERIVED) or isinstance(first.get(key), dict):  # a material "source"
                yield from differences(first.get(key), second.get(key), f"{path}.{key}" if path else key)
    elif isinstance(first, list) and isinstance(second, list) and len(first) == len(second):
        for index, values in enumerate(zip(first, second, strict=True)):
            yield from differences(*values, f"{path}.{index}")
    elif first != second:
        yield path, first, second


def setting_text(key: str, value: Any) -> str:
    """Text of a value in a setting; numbers are given in SI units, and free text in tables is left out."""
    if value is None or isinstance(value, str):
        return value or ""
    return _toml(key, value).strip('"')


def setting_texts(settings: Mapping[str, Any] | Sequence[str]) -> tuple[str, ...]:
    """``KEY=VALUE`` texts of settings by key, or such texts; numbers are given in SI units, None removes the key."""
    if not isinstance(settings, Mapping):
        return tuple(settings)
    return tuple(f"{key}={setting_text(key, value)}" for key, value in settings.items())


def _toml(key: str, value: Any) -> str:
    if isinstance(value, dict):
        entries = (f"{name}={_toml(f'{key}.{name}', entry)}" for name, entry in value.items() if name not in FREE_TEXT)
        return f"{{{', '.join(entries)}}}"
    if isinstance(value, list):
        return f"[{', '.join(_toml(f'{key}.{index}', entry) for index, entry in enumerate(value))}]"
    number = isinstance(value, int | float) and not isinstance(value, bool)
    return json.dumps(units.quantity(float(value), unit) if number and (unit := unit_of(key)) else value)


@cache
def unit_of(key: str) -> str:
    """SI unit of a scene's key; empty if it has none."""
    *path, last = key.split(".")
    field = model_at(Scene, path).model_fields.get(last)
    parts = [*field.metadata, *parts_of(field.annotation)] if field else []
    return next((part.unit for part in parts if isinstance(part, units.InUnit)), "")


def look_up(tables: Any, key: str) -> Any:
    """Value of a key in the tables of a file or in a scene; None if missing."""
    for part in key.split("."):
        if isinstance(tables, BaseModel):
            tables = dict(tables)
        elif isinstance(tables, list | tuple):
            tables = {str(index): entry for index, entry in enumerate(tables)}
        tables = tables.get(part) if isinstance(tables, dict) else None
    return tables
