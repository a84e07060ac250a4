"""Least squares: the parameters with the smallest chi-square, from several starting points, by lmfit."""

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from math import ceil, inf, log2, sqrt

import numpy as np
from lmfit import Minimizer, Parameters
from numpy.typing import NDArray

from drivers.base.errors import RunError
from drivers.chain.chain import Array
from validation.calibration.free import Free, without_effect
from validation.calibration.problem import STEP, Problem, has_motion, jacobian, residual, scanned, with_triggers

SCREENED_POINTS, DESCENTS = 8, 3  # points tried over the ranges for each parameter, and descents from the best
MAX_NESTED = 3  # searched parameters up to which the models inside a model are fitted first
ROUGH_CHANGE, CLOSE_CHANGE, FINE_CHANGE = 1e-3, 1e-5, 1e-6  # of chi-square or coordinates, at the end of a descent
MAX_EVALUATIONS, MAX_ROUGH_EVALUATIONS = 60, 3  # of one descent
MARGIN = (
    1e-4  # share of a range between a bound and the start of a descent: a restitution of 1 - 1e-5 has no exact motion
)
APART = 0.2  # share of a range between two starts
MIN_DISTANCE = 2e-2  # share of a range: closer minima count as one
MAX_EXCESS = 1.0  # of chi-square, up to which another minimum is reported
SAME = 0.1  # of chi-square: descents that end so close have reached the same minimum

RANGE_DEVIATION = 1 / sqrt(12)  # standard deviation of a parameter known only by its range, as a share of the range
MIN_COMPONENT = 0.1  # of a direction, relative to its largest; smaller components are not named
AT_BOUNDS = "dogbox"  # method that reaches bounds; it needs a start near the minimum

Held = tuple[tuple[int, float], ...]  # coordinates of parameters that are kept constant, by index
Ends = list[tuple[float, Array]]  # chi-square and coordinates at the ends of descents, best first


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
        return np.asarray(sum((named(each) for each in self.open_directions), np.zeros(len(self.place), dtype=bool)))

    @property
    def errors(self) -> Array:
        """Standard errors of the values, inf for undetermined parameters. Shape (parameters,)."""
        slopes = np.array([each.slope(float(x)) for each, x in zip(self.problem.free, self.place, strict=True)])
        return np.where(self.undetermined, inf, np.abs(slopes) * np.sqrt(np.diag(self.covariance)))

    def number(self, at: Callable[[Array], float]) -> tuple[float, float]:
        """Value of a function of the coordinates, with its standard error from their covariance."""
        value, slope = at(self.place), np.zeros(len(self.place))
        for index, x in enumerate(self.place):
            step = STEP if x + STEP <= 1 else -STEP
            slope[index] = (at(_moved(self.place, [index], [x + step])) - value) / step
        slope = np.nan_to_num(slope, nan=0.0)
        return value, sqrt(max(float(slope @ self.covariance @ slope), 0.0))


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
    ends = sorted([*ends, *_lowered(problem, seeded, {})], key=lambda end: end[0])
    if not ends:
        found = "the exact motion cannot be computed at the starting values or at any other point of the ranges"
        raise RunError(f"fit: {found}; narrow the bounds of --free")
    best = minimise(problem, minimise(problem, ends[0][1], converged=CLOSE_CHANGE), method=AT_BOUNDS)
    lowest, others = chi_square_at(problem, best), list[tuple[float, Array]]()
    for height, end in ends[1:]:
        distant = all(np.abs(end - each).max() > MIN_DISTANCE for each in (best, *(other for _, other in others)))
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
        drawn = (_with_others(problem, _moved(start, moving, draw), kept) for draw in draws)
        ranked = [
            np.array(place) for _, place in sorted((chi_square_at(problem, each), each.tolist()) for each in drawn)
        ]
        places += _apart(ranked, moving)
    if len(moving) > 1 and (len(problem.searched) <= MAX_NESTED or not held):
        for index in moving:
            for value in _null_coordinates(problem.free[index]):
                inside += [place for _, place in _descents(problem, (*held, (index, value)), known)[:1]]
    ends = known[frozenset(held)] = _lowered(problem, [*places, *inside], kept)
    return ends


def _apart(ranked: Sequence[Array], moving: Sequence[int]) -> list[Array]:
    """The first places that are ``APART`` from each other."""
    found = list[Array]()
    for place in ranked:
        if len(found) < DESCENTS and all(np.abs((place - each)[[*moving]]).max() > APART for each in found):
            found.append(place)
    return found


def _lowered(problem: Problem, places: Sequence[Array], held: Mapping[int, float]) -> Ends:
    """Ends of descents from some places, best first; places without a motion are left out."""
    starts = [place for place in places if has_motion(problem, place)]
    ends = [minimise(problem, place, held, converged=ROUGH_CHANGE) for place in starts]
    return sorted(((chi_square_at(problem, end), end) for end in ends), key=lambda end: end[0])


def _null_coordinates(free: Free) -> list[float]:
    """Coordinates of a parameter in the models inside the problem: the scene's value, and the value without effect."""
    values = [free.start, *(value for value in [without_effect(free.key)] if value is not None)]
    return sorted({free.coordinate(value) for value in values})


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
        found = residual(problem, here)[counting]
        if found @ found < lowest:
            lowest, best = float(found @ found), here
        return np.asarray(found)

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
