"""Solved calibration problem: fit, uncertainty, profiles, predictions, and sentences about them."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from math import isfinite, nan, sqrt

import numpy as np

from drivers.base.units import quantity
from validation.calibration.certainty import RISES, Certainty, Prediction, Profile, predictions, profile
from validation.calibration.data_sets import CUT
from validation.calibration.fit import Fit, fit, fitted_at, minimise
from validation.calibration.free import Free
from validation.calibration.problem import MISSING_RESIDUAL, Problem, motion_values, own_values, simulated
from validation.calibration.readings import DEFAULT_CUT, is_censored

END_MARGIN = 1e-3  # share of a range: a parameter so close to a bound is at the end of its range
MAX_CORRELATION = 0.5  # of neighbouring residuals; above it they are not noise
NOISE_ERROR = 0.1  # relative; twice the standard error of a noise level from about 100 readings
MIN_GAIN = 0.01  # decrease of chi-square that makes another minimum the better one
MAX_REFITS = 3
MIN_PROBABILITY = 0.01  # of a chi-square; below it the model does not explain the data


@dataclass(frozen=True, eq=False)
class Outcome:
    """A fit with its uncertainty.

    Attributes:
        profiles: Profiles by label, of the searched parameters that the data determine; empty for a quick fit.
        predictions: One prediction for each datum.
    """

    fit: Fit
    certainty: Certainty
    profiles: dict[str, Profile]
    predictions: list[Prediction]

    @property
    def probability(self) -> float:
        """Probability of a chi-square at least as large by chance; NaN without degrees of freedom."""
        return probability_of(self.fit.chi_square, self.fit.freedom)

    @property
    def explained(self) -> bool:
        """True if noise can explain the residual; noise found from traces is uncertain by ``NOISE_ERROR``."""
        found = any(record.found for data in self.fit.problem.sets for record in data.records)
        chi_square = self.fit.chi_square / ((1 + NOISE_ERROR) ** 2 if found else 1.0)
        return not probability_of(chi_square, self.fit.freedom) < MIN_PROBABILITY

    @property
    def enlargement(self) -> float:
        """Factor on printed errors, from the scatter of the data: 1 if the model explains the data."""
        return 1.0 if self.explained else max(1.0, sqrt(self.fit.chi_square / self.fit.freedom))

    def value(self, index: int) -> float:
        """Fitted value of a parameter."""
        return self.fit.problem.free[index].value(float(self.fit.place[index]))

    def error(self, index: int) -> float:
        """Standard error of a parameter; inf if the data do not determine it."""
        return float(self.certainty.errors[index])

    def interval(self, index: int, rise: float) -> tuple[float, float]:
        """Interval of a parameter from its profile, or else from its standard error; NaN if it is undetermined."""
        label = self.fit.problem.free[index].label
        if label in self.profiles:
            return self.profiles[label].interval(rise)
        reach = sqrt(rise) * self.error(index)
        return (self.value(index) - reach, self.value(index) + reach) if isfinite(reach) else (nan, nan)

    def sentences(self) -> Iterator[str]:
        """Sentences on the goodness of the fit, other minima and undetermined parameters."""
        found = self.fit
        chance = f", probability {self.probability:.2g}" if found.freedom > 0 else ""
        counted = f"{found.freedom} degrees of freedom{chance}" if found.freedom >= 0 else "fewer data than parameters"
        yield f"chi-square {found.chi_square:.3g} with {counted}"
        if not self.explained:
            times = self.enlargement
            yield f"the model does not explain the data; their scatter gives errors {times:.2g} times larger"
        if found.reached < 2 <= found.descents and not len(self.certainty.open_directions):
            yield f"not sure: 1 of {found.descents} descents ended at this minimum; a better one may exist"
        yield from self._about_numbers()
        for free, x in zip(found.problem.free, found.place, strict=True):
            if not END_MARGIN < x < 1 - END_MARGIN:
                yield f"{free.label} is at the end of its range, {rounded(free, free.value(float(x)))}"
        for chi_square, place in found.others if not len(self.certainty.open_directions) else ():
            values = ", ".join(
                f"{free.label} {rounded(free, free.value(float(place[i])))}" for i, free in enumerate(found.problem.free)
            )
            yield f"another minimum with chi-square {chi_square:.4g}: {values}"
        yield from self.certainty.sentences()
        for datum in found.problem.data:
            off = found.residual[datum.rows.start : datum.rows.stop]
            correlation = float(np.corrcoef(off[:-1], off[1:])[0, 1]) if datum.number is None and len(off) > 1 else 0.0
            if correlation > MAX_CORRELATION:
                problem = f"{datum.label}: neighbouring residuals have a correlation of {correlation:.2f}"
                yield f"{problem}: they contain more than noise, and errors are larger than stated"
        for label, each in self.profiles.items():
            low, high = each.interval(RISES["95 %"])
            if not (isfinite(low) and isfinite(high)):
                sides = " and ".join(["above"] * (not isfinite(high)) + ["below"] * (not isfinite(low)))
                yield f"the data do not bound {label} {sides} within its range"

    def _about_numbers(self) -> Iterator[str]:
        """Numbers that the fitted motion does not have, and widths of which it shows a lower bound."""
        problem = self.fit.problem
        for line in self.predictions:
            number = line.datum.number
            if number is None:
                continue
            if not isfinite(line.fitted):
                counts = f"counts as {MISSING_RESIDUAL:.0f} standard errors"
                yield f"{line.datum.label} is missing from the computed motion and {counts}"
            gauge, width, _ = number.observable.partition("_full_width")
            data = next(each for each in problem.sets if each.name == line.datum.data_set)
            simulation = simulated(data, motion_values(problem, data, self.fit.place)) if width else None
            cut = own_values(problem, data, self.fit.place).get(CUT, DEFAULT_CUT)
            if simulation and is_censored(simulation, gauge, cut):
                yield f"{line.datum.label} is a lower bound: the force is above the cut until the wave meets the wall"


def probability_of(chi_square: float, freedom: int) -> float:
    """Probability of a chi-square at least as large by chance; NaN without degrees of freedom."""
    from scipy.stats import chi2

    return float(chi2.sf(chi_square, freedom)) if freedom > 0 else nan


def solve(
    problem: Problem,
    *,
    quick: bool = False,
    seeds: Sequence[Mapping[str, float]] = (),
    search: bool = True,
    count: Callable[[], None] = lambda: None,
) -> Outcome:
    """Fits; unless ``quick``, also profiles each searched parameter and leaves out each number in turn.

    If a profile finds a better minimum, the fit is repeated from there. ``count`` is called after each fit, point of a
    profile and datum; ``seeds`` and ``search`` are those of ``fit``.
    """
    found = fit(problem, seeds, search=search)
    count()
    for _ in range(MAX_REFITS):
        undetermined = Certainty(found).undetermined
        asked = [index for index in problem.searched if not quick and not undetermined[index]]
        profiles = {problem.free[index].label: profile(found, index, count) for index in asked}
        best = min(profiles.values(), key=lambda each: each.chi_square.min(), default=None)
        if best is None or best.chi_square.min() > found.chi_square - MIN_GAIN:
            break
        place = minimise(problem, best.places[int(np.argmin(best.chi_square))])
        found = fitted_at(problem, place, found.others, 1, found.descents)
        count()
    return Outcome(found, Certainty(found), profiles, predictions(found, leave_out=not quick, count=count))


def value_text(free: Free, value: float, error: float) -> str:
    """Value with its error to two digits, in a suitable unit."""
    if not isfinite(error):
        return f"undetermined: {rounded(free, free.low)} to {rounded(free, free.high)}"
    scale, places, unit = _digits(free, value, error)
    return f"{value * scale:.{places}f} ± {error * scale:.{places}f} {unit}".strip()


def interval_text(free: Free, ends: tuple[float, float], value: float, error: float) -> str:
    """Interval with digits as in ``value_text``; an open side is the end of the range, in brackets."""
    scale, places, unit = _digits(free, value, min(error, (free.high - free.low) / 10))
    shown = [
        f"{end * scale:.{places}f}" if isfinite(end) else f"({limit * scale:.{places}f})"
        for end, limit in zip(ends, (free.low, free.high), strict=True)
    ]
    return f"{shown[0]} .. {shown[1]} {unit}".strip()


def _digits(free: Free, value: float, error: float) -> tuple[float, int, str]:
    """Factor from the SI unit to a suitable unit, decimal places for two digits of the error, name of the unit."""
    scale, unit = 1.0, free.unit
    if unit and value:
        amount, unit = quantity(float(f"{value:.3g}"), free.unit).split(" ", 1)
        scale = float(amount) / float(f"{value:.3g}")
    return scale, int(np.clip(1 - np.floor(np.log10(error * scale)), 0, 12)) if error > 0 else 6, unit


def rounded(free: Free, value: float) -> str:
    """Value to three digits, with its unit."""
    return quantity(float(f"{value:.3g}"), free.unit) if free.unit else f"{value:.3g}"
