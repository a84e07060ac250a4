"""Least squares: the parameters with the smallest chi-square, from several starting points."""

from collections.abc import Collection, Mapping
from contextlib import suppress
from dataclasses import dataclass
from math import ceil, log2
from typing import Any

import numpy as np

from drivers.base.errors import InputError, RunError
from drivers.chain.chain import Array
from postproc.read.alignment import align
from validation.calibration.free import TRIGGER
from validation.calibration.problem import (
    Problem,
    has_motion,
    jacobian,
    motion_values,
    own_values,
    raw_residual,
    residual,
    simulated,
)

SCREENED_POINTS, DESCENTS = 16, 3  # points tried over the ranges, and descents from the best of them
ROUGH_CHANGE, CLOSE_CHANGE, FINE_CHANGE = 1e-3, 1e-5, 1e-8  # of chi-square or coordinates, at the end of a descent
MAX_EVALUATIONS, MAX_ROUGH_EVALUATIONS = 60, 5  # of one descent
SIMPLEX = 0.02  # share of a range: first size of the simplex, and distance at which an edge is looked for
MARGIN = 1e-9  # share of a range between a bound and the start of a descent
MIN_DISTANCE = 2e-2  # share of a range: closer minima count as one
MAX_EXCESS = 1.0  # of chi-square, up to which another minimum is reported


@dataclass(frozen=True, eq=False)
class Fit:
    """A least-squares fit.

    Attributes:
        place: Coordinates of the parameters, shape (parameters,).
        residual: Residual in standard errors, shape (rows,).
        jacobian: Derivatives of the residual by the coordinates, shape (rows, parameters).
        others: Chi-square and coordinates of further minima, up to ``MAX_EXCESS`` above the best.
    """

    problem: Problem
    place: Array
    residual: Array
    jacobian: Array
    others: tuple[tuple[float, Array], ...] = ()

    @property
    def chi_square(self) -> float:
        """Sum of the squared residuals."""
        return float(self.residual @ self.residual)

    @property
    def freedom(self) -> int:
        """Degrees of freedom: data minus parameters minus coefficients of the fitted base lines of traces."""
        return self.problem.rows - len(self.place) - sum(data.lines for data in self.problem.sets)

    @property
    def values(self) -> dict[str, float]:
        """Values of the parameters, by label."""
        return self.problem.values(self.place)


def fit(problem: Problem) -> Fit:
    """Best of the minima found from the values of the scene and from points distributed over the ranges.

    At each of these points the parameters of single data sets are fitted before chi-square is compared.

    Raises:
        RunError: the exact motion cannot be computed at any of these points.
    """
    from scipy.stats import qmc

    start = problem.start
    shared, places = _shared(problem), [start]
    if shared:
        draws = qmc.Sobol(len(shared), seed=0).random_base2(ceil(log2(SCREENED_POINTS)))
        places += [_with_own(problem, _moved(start, shared, draw), shared) for draw in draws]
    places = [place for place in places if has_motion(problem, place)]
    if not places:
        found = "the exact motion cannot be computed at the starting values or at any other point of the ranges"
        raise RunError(f"fit: {found}; narrow the bounds of --free")
    best = sorted(places[1:], key=lambda place: chi_square_at(problem, place))[:DESCENTS]
    rough = (minimise(problem, place, converged=ROUGH_CHANGE) for place in (places[0], *best))
    ends = sorted(rough, key=lambda end: chi_square_at(problem, end))
    ends[0] = refined_at_edge(problem, minimise(problem, ends[0]))
    others = list[Array]()
    for end in ends[1:]:
        near = chi_square_at(problem, end) < chi_square_at(problem, ends[0]) + MAX_EXCESS
        if near and all(np.abs(end - each).max() > MIN_DISTANCE for each in (ends[0], *others)):
            others.append(end)
    return fitted_at(problem, ends[0], tuple((chi_square_at(problem, each), each) for each in others))


def _shared(problem: Problem) -> list[int]:
    """Indices of the parameters shared by all data sets."""
    return [index for index, each in enumerate(problem.free) if not each.own]


