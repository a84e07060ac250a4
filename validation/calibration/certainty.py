"""Uncertainty of fitted parameters beyond standard errors: trade-offs in words, intervals, contours."""

from collections.abc import Callable, Iterator
from math import inf, sqrt

import numpy as np
from numpy.typing import NDArray

from drivers.base.units import quantity
from drivers.chain.chain import Array
from validation.calibration.fit import CLOSE_CHANGE, RANGE_DEVIATION, ROUGH_CHANGE, Fit, chi_square_at, minimise, named
from validation.calibration.free import TRIGGER

MIN_INFLATION = 10.0  # growth of an error by the uncertainty of the other parameters, from which it is reported
RISES = {"68 %": 1.0, "95 %": 3.841458820694124}  # rise of chi-square at the ends of intervals (Wilks, one parameter)
MAX_RISE = 5.0  # of chi-square, at which a profile ends
STRIDE = 0.6  # standard errors from one point of a profile to the next
MAX_POINTS = 12  # of a profile on each side

Point = tuple[float, float, Array]  # coordinate, chi-square, and coordinates of all parameters


def trade_offs(fit: Fit) -> Iterator[str]:
    """Sentences on parameters that the data do not determine, or barely distinguish."""
    free = fit.problem.free
    for direction in fit.open_directions:
        members = np.flatnonzero(named(direction))
        if len(members) == 1:
            yield f"the data do not determine {free[members[0]].label}"
        else:
            names = " and ".join(free[i].label for i in members)
            yield f"the data cannot distinguish {names}: they trade off along {_along(fit, direction, members)}"
    alone = np.maximum(np.linalg.norm(fit.jacobian, axis=0), 1 / RANGE_DEVIATION)
    inflation = np.sqrt(np.diag(fit.covariance)) * alone  # each error divided by that with all others known
    weak = np.flatnonzero((inflation > MIN_INFLATION) & ~fit.undetermined)
    if len(weak) > 1:
        singular, directions = fit.directions
        names, along = (
            " and ".join(free[i].label for i in weak),
            _along(fit, directions[int(np.argmin(singular))], weak),
        )
        yield f"the data barely distinguish {names}: they trade off along {along}"
        times = f"{float(inflation[weak].min()):.0f} times smaller"
        yield f"each of them would have an error at least {times} if all others were known"


def _along(fit: Fit, direction: Array, members: NDArray[np.intp]) -> str:
    """Changes of parameters along a direction, scaled to a largest relative change of 10 %.

    A trigger has an arbitrary zero, so its change is a time.
    """
    free, place = fit.problem.free, fit.place
    changes = {i: direction[i] * free[i].slope(float(place[i])) for i in members}
    values = {i: free[i].value(float(place[i])) or free[i].high for i in members}
    shares = {i: changes[i] / values[i] for i in members if not free[i].key.endswith(f".{TRIGGER}")}
    scale = 0.1 / max(shares.values(), key=abs, default=1.0)
    texts = {i: quantity(float(f"{scale * change:.3g}"), "s") for i, change in changes.items()}
    texts |= {i: f"{100 * scale * share:+.3g} %" for i, share in shares.items()}
    return ", ".join(f"{free[i].label} {texts[i]}" for i in members)


def profile(fit: Fit, index: int, count: Callable[[], None] = lambda: None) -> list[Point]:
    """Smallest chi-square along one parameter, all others fitted, from the minimum to a rise of ``MAX_RISE``."""
    stride = min(STRIDE * sqrt(fit.covariance[index, index]), 1 / MAX_POINTS)
    along = fit.covariance[index] / fit.covariance[index, index]
    points = [(float(fit.place[index]), fit.chi_square, fit.place)]
    for sign in (-1, 1):
        place = fit.place
        for number in range(1, MAX_POINTS + 1):
            grown = sign * stride * (1 + (number > MAX_POINTS // 2))
            target = min(max(float(place[index]) + grown, 0.0), 1.0)
            if target == place[index] or (points[-1][1] - fit.chi_square > MAX_RISE and number > 1):
                break
            guess = place + along * (target - place[index])
            place = minimise(fit.problem, guess, {index: target}, converged=CLOSE_CHANGE)
            points.append((target, chi_square_at(fit.problem, place), place))
            count()
    return sorted(points, key=lambda point: point[0])


def interval(fit: Fit, index: int, rise: float, points: list[Point] | None = None) -> tuple[float, float]:
    """Values of a parameter at which chi-square has risen by ``rise``.

    Without a profile they follow from the standard error; with one, a side is -inf or inf if chi-square does not rise
    so far within the range.
    """
    free = fit.problem.free[index]
    if points is None:
        value, reach = free.value(float(fit.place[index])), sqrt(rise) * float(fit.errors[index])
        return value - reach, value + reach
    coordinate, chi_square = (np.array(column) for column in list(zip(*points, strict=True))[:2])
    best, ends = int(np.argmin(chi_square)), []
    for side, none in ((slice(best, None, -1), -inf), (slice(best, None), inf)):
        # the square root of the rise is nearly linear in the coordinate
        height = np.sqrt(np.maximum(chi_square[side] - chi_square[best], 0.0))
        reached = height[-1] >= sqrt(rise) and len(height) > 1
        ends.append(free.value(float(np.interp(sqrt(rise), height, coordinate[side]))) if reached else none)
    return ends[0], ends[1]


def contours(fit: Fit, across: int, up: int, values: tuple[Array, Array]) -> Array:
    """Chi-square over a grid of two parameters, with all others fitted again. Shape (values up, values across)."""
    problem, grid = fit.problem, np.empty((len(values[1]), len(values[0])))
    for row, high in enumerate(values[1]):
        place = fit.place
        for column in sorted(
            range(len(values[0])), key=lambda k: abs(values[0][k] - problem.free[across].value(fit.place[across]))
        ):
            held = {
                across: problem.free[across].coordinate(float(values[0][column])),
                up: problem.free[up].coordinate(float(high)),
            }
            ends = [minimise(problem, each, held, converged=ROUGH_CHANGE) for each in (place, fit.place)]
            heights = [chi_square_at(problem, end) for end in ends]
            place, grid[row, column] = ends[int(np.argmin(heights))], min(heights)
    return grid
