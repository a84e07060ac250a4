"""Calibration problem: exact motions of scenes by free parameters, residuals and their derivatives."""

import json
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from itertools import accumulate
from math import inf
from typing import Any

import numpy as np

from drivers.base.errors import InputError, RunError
from drivers.chain.case import build_case
from drivers.chain.chain import Array
from drivers.scene.read_scene import apply_setting, make_scene, set_value
from drivers.scene.settings import DERIVED, look_up, unit_of
from postproc.read.alignment import correlated, residual_of
from postproc.read.motion import Simulation, exact, is_censored, read
from validation.calibration.data import GAIN, TRIGGER, DataSet, Datum, parameters_of
from validation.calibration.parameters import CUT, NUMERICAL_KEYS, Free, around

DEFAULT_CUT = 0.04  # share of the peak at which the paper cuts widths

# of the exact motion: where forces are wrong by 1e-6, derivatives by differences are by up to 2e-4, and the minimum of
# the paper's fits moves by less than 1e-3 standard errors
TOLERANCE = 1e-6
STEP = 1e-4  # of finite differences, as a share of a parameter's range
LONGER = 2.0  # a run divided by the scene's duration, if a trigger has to be found
MISSING_RESIDUAL = 10.0  # standard errors counted for a number that the computed motion does not have
CACHE_SIZE = 64  # simulations; residuals are smaller
SCANNED = 8  # values of a parameter that one data set has alone, at the start of a descent

Values = tuple[tuple[str, float], ...]  # values of parameters by key


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
                datum = Datum(f"{channel.key} {channel.gauge}", data_set=source.name)
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

    def own_values(self, data: DataSet, place: Array) -> dict[str, float]:
        """Values of the parameters of a data set, by key."""
        pairs = zip(self.free, place, strict=True)
        return {free.key: free.value(float(x)) for free, x in pairs if free.belongs_to(data.name)} | dict(data.fixed)

    def motion(self, data: DataSet, place: Array) -> Simulation | None:
        """Motion of a data set at given coordinates; None if there is none."""
        return simulated(data, self.motion_values(data, place))

    def motion_values(self, data: DataSet, place: Array) -> Values:
        """Values of the parameters of a data set on which its motion depends."""
        moving = {free.key for free in self.free if free.of_motion}
        return tuple((key, value) for key, value in self.own_values(data, place).items() if key in moving)

    def residual(self, place: Array) -> Array:
        """Predicted minus measured values in standard errors; inf at a point without a motion. Shape (rows,)."""
        off = self.raw_residual(place) if np.isfinite(place).all() else np.full(self.rows, inf)
        return np.full(self.rows, inf) if np.isinf(off).any() else np.nan_to_num(off, nan=MISSING_RESIDUAL)

    def jacobian(self, place: Array, moving: Sequence[int] | None = None) -> Array:
        """Derivatives of the residual by the coordinates ``moving``, by differences. Shape (rows, moving).

        The derivative of a number that is missing from the motion on one side is 0.
        """
        here, columns = self.raw_residual(place), list[Array]()
        for index in range(len(place)) if moving is None else moving:
            other = place.copy()
            other[index] += STEP if place[index] + STEP <= 1 else -STEP
            columns.append((self.raw_residual(other) - here) / (other[index] - place[index]))
        return np.asarray(np.nan_to_num(np.column_stack(columns), nan=0.0, posinf=0.0, neginf=0.0))

    def raw_residual(self, place: Array) -> Array:
        """Residual with NaN for numbers missing from the motion, inf without one; that of each set is cached."""
        parts = [self.residual_of_set(data, place) for data in self.sets]
        pairs = zip(self.free, place, strict=True)
        priors = [(free.value(float(x)) - free.start) / free.prior for free, x in pairs if free.prior]
        return np.concatenate([*parts, priors])

    def residual_of_set(self, data: DataSet, place: Array) -> Array:
        """Raw residual of a data set."""
        return _of_set(data, self.motion_values(data, place), tuple(self.own_values(data, place).items()))

    def censored(self, datum: Datum, place: Array) -> bool:
        """True for a width of which the force is still above the cut when the wave reaches the wall."""
        gauge, width, _ = datum.name.partition("_full_width")
        data = next(data for data in self.sets if data.name == datum.data_set) if width else self.sets[0]
        simulation = self.motion(data, place) if width else None
        cut = self.own_values(data, place).get(CUT, DEFAULT_CUT)
        return simulation is not None and is_censored(simulation, gauge, cut)

    def scanned(self, place: Array) -> Array:
        """``place`` with the best of ``SCANNED`` values of each parameter of the motion that one data set has alone."""
        moved = place.copy()
        for data in self.sets:
            for index, free in enumerate(self.free):
                if free.own == data.name and free.of_motion:
                    heights = []
                    for x in (place[index], *np.linspace(0.0, 1.0, SCANNED)):
                        moved[index] = x
                        off = self.residual_of_set(data, self.with_triggers(moved))
                        heights.append((float(np.sum(np.nan_to_num(off, nan=MISSING_RESIDUAL) ** 2)), float(x)))
                    moved[index] = min(heights)[1]
        return moved

    def with_triggers(self, place: Array) -> Array:
        """``place`` with the triggers of all data sets at the best correlation of motion and traces."""
        moved = place.copy()
        for data in self.sets:
            simulation = self.motion(data, place) if data.channels else None
            for index, free in enumerate(self.free):
                if simulation and free.own == data.name and free.key.endswith(f".{TRIGGER}"):
                    channels = [channel for channel in data.channels if f"{channel.file_key}.{TRIGGER}" == free.key]
                    step_s = float(simulation.trace.time_s[1])
                    moved[index] = free.coordinate(correlated(channels, simulation.curves, step_s))
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
        simulation = simulated(source, ())
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
            make_scene(changed(data.tables, [(free.key, bound)]), data.name, f"--free {free.key}")
    tables = changed(data.tables, [(free.key, free.start) for free in moving])
    if any(free.own == data.name and free.key.endswith(f".{TRIGGER}") for free in parameters):
        apply_setting(tables, f"run.duration={LONGER * data.scene.run.duration!r} s")
    return replace(data, tables=json.dumps(tables))


