"""The one comparator: a run against its own scheme at the same step, integrated in this repository.

A run is right if it differs from its scheme by no more than rounding explains. ``plain`` is velocity Verlet at the
step of the case, in overlaps; ``rounded`` is the same with other rounding errors: in absolute heights as the codes have
them, in three dimensions turned and lifted. Differences are bounded at each sample by ``ROUNDING_MARGIN`` times the
largest difference of ``rounded`` and ``plain`` until then. Runs are compared until the horizon, where this bound
exceeds ``AGREEMENT``.
"""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np

from drivers.base.errors import digits_apart
from drivers.base.tolerances import Tolerance, tolerance
from drivers.chain.case import Case
from drivers.chain.chain import Array, moving_at_start
from drivers.chain.schemes import exact_of, turned_verlet_of, verlet_in_heights, verlet_of
from drivers.chain.trace import (
    FORCE,
    Trace,
    is_at_rest,
    largest_change_N,
    largest_kinetic_J,
    static_load_remark,
    until,
    with_work,
)
from drivers.engines import EXACT, IN_HEIGHTS, VERLET, load_engine

ROUNDING_MARGIN = 10.0  # engines add in another order than the in-repo scheme: rounding errors of the same size
ROUNDING_REASON = (
    f"{ROUNDING_MARGIN:g} times the effect of rounding absolute coordinates, measured in-repo on this scene"
)
MOMENTUM_SHARE = 1e-2  # of the momentum of all bodies together at the largest kinetic energy: less cancels
AGREEMENT = 1e-2  # of the largest change: runs that differ by more do not agree at all
FIELDS = {"energy": "total_energy_J", "momentum": "momentum_N_s"}  # compared columns of a trace besides the forces
COMPARED = (FORCE, *FIELDS)
UNITS = {FORCE: "N", "energy": "J", "momentum": "N s"}


@dataclass(frozen=True, eq=False)
class Scheme:
    """Motions of the schemes of a case, each computed once, on first use.

    Attributes:
        law: law of friction in three dimensions.
    """

    case: Case
    law: str

    @cached_property
    def plain(self) -> Trace:
        """Velocity Verlet at the case's step."""
        with np.errstate(all="ignore"):  # too large a step blows up
            return verlet_of(self.case, self.law)

    @cached_property
    def rounded(self) -> Trace:
        """``plain`` with other rounding errors; the work of a drive is that of ``plain``."""
        with ThreadPoolExecutor(1) as thread, np.errstate(all="ignore"):
            plain = thread.submit(lambda: self.plain)
            other = verlet_in_heights(self.case) if self.case.chain.straight else turned_verlet_of(self.case, self.law)
            return with_work(other, plain.result())

    @cached_property
    def reference(self) -> Trace:
        """The exact motion to the tolerance of the case's reference run.

        Raises:
            ArithmeticError: the integrator fails.
        """
        return exact_of(self.case, self.case.reference_tolerance)

    def of(self, engine: str) -> Trace:
        """Motion of a faultless run of an engine, except the order of additions."""
        scheme = load_engine(engine).scheme
        if scheme == EXACT:
            return self.reference
        return self.rounded if self.case.chain.straight and scheme == IN_HEIGHTS else self.plain

    @cached_property
    def rounding_N(self) -> Array:
        """Largest force difference at each sample due to rounding, in N; inf after a blow-up. Shape (samples,)."""
        with np.errstate(all="ignore"):
            apart_N = np.abs(self.rounded.force_N - self.plain.force_N).max(axis=1)
            return np.asarray(np.nan_to_num(apart_N, nan=np.inf))

    @cached_property
    def samples(self) -> int:
        """Horizon: number of samples before rounding alone separates two runs."""
        return max(1, int(np.searchsorted(self.rounding_bound, AGREEMENT, side="right")))

    def scale(self, quantity: str) -> float:
        """Scale of errors: largest change of force in N, largest kinetic energy in J, largest momentum in N s.

        The momentum is at least the sum of m |v| at time 0, since bodies may meet head on; at rest, at least the
        impulse of the loads.
        """
        finite = int(np.argmin(np.append(np.isfinite(self.rounding_N), False)))  # samples before a blow-up
        return scale_of_motion(self.case, until(self.plain, max(finite, 1)), quantity)

    @cached_property
    def rounding(self) -> Array:
        """Largest effect of rounding until each sample, divided by the largest change. Shape (samples,)."""
        return np.asarray(np.maximum.accumulate(self.rounding_N) / self.scale(FORCE))

    @property
    def rounding_bound(self) -> Array:
        """Bound on the effect of rounding in any order of addition, until each sample. Shape (samples,)."""
        return ROUNDING_MARGIN * self.rounding

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

    @property
    def until_horizon(self) -> str:
        """End of a sentence: until when differences from a scheme are judged, and why; empty if to the end."""
        return judged_until(self.case, self.samples, f"rounding alone explains differences of {AGREEMENT:g}")

    def departure(self, engine: str, trace: Trace) -> str:
        """First time and contact at which a run, finished or not, departs from its scheme; empty if it never does.

        A fault in the set-up shows at time 0 or before a wave arrives, a fault in the law or in a mass in the wave.

        Raises:
            ArithmeticError: the exact motion, with which a run of ``reference`` is compared, fails.
        """
        samples = min(self.samples, len(trace.time_s))
        scheme = until(self.of(engine), samples)
        trace = with_work(until(trace, samples), scheme)
        for quantity in COMPARED:
            has, right, scale = field_of(trace, quantity), field_of(scheme, quantity), self.scale(quantity)
            share = apart(has, right, scale)
            allowed = self.explained(quantity)[: len(share)]
            beyond = share.max(axis=1) > allowed
            if not beyond.any():
                continue
            sample = int(np.argmax(beyond))
            column = int(np.argmax(share[sample]))
            one, other = digits_apart(float(has[sample, column]), float(right[sample, column]))
            unit = UNITS[quantity]
            when = "from the start" if sample == 0 else f"from {self.case.sample_times_s[sample] * 1e6:.6g} µs"
            if sample and quantity == FORCE:
                change = np.abs(right[: sample + 1, column] - right[0, column]).max() / scale
                when += ", before any wave arrives" if change <= allowed[sample] else ", in the wave"
            name = f"the force in contact {column + 1}" if quantity == FORCE else f"the {quantity}"
            return f"departs from its scheme {when}: {name} is {one} {unit}, by its scheme {other} {unit}"
        return ""


