"""First departure of a run from the exact motion, and its cause.

A run is compared with the exact motion and with its own scheme at the same step. If it deviates from its scheme by
more than rounding, something is wrong: ``set-up`` if that happens before a wave arrives, else ``model`` (``diagnosis``
finds the step, law or mass that explains it). If it departs from the exact motion together with its scheme, the cause
is ``truncation``, or ``chaos`` once the chain has amplified rounding errors as much.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from drivers.chain.case import Case
from drivers.chain.chain import Array, Chain, moving_at_start
from drivers.chain.trace import Trace, until
from drivers.engines import EXACT, REFERENCE, load_engine
from postproc.read.residual import is_at_rest, largest_change_N, largest_kinetic_J, static_load_remark
from validation.accuracy.baseline import HORIZON, ROUNDING_MARGIN, Baseline, baseline_of
from validation.accuracy.budget import exactness_note

# of the largest change: limit of pointwise comparison, error of good time steps, resolution of experiments
LEVELS = (HORIZON, 1e-4, 1e-2)
NONE, UNKNOWN = "none", "not known"
TRUNCATION, ROUNDING, CHAOS = "truncation", "rounding", "chaos"
SET_UP, MODEL = FAULTS = ("set-up", "model")
START_SHARE = 1e-9  # of the largest energy and momentum: tolerance at time 0; up to 3e-16 measured
STILL_SHARE = 1e-3  # of the tolerance: a smaller change of force means that the wave has not arrived
ENERGY_FACTOR = 10.0  # tolerance of the energy over that of the forces, as it goes with velocity squared; 2.3 measured


@dataclass(frozen=True)
class Deviation:
    """Largest difference of two traces.

    Attributes:
        share: difference of forces over the largest change of F_ref; of kinetic energy or momentum over the largest.
        time_s: time of the difference.
        quantity: such as ``contact 3`` or ``momentum``.
        remark: the difference relative to the largest force, if that is much larger than the largest change.
    """

    share: float
    time_s: float
    quantity: str
    remark: str = ""

    @property
    def place(self) -> str:
        """Text with quantity and time."""
        return f"{self.quantity} at {self.time_s * 1e6:g} µs{self.remark}"


def deviation(trace: Trace, reference: Trace, samples: int | None = None) -> Deviation:
    """Largest force difference from a reference, over its largest change.

    Args:
        trace: the trace.
        reference: the reference.
        samples: number of samples to compare; all by default.

    Raises:
        ValueError: the traces differ in contacts or sample times.
    """
    if trace.force_N.shape != reference.force_N.shape:
        raise ValueError(f"{trace.force_N.shape} samples and contacts against {reference.force_N.shape}")
    if not np.allclose(trace.time_s, reference.time_s, rtol=1e-12, atol=0):
        raise ValueError("the sample times differ")
    share = shares_apart(trace.force_N, reference.force_N)[:samples]
    sample, column = np.unravel_index(int(np.argmax(share)), share.shape)
    found = _in_contact(trace, share, int(sample), int(column))
    return replace(found, remark=static_load_remark(found.share, reference.force_N))


def first_deviation(trace: Trace, reference: Trace, level: float) -> Deviation | None:
    """Largest force difference at the first sample at which one exceeds a level; None if none does."""
    share = shares_apart(trace.force_N, reference.force_N)
    beyond = first_beyond(share, level)
    return _in_contact(trace, share, *beyond) if beyond else None


def _in_contact(trace: Trace, share: Array, sample: int, column: int) -> Deviation:
    return Deviation(float(share[sample, column]), float(trace.time_s[sample]), f"contact {column + 1}")


def shares_apart(force_N: Array, reference_N: Array, scale_N: float | None = None) -> Array:
    """|F - F_ref| over the largest change of F_ref; inf for NaN. All arrays have the shape (samples, contacts).

    Args:
        force_N: the forces.
        reference_N: the reference forces.
        scale_N: largest change, if the arrays hold only the first samples.
    """
    scale_N = scale_N or largest_change_N(reference_N)
    with np.errstate(invalid="ignore"):
        return np.nan_to_num(np.abs(force_N - reference_N) / scale_N, nan=np.inf)


def first_beyond(share: Array, level: float | Array) -> tuple[int, int] | None:
    """First sample at which any contact exceeds a level, and the column of the largest difference; None if none does.

    Args:
        share: differences of forces. Shape (samples, contacts).
        level: the level, one for all samples or of shape (samples,).
    """
    beyond = share.max(axis=1) > level
    if not beyond.any():
        return None
    sample = int(np.argmax(beyond))
    return sample, int(np.argmax(share[sample]))


def motion_scales(chain: Chain, trace: Trace) -> Array:
    """Largest kinetic energy and momentum of a motion, in J and N s, the scales of differences. Shape (2,).

    The momentum is at least the sum of m |v| at time 0, since bodies may meet head on; at rest, at least the impulse
    of the loads.
    """
    loads = abs(float(chain.load_N.sum())) * float(trace.time_s[-1]) if is_at_rest(trace.force_N) else 0.0
    momentum = max(float(np.abs(trace.momentum_N_s).max()), moving_at_start(chain), loads) or 1.0
    return np.array([largest_kinetic_J(chain, trace), momentum])


def motion_deviation(chain: Chain, trace: Trace, reference: Trace, samples: int | None = None) -> Deviation:
    """Largest difference of kinetic energy or momentum between traces with equal sample times."""
    found = np.array([trace.kinetic_energy_J, trace.momentum_N_s])[:, :samples]
    right = np.array([reference.kinetic_energy_J, reference.momentum_N_s])[:, :samples]
    shares = np.abs(found - right) / motion_scales(chain, reference)[:, None]
    which, sample = np.unravel_index(int(np.argmax(shares)), shares.shape)
    quantity = ("kinetic energy", "momentum")[int(which)]
    return Deviation(float(shares[which, sample]), float(trace.time_s[sample]), quantity)


@dataclass(frozen=True)
class Departure:
    """First time at which the deviation of a run exceeds a level.

    Attributes:
        time_s: time of that sample; NaN if there is none.
        contact: contact with the largest deviation; 0 if the deviation is not of a contact force, or there is none.
        share: deviation over the largest change (of energy or momentum: over its largest value).
        kind: ``none``, ``not known``, ``set-up``, ``model``, ``truncation``, ``rounding``, ``chaos``.
        words: sentence on the departure.
        later: departures beyond larger levels; empty for a faulty run.
    """

    time_s: float
    contact: int
    share: float
    kind: str
    words: str
    later: tuple["Departure", ...] = ()


def departure_of(stored: Mapping[str, Any]) -> Departure:
    """Departure from its fields as JSON values."""
    return Departure(**{**stored, "later": tuple(map(departure_of, stored["later"]))})


@dataclass(frozen=True)
class CheckedRun:
    """A run with its scheme and the exact motion, at their common samples.

    Attributes:
        scheme: trace of the engine's own scheme at the same step.
        exact_N: forces of the exact motion. Shape (samples, contacts).
    """

    engine: str
    baseline: Baseline
    run: Trace
    scheme: Trace
    exact_N: Array

    @property
    def samples(self) -> int:
        """Number of samples at which a fault can be distinguished from chaos."""
        return min(self.baseline.samples, len(self.exact_N))

    def place(self, sample: int, column: int) -> str:
        """Text with the time of a sample and its contact."""
        return f"at {self.run.time_s[sample] * 1e6:.6g} µs in contact {column + 1}"

    def departure(self, place: tuple[int, int], share: Array, kind: str, words: str) -> Departure:
        """Departure at a sample and column; ``share`` has the shape (samples, contacts)."""
        return Departure(float(self.run.time_s[place[0]]), place[1] + 1, float(share[place]), kind, words)

    def off(self, should_N: Array) -> Array:
        """Differences of the run's forces from expected ones, over the largest change. Shape (samples, contacts)."""
        return shares_apart(self.run.force_N, should_N, self.baseline.scale_N)


