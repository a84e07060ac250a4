"""Data of fits: the file ``inputs/calibration.toml``, free parameters, and scenes with measured numbers or traces."""

import json
import re
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from difflib import get_close_matches
from functools import cache
from itertools import product
from math import exp, hypot, inf, log, nan, sqrt
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field

from drivers.base import paths, units
from drivers.base.errors import InputError
from drivers.base.messages import validate
from drivers.chain.case import build_case
from drivers.engines import REFERENCE
from drivers.laws import LAWS, VISCOELASTIC
from drivers.limits import refuse
from drivers.scene.model import MeasuredEntry, Part, Positive, Scene
from drivers.scene.read_scene import apply_setting, find_scene, make_scene, read_scene, read_toml
from drivers.scene.rules import LAW_KEYS
from drivers.scene.settings import look_up, unit_of
from postproc.paper import force_accuracy, quoted
from postproc.read.alignment import Channel, channels_of, correlated, must_overlap
from postproc.read.measured import MEASURED, entries_of, read_measured, read_quoted
from postproc.read.motion import exact
from postproc.read.observables import describe
from postproc.read.signals import gauges_of

Texts = Annotated[tuple[str, ...], Field(strict=False)]

LOG_RATIOS = 10.0, 1e6  # of positive bounds with a logarithmic coordinate; a larger one has a lower bound for 0
FACTOR = 10.0  # from a value to its bounds if ``inputs/calibration.toml`` has none
REACH = 8.0  # standard errors of prior knowledge from the value to the bounds
LONGER = 2.0  # a run divided by the scene's duration, if a trigger has to be found
ELASTIC = "elastic"
GAIN, TRIGGER = "gain", "trigger"  # keys of a [[measured]] table
NUMERICAL_KEYS = ("run", "seed", "title")  # not physical parameters
READING = "reading"  # table of the keys of parameters of readings
CUT = f"{READING}.cut"
IN_UNIT = re.compile(r"\s*[+-]?[\d.]++(?:[eE][+-]?\d+)?+\s*(\D.*?)\s*")  # a number with its unit
PRIOR = re.compile(r"(?P<value>.*?)\s*(?:±|\+/?-)\s*(?P<error>[^\s%]+)\s*(?P<percent>%)?\s*(?P<unit>.*)")
DEFAULT = "default"  # reading with the first answer to each question
ALL = "all"  # instead of the name of a data set


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


class Law(Part):
    """A contact law: settings of a scene that give it, and free parameters of its dissipation."""

    set: Texts = ()
    free: Texts = ()


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


def law_of(text: str, asked: Mapping[str, str] | None = None) -> Law:
    """Law by its name, ``elastic`` or one of ``drivers.laws``, with constants after commas: ``power,alpha=1.5``.

    Keys of other laws are removed from the scene, those of the law stay. Its first key is a free parameter, which
    starts at the value of ``inputs/calibration.toml``, or else at an end of its bounds.

    Args:
        text: The law.
        asked: Options ``--free`` by key.

    Raises:
        InputError: There is no such law, or no start of its parameter.
    """
    name, *constants = (part.strip() for part in text.split(","))
    if name not in (ELASTIC, *LAWS):
        raise unknown("fit", "--law", name, [ELASTIC, *LAWS])
    own = [key for key in LAW_KEYS.get(name, ()) if key != "damping_ratio"]  # which the restitution states, too
    removed = {key: "" for of_law in LAW_KEYS.values() for key in of_law if key not in own}
    free = [f"contact.{key}" for key in own[:1]]
    starts = [calibration_file().start.get(key) or (asked or {}).get(key, "").rpartition("..")[2] for key in free]
    if "" in starts:
        raise InputError("fit", f"--law {name}", f"no start of {free[0]}", f"bounds, --free '{free[0]}=LOW..HIGH'")
    chosen = {"dissipation": name if own else VISCOELASTIC} | removed | dict(zip(own, starts, strict=False))
    given = [*(f"{key}={value}" for key, value in chosen.items()), *constants]
    return Law(set=tuple(f"contact.{each}" for each in given), free=tuple(free))


