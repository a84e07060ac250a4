"""How surely data tell parameters: standard errors, correlations, directions they leave open, profiles, predictions."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cached_property
from math import hypot, inf, isfinite, nan, sqrt

import numpy as np
from numpy.typing import NDArray

from drivers.chain.chain import Array
from validation.calibration.fit import CLOSE, Fit, chi_square_at, minimise
from validation.calibration.problem import STEP, Datum, Problem, own_values, shown

OPEN = 1 / sqrt(12)  # of a range: the standard deviation of a parameter of which only the range is known
INFLATED = 10.0  # times that an error grows by what the other parameters leave open, from which on that is said
SHARE = 0.1  # of a direction's largest component, from which on another is named
RISES = {"68 %": 1.0, "95 %": 3.841458820694124}  # of chi-square at the ends of intervals (Wilks, one parameter)
FURTHEST = 5.0  # rise of chi-square at which a profile ends
STRIDE = 0.6  # standard errors from one point of a profile to the next
POINTS = 12  # of a profile to each side, at most


@dataclass(frozen=True, eq=False)
class Certainty:
    """Linear certainty of a fit: what the sensitivities say at the best place.

    Singular values are of the jacobian by the coordinates; where one is so small that the data leave the parameters
    free within their ranges along its direction, that direction is open.
    """

    fit: Fit

    @cached_property
    def _directions(self) -> tuple[Array, Array]:
        """Singular values, a 0 for each direction without, and the directions as rows."""
        _, singular, directions = np.linalg.svd(self.fit.jacobian, full_matrices=True)
        return np.append(singular, np.zeros(len(directions) - len(singular))), directions

    @property
    def open_directions(self) -> Array:
        """Directions that the data leave open. Shape (directions, parameters)."""
        singular, directions = self._directions
        return np.asarray(directions[singular * OPEN < 1.0])

    @cached_property
    def covariance(self) -> Array:
        """Of the coordinates; along open directions that of the ranges alone. Shape (parameters, parameters)."""
        singular, directions = self._directions
        variance = 1 / np.maximum(singular**2, 1 / OPEN**2)
        return np.asarray((directions.T * variance) @ directions)

    @property
    def errors(self) -> Array:
        """Standard errors of the values, inf where the data leave a parameter open. Shape (parameters,)."""
        free = self.fit.problem.free
        slopes = np.array([each.slope(float(x)) for each, x in zip(free, self.fit.place, strict=True)])
        return np.where(self.undetermined, inf, np.abs(slopes) * np.sqrt(np.diag(self.covariance)))

    @property
    def undetermined(self) -> NDArray[np.bool_]:
        """Whether a parameter may lie anywhere in its range, for all that the data say. Shape (parameters,)."""
        named = [np.abs(each) > SHARE * np.abs(each).max() for each in self.open_directions]
        return np.asarray(np.any(named, axis=0)) if named else np.zeros(len(self.fit.place), dtype=bool)

    @property
    def correlations(self) -> Array:
        """Of the parameters' errors. Shape (parameters, parameters)."""
        spread = np.sqrt(np.diag(self.covariance))
        return np.asarray(self.covariance / np.outer(spread, spread))

    @property
    def inflation(self) -> Array:
        """How many times smaller each error would be if all other parameters were known. Shape (parameters,)."""
        alone = np.linalg.norm(self.fit.jacobian, axis=0)
        return np.asarray(np.sqrt(np.diag(self.covariance)) * np.maximum(alone, 1 / OPEN))

    def sentences(self) -> Iterator[str]:
        """Parameters that the data do not tell, or hardly tell from each other."""
        free = self.fit.problem.free
        for direction in self.open_directions:
            named = np.flatnonzero(np.abs(direction) > SHARE * np.abs(direction).max())
            if len(named) == 1:
                yield f"the data do not tell {free[named[0]].label}"
            else:
                names = " and ".join(free[i].label for i in named)
                yield f"the data cannot tell {names} apart: they trade off along {self._along(direction, named)}"
        told = np.flatnonzero((self.inflation > INFLATED) & ~self.undetermined)
        if len(told) > 1:
            weakest = self._directions[1][int(np.argmin(self._directions[0]))]
            names, times = " and ".join(free[i].label for i in told), float(self.inflation[told].min())
            words = f"the data hardly tell {names} apart: they trade off along {self._along(weakest, told)}"
            yield f"{words}, and would be known {times:.0f} times better if the others were known"

    def _along(self, direction: Array, named: NDArray[np.intp]) -> str:
        """Changes of some parameters along a direction, the largest by 10 %."""
        free, place = self.fit.problem.free, self.fit.place
        values = [free[i].value(float(place[i])) or free[i].high for i in named]
        slopes = [free[i].slope(float(place[i])) for i in named]
        changes = [direction[i] * slope / value for i, slope, value in zip(named, slopes, values, strict=True)]
        largest = changes[int(np.argmax(np.abs(changes)))]
        return ", ".join(
            f"{free[i].label} {10 * each / largest:+.3g} %" for i, each in zip(named, changes, strict=True)
        )