def departure(case: Case, engine: str, trace: Trace) -> Departure:
    """First departure of a run from the exact motion.

    Args:
        case: the case that was to be run.
        engine: its engine, whose scheme distinguishes truncation from faults.
        trace: trace of the run at the samples of the case; of a failed run possibly only the first ones.
    """
    baseline = baseline_of(case, engine)
    if baseline.why_unknown:
        return _nowhere(UNKNOWN, f"deviation from the exact motion {baseline.why_unknown}")
    try:
        with np.errstate(over="ignore", invalid="ignore"):  # too large a step blows up
            scheme, exact = baseline.scheme_of(engine), baseline.exact
            if not (np.isfinite(scheme.force_N).all() and np.isfinite(scheme.kinetic_energy_J).all()):
                raise ArithmeticError("velocity Verlet at this step blows up")
            run = until(trace, len(exact.time_s))
            samples = len(run.time_s)
            checked = CheckedRun(engine, baseline, run, until(scheme, samples), exact.force_N[:samples])
            if fault := first_fault(checked):
                return fault
            found = sorted([*_from_exact(checked), *_from_scheme(checked)], key=lambda each: each.time_s)
            share = np.abs(checked.run.force_N - checked.exact_N) / checked.baseline.scale_N
            sample, column = np.unravel_index(int(np.argmax(share)), share.shape)
            largest = f"largest error {share.max():.1e} {checked.place(int(sample), int(column))}"
            if not found:
                if engine == REFERENCE and not share.any():
                    return _nowhere(NONE, f"is the exact motion; {exactness_note(baseline)}")
                never = f"the error never exceeds {LEVELS[0]:g} of the largest change"
                same = f"; {largest}" if share.any() else ": identical bit for bit with the exact motion"
                own = f"; {exactness_note(baseline)}" if load_engine(engine).scheme == EXACT else ""
                return _nowhere(NONE, f"{never}{same}{own}")
            return replace(found[0], words=f"{found[0].words}; {largest}", later=tuple(found[1:]))
    except ArithmeticError as error:
        return _nowhere(UNKNOWN, f"deviation from the exact motion not measured: {error}")


