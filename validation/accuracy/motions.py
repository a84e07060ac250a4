"""Motions by which the errors of a run are measured: its scheme (``drivers.run.scheme``) and the exact motion.

The exact motion of a straight chain is integrated adaptively; it counts as known until its own measured error exceeds
``HORIZON``. In three dimensions it is extrapolated from half and a quarter of the step, until rounding alone separates
two runs.

Quantities are named like observables, without the unit: ``wall_peak``, ``bead_9_arrival``, ``speed_9_to_5``. Errors:

* ``force``: largest difference over all contacts and sample times, divided by the largest change of force;
* ``energy``: largest difference of the change of the total energy, divided by the largest kinetic energy;
* ``momentum``: largest difference divided by the largest momentum;
* peaks, later ones too: relative to the true value minus the static load;
* all others: relative to the true value.
"""

from collections.abc import Collection
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from itertools import pairwise
from math import log2, nan
from typing import Any

import numpy as np

from drivers.chain.case import Case
from drivers.chain.chain import Array
from drivers.chain.schemes import exact_of, verlet_of
from drivers.chain.trace import FORCE, Trace, largest_change_N, part_of, until
from drivers.engines import EXACT, VERLET, load_engine
from drivers.run.scheme import COMPARED, FIELDS, Scheme, largest_difference, scale_of_motion, scheme_of
from postproc.read.observables import describe, observe, scale_of, without_unit
from validation.reference.adaptive import MIN_TOLERANCE, ROUNDED_TOLERANCE

HORIZON = 1e-6  # of the largest change: error beyond which the exact motion counts as not known
MAX_BODIES = 20_000
MAX_WORK = 20_000_000  # bodies times steps of the finest three-dimensional run, some seconds
MIN_ORDER, MAX_ORDER = 0.5, 2.5  # of convergence, for an extrapolation
SAMPLE_FACTOR = 4  # factor of samples for true values: of smooth forces quintic interpolation leaves 4^-6 of the error
TRUE_SHARE = 0.05  # of the sampling error, for the error of the true value itself
LEAST_SAMPLING = 1e-9  # relative sampling error that is taken as it is
NEAR_FACTOR = 3.0  # tolerance of a second motion, divided by that of the first, whose error it measures
LEAST_ERROR = 1e-13  # of the largest change: smaller errors of the exact motion are not stated
MAX_FINE_VALUES = 4_000_000  # values of the finer record; beyond, the sampling error is not measured


@dataclass(frozen=True)
class ExactMotion:
    """Exact motion of a case.

    Attributes:
        fine: with ``factor`` times as many samples as the case.
        factor: ``SAMPLE_FACTOR``, or 1 if that is too many; then the error of sampling is not known.
        tolerance: tolerance of the integration.
        limit_s: time limit of each integration; None for that of ``drivers.chain.schemes``.
    """

    case: Case
    fine: Trace
    factor: int
    tolerance: float
    limit_s: float | None = None

    @cached_property
    def trace(self) -> Trace:
        """The motion at the sample times of the case."""
        sampled = part_of(self.fine, slice(None, None, self.factor))
        return replace(sampled, time_s=self.case.sample_times_s[: len(sampled.time_s)])

    @cached_property
    def true(self) -> dict[str, float]:
        """Values of the observed quantities, from a record so fine that their own sampling error is negligible.

        Forces that are not smooth at a maximum or a crossing (dissipation, opening and closing contacts) converge
        slowly, so samples are added until half of them change no value by more than ``TRUE_SHARE`` of its sampling
        error, as far as ``MAX_FINE_VALUES`` allows.
        """
        samples, fine, factor = len(self.trace.time_s), self.fine, self.factor
        values = quantities(self.case, fine)
        while self.factor > 1 and not self._converged(fine, values):
            factor *= SAMPLE_FACTOR
            if factor * samples * self.case.chain.bodies > MAX_FINE_VALUES:
                break
            fine = until(exact_of(self.case, self.tolerance, factor, self.limit_s), factor * (samples - 1) + 1)
            values = quantities(self.case, fine)
        return values

    def _converged(self, fine: Trace, values: dict[str, float]) -> bool:
        """True if every second sample of a finer record gives its values to ``TRUE_SHARE`` of their sampling error."""
        half = quantities(self.case, part_of(fine, slice(None, None, 2)))
        return all(
            abs(half[name] - values[name])
            <= max(TRUE_SHARE * abs(self.sampled[name] - values[name]), LEAST_SAMPLING * scale_of(name, values))
            for name in values.keys() & half.keys() & self.sampled.keys()
        )

    @cached_property
    def sampled(self) -> dict[str, float]:
        """Values of the observed quantities, from the samples of the case."""
        return quantities(self.case, self.trace)

    @cached_property
    def error(self) -> Array:
        """Measured force error of the exact motion, largest until each sample, divided by the largest change.

        Shape (samples,).

        The difference from the motion at the tightest tolerance. Of such motions themselves, where rounding
        errors do not shrink with the tolerance: the difference from one with ``NEAR_FACTOR`` times the tolerance. On
        107 random scenes that is at least 0.4 times the true error, and at least the true error where that exceeds
        1e-13 of the largest change: no smaller error is stated.

        Raises:
            ArithmeticError: the integrator fails.
        """
        exact, change_N = self.trace, largest_change_N(self.trace.force_N)
        other_tolerance = NEAR_FACTOR * self.tolerance if self.tolerance < ROUNDED_TOLERANCE else MIN_TOLERANCE
        other = exact_of(self.case, other_tolerance, limit_s=self.limit_s)
        error_N = np.maximum(np.abs(other.force_N - exact.force_N).max(axis=1), LEAST_ERROR * change_N)
        return np.asarray(np.maximum.accumulate(error_N) / change_N)

    def first(self, samples: int) -> "ExactMotion":
        """The first samples of the motion."""
        return replace(self, fine=until(self.fine, self.factor * (samples - 1) + 1))