def changed(tables: str, values: Iterable[tuple[str, float]]) -> dict[str, Any]:
    """Tables of a scene with other values of some keys: text with the unit, or a plain number."""
    other: dict[str, Any] = json.loads(tables)
    for key, value in values:
        unit = unit_of(key)
        set_value(other, key, f"{value!r} {unit}" if unit else value, "--free")
    return other


def exact_numbers(sets: Sequence[DataSet], data: DataSet) -> Iterator[Free]:
    """Physical numbers other than 0 of a data set's scene, and its gains, as parameters in SI units.

    A number belongs to all data sets of a fit if they agree on it.
    """

    def numbers(value: Any, key: str) -> Iterator[tuple[str, float]]:
        parts = enumerate(value) if isinstance(value, list) else value.items() if isinstance(value, dict) else ()
        for part, inner in parts:
            if key or part not in (*NUMERICAL_KEYS, *DERIVED):
                yield from numbers(inner, f"{key}.{part}".lstrip("."))
        if isinstance(value, float) and value:
            yield key, value

    for key, value in numbers(data.scene.model_dump(mode="json", exclude_none=True), ""):
        common = all(look_up(each.scene, key) == value for each in sets)
        yield Free(key, "", value, *around(value), own="" if common else data.name)
    for channel in data.channels:
        gain = channel.trace.gain
        yield Free(f"{channel.key}.{GAIN}", "", gain, *around(gain), own=data.name)


def simulated(data: DataSet, values: Values) -> Simulation | None:
    """Exact motion of a data set's scene at given parameter values; None if there is none."""
    return _integrated(data.tables, data.where, values)


@lru_cache(maxsize=CACHE_SIZE)
def _integrated(tables: str, where: str, values: Values) -> Simulation | None:
    try:
        return exact(build_case(make_scene(changed(tables, values), where, where)), TOLERANCE)
    except (ArithmeticError, InputError):  # values that are allowed one by one may give an impossible chain
        return None


@lru_cache(maxsize=64 * CACHE_SIZE)
def _of_set(data: DataSet, motion: Values, values: Values) -> Array:
    simulation = simulated(data, motion)
    if simulation is None:
        return np.full(data.rows, inf)
    known, cut = dict(values), dict(values).get(CUT, DEFAULT_CUT)
    offs = [
        (read(simulation, number.name, cut) / known.get(number.divisor, 1.0) - number.value) / number.error
        for number in data.numbers
    ]
    traces = list[Array]()
    for channel in data.channels:
        gain = known.get(f"{channel.key}.{GAIN}", channel.trace.gain)
        trigger_s = known.get(f"{channel.file_key}.{TRIGGER}", channel.trigger_s)
        assert trigger_s is not None  # given, or a free parameter
        traces.append(residual_of(channel, simulation.curves[channel.gauge], gain, trigger_s))
    return np.concatenate([offs, *traces])
