"""Motions by which the runs of a case are judged: the scheme of each engine, the exact motion, and rounding alone.

* ``plain``: velocity Verlet at the case's step, in overlaps; in three dimensions with the engine's law of friction;
* ``rounded``: the same with other rounding errors: in absolute heights, or in three dimensions turned and lifted;
* ``exact``: the exact motion. Straight chains: adaptive integration, until its own measured error exceeds ``HORIZON``.
  Three dimensions: extrapolated from half and a quarter of the step, until rounding alone separates two runs.

Differences that rounding explains are bounded here at each sample, by ``ROUNDING_MARGIN`` times the largest difference
of ``rounded`` and ``plain`` until then. Runs are compared until the horizon, where this bound exceeds ``AGREEMENT``.
"""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from itertools import pairwise
from math import log2
from threading import Lock
from typing import Any

import numpy as np

from drivers.base.tolerances import Tolerance, tolerance
from drivers.chain.case import Case
from drivers.chain.chain import Array, moving_at_start
from drivers.chain.schemes import exact_of, turned_verlet_of, verlet_in_heights, verlet_of
from drivers.chain.trace import Trace, until
from drivers.engines import EXACT, IN_HEIGHTS, VERLET, load_engine
from drivers.limits.refusal import FORCE
from postproc.read.residual import is_at_rest, largest_change_N, largest_kinetic_J, residual, share_of_change
from validation.accuracy.exact_motion import ExactMotion, exact_motion_of, quantities
from validation.reference.adaptive import MIN_TOLERANCE

ROUNDING_MARGIN = 10.0  # engines add in another order than the in-repo scheme: rounding errors of the same size
ROUNDING_REASON = (
    f"{ROUNDING_MARGIN:g} times the effect of rounding absolute coordinates, measured in-repo on this scene"
)
HORIZON = 1e-6  # of the largest change: error beyond which the exact motion counts as not known
AGREEMENT = 1e-2  # of the largest change: runs that differ by more do not agree at all
MAX_BODIES = 20_000
MAX_WORK = 20_000_000  # bodies times steps of the finest three-dimensional run, about ten seconds
MIN_ORDER, MAX_ORDER = 0.5, 2.5  # of convergence, for an extrapolation
NAMES = {"name", "file", "title"}  # keys of a scene on which no motion depends
FIELDS = {"energy": "total_energy_J", "momentum": "momentum_N_s"}  # judged columns of a trace besides the forces


