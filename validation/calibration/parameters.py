"""Free parameters and contact laws of fits, as options name them; the file ``inputs/calibration.toml``."""

import re
from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace
from functools import cache
from itertools import product
from math import exp, inf, isfinite, isnan, log, nan
from typing import Annotated, Literal

from pydantic import Field

from drivers.base import paths, units
from drivers.base.errors import InputError
from drivers.base.messages import near, validate
from drivers.laws import LAWS, VISCOELASTIC
from drivers.scene.model import Part, Positive, Scene
from drivers.scene.read_scene import read_toml
from drivers.scene.rules import LAW_KEYS
from drivers.scene.settings import look_up, unit_of

Texts = Annotated[tuple[str, ...], Field(strict=False)]

LOG_RATIOS = 10.0, 1e6  # of positive bounds with a logarithmic coordinate; a larger one has a lower bound for 0
FACTOR = 10.0  # from a value to its bounds if ``inputs/calibration.toml`` has none
REACH = 8.0  # standard errors of prior knowledge from the value to the bounds
ELASTIC = "elastic"
OF_LAWS = ["contact.dissipation", *(f"contact.{key}" for keys in LAW_KEYS.values() for key in keys)]
NUMERICAL_KEYS = ("run", "seed", "title")  # not physical parameters
GAIN, TRIGGER = "gain", "trigger"  # keys of a [[measured]] table
READING = "reading"  # table of the keys of parameters of readings
CUT = f"{READING}.cut"
# two numbers with their units: bounds, or a value with its standard error, which may be in per cent
PAIR = re.compile(r"(.*?)\s*(\.\.|±|\+/?-)\s*([+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)\s*(%?)\s*(.*)")
DEFAULT = "default"  # reading with the first answer to each question


class QuotedNumber(Part):
    """A number of ``inputs/paper/quoted.toml`` as a datum.

    Attributes:
        scale: factor from the quoted unit to that of the observable.
        error: relative standard error, or the kind of number whose error the paper states.
        rounding: half of the last digit, in the quoted unit; one for each number of a list.
    """

    observable: str
    quoted: str
    scale: float = 1.0
    error: Literal["force", "speed"] | Positive
    rounding: Annotated[tuple[Positive, ...], Field(strict=False)] = ()
    because: str = ""


class QuotedSet(Part):
    """Quoted data of a scene; a list of numbers gives one data set per row.

    ``also`` maps a data set to the row with the same experiment; this row is left out if both are fitted.
    """

    scene: str
    set: Texts = ()
    own: Texts = ()
    also: dict[str, int] = Field(default_factory=dict)
    number: Annotated[tuple[QuotedNumber, ...], Field(strict=False, min_length=1)]


class Answer(Part):
    """One reading of a sentence of the paper.

    Attributes:
        set: settings by data set, or of ``all``.
        free: further free parameters.
        read: observables to be read in place of others.
        fixed: values of parameters of readings.
        independent: True if no error is common to several numbers.
        alone: True to combine it with the default answers to all other questions only.
        quick: True to fit it in the short study.
    """

    name: str
    because: str = ""
    set: dict[str, Texts] = Field(default_factory=dict)
    free: Texts = ()
    read: dict[str, str] = Field(default_factory=dict)
    fixed: dict[str, float] = Field(default_factory=dict)
    independent: bool = False
    alone: bool = False
    quick: bool = False


class CalibrationFile(Part):
    """The whole file.

    Attributes:
        data: data sets of the calibration on the paper.
        free: parameters that every law has in it.
        range: bounds by key of the scene or by the last part of a key, as in ``--free``.
        start, none: values at which a fit starts where the scene has none, and at which a parameter has no effect.
        reading: parameters of readings that are fitted with the numbers, as in ``--free``.
        found: parameters found on the paper, by law and label; the short study starts there alone.
        choice: answers to each question that the paper leaves open; the first is the default.
    """

    data: Annotated[tuple[str, ...], Field(strict=False, min_length=1)]
    free: Texts
    range: dict[Annotated[str, Field(min_length=1)], str]
    start: dict[str, str | float]
    none: dict[str, float]
    reading: dict[Literal["force_scale", "speed_scale", "cut"], str]
    found: dict[str, dict[str, float]]
    set: dict[str, QuotedSet]
    choice: dict[str, Annotated[tuple[Answer, ...], Field(strict=False, min_length=2)]]

    def readings(self, *, quick: bool = False) -> dict[str, tuple[Answer, ...]]:
        """Combinations of answers by the answers that are not the default one, which comes first."""
        asked = {}
        for answers in product(*self.choice.values()):
            pairs = zip(self.choice.items(), answers, strict=True)
            other = {question: answer for (question, usual), answer in pairs if answer is not usual[0]}
            combined = len(other) < 2 or not any(answer.alone for answer in other.values())
            if combined and (not quick or all(answer.quick for answer in other.values())):
                name = "; ".join(f"{question}: {answer.name}" for question, answer in other.items())
                asked[name or DEFAULT] = answers
        return asked


