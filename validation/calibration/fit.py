"""Least squares from several starting points, the uncertainty of the parameters found, and the tables of a fit."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from math import ceil, exp, inf, isfinite, log, log2, nan, sqrt
from typing import Any, Literal, TypeVar

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy.optimize import least_squares
from scipy.stats import chi2, qmc
from scipy.stats import f as f_distribution

from drivers.base.errors import RunError
from drivers.base.units import quantity
from drivers.chain.chain import Array
from drivers.run.execute import Place, execute
from validation.calibration.parameters import calibration_file
from validation.calibration.problem import MISSING_RESIDUAL, Datum, Problem, exact_numbers

SCREENED_POINTS, DESCENTS = 8, 3  # points tried over the ranges for each parameter, and descents from the best
ROUGH_CHANGE, CLOSE_CHANGE, FINE_CHANGE = 1e-3, 1e-5, 1e-6  # of chi-square or coordinates, at the end of a descent
MAX_EVALUATIONS, MAX_ROUGH_EVALUATIONS = 120, 6  # of one descent
# share of a range between a bound and the start of a descent: a restitution of 1 - 1e-5 has no exact motion
MARGIN = 1e-4
MIN_SEPARATION = 0.2  # share of a range, between two starts
MAX_EXCESS, SAME = 1.0, 0.1  # of chi-square: another minimum is reported, and descents have reached the same minimum
MIN_RISE = 10.0  # of chi-square by the sensitivities, between two minima; less is a valley
MIN_GAIN, MAX_REFITS = 0.01, 3  # decrease of chi-square in a profile that makes another fit, and the number of these

ROUNDING_ERROR = 0.1  # relative: errors of rounding without much noise are correlated
MIN_PROBABILITY = 1e-3  # of a residual by noise alone; below it the model does not explain the data
MAX_DEVIATION = 2.0  # standard errors; data with larger deviations are missed
END_MARGIN = 1e-3  # share of a range: a parameter so close to a bound is at the bound
RANGE_DEVIATION = 1 / sqrt(12)  # standard deviation of a parameter known only by its range, as a share of the range
MIN_UNFITTED = 1e-6  # 1 less the leverage of a number: one with a smaller share has a parameter of its own
MIN_COMPONENT = 0.1  # of a direction, relative to its largest; smaller components are not named
MIN_INFLATION = 10.0  # growth of an error by the uncertainty of the other parameters, from which it is reported
RISES = {"68 %": 1.0, "95 %": 3.841458820694124}  # rise of chi-square at the ends of intervals (Wilks, one parameter)
MAX_RISE, STRIDE, MAX_POINTS = 5.0, 0.6, 12  # of a profile: rise, standard errors between points, points on each side
COLOURS = ("#0072b2", "#d55e00", "#555555", "#cc79a7", "#999933", "#56b4e9")
LOOKS = [*zip(COLOURS, "osvDP^", strict=True)]  # colours and markers of laws
LAWS, PARAMETERS, DATA, EXACT = "laws", "parameters", "data", "exact"  # tables of a fit
DECISIVE, LEANING = 10.0, 2.0  # excess of Akaike's criterion: a law that has no support, and one with less

Tables = dict[str, pd.DataFrame]
Seeds = Sequence[Mapping[str, float]]  # values of parameters by label
Point = tuple[float, float, Array]  # coordinate, chi-square, and coordinates of all parameters
Item = TypeVar("Item")
Result = TypeVar("Result")


@dataclass(frozen=True, eq=False)
class Fit:
    """A least-squares fit, with the linear estimate of its uncertainty from the sensitivities at the minimum.

    Attributes:
        place: Coordinates of the parameters. Shape (parameters,).
        ends: Coordinates at the ends of the descents that led to it, the lowest first; none if it was known.
    """

    problem: Problem
    place: Array
    ends: Sequence[Array] = ()

    @cached_property
    def residual(self) -> Array:
        """Residual in standard errors. Shape (rows,)."""
        return self.problem.residual(self.place)

    @cached_property
    def jacobian(self) -> Array:
        """Derivatives of the residual by the coordinates. Shape (rows, parameters)."""
        return self.problem.jacobian(self.place)

    @property
    def chi_square(self) -> float:
        """Sum of the squared residuals."""
        return float(self.residual @ self.residual)

    @property
    def aic(self) -> float:
        """Akaike's criterion for known errors."""
        return self.chi_square + 2 * len(self.place)

    @property
    def freedom(self) -> int:
        """Degrees of freedom: data minus parameters minus coefficients of the fitted base lines of traces."""
        lines = sum(len(channel.base_lines.T) for data in self.problem.sets for channel in data.channels)
        return self.problem.rows - len(self.place) - lines

    @cached_property
    def misfit(self) -> tuple[float, float, float]:
        """Chi-square per degree of freedom of what the noise leaves to explain; these degrees, and those of the noise.

        Noise that was found from traces is that of their regression splines, which have the residual ``n - p`` of n
        readings by p coefficients in its unit: what chi-square has beyond is left. Noise that is stated has infinite
        degrees, and noise that is mere rounding is uncertain by ``ROUNDING_ERROR``.
        """
        found = [each for data in self.problem.sets for each in data.channels if each.trace.noise is None]
        splines = [each for each in found if each.coefficients]
        residual = sum(float(each.counts.sum() * (1 - each.coefficients / len(each.counts))) for each in splines)
        chi_square = self.chi_square / (1 + ROUNDING_ERROR * (len(splines) < len(found))) ** 2
        lacking = self.freedom - residual
        if not splines or lacking <= 0:
            return (chi_square / self.freedom if self.freedom else 0.0), self.freedom, inf
        return (chi_square - residual) / lacking, lacking, residual

    @cached_property
    def probability(self) -> float:
        """Probability of as bad a fit by noise alone, by the F-test of lack of fit, or that of chi-square."""
        ratio, lacking, known = self.misfit
        return float(f_distribution.sf(ratio, lacking, known) if isfinite(known) else chi2.sf(ratio * lacking, lacking))

    @property
    def explained(self) -> bool:
        """True if noise can explain the residual."""
        return not self.probability < MIN_PROBABILITY

    @property
    def enlargement(self) -> float:
        """Factor on printed errors, from the scatter of the data: 1 if the model explains the data."""
        return 1.0 if self.explained else max(1.0, sqrt(self.misfit[0]))

    @property
    def values(self) -> dict[str, float]:
        """Values of the parameters, by label."""
        return self.problem.values(self.place)

    @cached_property
    def directions(self) -> tuple[Array, Array]:
        """Singular values of the Jacobian, and its right singular vectors as rows; as many as parameters."""
        square = np.zeros((len(self.place), len(self.place)))  # there may be fewer data than parameters
        _, singular, directions = np.linalg.svd(np.vstack([self.jacobian, square]), full_matrices=False)
        return singular, directions

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
        return np.asarray(named(self.open_directions).any(axis=0))

    @cached_property
    def slopes(self) -> Array:
        """Derivatives of the values by the coordinates. Shape (parameters,)."""
        return np.array([free.slope(float(x)) for free, x in zip(self.problem.free, self.place, strict=True)])

    @property
    def errors(self) -> Array:
        """Standard errors of the values, inf for undetermined parameters. Shape (parameters,)."""
        return np.where(self.undetermined, inf, np.abs(self.slopes) * np.sqrt(np.diag(self.covariance)))


