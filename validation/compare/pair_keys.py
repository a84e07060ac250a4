"""Which keys of two runs' scenes differ."""

from collections.abc import Iterator
from typing import Any

from drivers.batch.columns import unit_of

DERIVED = ("units", "name", "steps_per_sample", "samples")  # no keys of a scene file
FREE_TEXT = ("source",)


def different_keys(one: dict[str, Any], other: dict[str, Any]) -> list[str]:
    """A line for each key that differs, such as ``run.time_step: 1e-07 s against 1e-06 s``.

    Args:
        one: the scene of a run record, in SI units.
        other: another.
    """
    return [f"{path}: {_told(path, a)} against {_told(path, b)}" for path, a, b in _different(one, other, "")]


def _different(one: Any, other: Any, path: str) -> Iterator[tuple[str, Any, Any]]:
    """Paths with both values; of what one of both lacks as a whole: one line."""
    if isinstance(one, dict) and isinstance(other, dict):
        for key in dict.fromkeys([*one, *other]):
            if key not in (FREE_TEXT if path else DERIVED):
                yield from _different(one.get(key), other.get(key), f"{path}.{key}" if path else key)
    elif isinstance(one, list) and isinstance(other, list) and len(one) == len(other):
        for place, values in enumerate(zip(one, other, strict=True)):
            yield from _different(*values, f"{path}.{place}")
    elif one != other:
        yield path, one, other


def _told(path: str, value: Any) -> str:
    if value is None or value == []:
        return "none"
    if isinstance(value, dict):
        return ", ".join(f"{key} {_told(f'{path}.{key}', each)}" for key, each in value.items() if key not in FREE_TEXT)
    if isinstance(value, list):
        return "; ".join(_told(f"{path}.{place}", each) for place, each in enumerate(value))
    return f"{value!r} {unit_of(path)}".strip() if isinstance(value, float) else str(value)
