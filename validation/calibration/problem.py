"""Calibration problem: free parameters of scenes, predictions of the exact motion, residuals and derivatives."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from math import inf, nan
from typing import Any

import numpy as np
from scipy.interpolate import BSpline

from drivers.base.errors import InputError, RunError
from drivers.chain.case import Case, build_case
from drivers.chain.chain import Array, build_chain
from drivers.chain.schemes import exact_motion, trace_of
from drivers.chain.trace import Trace
from drivers.engines import REFERENCE
from drivers.scene.read_scene import make_scene, set_value
from postproc.read.observables import describe
from validation.calibration.calibration_file import Answer
from validation.calibration.data_sets import CUT, DataSet, MeasuredNumber, gauge_parameters, nuisances, text_of
from validation.calibration.free import GAIN, TRIGGER, Free, free_parameter
from validation.calibration.readings import DEFAULT_CUT, READERS, Waves, best_trigger_s, curves_of, read, residual_of

# of the exact motion: where forces are wrong by 1e-6, derivatives by differences are by up to 2e-4, and the minimum of
# the paper's fits moves by less than 1e-3 standard errors
TOLERANCE = 1e-6
STEP = 1e-4  # of finite differences, as a share of a parameter's range
MISSING_RESIDUAL = 10.0  # standard errors counted for a number that the computed motion does not have
CACHE_SIZE = 256  # simulations; residuals are smaller
SCANNED = 8  # values of a parameter that one data set has alone, at the start of a descent

Values = tuple[tuple[str, float], ...]  # values of parameters by key


@dataclass(frozen=True)
class Datum:
    """One datum: a number, the trace of a gauge, or prior knowledge of a parameter.

    Attributes:
        data_set: Name of the data set.
        name: Name of the observable, gauge or parameter.
        rows: Rows of the residual.
        number: The measured number, if the datum is one.
    """

    data_set: str
    name: str
    rows: range
    number: MeasuredNumber | None = None


@dataclass(frozen=True, eq=False)
class Problem:
    """Data sets and free parameters; ``data`` has the order of the rows of the residual.

    Attributes:
        fixed: Values of parameters of readings that are not free, by key.
    """

    sets: tuple[DataSet, ...]
    free: tuple[Free, ...]
    data: tuple[Datum, ...]
    fixed: Mapping[str, float] = field(default_factory=dict)

    @property
    def start(self) -> Array:
        """Coordinates of the starting values. Shape (parameters,)."""
        return np.array([free.coordinate(free.start) for free in self.free])

    @property
    def rows(self) -> int:
        """Number of residuals."""
        return sum(len(datum.rows) for datum in self.data)

    @property
    def lines(self) -> int:
        """Number of coefficients of the base lines fitted to the traces."""
        return sum(data.lines for data in self.sets)

    @property
    def searched(self) -> list[int]:
        """Indices of the parameters of the motion that all data sets share and that are not known beforehand."""
        return [i for i, free in enumerate(self.free) if free.of_motion and not free.own and not free.prior]

    def values(self, place: Array) -> dict[str, float]:
        """Values of the parameters at given coordinates, by label."""
        return {free.label: free.value(float(x)) for free, x in zip(self.free, place, strict=True)}


def pose(
    sets: Sequence[DataSet], free: Sequence[str], own: Sequence[str] = (), answers: Sequence[Answer] = ()
) -> Problem:
    """Problem from data sets and options that name free parameters, with or without bounds.

    Args:
        sets: Measured data.
        free: Parameters shared by all data sets; parameters of gauges belong to one data set.
        own: Parameters with a separate value for each data set, in addition to the data set's own list.
        answers: Readings of the sentences that the paper leaves open.

    Raises:
        InputError: A scene lacks an observable or a parameter, or a parameter is named twice.
        RunError: The exact motion cannot be computed at the starting values.
    """
    gauges = [text for text in free if text.startswith("measured")]
    parameters = [free_parameter(text, sets[0].scene, sets[0].where) for text in free if text not in gauges]
    for source in sets:
        parameters += [free_parameter(text, source.scene, source.where, source.name) for text in (*source.own, *own)]
        parameters += gauge_parameters(source, gauges)
    of_readings, fixed = nuisances(sets, answers)
    parameters += of_readings
    names = [(parameter.key, parameter.own) for parameter in parameters]
    for key, own_set in names:
        if names.count((key, own_set)) > 1 or (own_set and (key, "") in names):
            raise InputError(sets[0].where, f"--free {key}", "twice", "each parameter once")
    for source in sets:
        _refuse_ends(source, [free for free in parameters if free.own in ("", source.name) and free.of_motion])
    data, first = list[Datum](), 0

    def add(data_set: str, name: str, rows: int, number: MeasuredNumber | None = None) -> None:
        nonlocal first
        data.append(Datum(data_set, name, range(first, first + rows), number))
        first += rows

    begun = [_begun(source, parameters) for source in sets]
    for source in begun:
        simulation = simulated(source, ())
        if simulation is None:
            raise RunError(f"{source.where}: the exact motion cannot be computed at the starting values")
        for number in source.numbers:
            read(simulation, number.observable, DEFAULT_CUT)  # an unknown observable is refused here
            add(source.name, number.observable, 1, number)
        for record in source.records:
            for gauge in record.measured.reading:
                add(source.name, f"{record.key} {gauge}", record.rows)
    for parameter in parameters:
        if parameter.prior:
            add(parameter.own, parameter.key, 1)
    return Problem(tuple(begun), tuple(parameters), tuple(data), fixed)


def _begun(data: DataSet, parameters: Sequence[Free]) -> DataSet:
    """Data set whose tables have the starting values."""
    tables = json.loads(data.tables)
    for free in parameters:
        if free.own in ("", data.name) and free.of_motion:
            set_value(tables, free.key, text_of(free.key, free.start), data.where)
    return replace(data, tables=json.dumps(tables))


def _refuse_ends(data: DataSet, free: Sequence[Free]) -> None:
    """Refuses bounds that are no values of a scene, such as a restitution of 2."""
    for parameter in free:
        for value in (parameter.low, parameter.high):
            tables = json.loads(data.tables)
            set_value(tables, parameter.key, text_of(parameter.key, value), data.where)
            make_scene(tables, data.name, f"--free {parameter.key}")


def own_values(problem: Problem, data: DataSet, place: Array) -> dict[str, float]:
    """Values of the parameters of a data set, by key."""
    pairs = zip(problem.free, place, strict=True)
    values = {free.key: free.value(float(x)) for free, x in pairs if free.own in ("", data.name)}
    return values | dict(problem.fixed)


def motion_values(problem: Problem, data: DataSet, place: Array) -> Values:
    """Values of the parameters of a data set on which its motion depends."""
    pairs = zip(problem.free, place, strict=True)
    return tuple(
        (free.key, free.value(float(x))) for free, x in pairs if free.own in ("", data.name) and free.of_motion
    )


def simulated(data: DataSet, values: Values, *, whole: bool = False) -> Waves | None:
    """Exact motion of a data set's scene at given parameter values; None if the integration fails.

    Its trace has energies only if ``whole``, or if numbers of the data set are not read from waves.
    """
    names = [number.observable for number in data.numbers]
    of_waves = all(describe(name).of_wave or name.endswith(tuple(READERS)) for name in names)
    return _integrated(data.tables, data.where, values, whole or not of_waves)


@lru_cache(maxsize=CACHE_SIZE)
def _integrated(tables: str, where: str, values: Values, whole: bool) -> Waves | None:
    case = _case(tables, where)
    scene = case.scene
    for key, value in values:
        scene = _changed(scene, key.split("."), value)
    case = build_case(scene) if whole else replace(case, scene=scene, chain=build_chain(scene))
    times = case.sample_times_s
    try:
        motion = exact_motion(case, TOLERANCE, times)
    except ArithmeticError:
        return None
    energies = np.full((3, len(times)), nan)
    trace = trace_of(case, times, motion) if whole else Trace(times, motion.force_N, *energies)
    return Waves(case, REFERENCE, trace)


@lru_cache(maxsize=CACHE_SIZE)
def _case(tables: str, where: str) -> Case:
    return build_case(make_scene(json.loads(tables), where, where))


def _changed(part: Any, keys: Sequence[str], value: float) -> Any:
    """Copy of a scene, or of a part of it, with another value of a key, which is not checked."""
    name, *rest = keys
    if isinstance(part, tuple):
        return tuple(_changed(each, rest, value) if str(i) == name else each for i, each in enumerate(part))
    if isinstance(part, dict):
        return part | {name: _changed(part[name], rest, value)}
    return part.model_copy(update={name: _changed(getattr(part, name), rest, value) if rest else value})


@lru_cache(maxsize=CACHE_SIZE)
def curves(data: DataSet, values: Values) -> dict[str, BSpline]:
    """Splines of the computed gauge signals; empty if the integration fails."""
    simulation = simulated(data, values)
    return {} if simulation is None else curves_of(simulation)


def has_motion(problem: Problem, place: Array) -> bool:
    """True if the coordinates are finite and the exact motion of each data set can be computed."""
    return bool(np.isfinite(residual(problem, place)).all())


def residual(problem: Problem, place: Array) -> Array:
    """Predicted minus measured values in standard errors; inf at a point without a motion. Shape (rows,)."""
    off = raw_residual(problem, place) if np.isfinite(place).all() else np.full(problem.rows, inf)
    return np.full(problem.rows, inf) if np.isinf(off).any() else np.nan_to_num(off, nan=MISSING_RESIDUAL)


def jacobian(problem: Problem, place: Array, moving: Sequence[int] | None = None) -> Array:
    """Derivatives of the residual by the coordinates ``moving``, by differences. Shape (rows, moving).

    The derivative of a number that is missing from the motion on one side is 0.
    """
    moving = range(len(place)) if moving is None else moving
    here, columns = raw_residual(problem, place), []
    for index in moving:
        other = place.copy()
        other[index] += STEP if place[index] + STEP <= 1 else -STEP
        columns.append((raw_residual(problem, other) - here) / (other[index] - place[index]))
    return np.asarray(np.nan_to_num(np.column_stack(columns), nan=0.0, posinf=0.0, neginf=0.0))


def raw_residual(problem: Problem, place: Array) -> Array:
    """Residual with NaN for numbers missing from the motion, inf without one; results of each data set are cached."""
    parts = [
        _of_set(data, motion_values(problem, data, place), tuple(own_values(problem, data, place).items()))
        for data in problem.sets
    ]
    pairs = zip(problem.free, place, strict=True)
    priors = [(free.value(float(x)) - free.start) / free.prior for free, x in pairs if free.prior]
    return np.concatenate([*parts, priors])


@lru_cache(maxsize=16 * CACHE_SIZE)
def _of_set(data: DataSet, motion: Values, values: Values) -> Array:
    """Residual of a data set."""
    if simulated(data, motion) is None:
        return np.full(data.rows, inf)
    known = dict(values)
    offs = [(predicted(data, number, motion, known) - number.value) / number.error for number in data.numbers]
    traces, signals = list[Array](), curves(data, motion) if data.records else {}
    for record in data.records:
        gain = known.get(f"{record.key}.{GAIN}", record.measured.gain)
        trigger_s = known.get(f"{record.trigger_key}.{TRIGGER}", record.trigger_s)
        for gauge in record.measured.reading:
            assert trigger_s is not None  # given, or a free parameter
            traces.append(residual_of(record, gauge, signals[gauge], gain, trigger_s))
    return np.concatenate([offs, *traces])


def predicted(data: DataSet, number: MeasuredNumber, motion: Values, values: Mapping[str, float]) -> float:
    """Prediction of a measured number at given parameter values; NaN if it is missing from the motion."""
    simulation = simulated(data, motion)
    if simulation is None:
        return nan
    return read(simulation, number.observable, values.get(CUT, DEFAULT_CUT)) / values.get(number.divisor, 1.0)


def scanned(problem: Problem, place: Array) -> Array:
    """``place`` with the best of ``SCANNED`` values of each parameter of the motion that one data set has alone."""
    moved = place.copy()
    for data in problem.sets:
        for index, free in enumerate(problem.free):
            if free.own == data.name and free.of_motion:
                heights = []
                for x in (place[index], *np.linspace(0.0, 1.0, SCANNED)):
                    moved[index] = x
                    here = with_triggers(problem, moved, [data])
                    motion = motion_values(problem, data, here)
                    off = _of_set(data, motion, tuple(own_values(problem, data, here).items()))
                    heights.append((float(np.sum(np.nan_to_num(off, nan=MISSING_RESIDUAL) ** 2)), float(x)))
                moved[index] = min(heights)[1]
    return moved


def with_triggers(problem: Problem, place: Array, sets: Sequence[DataSet] | None = None) -> Array:
    """``place`` with the triggers of all or of some data sets at which the motion fits the traces best."""
    moved = place.copy()
    for data in problem.sets if sets is None else sets:
        signals = curves(data, motion_values(problem, data, place)) if data.records else {}
        values = own_values(problem, data, place)
        for index, free in enumerate(problem.free):
            if signals and free.own == data.name and free.key.endswith(f".{TRIGGER}"):
                records = [record for record in data.records if f"{record.trigger_key}.{TRIGGER}" == free.key]
                gains = {record.key: values.get(f"{record.key}.{GAIN}", record.measured.gain) for record in records}
                moved[index] = free.coordinate(best_trigger_s(records, signals, gains))
    return moved
