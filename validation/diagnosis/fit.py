"""How near a variant comes to a run, and the parameter at which a family of them comes nearest."""

from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares

from drivers.chain.chain import Array
from validation.diagnosis.faulty_model import Model, moved, readings
from validation.diagnosis.variants import Family

FAR = 1e3  # what a motion that blows up counts, of the largest force
LITTLE = 1e-3  # deviations below, of the largest force, are those of parameters near the scene's
STEP = 1e-4  # of a parameter's size, for slopes
MOST = 40  # evaluations of a fit
STARTS = 2  # minima of a scan that are followed


@dataclass(frozen=True)
class Target:
    """A run that is to be explained.

    Attributes:
        force_N: shape (samples, bodies).
        largest_N: what deviations are counted by.
    """

    force_N: Array
    largest_N: float

    def until(self, samples: int) -> "Target":
        """Its first samples."""
        return Target(self.force_N[:samples], self.largest_N)

    def off(self, model: Model) -> Array:
        """By how much a model misses it, of the largest force, read as it comes nearer. Shape (samples, bodies)."""
        try:
            with np.errstate(all="ignore"):
                force = moved(model, len(self.force_N)).force_N
        except (ArithmeticError, ValueError):
            return np.full(self.force_N.shape, FAR)
        return min((self._off(read) for read in readings(model, force)), key=root_mean)

    def _off(self, force_N: Array) -> Array:
        with np.errstate(all="ignore"):
            missed = (force_N - self.force_N) / self.largest_N
        return np.asarray(np.clip(np.nan_to_num(missed, nan=FAR), -FAR, FAR))


def worst(off: Array) -> float:
    """The largest deviation."""
    return float(np.abs(off).max())


def root_mean(off: Array) -> float:
    """The root of the mean square deviation."""
    return float(np.sqrt(np.mean(off**2)))


def start_values(family: Family, target: Target, deviation: float) -> list[float]:
    """Where to begin: the scene's own value, or where that is far off the lowest minima of a scan."""
    if deviation < LITTLE:
        return [family.neutral]
    values = np.unique(np.append(family.start, family.neutral))
    misses = np.array([root_mean(target.off(family.at(float(t)))) for t in values])
    padded = np.concatenate([[np.inf], misses, [np.inf]])
    minima = np.flatnonzero((misses <= padded[:-2]) & (misses <= padded[2:]))
    return [float(values[i]) for i in minima[np.argsort(misses[minima])][:STARTS]]


def refined(family: Family, target: Target, start: float, precision: float = 1e-15) -> tuple[float, float]:
    """The value nearest to a start at which a family comes nearest, and the root mean square it leaves."""
    size = abs(start) if family.additive and start else family.size

    def off(x: Array) -> Array:
        return target.off(family.at(start + size * (float(x[0]) - 1))).ravel()

    found = least_squares(
        off, [1.0], method="lm", diff_step=[STEP], xtol=precision, ftol=precision, gtol=precision, max_nfev=MOST
    )
    return start + size * (float(found.x[0]) - 1), root_mean(np.asarray(found.fun))