@dataclass(frozen=True)
class Free:
    """A free parameter with bounds, prior knowledge, and a coordinate from 0 to 1; values in the SI unit of its key.

    Attributes:
        key: Key of the scene, such as ``materials.ptfe.youngs_modulus``, of a gauge or of a reading.
        own: Name of the data set that alone has this parameter; empty if data sets share it.
        without: Names of data sets whose scenes have no table for a shared parameter.
        prior: Standard error of prior knowledge of the starting value; 0 without prior knowledge.
    """

    key: str
    unit: str
    start: float
    low: float
    high: float
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
        """True if the motion depends on the parameter; gauges and readings do not change it."""
        return not self.key.startswith(("measured", READING))

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
    unit, value, known, start = unit_of(key), look_up(scene, key), _of_key(asked.range, key), _of_key(asked.start, key)
    physics = key.split(".")[0] not in NUMERICAL_KEYS and not isinstance(value, (bool, int, str))
    if not physics or not (isinstance(value, float) or (value is None and (unit or known))):
        raise unknown(where, "--free", key, asked.range, "a key of the scene with a physical number")
    if value is None and start is not None:
        value = _number(start, unit, file, key)
    usual = around(value) if value else None
    if known:
        low, high = _bounds(known, unit, file, key)
        usual = (low, high) if value is None or low <= value <= high else around(value)
    return stated(text, unit, where, value, usual, own)


def stated(
    text: str,
    unit: str,
    where: str,
    start: float | None,
    usual: tuple[float, float] | None,
    own: str = "",
    option: str = "--free",
) -> Free:
    """Parameter of an option ``KEY``, ``KEY=LOW..HIGH`` or ``KEY=VALUE±ERROR``; the error may be in per cent.

    A number without a unit has that of the other number, or else the SI unit of the key.

    Args:
        text: The option; without a value before ± it is that of the scene.
        unit: SI unit of the key.
        where: Scene as messages name it.
        start: Starting value; None: the middle of the bounds.
        usual: Bounds if the option gives none.
        own: Data set that alone has the parameter.
        option: Option as messages name it.

    Raises:
        InputError: There are no bounds, or the text after ``=`` is wrong.
    """
    key, given, rest = (part.strip() for part in text.partition("="))
    prior, label = PRIOR.fullmatch(rest), f"{option} {key}"
    if prior:
        value, error = _known_value(prior, unit, where, label, start)
        ends = usual if usual and usual[0] <= value <= usual[1] else (-inf, inf)
        low = value - REACH * error if not 0 < value <= REACH * error else value / (2 * FACTOR)
        free = Free(key, unit, value, max(low, ends[0]), min(value + REACH * error, ends[1]), own, error)
    else:
        bounds = _bounds(rest, unit, where, label) if given else usual
        if bounds is None:
            raise InputError(where, label, f"no starting value: give bounds, {option} '{key}=LOW..HIGH'")
        free = Free(key, unit, bounds[0], *bounds, own)
        free = replace(free, start=free.value(0.5) if start is None else min(max(start, free.low), free.high))
    if unit and start and given and not re.search("[A-Za-z]", rest) and not 0.1 <= free.start / start <= 10:
        found, allowed = f"{rest}, that is {free.start:g} {unit}", f"a value near {start:g} {unit}, or a unit"
        raise InputError(where, label, found, allowed)
    return free


def _bounds(text: str, unit: str, where: str, label: str) -> tuple[float, float]:
    """Bounds such as ``0.5 GPa..2 GPa``."""
    first, dots, last = (part.strip() for part in text.partition(".."))
    if not dots:
        allowed = "bounds such as 0.5 GPa..2 GPa, or a value with its error such as 1 GPa±5%"
        raise InputError(where, label, text, allowed)
    other = IN_UNIT.fullmatch(last)
    low, high = _number(first, unit, where, label, other[1] if other else ""), _number(last, unit, where, label)
    if not low < high:
        raise InputError(where, label, f"{low:g}..{high:g}", "a lower bound, then an upper bound")
    return low, high


def _known_value(prior: re.Match[str], unit: str, where: str, label: str, start: float | None) -> tuple[float, float]:
    """Value and standard error of a text such as ``9.525±0.005 mm``."""
    if not prior["value"] and start is None:
        raise InputError(where, label, prior[0], "a value before ±, since the scene has none")
    value = _number(prior["value"], unit, where, label, prior["unit"]) if prior["value"] else start or 0.0
    error = _number(prior["error"], "" if prior["percent"] else unit, where, label, prior["unit"])
    error *= abs(value) / 100 if prior["percent"] else 1.0
    if not error > 0:
        raise InputError(where, label, prior[0], "a value with an error above 0, such as 1 GPa±5%")
    return value, error


