"""When a run first leaves the exact motion, and why: a fault shows at once, truncation with the wave, chaos after it.

A run is held against the exact motion and against its own scheme at the same step. If it deviates from the latter by
more than rounding, something is wrong: ``set-up`` where it does so before a wave comes, else ``model``: ``diagnosis``
says which step, law or mass explains it. Where it leaves the exact motion together with its scheme, that is
``truncation``; or ``chaos``, once the chain has multiplied whatever there was, as it has multiplied rounding alone.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from drivers.chain.case import Case
from drivers.chain.chain import Array, Chain, moving_at_start
from drivers.chain.trace import Trace, until
from drivers.engines import EXACT, load_engine
from postproc.read.residual import beside, largest_change_N, largest_kinetic_J, still
from validation.accuracy.baseline import HORIZON, ROUNDING_MARGIN, Baseline, baseline_of
from validation.accuracy.budget import known_to

# of the largest change: where rounding ends comparisons, what good steps keep, what experiments could resolve
LEVELS = (HORIZON, 1e-4, 1e-2)
NONE, UNKNOWN = "none", "not known"
TRUNCATION, ROUNDING, CHAOS = "truncation", "rounding", "chaos"
SET_UP, MODEL = FAULTS = ("set-up", "model")
START_SHARE = 1e-9  # of the largest energy and momentum: what runs may differ by at time 0; measured up to 3e-16
STILL_SHARE = 1e-3  # of what is allowed: a contact whose force has changed by less has not felt the wave yet
ENERGY_FACTOR = 10.0  # times what forces may differ by: the energy goes with the velocity squared, 2.3 times measured


@dataclass(frozen=True)
class Deviation:
    """How far two traces are apart, and where.

    Attributes:
        share: of the forces, over the largest change of F_ref; of kinetic energy or momentum, over the
            largest.
        quantity: such as ``contact 3`` or ``momentum``.
        remark: the share of the largest force, where that is another.
    """

    share: float
    time_s: float
    quantity: str
    remark: str = ""

    @property
    def place(self) -> str:
        """Where that is, in words."""
        return f"{self.quantity} at {self.time_s * 1e6:g} µs{self.remark}"


def deviation(trace: Trace, reference: Trace, samples: int | None = None) -> Deviation:
    """The largest force difference from a reference, whose largest change is 1; all samples count by default.

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
    return replace(found, remark=beside(found.share, reference.force_N))


def first_deviation(trace: Trace, reference: Trace, level: float) -> Deviation | None:
    """The largest force difference at the first sample at which any is beyond a level; None where none is."""
    share = shares_apart(trace.force_N, reference.force_N)
    beyond = first_beyond(share, level)
    return _in_contact(trace, share, *beyond) if beyond else None


def _in_contact(trace: Trace, share: Array, sample: int, column: int) -> Deviation:
    return Deviation(float(share[sample, column]), float(trace.time_s[sample]), f"contact {column + 1}")


def shares_apart(force_N: Array, reference_N: Array, scale_N: float | None = None) -> Array:
    """|F - F_ref| over the largest change of F_ref; inf where there is no number. All of shape (samples, contacts).

    Args:
        force_N: the forces in question.
        reference_N: what they should be.
        scale_N: the largest change, where these are but the first samples.
    """
    scale_N = scale_N or largest_change_N(reference_N)
    with np.errstate(invalid="ignore"):
        return np.nan_to_num(np.abs(force_N - reference_N) / scale_N, nan=np.inf)


def first_beyond(share: Array, level: float | Array) -> tuple[int, int] | None:
    """The first sample at which any contact is beyond a level, and the column furthest off then; None where none is.

    Args:
        share: differences of forces. Shape (samples, contacts).
        level: in the same terms, for all samples or for each. Shape (samples,).
    """
    beyond = share.max(axis=1) > level
    if not beyond.any():
        return None
    sample = int(np.argmax(beyond))
    return sample, int(np.argmax(share[sample]))


