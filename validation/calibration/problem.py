"""Calibration problem: readings of the exact motion of scenes, residuals by free parameters, and their derivatives.

Observables of ``postproc.read.observables`` follow the printed paper: a duration is twice the rise, an envelope passes
through a list of maxima. A duration of that kind cannot fail, and a list of maxima changes by jumps. Least squares need
readings that change continuously with the parameters:

- the full width at a cut is the time for which the gauge is above this share of its peak before the wave reaches
  the wall. If the force has not fallen so low until then, the width is censored: this time is its lower bound;
- the decay at the wall is the rate of the lowest exponential above the force, from the first maximum at t1 until
  1.75 t1, which is the third maximum of the elastic chain of Fig. 5. It is the expectile of ``log F`` with the
  asymmetry ``ABOVE`` (Newey & Powell, Econometrica 55, 819): a least-squares line on which a point above it weighs
  ``ABOVE / (1 - ABOVE)`` times as much as one below. The elastic chain of 1.46 GPa gives -0.00590 per us, the paper
  -0.0059.
"""

import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from math import inf, nan
from typing import Any

import numpy as np
from scipy.interpolate import BSpline, make_interp_spline

from drivers.base.errors import InputError, RunError
from drivers.chain.case import Case, build_case
from drivers.chain.chain import Array, build_chain
from drivers.chain.schemes import exact_motion, trace_of
from drivers.chain.trace import Trace
from drivers.engines import REFERENCE
from drivers.scene.read_scene import make_scene, set_value
from drivers.scene.settings import unit_of
from postproc.paper.simulate import Simulation
from postproc.read.alignment import correlated, residual_of
from postproc.read.observables import describe
from postproc.read.sensors import sensor_signals
from postproc.read.signals import first_peak
from validation.calibration.data import (
    CUT,
    GAIN,
    READING,
    TRIGGER,
    Answer,
    DataSet,
    Datum,
    Free,
    free_parameter,
    gauge_parameters,
    of_readings,
)

ABOVE = 0.999  # asymmetry of the expectile
WINDOW = 0.75  # of the arrival time at the wall, after the first maximum
POINTS = 301  # of the window
FLOOR = 1e-3  # of the first maximum: lower forces count as this
MAX_ROUNDS = 100  # of the expectile
CUBIC = np.linalg.inv(np.vander(np.arange(4.0), increasing=True))  # coefficients from values at 0, 1, 2, 3
NEWTON_STEPS = 3
DEFAULT_CUT = 0.04  # share of the peak at which the paper cuts widths

# of the exact motion: where forces are wrong by 1e-6, derivatives by differences are by up to 2e-4, and the minimum of
# the paper's fits moves by less than 1e-3 standard errors
TOLERANCE = 1e-6
STEP = 1e-4  # of finite differences, as a share of a parameter's range
MISSING_RESIDUAL = 10.0  # standard errors counted for a number that the computed motion does not have
CACHE_SIZE = 256  # simulations; residuals are smaller
SCANNED = 8  # values of a parameter that one data set has alone, at the start of a descent

Values = tuple[tuple[str, float], ...]  # values of parameters by key


def full_width_s(simulation: Simulation, gauge: str, cut: float) -> float:
    """Full width of the first pulse in s, or its lower bound; NaN if a pulse is missing."""
    values, signal = simulation.first, simulation.signals[gauge]
    level, end_s = cut * values[f"{gauge}_amplitude_N"], values["wall_arrival_s"]
    return time_above(simulation.trace.time_s, signal - signal[0], level, end_s)


def is_censored(simulation: Simulation, gauge: str, cut: float) -> bool:
    """True if the force is still above the cut when the wave reaches the wall."""
    values, signal = simulation.first, simulation.signals[gauge]
    last = np.interp(values["wall_arrival_s"], simulation.trace.time_s, signal - signal[0])
    return bool(last > cut * values[f"{gauge}_amplitude_N"])