def _number(text: object, unit: str, where: str, label: str, other: str = "") -> float:
    """Number in the SI unit of its key, from text with a unit, or without one in another or the SI unit."""
    given = str(text) if IN_UNIT.fullmatch(str(text)) else f"{text} {other}".strip()
    try:
        return units.to_si(given, unit) if unit and IN_UNIT.fullmatch(given) else float(given)
    except ValueError as error:
        allowed = f"a quantity in {unit} with its unit" if unit else "a plain number"
        raise InputError(where, label, str(text), allowed) from error


def _of_key(table: Mapping[str, Any], key: str) -> Any:
    """Entry of a key, or of its last part; None without one."""
    return table.get(key, table.get(key.rpartition(".")[2]))


def around(value: float) -> tuple[float, float]:
    """Bounds around a value other than 0: a tenth of and ten times the value."""
    return min(value / FACTOR, value * FACTOR), max(value / FACTOR, value * FACTOR)


def unknown(where: str, key: str, name: str, known: Collection[str], allowed: str = "") -> InputError:
    """Error of an unknown name, which asks for the nearest known one; else it says what is allowed."""
    close = get_close_matches(name, known, 1)
    hint = f"did you mean {close[0]}?" if close else f"allowed: {allowed or ', '.join(known)}"
    return InputError(where, key, f"found {name}; {hint}")


@dataclass(frozen=True)
class Datum:
    """One datum: a measured number, the trace of a gauge, or prior knowledge of a parameter.

    Attributes:
        name: Name of an observable or of a reading with its unit, of a gauge, or of a parameter.
        value, error: Measured number and its standard error without common parts; NaN for other data.
        because: Reason of an assumed error; empty for a stated one.
        divisor: Key of the parameter by which the computed number is divided; empty without one.
        data_set: Name of its data set, in a problem.
        rows: Rows of the residual, in a problem.
    """

    name: str
    value: float = nan
    error: float = nan
    because: str = ""
    divisor: str = ""
    data_set: str = ""
    rows: range = range(0)

    @property
    def unit(self) -> str:
        """Unit of a number."""
        unit = describe(self.name).unit or self.name.rpartition("_")[2]
        return f"1/{unit}" if self.name.endswith(f"_per_{unit}") else unit

    @property
    def label(self) -> str:
        """Name of the data set and of the datum."""
        return f"{self.data_set}: {self.name}" if self.data_set else self.name


@dataclass(frozen=True, eq=False)
class DataSet:
    """A scene with its measured data.

    Attributes:
        source: Name of the scene or path of its file.
        tables: Tables of the scene's file with settings applied, as JSON: data sets with the same tables share motions.
        where: File as messages name it.
        numbers: Measured numbers.
        own: Keys of free parameters of this data set alone.
        channels: Measured traces of gauges.
        entries: ``[[measured]]`` tables by key, such as ``measured.0``.
        triggers: Trigger of each file, given or found at the scene's values, by the key of its first entry.
        step_s: Sample interval of the run.
        duration: Duration of the scene's run; that of the tables is longer if a trigger has to be found.
        fixed: Values of parameters of readings that are not free, by key.
    """

    name: str
    source: str
    tables: str
    where: str
    numbers: tuple[Datum, ...] = ()
    own: tuple[str, ...] = ()
    channels: tuple[Channel, ...] = ()
    entries: Mapping[str, MeasuredEntry] = field(default_factory=dict)
    triggers: Mapping[str, float] = field(default_factory=dict)
    step_s: float = nan
    duration: str = ""
    fixed: Mapping[str, float] = field(default_factory=dict)

    @property
    def rows(self) -> int:
        """Number of residuals."""
        return len(self.numbers) + sum(int(channel.counts.sum()) for channel in self.channels)

    @property
    def scene(self) -> Scene:
        """Scene made from the tables."""
        return make_scene(json.loads(self.tables), self.name, self.where)


def paper_data(names: Sequence[str], settings: Sequence[str] = (), answers: Sequence[Answer] = ()) -> list[DataSet]:
    """Quoted data sets, with settings applied to their scenes.

    Args:
        names: Names of data sets of ``inputs/calibration.toml``.
        settings: Settings of all scenes, such as those of a law.
        answers: Readings of the sentences that the paper leaves open.

    Raises:
        InputError: A data set or setting is unknown.
    """
    known, data = calibration_file().set, list[DataSet]()
    fixed = {f"{READING}.{key}": value for answer in answers for key, value in answer.fixed.items()}
    for name in names:
        if name not in known:
            raise unknown("fit", "--quoted", name, known)
        asked = known[name]
        changes = [text for answer in answers for key in (ALL, name) for text in answer.set.get(key, ())]
        everything = (*asked.set, *settings, *changes)
        _, tables, where = checked(asked.scene, everything)
        skipped = [row for other, row in asked.also.items() if other in names]
        columns = [_column(number, answers) for number in asked.number]
        rows = max(map(len, columns))
        for row in (row for row in range(rows) if row not in skipped):
            numbers = tuple(column[min(row, len(column) - 1)] for column in columns)
            label = f"{name} {numbers[0].value:g} {numbers[0].unit}" if rows > 1 else name
            data.append(DataSet(label, asked.scene, json.dumps(tables), where, numbers, asked.own, fixed=fixed))
    return data


