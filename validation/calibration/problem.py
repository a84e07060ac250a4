"""A problem of calibration: free parameters of scenes, what the exact motion predicts with them, and residuals."""

from collections.abc import Mapping, Sequence
from copy import deepcopy
from dataclasses import dataclass
from functools import lru_cache
from math import nan

import numpy as np

from drivers.base.errors import InputError
from drivers.chain.case import build_case
from drivers.chain.chain import Array
from drivers.scene.read_scene import make_scene, set_value
from postproc.paper.simulate import Simulation, exact
from postproc.read.observables import describe
from validation.calibration.data_sets import DataSet, Number, gauge_parameters, library
from validation.calibration.free import GAIN, TRIGGER, Free, free_parameter
from validation.calibration.records import Record, residual_of

TOLERANCE = 1e-6  # of the exact motion, whose observables are then good to 2e-9, and sensitivities to 1e-4
STEP = 1e-4  # of a parameter's range, over which sensitivities are taken
NOT_SEEN = 10.0  # standard errors that a number counts which the motion does not show
KEPT = 256  # simulations


@dataclass(frozen=True)
class Datum:
    """Rows of the residual that are one datum: a number, a gauge's trace, or what is known of a parameter beforehand.

    Attributes:
        data_set: its name.
        name: of the observable, the gauge, or the parameter.
        number: where it is one.
        rows: of the residual; empty where it is only predicted.
    """

    data_set: str
    name: str
    rows: range
    number: Number | None = None

    @property
    def label(self) -> str:
        """Data set and name."""
        return f"{self.data_set}: {self.name}" if self.data_set else self.name


@dataclass(frozen=True, eq=False)
class Problem:
    """Data sets and the parameters that are free in them; ``data`` in the order of the residual's rows."""

    sets: tuple[DataSet, ...]
    free: tuple[Free, ...]
    data: tuple[Datum, ...]

    @property
    def start(self) -> Array:
        """Coordinates of the parameters' starts. Shape (parameters,)."""
        return np.array([each.coordinate(each.start) for each in self.free])

    @property
    def rows(self) -> int:
        """Number of residuals."""
        return sum(len(datum.rows) for datum in self.data)

    def values(self, place: Array) -> dict[str, float]:
        """Values of the parameters at a place, by label."""
        return {each.label: each.value(float(x)) for each, x in zip(self.free, place, strict=True)}


def pose(sets: Sequence[DataSet], free: Sequence[str], own: Sequence[str] = ()) -> Problem:
    """The problem of data sets and of options that name free parameters, with bounds or without.

    Args:
        sets: what was measured.
        free: shared by all data sets, but for those of gauges.
        own: free in each data set by itself, beside those that are a data set's own anyway.

    Raises:
        InputError: a scene has no observable of a name, no such parameter, or one is named twice.
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
        for number in each.numbers:
            if number.observable not in seen:
                raise InputError(each.where, number.observable, "no such observable of the scene", ", ".join(seen))
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
    """Values of the parameters that act on a data set, by key."""
    pairs = zip(problem.free, place, strict=True)
    return {each.key: each.value(float(x)) for each, x in pairs if each.own in ("", data.name)}


def predicted(data: DataSet, values: Mapping[str, float]) -> dict[str, float]:
    """Observables of a data set's scene at values of parameters; empty where the motion cannot be followed."""
    simulation = simulated(data, of_motion(values))
    return {} if simulation is None else dict(simulation.values)


@lru_cache(maxsize=KEPT)
def simulated(data: DataSet, values: tuple[tuple[str, float], ...]) -> Simulation | None:
    """The exact motion of a data set's scene at values of parameters; None where it cannot be followed."""
    tables = deepcopy(data.tables)
    for key, value in values:
        set_value(tables, key, data.text(key, value), data.where)
    try:
        return exact(build_case(make_scene(tables, library(), data.name, data.where)), TOLERANCE)
    except ArithmeticError:
        return None


def residual(problem: Problem, place: Array) -> Array:
    """Predicted less measured values in standard errors. Shape (rows,)."""
    return np.nan_to_num(offs(problem, place), nan=NOT_SEEN)


def jacobian(problem: Problem, place: Array, moving: Sequence[int] | None = None) -> Array:
    """Derivatives of the residual by some coordinates, by differences of the exact motion. Shape (rows, moving).

    A parameter that is a data set's own is varied in that set alone. A number that is lost to one side has the
    derivative of the other, one that is not seen has none.
    """
    moving = range(len(place)) if moving is None else moving
    here, columns = offs(problem, place), np.zeros((problem.rows, len(moving)))
    for column, index in enumerate(moving):
        first = STEP if place[index] + STEP <= 1 else -STEP
        slope = _difference(problem, place, here, index, first)
        lost = np.isnan(slope)
        if lost.any():
            slope[lost] = _difference(problem, place, here, index, -first)[lost]
        columns[:, column] = np.nan_to_num(slope, nan=0.0)
    return columns


def _difference(problem: Problem, place: Array, here: Array, index: int, step: float) -> Array:
    """Change of the residual over a step of one coordinate, over the step."""
    other = place.copy()
    other[index] += step
    return (offs(problem, other) - here) / step


def offs(problem: Problem, place: Array) -> Array:
    """The residual, NaN for what is not seen; what was computed for a data set before is kept."""
    parts = (_of_set(data, tuple(own_values(problem, data, place).items())) for data in problem.sets)
    return np.concatenate([*parts, _priors(problem, place)])


@lru_cache(maxsize=KEPT)
def _of_set(data: DataSet, values: tuple[tuple[str, float], ...]) -> Array:
    known = dict(values)
    offs = [(shown(data, each, known) - each.value) / each.error for each in data.numbers if each.fitted]
    return np.concatenate([offs, *(_of_record(data, record, known) for record in data.records)])


def shown(data: DataSet, number: Number, values: Mapping[str, float]) -> float:
    """What stands for a measured number at values of parameters; NaN where the motion does not show it.

    A force is divided by the gauge's gain, where that is a parameter.
    """
    gain = values.get(f"{number.gain}.{GAIN}", 1.0) if describe(number.observable).unit == "N" else 1.0
    return predicted(data, values).get(number.observable, nan) / gain


def _of_record(data: DataSet, record: Record, values: Mapping[str, float]) -> Array:
    """Residuals of all gauges of a trace. Shape (rows,)."""
    measured, simulation = record.measured, simulated(data, of_motion(values))
    if simulation is None:
        return np.full(record.rows * len(measured.reading), nan)
    gain = values.get(f"{record.key}.{GAIN}", measured.gain)
    trigger_s = values.get(f"{record.key}.{TRIGGER}", record.trigger_s)
    return np.concatenate([residual_of(record, gauge, simulation, gain, trigger_s) for gauge in measured.reading])


def of_motion(values: Mapping[str, float]) -> tuple[tuple[str, float], ...]:
    """Values without those of gauges' gains and triggers, which leave the motion as it is."""
    return tuple((key, value) for key, value in values.items() if not key.startswith("measured"))


def _priors(problem: Problem, place: Array) -> Array:
    pairs = zip(problem.free, place, strict=True)
    return np.array([(each.value(float(x)) / each.start - 1) / each.prior for each, x in pairs if each.prior])
