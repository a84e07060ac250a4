"""Baseline of a case: velocity Verlet at the same step, the exact motion, and the effect of rounding alone.

All decisions on whether a difference is only rounding are made here, for straight and three-dimensional chains:

* ``plain``: velocity Verlet at the case's step, in overlaps; in three dimensions with the engine's law of friction;
* ``rounded``: the same with other rounding errors: in absolute heights, or in three dimensions turned and lifted;
* ``exact``: the exact motion. Straight chains: adaptive integration (``ExactMotion``), until its own measured error
  exceeds ``HORIZON``. Three dimensions: extrapolated from finer steps (``Extrapolation``), until rounding alone
  separates two runs.
"""

from dataclasses import dataclass, replace
from functools import cached_property
from math import log2
from threading import Lock
from typing import Any

import numpy as np

from drivers.base.tolerances import Tolerance, tolerance
from drivers.chain.case import Case
from drivers.chain.chain import Array
from drivers.chain.trace import Trace, until
from drivers.engines import EXACT, IN_HEIGHTS, VERLET, load_engine
from drivers.limits.refusal import FORCE
from postproc.read.residual import largest_change_N, largest_kinetic_J, share_of_change
from validation.accuracy.schemes import ExactMotion, exact_motion_of, turned_verlet_of, verlet_in_heights, verlet_of
from validation.reference.adaptive import MIN_TOLERANCE

ROUNDING_MARGIN = 10.0  # engines add in another order than the in-repo scheme: rounding errors of the same size
ROUNDING_REASON = (
    f"{ROUNDING_MARGIN:g} times the effect of rounding absolute coordinates, measured in-repo on this scene"
)
HORIZON = 1e-6  # of the largest change; pointwise comparison ends where rounding or the exact motion's error exceeds it
MAX_BODIES = 20_000
TOO_LARGE = f"not measured: the exact motion is too expensive for more than {MAX_BODIES} bodies"
MAX_WORK = 20_000_000  # bodies times steps of the finest three-dimensional run, about ten seconds
MIN_ORDER, MAX_ORDER = 0.5, 2.5  # of convergence, for an extrapolation
ARRIVED_SHARE = 1e-3  # force change over the largest change, from which the wave has arrived
CHAOTIC_GROWTH = 100.0  # of rounding errors since the wave reached the wall; up to 56 measured on shipped scenes


@dataclass(frozen=True)
class Extrapolation:
    """A motion at a time step of zero, by Richardson's extrapolation from half and a quarter of the step.

    Attributes:
        trace: extrapolated forces; all other columns are from the run at the whole step.
        half, quarter: runs at half and a quarter of the step.
        order: order of convergence of the three steps.
    """

    trace: Trace
    half: Trace
    quarter: Trace
    order: float

    def at_zero(self, half: Any, quarter: Any) -> Any:
        """A value at a step of zero: ``Q_4 + (Q_4 - Q_2) / (2^p - 1)``."""
        return quarter + (quarter - half) / (2**self.order - 1)


