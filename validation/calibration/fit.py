"""Least squares from several starting points by lmfit, and the uncertainty of the parameters found."""

import itertools
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from math import ceil, inf, log2, sqrt
from typing import TypeVar

import numpy as np
from lmfit import Minimizer, Parameters
from numpy.typing import NDArray

from drivers.base.errors import RunError
from drivers.base.units import quantity
from drivers.chain.chain import Array
from drivers.run.execute import Place, execute
from validation.calibration.free import TRIGGER, Free, without_effect
from validation.calibration.problem import STEP, Problem, has_motion, jacobian, residual, scanned, with_triggers

SCREENED_POINTS, DESCENTS = 8, 3  # points tried over the ranges for each parameter, and descents from the best
MAX_NESTED = 3  # searched parameters up to which the models inside a model are fitted first
ROUGH_CHANGE, CLOSE_CHANGE, FINE_CHANGE = 1e-3, 1e-5, 1e-6  # of chi-square or coordinates, at the end of a descent
MAX_EVALUATIONS, MAX_ROUGH_EVALUATIONS = 60, 3  # of one descent
# share of a range between a bound and the start of a descent: a restitution of 1 - 1e-5 has no exact motion
MARGIN = 1e-4
MIN_SEPARATION = 0.2  # share of a range between two starts
MIN_DISTANCE = 2e-2  # share of a range: closer minima count as one
MAX_EXCESS = 1.0  # of chi-square, up to which another minimum is reported
SAME = 0.1  # of chi-square: descents that end so close have reached the same minimum

RANGE_DEVIATION = 1 / sqrt(12)  # standard deviation of a parameter known only by its range, as a share of the range
MIN_COMPONENT = 0.1  # of a direction, relative to its largest; smaller components are not named
AT_BOUNDS = "dogbox"  # method that reaches bounds; it needs a start near the minimum

MIN_INFLATION = 10.0  # growth of an error by the uncertainty of the other parameters, from which it is reported
RISES = {"68 %": 1.0, "95 %": 3.841458820694124}  # rise of chi-square at the ends of intervals (Wilks, one parameter)
MAX_RISE = 5.0  # of chi-square, at which a profile ends
STRIDE = 0.6  # standard errors from one point of a profile to the next
MAX_POINTS = 12  # of a profile on each side

Held = tuple[tuple[int, float], ...]  # coordinates of parameters that are kept constant, by index
Ends = list[tuple[float, Array]]  # chi-square and coordinates at the ends of descents, best first
Point = tuple[float, float, Array]  # coordinate, chi-square, and coordinates of all parameters
Item = TypeVar("Item")
Result = TypeVar("Result")


