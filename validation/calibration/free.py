"""Free parameters: keys of a scene with bounds and a coordinate from 0 to 1."""

from dataclasses import dataclass
from math import exp, log

from drivers.base import paths, units
from drivers.base.errors import InputError
from drivers.scene.model import Scene
from drivers.scene.settings import look_up, unit_of
from validation.calibration.calibration_file import Range, calibration_file

MIN_LOG_RATIO = 10.0  # of positive bounds; from here on the coordinate is logarithmic
FACTOR = 10.0  # from a value to its bounds if ``inputs/calibration.toml`` has none
GAIN, TRIGGER = "gain", "trigger"  # keys of a [[measured]] table
NUMERICAL_KEYS = ("run", "seed", "title")  # not physical parameters


@dataclass(frozen=True)
class Free:
    """A free parameter; values in the SI unit of its key.

    Attributes:
        key: Key of the scene, such as ``materials.ptfe.youngs_modulus``.
        own: Name of the data set that alone has this parameter; empty if all data sets share it.
        prior: Relative standard error of prior knowledge of the starting value; 0 without prior knowledge.
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
        """Key, preceded by the data set for a parameter of one data set."""
        return f"{self.own}: {self.key}" if self.own else self.key

    @property
    def logarithmic(self) -> bool:
        """True if the coordinate is proportional to the logarithm of the value."""
        return self.low > 0 and self.high / self.low >= MIN_LOG_RATIO

    def value(self, coordinate: float) -> float:
        """Value at a coordinate from 0 (lower bound) to 1 (upper bound)."""
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
    """Parameter of an option such as ``contact.restitution`` or ``striker.speed=1 m/s..3 m/s``.

    Default bounds are those of ``inputs/calibration.toml``, or else a tenth of and ten times the scene's value.

    Raises:
        InputError: the key has no physical number, there is no starting value, or the bounds are not a range.
    """
    key = text.partition("=")[0].strip()
    unit, found, known = unit_of(key), look_up(scene, key), _range_of(key)
    physics = key.split(".")[0] not in NUMERICAL_KEYS and not isinstance(found, (bool, int, str))
    if not physics or not (isinstance(found, float) or (found is None and (unit or known))):
        allowed = "a key of the scene with a physical number"
        if found is None:
            raise InputError(where, f"--free {key}", f"unknown key; allowed: {allowed}")
        raise InputError(where, f"--free {key}", repr(found), allowed)
    if found is None and known and known.start is not None:
        found = _number(known.start, unit, where, key)
    given, usual = bounds_in(text, unit, where), known_range(key, unit)
    if usual and found is not None and not usual[0] <= found <= usual[1]:
        usual = None
    ends = given or usual or (around(found) if found else None)
    if ends is None:
        raise InputError(where, f"--free {key}", f"no starting value: give bounds, --free '{key}=LOW..HIGH'")
    low, high = ends
    if not low < high:
        raise InputError(where, f"--free {key}", f"{low:g}..{high:g}", "a lower bound, then an upper bound")
    return Free(key, unit, sum(ends) / 2 if found is None else min(max(found, low), high), low, high, own)


def known_range(key: str, unit: str) -> tuple[float, float] | None:
    """Bounds of a key in ``inputs/calibration.toml``; None if it has none."""
    found, where = _range_of(key), paths.shown(paths.CALIBRATION)
    return None if found is None else (_number(found.low, unit, where, key), _number(found.high, unit, where, key))


def bounds_in(text: str, unit: str, where: str) -> tuple[float, float] | None:
    """Bounds of an option such as ``KEY=1 GPa..2 GPa``; None for a key alone.

    Raises:
        InputError: the text after = is not a pair of bounds.
    """
    key, given, bounds = text.partition("=")
    if not given:
        return None
    low, dots, high = bounds.partition("..")
    if not dots:
        raise InputError(where, f"--free {key.strip()}", bounds, "bounds such as 0.5 GPa..2 GPa")
    return _number(low.strip(), unit, where, key.strip()), _number(high.strip(), unit, where, key.strip())


def around(value: float) -> tuple[float, float]:
    """Bounds around a value other than 0: a tenth of and ten times the value."""
    return min(value / FACTOR, value * FACTOR), max(value / FACTOR, value * FACTOR)


def _number(text: object, unit: str, where: str, key: str) -> float:
    """Number in the unit of its key, from text or a plain number."""
    try:
        return units.to_si(text, unit) if unit and isinstance(text, str) else float(str(text))
    except ValueError as error:
        allowed = f"a quantity in {unit} with its unit" if unit else "a plain number"
        raise InputError(where, f"--free {key}", str(text), allowed) from error


def _range_of(key: str) -> Range | None:
    ranges = calibration_file().range
    return ranges.get(key) or ranges.get(key.rpartition(".")[2])
