"""Uncertainty of fitted parameters: standard errors, undetermined directions, profiles, contours, predictions."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cached_property
from math import hypot, inf, isfinite, nan, sqrt

import numpy as np
from numpy.typing import NDArray

from drivers.base.units import quantity
from drivers.chain.chain import Array
from validation.calibration.fit import CLOSE_CHANGE, ROUGH_CHANGE, Fit, chi_square_at, minimise
from validation.calibration.free import TRIGGER
from validation.calibration.problem import STEP, Datum, Problem, motion_values, own_values, predicted

RANGE_DEVIATION = 1 / sqrt(12)  # standard deviation of a parameter known only by its range, as a share of the range
MIN_INFLATION = 10.0  # growth of an error by the uncertainty of the other parameters, from which it is reported
MIN_COMPONENT = 0.1  # of a direction, relative to its largest; smaller components are not named
RISES = {"68 %": 1.0, "95 %": 3.841458820694124}  # rise of chi-square at the ends of intervals (Wilks, one parameter)
MAX_RISE = 5.0  # of chi-square, at which a profile ends
STRIDE = 0.6  # standard errors from one point of a profile to the next
MAX_POINTS = 12  # of a profile on each side


@dataclass(frozen=True, eq=False)
class Certainty:
    """Linear estimate of a fit's uncertainty, from the sensitivities at the minimum.

    Directions are the right singular vectors of the Jacobian. A direction is open if its singular value is so small
    that the data do not bound the parameters within their ranges along it.
    """

    fit: Fit

    @cached_property
    def _directions(self) -> tuple[Array, Array]:
        """Singular values (0 for directions without one), and the directions as rows."""
        _, singular, directions = np.linalg.svd(self.fit.jacobian, full_matrices=True)
        return np.append(singular, np.zeros(len(directions) - len(singular))), directions

    @property
    def open_directions(self) -> Array:
        """Open directions. Shape (directions, parameters)."""
        singular, directions = self._directions
        return np.asarray(directions[singular * RANGE_DEVIATION < 1.0])

    @cached_property
    def covariance(self) -> Array:
        """Covariance of the coordinates; in open directions that of the ranges. Shape (parameters, parameters)."""
        singular, directions = self._directions
        variance = 1 / np.maximum(singular**2, 1 / RANGE_DEVIATION**2)
        return np.asarray((directions.T * variance) @ directions)

    @property
    def errors(self) -> Array:
        """Standard errors of the values, inf for undetermined parameters. Shape (parameters,)."""
        free = self.fit.problem.free
        slopes = np.array([each.slope(float(x)) for each, x in zip(free, self.fit.place, strict=True)])
        return np.where(self.undetermined, inf, np.abs(slopes) * np.sqrt(np.diag(self.covariance)))

    @property
    def undetermined(self) -> NDArray[np.bool_]:
        """True for each parameter that the data do not bound within its range. Shape (parameters,)."""
        named = [np.abs(each) > MIN_COMPONENT * np.abs(each).max() for each in self.open_directions]
        return np.asarray(np.any(named, axis=0)) if named else np.zeros(len(self.fit.place), dtype=bool)

    @property
    def inflation(self) -> Array:
        """Each error divided by the error if all other parameters were known. Shape (parameters,)."""
        alone = np.linalg.norm(self.fit.jacobian, axis=0)
        return np.asarray(np.sqrt(np.diag(self.covariance)) * np.maximum(alone, 1 / RANGE_DEVIATION))

    def sentences(self) -> Iterator[str]:
        """Parameters that the data do not determine, or barely distinguish."""
        free = self.fit.problem.free
        for direction in self.open_directions:
            named = np.flatnonzero(np.abs(direction) > MIN_COMPONENT * np.abs(direction).max())
            if len(named) == 1:
                yield f"the data do not determine {free[named[0]].label}"
            else:
                names = " and ".join(free[i].label for i in named)
                yield f"the data cannot distinguish {names}: they trade off along {self._along(direction, named)}"
        weak = np.flatnonzero((self.inflation > MIN_INFLATION) & ~self.undetermined)
        if len(weak) > 1:
            weakest = self._directions[1][int(np.argmin(self._directions[0]))]
            names, times = " and ".join(free[i].label for i in weak), float(self.inflation[weak].min())
            pair = f"the data barely distinguish {names}: they trade off along {self._along(weakest, weak)}"
            yield f"{pair}; with all but one of them known, its error would be {times:.0f} times smaller"

    def _along(self, direction: Array, named: NDArray[np.intp]) -> str:
        """Changes of the named parameters along a direction, scaled to a largest relative change of 10 %.

        A trigger has an arbitrary zero, so its change is a time.
        """
        free, place = self.fit.problem.free, self.fit.place
        changes = {i: direction[i] * free[i].slope(float(place[i])) for i in named}
        shares = {
            i: change / (free[i].value(float(place[i])) or free[i].high)
            for i, change in changes.items()
            if not free[i].key.endswith(f".{TRIGGER}")
        }
        scale = 0.1 / max(shares.values(), key=abs)
        texts = {i: f"{100 * scale * share:+.3g} %" for i, share in shares.items()}
        texts |= {i: quantity(float(f"{scale * changes[i]:.3g}"), "s") for i in changes if i not in shares}
        return ", ".join(f"{free[i].label} {texts[i]}" for i in named)


@dataclass(frozen=True, eq=False)
class Profile:
    """Smallest chi-square for each value of one parameter, with all others fitted again.

    Attributes:
        coordinate, chi_square: Shape (points,), in the order of the coordinate.
        places: Coordinates of all parameters at each point. Shape (points, parameters).
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
        """Values at which chi-square has risen by ``rise``; -inf or inf on a side where it has not within the range."""
        excess = self.chi_square - self.chi_square.min()
        best, free = int(np.argmin(excess)), self.problem.free[self.index]
        ends = []
        for side, none in ((slice(best, None, -1), -inf), (slice(best, None), inf)):
            # the square root of the rise is nearly linear in the coordinate
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
    """Profile of chi-square along one parameter, from the minimum outwards to a rise of ``MAX_RISE``."""
    certainty = Certainty(fit)
    stride = min(STRIDE * sqrt(certainty.covariance[index, index]), 1 / MAX_POINTS)
    along = certainty.covariance[index] / certainty.covariance[index, index]
    points = [(float(fit.place[index]), fit.chi_square, fit.place)]
    for sign in (-1, 1):
        place = fit.place
        for number in range(1, MAX_POINTS + 1):
            grown = sign * stride * (1 + (number > MAX_POINTS // 2))
            target = min(max(float(place[index]) + grown, 0.0), 1.0)
            if target == place[index]:
                break
            guess = place + along * (target - place[index])
            place = minimise(fit.problem, guess, {index: target}, converged=CLOSE_CHANGE)
            points.append((target, chi_square_at(fit.problem, place), place))
            count()
            if points[-1][1] - fit.chi_square > MAX_RISE:
                break
    points.sort(key=lambda point: point[0])
    coordinate, chi_square, places = (np.array(column) for column in zip(*points, strict=True))
    return Profile(fit.problem, index, coordinate, chi_square, places)


def contours(fit: Fit, across: int, up: int, values: tuple[Array, Array]) -> Array:
    """Chi-square over a grid of two parameters, with all others fitted again. Shape (values up, values across)."""
    problem, found = fit.problem, np.full((len(values[1]), len(values[0])), nan)
    row_start = fit.place
    columns = sorted(range(len(values[0])), key=lambda k: abs(values[0][k] - problem.free[across].value(fit.place[across])))
    for row in sorted(range(len(values[1])), key=lambda k: abs(values[1][k] - problem.free[up].value(fit.place[up]))):
        place = row_start
        for column in columns:
            held = {
                across: problem.free[across].coordinate(float(values[0][column])),
                up: problem.free[up].coordinate(float(values[1][row])),
            }
            ends = [minimise(problem, each, held, converged=ROUGH_CHANGE) for each in (place, fit.place)]
            place = min(ends, key=lambda end: chi_square_at(problem, end))
            found[row, column] = chi_square_at(problem, place)
    return found


@dataclass(frozen=True)
class Prediction:
    """A datum, its fitted value, and its prediction by a fit without this datum, in the unit of the observable.

    Attributes:
        fitted, error: Fitted value with its standard error.
        off: Fitted minus measured in standard errors of the measurement; of a trace the rms.
        without, without_error: Prediction of the fit to all other data, with standard error; NaN if undetermined.
        without_off: This prediction minus measured, in standard errors of both combined.
        without_chi_square: Chi-square of that fit.
        without_values: Values of that fit, by label.
    """

    datum: Datum
    fitted: float
    error: float
    off: float
    without: float = nan
    without_error: float = nan
    without_off: float = nan
    without_chi_square: float = nan
    without_values: dict[str, float] | None = None


def predictions(fit: Fit, *, leave_out: bool = True, count: Callable[[], None] = lambda: None) -> list[Prediction]:
    """Prediction of each datum; with ``leave_out`` also by the fit without this datum."""
    found, certainty = list[Prediction](), Certainty(fit)
    for datum in fit.problem.data:
        value, error = number_in_fit(fit, datum, certainty)
        if datum.number is None:
            rows = fit.residual[datum.rows.start : datum.rows.stop]
            off = float(np.sqrt(np.mean(rows**2)))
        else:
            off = (value - datum.number.value) / datum.number.error
        shown = Prediction(datum, value, error, off)
        found.append(_without(fit, shown) if leave_out and datum.number else shown)
        count()
    return found


def _without(fit: Fit, shown: Prediction) -> Prediction:
    """The prediction of a number with that by the fit to all other data."""
    datum, number = shown.datum, shown.datum.number
    assert number is not None
    place = minimise(fit.problem, fit.place, left_out=datum.rows, converged=CLOSE_CHANGE)
    kept = np.setdiff1d(np.arange(fit.problem.rows), list(datum.rows))
    rest = Fit(fit.problem, place, fit.residual, fit.jacobian[kept])
    others, chi_square = Certainty(rest), chi_square_at(fit.problem, place, kept)
    values = (chi_square, fit.problem.values(place))
    if len(others.open_directions):
        return Prediction(datum, shown.fitted, shown.error, shown.off, nan, nan, nan, *values)
    without, error = number_in_fit(rest, datum, others)
    off = (without - number.value) / hypot(error, number.error)
    return Prediction(datum, shown.fitted, shown.error, shown.off, without, error, off, *values)


def number_in_fit(fit: Fit, datum: Datum, certainty: Certainty) -> tuple[float, float]:
    """A number in the fitted motion, with its standard error from the parameters' covariance; NaN for other data."""
    if datum.number is None:
        return nan, nan
    problem, number = fit.problem, datum.number
    data = next(each for each in problem.sets if each.name == datum.data_set)
    return with_error(
        fit, certainty, lambda place: predicted(data, number, motion_values(problem, data, place), own_values(problem, data, place))
    )


def with_error(fit: Fit, certainty: Certainty, at: Callable[[Array], float]) -> tuple[float, float]:
    """Value of a function of the coordinates at a fit, with its standard error from their covariance."""
    value, slope = at(fit.place), np.zeros(len(fit.place))
    for index in range(len(slope)):
        step = np.zeros(len(fit.place))
        step[index] = STEP if fit.place[index] + STEP <= 1 else -STEP
        slopes = [(at(fit.place + each) - value) / each[index] for each in (step, -step)]
        slope[index] = next((each for each in slopes if isfinite(each)), 0.0)
    return value, sqrt(max(float(slope @ certainty.covariance @ slope), 0.0))
