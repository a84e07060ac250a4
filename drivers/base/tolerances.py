"""Tolerances are data: ``inputs/tolerances.toml`` holds each with its reason."""

import tomllib
from dataclasses import dataclass
from functools import cache
from typing import Any

from drivers.base import paths


@dataclass(frozen=True)
class Tolerance:
    """A limit with its reason."""

    limit: float
    reason: str


@cache
def _table() -> dict[str, Any]:
    return tomllib.loads(paths.TOLERANCES.read_text())


def tolerance(kind: str, quantity: str, scene: str | None = None) -> Tolerance:
    """The tolerance of a quantity, the scene's own before the general one."""
    table = _table()[kind][quantity]
    chosen = table.get("scene", {}).get(scene) or table
    return Tolerance(float(chosen["limit"]), chosen["reason"])