@dataclass(frozen=True, eq=False)
class Fit:
    """A least-squares fit, with the linear estimate of its uncertainty from the sensitivities at the minimum.

    Attributes:
        place: Coordinates of the parameters. Shape (parameters,).
        residual: Residual in standard errors. Shape (rows,).
        jacobian: Derivatives of the residual by the coordinates. Shape (rows, parameters).
        others: Chi-square and coordinates of further minima, up to ``MAX_EXCESS`` above the best.
        reached, descents: Number of descents that ended at this minimum, and of all; 0 if it was known.
    """

    problem: Problem
    place: Array
    residual: Array
    jacobian: Array
    others: tuple[tuple[float, Array], ...] = ()
    reached: int = 0
    descents: int = 0

    @property
    def chi_square(self) -> float:
        """Sum of the squared residuals."""
        return float(self.residual @ self.residual)

    @property
    def freedom(self) -> int:
        """Degrees of freedom: data minus parameters minus coefficients of the fitted base lines of traces."""
        return self.problem.rows - len(self.place) - self.problem.lines

    @property
    def values(self) -> dict[str, float]:
        """Values of the parameters, by label."""
        return self.problem.values(self.place)

    @cached_property
    def directions(self) -> tuple[Array, Array]:
        """Singular values of the Jacobian (0 for directions without one), and its right singular vectors as rows."""
        _, singular, directions = np.linalg.svd(self.jacobian, full_matrices=True)
        return np.append(singular, np.zeros(len(directions) - len(singular))), directions

    @property
    def open_directions(self) -> Array:
        """Directions in which the data do not bound the parameters. Shape (directions, parameters)."""
        singular, directions = self.directions
        return np.asarray(directions[singular * RANGE_DEVIATION < 1.0])

    @cached_property
    def covariance(self) -> Array:
        """Covariance of the coordinates; in open directions that of the ranges. Shape (parameters, parameters)."""
        singular, directions = self.directions
        variance = 1 / np.maximum(singular**2, 1 / RANGE_DEVIATION**2)
        return np.asarray((directions.T * variance) @ directions)

    @property
    def undetermined(self) -> NDArray[np.bool_]:
        """True for each parameter that the data do not bound within its range. Shape (parameters,)."""
        return np.asarray(
            sum((named(direction) for direction in self.open_directions), np.zeros(len(self.place), dtype=bool))
        )

    @property
    def errors(self) -> Array:
        """Standard errors of the values, inf for undetermined parameters. Shape (parameters,)."""
        slopes = np.array([free.slope(float(x)) for free, x in zip(self.problem.free, self.place, strict=True)])
        return np.where(self.undetermined, inf, np.abs(slopes) * np.sqrt(np.diag(self.covariance)))

    def number(self, at: Callable[[Array], float]) -> tuple[float, float]:
        """Value of a function of the coordinates, with its standard error from their covariance."""
        value, slope = at(self.place), np.zeros(len(self.place))
        for index, x in enumerate(self.place):
            step = STEP if x + STEP <= 1 else -STEP
            slope[index] = (at(_moved(self.place, [index], [x + step])) - value) / step
        slope = np.nan_to_num(slope, nan=0.0)
        return value, sqrt(max(float(slope @ self.covariance @ slope), 0.0))


def for_each(problem: Problem, work: Callable[[Item], Result], items: Sequence[Item]) -> list[Result]:
    """Results of all items, by worker processes; by this one for a single data set, as fast as they would start."""
    if len(problem.sets) == 1:
        return [*map(work, items)]
    results = {id(item): result for item, result in execute(work, items, Place(processes=True))}
    return [results[id(item)] for item in items]


def named(direction: Array) -> NDArray[np.bool_]:
    """True for each parameter that takes part in a direction. Shape (parameters,)."""
    return np.asarray(np.abs(direction) > MIN_COMPONENT * np.abs(direction).max())


def fit(problem: Problem, seeds: Sequence[Mapping[str, float]] = (), *, search: bool = True) -> Fit:
    """Best of the minima found from the scene's values, points over the ranges, models inside this one, and seeds.

    Each searched parameter is first held at the scene's value, and at the value without effect: so a model is never
    worse than one inside it.

    Args:
        problem: Data and parameters.
        seeds: Values of parameters by label, such as those of other fits; missing ones start without effect.
        search: False to start at the seeds alone.

    Raises:
        RunError: The exact motion cannot be computed at any of these points.
    """
    seeded = [_seeded(problem, seed) for seed in seeds]
    ends = _descents(problem, (), {}) if search else []
    ends = sorted(itertools.chain(ends, *(_lowered(problem, {}, place) for place in seeded)), key=lambda end: end[0])
    if not ends:
        message = "the exact motion cannot be computed at the starting values or at any other point of the ranges"
        raise RunError(f"fit: {message}; narrow the bounds of --free")
    best = minimise(problem, minimise(problem, ends[0][1], converged=CLOSE_CHANGE), method=AT_BOUNDS)
    lowest, others = chi_square_at(problem, best), list[tuple[float, Array]]()
    for height, end in ends[1:]:
        distant = all(np.abs(end - minimum).max() > MIN_DISTANCE for minimum in (best, *(other for _, other in others)))
        if height < lowest + MAX_EXCESS and distant:
            others.append((height, end))
    reached = sum(height < lowest + SAME + 5 * ROUGH_CHANGE * lowest for height, _ in ends)
    return fitted_at(problem, best, tuple(others), reached, len(ends))