def _column(number: QuotedNumber, answers: Sequence[Answer]) -> list[Datum]:
    """Numbers of a list in ``quoted.toml``, or its single number."""
    stored = look_up(quoted(), number.quoted)
    values = stored if isinstance(stored, tuple) else (stored,)
    if not all(isinstance(value, (int, float)) for value in values):
        allowed = "a number of inputs/paper/quoted.toml"
        raise InputError(paths.shown(paths.CALIBRATION), "quoted", number.quoted, allowed)
    name = next((said.read[number.observable] for said in answers if number.observable in said.read), number.observable)
    scale = f"{READING}.{number.error}_scale"  # key of the parameter of this kind of error
    shared, numbers = not any(answer.independent for answer in answers), []
    prior = next((free.prior for free in of_readings() if shared and free.key == scale), 0.0)
    for place, value in enumerate(values):
        share = quoted().accuracy_speed if number.error == "speed" else number.error
        share = force_accuracy(value) if share == "force" else float(share)
        own_error = sqrt(max(share**2 - prior**2, 0.0)) * abs(value)
        rounding = number.rounding[place] / sqrt(3) if number.rounding and shared else 0.0
        error = hypot(own_error, rounding) * number.scale
        numbers.append(Datum(name, value * number.scale, error, number.because, scale if prior else ""))
    return numbers


@cache
def of_readings() -> list[Free]:
    """Parameters of readings of quoted numbers."""
    asked = calibration_file().reading.items()
    return [stated(f"{READING}.{key}={text}", "", paths.shown(paths.CALIBRATION), None, None) for key, text in asked]


def checked(source: str, settings: Sequence[str]) -> tuple[Scene, dict[str, Any], str]:
    """Scene of which the exact motion can be computed, with its tables and file, settings applied.

    Raises:
        InputError: The scene or a setting is unknown, or its exact motion cannot be computed.
    """
    path, scene = find_scene(source), read_scene(source, tuple(settings))
    tables = read_toml(path)
    for setting in settings:
        apply_setting(tables, setting)
    if file := look_up(tables, "drive.file"):
        tables["drive"]["file"] = str((path.parent / file).resolve())
    refuse(build_case(scene), REFERENCE)
    return scene, tables, paths.shown(path)


def scene_data(
    source: str, settings: Sequence[str] = (), file: Path | None = None, *, free_trigger: bool = False
) -> DataSet:
    """Data set of a scene from its ``[[measured]]`` entries, or from one file, which needs no entry.

    Args:
        source: Name of the scene or path of its file.
        settings: Settings applied to the scene.
        file: Measured file that replaces those of the scene.
        free_trigger: True if a stated trigger is free.

    Raises:
        InputError: There is no measured data, or the scene or its data have errors.
    """
    scene, tables, where = checked(source, settings)
    entries, folder, named = entries_of(scene, file, where)
    simulation = exact(build_case(scene))
    gauges, names = gauges_of(simulation.case.layout), [*simulation.values]
    traces = {key: read_measured(entry, folder, gauges, named, key) for key, entry in entries.items() if entry.file}
    numbers = [
        Datum(observable, value, abs(value) * share, divisor=f"{key}.{GAIN}" * observable.endswith("_N"))
        for key, entry in entries.items()
        for observable, (value, share) in read_quoted(entry, names, named, key).items()
    ]
    step_s, duration_s = scene.run.sample_interval, scene.run.duration
    files, triggers = channels_of(traces, duration_s, step_s), dict[str, float]()
    for file in files:
        given_s, key = file[0].trigger_s, file[0].file_key
        triggers[key] = correlated(file, simulation.curves, step_s) if given_s is None else given_s
        if given_s is not None:
            must_overlap(file[0], given_s, duration_s)
    channels = tuple(channel for key in traces for file in files for channel in file if channel.key == key)
    tables.pop("measured", None)
    duration = tables["run"]["duration"]
    if free_trigger or any(channel.trigger_s is None for channel in channels):
        apply_setting(tables, f"run.duration={LONGER * duration_s!r} s")
    more = {"channels": channels, "entries": entries, "triggers": triggers, "step_s": step_s, "duration": duration}
    return DataSet(find_scene(source).stem, source, json.dumps(tables), where, tuple(numbers), **more)


