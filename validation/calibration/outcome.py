"""Solved calibration problem: rows of its tables, and sentences about it."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from math import hypot, isfinite, isnan, log, nan, sqrt

import numpy as np

from drivers.base.units import quantity
from postproc.read.observables import describe
from validation.calibration.data_sets import CUT, DataSet, MeasuredNumber
from validation.calibration.fit import (
    CLOSE_CHANGE,
    RISES,
    Fit,
    Point,
    chi_square_at,
    fit,
    fitted_at,
    for_each,
    interval,
    minimise,
    profile,
    trade_offs,
)
from validation.calibration.problem import (
    MISSING_RESIDUAL,
    Datum,
    Problem,
    motion_values,
    own_values,
    predicted,
    simulated,
)
from validation.calibration.readings import DEFAULT_CUT, is_censored

END_MARGIN = 1e-3  # share of a range: a parameter so close to a bound is at the end of its range
MAX_CORRELATION = 0.5  # of neighbouring residuals; above it they are not noise
NOISE_ERROR = 0.1  # relative; twice the standard error of a noise level from about 100 readings
MIN_GAIN = 0.01  # decrease of chi-square that makes another minimum the better one
MAX_REFITS = 3
MIN_PROBABILITY = 0.01  # of a chi-square; below it the model does not explain the data
MAX_DEVIATION = 2.0  # standard errors; data with larger deviations are missed


@dataclass(frozen=True)
class FitRow:
    """Goodness of a law's fit; AIC and BIC are Akaike's and Schwarz's criteria for known errors.

    ``data`` names the data sets, or the reading of the paper; ``missed`` the numbers that deviate by more than
    ``MAX_DEVIATION`` standard errors; ``remarks`` are separated by ". ".
    """

    law: str
    data: str
    chi_square: float
    freedom: int
    probability: float
    aic: float
    bic: float
    missed: str
    remarks: str


@dataclass(frozen=True)
class Parameter:
    """A parameter of one fit, in the SI unit of its key; the standard error is inf if the data do not determine it.

    ``start``, ``least`` and ``most`` are its starting value and bounds; ``prior`` is 0 without prior knowledge.
    """

    law: str
    data: str
    parameter: str
    unit: str
    value: float
    error: float
    low_68pct: float
    high_68pct: float
    low_95pct: float
    high_95pct: float
    start: float
    least: float
    most: float
    prior: float


@dataclass(frozen=True)
class DatumRow:
    """A datum with its fitted value and its prediction by a fit without it; NaN if there is no number.

    Attributes:
        off: Fitted minus measured in standard errors of the measurement; of a trace the rms.
        by_the_others_off: Prediction of the fit to all other data minus measured, in standard errors of both combined.
        chi_square_without: Chi-square of that fit.
    """

    law: str
    data: str
    data_set: str
    datum: str
    unit: str
    measured: float
    error: float
    fitted: float
    fitted_error: float
    off: float
    by_the_others: float = nan
    by_the_others_error: float = nan
    by_the_others_off: float = nan
    chi_square_without: float = nan
    because: str = ""

    @property
    def label(self) -> str:
        """Name of the data set and of the datum."""
        return f"{self.data_set}: {self.datum}" if self.data_set else self.datum


@dataclass(frozen=True, eq=False)
class Outcome:
    """A fit with the rows of its tables."""

    fit: Fit
    row: FitRow
    parameters: list[Parameter]
    data: list[DatumRow]

    @property
    def explained(self) -> bool:
        """True if noise can explain the residual; noise found from traces is uncertain by ``NOISE_ERROR``."""
        estimated = any(record.found for data in self.fit.problem.sets for record in data.records)
        chi_square = self.fit.chi_square / ((1 + NOISE_ERROR) ** 2 if estimated else 1.0)
        return not probability_of(chi_square, self.fit.freedom) < MIN_PROBABILITY

    @property
    def enlargement(self) -> float:
        """Factor on printed errors, from the scatter of the data: 1 if the model explains the data."""
        return 1.0 if self.explained else max(1.0, sqrt(self.fit.chi_square / self.fit.freedom))


def probability_of(chi_square: float, freedom: int) -> float:
    """Probability of a chi-square at least as large by chance; NaN without degrees of freedom."""
    from scipy.stats import chi2

    return float(chi2.sf(chi_square, freedom)) if freedom > 0 else nan


def solve(
    problem: Problem,
    law: str = "",
    reading: str = "",
    *,
    quick: bool = False,
    seeds: Sequence[Mapping[str, float]] = (),
    search: bool = True,
    count: Callable[[], None] = lambda: None,
) -> Outcome:
    """Fits; unless ``quick``, also profiles each searched parameter and leaves out each number in turn.

    If a profile finds a better minimum, the fit is repeated from there.

    Args:
        problem: Data and parameters.
        law: Name of the law, for the tables.
        reading: Name of the data, for the tables.
        quick: True for the fit alone.
        seeds: As those of ``fit``.
        search: As that of ``fit``.
        count: Called after each fit, and after the profiles.
    """
    best, profiles = fit(problem, seeds, search=search), dict[int, list[Point]]()
    count()
    for _ in range(0 if quick else MAX_REFITS):
        bounded = [i for i in problem.searched if not best.undetermined[i]]
        profiles = dict(zip(bounded, for_each(problem, partial(profile, best), bounded), strict=True))
        count()
        lowest = min((point for points in profiles.values() for point in points), key=lambda p: p[1], default=None)
        if lowest is None or lowest[1] > best.chi_square - MIN_GAIN:
            break
        best = fitted_at(problem, minimise(problem, lowest[2]), best.others, 1, best.descents)
        count()
    names = law, reading
    parameters = [_parameter(best, names, index, profiles.get(index)) for index in range(len(problem.free))]
    one = partial(_datum, best, names, leave_out=not quick)
    data = [*map(one, problem.data)] if quick else for_each(problem, one, problem.data)
    numbers = zip(data, problem.data, strict=True)
    missed = [row.label for row, datum in numbers if datum.number and not abs(row.off) <= MAX_DEVIATION]
    row = FitRow(
        *names, best.chi_square, best.freedom, probability_of(best.chi_square, best.freedom),
        best.chi_square + 2 * len(problem.free), best.chi_square + len(problem.free) * log(problem.rows),
        "; ".join(missed), ". ".join(_remarks(best, parameters, data)),
    )  # fmt: skip
    return Outcome(best, row, parameters, data)


def _parameter(best: Fit, names: tuple[str, str], index: int, points: list[Point] | None) -> Parameter:
    """Row of a parameter; ``names`` are those of the law and of the data."""
    free, error = best.problem.free[index], float(best.errors[index])
    known = [interval(best, index, rise, points) if isfinite(error) else (nan, nan) for rise in RISES.values()]
    value = free.value(float(best.place[index]))
    return Parameter(
        *names, free.label, free.unit, value, error, *known[0], *known[1], free.start, free.low, free.high, free.prior
    )


def _datum(best: Fit, names: tuple[str, str], datum: Datum, *, leave_out: bool) -> DatumRow:
    """Row of a datum; for traces and prior knowledge only the deviation in standard errors."""
    number = datum.number
    if number is None:
        rows = best.residual[datum.rows.start : datum.rows.stop]
        off = float(np.sqrt(np.mean(rows**2)))
        return DatumRow(*names, datum.data_set, datum.name, "", nan, nan, nan, nan, off)
    value, error = _number(best, datum.data_set, number)
    unit = describe(datum.name).unit or datum.name.rpartition("_")[2]
    unit = f"1/{unit}" if datum.name.endswith(f"_per_{unit}") else unit
    off = (value - number.value) / number.error
    measured = number.value, number.error
    row = DatumRow(*names, datum.data_set, datum.name, unit, *measured, value, error, off, because=number.because)
    if not leave_out:
        return row
    place = minimise(best.problem, best.place, left_out=datum.rows, converged=CLOSE_CHANGE)
    kept = np.setdiff1d(np.arange(best.problem.rows), list(datum.rows))
    rest = Fit(best.problem, place, best.residual[kept], best.jacobian[kept])
    row = replace(row, chi_square_without=chi_square_at(best.problem, place, kept))
    if len(rest.open_directions):
        return row
    without, error = _number(rest, datum.data_set, number)
    off = (without - number.value) / hypot(error, number.error)
    return replace(row, by_the_others=without, by_the_others_error=error, by_the_others_off=off)


def _number(best: Fit, data_set: str, number: MeasuredNumber) -> tuple[float, float]:
    """A number in the fitted motion, with its standard error."""
    problem, data = best.problem, _set(best.problem, data_set)
    return best.number(
        lambda place: predicted(data, number, motion_values(problem, data, place), own_values(problem, data, place))
    )


def _set(problem: Problem, name: str) -> DataSet:
    return next(data for data in problem.sets if data.name == name)


def _remarks(best: Fit, parameters: Sequence[Parameter], data: Sequence[DatumRow]) -> Iterator[str]:
    """Sentences on other minima, undetermined parameters, and numbers that the motion does not have."""
    problem, certain = best.problem, not len(best.open_directions)
    if best.reached < 2 <= best.descents and certain:
        yield f"not sure: 1 of {best.descents} descents ended at this minimum; a better one may exist"
    for datum, line in zip(problem.data, data, strict=True):
        if datum.number is None:
            continue
        if not isfinite(line.fitted):
            counts = f"counts as {MISSING_RESIDUAL:.0f} standard errors"
            yield f"{line.label} is missing from the computed motion and {counts}"
        gauge, width, _ = line.datum.partition("_full_width")
        source = _set(problem, line.data_set)
        simulation = simulated(source, motion_values(problem, source, best.place)) if width else None
        if simulation and is_censored(simulation, gauge, own_values(problem, source, best.place).get(CUT, DEFAULT_CUT)):
            yield f"{line.label} is a lower bound: the force is above the cut until the wave meets the wall"
    for row, x in zip(parameters, best.place, strict=True):
        if not END_MARGIN < x < 1 - END_MARGIN:
            yield f"{row.parameter} is at the end of its range, {rounded(row.value, row.unit)}"
        open_ends = [side for side, end in (("below", row.low_95pct), ("above", row.high_95pct)) if abs(end) == np.inf]
        if open_ends:
            yield f"the data do not bound {row.parameter} {' and '.join(open_ends)} within its range"
    for chi_square, place in best.others if certain else ():
        units, values = [row.unit for row in parameters], problem.values(place)
        shown = ", ".join(f"{name} {rounded(x, unit)}" for (name, x), unit in zip(values.items(), units, strict=True))
        yield f"another minimum with chi-square {chi_square:.4g}: {shown}"
    yield from trade_offs(best)
    for datum, line in zip(problem.data, data, strict=True):
        off = best.residual[datum.rows.start : datum.rows.stop]
        correlation = float(np.corrcoef(off[:-1], off[1:])[0, 1]) if datum.number is None and len(off) > 1 else 0.0
        if correlation > MAX_CORRELATION:
            sentence = f"{line.label}: neighbouring residuals have a correlation of {correlation:.2f}"
            yield f"{sentence}: they contain more than noise, and errors are larger than stated"


def value_text(row: Parameter, factor: float = 1.0) -> str:
    """Value with its error to two digits, in a suitable unit; the error is multiplied by a factor."""
    if not isfinite(row.error):
        return f"undetermined: {rounded(row.least, row.unit)} to {rounded(row.most, row.unit)}"
    return with_error(row.value, row.error * factor, row.unit)


def with_error(value: float, error: float, unit: str) -> str:
    """Value with its error to two digits, in a suitable unit."""
    scale, places, unit = _digits(value, error, unit)
    return f"{value * scale:.{places}f} ± {error * scale:.{places}f} {unit}".strip()


def interval_text(row: Parameter, ends: tuple[float, float]) -> str:
    """Interval with digits as in ``value_text``; an open side is the end of the range, in brackets; empty for NaN."""
    if isnan(ends[0]):
        return ""
    scale, places, unit = _digits(row.value, min(row.error, (row.most - row.least) / 10), row.unit)
    shown = [
        f"{end * scale:.{places}f}" if isfinite(end) else f"({limit * scale:.{places}f})"
        for end, limit in zip(ends, (row.least, row.most), strict=True)
    ]
    return f"{shown[0]} .. {shown[1]} {unit}".strip()


def _digits(value: float, error: float, unit: str) -> tuple[float, int, str]:
    """Factor from the SI unit to a suitable unit, decimal places for two digits of the error, name of the unit."""
    scale, unit = suited(value, unit)
    return scale, int(np.clip(1 - np.floor(np.log10(error * scale)), 0, 12)) if error > 0 else 6, unit


def suited(value: float, unit: str) -> tuple[float, str]:
    """Factor from the SI unit to a unit that suits a value, and that unit."""
    if not (unit and value):
        return 1.0, unit
    amount, unit = quantity(float(f"{value:.3g}"), unit).split(" ", 1)
    return float(amount) / float(f"{value:.3g}"), unit


def rounded(value: float, unit: str) -> str:
    """Value to three digits, with its unit."""
    return quantity(float(f"{value:.3g}"), unit) if unit else f"{value:.3g}"