@cache
def calibration_file() -> CalibrationFile:
    """Contents of the file.

    Raises:
        InputError: the file has errors.
    """
    return validate(CalibrationFile, read_toml(paths.CALIBRATION), paths.CALIBRATION)


def keys_of(law: str) -> list[str]:
    """Keys of the dissipation of a law; a fit to the law has the first one as a parameter.

    Raises:
        InputError: There is no such law.
    """
    name = law.partition(",")[0].strip()
    if name not in ("", ELASTIC, *LAWS):
        raise unknown("fit", "--law", name, [ELASTIC, *LAWS])
    return [f"contact.{key}" for key in LAW_KEYS.get(name, ()) if key != "damping_ratio"]  # stated by the restitution


def law_of(text: str, asked: Mapping[str, str] | None = None) -> tuple[str, ...]:
    """Settings of a law: ``elastic`` or one of ``drivers.laws``, with constants after commas, ``power,alpha=1.5``.

    Keys of other laws are removed from the scene, those of the law stay. Its first key starts at the value of
    ``inputs/calibration.toml``, or else at an end of its bounds. The law of the scene, an empty text, has none.

    Args:
        text: The law.
        asked: Options ``--free`` by key.

    Raises:
        InputError: There is no such law, or no start of its parameter.
    """
    if not text:
        return ()
    name, *constants = (part.strip() for part in text.split(","))
    own = keys_of(name)
    if wrong := [part for part in constants if "=" not in part]:
        raise InputError("fit", f"--law {name}", wrong[0], f"constants as KEY=VALUE: --law {name},KEY=VALUE")
    removed = [f"{key}=" for key in OF_LAWS if key not in own]
    given = dict(f"contact.{each}".split("=", 1) for each in constants)
    for key in own[:1]:
        start = calibration_file().start.get(key) or (asked or {}).get(key, "").rpartition("..")[2]
        if not given.setdefault(key, str(start)):
            raise InputError("fit", f"--law {name}", f"no start of {key}", f"bounds, --free '{key}=LOW..HIGH'")
    texts = (f"{key}={value}" for key, value in given.items())
    return (*removed, f"contact.dissipation={name if own else VISCOELASTIC}", *texts)


@dataclass(frozen=True)
class Free:
    """A free parameter with bounds, prior knowledge, and a coordinate from 0 to 1; values in the SI unit of its key.

    Attributes:
        key: Key of the scene, such as ``materials.ptfe.youngs_modulus``, of a gauge or of a reading.
        start, low, high: Starting value and bounds; NaN if there are none yet.
        own: Name of the data set that alone has this parameter; empty if data sets share it.
        without: Names of data sets whose scenes have no table for a shared parameter.
        prior: Standard error of prior knowledge of the starting value; 0 without prior knowledge.
    """

    key: str
    unit: str
    start: float = nan
    low: float = nan
    high: float = nan
    own: str = ""
    prior: float = 0.0
    without: tuple[str, ...] = ()

    def belongs_to(self, data_set: str) -> bool:
        """True if a data set depends on the parameter."""
        return self.own in ("", data_set) and data_set not in self.without

    @property
    def label(self) -> str:
        """Key, preceded by the data set for a parameter of one data set."""
        return f"{self.own}: {self.key}" if self.own else self.key

    @property
    def of_motion(self) -> bool:
        """True if the motion depends on the parameter."""
        return not self.key.startswith(("measured", READING))  # gauges and readings do not change it

    @property
    def is_trigger(self) -> bool:
        """True for the trigger of a file, of which the zero is arbitrary."""
        return self.key.endswith(f".{TRIGGER}")

    @property
    def logarithmic(self) -> bool:
        """True if the coordinate is proportional to the logarithm of the value."""
        return self.low > 0 and LOG_RATIOS[0] <= self.high / self.low <= LOG_RATIOS[1]

    def value(self, coordinate: float) -> float:
        """Value at a coordinate from 0 (lower bound) to 1 (upper bound)."""
        low, high = self.low, self.high
        value = low * exp(coordinate * log(high / low)) if self.logarithmic else low + coordinate * (high - low)
        return min(max(value, low), high)

    def coordinate(self, value: float) -> float:
        """Coordinate of a value; that of the nearer bound beyond the range."""
        value = min(max(value, self.low), self.high)
        share = (value - self.low) / (self.high - self.low)
        return log(value / self.low) / log(self.high / self.low) if self.logarithmic else share

    def slope(self, coordinate: float) -> float:
        """Derivative of the value by the coordinate."""
        return self.value(coordinate) * log(self.high / self.low) if self.logarithmic else self.high - self.low


