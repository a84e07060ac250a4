"""Motions by which the errors of a run are measured: its scheme (``drivers.run.scheme``) and the exact motion.

The exact motion of a straight chain is integrated adaptively; it counts as known until its own measured error exceeds
``HORIZON``. In three dimensions it is extrapolated from half and a quarter of the step, until rounding alone separates
two runs.
"""

from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from itertools import pairwise
from math import log2
from typing import Any

import numpy as np

from drivers.chain.case import Case
from drivers.chain.chain import Array
from drivers.chain.residual import residual, share_of_change
from drivers.chain.schemes import verlet_of
from drivers.chain.trace import Trace, until
from drivers.engines import EXACT, VERLET, load_engine
from drivers.run.scheme import FIELDS, Scheme, scale_of_motion, scheme_of
from validation.accuracy.exact_motion import ExactMotion, exact_motion_of, quantities
from validation.reference.adaptive import MIN_TOLERANCE

HORIZON = 1e-6  # of the largest change: error beyond which the exact motion counts as not known
MAX_BODIES = 20_000
MAX_WORK = 20_000_000  # bodies times steps of the finest three-dimensional run, about ten seconds
MIN_ORDER, MAX_ORDER = 0.5, 2.5  # of convergence, for an extrapolation


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

    @property
    def straight(self) -> bool:
        """True if the chain is straight."""
        return self.scheme.straight

    @cached_property
    def why_unknown(self) -> str:
        """Reason why the exact motion is not known; empty if it is."""
        if not self.straight:
            costly = 4 * self.case.chain.bodies * self.case.scene.steps > MAX_WORK
            most = f"more than {MAX_WORK:g} bodies times steps"
            return f"not measured: a run at a quarter of the step takes {most}" if costly else ""
        if self.case.chain.bodies > MAX_BODIES:
            return f"not measured: the exact motion is too expensive for more than {MAX_BODIES} bodies"
        try:
            _ = self.exact_to_end
        except ArithmeticError as error:
            return f"not measured: {error}"
        return ""

    @cached_property
    def half(self) -> Trace:
        """Velocity Verlet at half the step."""
        return verlet_of(self.case, self.scheme.law, 2)

    @cached_property
    def quarter(self) -> Trace:
        """Velocity Verlet at a quarter of the step."""
        return verlet_of(self.case, self.scheme.law, 4)

    @cached_property
    def exact_to_end(self) -> ExactMotion:
        """Exact motion of a straight chain to the end of the run, at the tightest tolerance.

        Raises:
            ArithmeticError: the integrator fails.
        """
        return exact_motion_of(self.case, limit_s=self.limit_s)

    @cached_property
    def exact_error(self) -> Array:
        """Error of the exact motion, largest until each sample, divided by the largest change. Shape (samples,)."""
        return share_of_change(self.exact_to_end.error_N, self.exact_to_end.trace)

    @cached_property
    def exact(self) -> Trace:
        """Exact motion at the samples at which it is known; in three dimensions some columns are extrapolated."""
        if self.straight:
            return until(self.exact_to_end.trace, self.known)
        half, quarter = (until(trace, self.known) for trace in (self.half, self.quarter))
        columns = ("force_N", "kinetic_energy_J", *FIELDS.values())
        values: dict[str, Any] = {
            name: np.asarray(self.at_zero(getattr(half, name), getattr(quarter, name))) for name in columns
        }
        return replace(until(self.scheme.plain, self.known), **values)

    @cached_property
    def values(self) -> list[dict[str, float]]:
        """Observables of the exact motion from the samples of the case, and their true values from finer samples.

        In three dimensions both are extrapolated.
        """
        if self.straight:
            known = self.exact_to_end.first(self.known)
            return [known.sampled, known.true]
        half, quarter = (quantities(self.case, until(trace, self.known)) for trace in (self.half, self.quarter))
        return [{name: self.at_zero(half[name], quarter[name]) for name in half if name in quarter}] * 2

    @cached_property
    def full(self) -> "Motions | None":
        """Motions of the case with the elements that its accuracy left out; None if there are none."""
        return Motions(Scheme(self.case.full, self.scheme.law), self.limit_s) if self.case.full else None

    @property
    def order(self) -> float:
        """Order of convergence of the scheme in three dimensions, measured at the whole, half and quarter step."""
        steps = [until(trace, self.known).force_N for trace in (self.scheme.plain, self.half, self.quarter)]
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
        error = self.exact_error if self.straight else self.scheme.rounding
        return max(1, int(np.searchsorted(error, HORIZON, side="right")))

    def scale(self, quantity: str) -> float:
        """Scale of errors, as ``Scheme.scale``, by the exact motion where that is known."""
        if self.why_unknown:
            return self.scheme.scale(quantity)
        return scale_of_motion(self.case, self.exact_to_end.trace if self.straight else self.exact, quantity)


def predicted_error(case: Case, engine: str) -> Array:
    """Largest force error of the engine's scheme at each sample, divided by the largest change. Shape (samples,).

    NaN if the exact motion is not known.
    """
    motions = motions_of(case, engine)
    if motions.why_unknown:
        return np.full(case.scene.samples, np.nan)
    with np.errstate(over="ignore", invalid="ignore"):  # too large a step blows up
        error = residual(until(motions.scheme_of(engine), motions.known), motions.exact)
    return np.nan_to_num(error, nan=np.inf)


def motions_of(case: Case, engine: str = VERLET, limit_s: float | None = None) -> Motions:
    """Motions of a case for an engine; the last ones are cached."""
    return cached_motions(scheme_of(case, engine), limit_s)


cached_motions = lru_cache(maxsize=2)(Motions)
