"""A solved problem of calibration: fit, certainty, profiles, predictions; and what they say."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from math import isfinite

import numpy as np

from drivers.base.units import quantity
from validation.calibration.certainty import RISES, Certainty, Prediction, Profile, predictions, profile
from validation.calibration.fit import Fit, at_edge, fit, fitted_at, minimise, settled
from validation.calibration.free import Free
from validation.calibration.problem import Problem

AT_END = 1e-6  # of a range
ALIKE = 0.5  # correlation of neighbouring residuals, from which on they are no noise
NOISE = 0.1  # relative: twice the standard error of a noise by a hundred quiet readings or so
BETTER = 0.01  # lower chi-square, which makes another minimum the better one
REFITS = 3  # at most
UNLIKELY = 0.01  # probability of a chi-square, below which the model does not explain the data


@dataclass(frozen=True, eq=False)
class Outcome:
    """A fit with all that is known of its certainty.

    Attributes:
        profiles: by label, of the parameters that were asked for and are told by the data.
        predictions: a line for each datum.
    """

    fit: Fit
    certainty: Certainty
    profiles: dict[str, Profile]
    predictions: list[Prediction]

    @property
    def probability(self) -> float:
        """Probability of a chi-square as large by chance; NaN without degrees of freedom."""
        return self._probability(self.fit.chi_square)

    @property
    def explained(self) -> bool:
        """Whether chance may leave what the model does; noise that was found in traces is known to ``NOISE`` only."""
        found = any(record.found for data in self.fit.problem.sets for record in data.records)
        return not self._probability(self.fit.chi_square / ((1 + NOISE) ** 2 if found else 1.0)) < UNLIKELY

    def _probability(self, chi_square: float) -> float:
        from scipy.stats import chi2

        return float(chi2.sf(chi_square, self.fit.freedom)) if self.fit.freedom > 0 else float("nan")

    def error(self, label: str) -> float:
        """Standard error of a parameter; inf where the data do not tell it."""
        labels = [each.label for each in self.fit.problem.free]
        return float(self.certainty.errors[labels.index(label)])

    def sentences(self) -> Iterator[str]:
        """Goodness of the fit, other minima, what the data leave open."""
        found = self.fit
        chance = f", probability {self.probability:.2g}" if found.freedom > 0 else ""
        counted = f"{found.freedom} degrees of freedom{chance}" if found.freedom >= 0 else "fewer data than parameters"
        yield f"chi-square {found.chi_square:.3g} with {counted}"
        if not self.explained:
            times = np.sqrt(found.chi_square / found.freedom)
            yield f"the model does not explain the data; errors would be {times:.2g} times as large by their scatter"
        for datum in found.problem.data:
            if datum.number is not None and datum.number.fitted and not self._shown(datum.name, datum.data_set):
                yield f"{datum.label} is not seen in the computed motion, and counts as 10 standard errors"
        for free, x in zip(found.problem.free, found.place, strict=True):
            if not AT_END < x < 1 - AT_END:
                yield f"{free.label} is at the end of its range, {_rounded(free, free.value(float(x)))}"
        if at_edge(found.problem, found.place):
            yield "next to these values a datum is no longer seen: the fit rests at that edge, where intervals may end"
        for chi_square, place in found.others if not len(self.certainty.open_directions) else ():
            values = ", ".join(f"{label} {value:.4g}" for label, value in found.problem.values(place).items())
            yield f"another minimum, of chi-square {chi_square:.4g}: {values}"
        yield from self.certainty.sentences()
        for datum in found.problem.data:
            off = found.residual[datum.rows.start : datum.rows.stop]
            if datum.number is None and len(off) > 1 and (alike := float(np.corrcoef(off[:-1], off[1:])[0, 1])) > ALIKE:
                words = f"{datum.label}: neighbouring residuals have a correlation of {alike:.2f}"
                yield f"{words}: the model leaves more than noise, and errors are larger than stated"
        for label, each in self.profiles.items():
            low, high = each.interval(RISES["95 %"])
            if not (isfinite(low) and isfinite(high)):
                sides = " and ".join(["above"] * (not isfinite(high)) + ["below"] * (not isfinite(low)))
                yield f"the data do not bound {label} {sides} within its range"

    def _shown(self, name: str, data_set: str) -> bool:
        own = [each for each in self.predictions if each.datum.name == name and each.datum.data_set == data_set]
        return all(isfinite(each.fitted) for each in own)


def solve(problem: Problem, *, quick: bool = False, count: Callable[[], None] = lambda: None) -> Outcome:
    """Fits, then profiles each shared parameter and leaves out each datum in turn; ``quick``: neither of these.

    A profile that comes upon a better minimum is where the fit begins anew. ``count`` is called for each fit, for each
    point of a profile and for each datum.
    """
    found = fit(problem)
    count()
    for _ in range(REFITS):
        profiles = {} if quick else _profiles(found, count)
        best = min(profiles.values(), key=lambda each: each.chi_square.min(), default=None)
        if best is None or best.chi_square.min() > found.chi_square - BETTER:
            break
        place = minimise(problem, best.places[int(np.argmin(best.chi_square))])
        found = fitted_at(problem, settled(problem, place), found.others)
        count()
    return Outcome(found, Certainty(found), profiles, predictions(found, leave_out=not quick, count=count))


def _profiles(found: Fit, count: Callable[[], None]) -> dict[str, Profile]:
    """Profiles of the shared parameters that the data tell, by label."""
    undetermined, free = Certainty(found).undetermined, found.problem.free
    asked = [index for index, each in enumerate(free) if not (each.own or undetermined[index])]
    return {free[index].label: profile(found, index, count) for index in asked}


def value_in_words(free: Free, value: float, error: float) -> str:
    """A value with as many digits as its error leaves, in a unit that suits it."""
    if not isfinite(error):
        return f"not told: {_rounded(free, free.low)} to {_rounded(free, free.high)}"
    scale, places, unit = _digits(free, value, error)
    return f"{value * scale:.{places}f} ± {error * scale:.{places}f} {unit}".strip()


def interval_in_words(free: Free, ends: tuple[float, float], value: float, error: float) -> str:
    """An interval with as many digits; a side that the data leave open is the range's end, in brackets."""
    scale, places, unit = _digits(free, value, min(error, (free.high - free.low) / 10))
    shown = [
        f"{end * scale:.{places}f}" if isfinite(end) else f"({limit * scale:.{places}f})"
        for end, limit in zip(ends, (free.low, free.high), strict=True)
    ]
    return f"{shown[0]} .. {shown[1]} {unit}".strip()


def _digits(free: Free, value: float, error: float) -> tuple[float, int, str]:
    """Units in one SI unit, decimal places that an error of two digits has in them, and their name."""
    scale, unit = 1.0, free.unit
    if unit and value:
        amount, unit = quantity(float(f"{value:.3g}"), free.unit).split(" ", 1)
        scale = float(amount) / float(f"{value:.3g}")
    return scale, int(np.clip(1 - np.floor(np.log10(error * scale)), 0, 12)) if error > 0 else 6, unit


def _rounded(free: Free, value: float) -> str:
    return quantity(float(f"{value:.3g}"), free.unit) if free.unit else f"{value:.3g}"