def motion_scales(chain: Chain, trace: Trace) -> Array:
    """Largest kinetic energy and momentum of a motion, in J and N s, over which differences are counted. Shape (2,).

    The momentum is at least that of all bodies at time 0 without directions, since some meet head on, and the loads'
    impulse where nothing moves.
    """
    loads = abs(float(chain.load_N.sum())) * float(trace.time_s[-1]) if still(trace.force_N) else 0.0
    momentum = max(float(np.abs(trace.momentum_N_s).max()), moving_at_start(chain), loads) or 1.0
    return np.array([largest_kinetic_J(chain, trace), momentum])


def motion_deviation(chain: Chain, trace: Trace, reference: Trace, samples: int | None = None) -> Deviation:
    """The largest difference of kinetic energy and momentum between traces of equal sample times."""
    found = np.array([trace.kinetic_energy_J, trace.momentum_N_s])[:, :samples]
    right = np.array([reference.kinetic_energy_J, reference.momentum_N_s])[:, :samples]
    shares = np.abs(found - right) / motion_scales(chain, reference)[:, None]
    which, sample = np.unravel_index(int(np.argmax(shares)), shares.shape)
    quantity = ("kinetic energy", "momentum")[int(which)]
    return Deviation(float(shares[which, sample]), float(trace.time_s[sample]), quantity)


@dataclass(frozen=True)
class Departure:
    """The first time that a run is away from where it should be by more than a level.

    Attributes:
        time_s: of that sample; NaN where there is none.
        contact: which is furthest off then; 0 where it is not a contact's force, or there is none.
        share: by how much, of the largest change (of energy or momentum: of its largest).
        kind: ``none``, ``not known``, ``set-up``, ``model``, ``truncation``, ``rounding``, ``chaos``.
        words: all this in a sentence.
        later: when larger levels are passed, and why; empty of a run at fault.
    """

    time_s: float
    contact: int
    share: float
    kind: str
    words: str
    later: tuple["Departure", ...] = ()


def departure_of(stored: Mapping[str, Any]) -> Departure:
    """A departure from its fields, as JSON holds them."""
    return Departure(**{**stored, "later": tuple(map(departure_of, stored["later"]))})


@dataclass(frozen=True)
class HeldRun:
    """A run held against what it should be, at the samples that all have.

    Attributes:
        scheme: the engine's own scheme at the same step.
        exact_N: shape (samples, contacts).
    """

    engine: str
    baseline: Baseline
    run: Trace
    scheme: Trace
    exact_N: Array

    @property
    def samples(self) -> int:
        """For how many a fault can be told from chaos."""
        return min(self.baseline.samples, len(self.exact_N))

    def place(self, sample: int, column: int) -> str:
        """When and where that is, in words."""
        return f"at {self.run.time_s[sample] * 1e6:.6g} µs in contact {column + 1}"

    def departure(self, place: tuple[int, int], share: Array, kind: str, words: str) -> Departure:
        """A departure at a sample and in a contact's column. Shares of shape (samples, contacts)."""
        return Departure(float(self.run.time_s[place[0]]), place[1] + 1, float(share[place]), kind, words)

    def off(self, should_N: Array) -> Array:
        """Differences of the run's forces from others, of the largest change. Shape (samples, contacts)."""
        return shares_apart(self.run.force_N, should_N, self.baseline.scale_N)


def departure(case: Case, engine: str, trace: Trace) -> Departure:
    """When and why a run of a case first leaves the exact motion; in words where that cannot be said.

    Args:
        case: what was to be run.
        engine: on which engine: its scheme tells truncation from faults.
        trace: what came out, at the case's samples; of a run that ended badly maybe only the first of them.
    """
    baseline = baseline_of(case, engine)
    if baseline.unknown:
        return _nowhere(UNKNOWN, f"when it leaves the exact motion is {baseline.unknown}")
    try:
        with np.errstate(over="ignore", invalid="ignore"):  # too large a step blows up
            scheme, exact = baseline.scheme_of(engine), baseline.exact
            if not (np.isfinite(scheme.force_N).all() and np.isfinite(scheme.kinetic_energy_J).all()):
                raise ArithmeticError("velocity Verlet at this step blows up")
            run = until(trace, len(exact.time_s))
            samples = len(run.time_s)
            held = HeldRun(engine, baseline, run, until(scheme, samples), exact.force_N[:samples])
            if fault := first_fault(held):
                return fault
            found = sorted([*_from_exact(held), *_from_scheme(held)], key=lambda each: each.time_s)
            share = np.abs(held.run.force_N - held.exact_N) / held.baseline.scale_N
            sample, column = np.unravel_index(int(np.argmax(share)), share.shape)
            furthest = f"it is furthest from it, {share.max():.1e}, {held.place(int(sample), int(column))}"
            if not found:
                never = f"never leaves the exact motion by {LEVELS[0]:g} of the largest change"
                same = f"; {furthest}" if share.any() else ": it is the same, bit for bit"
                own = f"; {known_to(baseline)}" if load_engine(engine).scheme == EXACT else ""
                return _nowhere(NONE, f"{never}{same}{own}")
            return replace(found[0], words=f"{found[0].words}; {furthest}", later=tuple(found[1:]))
    except ArithmeticError as error:
        return _nowhere(UNKNOWN, f"when it leaves the exact motion is not measured: {error}")


