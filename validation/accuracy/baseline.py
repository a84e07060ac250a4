"""Baseline of a run: the exact motion, its own scheme at the same step, and what rounding alone may add.

This is the one place that says whether a difference is only rounding. It knows of a straight chain and of a
three-dimensional one alike

* ``plain``: velocity Verlet at the case's step, in overlaps, or in three dimensions with the engine's law of friction;
* ``rounded``: the same with other rounding, in absolute heights, or in three dimensions turned and lifted;
* ``exact``: followed adaptively (``Truth``) as long as its own error is measured to stay below ``HORIZON``, or in three
  dimensions extrapolated from finer steps (``Extrapolation``) as long as rounding alone does not part two runs.
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
from validation.accuracy.schemes import Truth, truth_of, turned_verlet_of, verlet_in_heights, verlet_of

ROUNDING_MARGIN = 10.0  # engines add in another order than the in-repo scheme: rounding of the same size, not the same
ROUNDING_REASON = (
    f"{ROUNDING_MARGIN:g} times what rounding absolute coordinates does to this very scene, measured in-repo"
)
HORIZON = 1e-6  # where rounding alone makes this much, or the exact motion is off by it, pointwise comparison ends
MAX_BODIES = 20_000
TOO_LARGE = f"not measured: the exact motion of more than {MAX_BODIES} bodies costs more than most runs of them"
MAX_WORK = 20_000_000  # bodies times steps of the finest three-dimensional run, some ten seconds
MIN_ORDER, MAX_ORDER = 0.5, 2.5  # that an extrapolation is made with
ARRIVED_SHARE = 1e-3  # of the largest change: the wave is there
CHAOTIC_GROWTH = 100.0  # times what rounding made until the wave came to the wall: measured up to 56 on shipped scenes


@dataclass(frozen=True)
class Extrapolation:
    """A motion at a time step of zero, by Richardson's extrapolation from half and a quarter of the step.

    Attributes:
        trace: its forces are extrapolated, all else is that of the whole step.
        order: by which the three steps converge.
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
    """Motions of a case and what they allow; each is computed once, when it is asked for.

    Attributes:
        law: of friction in three dimensions.
    """

    case: Case
    law: str

    @property
    def straight(self) -> bool:
        """Whether the chain is straight."""
        return self.case.chain.lateral is None

    @property
    def unknown(self) -> str:
        """Why the exact motion is not known; empty where it is."""
        lateral = self.case.chain.lateral
        if lateral is None:
            return TOO_LARGE if self.case.chain.bodies > MAX_BODIES else ""
        if lateral.bore is not None and lateral.bore.sides is not None:
            return "not measured: the in-repo scheme has a true cylinder, no bore of flat sides"
        if 4 * self.case.chain.bodies * self.case.scene.steps > MAX_WORK:
            return f"not measured: at a quarter of the step this is more than {MAX_WORK:g} bodies times steps"
        return ""

    @cached_property
    def plain(self) -> Trace:
        """Velocity Verlet at the case's step."""
        return verlet_of(self.case, self.law)

    @cached_property
    def half(self) -> Trace:
        """The same at half the step."""
        return verlet_of(self.case, self.law, 2)

    @cached_property
    def quarter(self) -> Trace:
        """The same at a quarter of the step."""
        return verlet_of(self.case, self.law, 4)

    @cached_property
    def eighth(self) -> Trace:
        """The same at an eighth of the step."""
        return verlet_of(self.case, self.law, 8)

    @cached_property
    def rounded(self) -> Trace:
        """``plain`` with other rounding."""
        return verlet_in_heights(self.case) if self.straight else turned_verlet_of(self.case, self.law)

    @cached_property
    def followed(self) -> Truth:
        """The motion of a straight chain as exactly as it can be followed, to the end.

        Raises:
            ArithmeticError: it cannot be followed.
        """
        return truth_of(self.case)

    @cached_property
    def known(self) -> Array:
        """The most that this motion itself is off until each sample, measured, of the largest change."""
        return share_of_change(self.followed.known_N, self.followed.trace)

    @cached_property
    def truth(self) -> Truth | Extrapolation:
        """The exact motion as long as it is known to ``HORIZON``.

        Raises:
            ArithmeticError: it cannot be followed.
        """
        if self.straight:
            return self.followed.first(max(1, int(np.searchsorted(self.known, HORIZON, side="right"))))
        whole, half, quarter = (until(trace, self.samples) for trace in (self.plain, self.half, self.quarter))
        order, apart = 2.0, [float(np.abs(a.force_N - b.force_N).max()) for a, b in ((whole, half), (half, quarter))]
        if all(apart) and np.isfinite(apart).all():
            order = min(max(log2(apart[0] / apart[1]), MIN_ORDER), MAX_ORDER)
        found = Extrapolation(whole, half, quarter, order)
        forces = np.asarray(found.at_zero(half.force_N, quarter.force_N))
        return replace(found, trace=replace(whole, force_N=forces))

    @property
    def exact(self) -> Trace:
        """The exact motion at the first of the case's samples, as many as it is known at."""
        return self.truth.trace

    @property
    def order(self) -> float:
        """Order of convergence of the scheme."""
        if isinstance(self.truth, Extrapolation):
            return self.truth.order
        return 1.0 if self.case.chain.damped else 2.0

    @property
    def in_overlaps(self) -> Trace:
        """``plain`` at the samples at which the exact motion is known."""
        return until(self.plain, len(self.exact.time_s))

    def stepped_by(self, engine: str) -> Trace:
        """The case by the scheme of an engine that has a time step, rounded as the engine does."""
        return self.rounded if self.straight and load_engine(engine).scheme == IN_HEIGHTS else self.plain

    def scheme_of(self, engine: str) -> Trace:
        """The motion of a run without faults, but for rounding, at the samples at which the exact motion is known."""
        if load_engine(engine).scheme == EXACT:
            return self.exact
        return until(self.stepped_by(engine), len(self.exact.time_s))

    @cached_property
    def rounding_N(self) -> Array:
        """Largest force difference at each sample that rounding makes. Shape (samples,)."""
        return np.asarray(np.abs(self.rounded.force_N - self.plain.force_N).max(axis=1))

    @cached_property
    def rounding(self) -> Array:
        """The most that rounding has made until each sample, of the largest change. Shape (samples,)."""
        share = np.nan_to_num(share_of_change(self.rounding_N, self.plain), nan=np.inf)
        return np.asarray(np.maximum.accumulate(share))

    @property
    def explained(self) -> Array:
        """Share that rounding explains until each sample, in another order of adding. Shape (samples,)."""
        return ROUNDING_MARGIN * self.rounding

    @property
    def samples(self) -> int:
        """The horizon: how many samples can be compared before rounding alone parts two runs."""
        return comparable(self.rounding)[1]

    @cached_property
    def stated(self) -> Tolerance:
        """Tolerance of a run against its scheme, as ``inputs/tolerances.toml`` has it."""
        return tolerance("model", model_quantity(self.case))

    @property
    def allowed(self) -> Tolerance:
        """The same until the horizon, and more only where rounding is measured to exceed it."""
        explained, _ = comparable(self.rounding)
        return self.stated if explained <= self.stated.limit else Tolerance(explained, ROUNDING_REASON)

    @cached_property
    def scale_N(self) -> float:
        """Largest change of force, over which errors are counted."""
        return largest_change_N((self.followed.trace if self.straight else self.exact).force_N)

    def energy_scale_J(self, trace: Trace) -> float:
        """Largest kinetic energy, of the exact motion where that is known, else of a run."""
        try:
            motion = self.followed.trace if self.straight and not self.unknown else trace
        except ArithmeticError:
            motion = trace
        return largest_kinetic_J(self.case.chain, motion)

    @cached_property
    def arrival(self) -> int:
        """The sample at which the wave has come to the lowest contact; how many there are where it never does."""
        force_N = self.exact.force_N
        felt = np.flatnonzero(force_N.any(axis=0))
        if not felt.size:
            return len(force_N)
        lowest = force_N[:, felt[0]]
        arrived = np.abs(lowest - lowest[0]) > ARRIVED_SHARE * self.scale_N
        return int(np.argmax(arrived)) if arrived.any() else len(force_N)

    def growth(self, sample: int) -> float:
        """Growth of rounding since the wave came to the wall; 1 before."""
        if sample <= self.arrival:
            return 1.0
        return float(self.rounding[sample] / max(self.rounding[self.arrival], np.finfo(float).eps))

    def chaotic(self, sample: int) -> bool:
        """Whether the chain multiplies by then whatever there is; one body alone is never chaotic, it only adds up."""
        return self.case.chain.bodies > 1 and self.growth(sample) > CHAOTIC_GROWTH


