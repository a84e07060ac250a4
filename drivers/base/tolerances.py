"""Tolerances are data: ``inputs/tolerances.toml`` holds each with its reason."""

import tomllib
from dataclasses import dataclass
from functools import cache
from typing import Any

from drivers.base import paths


@dataclass(frozen=True)
class Tolerance:
    """A limit with its reason.

    Attributes:
        predicted: the part of the limit that a run without faults is expected to take.
    """

    limit: float
    reason: str
    predicted: float = 0.0


@cache
def _table() -> dict[str, Any]:
    return tomllib.loads(paths.TOLERANCES.read_text())


def tolerance(kind: str, quantity: str) -> Tolerance:
    """The tolerance of a quantity."""
    found = _table()[kind][quantity]
    return Tolerance(float(found["limit"]), found["reason"])
