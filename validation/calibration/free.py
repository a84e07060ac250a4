"""Free parameters: keys of a scene with bounds, prior knowledge, and a coordinate from 0 to 1."""

import re
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from difflib import get_close_matches
from math import exp, inf, log
from typing import Any

from drivers.base import paths, units
from drivers.base.errors import InputError
from drivers.scene.model import Scene
from drivers.scene.settings import look_up, unit_of
from validation.calibration.calibration_file import Range, calibration_file

MIN_LOG_RATIO = 10.0  # of positive bounds; from here on the coordinate is logarithmic
FACTOR = 10.0  # from a value to its bounds if ``inputs/calibration.toml`` has none
REACH = 8.0  # standard errors of prior knowledge from the value to the bounds
GAIN, TRIGGER = "gain", "trigger"  # keys of a [[measured]] table
NUMERICAL_KEYS = ("run", "seed", "title")  # not physical parameters
PRIOR = re.compile(r"(?P<value>.+?)\s*(?:±|\+/?-)\s*(?P<error>[^\s%]+)\s*(?P<percent>%)?\s*(?P<unit>.*)")


@dataclass(frozen=True)
class Free:
    """A free parameter; values in the SI unit of its key.

    Attributes:
        key: Key of the scene, such as ``materials.ptfe.youngs_modulus``, of a gauge or of a reading.
        own: Name of the data set that alone has this parameter; empty if all data sets share it.
        prior: Standard error of prior knowledge of the starting value; 0 without prior knowledge.
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
    def of_motion(self) -> bool:
        """True if the motion depends on the parameter; gauges and readings do not change it."""
        return not self.key.startswith(("measured", "reading"))

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
        """Coordinate of a value; that of the nearer bound beyond the range."""
        value = min(max(value, self.low), self.high)
        if self.logarithmic:
            return log(value / self.low) / log(self.high / self.low)
        return (value - self.low) / (self.high - self.low)

    def slope(self, coordinate: float) -> float:
        """Derivative of the value by the coordinate."""
        if self.logarithmic:
            return self.value(coordinate) * log(self.high / self.low)
        return self.high - self.low


def free_parameter(text: str, scene: Scene, where: str, own: str = "") -> Free:
    """Parameter of an option such as ``contact.restitution``, ``striker.speed=1 m/s..3 m/s`` or ``...=2 m/s±1%``.

    Default bounds are those of ``inputs/calibration.toml``, or else a tenth of and ten times the scene's value.

    Raises:
        InputError: The key has no physical number, there is no starting value, or the bounds are not a range.
    """
    key = text.partition("=")[0].strip()
    unit, value, known = unit_of(key), look_up(scene, key), _range_of(key)
    physics = key.split(".")[0] not in NUMERICAL_KEYS and not isinstance(value, (bool, int, str))
    if not physics or not (isinstance(value, float) or (value is None and (unit or known))):
        if value is None:
            hint = (
                did_you_mean(key, [*_numbers_in(scene.model_dump()), *calibration_file().range])
                or "allowed: a key of the scene with a physical number"
            )
            raise InputError(where, f"--free {key}", f"unknown key; {hint}")
        raise InputError(where, f"--free {key}", repr(value), "a key of the scene with a physical number")
    file, usual = paths.shown(paths.CALIBRATION), around(value) if value else None
    if value is None and known and known.start is not None:
        value = _number(known.start, unit, file, key)
    if known:
        low, high = _number(known.low, unit, file, key), _number(known.high, unit, file, key)
        usual = (low, high) if value is None or low <= value <= high else around(value)
    return stated(text, unit, where, value, usual, own)


def stated(
    text: str, unit: str, where: str, start: float | None, usual: tuple[float, float] | None, own: str = ""
) -> Free:
    """Parameter of an option ``KEY``, ``KEY=LOW..HIGH`` or ``KEY=VALUE±ERROR``; the error may be in per cent.

    Args:
        text: The option.
        unit: SI unit of the key.
        where: Scene as messages name it.
        start: Starting value; None: the middle of the bounds.
        usual: Bounds if the option gives none.
        own: Data set that alone has the parameter.

    Raises:
        InputError: There are no bounds, or the text after ``=`` is wrong.
    """
    key, given, rest = (part.strip() for part in text.partition("="))
    name = f"--free {key}"
    if not given:
        if usual is None:
            raise InputError(where, name, f"no starting value: give bounds, --free '{key}=LOW..HIGH'")
        low, high = usual
        return Free(key, unit, sum(usual) / 2 if start is None else min(max(start, low), high), low, high, own)
    if prior := PRIOR.fullmatch(rest):
        value, error = _known_value(prior, unit, where, key)
        if unit and not re.search("[A-Za-z]", rest) and start and not 0.1 <= value / start <= 10:
            raise InputError(
                where, name, f"{rest}, that is {value:g} {unit}", f"a value near {start:g} {unit}, or a unit"
            )
        low = value - REACH * error if not 0 < value <= REACH * error else value / (2 * FACTOR)
        high, ends = value + REACH * error, usual if usual and usual[0] <= value <= usual[1] else (low, inf)
        return Free(key, unit, value, max(low, ends[0]), min(high, ends[1]), own, error)
    first, dots, last = (part.strip() for part in rest.partition(".."))
    if not dots:
        allowed = "bounds such as 0.5 GPa..2 GPa, or a value with its error such as 1 GPa±5%"
        raise InputError(where, name, rest, allowed)
    low, high = _number(first, unit, where, key), _number(last, unit, where, key)
    if not low < high:
        raise InputError(where, name, f"{low:g}..{high:g}", "a lower bound, then an upper bound")
    return Free(key, unit, (low + high) / 2 if start is None else min(max(start, low), high), low, high, own)


def _known_value(prior: re.Match[str], unit: str, where: str, key: str) -> tuple[float, float]:
    """Value and standard error of a text such as ``9.525±0.005 mm``; without a unit it is in the SI unit."""
    suffix = f" {prior['unit']}" if prior["unit"] else ""
    value = _number(_with_unit(prior["value"] + suffix * (not _has_unit(prior["value"])), unit), unit, where, key)
    if prior["percent"]:
        error = abs(value) * _number(prior["error"], "", where, key) / 100
    else:
        error = _number(_with_unit(prior["error"] + suffix, unit), unit, where, key)
    if not error > 0:
        raise InputError(where, f"--free {key}", prior[0], "a value with an error above 0, such as 1 GPa±5%")
    return value, error


def _has_unit(text: str) -> bool:
    return " " in text.strip() or text.strip()[-1:].isalpha()


def _with_unit(text: str, unit: str) -> str:
    return text if _has_unit(text) or not unit else f"{text} {unit}"


def without_effect(key: str) -> float | None:
    """Value at which a parameter has no effect, such as a restitution of 1; None if the file names none."""
    known = _range_of(key)
    return known.none if known else None


def around(value: float) -> tuple[float, float]:
    """Bounds around a value other than 0: a tenth of and ten times the value."""
    return min(value / FACTOR, value * FACTOR), max(value / FACTOR, value * FACTOR)


def _numbers_in(tables: Any, path: str = "") -> Iterator[str]:
    """Keys of the physical numbers in the tables of a scene."""
    for name, value in tables.items() if isinstance(tables, dict) else enumerate(tables):
        key = f"{path}{name}"
        if isinstance(value, (dict, list, tuple)):
            yield from _numbers_in(value, f"{key}.")
        elif isinstance(value, float) or (value is None and unit_of(key)):
            yield key


def did_you_mean(word: str, known: Iterable[str]) -> str:
    """Question with the nearest known word; empty if none is near."""
    close = get_close_matches(word, list(known), 1)
    return f"did you mean {close[0]}?" if close else ""


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