def free_parameter(text: str, scene: Scene, where: str, own: str = "") -> Free:
    """Parameter of an option such as ``contact.restitution``, ``striker.speed=1 m/s..3 m/s`` or ``...=2 m/s±1%``.

    Default bounds are those of ``inputs/calibration.toml``, or else a tenth of and ten times the scene's value.

    Raises:
        InputError: The key has no physical number, there is no starting value, or the bounds are not a range.
    """
    key, asked, file = text.partition("=")[0].strip(), calibration_file(), paths.shown(paths.CALIBRATION)
    unit, value, start = unit_of(key), look_up(scene, key), asked.start.get(key)
    known = asked.range.get(key, asked.range.get(key.rpartition(".")[2]))
    number = isinstance(value, float) or (value is None and (unit or known or "=" in text))
    if not number or key.split(".")[0] in NUMERICAL_KEYS:
        raise unknown(where, "--free", key, asked.range, "a key of the scene with a physical number")
    if value is None and start is not None and not of_scene(text):  # which is no knowledge
        value = _number(start, unit, file, key)
    usual = Free(key, unit, nan if value is None else value, *around(value or nan), own)
    if known:
        ends = stated(f"{key}={known}", Free(key, unit), file)
        inside = value is None or ends.low <= value <= ends.high
        usual = replace(usual, low=ends.low, high=ends.high) if inside else usual
    return stated(text, usual, where)


def of_scene(text: str) -> bool:
    """True for an option ``KEY=±ERROR``, prior knowledge of the scene's own value."""
    return text.partition("=")[2].lstrip().startswith(("±", "+-", "+/-"))


def stated(text: str, usual: Free, where: str, option: str = "--free") -> Free:
    """Parameter of an option ``KEY``, ``KEY=LOW..HIGH`` or ``KEY=VALUE±ERROR``; the error may be in per cent.

    A number without a unit has that of the other number, or else the SI unit of the key.

    Args:
        text: The option; without a value before ± it is that of the scene.
        usual: Parameter of the key alone; without a start it starts in the middle of its bounds.
        where: Scene as messages name it.
        option: Option as messages name it.

    Raises:
        InputError: There are no bounds, or the text after ``=`` is wrong.
    """
    key, given, rest = (part.strip() for part in text.partition("="))
    label, unit, free, pair = f"{option} {key}", usual.unit, usual, PAIR.fullmatch(rest)
    if given and not pair:
        ends, known = ("0.5 GPa..2 GPa", "1 GPa±5%") if unit else ("2..5", "3±5%")
        raise InputError(where, label, rest, f"bounds such as {ends}, or a value with its error such as {known}")
    if pair:
        first, sign, last, percent, ending = pair.groups()
        value = _number(first, unit, where, label, ending) if first or sign == ".." else usual.start
        other = float(last) / 100 * abs(value) if percent else _number(f"{last} {ending}".strip(), unit, where, label)
        if not (value < other if sign == ".." else other > 0 and isfinite(value)):
            of_value = "a value, which the scene may state, with an error above 0"
            allowed = "a lower bound, then an upper bound" if sign == ".." else of_value
            raise InputError(where, label, rest, allowed)
        if sign == "..":
            free = replace(usual, low=value, high=other)
        else:
            least, most = (usual.low, usual.high) if usual.low <= value <= usual.high else (-inf, inf)
            low = value - REACH * other if not 0 < value <= REACH * other else value / (2 * FACTOR)
            high = value + REACH * other
            free = replace(usual, start=value, low=max(low, least), high=min(high, most), prior=other)
    if isnan(free.low):
        raise InputError(where, label, f"no starting value: give bounds, {option} '{key}=LOW..HIGH'")
    free = replace(free, start=free.value(0.5) if isnan(free.start) else min(max(free.start, free.low), free.high))
    start, unitless = abs(usual.start), given and not re.search("[A-Za-z]", rest)
    if unit and start > 0 and unitless and not 0.1 <= free.start / usual.start <= 10:
        found, allowed = f"{rest}, that is {free.start:g} {unit}", f"a value near {usual.start:g} {unit}, or a unit"
        raise InputError(where, label, found, allowed)
    return free


def _number(text: object, unit: str, where: str, label: str, other: str = "") -> float:
    """Number in the SI unit of its key, from text with a unit, or without one in another or the SI unit."""
    given = str(text) if units.NUMBER_AND_UNIT.fullmatch(str(text)) else f"{text} {other}".strip()
    try:
        return units.to_si(given, unit) if unit and units.NUMBER_AND_UNIT.fullmatch(given) else float(given)
    except ValueError as error:
        allowed = f"a quantity in {unit} with its unit" if unit else "a plain number"
        raise InputError(where, label, str(text), allowed) from error


def around(value: float) -> tuple[float, float]:
    """Bounds around a value other than 0: a tenth of and ten times the value."""
    return min(value / FACTOR, value * FACTOR), max(value / FACTOR, value * FACTOR)


def unknown(where: str, key: str, name: str, known: Collection[str], allowed: str = "") -> InputError:
    """Error of an unknown name, which asks for the nearest known one; else it says what is allowed."""
    return InputError(where, key, f"found {name}; {near(name, known) or 'allowed: ' + (allowed or ', '.join(known))}")


@cache
def of_readings() -> list[Free]:
    """Parameters of readings of quoted numbers."""
    asked = {f"{READING}.{key}": text for key, text in calibration_file().reading.items()}
    return [stated(f"{key}={text}", Free(key, ""), paths.shown(paths.CALIBRATION)) for key, text in asked.items()]
