"""Calibration problem: measured data of scenes, their exact motions by free parameters, residuals and derivatives.

The data are numbers that the paper quotes, and scenes with measured numbers or traces.
"""

import json
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache
from itertools import accumulate
from math import hypot, inf, nan, sqrt
from pathlib import Path
from typing import Any

import numpy as np

from drivers.base import paths
from drivers.base.errors import InputError, RunError
from drivers.base.units import SI
from drivers.chain.case import build_case
from drivers.chain.chain import Array
from drivers.engines import REFERENCE
from drivers.limits import refuse
from drivers.scene.model import Scene
from drivers.scene.read_scene import DERIVED, apply_settings, find_scene, make_scene, read_scene
from drivers.scene.settings import look_up, setting_texts
from postproc.paper import force_accuracy, quoted
from postproc.read.alignment import Channel, channels_of, correlated, residual_of
from postproc.read.measured import MEASURED, entries_of, read_measured, read_quoted
from postproc.read.motion import Simulation, exact, is_censored, read
from postproc.read.observables import describe
from validation.calibration.parameters import (
    CUT,
    GAIN,
    NUMERICAL_KEYS,
    READING,
    TRIGGER,
    Answer,
    Free,
    QuotedNumber,
    around,
    calibration_file,
    free_parameter,
    of_readings,
    of_scene,
    stated,
    unknown,
)

ALL = "all"  # instead of the name of a data set
DEFAULT_CUT = 0.04  # share of the peak at which the paper cuts widths

# of the exact motion: where forces are wrong by 1e-6, derivatives by differences are by up to 2e-4, and the minimum of
# the paper's fits moves by less than 1e-3 standard errors
TOLERANCE = 1e-6
STEP = 1e-4  # of finite differences, as a share of a parameter's range
LONGER = 2.0  # a run divided by the scene's duration, if a trigger has to be found
MISSING_RESIDUAL = 10.0  # standard errors counted for a number that the computed motion does not have
CACHE_SIZE = 64  # simulations; residuals are smaller