def time_above(time_s: Array, signal: Array, level: float, end_s: float) -> float:
    """Time before ``end_s`` for which a signal, sampled at equal intervals, is above a level.

    Crossings are those of the cubic through four samples: that of a straight line would have kinks.
    """
    if not np.isfinite(level + end_s):
        return nan
    above, step_s = signal - level, float(time_s[1])
    places = np.flatnonzero((above[:-1] > 0) != (above[1:] > 0))
    crossings = np.array([step_s * (place + _root(above, int(place))) for place in places])
    ends = np.concatenate([[0.0], crossings[crossings < end_s], [end_s]])
    return float(np.diff(ends)[int(above[0] <= 0) :: 2].sum())


def _root(values: Array, place: int) -> float:
    """Share of the interval after a sample at which the cubic through four samples is zero, by Newton's method."""
    first = min(max(place - 1, 0), len(values) - 4)
    a, b, c, d = (CUBIC @ values[first : first + 4]).tolist()
    share = place - first + float(values[place] / (values[place] - values[place + 1]))
    for _ in range(NEWTON_STEPS):
        share -= (a + share * (b + share * (c + share * d))) / (b + share * (2 * c + share * 3 * d))
    return min(max(share - (place - first), 0.0), 1.0)


def contact_force_N(simulation: Simulation, gauge: str, cut: float) -> float:
    """The paper's F_m of Eq. (6): beta times the gauge's amplitude plus the static load of the contact above the bead.

    The factor beta, amplitude at that contact divided by that of the mean of both contacts, is of the same motion.
    """
    layout, trace = simulation.case.layout, simulation.trace
    force_N = trace.force_N[:, int(gauge.removeprefix("bead_"))]
    plain = sensor_signals(replace(layout, time_constant_s=None), trace)[gauge]
    contact, mean = (first_peak(trace.time_s, signal - signal[0]) for signal in (force_N, plain))
    if contact is None or mean is None:
        return nan
    return float(contact.value / mean.value * simulation.first[f"{gauge}_amplitude_N"] + force_N[0])


def decay_per_s(simulation: Simulation, gauge: str, cut: float) -> float:
    """Rate of the lowest exponential above the force at a gauge in 1/s; NaN if the motion ends before."""
    trace, first_s = simulation.trace, simulation.first[f"{gauge}_arrival_s"]
    times = first_s * np.linspace(1.0, 1.0 + WINDOW, POINTS)
    if not times[-1] <= trace.time_s[-1]:
        return nan
    force = make_interp_spline(trace.time_s, simulation.signals[gauge], k=3)(times)
    level = np.log(np.maximum(force / force[0], FLOOR))
    late, weight, slope = times - first_s, np.ones(POINTS), nan
    for _ in range(MAX_ROUNDS):
        middle, height = weight @ late / weight.sum(), weight @ level / weight.sum()
        slope = float((weight * (late - middle)) @ level / ((weight * (late - middle)) @ late))
        changed = np.where(level > height + slope * (late - middle), ABOVE, 1 - ABOVE)
        if np.array_equal(changed, weight):
            break
        weight = changed
    return slope


READERS: dict[str, Callable[[Simulation, str, float], float]] = {
    "_full_width_s": full_width_s,
    "_contact_force_N": contact_force_N,
    "_decay_per_s": decay_per_s,
}


