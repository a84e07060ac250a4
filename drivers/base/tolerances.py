"""Tolerances of ``inputs/tolerances.toml``, each with its reason."""

import tomllib
from dataclasses import dataclass
from functools import cache

from drivers.base import paths


@dataclass(frozen=True)
class Tolerance:
    """Allowed deviation with its reason."""

    limit: float
    reason: str


@cache
def tolerance(kind: str, quantity: str) -> Tolerance:
    """Tolerance of a quantity."""
    entry = tomllib.loads((paths.INPUTS / "tolerances.toml").read_text())[kind][quantity]
    return Tolerance(float(entry["limit"]), entry["reason"])