def weights_of(fits: Mapping[str, Fit]) -> dict[str, float]:
    """Akaike weights of the laws that hold, up to ``DECISIVE`` above the best; of all laws if none explains the data.

    They are proportional to ``exp(-AIC / 2)``: Burnham and Anderson, Model selection and multimodel inference, 2002,
    2.9.
    """
    able = {law: fit for law, fit in fits.items() if fit.explained} or fits
    shares = {law: exp(-excess / 2) for law, excess in excess_of(able).items() if excess < DECISIVE}
    return {law: share / sum(shares.values()) for law, share in shares.items()}


def excess_of(fits: Mapping[str, Fit]) -> dict[str, float]:
    """Excess of Akaike's criterion over the best law.

    Where that does not explain the data, the excess is divided by the square of the enlargement of its errors.
    """
    best = min(fits.values(), key=lambda fit: fit.aic)
    return {law: (fit.aic - best.aic) / best.enlargement**2 for law, fit in fits.items()}


def taken_as_exact(fit: Fit) -> pd.DataFrame:
    """Changes of the parameters of the motion by 1 % of each number of the scenes, or gain, that is taken as exact.

    The number is a further parameter, with the column k of the Jacobian. A change of its coordinate by s moves the
    minimum by ``-(J^T J)^-1 J^T k s`` with the Jacobian J of the fit.
    """
    problem, rows = fit.problem, list[tuple[str | float, ...]]()
    for free in exact_numbers(problem):
        place, wide = np.append(fit.place, free.coordinate(free.start)), replace(problem, free=(*problem.free, free))
        column = wide.jacobian(place, [len(fit.place)])[:, 0] * 0.01 * free.start / free.slope(float(place[-1]))
        changes = fit.slopes * -(fit.covariance @ (fit.jacobian.T @ column))
        for own, change, error in zip(problem.free, changes.tolist(), fit.errors.tolist(), strict=True):
            if own.of_motion and column.any():
                rows.append((free.label, own.label, own.unit, change, error))
    return pd.DataFrame(rows, columns=["key", "parameter", "unit", "change_by_1pct", "error"])