def read(simulation: Simulation, name: str, cut: float) -> float:
    """A reading, or an observable, of a motion by its name with the unit; NaN if the motion does not show it.

    Raises:
        InputError: The scene's runs have neither.
    """
    for ending, reader in READERS.items():
        if name.endswith(ending):
            return reader(simulation, name.removesuffix(ending), cut)
    return simulation.first[name] if name in simulation.first else simulation.values[name]


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
    def searched(self) -> list[int]:
        """Indices of the parameters of the motion that all data sets share and that are not known beforehand."""
        return [i for i, free in enumerate(self.free) if free.of_motion and not free.own and not free.prior]

    def values(self, place: Array) -> dict[str, float]:
        """Values of the parameters at given coordinates, by label."""
        return {free.label: free.value(float(x)) for free, x in zip(self.free, place, strict=True)}

    def own_values(self, data: DataSet, place: Array) -> dict[str, float]:
        """Values of the parameters of a data set, by key."""
        pairs = zip(self.free, place, strict=True)
        return {free.key: free.value(float(x)) for free, x in pairs if free.own in ("", data.name)} | dict(self.fixed)

    def motion_values(self, data: DataSet, place: Array) -> Values:
        """Values of the parameters of a data set on which its motion depends."""
        moving = {free.key for free in self.free if free.of_motion}
        return tuple((key, value) for key, value in self.own_values(data, place).items() if key in moving)


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
    numbers = [number for source in sets for number in source.numbers]
    needed = {number.divisor for number in numbers} | {CUT for number in numbers if "_full_width" in number.name}
    fixed = {f"{READING}.{key}": value for answer in answers for key, value in answer.fixed.items()}
    parameters += [parameter for parameter in of_readings() if parameter.key in needed and parameter.key not in fixed]
    names = [(parameter.key, parameter.own) for parameter in parameters]
    for key, own_set in names:
        if names.count((key, own_set)) > 1 or (own_set and (key, "") in names):
            raise InputError(sets[0].where, f"--free {key}", "twice", "each parameter once")
    begun, data = [_begun(source, parameters) for source in sets], list[Datum]()
    for source in begun:
        simulation = simulated(source, ())
        if simulation is None:
            raise RunError(f"{source.where}: the exact motion cannot be computed at the starting values")
        for number in source.numbers:
            read(simulation, number.name, DEFAULT_CUT)  # an unknown observable is refused here
            _add(data, replace(number, data_set=source.name), 1)
        for channel in source.channels:
            _add(data, Datum(f"{channel.key} {channel.gauge}", data_set=source.name), int(channel.counts.sum()))
    for parameter in (parameter for parameter in parameters if parameter.prior):
        _add(data, Datum(parameter.key, data_set=parameter.own), 1)
    return Problem(tuple(begun), tuple(parameters), tuple(data), fixed)


def _add(data: list[Datum], datum: Datum, rows: int) -> None:
    """Add a datum with the next rows of the residual."""
    first = data[-1].rows.stop if data else 0
    data.append(replace(datum, rows=range(first, first + rows)))


def _begun(data: DataSet, parameters: Sequence[Free]) -> DataSet:
    """Data set whose tables have the starting values; refuses bounds such as a restitution of 2."""
    tables = json.loads(data.tables)
    for free in parameters:
        if free.own in ("", data.name) and free.of_motion:
            for bound in (free.low, free.high):
                changed = json.loads(data.tables)
                set_value(changed, free.key, _as_text(free.key, bound), data.where)
                make_scene(changed, data.name, f"--free {free.key}")
            set_value(tables, free.key, _as_text(free.key, free.start), data.where)
    return replace(data, tables=json.dumps(tables))


def _as_text(key: str, value: float) -> Any:
    """A value as in a scene file: text with its unit, or a plain number."""
    unit = unit_of(key)
    return f"{value!r} {unit}" if unit else value


def simulated(data: DataSet, values: Values, *, whole: bool = False) -> Simulation | None:
    """Exact motion of a data set's scene at given parameter values; None if the integration fails.

    Its trace has energies only if ``whole``, or if numbers of the data set are not read from waves.
    """
    names = [number.name for number in data.numbers]
    of_waves = all(describe(name).of_wave or name.endswith(tuple(READERS)) for name in names)
    return _integrated(data.tables, data.where, values, whole or not of_waves)


@lru_cache(maxsize=CACHE_SIZE)
def _integrated(tables: str, where: str, values: Values, whole: bool) -> Simulation | None:
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
    return Simulation(case, REFERENCE, trace)


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
    """Splines of the changes of the computed gauge signals; empty if the integration fails."""
    simulation = simulated(data, values) if data.channels else None
    if simulation is None:
        return {}
    time_s, signals = simulation.trace.time_s, simulation.signals
    return {gauge: make_interp_spline(time_s, signal - signal[0], k=5) for gauge, signal in signals.items()}


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
    here = raw_residual(problem, place)
    columns = [(raw_residual(problem, other) - here) / step for other, step in stepped(place, moving)]
    return np.asarray(np.nan_to_num(np.column_stack(columns), nan=0.0, posinf=0.0, neginf=0.0))