def _seeded(problem: Problem, seed: Mapping[str, float]) -> Array:
    """Coordinates of a seed; parameters that one data set has alone are fitted roughly if the seed has none."""
    values = {free.label: without_effect(free.key) for free in problem.free} | dict(seed)
    place = np.array([free.coordinate(free.start if (x := values[free.label]) is None else x) for free in problem.free])
    missing = any(free.own and free.of_motion and free.label not in seed for free in problem.free)
    return _with_others(problem, place, {}) if missing else with_triggers(problem, place)


def _descents(problem: Problem, held: Held, known: dict[frozenset[tuple[int, float]], Ends]) -> Ends:
    """Ends of descents with some parameters held, best first; ``known`` holds those of models inside the problem."""
    from scipy.stats import qmc

    if frozenset(held) in known:
        return known[frozenset(held)]
    kept = dict(held)
    start = _moved(problem.start, [*kept], [*kept.values()])
    moving = [index for index in problem.searched if index not in kept]
    places, inside = [_with_others(problem, start, kept)], list[Array]()
    if moving:
        draws = qmc.Sobol(len(moving), seed=0).random_base2(ceil(log2(SCREENED_POINTS * len(moving))))
        drawn = [_moved(start, moving, draw) for draw in draws]
        screened = sorted(for_each(problem, partial(_screened, problem, kept), drawn))
        places += _apart([np.array(place) for _, place in screened], moving)
    if len(problem.searched) <= MAX_NESTED or not held:
        for index in moving:
            for value in _null_coordinates(problem.free[index]):
                inside += [place for _, place in _descents(problem, (*held, (index, value)), known)[:1]]
    lowered = for_each(problem, partial(_lowered, problem, kept), [*places, *inside])
    ends = known[frozenset(held)] = sorted(itertools.chain(*lowered), key=lambda end: end[0])
    return ends


def _apart(ranked: Sequence[Array], moving: Sequence[int]) -> list[Array]:
    """The first places that are ``MIN_SEPARATION`` from each other."""
    kept = list[Array]()
    for place in ranked:
        if len(kept) < DESCENTS and all(np.abs((place - other)[[*moving]]).max() > MIN_SEPARATION for other in kept):
            kept.append(place)
    return kept


def _lowered(problem: Problem, held: Mapping[int, float], place: Array) -> Ends:
    """End of a descent from a place; nothing from a place without a motion."""
    if not has_motion(problem, place):
        return []
    end = minimise(problem, place, held, converged=ROUGH_CHANGE)
    return [(chi_square_at(problem, end), end)]


def _null_coordinates(free: Free) -> list[float]:
    """Coordinates of a parameter in the models inside the problem: the scene's value, and the value without effect."""
    values = [free.start, *(value for value in [without_effect(free.key)] if value is not None)]
    return sorted({free.coordinate(value) for value in values})


def _screened(problem: Problem, held: Mapping[int, float], place: Array) -> tuple[float, list[float]]:
    """Chi-square and coordinates of a place ``_with_others``."""
    found = _with_others(problem, place, held)
    return chi_square_at(problem, found), found.tolist()


def _with_others(problem: Problem, place: Array, held: Mapping[int, float]) -> Array:
    """``place`` with all parameters fitted roughly that are not searched."""
    if not has_motion(problem, place):
        return place
    kept = {index: float(place[index]) for index in problem.searched} | dict(held)
    begun = with_triggers(problem, scanned(problem, place))
    return minimise(problem, begun, kept, converged=ROUGH_CHANGE, tries=MAX_ROUGH_EVALUATIONS)


def fitted_at(
    problem: Problem, place: Array, others: tuple[tuple[float, Array], ...] = (), reached: int = 0, descents: int = 0
) -> Fit:
    """Fit at a known minimum."""
    return Fit(problem, place, residual(problem, place), jacobian(problem, place), others, reached, descents)


