"""Exact motion of a straight chain, with its own error; errors of a run against it.

Quantities are named like observables, without the unit: ``wall_peak``, ``bead_9_arrival``, ``speed_9_to_5``. Errors:

* ``force``: largest difference over all contacts and sample times, divided by the largest change of force;
* ``energy``: largest difference of the change of the total energy, divided by the largest kinetic energy;
* ``momentum``: largest difference divided by the largest momentum;
* peaks, later ones too: relative to the true value minus the static load;
* all others: relative to the true value.
"""

from collections.abc import Collection
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from drivers.chain.case import Case
from drivers.chain.chain import Array
from drivers.chain.residual import largest_change_N, share_of_change
from drivers.chain.schemes import exact_of
from drivers.chain.trace import Trace, part_of, until
from drivers.run.scheme import COMPARED, largest_difference, scale_of_motion
from postproc.read.observables import describe, observe, scale_of, without_unit
from validation.reference.adaptive import MIN_TOLERANCE

SAMPLE_FACTOR = 4  # factor of samples for true values: of smooth forces quintic interpolation leaves 4^-6 of the error
TRUE_SHARE = 0.05  # of the sampling error, for the error of the true value itself
LEAST_SAMPLING = 1e-9  # relative sampling error that is taken as it is
# tolerance of the second motions, divided by the tolerance of the first, whose error they measure
ROUGH_FACTOR, NEAR_FACTOR = 100.0, 3.0
LEAST_ERROR = 1e-13  # of the largest change: smaller errors of the exact motion are not stated
ROUNDED_TOLERANCE = 10 * MIN_TOLERANCE  # below, rounding errors are of the size of the tolerance
LINEAR_SHARE = 1e-3  # of the largest change: larger differences do not shrink with the tolerance
COARSE_ERROR = 0.1  # larger tolerances are meaningless
MAX_FINE_VALUES = 4_000_000  # values of the finer record; beyond, the sampling error is not measured


