"""Calibration problem: free parameters of scenes, predictions of the exact motion, residuals and derivatives."""

from collections.abc import Mapping, Sequence
from copy import deepcopy
from dataclasses import dataclass
from functools import lru_cache
from math import inf, nan

import numpy as np

from drivers.base.errors import InputError, RunError
from drivers.chain.case import build_case
from drivers.chain.chain import Array
from drivers.scene.read_scene import make_scene, set_value
from postproc.paper.simulate import Simulation, exact
from postproc.read.observables import describe
from validation.calibration.data_sets import DataSet, MeasuredNumber, gauge_parameters, library
from validation.calibration.free import GAIN, TRIGGER, Free, free_parameter
from validation.calibration.records import Record, residual_of

TOLERANCE = 1e-6  # of the exact motion; observables are then accurate to 2e-9, sensitivities to 1e-4
STEP = 1e-4  # of finite differences, as a share of a parameter's range
MISSING_RESIDUAL = 10.0  # standard errors counted for a number that the computed motion does not have
CACHE_SIZE = 256  # simulations


@dataclass(frozen=True)
class Datum:
    """One datum: a number, the trace of a gauge, or prior knowledge of a parameter.

    Attributes:
        data_set: Name of the data set.
        name: Name of the observable, gauge or parameter.
        rows: Rows of the residual; empty for a datum that is predicted only.
        number: The measured number, if the datum is one.
    """

    data_set: str
    name: str
    rows: range
    number: MeasuredNumber | None = None

    @property
    def label(self) -> str:
        """Name of the data set and of the datum."""
        return f"{self.data_set}: {self.name}" if self.data_set else self.name


@dataclass(frozen=True, eq=False)
class Problem:
    """Data sets and free parameters; ``data`` has the order of the rows of the residual."""

    sets: tuple[DataSet, ...]
    free: tuple[Free, ...]
    data: tuple[Datum, ...]

    @property
    def start(self) -> Array:
        """Coordinates of the starting values. Shape (parameters,)."""
        return np.array([each.coordinate(each.start) for each in self.free])

    @property
    def rows(self) -> int:
        """MeasuredNumber of residuals."""
        return sum(len(datum.rows) for datum in self.data)

    def values(self, place: Array) -> dict[str, float]:
        """Values of the parameters at given coordinates, by label."""
        return {each.label: each.value(float(x)) for each, x in zip(self.free, place, strict=True)}


def pose(sets: Sequence[DataSet], free: Sequence[str], own: Sequence[str] = ()) -> Problem:
    """Problem from data sets and options that name free parameters, with or without bounds.

    Args:
        sets: Measured data.
        free: Parameters shared by all data sets; parameters of gauges belong to one data set.
        own: Parameters with a separate value for each data set, in addition to the data set's own list.

    Raises:
        InputError: a scene lacks an observable or a parameter, or a parameter is named twice.
        RunError: the exact motion cannot be computed at the starting values.
    """
    gauges = [text for text in free if text.startswith("measured")]
    parameters = [free_parameter(text, sets[0].scene, sets[0].where) for text in free if text not in gauges]
    for each in sets:
        parameters += [free_parameter(text, each.scene, each.where, each.name) for text in (*each.own, *own)]
        parameters += gauge_parameters(each, gauges)
    labels = [parameter.label for parameter in parameters]
    for label in labels:
        if labels.count(label) > 1:
            raise InputError(sets[0].where, f"--free {label}", "twice", "each parameter once")
    data, first = list[Datum](), 0
    for each in sets:
        seen = predicted(each, {free.key: free.start for free in parameters if free.own in ("", each.name)})
        if each.numbers and not seen:
            raise RunError(f"{each.where}: the exact motion cannot be computed at the starting values")
        for number in each.numbers:
            if number.observable not in seen:
                raise InputError(each.where, number.observable, f"unknown observable; allowed: {', '.join(seen)}")
            data.append(Datum(each.name, number.observable, range(first, first + number.fitted), number))
            first += number.fitted
        for record in each.records:
            for gauge in record.measured.reading:
                data.append(Datum(each.name, f"{record.key} {gauge}", range(first, first + record.rows)))
                first += record.rows
    for parameter in parameters:
        if parameter.prior:
            data.append(Datum(parameter.own, parameter.key, range(first, first + 1)))
            first += 1
    return Problem(tuple(sets), tuple(parameters), tuple(data))


def own_values(problem: Problem, data: DataSet, place: Array) -> dict[str, float]:
    """Values of the parameters of a data set, by key."""
    pairs = zip(problem.free, place, strict=True)
    return {each.key: each.value(float(x)) for each, x in pairs if each.own in ("", data.name)}


