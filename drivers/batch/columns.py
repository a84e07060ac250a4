"""Columns of a study's table: the swept values as the scenes have them, in SI units that the names tell."""

import json
import re
from typing import Any

from pydantic import BaseModel

from drivers.base.units import InUnit
from drivers.scene.model import Scene, SceneFile


def column_name(name: str, key: str) -> str:
    """A column's name with its unit, such as ``striker.speed_m_s``."""
    unit = unit_of(key)
    return f"{name}_{re.sub(r'[/*]', '_', unit.replace('^', ''))}" if unit else name


def unit_of(key: str) -> str:
    """The SI unit of the quantity at a scene's key; empty where it has none."""
    return _unit_at(SceneFile, key.split("."))


def value_at(scene: Scene, key: str) -> Any:
    """What a scene has at a key, in SI units; None where it has nothing there."""
    here: Any = scene
    for part in key.split("."):
        if isinstance(here, dict):
            here = here.get(part)
        elif isinstance(here, tuple):
            here = here[int(part)] if part.isdecimal() and int(part) < len(here) else None
        else:
            here = getattr(here, part, None)
    if isinstance(here, BaseModel):
        return here.model_dump_json(exclude_none=True, exclude_defaults=True)
    if isinstance(here, (tuple, dict)):
        return json.dumps(here, default=lambda part: part.model_dump(exclude_none=True, exclude_defaults=True))
    return here


def _unit_at(model: Any, path: list[str]) -> str:
    """The unit of the quantity at a path; empty where it has none."""
    for place, part in enumerate(path):
        field = model.model_fields.get(part)
        if field is None:
            continue  # a place in a list, or the free name of a material: the same model goes on
        if place == len(path) - 1:
            units = [
                entry.unit for entry in (*field.metadata, *_metadata(field.annotation)) if isinstance(entry, InUnit)
            ]
            return units[0] if units else ""
        models = [
            found for found in _parts(field.annotation) if isinstance(found, type) and issubclass(found, BaseModel)
        ]
        if not models:
            return ""
        model = models[0]
    return ""


def _parts(annotation: Any) -> list[Any]:
    """An annotation and all that it is made of."""
    return [annotation, *(part for inner in getattr(annotation, "__args__", ()) for part in _parts(inner))]


def _metadata(annotation: Any) -> list[Any]:
    return [entry for part in _parts(annotation) for entry in getattr(part, "__metadata__", ())]