def gauge_parameters(data: DataSet, asked: Sequence[str]) -> list[Free]:
    """Parameters of a data set's gauges: missing triggers, gains with an uncertainty, and requested ones.

    Args:
        data: Data set with its entries.
        asked: Options such as ``measured.0.gain`` or ``measured.0.trigger=10 us..20 us``; without a number it is that
            of all entries.

    Raises:
        InputError: An option names an unknown entry or key, or the trigger of an entry that shares another's.
    """
    channels = {each.key: each for each in data.channels}
    known = dict[str, tuple[str, float, tuple[float, float], float, bool]]()  # unit, start, bounds, prior, free unasked
    for key, entry in data.entries.items():
        channel = channels.get(key)
        gain, unit = (channel.trace.gain, channel.trace.unit) if channel else (1.0, "N")
        prior = entry.gain_uncertainty * abs(gain)
        if channel or any(number.divisor == f"{key}.{GAIN}" for number in data.numbers):
            known[f"{key}.{GAIN}"] = (f"N/{unit}" if unit != "N" else ""), gain, around(gain), prior, prior > 0
        if channel and key in {each.file_key for each in data.channels}:
            known[f"{key}.{TRIGGER}"] = "s", data.triggers[key], channel.window_s, 0.0, channel.trigger_s is None
    options = dict[str, str]()
    for key, text in ((text.partition("=")[0].strip(), text) for text in asked):
        whole = re.fullmatch(rf"{MEASURED}(?:\.0)?\.(\w+)", key)  # .0 of a file without a [[measured]] table
        named = [each for each in known if whole and each.rpartition(".")[2] == whole[1]] if key not in known else [key]
        if not named:
            raise unknown(data.where, "--free", key, known, ", ".join(known) or "none, since the data set has no gauge")
        options |= dict.fromkeys(named, text)
    parameters = list[Free]()
    for key, (unit, start, usual, prior, unasked) in known.items():
        if unasked or key in options:
            text = key + "".join(options.get(key, "").partition("=")[1:])
            free = stated(text, "s" * (unit == "s"), data.where, start, usual, data.name)
            parameters.append(replace(free, unit=unit, prior=free.prior or prior))
    return parameters


def parameters_of(sets: Sequence[DataSet], free: Sequence[str], own: Sequence[str]) -> list[Free]:
    """Free parameters of data sets.

    A data set whose scene lacks the table of a key is without it, unless all are. Prior knowledge of the scene's own
    value (``KEY=±ERROR``) belongs to each data set if these values differ.

    Args:
        sets: Measured data.
        free: Options that name parameters shared by all data sets, and parameters of gauges.
        own: Options that name parameters with a separate value for each data set.

    Raises:
        InputError: A scene lacks a parameter, or a parameter is named twice.
    """
    gauges = [text for text in free if text.startswith(MEASURED)]
    parameters, scenes = list[Free](), {source.name: source.scene for source in sets}
    for text in (text for text in free if text not in gauges):
        key, _, rest = (part.strip() for part in text.partition("="))
        values = {name: look_up(scene, key) for name, scene in scenes.items()}
        having = [each for each in sets if look_up(scenes[each.name], key.rpartition(".")[0]) is not None] or [*sets]
        if rest.startswith(("±", "+")) and len({values[source.name] for source in having}) > 1:
            parameters += [free_parameter(text, scenes[each.name], each.where, each.name) for each in having]
            continue
        first = next((each for each in having if values[each.name] is not None), having[0])
        without = tuple(each.name for each in sets if each not in having)
        parameters.append(replace(free_parameter(text, scenes[first.name], first.where), without=without))
    for source in sets:
        texts = (*source.own, *own)
        parameters += [free_parameter(text, scenes[source.name], source.where, source.name) for text in texts]
        parameters += gauge_parameters(source, gauges)
    numbers = [number for source in sets for number in source.numbers]
    needed = {number.divisor for number in numbers} | {CUT for number in numbers if "_full_width" in number.name}
    parameters += [parameter for parameter in of_readings() if parameter.key in needed - {*sets[0].fixed}]
    names = [(parameter.key, parameter.own) for parameter in parameters]
    for key, own_set in names:
        if names.count((key, own_set)) > 1 or (own_set and (key, "") in names):
            raise InputError(sets[0].where, f"--free {key}", "twice", "each parameter once")
    return parameters
