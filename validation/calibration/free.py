"""Free parameters: keys of a scene whose values are to be found, with bounds and a coordinate of their own."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from math import exp, log
from typing import Annotated

from pydantic import Field

from drivers.base import paths, units
from drivers.base.errors import InputError
from drivers.base.messages import validate
from drivers.scene.model import Part, Scene
from drivers.scene.read_scene import read_toml
from drivers.scene.settings import look_up, unit_of

WIDE = 10.0  # ratio of bounds above zero from which on the coordinate is logarithmic
FACTOR = 10.0  # bounds about a value that has none in ``inputs/calibration.toml``
GAIN, TRIGGER = "gain", "trigger"  # of a [[measured]] table
FIXED = ("run", "seed", "title")  # tables of a scene that are no physics


class Range(Part):
    """Where a parameter is looked for, as ``inputs/calibration.toml`` has it; quantities in words such as "1 GPa"."""

    low: str | float
    high: str | float
    start: str | float | None = None
    because: str


@dataclass(frozen=True)
class Free:
    """A free parameter; values in the SI unit of its key.

    Attributes:
        key: of the scene, such as ``materials.ptfe.youngs_modulus``.
        own: name of the data set whose own it is; empty where all data sets share it.
        prior: relative standard error with which the start is known beforehand; 0 where nothing is known.
    """

    key: str
    unit: str
    start: float
    low: float
    high: float
    own: str = ""
    prior: float = 0.0

    @property
    def label(self) -> str:
        """The key, with the data set before it where it is one's own."""
        return f"{self.own}: {self.key}" if self.own else self.key

    @property
    def logarithmic(self) -> bool:
        """Whether the coordinate goes with the logarithm."""
        return self.low > 0 and self.high / self.low >= WIDE

    def value(self, coordinate: float) -> float:
        """Value at a coordinate, which goes from 0 at the lower bound to 1 at the upper."""
        if self.logarithmic:
            return min(max(self.low * exp(coordinate * log(self.high / self.low)), self.low), self.high)
        return min(max(self.low + coordinate * (self.high - self.low), self.low), self.high)

    def coordinate(self, value: float) -> float:
        """Coordinate of a value."""
        if self.logarithmic:
            return log(value / self.low) / log(self.high / self.low)
        return (value - self.low) / (self.high - self.low)

    def slope(self, coordinate: float) -> float:
        """Derivative of the value by the coordinate."""
        if self.logarithmic:
            return self.value(coordinate) * log(self.high / self.low)
        return self.high - self.low


def free_parameter(text: str, scene: Scene, where: str, own: str = "") -> Free:
    """The parameter of an option such as ``contact.restitution`` or ``striker.speed=1 m/s..3 m/s``.

    Bounds that are not given are those of ``inputs/calibration.toml``, else a tenth and ten times the scene's value.

    Raises:
        InputError: no number of the physics stands at the key, or there is nothing to start from, or the bounds are
            no range.
    """
    key = text.partition("=")[0].strip()
    unit, found, known = unit_of(key), look_up(scene, key), _range_of(key)
    physics = key.split(".")[0] not in FIXED and not isinstance(found, (bool, int, str))
    if not physics or not (isinstance(found, float) or (found is None and (unit or known))):
        raise InputError(where, f"--free {key}", _shown(found), "a key of the scene that holds a number of its physics")
    if found is None and known and known.start is not None:
        found = _number(known.start, unit, where, key)
    given, usual = bounds_in(text, unit, where), known_range(key, unit)
    if usual and found is not None and not usual[0] <= found <= usual[1]:
        usual = None
    ends = given or usual or (around(found) if found else None)
    if ends is None:
        raise InputError(where, f"--free {key}", "nothing to start from", f"bounds: --free '{key}=LOW..HIGH'")
    low, high = ends
    if not low < high:
        raise InputError(where, f"--free {key}", f"{low:g}..{high:g}", "a lower bound, then a higher one")
    return Free(key, unit, sum(ends) / 2 if found is None else min(max(found, low), high), low, high, own)


def known_range(key: str, unit: str) -> tuple[float, float] | None:
    """Bounds that ``inputs/calibration.toml`` has for a key."""
    found, where = _range_of(key), paths.shown(paths.CALIBRATION)
    return None if found is None else (_number(found.low, unit, where, key), _number(found.high, unit, where, key))


def bounds_in(text: str, unit: str, where: str) -> tuple[float, float] | None:
    """Bounds of an option such as ``KEY=1 GPa..2 GPa``; None where it names a key alone.

    Raises:
        InputError: they are no bounds.
    """
    key, given, bounds = text.partition("=")
    if not given:
        return None
    low, dots, high = bounds.partition("..")
    if not dots:
        raise InputError(where, f"--free {key.strip()}", bounds, "bounds, such as 0.5 GPa..2 GPa")
    return _number(low.strip(), unit, where, key.strip()), _number(high.strip(), unit, where, key.strip())


def around(value: float) -> tuple[float, float]:
    """Bounds about a value that is not 0: a tenth of it and ten times it."""
    return min(value / FACTOR, value * FACTOR), max(value / FACTOR, value * FACTOR)


def _shown(found: object) -> str:
    return "no such number" if found is None else repr(found)


def _number(text: object, unit: str, where: str, key: str) -> float:
    """A number in the unit of its key, from text or as it stands."""
    try:
        return units.to_si(text, unit) if unit and isinstance(text, str) else float(str(text))
    except ValueError as error:
        allowed = f"a quantity in {unit} with its unit" if unit else "a plain number"
        raise InputError(where, f"--free {key}", str(text), allowed) from error


def _range_of(key: str) -> Range | None:
    return _ranges().get(key) or _ranges().get(key.rpartition(".")[2])


class _Ranges(Part):
    range: dict[Annotated[str, Field(min_length=1)], Range]


@cache
def _ranges() -> Mapping[str, Range]:
    """Ranges by key, or by the last part of a key."""
    table = {"range": read_toml(paths.CALIBRATION).get("range", {})}
    return validate(_Ranges, table, paths.shown(paths.CALIBRATION)).range
