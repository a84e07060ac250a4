"""When a run first leaves the exact motion, and why: a fault shows at once, truncation with the wave, chaos after it.

A run is held against two yardsticks, the exact motion and its own scheme at the same step. Leaves it the latter by
more than rounding, something is wrong: ``set-up`` where it does so before a wave comes, ``another step`` where the
scheme at another step explains it, else ``model``. Where it leaves the exact motion together with its scheme, that is
``truncation``; or ``chaos``, once the chain has multiplied whatever there was, as it has multiplied rounding alone.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np

from drivers.chain.case import Case
from drivers.chain.trace import Trace, until
from drivers.engines import EXACT, load_engine
from validation.accuracy.deviation import first_beyond, shares_apart
from validation.accuracy.rounding import HORIZON
from validation.compare.expected import Expected, expected_of, why_not_known
from validation.compare.first_fault import MODEL, first_fault

# of the largest force: where rounding ends comparisons, what good steps keep, what experiments could resolve
LEVELS = (HORIZON, 1e-4, 1e-2)
NONE, UNKNOWN = "none", "not known"
TRUNCATION, ROUNDING, CHAOS = "truncation", "rounding", "chaos"


@dataclass(frozen=True)
class Departure:
    """The first time that a run is away from where it should be by more than a level.

    Attributes:
        time_s: of that sample; NaN where there is none.
        contact: which is furthest off then; 0 where it is not a contact's force, or there is none.
        share: by how much, of the largest force (of energy or momentum at time 0: of its largest).
        kind: ``none``, ``not known``, ``set-up``, ``model``, ``another step``, ``truncation``, ``rounding``, ``chaos``.
        level: what was passed, likewise a share; NaN where there is none.
        words: all this in a sentence.
        later: when larger levels are passed, and why; empty of a run at fault.
    """

    time_s: float
    contact: int
    share: float
    kind: str
    level: float
    words: str
    later: tuple["Departure", ...] = ()


@dataclass(frozen=True)
class DepartureRow:
    """A line of a table."""

    engine: str
    words: str
    time_s: float
    kind: str


def departure(case: Case, engine: str, trace: Trace) -> Departure:
    """When and why a run of a case first leaves the exact motion; in words where that cannot be said.

    Args:
        case: what was to be run.
        engine: on which engine: its scheme tells truncation from faults.
        trace: what came out, at the case's samples; of a run that ended badly maybe only the first of them.
    """
    why = why_not_known(case)
    if why:
        return _nowhere(UNKNOWN, f"when it leaves the exact motion is {why}")
    try:
        with np.errstate(over="ignore", invalid="ignore"):  # too large a step blows up
            return _departure(case, engine, trace)
    except ArithmeticError as error:
        return _nowhere(UNKNOWN, f"when it leaves the exact motion is not measured: {error}")


def _departure(case: Case, engine: str, trace: Trace) -> Departure:
    followed = expected_of(case, engine)
    run = until(trace, len(followed.exact_N))
    expected = followed.until(len(run.time_s))
    fault = first_fault(case, engine, run, expected)
    if fault:
        time_s = float(run.time_s[fault.sample])
        return Departure(time_s, fault.contact, fault.share, fault.kind, fault.limit, fault.words)
    found = [*_from_exact(engine, run, expected), *_from_scheme(case, engine, run, followed)]
    found.sort(key=lambda each: each.time_s)
    share = np.abs(run.force_N - expected.exact_N) / expected.largest_N
    sample, column = np.unravel_index(int(np.argmax(share)), share.shape)
    furthest = f"it is furthest from it, {share.max():.1e}, {_place(float(run.time_s[sample]), int(column) + 1)}"
    if not found:
        never = f"never leaves the exact motion by {LEVELS[0]:g} of the largest force"
        return _nowhere(NONE, f"{never}; {furthest}" if share.any() else f"{never}: it is the same, bit for bit")
    return replace(found[0], words=f"{found[0].words}; {furthest}", later=tuple(found[1:]))


def departure_rows(departures: Mapping[str, Departure]) -> list[DepartureRow]:
    """Lines of a table: of each engine the first departure, then when larger levels are passed."""
    return [
        DepartureRow(engine, each.words, each.time_s, each.kind)
        for engine, first in departures.items()
        for each in (first, *first.later)
    ]


def _nowhere(kind: str, words: str) -> Departure:
    return Departure(float("nan"), 0, float("nan"), kind, float("nan"), words)


def _from_exact(engine: str, run: Trace, expected: Expected) -> Iterator[Departure]:
    """When a run passes each level; of several at one sample the largest."""
    share = shares_apart(run.force_N, expected.exact_N, expected.of_N)
    own = shares_apart(run.force_N, expected.scheme.force_N, expected.of_N).max(axis=1)
    passed = {place: level for level in LEVELS if (place := first_beyond(share, level))}
    for (sample, column), level in passed.items():
        kind, why = _why(engine, expected, sample, float(own[sample]), level)
        time_s = float(run.time_s[sample])
        words = f"leaves the exact motion by {level:g} of the largest force {_place(time_s, column + 1)}: {kind}, {why}"
        yield Departure(time_s, column + 1, float(share[sample, column]), kind, level, words)


def _why(engine: str, expected: Expected, sample: int, own: float, level: float) -> tuple[str, str]:
    """The kind of a departure from the exact motion and why, by how far the run is from its own scheme then."""
    if expected.chaotic(sample):
        times = f"{expected.multiplied(sample):.0e} times"
        return CHAOS, f"after reflections, which have multiplied what rounding alone does {times}"
    if own <= level / 2:
        return TRUNCATION, "velocity Verlet at this step does the same"
    if own <= expected.explained[sample]:
        return ROUNDING, "of heights so far from 0"
    return MODEL, f"within what is allowed ({expected.allowed.limit:g}: {expected.allowed.reason})"


def _from_scheme(case: Case, engine: str, run: Trace, expected: Expected) -> Iterator[Departure]:
    """When rounding alone has parted a run from its scheme: from then on two runs cannot be compared."""
    if load_engine(engine).scheme == EXACT:
        return
    share = shares_apart(run.force_N, expected.plain_N[: len(run.time_s)], float(np.abs(expected.plain_N).max()))
    beyond = first_beyond(share, HORIZON)
    if expected.samples < case.scene.samples and beyond and expected.chaotic(beyond[0]):
        sample, column = beyond
        time_s = float(run.time_s[sample])
        place = _place(time_s, column + 1)
        words = f"leaves velocity Verlet at the same step by {HORIZON:g} of the largest force {place}: {CHAOS},"
        words = f"{words} as a Verlet does that only rounds otherwise"
        yield Departure(time_s, column + 1, float(share[sample, column]), CHAOS, HORIZON, words)
    elif len(run.time_s) == len(expected.exact_N) < case.scene.samples:  # of three dimensions nothing beyond is known
        time_s = float(case.sample_times_s[len(run.time_s)])
        kind = CHAOS if expected.chaotic(len(run.time_s) - 1) else ROUNDING
        words = (
            f"cannot be followed from {time_s * 1e6:.6g} µs on: {kind}, rounding alone parts two runs by {HORIZON:g}"
        )
        yield Departure(time_s, 0, HORIZON, kind, HORIZON, words)


def _place(time_s: float, contact: int) -> str:
    return f"at {time_s * 1e6:.6g} µs in contact {contact}"