def for_each(problem: Problem, work: Callable[[Item], Result], items: Sequence[Item]) -> list[Result]:
    """Results of all items, by worker processes; by this one for a single data set, as fast as they would start."""
    if len(problem.sets) == 1:
        return [*map(work, items)]
    results = {id(item): result for item, result in execute(work, items, Place(processes=True))}
    return [results[id(item)] for item in items]


def named(directions: Array) -> NDArray[np.bool_]:
    """True for each parameter that takes part in a direction. Shape of the directions, (..., parameters)."""
    sizes = np.abs(directions)
    return np.asarray(sizes > MIN_COMPONENT * sizes.max(axis=-1, keepdims=True, initial=0.0))


def fit(problem: Problem, seeds: Seeds = (), *, search: bool = True) -> Fit:
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
    starts, lower = [_seeded(problem, seed) for seed in seeds], partial(minimise, problem, converged=ROUGH_CHANGE)
    places = for_each(problem, lower, [*_starts(problem), *starts]) if search else [*map(lower, starts)]
    ends = sorted(places, key=problem.chi_square)
    if not isfinite(problem.chi_square(ends[0])):
        message = "the exact motion cannot be computed at the starting values or at any other point of the ranges"
        raise RunError(f"fit: {message}; narrow the bounds of --free")
    return Fit(problem, minimise(problem, minimise(problem, ends[0], converged=CLOSE_CHANGE)), ends)


def _seeded(problem: Problem, seed: Mapping[str, float]) -> Array:
    """Coordinates of a seed; parameters that one data set has alone are fitted roughly if the seed has none."""
    values = {free.label: calibration_file().none.get(free.key) for free in problem.free} | dict(seed)
    place = np.array([free.coordinate(free.start if (x := values[free.label]) is None else x) for free in problem.free])
    missing = any(free.own and free.of_motion and free.label not in seed for free in problem.free)
    return _with_others(problem, place, MAX_EVALUATIONS) if missing else problem.with_triggers(place)