@dataclass(frozen=True)
class Baseline:
    """Motions of a case and the tolerances derived from them, each computed once, on first use.

    Attributes:
        law: law of friction in three dimensions.
    """

    case: Case
    law: str

    @property
    def straight(self) -> bool:
        """True if the chain is straight."""
        return self.case.chain.lateral is None

    @property
    def why_unknown(self) -> str:
        """Reason why the exact motion is not known; empty if it is."""
        lateral = self.case.chain.lateral
        if lateral is None:
            return TOO_LARGE if self.case.chain.bodies > MAX_BODIES else ""
        if 4 * self.case.chain.bodies * self.case.scene.steps > MAX_WORK:
            return f"not measured: a run at a quarter of the step takes more than {MAX_WORK:g} bodies times steps"
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
    def eighth(self) -> Trace:
        """Velocity Verlet at an eighth of the step."""
        return verlet_of(self.case, self.law, 8)

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
        """Measured error of the exact motion: largest until each sample, over the largest change. Shape (samples,)."""
        return share_of_change(self.exact_to_end.error_N, self.exact_to_end.trace)

    @cached_property
    def exact_motion(self) -> ExactMotion | Extrapolation:
        """Exact motion, cut where its own error exceeds ``HORIZON``.

        Raises:
            ArithmeticError: the integrator fails.
        """
        if self.straight:
            return self.exact_to_end.first(max(1, int(np.searchsorted(self.exact_error, HORIZON, side="right"))))
        whole, half, quarter = (until(trace, self.samples) for trace in (self.plain, self.half, self.quarter))
        order, apart = 2.0, [float(np.abs(a.force_N - b.force_N).max()) for a, b in ((whole, half), (half, quarter))]
        if all(apart) and np.isfinite(apart).all():
            order = min(max(log2(apart[0] / apart[1]), MIN_ORDER), MAX_ORDER)
        found = Extrapolation(whole, half, quarter, order)
        forces = np.asarray(found.at_zero(half.force_N, quarter.force_N))
        return replace(found, trace=replace(whole, force_N=forces))

    @property
    def exact(self) -> Trace:
        """Trace of the exact motion, at the samples at which it is known."""
        return self.exact_motion.trace

    @cached_property
    def reference(self) -> Trace:
        """The exact motion to the tolerance of the case's reference run, at the samples of ``exact``."""
        if self.case.reference_tolerance == MIN_TOLERANCE:
            return self.exact
        motion = exact_motion_of(self.case, self.case.reference_tolerance, finer=False)
        return until(motion.trace, len(self.exact.time_s))

    @property
    def order(self) -> float:
        """Order of convergence of the scheme."""
        if isinstance(self.exact_motion, Extrapolation):
            return self.exact_motion.order
        return 1.0 if self.case.chain.damped else 2.0

    @property
    def in_overlaps(self) -> Trace:
        """``plain`` at the samples at which the exact motion is known."""
        return until(self.plain, len(self.exact.time_s))

    def stepped_by(self, engine: str) -> Trace:
        """Velocity Verlet with the rounding errors of an engine that has a time step."""
        return self.rounded if self.straight and load_engine(engine).scheme == IN_HEIGHTS else self.plain

    def scheme_of(self, engine: str) -> Trace:
        """Motion of a faultless run, except for rounding, at the samples at which the exact motion is known."""
        if load_engine(engine).scheme == EXACT:
            return self.reference
        return until(self.stepped_by(engine), len(self.exact.time_s))

    @cached_property
    def rounding_N(self) -> Array:
        """Largest force difference at each sample due to rounding, in N. Shape (samples,)."""
        return np.asarray(np.abs(self.rounded.force_N - self.plain.force_N).max(axis=1))

    @cached_property
    def rounding(self) -> Array:
        """Largest effect of rounding until each sample, over the largest change. Shape (samples,)."""
        share = np.nan_to_num(share_of_change(self.rounding_N, self.plain), nan=np.inf)
        return np.asarray(np.maximum.accumulate(share))

    @property
    def rounding_bound(self) -> Array:
        """Bound on the effect of rounding in any order of addition, until each sample. Shape (samples,)."""
        return ROUNDING_MARGIN * self.rounding

    @property
    def samples(self) -> int:
        """Horizon: number of samples before rounding alone separates two runs."""
        return comparable(self.rounding)[1]

    @cached_property
    def model_tolerance(self) -> Tolerance:
        """Tolerance of ``inputs/tolerances.toml`` for a run against its scheme."""
        return tolerance("model", model_quantity(self.case))

    @property
    def allowed(self) -> Tolerance:
        """Tolerance of a run against its scheme until the horizon; widened only if rounding exceeds it."""
        explained, _ = comparable(self.rounding)
        return (
            self.model_tolerance if explained <= self.model_tolerance.limit else Tolerance(explained, ROUNDING_REASON)
        )

    @cached_property
    def scale_N(self) -> float:
        """Largest change of force in N, the scale of force errors."""
        return largest_change_N((self.exact_to_end.trace if self.straight else self.exact).force_N)

    def energy_scale_J(self, trace: Trace) -> float:
        """Largest kinetic energy in J, of the exact motion if it is known, else of the run."""
        try:
            motion = self.exact_to_end.trace if self.straight and not self.why_unknown else trace
        except ArithmeticError:
            motion = trace
        return largest_kinetic_J(self.case.chain, motion)

    @cached_property
    def arrival(self) -> int:
        """Sample at which the wave reaches the lowest contact; the number of samples if it never does."""
        force_N = self.exact.force_N
        felt = np.flatnonzero(force_N.any(axis=0))
        if not felt.size:
            return len(force_N)
        lowest = force_N[:, felt[0]]
        arrived = np.abs(lowest - lowest[0]) > ARRIVED_SHARE * self.scale_N
        return int(np.argmax(arrived)) if arrived.any() else len(force_N)

    def growth(self, sample: int) -> float:
        """Growth of rounding errors since the wave reached the wall; 1 before."""
        if sample <= self.arrival:
            return 1.0
        return float(self.rounding[sample] / max(self.rounding[self.arrival], np.finfo(float).eps))

    def chaotic(self, sample: int) -> bool:
        """True if the chain has amplified rounding errors by chaos until a sample; never for a single body."""
        return self.case.chain.bodies > 1 and self.growth(sample) > CHAOTIC_GROWTH


def comparable(rounding_share: Array) -> tuple[float, int]:
    """Difference of two engines due to rounding, over the largest change, and the number of samples until the horizon.

    Args:
        rounding_share: effect of rounding on the forces at each sample, over the largest change. Shape (samples,).
    """
    explained = ROUNDING_MARGIN * np.maximum.accumulate(rounding_share)
    samples = max(1, int(np.searchsorted(explained, ROUNDING_MARGIN * HORIZON, side="right")))
    return float(explained[samples - 1]), samples


def model_quantity(case: Case) -> str:
    """Name of the tolerance of a case's modelling error."""
    level = case.chain.lateral is not None and bool(np.isinf(case.chain.radius_m[-1]))
    return "level" if level else FORCE


_last: dict[tuple[str, str], Baseline] = {}  # baselines of the last case, by deck and law of friction
_lock = Lock()


def baseline_of(case: Case, engine: str = VERLET) -> Baseline:
    """Baseline of a case for an engine; the baselines of the last case are cached."""
    law = load_engine(engine if case.chain.lateral is not None else VERLET).shear
    with _lock:
        same = next((key for (key, _), kept in _last.items() if kept.case is case), None) or _key(case)
        if not any(key == same for key, _ in _last):
            _last.clear()
        return _last.setdefault((same, law), Baseline(case, law))


def _key(case: Case) -> str:
    """Everything that determines the baselines of a case; the deck lacks gauges and the reference's tolerance."""
    return f"{load_engine(VERLET).render(case).sha256} {case.layout} {case.reference_tolerance}"