@dataclass(frozen=True)
class ExactMotion:
    """Exact motion of a case.

    Attributes:
        trace: at the sample times of the case.
        fine: with ``SAMPLE_FACTOR`` times as many samples; the same object as ``trace`` if that is too many.
        tolerance: tolerance of the integration.
        limit_s: time limit of each integration; None for that of ``drivers.chain.schemes``.
    """

    case: Case
    trace: Trace
    fine: Trace
    tolerance: float
    limit_s: float | None = None

    @cached_property
    def true(self) -> dict[str, float]:
        """Values of the observed quantities, from a record so fine that their own sampling error is negligible.

        Forces that are not smooth at a maximum or a crossing (dissipation, opening and closing contacts) converge
        slowly, so samples are added until half of them change no value by more than ``TRUE_SHARE`` of its sampling
        error, as far as ``MAX_FINE_VALUES`` allows.
        """
        samples, fine = len(self.trace.time_s), self.fine
        factor = (len(fine.time_s) - 1) // max(samples - 1, 1)
        values = quantities(self.case, fine)
        while self.sampling_known and not self._converged(fine, values):
            factor *= SAMPLE_FACTOR
            if factor * samples * self.case.chain.bodies > MAX_FINE_VALUES:
                break
            fine = until(exact_of(self.case, self.tolerance, factor, self.limit_s), factor * (samples - 1) + 1)
            values = quantities(self.case, fine)
        return values

    def _converged(self, fine: Trace, values: dict[str, float]) -> bool:
        """True if every second sample of a finer record gives its values to ``TRUE_SHARE`` of their sampling error."""
        half = quantities(self.case, part_of(fine, slice(None, None, 2)))
        for name in values.keys() & half.keys() & self.sampled.keys():
            least = max(TRUE_SHARE * abs(self.sampled[name] - values[name]), LEAST_SAMPLING * scale_of(name, values))
            if abs(half[name] - values[name]) > least:
                return False
        return True

    @cached_property
    def sampled(self) -> dict[str, float]:
        """Values of the observed quantities, from the samples of the case."""
        return quantities(self.case, self.trace)

    @property
    def sampling_known(self) -> bool:
        """True if ``fine`` has more samples than ``trace``."""
        return self.fine is not self.trace

    @cached_property
    def error_N(self) -> Array:
        """Measured force error of the exact motion, largest until each sample, in N. Shape (samples,).

        While differences are small enough to grow linearly: the difference from a motion with ``ROUGH_FACTOR`` times
        the tolerance, divided by that factor. In a chaotic motion, and at the tightest tolerances, where rounding
        errors do not shrink with the tolerance: at least the difference from a motion with ``NEAR_FACTOR`` times the
        tolerance. On 27 random scenes with light beads and flat strikers and on a chaotic one of 121 bodies the
        estimate is 1/12 to 30 times the true error, mostly 1/2 to 3 times. At the tightest tolerance on 107 random
        scenes it is at least 0.4 times the true error, and at least the true error where that exceeds 1e-13 of the
        largest change: no smaller error is stated.

        Raises:
            ArithmeticError: the integrator fails.
        """
        exact = self.trace

        def apart(factor: float) -> Array:
            other = exact_of(self.case, min(factor * self.tolerance, COARSE_ERROR), limit_s=self.limit_s)
            return np.asarray(np.maximum.accumulate(np.abs(other.force_N - exact.force_N).max(axis=1)))

        rough = apart(ROUGH_FACTOR)
        linear = share_of_change(rough, exact) < LINEAR_SHARE
        error = np.maximum(np.where(linear, rough / ROUGH_FACTOR, 0.0), LEAST_ERROR * largest_change_N(exact.force_N))
        if self.tolerance < ROUNDED_TOLERANCE or not linear.all():
            error = np.maximum(error, apart(NEAR_FACTOR))
        return np.asarray(np.maximum.accumulate(error))

    def first(self, samples: int) -> "ExactMotion":
        """The first samples of the motion."""
        factor = (len(self.fine.time_s) - 1) // max(len(self.trace.time_s) - 1, 1)
        trace = until(self.trace, samples)
        return replace(self, trace=trace, fine=until(self.fine, factor * (samples - 1) + 1) if factor > 1 else trace)


def exact_motion_of(
    case: Case, tolerance: float = MIN_TOLERANCE, *, finer: bool = True, limit_s: float | None = None
) -> ExactMotion:
    """Exact motion of a case, with a force error of at most ``tolerance`` times the largest change.

    Raises:
        ArithmeticError: the integrator fails, or takes longer than the limit.
    """
    factor = SAMPLE_FACTOR if finer and SAMPLE_FACTOR * case.scene.samples * case.chain.bodies <= MAX_FINE_VALUES else 1
    fine = exact_of(case, tolerance, factor, limit_s)
    if factor == 1:
        return ExactMotion(case, fine, fine, tolerance, limit_s)
    samples = replace(part_of(fine, slice(None, None, factor)), time_s=case.sample_times_s)
    return ExactMotion(case, samples, fine, tolerance, limit_s)


def quantities(case: Case, trace: Trace) -> dict[str, float]:
    """Observables of the pulses in a trace, by name without the unit."""
    values = observe(case.layout, trace).items()
    return {without_unit(name): value for name, value in values if describe(name).of_wave and np.isfinite(value)}


def errors_of(case: Case, trace: Trace, truth: ExactMotion, names: Collection[str]) -> dict[str, float]:
    """Errors of the named quantities; inf for a quantity missing in the trace.

    Raises:
        KeyError: a quantity is missing in the exact motion.
    """
    errors = {}
    seen = {} if {*names} <= {*COMPARED} else quantities(case, trace)
    for name in names:
        if name in COMPARED:
            errors[name], *_ = largest_difference(name, trace, truth.trace, scale_of_motion(case, truth.trace, name))
        else:
            errors[name] = abs(seen.get(name, np.inf) - truth.true[name]) / scale_of(name, truth.true)
    return {name: error if np.isfinite(error) else np.inf for name, error in errors.items()}
