"""The one comparator: a run against its own scheme at the same step, integrated in this repository.

A run is right if it differs from its scheme by no more than rounding explains. ``plain`` is velocity Verlet at the
step of the case, in overlaps; ``rounded`` is the same with other rounding errors: in absolute heights as the codes have
them, in three dimensions turned and lifted. Differences are bounded at each sample by ``ROUNDING_MARGIN`` times the
largest difference of ``rounded`` and ``plain`` until then. Runs are compared until the horizon, where this bound
exceeds ``AGREEMENT``. A run whose output rules out this comparison fails as well.
"""

import re
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property, lru_cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from drivers.base.errors import RunError, digits_apart
from drivers.base.processes import STDERR, STDOUT, EndedProcess
from drivers.base.tolerances import Tolerance, tolerance
from drivers.chain.case import ALL_DIGITS, Case
from drivers.chain.chain import Array, Chain, above_rim_m, furthest_m, hertz_force, moving_at_start
from drivers.chain.schemes import exact_of, printed_of, turned_verlet_of, verlet_in_heights, verlet_of
from drivers.chain.trace import FORCE, Trace, finite_part, is_at_rest, largest_change_N, largest_kinetic_J, with_work
from drivers.engines import EXACT, IN_HEIGHTS, VERLET, Engine, load_engine