def departure_rows(departures: Mapping[str, Departure]) -> list[tuple[str, Departure]]:
    """Rows of a table: for each engine the first departure, then those beyond larger levels."""
    return [(engine, each) for engine, first in departures.items() for each in (first, *first.later)]


def _nowhere(kind: str, words: str) -> Departure:
    return Departure(float("nan"), 0, float("nan"), kind, words)


def _from_exact(checked: CheckedRun) -> Iterator[Departure]:
    """Departures from the exact motion beyond each level, with the cause; of simultaneous ones the largest level."""
    baseline, share, own = (
        checked.baseline,
        checked.off(checked.exact_N),
        checked.off(checked.scheme.force_N).max(axis=1),
    )
    passed = {place: level for level in LEVELS if (place := first_beyond(share, level))}
    for place, level in passed.items():
        kind, why = MODEL, f"within the tolerance ({baseline.allowed.limit:g}: {baseline.allowed.reason})"
        if baseline.chaotic(place[0]):
            times = f"{baseline.growth(place[0]):.0e} times"
            kind, why = CHAOS, f"rounding errors have grown {times} since the wave reached the wall"
        elif own[place[0]] <= level / 2:
            kind, why = TRUNCATION, "as for velocity Verlet at this step"
        elif own[place[0]] <= baseline.rounding_bound[place[0]]:
            kind, why = ROUNDING, "heights are far from 0"
        words = f"the error exceeds {level:g} of the largest change {checked.place(*place)}: {kind}, {why}"
        yield checked.departure(place, share, kind, words)


def _from_scheme(checked: CheckedRun) -> Iterator[Departure]:
    """Departures from the scheme by rounding alone, beyond which two runs cannot be compared."""
    baseline, times_s = checked.baseline, checked.baseline.case.sample_times_s
    if load_engine(checked.engine).scheme == EXACT:
        return
    samples, plain_N = len(checked.exact_N), baseline.in_overlaps.force_N
    share = shares_apart(checked.run.force_N, plain_N[:samples], largest_change_N(plain_N))
    beyond = first_beyond(share, HORIZON)
    if baseline.samples < len(times_s) and beyond and baseline.chaotic(beyond[0]):
        words = (
            f"the deviation from velocity Verlet at the same step exceeds {HORIZON:g} of the largest change"
            f" {checked.place(*beyond)}: {CHAOS}, as for velocity Verlet with other rounding"
        )
        yield checked.departure(beyond, share, CHAOS, words)
    elif samples == len(plain_N) < len(times_s):
        time_s = float(times_s[samples])
        kind = CHAOS if baseline.chaotic(samples - 1) else ROUNDING
        words = (
            f"cannot be judged beyond {time_s * 1e6:.6g} µs: {kind}, rounding alone separates two runs by {HORIZON:g}"
        )
        yield Departure(time_s, 0, HORIZON, kind, words)