def refined_at_edge(problem: Problem, place: Array) -> Array:
    """Minimum near ``place``, refined by a simplex search if a datum vanishes nearby, where a descent gets stuck.

    The simplex covers the shared parameters; those of single data sets are fitted at each of its points.
    """
    from scipy.optimize import minimize

    shared, latest = _shared(problem), place
    if not at_edge(problem, place):
        return place

    def fitted(coordinates: Array) -> Array:
        held = dict(zip(shared, np.clip(coordinates, 0.0, 1.0).tolist(), strict=True))
        return minimise(problem, latest, held, converged=ROUGH_CHANGE)

    def height(coordinates: Array) -> float:
        nonlocal latest
        here = fitted(coordinates)
        found = chi_square_at(problem, here)
        latest = here if found <= chi_square_at(problem, latest) else latest
        return found

    corners = np.vstack([place[shared], place[shared] + SIMPLEX * np.eye(len(shared))])
    options: Any = {"initial_simplex": corners, "xatol": 1e-3 * SIMPLEX, "fatol": 1e-3, "maxfev": 60 * len(shared)}
    minimize(height, place[shared], method="Nelder-Mead", options=options)
    return latest


def at_edge(problem: Problem, place: Array) -> bool:
    """True if a number exists in the motion at ``place`` and is missing a short distance away."""
    seen = ~np.isnan(raw_residual(problem, place))
    for index in _shared(problem):
        for step in (-SIMPLEX, SIMPLEX):
            other = place.copy()
            other[index] = min(max(other[index] + step, 0.0), 1.0)
            if (seen & np.isnan(raw_residual(problem, other))).any():
                return True
    return False


def _with_own(problem: Problem, place: Array, shared: list[int]) -> Array:
    """``place`` with the parameters of single data sets fitted roughly; shared parameters stay."""
    held = {index: float(place[index]) for index in shared}
    return minimise(problem, aligned(problem, place), held, converged=ROUGH_CHANGE, tries=MAX_ROUGH_EVALUATIONS)


def aligned(problem: Problem, place: Array) -> Array:
    """``place`` with triggers from aligning the motion with the traces; a trigger stays if alignment fails."""
    moved = place.copy()
    for data in problem.sets:
        simulation = simulated(data, motion_values(own_values(problem, data, place))) if data.records else None
        if simulation is None:
            continue
        for record in data.records:
            for index, free in enumerate(problem.free):
                if (free.own, free.key) == (data.name, f"{record.key}.{TRIGGER}"):
                    with suppress(InputError):
                        gauges = align([record.measured], simulation.case.layout, simulation.trace)
                        moved[index] = min(max(free.coordinate(gauges[0].trigger_s), 0.0), 1.0)
    return moved


def fitted_at(problem: Problem, place: Array, others: tuple[tuple[float, Array], ...] = ()) -> Fit:
    """Fit at a known minimum."""
    return Fit(problem, place, residual(problem, place), jacobian(problem, place), others)


def minimise(
    problem: Problem,
    start: Array,
    held: Mapping[int, float] | None = None,
    left_out: Collection[int] = (),
    converged: float = FINE_CHANGE,
    tries: int = MAX_EVALUATIONS,
) -> Array:
    """Coordinates of the minimum reached by a descent from ``start``; ``start`` itself where it has no motion.

    Args:
        problem: Data and parameters.
        start: Coordinates, shape (parameters,).
        held: Coordinates of parameters that are kept constant, by index.
        left_out: Rows of the residual to ignore.
        converged: Relative change at which the descent ends.
        tries: Largest number of evaluations.
    """
    from scipy.optimize import least_squares

    place = np.clip(start, 0.0, 1.0)
    for index, value in (held or {}).items():
        place[index] = value
    moving = [index for index in range(len(place)) if index not in (held or {})]
    counting = np.setdiff1d(np.arange(problem.rows), list(left_out))
    if not moving or not counting.size or not has_motion(problem, place):
        return place

    def off(x: Array) -> Array:
        return np.asarray(residual(problem, _moved(place, moving, x))[counting])

    def slopes(x: Array) -> Array:
        return np.asarray(jacobian(problem, _moved(place, moving, x), moving)[counting])

    inside = np.clip(place[moving], MARGIN, 1 - MARGIN)
    if not has_motion(problem, _moved(place, moving, inside)):
        return place
    ends: Any = {"xtol": converged, "ftol": converged, "gtol": None, "max_nfev": tries}
    with np.errstate(invalid="ignore", divide="ignore"):  # the slope is zero if all data are missing
        # a point without a motion has infinite residuals, from which least_squares steps back
        end = least_squares(off, inside, slopes, bounds=(0.0, 1.0), **ends)
    return _moved(place, moving, end.x)


def chi_square_at(problem: Problem, place: Array) -> float:
    """Chi-square at given coordinates."""
    off = residual(problem, place)
    return float(off @ off)


def _moved(place: Array, moving: list[int], coordinates: Array) -> Array:
    moved = place.copy()
    moved[moving] = coordinates
    return moved
