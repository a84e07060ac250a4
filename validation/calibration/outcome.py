"""Solved calibration problem: fit, uncertainty, profiles, predictions, and sentences about them."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from math import isfinite

import numpy as np

from drivers.base.units import quantity
from validation.calibration.certainty import RISES, Certainty, Prediction, Profile, predictions, profile
from validation.calibration.fit import Fit, at_edge, fit, fitted_at, minimise, refined_at_edge
from validation.calibration.free import Free
from validation.calibration.problem import MISSING_RESIDUAL, Problem

END_MARGIN = 1e-6  # share of a range: a parameter so close to a bound is at the end of its range
MAX_CORRELATION = 0.5  # of neighbouring residuals; above it they are not noise
NOISE_ERROR = 0.1  # relative; twice the standard error of a noise level from about 100 quiet readings
MIN_GAIN = 0.01  # decrease of chi-square that makes another minimum the better one
MAX_REFITS = 3
MIN_PROBABILITY = 0.01  # of a chi-square; below it the model does not explain the data


@dataclass(frozen=True, eq=False)
class Outcome:
    """A fit with its uncertainty.

    Attributes:
        profiles: Profiles by label, of the shared parameters that the data determine; empty for a quick fit.
        predictions: One prediction for each datum.
    """

    fit: Fit
    certainty: Certainty
    profiles: dict[str, Profile]
    predictions: list[Prediction]

    @property
    def probability(self) -> float:
        """Probability of a chi-square at least as large by chance; NaN without degrees of freedom."""
        return self._probability(self.fit.chi_square)

    @property
    def explained(self) -> bool:
        """True if noise can explain the residual; noise found from traces is uncertain by ``NOISE_ERROR``."""
        found = any(record.found for data in self.fit.problem.sets for record in data.records)
        return not self._probability(self.fit.chi_square / ((1 + NOISE_ERROR) ** 2 if found else 1.0)) < MIN_PROBABILITY

    @property
    def enlargement(self) -> float:
        """Factor on printed errors, from the scatter of the data: 1 if the model explains the data."""
        return 1.0 if self.explained else max(1.0, float(np.sqrt(self.fit.chi_square / self.fit.freedom)))

    def _probability(self, chi_square: float) -> float:
        from scipy.stats import chi2

        return float(chi2.sf(chi_square, self.fit.freedom)) if self.fit.freedom > 0 else float("nan")

    def error(self, label: str) -> float:
        """Standard error of a parameter; inf if the data do not determine it."""
        labels = [each.label for each in self.fit.problem.free]
        return float(self.certainty.errors[labels.index(label)])

    def sentences(self) -> Iterator[str]:
        """Sentences on the goodness of the fit, other minima and undetermined parameters."""
        found = self.fit
        chance = f", probability {self.probability:.2g}" if found.freedom > 0 else ""
        counted = f"{found.freedom} degrees of freedom{chance}" if found.freedom >= 0 else "fewer data than parameters"
        yield f"chi-square {found.chi_square:.3g} with {counted}"
        if not self.explained:
            times = self.enlargement
            yield f"the model does not explain the data; their scatter gives errors {times:.2g} times larger"
        for datum in found.problem.data:
            if datum.number is not None and datum.number.fitted and not self._shown(datum.name, datum.data_set):
                counted = f"counts as {MISSING_RESIDUAL:.0f} standard errors"
                yield f"{datum.label} is missing from the computed motion and {counted}"
        for free, x in zip(found.problem.free, found.place, strict=True):
            if not END_MARGIN < x < 1 - END_MARGIN:
                yield f"{free.label} is at the end of its range, {_rounded(free, free.value(float(x)))}"
        if at_edge(found.problem, found.place):
            yield "next to these values a datum is missing from the motion: the fit lies at this edge"
        for chi_square, place in found.others if not len(self.certainty.open_directions) else ():
            values = ", ".join(f"{label} {value:.4g}" for label, value in found.problem.values(place).items())
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

    def _shown(self, name: str, data_set: str) -> bool:
        own = [each for each in self.predictions if each.datum.name == name and each.datum.data_set == data_set]
        return all(isfinite(each.fitted) for each in own)


def solve(problem: Problem, *, quick: bool = False, count: Callable[[], None] = lambda: None) -> Outcome:
    """Fits; unless ``quick``, also profiles each shared parameter and leaves out each datum in turn.

    If a profile finds a better minimum, the fit is repeated from there. ``count`` is called after each fit, point of a
    profile and datum.
    """
    found = fit(problem)
    count()
    for _ in range(MAX_REFITS):
        profiles = {} if quick else _profiles(found, count)
        best = min(profiles.values(), key=lambda each: each.chi_square.min(), default=None)
        if best is None or best.chi_square.min() > found.chi_square - MIN_GAIN:
            break
        place = minimise(problem, best.places[int(np.argmin(best.chi_square))])
        found = fitted_at(problem, refined_at_edge(problem, place), found.others)
        count()
    return Outcome(found, Certainty(found), profiles, predictions(found, leave_out=not quick, count=count))


def _profiles(found: Fit, count: Callable[[], None]) -> dict[str, Profile]:
    """Profiles of the shared parameters that the data determine, by label."""
    undetermined, free = Certainty(found).undetermined, found.problem.free
    asked = [index for index, each in enumerate(free) if not (each.own or undetermined[index])]
    return {free[index].label: profile(found, index, count) for index in asked}


def value_text(free: Free, value: float, error: float) -> str:
    """Value with its error to two digits, in a suitable unit."""
    if not isfinite(error):
        return f"undetermined: {_rounded(free, free.low)} to {_rounded(free, free.high)}"
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


def _rounded(free: Free, value: float) -> str:
    return quantity(float(f"{value:.3g}"), free.unit) if free.unit else f"{value:.3g}"