Values = tuple[tuple[str, float], ...]  # values of parameters by key


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
        tables: Tables of the scene in SI units, as JSON: data sets with the same tables share motions.
        where: File as messages name it.
        numbers: Measured numbers.
        own: Keys of free parameters of this data set alone.
        channels: Measured traces of gauges.
        fixed: Values of parameters of readings that are not free, by key.
        settings: Settings applied to the scene.
        gain_errors: Relative standard errors of the gains of entries, by key.
    """

    name: str
    source: str
    tables: str
    where: str
    numbers: tuple[Datum, ...] = ()
    own: tuple[str, ...] = ()
    channels: tuple[Channel, ...] = ()
    fixed: Mapping[str, float] = field(default_factory=dict)
    settings: Sequence[str] = ()
    gain_errors: Mapping[str, float] = field(default_factory=dict)

    @property
    def rows(self) -> int:
        """Number of residuals."""
        return len(self.numbers) + sum(int(channel.counts.sum()) for channel in self.channels)

    @cached_property
    def scene(self) -> Scene:
        """Scene made from the tables."""
        return make_scene(json.loads(self.tables), self.name, self.where, context=SI)


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
        bare = checked(asked.scene, (*asked.set, *settings, *changes))
        skipped = [row for other, row in asked.also.items() if other in names]
        rows = [*zip(*(_column(number, answers) for number in asked.number), strict=True)]
        for row, numbers in enumerate(rows):
            label = f"{name} {numbers[0].value:g} {numbers[0].unit}" if len(rows) > 1 else name
            if row not in skipped:
                data.append(replace(bare, name=label, numbers=numbers, own=asked.own, fixed=fixed))
    return data


def _column(number: QuotedNumber, answers: Sequence[Answer]) -> list[Datum]:
    """Numbers of a list in ``quoted.toml``, or its single number."""
    stored = look_up(quoted().model_dump(), number.quoted)
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


def checked(source: str, settings: Sequence[str]) -> DataSet:
    """Data set without data of a scene of which the exact motion can be computed, with settings applied.

    Raises:
        InputError: The scene or a setting is unknown, or its exact motion cannot be computed.
    """
    scene = read_scene(source, tuple(settings))
    refuse(build_case(scene), REFERENCE)
    tables = scene.model_dump(mode="json", exclude_none=True, exclude={*DERIVED})
    if scene.drive and scene.drive.file:
        tables["drive"]["file"] = str((scene.folder / scene.drive.file).resolve())
    return DataSet(scene.name, source, json.dumps(tables), paths.shown(find_scene(source)), settings=settings)


def scene_data(source: str, settings: Sequence[str] = (), file: Path | None = None) -> DataSet:
    """Data set of a scene from its ``[[measured]]`` entries, or from one file, which needs no entry.

    Args:
        source: Name of the scene or path of its file.
        settings: Settings applied to the scene.
        file: Measured file that replaces those of the scene.

    Raises:
        InputError: There is no measured data, or the scene or its data have errors.
    """
    bare = checked(source, settings)
    entries, folder, named = entries_of(read_scene(source, tuple(settings)), file, bare.where)
    simulation = exact(build_case(bare.scene))
    signals, names = simulation.signals, [*simulation.values]
    traces = [read_measured(entry, folder, signals, named, key) for key, entry in entries.items() if entry.file]
    numbers = tuple(
        Datum(observable, value, abs(value) * share, divisor=f"{key}.{GAIN}" * observable.endswith("_N"))
        for key, entry in entries.items()
        for observable, (value, share) in read_quoted(entry, names, named, key).items()
    )
    channels = tuple(channel for file in channels_of(traces, simulation) for channel in file)
    gain_errors = {f"{key}.{GAIN}": entry.gain_uncertainty for key, entry in entries.items()}
    return replace(bare, numbers=numbers, channels=channels, gain_errors=gain_errors)


def gauge_parameters(data: DataSet, asked: Sequence[str]) -> list[Free]:
    """Parameters of a data set's gauges: missing triggers, gains with an uncertainty, and requested ones.

    Args:
        data: The data set.
        asked: Options such as ``measured.0.gain`` or ``measured.0.trigger=10 us..20 us``; without a number it is that
            of all entries.

    Raises:
        InputError: An option names an unknown entry or key, or the trigger of an entry that shares another's.
    """
    known, found = dict[str, Free](), set[str]()
    for key in (number.divisor for number in data.numbers if number.divisor.startswith(MEASURED)):
        known[key] = Free(key, "", 1.0, *around(1.0), data.name, data.gain_errors[key])
    for channel in data.channels:
        trace, gain, trigger = channel.trace, f"{channel.trace.key}.{GAIN}", f"{channel.file_key}.{TRIGGER}"
        unit, prior = f"N/{trace.unit}" if trace.unit != "N" else "", trace.gain_uncertainty * abs(trace.gain)
        known[gain] = Free(gain, unit, trace.gain, *around(trace.gain), data.name, prior)
        known[trigger] = Free(trigger, "s", channel.trigger_s, *channel.window_s, data.name)
        found |= {trigger} if channel.found else set()
    options = dict[str, str]()
    for text in asked:
        key = text.partition("=")[0].strip()
        named = [each for each in known if key in (each, re.sub(r"\.\d+", "", each))]
        if not named:
            raise unknown(data.where, "--free", key, known, ", ".join(known) or "none, since the data set has no gauge")
        options |= dict.fromkeys(named, text)
    asked_for = {key: free for key, free in known.items() if free.prior or key in found or key in options}
    return [stated(options.get(key, key), free, data.where) for key, free in asked_for.items()]


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
    parameters = list[Free]()
    for text in (text for text in free if text not in gauges):
        key = text.partition("=")[0].strip()
        having = [each for each in sets if look_up(each.scene, key.rpartition(".")[0]) is not None] or [*sets]
        if of_scene(text) and len({look_up(each.scene, key) for each in having}) > 1:
            parameters += [free_parameter(text, each.scene, each.where, each.name) for each in having]
            continue
        first = next((each for each in having if look_up(each.scene, key) is not None), having[0])
        without = tuple(each.name for each in sets if each not in having)
        parameters.append(replace(free_parameter(text, first.scene, first.where), without=without))
    for source in sets:
        texts = (*source.own, *own)
        parameters += [free_parameter(text, source.scene, source.where, source.name) for text in texts]
        parameters += gauge_parameters(source, gauges)
    numbers = [number for source in sets for number in source.numbers]
    needed = {number.divisor for number in numbers} | {CUT for number in numbers if "_full_width" in number.name}
    parameters += [parameter for parameter in of_readings() if parameter.key in needed - {*sets[0].fixed}]
    names = [(parameter.key, parameter.own) for parameter in parameters]
    for key, own_set in names:
        if names.count((key, own_set)) > 1 or (own_set and (key, "") in names):
            raise InputError(sets[0].where, f"--free {key}", "twice", "each parameter once")
    return parameters


@dataclass(frozen=True, eq=False)
class Problem:
    """Data sets and free parameters."""

    sets: tuple[DataSet, ...]
    free: tuple[Free, ...]

    @cached_property
    def data(self) -> list[Datum]:
        """Numbers and traces of the data sets, then prior knowledge, in the order of the rows of the residual."""
        counted = list[tuple[Datum, int]]()
        for source in self.sets:
            counted += [(replace(number, data_set=source.name), 1) for number in source.numbers]
            for channel in source.channels:
                datum = Datum(f"{channel.trace.key} {channel.gauge}", data_set=source.name)
                counted.append((datum, int(channel.counts.sum())))
        counted += [(Datum(free.key, data_set=free.own), 1) for free in self.free if free.prior]
        ends = accumulate(rows for _, rows in counted)
        return [replace(datum, rows=range(end - rows, end)) for (datum, rows), end in zip(counted, ends, strict=True)]

    @property
    def start(self) -> Array:
        """Coordinates of the starting values. Shape (parameters,)."""
        return np.array([free.coordinate(free.start) for free in self.free])

    @property
    def rows(self) -> int:
        """Number of residuals."""
        return sum(len(datum.rows) for datum in self.data)

    @property
    def searched(self) -> list[int]:
        """Indices of the parameters of the motion that all data sets share and that are not known beforehand."""
        return [i for i, free in enumerate(self.free) if free.of_motion and not free.own and not free.prior]

    def values(self, place: Array) -> dict[str, float]:
        """Values of the parameters at given coordinates, by label."""
        return {free.label: free.value(float(x)) for free, x in zip(self.free, place, strict=True)}

    def own_values(self, data: DataSet, place: Array) -> tuple[Values, Values]:
        """Values of the parameters of a data set, by key: those of the motion, then those of gauges and readings."""
        own = [(free, float(x)) for free, x in zip(self.free, place, strict=True) if free.belongs_to(data.name)]
        motion = [(free.key, free.value(x)) for free, x in own if free.of_motion]
        others = [(free.key, free.value(x)) for free, x in own if not free.of_motion]
        return (*motion,), (*others, *data.fixed.items())

    def motion(self, data: DataSet, place: Array) -> Simulation | None:
        """Motion of a data set at given coordinates; None if there is none."""
        return simulated(data.tables, data.where, self.own_values(data, place)[0])

    def residual(self, place: Array) -> Array:
        """Predicted minus measured values in standard errors; inf at a point without a motion. Shape (rows,)."""
        off = self.raw_residual(place) if np.isfinite(place).all() else np.full(self.rows, inf)
        return np.full(self.rows, inf) if np.isinf(off).any() else np.nan_to_num(off, nan=MISSING_RESIDUAL)

    def chi_square(self, place: Array) -> float:
        """Sum of the squared residuals."""
        off = self.residual(place)
        return float(off @ off)

    def jacobian(self, place: Array, moving: Sequence[int] | None = None) -> Array:
        """Derivatives of the residual by the coordinates ``moving``, by differences. Shape (rows, moving).

        The derivative of a number that is missing from the motion on one side is 0.
        """
        here, moving = self.raw_residual(place), range(len(place)) if moving is None else moving
        slopes = np.zeros((len(here), len(moving)))
        for column, index in enumerate(moving):
            other = place.copy()
            other[index] += STEP if place[index] + STEP <= 1 else -STEP
            slopes[:, column] = (self.raw_residual(other) - here) / (other[index] - place[index])
        return np.nan_to_num(slopes, nan=0.0, posinf=0.0, neginf=0.0)

    def raw_residual(self, place: Array) -> Array:
        """Residual with NaN for numbers missing from the motion, inf without one; that of each set is cached."""
        parts = [_of_set(data, *self.own_values(data, place)) for data in self.sets]
        pairs = zip(self.free, place, strict=True)
        priors = [(free.value(float(x)) - free.start) / free.prior for free, x in pairs if free.prior]
        return np.concatenate([*parts, priors])

    def censored(self, datum: Datum, place: Array) -> bool:
        """True for a width of which the force is still above the cut when the wave reaches the wall."""
        gauge, width, _ = datum.name.partition("_full_width")
        if not width:
            return False
        data = next(data for data in self.sets if data.name == datum.data_set)
        simulation, cut = self.motion(data, place), dict(self.own_values(data, place)[1]).get(CUT, DEFAULT_CUT)
        return simulation is not None and is_censored(simulation, gauge, cut)

    def with_triggers(self, place: Array) -> Array:
        """``place`` with the triggers of all data sets at the best correlation of motion and traces."""
        moved, named = place.copy(), {data.name: data for data in self.sets}
        for index, free in enumerate(self.free):
            if free.is_trigger and (simulation := self.motion(named[free.own], place)):
                channels = [each for each in named[free.own].channels if f"{each.file_key}.{TRIGGER}" == free.key]
                moved[index] = free.coordinate(correlated(channels, simulation))
        return moved


def pose(sets: Sequence[DataSet], free: Sequence[str], own: Sequence[str] = ()) -> Problem:
    """Problem from data sets and options that name free parameters, with or without bounds.

    Args:
        sets: Measured data.
        free: Parameters shared by all data sets; parameters of gauges belong to one data set.
        own: Parameters with a separate value for each data set, in addition to the data set's own list.

    Raises:
        InputError: A scene lacks an observable or a parameter, or a parameter is named twice.
        RunError: The exact motion cannot be computed at the starting values.
    """
    parameters = parameters_of(sets, free, own)
    begun = tuple(_begun(source, parameters) for source in sets)
    for source in begun:
        simulation = simulated(source.tables, source.where, ())
        if simulation is None:
            raise RunError(f"{source.where}: the exact motion cannot be computed at the starting values")
        for number in source.numbers:
            read(simulation, number.name, DEFAULT_CUT)  # an unknown observable is refused here
    return Problem(begun, tuple(parameters))


def _begun(data: DataSet, parameters: Sequence[Free]) -> DataSet:
    """Data set whose tables have the starting values; its run is longer if a trigger has to be found.

    Raises:
        InputError: The scene cannot have a bound, such as a restitution of 2.
    """
    moving = [free for free in parameters if free.belongs_to(data.name) and free.of_motion]
    for free in moving:
        for bound in (free.low, free.high):
            make_scene(changed(data.tables, [(free.key, bound)]), data.name, f"--free {free.key}", context=SI)
    tables = changed(data.tables, [(free.key, free.start) for free in moving])
    if any(free.own == data.name and free.is_trigger for free in parameters):
        apply_settings(tables, [f"run.duration={LONGER * data.scene.run.duration!r} s"])
    return replace(data, tables=json.dumps(tables))


def changed(tables: str, values: Iterable[tuple[str, float]]) -> dict[str, Any]:
    """Tables of a scene with other values of some keys."""
    other: dict[str, Any] = json.loads(tables)
    apply_settings(other, setting_texts(dict(values)))
    return other


def exact_numbers(problem: Problem) -> list[Free]:
    """Physical numbers other than 0 of the scenes, and gains, that are not free, as parameters in SI units.

    A number belongs to all data sets if they agree on it.
    """

    def numbers(value: Any, key: str = "") -> Iterator[tuple[str, float]]:
        parts = enumerate(value) if isinstance(value, list) else value.items() if isinstance(value, dict) else ()
        for part, inner in parts:
            yield from numbers(inner, f"{key}.{part}".lstrip("."))
        if isinstance(value, float) and value:
            yield key, value

    exact, sets = list[Free](), problem.sets
    for data in sets:
        scene = data.scene.model_dump(mode="json", exclude_none=True, exclude={*NUMERICAL_KEYS, *DERIVED})
        for key, value in numbers(scene):
            common = all(look_up(each.scene, key) == value for each in sets)
            exact.append(Free(key, "", value, *around(value), own="" if common else data.name))
        gains = {f"{channel.trace.key}.{GAIN}": channel.trace.gain for channel in data.channels}
        exact += [Free(key, "", gain, *around(gain), own=data.name) for key, gain in gains.items()]
    return [free for free in dict.fromkeys(exact) if free.key not in {each.key for each in problem.free}]


@lru_cache(maxsize=CACHE_SIZE)
def simulated(tables: str, where: str, values: Values) -> Simulation | None:
    """Exact motion of a scene at given values of its parameters; None if there is none."""
    try:
        return exact(build_case(make_scene(changed(tables, values), where, where, context=SI)), TOLERANCE)
    except (ArithmeticError, InputError):  # values that are allowed one by one may give an impossible chain
        return None


@lru_cache(maxsize=64 * CACHE_SIZE)
def _of_set(data: DataSet, values: Values, others: Values) -> Array:
    """Residual of a data set at values of the parameters of its motion, and of its gauges and readings."""
    simulation, known = simulated(data.tables, data.where, values), dict(others)
    if simulation is None:
        return np.full(data.rows, inf)
    parts = list[Array]()
    for number in data.numbers:
        reading = read(simulation, number.name, known.get(CUT, DEFAULT_CUT)) / known.get(number.divisor, 1.0)
        parts.append(np.array([(reading - number.value) / number.error]))
    for channel in data.channels:
        gain = known.get(f"{channel.trace.key}.{GAIN}", channel.trace.gain)
        trigger_s = known.get(f"{channel.file_key}.{TRIGGER}", channel.trigger_s)
        parts.append(residual_of(channel, simulation.curves[channel.gauge], gain, trigger_s))
    return np.concatenate(parts)