ROUNDING_MARGIN = 10.0  # engines add in another order than the in-repo scheme: rounding errors of the same size
ROUNDING_REASON = (
    f"{ROUNDING_MARGIN:g} times the effect of rounding absolute coordinates, measured in-repo on this scene"
)
MOMENTUM_SHARE = 1e-2  # of the momentum of all bodies together at the largest kinetic energy: less cancels
SAME = 0.1  # of the limit without rounding: scales by motions with and without rounding differ by less
AGREEMENT = 1e-2  # of the largest change: runs that differ by more do not agree at all
FIELDS = {"energy": "total_energy_J", "momentum": "momentum_N_s"}  # compared columns of a trace besides the forces
UNITS = {FORCE: "N", "energy": "J", "momentum": "N s"}
COMPARED = tuple(UNITS)
REASON_CHARACTERS = 300
UNSTABLE = "unstable at t = "  # beginning of messages
OWN_ERRORS = ("ERROR", "Traceback")  # beginnings of lines that lead to the code's own message
ROUNDINGS = 64  # largest deviation of a start in units in the last place of the coordinates


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
        with np.errstate(all="ignore"):
            other = verlet_in_heights(self.case) if self.case.chain.straight else turned_verlet_of(self.case, self.law)
            return other if self.case.chain.drive is None else with_work(other, self.plain)

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
    def samples(self) -> int:
        """Horizon: number of samples before rounding alone separates two runs."""
        return max(1, int(np.searchsorted(ROUNDING_MARGIN * self.rounding[FORCE], AGREEMENT, side="right")))

    @cached_property
    def scales(self) -> dict[str, float]:
        """Scales of errors: largest change of force in N, largest kinetic energy in J, largest momentum in N s.

        The momentum is at least the sum of m |v| at time 0, since bodies may meet head on; at rest, at least the
        impulse of the loads.
        """
        motion = finite_part(self.plain)
        assert motion is not None  # the start is finite
        return {quantity: scale_of_motion(self.case, motion, quantity) for quantity in COMPARED}

    @cached_property
    def rounding(self) -> dict[str, Array]:
        """Largest effect of rounding until each sample by quantity, divided by its scale; inf after a blow-up.

        That of the few digits of a text is included. Each is an array of shape (samples,).
        """
        others = [self.rounded]
        if self.case.digits < ALL_DIGITS and self.case.chain.straight:
            others.append(printed_of(self.case, self.plain))
        apart = {
            name: [difference(name, other, self.plain, self.scales[name]).max(axis=1) for other in others]
            for name in COMPARED
        }
        return {name: np.maximum.accumulate(np.max(shares, axis=0)) for name, shares in apart.items()}

    def explained(self, quantity: str) -> Array:
        """Limits of the difference of a run from its scheme at each sample until the horizon. Shape (samples,).

        Rounding in any order of addition, of forces as well as of the quantity itself, explains less.

        Args:
            quantity: ``force``, ``energy`` or ``momentum``, divided by their scales.
        """
        causes = {FORCE, quantity}
        bounds = [np.maximum(ROUNDING_MARGIN * self.rounding[name], self._least(name).limit) for name in causes]
        return np.asarray(np.max(bounds, axis=0)[: self.samples])

    def tolerance_at(self, quantity: str, sample: int) -> Tolerance:
        """Limit of ``explained`` at a sample, with its reason."""
        limit, least = float(self.explained(quantity)[sample]), self._least(quantity)
        return least if limit <= least.limit else Tolerance(limit, ROUNDING_REASON)

    def _least(self, quantity: str) -> Tolerance:
        """Limit without rounding; LIGGGHTS has no level flat face in three dimensions."""
        chain = self.case.chain
        level = not chain.straight and bool(np.isinf(chain.radius_m[-1]))
        return tolerance("model", "motion" if quantity != FORCE else "level" if level else FORCE)

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
        right = self.of(engine)
        trace = with_work(trace, right)
        known = known_of(trace)
        scales = {quantity: scale_of_motion(self.case, right, quantity) for quantity in known}
        apart = {quantity: difference(quantity, trace, right, scales[quantity]).max() for quantity in known}
        if all(apart[quantity] <= SAME * self._least(quantity).limit for quantity in known):
            return ""  # the same to the last digits in all samples: how far rounding may go need not be known
        for quantity in known:
            unit, scale = UNITS[quantity], self.scales[quantity]
            share = difference(quantity, trace, right, scale)[: self.samples]
            allowed = self.explained(quantity)[: len(share)]
            beyond = share.max(axis=1) > allowed
            if not beyond.any():
                continue
            sample = int(np.argmax(beyond))
            column = int(np.argmax(share[sample]))
            has, expected = (field_of(motion, quantity)[: sample + 1, column] for motion in (trace, right))
            one, other = digits_apart(float(has[-1]), float(expected[-1]))
            when = "from the start" if sample == 0 else f"from {self.case.sample_times_s[sample] * 1e6:.6g} µs"
            if sample and quantity == FORCE:
                still = np.abs(expected - expected[0]).max() / scale <= allowed[sample]
                when += ", before any wave arrives" if still else ", in the wave"
            name = f"the force in contact {column + 1}" if quantity == FORCE else f"the {quantity}"
            return f"departs from its scheme {when}: {name} is {one} {unit}, by its scheme {other} {unit}"
        return ""


def scheme_of(case: Case, engine: str = VERLET) -> Scheme:
    """Scheme of a case on an engine; the last ones are cached."""
    return cached_scheme(case, load_engine(VERLET if case.chain.straight else engine).shear)


cached_scheme = lru_cache(maxsize=2)(Scheme)


def scale_of_motion(case: Case, motion: Trace, quantity: str) -> float:
    """Scale of errors of a quantity by a motion, as in ``Scheme.scales``."""
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


def known_of(trace: Trace) -> list[str]:
    """Quantities of ``COMPARED`` that a trace tells."""
    return [quantity for quantity in COMPARED if not np.isnan(field_of(trace, quantity)).all()]


def field_of(trace: Trace, quantity: str) -> Array:
    """Forces of all contacts, change of the energy, or momentum. Shape (samples, contacts) or (samples, 1)."""
    values: Array = trace.force_N if quantity == FORCE else getattr(trace, FIELDS[quantity])[:, np.newaxis]
    return values - values[0] if quantity == "energy" else values