def departure_rows(departures: Mapping[str, Departure]) -> list[tuple[str, Departure]]:
    """Lines of a table: of each engine the first departure, then when larger levels are passed."""
    return [(engine, each) for engine, first in departures.items() for each in (first, *first.later)]


def _nowhere(kind: str, words: str) -> Departure:
    return Departure(float("nan"), 0, float("nan"), kind, words)


def _from_exact(held: HeldRun) -> Iterator[Departure]:
    """When a run passes each level, and why, by how far it is from its own scheme; of several at once the largest."""
    baseline, share, own = held.baseline, held.off(held.exact_N), held.off(held.scheme.force_N).max(axis=1)
    passed = {place: level for level in LEVELS if (place := first_beyond(share, level))}
    for place, level in passed.items():
        kind, why = MODEL, f"within what is allowed ({baseline.allowed.limit:g}: {baseline.allowed.reason})"
        if baseline.chaotic(place[0]):
            times = f"{baseline.growth(place[0]):.0e} times"
            kind, why = CHAOS, f"after reflections, which have multiplied what rounding alone does {times}"
        elif own[place[0]] <= level / 2:
            kind, why = TRUNCATION, "velocity Verlet at this step does the same"
        elif own[place[0]] <= baseline.explained[place[0]]:
            kind, why = ROUNDING, "of heights so far from 0"
        words = f"leaves the exact motion by {level:g} of the largest change {held.place(*place)}: {kind}, {why}"
        yield held.departure(place, share, kind, words)


def _from_scheme(held: HeldRun) -> Iterator[Departure]:
    """When rounding alone has parted a run from its scheme: from then on two runs cannot be compared."""
    baseline, times_s = held.baseline, held.baseline.case.sample_times_s
    if load_engine(held.engine).scheme == EXACT:
        return
    samples, plain_N = len(held.exact_N), baseline.in_overlaps.force_N
    share = shares_apart(held.run.force_N, plain_N[:samples], largest_change_N(plain_N))
    beyond = first_beyond(share, HORIZON)
    if baseline.samples < len(times_s) and beyond and baseline.chaotic(beyond[0]):
        words = (
            f"leaves velocity Verlet at the same step by {HORIZON:g} of the largest change {held.place(*beyond)}:"
            f" {CHAOS}, as a Verlet does that only rounds otherwise"
        )
        yield held.departure(beyond, share, CHAOS, words)
    elif samples == len(plain_N) < len(times_s):  # nothing beyond is known
        time_s = float(times_s[samples])
        kind = CHAOS if baseline.chaotic(samples - 1) else ROUNDING
        words = (
            f"cannot be followed from {time_s * 1e6:.6g} µs on: {kind}, rounding alone parts two runs by {HORIZON:g}"
        )
        yield Departure(time_s, 0, HORIZON, kind, words)