def exact_motion_of(
    case: Case, tolerance: float = MIN_TOLERANCE, *, finer: bool = True, limit_s: float | None = None
) -> ExactMotion:
    """Exact motion of a case, with a force error of at most ``tolerance`` times the largest change.

    Raises:
        ArithmeticError: the integrator fails, or takes longer than the limit.
    """
    factor = SAMPLE_FACTOR if finer and SAMPLE_FACTOR * case.scene.samples * case.chain.bodies <= MAX_FINE_VALUES else 1
    return ExactMotion(case, exact_of(case, tolerance, factor, limit_s), factor, tolerance, limit_s)


def quantities(case: Case, trace: Trace) -> dict[str, float]:
    """Observables of the pulses in a trace, by name without the unit."""
    values = observe(case.layout, trace).items()
    return {without_unit(name): value for name, value in values if describe(name).of_wave and np.isfinite(value)}


def errors_of(case: Case, trace: Trace, truth: ExactMotion, names: Collection[str]) -> dict[str, float]:
    """Errors of the named quantities; inf for a quantity missing in the trace.

    Raises:
        KeyError: a quantity is missing in the exact motion.
    """
    seen = {} if {*names} <= {*COMPARED} else quantities(case, trace)
    errors = {
        name: largest_difference(name, trace, truth.trace, scale_of_motion(case, truth.trace, name))[0]
        if name in COMPARED
        else abs(seen.get(name, np.inf) - truth.true[name]) / scale_of(name, truth.true)
        for name in names
    }
    return {name: error if np.isfinite(error) else np.inf for name, error in errors.items()}