def difference(quantity: str, one: Trace, other: Trace, scale: float) -> Array:
    """Magnitude of the difference of two motions at their common samples, divided by a scale; inf for NaN.

    Returns:
        Array of shape (samples, contacts) for forces, else (samples, 1).
    """
    samples = min(len(one.time_s), len(other.time_s))
    with np.errstate(over="ignore", invalid="ignore"):
        apart = np.abs(field_of(one, quantity)[:samples] - field_of(other, quantity)[:samples]) / scale
        return np.nan_to_num(apart, nan=np.inf)


def largest_difference(
    quantity: str, trace: Trace, right: Trace, scale: float, limits: Array | None = None
) -> tuple[float, tuple[int, int], str]:
    """Largest difference of two motions at common samples: its size divided by a scale, sample and column, place.

    With limits at each sample, shape (samples,), the difference closest to its limit. The place has the size relative
    to the largest force as well, if that is more than twice the largest change.
    """
    share = difference(quantity, trace, right, scale)
    of_limit = share if limits is None else share / limits[: len(share), np.newaxis]
    sample, column = map(int, np.unravel_index(int(np.argmax(of_limit)), of_limit.shape))
    size, where = float(share[sample, column]), place_of(quantity, right.time_s, (sample, column))
    if quantity == FORCE:
        plain, change_N = float(np.abs(right.force_N).max()), largest_change_N(right.force_N)
        where += f", {size * change_N / plain:.1e} of the largest force" if plain > 2 * change_N else ""
    return size, (sample, column), where


def place_of(quantity: str, time_s: Array, place: tuple[int, int]) -> str:
    """Contact and time of a sample and column, as text."""
    contact = f"contact {place[1] + 1} " if quantity == FORCE else ""
    return f"{contact}at {time_s[place[0]] * 1e6:.6g} µs"


def judged_until(case: Case, samples: int, why: str) -> str:
    """End of a sentence: until when a run is judged, and why; empty if to the end."""
    all_of_it = samples >= case.scene.samples
    return "" if all_of_it else f"; judged until {case.sample_times_s[samples] * 1e6:g} µs, where {why}"


def checked_trace(case: Case, engine: Engine, outcome: EndedProcess, folder: Path) -> Trace:
    """Read a trace of a process that ended, check it, and compare it with the scheme of the engine.

    Raises:
        RunError: the run failed; with the partial trace if there is one.
    """
    stdout, stderr = ((folder / name).read_text(errors="replace") for name in (STDOUT, STDERR))
    if outcome.timed_out or outcome.code != 0:
        try:
            before: Trace | None = engine.read(case, folder)
        except RunError as error:
            before = error.partial
        blown_up = unstable(case, before) if before else None
        status, ending = "timeout", timed_out(outcome.limit_s, engine.loop_seconds(stdout))
        if not outcome.timed_out:
            message = _failed_start(stdout, stderr) or engine.failure_reason(stdout, stderr)
            message = "".join(c if c.isprintable() else " " for c in message)[:REASON_CHARACTERS]
            how = f"exit code {outcome.code}" if outcome.code > 0 else f"killed by signal {-outcome.code}"
            status, ending = "failed", f"{how}: {message}"
        raise RunError("; ".join(filter(None, (blown_up, ending))), status, partial=before)
    return compared(case, engine, checked(case, engine.read(case, folder)))


def checked(case: Case, trace: Trace) -> Trace:
    """Check a complete trace.

    Raises:
        RunError: it cannot be that of the case.
    """
    if reason := unstable(case, trace) or wrong_start(case, trace) or not_modelled(case.chain, trace):
        raise RunError(reason, partial=trace)
    return trace


def compared(case: Case, engine: Engine, trace: Trace) -> Trace:
    """Compare a trace with the scheme of its engine; returns it with the work of the drive by that scheme.

    Raises:
        RunError: it departs from its scheme.
    """
    scheme = scheme_of(case, engine.name)
    try:
        if departure := scheme.departure(engine.name, trace):
            raise RunError(departure, partial=trace)
    except ArithmeticError as error:  # no exact motion to compare a run of ``reference`` with
        raise RunError(f"cannot be compared: {error}", partial=trace) from error
    return trace if case.chain.drive is None else with_work(trace, scheme.of(engine.name))