def stepped(place: Array, moving: Sequence[int] | None = None) -> Iterator[tuple[Array, float]]:
    """Coordinates after a step of each coordinate, and the step."""
    for index in range(len(place)) if moving is None else moving:
        other = place.copy()
        other[index] += STEP if place[index] + STEP <= 1 else -STEP
        yield other, float(other[index] - place[index])


def raw_residual(problem: Problem, place: Array) -> Array:
    """Residual with NaN for numbers missing from the motion, inf without one; results of each data set are cached."""
    parts = [residual_of_set(problem, data, place) for data in problem.sets]
    pairs = zip(problem.free, place, strict=True)
    priors = [(free.value(float(x)) - free.start) / free.prior for free, x in pairs if free.prior]
    return np.concatenate([*parts, priors])


def residual_of_set(problem: Problem, data: DataSet, place: Array) -> Array:
    """Raw residual of a data set."""
    return _of_set(data, problem.motion_values(data, place), tuple(problem.own_values(data, place).items()))


@lru_cache(maxsize=16 * CACHE_SIZE)
def _of_set(data: DataSet, motion: Values, values: Values) -> Array:
    simulation = simulated(data, motion)
    if simulation is None:
        return np.full(data.rows, inf)
    known, signals, cut = dict(values), curves(data, motion), dict(values).get(CUT, DEFAULT_CUT)
    offs = [
        (read(simulation, number.name, cut) / known.get(number.divisor, 1.0) - number.value) / number.error
        for number in data.numbers
    ]
    traces = list[Array]()
    for channel in data.channels:
        gain = known.get(f"{channel.key}.{GAIN}", channel.trace.gain)
        trigger_s = known.get(f"{channel.file_key}.{TRIGGER}", channel.trigger_s)
        assert trigger_s is not None  # given, or a free parameter
        traces.append(residual_of(channel, signals[channel.gauge], gain, trigger_s))
    return np.concatenate([offs, *traces])


def censored(problem: Problem, datum: Datum, place: Array) -> bool:
    """True for a width of which the force is still above the cut when the wave reaches the wall."""
    gauge, width, _ = datum.name.partition("_full_width")
    data = next(data for data in problem.sets if data.name == datum.data_set) if width else problem.sets[0]
    simulation = simulated(data, problem.motion_values(data, place)) if width else None
    cut = problem.own_values(data, place).get(CUT, DEFAULT_CUT)
    return simulation is not None and is_censored(simulation, gauge, cut)


def scanned(problem: Problem, place: Array) -> Array:
    """``place`` with the best of ``SCANNED`` values of each parameter of the motion that one data set has alone."""
    moved = place.copy()
    for data in problem.sets:
        for index, free in enumerate(problem.free):
            if free.own == data.name and free.of_motion:
                heights = []
                for x in (place[index], *np.linspace(0.0, 1.0, SCANNED)):
                    moved[index] = x
                    off = residual_of_set(problem, data, with_triggers(problem, moved, [data]))
                    heights.append((float(np.sum(np.nan_to_num(off, nan=MISSING_RESIDUAL) ** 2)), float(x)))
                moved[index] = min(heights)[1]
    return moved


def with_triggers(problem: Problem, place: Array, sets: Sequence[DataSet] | None = None) -> Array:
    """``place`` with the triggers of all or of some data sets at the best correlation of motion and traces."""
    moved = place.copy()
    for data in problem.sets if sets is None else sets:
        signals = curves(data, problem.motion_values(data, place))
        for index, free in enumerate(problem.free):
            if signals and free.own == data.name and free.key.endswith(f".{TRIGGER}"):
                channels = [channel for channel in data.channels if f"{channel.file_key}.{TRIGGER}" == free.key]
                moved[index] = free.coordinate(correlated(channels, signals, data.step_s))
    return moved