@dataclass(frozen=True)
class Motions:
    """Motions of a case, each computed once, on first use.

    Attributes:
        law: law of friction in three dimensions.
    """

    case: Case
    law: str

    @property
    def straight(self) -> bool:
        """True if the chain is straight."""
        return self.case.chain.lateral is None

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
    def plain(self) -> Trace:
        """Velocity Verlet at the case's step."""
        return verlet_of(self.case, self.law)

    @cached_property
    def half(self) -> Trace:
        """Velocity Verlet at half the step."""
        return verlet_of(self.case, self.law, 2)

    @cached_property
    def quarter(self) -> Trace:
        """Velocity Verlet at a quarter of the step."""
        return verlet_of(self.case, self.law, 4)

    @cached_property
    def rounded(self) -> Trace:
        """``plain`` with other rounding errors."""
        return verlet_in_heights(self.case) if self.straight else turned_verlet_of(self.case, self.law)

    @cached_property
    def exact_to_end(self) -> ExactMotion:
        """Exact motion of a straight chain to the end of the run, at the tightest tolerance.

        Raises:
            ArithmeticError: the integrator fails.
        """
        return exact_motion_of(self.case)

    @cached_property
    def exact_error(self) -> Array:
        """Error of the exact motion, largest until each sample, divided by the largest change. Shape (samples,)."""
        return share_of_change(self.exact_to_end.error_N, self.exact_to_end.trace)

    @cached_property
    def exact(self) -> Trace:
        """Exact motion at the samples at which it is known; in three dimensions ``plain`` with extrapolated columns."""
        if self.straight:
            return until(self.exact_to_end.trace, self.known)
        half, quarter = (until(trace, self.known) for trace in (self.half, self.quarter))
        columns = ("force_N", "kinetic_energy_J", *FIELDS.values())
        values: dict[str, Any] = {
            name: np.asarray(self.at_zero(getattr(half, name), getattr(quarter, name))) for name in columns
        }
        return replace(until(self.plain, self.known), **values)

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
        return Motions(self.case.full, self.law) if self.case.full else None

    @property
    def order(self) -> float:
        """Order of convergence of the scheme; in three dimensions measured at the whole, half and quarter step."""
        if self.straight:
            return 1.0 if self.case.chain.damped else 2.0
        steps = [until(trace, self.known).force_N for trace in (self.plain, self.half, self.quarter)]
        apart = [float(np.abs(coarse - fine).max()) for coarse, fine in pairwise(steps)]
        if not (all(apart) and np.isfinite(apart).all()):
            return 2.0
        return min(max(log2(apart[0] / apart[1]), MIN_ORDER), MAX_ORDER)

    def at_zero(self, half: Any, quarter: Any) -> Any:
        """A value at a step of zero by Richardson's extrapolation, ``Q_4 + (Q_4 - Q_2) / (2^p - 1)``."""
        return quarter + (quarter - half) / (2**self.order - 1)

    @cached_property
    def reference(self) -> Trace:
        """The exact motion to the tolerance of the case's reference run, at the samples of ``exact``."""
        if self.case.reference_tolerance == MIN_TOLERANCE:
            return self.exact
        return until(exact_of(self.case, self.case.reference_tolerance), self.known)

    def scheme_of(self, engine: str) -> Trace:
        """Motion of a faultless run of an engine, except the order of additions."""
        scheme = load_engine(engine).scheme
        if scheme == EXACT:
            return self.reference
        return self.rounded if self.straight and scheme == IN_HEIGHTS else self.plain

    @cached_property
    def rounding_N(self) -> Array:
        """Largest force difference at each sample due to rounding, in N. Shape (samples,)."""
        side_by_side = ["plain", "rounded", *(["half"] if self.straight and self.why_unknown else [])]
        with ThreadPoolExecutor() as threads:
            all(threads.map(lambda name: getattr(self, name), side_by_side))
        return np.asarray(np.abs(self.rounded.force_N - self.plain.force_N).max(axis=1))

    @cached_property
    def rounding(self) -> Array:
        """Largest effect of rounding until each sample, divided by the largest change. Shape (samples,)."""
        share = np.nan_to_num(share_of_change(self.rounding_N, self.plain), nan=np.inf)
        return np.asarray(np.maximum.accumulate(share))

    @property
    def rounding_bound(self) -> Array:
        """Bound on the effect of rounding in any order of addition, until each sample. Shape (samples,)."""
        return ROUNDING_MARGIN * self.rounding

    @cached_property
    def known(self) -> int:
        """Number of samples at which the exact motion is known: by its error, in three dimensions by rounding."""
        error = self.exact_error if self.straight else self.rounding
        return max(1, int(np.searchsorted(error, HORIZON, side="right")))

    @cached_property
    def samples(self) -> int:
        """Horizon: number of samples before rounding alone separates two runs."""
        return max(1, int(np.searchsorted(self.rounding_bound, AGREEMENT, side="right")))

    def explained(self, quantity: str) -> Array:
        """Limits of the difference of a run from its scheme at each sample until the horizon. Shape (samples,).

        Args:
            quantity: ``force``, ``energy`` or ``momentum``, divided by their scales.
        """
        bound, least = self.rounding_bound[: self.samples], self._least(quantity).limit
        if quantity != FORCE:
            one, other = (getattr(trace, FIELDS[quantity])[: self.samples] for trace in (self.rounded, self.plain))
            largest = np.maximum.accumulate(np.abs(one - other)) / self.scale(quantity)
            bound = np.maximum(ROUNDING_MARGIN * largest, self.explained(FORCE))
        return np.asarray(np.maximum(bound, least))

    def tolerance_at(self, quantity: str, sample: int) -> Tolerance:
        """Limit of ``explained`` at a sample, with its reason."""
        limit, least = float(self.explained(quantity)[sample]), self._least(quantity)
        return least if limit <= least.limit else Tolerance(limit, ROUNDING_REASON)

    def _least(self, quantity: str) -> Tolerance:
        return tolerance("model", force_tolerance(self.case) if quantity == FORCE else "motion")

    def scale(self, quantity: str) -> float:
        """Scale of errors: largest change of force in N, largest kinetic energy in J, largest momentum in N s.

        The momentum is at least the sum of m |v| at time 0, since bodies may meet head on; at rest, at least the
        impulse of the loads.
        """
        motion = self.plain if self.why_unknown else self.exact_to_end.trace if self.straight else self.exact
        if quantity == FORCE:
            return largest_change_N(motion.force_N)
        if quantity == "energy":
            return largest_kinetic_J(self.case.chain, motion)
        resting = is_at_rest(motion.force_N)
        loads = abs(float(self.case.chain.load_N.sum())) * float(motion.time_s[-1]) if resting else 0.0
        return max(float(np.abs(motion.momentum_N_s).max()), moving_at_start(self.case.chain), loads) or 1.0

    @property
    def until_horizon(self) -> str:
        """End of a sentence: until when differences from a scheme are judged, and why; empty if to the end."""
        return judged_until(self.case, self.samples, f"rounding alone explains differences of {AGREEMENT:g}")