def scheme_of(case: Case, engine: str = VERLET) -> Scheme:
    """Scheme of a case on an engine; the last ones are cached."""
    return cached_scheme(case, load_engine(VERLET if case.chain.straight else engine).shear)


cached_scheme = lru_cache(maxsize=2)(Scheme)


def scale_of_motion(case: Case, motion: Trace, quantity: str) -> float:
    """Scale of errors of a quantity by a motion, as in ``Scheme.scale``."""
    if quantity == FORCE:
        return largest_change_N(motion.force_N)
    if quantity == "energy":
        return largest_kinetic_J(case.chain, motion)
    resting = is_at_rest(motion.force_N)
    loads = abs(float(case.chain.load_N.sum())) * float(motion.time_s[-1]) if resting else 0.0
    # of a total momentum that vanishes at all samples, while bodies move against each other or between samples
    least = MOMENTUM_SHARE * np.sqrt(2 * case.chain.mass_kg.sum() * largest_kinetic_J(case.chain, motion))
    largest = float(np.abs(motion.momentum_N_s).max())
    return max(largest, moving_at_start(case.chain), loads, float(least)) or 1.0


def field_of(trace: Trace, quantity: str) -> Array:
    """Forces of all contacts, change of the energy, or momentum. Shape (samples, contacts) or (samples, 1)."""
    if quantity == FORCE:
        return trace.force_N
    column = getattr(trace, FIELDS[quantity])
    return np.asarray(column - column[0] if quantity == "energy" else column)[:, np.newaxis]


def apart(one: Array, other: Array, scale: float) -> Array:
    """Magnitude of the difference of two fields over the common samples, divided by a scale; inf for NaN."""
    samples = min(len(one), len(other))
    with np.errstate(over="ignore", invalid="ignore"):
        return np.nan_to_num(np.abs(one[:samples] - other[:samples]) / scale, nan=np.inf)


def largest_difference(
    quantity: str, trace: Trace, right: Trace, scale: float, limits: Array | None = None
) -> tuple[float, tuple[int, int], str]:
    """Largest difference of two motions at common samples: its size divided by a scale, sample and column, place.

    With limits at each sample, shape (samples,), the difference closest to its limit.
    """
    has, expected = field_of(trace, quantity), field_of(right, quantity)
    share = apart(has, expected, scale)
    of_limit = share if limits is None else share / limits[: len(share), np.newaxis]
    sample, column = map(int, np.unravel_index(int(np.argmax(of_limit)), of_limit.shape))
    size = float(share[sample, column])
    remark = static_load_remark(size, expected) if quantity == FORCE else ""
    return size, (sample, column), place_of(quantity, right.time_s, (sample, column)) + remark


def place_of(quantity: str, time_s: Array, place: tuple[int, int]) -> str:
    """Contact and time of a sample and column, as text."""
    contact = f"contact {place[1] + 1} " if quantity == FORCE else ""
    return f"{contact}at {time_s[place[0]] * 1e6:.6g} µs"


def judged_until(case: Case, samples: int, why: str) -> str:
    """End of a sentence: until when a run is judged, and why; empty if to the end."""
    all_of_it = samples >= case.scene.samples
    return "" if all_of_it else f"; judged until {case.sample_times_s[samples] * 1e6:g} µs, where {why}"


def force_tolerance(case: Case) -> str:
    """Name of the tolerance of the forces of a case: LIGGGHTS has no level flat face in three dimensions."""
    level = not case.chain.straight and bool(np.isinf(case.chain.radius_m[-1]))
    return "level" if level else FORCE