@dataclass(frozen=True, eq=False)
class Profile:
    """Least chi-square for each value of one parameter, all others fitted anew.

    Attributes:
        coordinate, chi_square: shape (points,), in the order of the coordinate.
        places: of all parameters there, shape (points, parameters).
    """

    problem: Problem
    index: int
    coordinate: Array
    chi_square: Array
    places: Array

    @property
    def value(self) -> Array:
        """Values of the parameter. Shape (points,)."""
        free = self.problem.free[self.index]
        return np.array([free.value(float(x)) for x in self.coordinate])

    def interval(self, rise: float) -> tuple[float, float]:
        """Values at which chi-square has risen so far; -inf or inf where it has not at the end of the range."""
        excess = self.chi_square - self.chi_square.min()
        best, free = int(np.argmin(excess)), self.problem.free[self.index]
        ends = []
        for side, none in ((slice(best, None, -1), -inf), (slice(best, None), inf)):
            # the root of chi-square's rise is nearly straight in the coordinate
            height, where = np.sqrt(np.maximum(excess[side], 0.0)), self.coordinate[side]
            beyond = np.flatnonzero(height >= sqrt(rise))
            if not beyond.size:
                ends.append(none)
                continue
            k = int(beyond[0])
            share = (sqrt(rise) - height[k - 1]) / (height[k] - height[k - 1])
            ends.append(free.value(float(where[k - 1] + share * (where[k] - where[k - 1]))))
        return ends[0], ends[1]


def profile(fit: Fit, index: int, count: Callable[[], None] = lambda: None) -> Profile:
    """Profile of chi-square along one parameter, from the best place outwards until it has risen by ``FURTHEST``."""
    certainty = Certainty(fit)
    stride = min(STRIDE * sqrt(certainty.covariance[index, index]), 1 / POINTS)
    along = certainty.covariance[index] / certainty.covariance[index, index]
    points = [(float(fit.place[index]), fit.chi_square, fit.place)]
    for sign in (-1, 1):
        place = fit.place
        for number in range(1, POINTS + 1):
            grown = sign * stride * (1 + (number > POINTS // 2))
            target = min(max(float(place[index]) + grown, 0.0), 1.0)
            if target == place[index]:
                break
            guess = place + along * (target - place[index])
            place = minimise(fit.problem, guess, {index: target}, converged=CLOSE)
            points.append((target, chi_square_at(fit.problem, place), place))
            count()
            if points[-1][1] - fit.chi_square > FURTHEST:
                break
    points.sort(key=lambda point: point[0])
    coordinate, chi_square, places = (np.array(column) for column in zip(*points, strict=True))
    return Profile(fit.problem, index, coordinate, chi_square, places)


@dataclass(frozen=True)
class Prediction:
    """A datum beside what the fit gives for it, and what a fit without it foretells.

    Values in the observable's unit.

    Attributes:
        off: fitted less measured, in standard errors of the measurement; of a trace the rms of these.

        without: foretold by the fit to all other data, with the standard error of that fit; NaN if they leave it open.
        without_off: foretold less measured, in standard errors of both together.
    """

    datum: Datum
    fitted: float
    error: float
    off: float
    without: float = nan
    without_error: float = nan
    without_off: float = nan


def predictions(fit: Fit, *, leave_out: bool = True, count: Callable[[], None] = lambda: None) -> list[Prediction]:
    """A line for each datum, fitted or only predicted; with ``leave_out`` also what a fit without it foretells."""
    found, certainty = list[Prediction](), Certainty(fit)
    for datum in fit.problem.data:
        value, error = _foretold(fit, datum, certainty)
        off = _off(fit.residual, datum, value)
        if not leave_out or not datum.rows:
            found.append(Prediction(datum, value, error, off))
            continue
        place = minimise(fit.problem, fit.place, left_out=datum.rows, converged=CLOSE)
        rest = Fit(fit.problem, place, fit.residual, _without(fit, datum))
        others, number = Certainty(rest), datum.number
        if number is None or len(others.open_directions):
            found.append(Prediction(datum, value, error, off))
        else:
            without, without_error = _foretold(rest, datum, others)
            both = (without - number.value) / hypot(without_error, number.error)
            found.append(Prediction(datum, value, error, off, without, without_error, both))
        count()
    return found


def _without(fit: Fit, datum: Datum) -> Array:
    """Sensitivities of all data but one."""
    kept = np.setdiff1d(np.arange(fit.problem.rows), list(datum.rows))
    return np.asarray(fit.jacobian[kept])


def _off(residual: Array, datum: Datum, value: float) -> float:
    if datum.number is not None:
        return (value - datum.number.value) / datum.number.error
    rows = residual[datum.rows.start : datum.rows.stop]
    return float(np.sqrt(np.mean(rows**2)))


def _foretold(fit: Fit, datum: Datum, certainty: Certainty) -> tuple[float, float]:
    """What the motion at a fit shows of a number, with its standard error by that of the parameters."""
    if datum.number is None:
        return nan, nan
    problem, number = fit.problem, datum.number
    data = next(each for each in problem.sets if each.name == datum.data_set)

    def at(place: Array) -> float:
        return shown(data, number, own_values(problem, data, place))

    value, slope = at(fit.place), np.zeros(len(fit.place))
    for index in range(len(slope)):
        step = np.zeros(len(fit.place))
        step[index] = STEP if fit.place[index] + STEP <= 1 else -STEP
        slopes = [(at(fit.place + each) - value) / each[index] for each in (step, -step)]
        slope[index] = next((each for each in slopes if isfinite(each)), 0.0)
    error = sqrt(max(float(slope @ certainty.covariance @ slope), 0.0))
    return value, error
