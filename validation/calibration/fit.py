"""Least squares: the parameters at which predictions come nearest to the data, from several starts."""

from collections.abc import Collection, Mapping
from contextlib import suppress
from dataclasses import dataclass
from math import ceil, log2
from typing import Any

import numpy as np

from drivers.base.errors import InputError
from drivers.chain.chain import Array
from postproc.read.alignment import align
from validation.calibration.free import TRIGGER
from validation.calibration.problem import Problem, jacobian, of_motion, offs, own_values, residual, simulated

SCREENED, POLISHED = 16, 3  # places all over the ranges that are looked at, and the best of them that are followed
ROUGH, CLOSE, FINE = 1e-3, 1e-5, 1e-8  # relative change of chi-square, or of coordinates, at which a descent ends
EVALUATIONS, FEW = 60, 5  # of one descent, of a rough one
SIMPLEX = 0.02  # of a range: first size of a simplex, and how near an edge is
EDGE = 1e-9  # of a range: a descent starts inside of it
APART = 2e-2  # of a range: minima nearer than that are one
WORSE = 1.0  # of chi-square, by which another minimum may be worse and still be told


@dataclass(frozen=True, eq=False)
class Fit:
    """A least-squares fit.

    Attributes:
        place: coordinates of the parameters, shape (parameters,).
        residual: in standard errors, shape (rows,).
        jacobian: of the residual by the coordinates, shape (rows, parameters).
        others: chi-square and coordinates of further minima that are nearly as good.
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
        """Degrees of freedom: data less parameters, and less what is fitted of traces' base lines."""
        return self.problem.rows - len(self.place) - sum(data.lines for data in self.problem.sets)

    @property
    def values(self) -> dict[str, float]:
        """Values of the parameters, by label."""
        return self.problem.values(self.place)


def fit(problem: Problem) -> Fit:
    """The best of the minima that are found from the scene's own values and from places all over the ranges.

    Places are looked at with the parameters of single data sets fitted to them.
    """
    from scipy.stats import qmc

    start = problem.start
    shared, places = _shared(problem), [start]
    if shared:
        draws = qmc.Sobol(len(shared), seed=0).random_base2(ceil(log2(SCREENED)))
        places += [_with_own(problem, _moved(start, shared, draw), shared) for draw in draws]
    best = sorted(places[1:], key=lambda place: chi_square_at(problem, place))[:POLISHED]
    rough = (minimise(problem, place, converged=ROUGH) for place in (start, *best))
    ends = sorted(rough, key=lambda end: chi_square_at(problem, end))
    ends[0] = settled(problem, minimise(problem, ends[0]))
    others = list[Array]()
    for end in ends[1:]:
        near = chi_square_at(problem, end) < chi_square_at(problem, ends[0]) + WORSE
        if near and all(np.abs(end - each).max() > APART for each in (ends[0], *others)):
            others.append(end)
    return fitted_at(problem, ends[0], tuple((chi_square_at(problem, each), each) for each in others))


def _shared(problem: Problem) -> list[int]:
    """Places of the parameters that all data sets share."""
    return [index for index, each in enumerate(problem.free) if not each.own]


def settled(problem: Problem, place: Array) -> Array:
    """The minimum near a place by a simplex, where a datum is lost next to it: a descent comes to rest at such an edge.

    The simplex goes over the shared parameters, with those of single data sets fitted to each of its points.
    """
    from scipy.optimize import minimize

    shared, latest = _shared(problem), place
    if not at_edge(problem, place):
        return place

    def fitted(coordinates: Array) -> Array:
        held = dict(zip(shared, np.clip(coordinates, 0.0, 1.0).tolist(), strict=True))
        return minimise(problem, latest, held, converged=ROUGH)

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
    """Whether a number that is seen at a place is not seen a little beside it."""
    seen = ~np.isnan(offs(problem, place))
    for index in _shared(problem):
        for step in (-SIMPLEX, SIMPLEX):
            other = place.copy()
            other[index] = min(max(other[index] + step, 0.0), 1.0)
            if (seen & np.isnan(offs(problem, other))).any():
                return True
    return False


def _with_own(problem: Problem, place: Array, shared: list[int]) -> Array:
    """A place with the parameters of single data sets fitted roughly, those that are shared held."""
    held = {index: float(place[index]) for index in shared}
    return minimise(problem, aligned(problem, place), held, converged=ROUGH, tries=FEW)


def aligned(problem: Problem, place: Array) -> Array:
    """A place with the triggers at which the motion there is most like the traces; as it is where none can be found."""
    moved = place.copy()
    for data in problem.sets:
        simulation = simulated(data, of_motion(own_values(problem, data, place))) if data.records else None
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
    """The fit at a place that is known to be a minimum."""
    return Fit(problem, place, residual(problem, place), jacobian(problem, place), others)


def minimise(
    problem: Problem,
    start: Array,
    held: Mapping[int, float] | None = None,
    left_out: Collection[int] = (),
    converged: float = FINE,
    tries: int = EVALUATIONS,
) -> Array:
    """Coordinates of the minimum that a descent from ``start`` ends in.

    Args:
        problem: what is fitted.
        start: coordinates, shape (parameters,).
        held: coordinates by index of the parameters that keep them.
        left_out: rows of the residual that do not count.
        converged: relative change at which it ends.
        tries: evaluations at most.
    """
    from scipy.optimize import least_squares

    place = np.clip(start, 0.0, 1.0)
    for index, value in (held or {}).items():
        place[index] = value
    moving = [index for index in range(len(place)) if index not in (held or {})]
    counting = np.setdiff1d(np.arange(problem.rows), list(left_out))
    if not moving or not counting.size:
        return place

    def off(x: Array) -> Array:
        return np.asarray(residual(problem, _moved(place, moving, x))[counting])

    def slopes(x: Array) -> Array:
        return np.asarray(jacobian(problem, _moved(place, moving, x), moving)[counting])

    inside = np.clip(place[moving], EDGE, 1 - EDGE)
    ends: Any = {"xtol": converged, "ftol": converged, "gtol": None, "max_nfev": tries}
    with np.errstate(invalid="ignore", divide="ignore"):  # where nothing is seen there is no slope
        end = least_squares(off, inside, slopes, bounds=(0.0, 1.0), **ends)
    return _moved(place, moving, end.x)


def chi_square_at(problem: Problem, place: Array) -> float:
    """Chi-square at a place."""
    off = residual(problem, place)
    return float(off @ off)


def _moved(place: Array, moving: list[int], coordinates: Array) -> Array:
    moved = place.copy()
    moved[moving] = coordinates
    return moved