def first_fault(held: HeldRun) -> Departure | None:
    """The first fault of a run; None where rounding explains all that it differs by from its scheme.

    Faults are only looked for as long as they can be told from chaos.
    """
    baseline, allowed = held.baseline, held.baseline.allowed.limit
    shares = held.off(held.scheme.force_N)
    beyond = first_beyond(shares[: held.samples], allowed)
    wrong_start = _wrong_start(held)
    if beyond is None:
        return wrong_start or _wrong_speeds(held)
    # rounding explains less of it at first than in the end, so that the fault shows sooner than ``beyond``
    explained = np.maximum(baseline.stated.limit, baseline.explained[: len(shares)])
    sample, column = first_beyond(shares, explained) or beyond
    if sample == 0:
        has, should = (float(each.force_N[0, column]) for each in (held.run, held.scheme))
        starts = f"starts wrong: at time 0 contact {column + 1} bears {has:.4g} N, where the scene has {should:.4g} N"
        kind, words = SET_UP, f"{starts}: set-up, its heights or the law of that contact"
    elif wrong_start:
        return wrong_start
    else:
        kind, why = _kind_and_why(held, sample, column)
        scheme = load_engine(held.engine).scheme
        words = (
            f"leaves {'the exact motion' if scheme == EXACT else 'velocity Verlet at the same step'} by"
            f" {shares[sample, column]:.1e} of the largest change {held.place(sample, column)}{why};"
            f" it is off by up to {shares[: held.samples].max():.1e}"
        )
    return held.departure((sample, column), shares, kind, words)


def _wrong_start(held: HeldRun) -> Departure | None:
    """Energy or momentum that is not the scene's at time 0: bodies of other speeds or masses."""
    run, scheme = held.run, held.scheme
    units = ("kinetic energy", "J", "kinetic_energy_J"), ("momentum", "N s", "momentum_N_s")
    for (name, unit, key), scale in zip(units, motion_scales(held.baseline.case.chain, scheme).tolist(), strict=True):
        has, should = (float(getattr(each, key)[0]) for each in (run, scheme))
        share = abs(has - should) / scale
        if not share <= START_SHARE:
            is_, is_to_be = (0.0 if abs(value) < START_SHARE * scale else value for value in (has, should))
            starts = f"at time 0 its {name} is {is_:.7g} {unit}, where the scene has {is_to_be:.7g} {unit}"
            words = f"starts wrong: {starts}: set-up, masses or speeds, or speeds of another time"
            return Departure(float(run.time_s[0]), 0, share, SET_UP, words)
    return None


def _wrong_speeds(held: HeldRun) -> Departure | None:
    """Kinetic energy that is off where no force is: velocities of another time, or the masses of something else."""
    baseline, right_J = held.baseline, held.scheme.kinetic_energy_J
    scale = float(np.abs(right_J).max()) or 1.0
    share = np.abs(held.run.kinetic_energy_J - right_J)[: held.samples] / scale
    rounding_J = np.abs(baseline.rounded.kinetic_energy_J - baseline.plain.kinetic_energy_J)[: baseline.samples].max()
    allowed = max(ENERGY_FACTOR * baseline.allowed.limit, ROUNDING_MARGIN * float(rounding_J) / scale)
    beyond = share > allowed
    if not beyond.any():
        return None
    sample = int(np.argmax(beyond))
    time_s = float(held.run.time_s[sample])
    words = f"its kinetic energy is off by {share[sample]:.1e} of its largest at {time_s * 1e6:.6g} µs"
    words = f"{words}, while its forces are right: model, velocities of another time; up to {share.max():.1e}"
    return Departure(time_s, 0, float(share[sample]), MODEL, words)


def _kind_and_why(held: HeldRun, sample: int, column: int) -> tuple[str, str]:
    """The kind of a fault that does not show at time 0, and the end of its sentence."""
    stated, explained = held.baseline.stated.limit, float(held.baseline.explained[sample])
    still = max(STILL_SHARE * stated, explained)  # what changes by less has felt nothing but rounding
    force_N = held.scheme.force_N
    change = np.abs(force_N[: sample + 1] - force_N[0]) / held.baseline.scale_N
    if change[:, column].max() <= still:
        return SET_UP, ", before any wave is there: set-up, it does not start in equilibrium (gravity, loads, masses)"
    if change[:sample].max() <= still:
        why = "what strikes there, the law of that contact, or samples of another time"
        return SET_UP, f", with the first force that changes: set-up, {why}"
    most = max(explained, stated)
    return MODEL, f" while a wave passes: model, another step, law or mass; rounding explains up to {most:.0e}"