def timed_out(limit_s: float, loop_s: float | None = None) -> str:
    """Message on a run that was ended at its time limit, perhaps after its time loop."""
    hung = "" if loop_s is None else f"the time loop ended after {loop_s:g} s, but the program did not exit; "
    return f"{hung}killed at the time limit of {limit_s:g} s"


def _failed_start(stdout: str, stderr: str) -> str:
    """Lines of the standard error of a program that failed before any output, such as mpirun's; else empty."""
    lines = [line.strip() for line in stderr.splitlines() if re.search(r"\w", line)]
    if re.search(r"\w", stdout) or any(line.startswith(OWN_ERRORS) for line in lines):
        return ""
    return " ".join(lines)


def wrong_start(case: Case, trace: Trace) -> str | None:
    """Message on a height at time 0 that is not that of the scene; None if all are those of the scene.

    Other deviations of a start are found by the comparison with the scheme, which has no heights.
    """
    if trace.height_m is None:
        return None
    chain, furthest = case.chain, furthest_m(case.chain)
    off = np.abs(trace.height_m[0] - chain.height_m) > max(ROUNDINGS * np.spacing(furthest), furthest / 10**case.digits)
    body = int(np.argmax(off))
    has, right = digits_apart(float(trace.height_m[0, body]), float(chain.height_m[body]))
    return f"body {body + 1} starts with a height of {has} m, the scene has {right} m" if off.any() else None


def unstable(case: Case, trace: Trace) -> str | None:
    """Message on values that are not finite, or beads that pass through the wall or each other; None without such."""
    faults = [(int(np.nonzero(wrong)[0][0]), message) for wrong, message in _faults(case, trace) if wrong.any()]
    if not faults:
        return None
    first, message = min(faults, key=lambda fault: fault[0])
    return f"{UNSTABLE}{trace.time_s[first]:g} s: {message}"


def _faults(case: Case, trace: Trace) -> Iterator[tuple[NDArray[np.bool_], str]]:
    """Kinds of faults: a mask of the samples, or of samples and bodies, that have it, and its message."""
    chain = case.chain
    yield ~np.isfinite(trace.force_N), "values are not finite"
    yield ~(np.isfinite(trace.total_energy_J) | np.isnan(trace.total_energy_J).all()), "values are not finite"
    if trace.height_m is not None:
        passed = np.empty(trace.height_m.shape, bool)
        passed[:, 0] = (trace.height_m[:, 0] < chain.wall_height_m) & (chain.wall is not None)
        np.less(trace.height_m[:, 1:], trace.height_m[:, :-1], out=passed[:, 1:])
        body = int(np.argmax(passed.any(axis=0)))
        beneath = f"body {body}" if body else "the wall"
        yield passed, f"body {body + 1} passed through {beneath}"
    through = hertz_force(chain.stiffness, chain.smaller_radius_m)  # force at an overlap of a radius
    through = np.maximum(through, tolerance("model", FORCE).limit * through.max())  # without a wall: rounding
    yield np.asarray(trace.force_N > through), "beads are pressed into each other by more than a radius"


def not_modelled(chain: Chain, trace: Trace) -> str | None:
    """Message if a striker above the tube comes down to its upper end, which no deck models; else None."""
    if not chain.bore_m or chain.bodies - 1 in chain.guided or trace.height_m is None:
        return None
    down = trace.height_m[:, -1] - above_rim_m(float(chain.radius_m[-1]), chain.bore_m) < chain.top_m
    when = f"at t = {trace.time_s[int(np.argmax(down))]:g} s the striker comes down to the end of the tube"
    return f"{when}: lower tube.top" if down.any() else None
