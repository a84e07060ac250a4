"""Rows of tables of keys, from the models of input files: key, values, default, meaning."""

import json
from collections.abc import Iterator, Sequence
from typing import Any, Literal, get_args, get_origin

from pydantic import BaseModel
from pydantic.fields import FieldInfo

from drivers.base import units
from drivers.base.messages import parts_of

WORDS = {bool: "true or false", str: "text", tuple: "list", dict: "table"}
ENDS = ("ge", "le", "lt")


def key_rows(model: type[BaseModel], prefix: str = "") -> Iterator[tuple[str, ...]]:
    """Row of each key of a model, and after the key of a table the rows of its own keys, with dots between names."""
    for name, field in model.model_fields.items():
        key, annotation = f"{prefix}{field.alias or name}", parts_of(field.annotation)
        parts = [field, *field.metadata, *annotation]
        meaning = next((part.description for part in parts if isinstance(part, FieldInfo) and part.description), "")
        yield key, _values(parts), _default(field), meaning
        for inner in filter(_is_model, annotation):
            yield from key_rows(inner, f"{key}.NAME." if dict in _origins(annotation) else f"{key}.")


def _is_model(part: object) -> bool:
    return isinstance(part, type) and issubclass(part, BaseModel)


def _origins(parts: Sequence[Any]) -> list[Any]:
    return [get_origin(part) or part for part in parts]


def _default(field: FieldInfo) -> str:
    """TOML text of a default; empty if there is none."""
    if field.is_required():
        return "required"
    value = field.get_default(call_default_factory=True)
    if value is None or isinstance(value, BaseModel) or value in ("", (), {}):
        return ""
    return _number(value) if isinstance(value, float) else json.dumps(value)


def _values(parts: Sequence[Any]) -> str:
    """Range, choices or type of a key, from the parts of its annotation."""
    origins = _origins(parts)
    if quantity := next((part for part in parts if isinstance(part, units.InUnit)), None):
        return f"{_number(quantity.least)}..{_number(quantity.most)} {quantity.unit}"
    if Literal in origins:
        choices = ", ".join(f'"{choice}"' for choice in get_args(parts[origins.index(Literal)]))
        return f"list of {choices}" if tuple in origins else choices
    if any(map(_is_model, parts)):
        return "list of tables" if tuple in origins else "table"
    kinds = [kind for kind in origins if isinstance(kind, type) and kind in (*WORDS, int, float)]
    last = next((place for place, kind in enumerate(kinds) if kind in (tuple, dict)), len(kinds))  # then its members
    return " or ".join(dict.fromkeys(WORDS.get(kind) or _range(parts) for kind in kinds[: last + 1]))


def _range(parts: Sequence[Any]) -> str:
    """Range of a number."""
    limits = [limit for part in parts for limit in (part, *getattr(part, "metadata", ()))]
    ends = {end: _number(getattr(limit, end)) for limit in limits for end in ENDS if hasattr(limit, end)}
    if "le" in ends or "lt" in ends:
        return f"{ends['ge']}..{ends['le']}" if "le" in ends else f"{ends['ge']} to below {ends['lt']}"
    return f"{ends['ge']} or more" if "ge" in ends else "number"


def _number(number: float) -> str:
    """Short text of a number that TOML can read, such as 1e-9."""
    return f"{number:g}".replace("e+0", "e").replace("e+", "e").replace("e-0", "e-")