def _starts(problem: Problem) -> list[Array]:
    """The scene's values, the best places over the ranges, and the minima of the models inside the problem."""
    searched, places = problem.searched, list[Array]()
    count = ceil(log2(SCREENED_POINTS * max(len(searched), 1)))
    draws = qmc.Sobol(len(searched), seed=0).random_base2(count) if searched else ()
    places_drawn = [_moved(problem.start, searched, draw) for draw in draws]
    first, *drawn = for_each(problem, partial(_with_others, problem), [problem.start, *places_drawn])
    for place in sorted(drawn, key=problem.chi_square):
        if len(places) < DESCENTS and all(np.abs(place - each)[searched].max() > MIN_SEPARATION for each in places):
            places.append(place)
    inside = set[tuple[int, float]]()
    for index in searched:
        free, none = problem.free[index], calibration_file().none
        inside |= {(index, free.coordinate(value)) for value in (free.start, none.get(free.key, free.start))}
    held = [{index: coordinate} for index, coordinate in sorted(inside)]
    return [first, *places, *for_each(problem, partial(minimise, problem, first, converged=ROUGH_CHANGE), held)]


def _with_others(problem: Problem, place: Array, tries: int = MAX_ROUGH_EVALUATIONS) -> Array:
    """``place`` with all parameters fitted that are not searched, by some evaluations."""
    held = {index: float(place[index]) for index in problem.searched}
    return minimise(problem, problem.with_triggers(place), held, converged=ROUGH_CHANGE, tries=tries)


def minimise(
    problem: Problem,
    start: Array,
    held: Mapping[int, float] = {},
    converged: float = FINE_CHANGE,
    tries: int = MAX_EVALUATIONS,
) -> Array:
    """Coordinates of the lowest point of a descent from ``start``; ``start`` itself where it has no motion.

    Args:
        problem: Data and parameters.
        start: Coordinates. Shape (parameters,).
        held: Coordinates of parameters that are kept constant, by index.
        converged: Relative change at which the descent ends.
        tries: Largest number of evaluations.
    """
    begun = np.clip(start, 0.0, 1.0)
    begun[[*held]] = [*held.values()]
    moving = [index for index in range(len(begun)) if index not in held]
    at, inside = partial(_moved, begun, moving), np.clip(begun[moving], MARGIN, 1 - MARGIN)
    if not moving or not np.isfinite(problem.residual(at(inside))).all():
        return begun
    method: Literal["dogbox", "trf"] = "dogbox" if converged == FINE_CHANGE else "trf"  # for bounds

    def off(coordinates: Array) -> Array:
        return problem.residual(at(coordinates))

    def slopes(coordinates: Array) -> Array:
        return problem.jacobian(at(coordinates), moving)

    with np.errstate(invalid="ignore", divide="ignore"):  # the slope is zero if all data are missing
        # a point without a motion has infinite residuals, from which least squares steps back
        found = least_squares(off, inside, slopes, (0, 1), method, converged, converged, None, max_nfev=tries)
    return min(begun, at(found.x), key=problem.chi_square)


def _moved(place: Array, moving: Sequence[int], coordinates: Sequence[float] | Array) -> Array:
    moved = place.copy()
    moved[list(moving)] = coordinates
    return moved


def trade_offs(fit: Fit) -> Iterator[str]:
    """Sentences on parameters that the data do not determine, or barely distinguish."""
    free = fit.problem.free
    groups = [("cannot", direction, np.flatnonzero(named(direction))) for direction in fit.open_directions]
    alone = np.maximum(np.linalg.norm(fit.jacobian, axis=0), 1 / RANGE_DEVIATION)
    inflation = np.sqrt(np.diag(fit.covariance)) * alone  # each error divided by that with all others known
    weak = np.flatnonzero((inflation > MIN_INFLATION) & ~fit.undetermined)
    if len(weak) > 1:
        singular, directions = fit.directions
        groups.append(("barely", directions[int(np.argmin(singular))], weak))
    for how, direction, members in groups:
        names = " and ".join(free[i].label for i in members)
        if len(members) == 1:
            yield f"the data do not determine {names}"
        else:
            yield f"the data {how} distinguish {names}: they trade off along {_along(fit, direction, members)}"


def _along(fit: Fit, direction: Array, members: NDArray[np.intp]) -> str:
    """Changes of parameters along a direction, scaled to a largest relative change of 10 %.

    A trigger has an arbitrary zero, so its change is a time.
    """
    free, changes, values = fit.problem.free, direction * fit.slopes, [*fit.values.values()]
    shares = {i: changes[i] / (values[i] or free[i].high) for i in members if not free[i].is_trigger}
    scale = 0.1 / max(shares.values(), key=abs, default=1.0)
    texts = {i: rounded(scale * changes[i], "s") for i in members}
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
            points.append((target, fit.problem.chi_square(place), place))
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