def minimise(
    problem: Problem,
    start: Array,
    held: Mapping[int, float] | None = None,
    left_out: Collection[int] = (),
    converged: float = FINE_CHANGE,
    tries: int = MAX_EVALUATIONS,
    method: str = "trf",
) -> Array:
    """Coordinates of the lowest point of a descent from ``start``; ``start`` itself where it has no motion.

    Args:
        problem: Data and parameters.
        start: Coordinates. Shape (parameters,).
        held: Coordinates of parameters that are kept constant, by index.
        left_out: Rows of the residual to ignore.
        converged: Relative change at which the descent ends.
        tries: Largest number of evaluations.
        method: Method of ``scipy.optimize.least_squares``.
    """
    held, place = held or {}, np.clip(start, 0.0, 1.0)
    place[[*held]] = [*held.values()]
    begun = place.copy()
    moving = [index for index in range(len(place)) if index not in held]
    counting = np.setdiff1d(np.arange(problem.rows), list(left_out))
    lowest, best = chi_square_at(problem, begun, counting), begun
    place[moving] = np.clip(place[moving], MARGIN, 1 - MARGIN)
    if not moving or not counting.size or not has_motion(problem, place):
        return begun

    def coordinates(parameters: Parameters) -> Array:
        return _moved(place, moving, np.array([parameters[f"p{index}"].value for index in moving]))

    def off(parameters: Parameters) -> Array:
        nonlocal lowest, best
        here = coordinates(parameters)
        residuals = residual(problem, here)[counting]
        if residuals @ residuals < lowest:
            lowest, best = float(residuals @ residuals), here
        return np.asarray(residuals)

    def slopes(parameters: Parameters) -> Array:
        return np.asarray(jacobian(problem, coordinates(parameters), moving)[counting])

    inside = Parameters()
    for index in moving:
        inside.add(f"p{index}", value=float(place[index]), min=0.0, max=1.0)
    with np.errstate(invalid="ignore", divide="ignore"):  # the slope is zero if all data are missing
        # a point without a motion has infinite residuals, from which least squares steps back
        Minimizer(off, inside, scale_covar=False, calc_covar=False, nan_policy="propagate").least_squares(
            max_nfev=2 * tries, Dfun=slopes, xtol=converged, ftol=converged, gtol=None, method=method
        )
    return best


def chi_square_at(problem: Problem, place: Array, rows: Array | None = None) -> float:
    """Chi-square at given coordinates, of all or of some rows of the residual."""
    off = residual(problem, place)
    off = off if rows is None else off[rows]
    return float(off @ off)


def _moved(place: Array, moving: Sequence[int], coordinates: Sequence[float] | Array) -> Array:
    moved = place.copy()
    moved[list(moving)] = coordinates
    return moved


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
        names = " and ".join(free[i].label for i in weak)
        along = _along(fit, directions[int(np.argmin(singular))], weak)
        yield f"the data barely distinguish {names}: they trade off along {along}"
        times = f"{float(inflation[weak].min()):.0f} times smaller"
        yield f"each of them would have an error at least {times} if all other parameters were known"


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


def profile(fit: Fit, index: int) -> list[Point]:
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
    return sorted(points, key=lambda point: point[0])


def interval(fit: Fit, index: int, rise: float, points: list[Point] | None = None) -> tuple[float, float]:
    """Values of a parameter at which chi-square has risen by ``rise``.

    Without a profile they follow from the standard error; with one, a side is -inf or inf if chi-square does not rise
    so far within the range.
    """
    free = fit.problem.free[index]
    if points is None:
        value, reach = free.value(float(fit.place[index])), sqrt(rise) * float(fit.errors[index])
        return max(value - reach, free.low), min(value + reach, free.high)
    coordinate, chi_square = (np.array(column) for column in list(zip(*points, strict=True))[:2])
    best, ends = int(np.argmin(chi_square)), []
    for side, none in ((slice(best, None, -1), -inf), (slice(best, None), inf)):
        # the square root of the rise is nearly linear in the coordinate
        height = np.sqrt(np.maximum(chi_square[side] - chi_square[best], 0.0))
        reached = height[-1] >= sqrt(rise) and len(height) > 1
        ends.append(free.value(float(np.interp(sqrt(rise), height, coordinate[side]))) if reached else none)
    return ends[0], ends[1]