def comparable(rounding_share: Array) -> tuple[float, int]:
    """Difference of two engines that rounding explains, of the largest change, and for how many samples that is small.

    Args:
        rounding_share: what rounding does to the forces at each sample, over the largest change. Shape (samples,).
    """
    explained = ROUNDING_MARGIN * np.maximum.accumulate(rounding_share)
    samples = max(1, int(np.searchsorted(explained, ROUNDING_MARGIN * HORIZON, side="right")))
    return float(explained[samples - 1]), samples


def model_quantity(case: Case) -> str:
    """The name of the tolerance of a case's modelling error."""
    level = case.chain.lateral is not None and bool(np.isinf(case.chain.radius_m[-1]))
    return "level" if level else FORCE


_last: dict[tuple[str, str], Baseline] = {}  # by deck and law of friction; of the last case: its engines share them
_looking = Lock()


def baseline_of(case: Case, engine: str = VERLET) -> Baseline:
    """Baseline of a case for an engine; that of the last case is kept."""
    law = load_engine(engine if case.chain.lateral is not None else VERLET).shear
    with _looking:
        keys = [key for key, kept in _last.items() if kept.case is case]
        # gauges are part of it
        same = keys[0][0] if keys else f"{load_engine(VERLET).render(case).sha256} {case.layout}"
        if not any(key == same for key, _ in _last):
            _last.clear()
        return _last.setdefault((same, law), Baseline(case, law))