def solve(problem: Problem, *, quick: bool = False, seeds: Seeds = (), search: bool = True) -> tuple[Fit, Tables]:
    """Fit; unless ``quick``, also profile each searched parameter.

    If a profile finds a better minimum, the fit is repeated from there.

    Args:
        problem: Data and parameters.
        quick: True for the fit alone.
        seeds: As those of ``fit``.
        search: As that of ``fit``.

    Returns:
        The fit, and its tables in the SI units of their rows:
        ``laws`` with the goodness; AIC and BIC are Akaike's and Schwarz's criteria for known errors;
        ``parameters`` with standard errors (inf if the data do not determine them), intervals, bounds and standard
        errors of prior knowledge (0 without it);
        ``data`` with ``off``, fitted minus measured in standard errors of the measurement (the rms for a trace), and
        for a number chi-square without it.
    """
    best, profiles = fit(problem, seeds, search=search), dict[int, list[Point]]()
    for _ in range(0 if quick else MAX_REFITS):
        bounded = [i for i in problem.searched if not best.undetermined[i]]
        profiles = dict(zip(bounded, for_each(problem, partial(profile, best), bounded), strict=True))
        lowest = min((point for points in profiles.values() for point in points), key=lambda p: p[1], default=None)
        if lowest is None or lowest[1] > best.chi_square - MIN_GAIN:
            break
        best = Fit(problem, minimise(problem, lowest[2]), best.ends)
    parameters = pd.DataFrame([_parameter(best, index, profiles.get(index)) for index in range(len(problem.free))])
    rows = pd.DataFrame([_datum(best, datum) for datum in problem.data])
    missed = rows[np.isfinite(rows["measured"]) & ~(rows["off"].abs() <= MAX_DEVIATION)]
    goodness = {
        "chi_square": best.chi_square, "freedom": best.freedom,
        "probability": best.probability,
        "aic": best.aic, "bic": best.chi_square + len(problem.free) * log(problem.rows),
        "missed": "; ".join(missed["data_set"] + ": " + missed["datum"]),
        "remarks": ". ".join(_remarks(best)),
    }  # fmt: skip
    return best, {LAWS: pd.DataFrame([goodness]), PARAMETERS: parameters, DATA: rows}


def _parameter(best: Fit, index: int, points: list[Point] | None) -> dict[str, Any]:
    """Row of a parameter."""
    free, place, error = best.problem.free[index], float(best.place[index]), float(best.errors[index])
    ends = [interval(best, index, rise, points) if isfinite(error) else (nan, nan) for rise in RISES.values()]
    bound = "lower bound" * (place <= END_MARGIN) or "upper bound" * (place >= 1 - END_MARGIN)
    return {
        "parameter": free.label, "unit": free.unit, "value": free.value(place), "error": error, "at": bound,
        "low_68pct": ends[0][0], "high_68pct": ends[0][1], "low_95pct": ends[1][0], "high_95pct": ends[1][1],
        "start": free.start, "least": free.low, "most": free.high, "prior": free.prior,
    }  # fmt: skip