def first_fault(checked: CheckedRun) -> Departure | None:
    """First fault of a run; None if rounding explains its deviation from its scheme.

    Only samples at which faults can be distinguished from chaos are examined.
    """
    baseline, allowed = checked.baseline, checked.baseline.allowed.limit
    shares = checked.off(checked.scheme.force_N)
    beyond = first_beyond(shares[: checked.samples], allowed)
    wrong_start = _wrong_start(checked)
    if beyond is None:
        return wrong_start or _wrong_speeds(checked)
    # early samples have less rounding, so the fault shows sooner than ``beyond``
    explained = np.maximum(baseline.model_tolerance.limit, baseline.rounding_bound[: len(shares)])
    sample, column = first_beyond(shares, explained) or beyond
    if sample == 0:
        has, should = (float(each.force_N[0, column]) for each in (checked.run, checked.scheme))
        starts = f"wrong start: at time 0 contact {column + 1} has {has:.4g} N, in the scene {should:.4g} N"
        kind, words = SET_UP, f"{starts}: set-up, heights or the law of this contact"
    elif wrong_start:
        return wrong_start
    else:
        kind, why = _kind_and_why(checked, sample, column)
        scheme = load_engine(checked.engine).scheme
        words = (
            f"deviates from {'the exact motion' if scheme == EXACT else 'velocity Verlet at the same step'} by"
            f" {shares[sample, column]:.1e} of the largest change {checked.place(sample, column)}{why};"
            f" largest deviation {shares[: checked.samples].max():.1e}"
        )
    return checked.departure((sample, column), shares, kind, words)


def _wrong_start(checked: CheckedRun) -> Departure | None:
    """Fault of energy or momentum at time 0: bodies have other speeds or masses than in the scene."""
    run, scheme = checked.run, checked.scheme
    units = ("kinetic energy", "J", "kinetic_energy_J"), ("momentum", "N s", "momentum_N_s")
    for (name, unit, key), scale in zip(
        units, motion_scales(checked.baseline.case.chain, scheme).tolist(), strict=True
    ):
        has, should = (float(getattr(each, key)[0]) for each in (run, scheme))
        share = abs(has - should) / scale
        if not share <= START_SHARE:
            is_, is_to_be = (0.0 if abs(value) < START_SHARE * scale else value for value in (has, should))
            starts = f"at time 0 the {name} is {is_:.7g} {unit}, in the scene {is_to_be:.7g} {unit}"
            words = f"wrong start: {starts}: set-up, masses or speeds, or speeds of another time"
            return Departure(float(run.time_s[0]), 0, share, SET_UP, words)
    return None


def _wrong_speeds(checked: CheckedRun) -> Departure | None:
    """Fault of the kinetic energy with correct forces: velocities of another time, or wrong masses."""
    baseline, right_J = checked.baseline, checked.scheme.kinetic_energy_J
    scale = float(np.abs(right_J).max()) or 1.0
    share = np.abs(checked.run.kinetic_energy_J - right_J)[: checked.samples] / scale
    rounding_J = np.abs(baseline.rounded.kinetic_energy_J - baseline.plain.kinetic_energy_J)[: baseline.samples].max()
    allowed = max(ENERGY_FACTOR * baseline.allowed.limit, ROUNDING_MARGIN * float(rounding_J) / scale)
    beyond = share > allowed
    if not beyond.any():
        return None
    sample = int(np.argmax(beyond))
    time_s = float(checked.run.time_s[sample])
    words = f"kinetic energy deviates by {share[sample]:.1e} of its largest value at {time_s * 1e6:.6g} µs"
    words = f"{words}, with correct forces: model, velocities of another time; largest deviation {share.max():.1e}"
    return Departure(time_s, 0, float(share[sample]), MODEL, words)


def _kind_and_why(checked: CheckedRun, sample: int, column: int) -> tuple[str, str]:
    """Kind of a fault that does not show at time 0, and the end of its sentence."""
    stated, explained = checked.baseline.model_tolerance.limit, float(checked.baseline.rounding_bound[sample])
    still = max(STILL_SHARE * stated, explained)  # smaller changes are rounding
    force_N = checked.scheme.force_N
    change = np.abs(force_N[: sample + 1] - force_N[0]) / checked.baseline.scale_N
    if change[:, column].max() <= still:
        return SET_UP, ", before any wave arrives: set-up, no equilibrium at the start (gravity, loads, masses)"
    if change[:sample].max() <= still:
        why = "the striker, the law of this contact, or samples of another time"
        return SET_UP, f", at the first change of any force: set-up, {why}"
    most = max(explained, stated)
    return MODEL, f", in the wave: model, another step, law or mass; rounding explains up to {most:.0e}"