def predicted(data: DataSet, values: Mapping[str, float]) -> dict[str, float]:
    """Observables of a data set's scene at given parameter values; empty if the integration fails."""
    simulation = simulated(data, motion_values(values))
    return {} if simulation is None else dict(simulation.values)


@lru_cache(maxsize=CACHE_SIZE)
def simulated(data: DataSet, values: tuple[tuple[str, float], ...]) -> Simulation | None:
    """Exact motion of a data set's scene at given parameter values; None if the integration fails."""
    tables = deepcopy(data.tables)
    for key, value in values:
        set_value(tables, key, data.text(key, value), data.where)
    try:
        return exact(build_case(make_scene(tables, library(), data.name, data.where)), TOLERANCE)
    except ArithmeticError:
        return None


def has_motion(problem: Problem, place: Array) -> bool:
    """True if the coordinates are finite and the exact motion of each data set can be computed."""
    if not np.isfinite(place).all():
        return False
    return all(simulated(each, motion_values(own_values(problem, each, place))) is not None for each in problem.sets)


def residual(problem: Problem, place: Array) -> Array:
    """Predicted minus measured values in standard errors; inf at a point without a motion. Shape (rows,)."""
    if not has_motion(problem, place):
        return np.full(problem.rows, inf)
    return np.nan_to_num(raw_residual(problem, place), nan=MISSING_RESIDUAL)


def jacobian(problem: Problem, place: Array, moving: Sequence[int] | None = None) -> Array:
    """Derivatives of the residual by the coordinates ``moving``, by finite differences. Shape (rows, moving).

    A parameter of one data set is varied in that data set only. If a number is missing from the motion on one side, the
    derivative is that of the other side; if it is missing on both sides, the derivative is 0.
    """
    moving = range(len(place)) if moving is None else moving
    here, columns = raw_residual(problem, place), np.zeros((problem.rows, len(moving)))
    for column, index in enumerate(moving):
        first = STEP if place[index] + STEP <= 1 else -STEP
        slope = _difference(problem, place, here, index, first)
        lost = np.isnan(slope)
        if lost.any():
            slope[lost] = _difference(problem, place, here, index, -first)[lost]
        columns[:, column] = np.nan_to_num(slope, nan=0.0)
    return columns


def _difference(problem: Problem, place: Array, here: Array, index: int, step: float) -> Array:
    """Difference quotient of the residual for a step of one coordinate."""
    other = place.copy()
    other[index] += step
    return (raw_residual(problem, other) - here) / step


def raw_residual(problem: Problem, place: Array) -> Array:
    """Residual with NaN for numbers missing from the motion; results of each data set are cached."""
    parts = (_of_set(data, tuple(own_values(problem, data, place).items())) for data in problem.sets)
    return np.concatenate([*parts, _priors(problem, place)])


@lru_cache(maxsize=CACHE_SIZE)
def _of_set(data: DataSet, values: tuple[tuple[str, float], ...]) -> Array:
    known = dict(values)
    offs = [(predicted_number(data, each, known) - each.value) / each.error for each in data.numbers if each.fitted]
    return np.concatenate([offs, *(_of_record(data, record, known) for record in data.records)])


def predicted_number(data: DataSet, number: MeasuredNumber, values: Mapping[str, float]) -> float:
    """Prediction of a measured number at given parameter values; NaN if it is missing from the motion.

    A force is divided by the gain of its gauge if the gain is a parameter.
    """
    gain = values.get(f"{number.gain}.{GAIN}", 1.0) if describe(number.observable).unit == "N" else 1.0
    return predicted(data, values).get(number.observable, nan) / gain


def _of_record(data: DataSet, record: Record, values: Mapping[str, float]) -> Array:
    """Residuals of all gauges of a trace. Shape (rows,)."""
    measured, simulation = record.measured, simulated(data, motion_values(values))
    if simulation is None:
        return np.full(record.rows * len(measured.reading), nan)
    gain = values.get(f"{record.key}.{GAIN}", measured.gain)
    trigger_s = values.get(f"{record.key}.{TRIGGER}", record.trigger_s)
    return np.concatenate([residual_of(record, gauge, simulation, gain, trigger_s) for gauge in measured.reading])


def motion_values(values: Mapping[str, float]) -> tuple[tuple[str, float], ...]:
    """Values without gains and triggers of gauges, on which the motion does not depend."""
    return tuple((key, value) for key, value in values.items() if not key.startswith("measured"))


def _priors(problem: Problem, place: Array) -> Array:
    pairs = zip(problem.free, place, strict=True)
    return np.array([(each.value(float(x)) / each.start - 1) / each.prior for each, x in pairs if each.prior])