def _datum(best: Fit, datum: Datum) -> dict[str, Any]:
    """Row of a datum; for traces and prior knowledge only the deviation in standard errors.

    A fit without a number of residual r has a chi-square lower by ``r^2 / (1 - h)``, where its leverage h is the
    variance of the fitted number in the square of its error: Cook and Weisberg, Residuals and Influence in Regression,
    1982, 2.2. This is exact for a linear model; fits to the paper's numbers but one, by laws that hold, differ from it
    by up to 0.9.
    """
    rows, number = best.residual[datum.rows.start : datum.rows.stop], isfinite(datum.value)
    off, error, without = float(np.sqrt(np.mean(rows**2))), nan, nan
    if number:
        slopes = best.jacobian[datum.rows.start]
        leverage = max(float(slopes @ best.covariance @ slopes), 0.0)
        off = float(best.problem.raw_residual(best.place)[datum.rows.start])
        error = datum.error * sqrt(leverage)
        without = max(best.chi_square - float(rows[0]) ** 2 / max(1.0 - leverage, MIN_UNFITTED), 0.0)
    return {
        "data_set": datum.data_set, "datum": datum.name, "unit": datum.unit if number else "",
        "measured": datum.value, "error": datum.error, "fitted": datum.value + off * datum.error, "fitted_error": error,
        "off": off, "chi_square_without": without, "because": datum.because,
    }  # fmt: skip


def _remarks(best: Fit) -> Iterator[str]:
    """Sentences on other minima, undetermined parameters, and numbers that the motion does not have."""
    problem, certain = best.problem, not len(best.open_directions)
    reached = sum(problem.chi_square(end) < best.chi_square * (1 + 5 * ROUGH_CHANGE) + SAME for end in best.ends)
    if reached < 2 <= len(best.ends) and certain:
        yield f"not sure: {reached} of {len(best.ends)} descents ended at this minimum; a better one may exist"
    missing = np.isnan(problem.raw_residual(best.place))
    for datum in problem.data:
        if missing[datum.rows.start]:
            counts = f"counts as {MISSING_RESIDUAL:.0f} standard errors"
            yield f"{datum.label} is missing from the computed motion and {counts}"
        if problem.censored(datum, best.place):
            yield f"{datum.label} is a lower bound: the force is above the cut until the wave meets the wall"
    near = [end for end in best.ends if problem.chi_square(end) < best.chi_square + MAX_EXCESS]
    others = [end for end in near if np.sum((best.jacobian @ (end - best.place)) ** 2) > MIN_RISE]
    for end in others[:certain]:
        pairs = zip(problem.free, problem.values(end).items(), strict=True)
        shown = ", ".join(f"{name} {rounded(value, free.unit)}" for free, (name, value) in pairs)
        yield f"another minimum with chi-square {problem.chi_square(end):.4g}: {shown}"
    yield from trade_offs(best)


def rows_of(table: pd.DataFrame) -> list[Any]:
    """Rows of a table with their columns as attributes."""
    return [*table.itertuples(index=False)]


def value_text(row: Any, factor: float = 1.0) -> str:
    """Value with its error, multiplied by a factor, to two digits in a suitable unit, and the bound that it is at."""
    at = f" (at its {row.at})" if row.at else ""
    if not isfinite(row.error):
        return f"undetermined: {rounded(row.least, row.unit)} to {rounded(row.most, row.unit)}{at}"
    return with_error(row.value, row.error * factor, row.unit) + at


def with_error(value: float, error: float, unit: str) -> str:
    """Value with its error to two digits, in a suitable unit."""
    (number, deviation), unit = digits((value, error), value, error, unit)
    return f"{number} ± {deviation} {unit}".strip()


def digits(numbers: Sequence[float], value: float, error: float, unit: str) -> tuple[list[str], str]:
    """Numbers with the digits of a value with its error, of which two are shown, in a suitable unit, and this unit."""
    scale, unit = suited(value, unit)
    places = int(np.clip(1 - np.floor(np.log10(error * scale)), 0, 12)) if 0 < error < inf else 6
    return [f"{number * scale:.{places}f}" for number in numbers], unit


def suited(value: float, unit: str) -> tuple[float, str]:
    """Factor from the SI unit to a unit that suits a value, and that unit; speeds stay in m/s."""
    if not (unit and value) or unit == "m/s":
        return 1.0, unit
    amount, unit = quantity(float(f"{value:.3g}"), unit).split(" ", 1)
    return float(amount) / float(f"{value:.3g}"), unit


def rounded(value: float, unit: str) -> str:
    """Value to three digits, with its unit."""
    return quantity(float(f"{value:.3g}"), unit) if unit else f"{value:.3g}"