@dataclass(frozen=True, eq=False)
class Motions:
    """Motions of a case, each computed once, on first use.

    Attributes:
        scheme: motions of the schemes.
        limit_s: time limit of the exact motion; None for ``drivers.chain.schemes.default_limit_s``.
    """

    scheme: Scheme
    limit_s: float | None = None

    @property
    def case(self) -> Case:
        """Case of the motions."""
        return self.scheme.case

    @cached_property
    def why_unknown(self) -> str:
        """Reason why the exact motion is not known; empty if it is."""
        if not self.case.chain.straight:
            too_long = f"not measured: a run at a quarter of the step takes more than {MAX_WORK:g} bodies times steps"
            return too_long if 4 * self.case.work > MAX_WORK else ""
        if self.case.chain.bodies > MAX_BODIES:
            return f"not measured: the exact motion is too expensive for more than {MAX_BODIES} bodies"
        try:
            _ = self.exact_to_end
        except ArithmeticError as error:
            return f"not measured: {error}"
        return ""

    @cached_property
    def finer(self) -> tuple[Trace, Trace]:
        """Velocity Verlet at half and at a quarter of the step."""
        return verlet_of(self.case, self.scheme.law, 2), verlet_of(self.case, self.scheme.law, 4)

    @cached_property
    def exact_to_end(self) -> ExactMotion:
        """Exact motion of a straight chain to the end of the run, at the tightest tolerance.

        Raises:
            ArithmeticError: the integrator fails.
        """
        return exact_motion_of(self.case, limit_s=self.limit_s)

    @cached_property
    def exact(self) -> Trace:
        """Exact motion at the samples at which it is known; in three dimensions some columns are extrapolated."""
        if self.case.chain.straight:
            return until(self.exact_to_end.trace, self.known)
        half, quarter = (vars(until(trace, self.known)) for trace in self.finer)
        columns = ("force_N", "kinetic_energy_J", *FIELDS.values())
        values: dict[str, Any] = {name: self.at_zero(half[name], quarter[name]) for name in columns}
        return replace(until(self.scheme.plain, self.known), **values)

    @cached_property
    def values(self) -> list[dict[str, float]]:
        """Observables of the exact motion from the samples of the case, and their true values from finer samples.

        In three dimensions both are extrapolated.
        """
        if self.case.chain.straight:
            known = self.exact_to_end.first(self.known)
            return [known.sampled, known.true]
        half, quarter = (quantities(self.case, until(trace, self.known)) for trace in self.finer)
        return [{name: self.at_zero(half[name], quarter[name]) for name in half if name in quarter}] * 2

    @cached_property
    def full(self) -> "Motions | None":
        """Motions of the case with the elements that its accuracy left out; None if there are none."""
        return Motions(Scheme(self.case.full, self.scheme.law), self.limit_s) if self.case.full else None

    @property
    def order(self) -> float:
        """Order of convergence of the scheme in three dimensions, measured at the whole, half and quarter step."""
        steps = [until(trace, self.known).force_N for trace in (self.scheme.plain, *self.finer)]
        apart = [float(np.abs(coarse - fine).max()) for coarse, fine in pairwise(steps)]
        if not (all(apart) and np.isfinite(apart).all()):
            return 2.0
        return min(max(log2(apart[0] / apart[1]), MIN_ORDER), MAX_ORDER)

    def at_zero(self, half: Any, quarter: Any) -> Any:
        """A value at a step of zero by Richardson's extrapolation, ``Q_4 + (Q_4 - Q_2) / (2^p - 1)``."""
        return quarter + (quarter - half) / (2**self.order - 1)

    def scheme_of(self, engine: str) -> Trace:
        """Motion of a faultless run of an engine, except the order of additions."""
        exact = load_engine(engine).scheme == EXACT
        return self.exact if exact and self.case.reference_tolerance == MIN_TOLERANCE else self.scheme.of(engine)

    @cached_property
    def known(self) -> int:
        """Number of samples at which the exact motion is known: by its error, in three dimensions by rounding."""
        error = self.exact_to_end.error if self.case.chain.straight else self.scheme.rounding[FORCE]
        return max(1, int(np.searchsorted(error, HORIZON, side="right")))

    def scale(self, quantity: str) -> float:
        """Scale of errors, as in ``Scheme.scales``, by the exact motion."""
        return scale_of_motion(self.case, self.exact_to_end.trace if self.case.chain.straight else self.exact, quantity)


def predicted_error(case: Case, engine: str) -> float:
    """Largest force error of the engine's scheme, divided by the largest change; NaN without the exact motion."""
    motions = motions_of(case, engine)
    if motions.why_unknown:
        return nan
    return largest_difference(FORCE, motions.scheme_of(engine), motions.exact, motions.scale(FORCE))[0]


def motions_of(case: Case, engine: str = VERLET, limit_s: float | None = None) -> Motions:
    """Motions of a case for an engine; the last ones are cached."""
    return cached_motions(scheme_of(case, engine), limit_s)


cached_motions = lru_cache(maxsize=2)(Motions)