def judged_until(case: Case, samples: int, why: str) -> str:
    """End of a sentence: until when a run is judged, and why; empty if to the end."""
    all_of_it = samples >= case.scene.samples
    return "" if all_of_it else f"; judged until {case.sample_times_s[samples] * 1e6:g} µs, where {why}"


def force_tolerance(case: Case) -> str:
    """Name of the tolerance of the forces of a case: LIGGGHTS has no level flat face in three dimensions."""
    level = case.chain.lateral is not None and bool(np.isinf(case.chain.radius_m[-1]))
    return "level" if level else FORCE


def predicted_error(case: Case, engine: str) -> Array:
    """Largest force error of the engine's scheme at each sample, divided by the largest change. Shape (samples,).

    The error is measured against the exact motion; for chains too long for that, against half the step.
    """
    motions = motions_of(case, engine)
    with np.errstate(over="ignore", invalid="ignore"):  # too large a step blows up
        if not motions.why_unknown:
            error = residual(until(motions.scheme_of(engine), motions.known), motions.exact)
        elif load_engine(engine).scheme == EXACT:
            error = np.zeros(case.scene.samples)
        else:  # second order in the step; first order with damping
            error = residual(motions.plain, motions.half) * (2 if case.chain.damped else 4 / 3)
    return np.nan_to_num(error, nan=np.inf)


_lock = Lock()


def motions_of(case: Case, engine: str = VERLET) -> Motions:
    """Motions of a case for an engine; the motions of the last case are cached."""
    law = load_engine(engine if case.chain.lateral is not None else VERLET).shear
    with _lock:
        return _last(_key(case)).setdefault(law, Motions(case, law))


@lru_cache(maxsize=1)
def _last(key: str) -> dict[str, Motions]:
    """Motions of the last case by law of friction; ``motions_of`` fills it."""
    return {}


@lru_cache(maxsize=4)
def _key(case: Case) -> str:
    """Everything that determines the motions of a case."""
    scenes = [variant.scene.model_dump_json(exclude=NAMES) for variant in (case, case.full) if variant]
    return f"{scenes} {case.reference_tolerance}"
