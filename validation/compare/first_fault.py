"""Where a run first leaves its own scheme by more than rounding does, and what kind of fault shows like that."""

from dataclasses import dataclass

import numpy as np

from drivers.chain.case import Case
from drivers.chain.trace import Trace
from drivers.engines import EXACT, load_engine
from validation.accuracy.deviation import first_beyond, motion_scales, shares_apart
from validation.accuracy.rounding import ROUNDING_MARGIN
from validation.compare.expected import Expected, forces_of_scheme

SET_UP, MODEL, ANOTHER_STEP = "set-up", "model", "another step"
FAULTS = (SET_UP, MODEL, ANOTHER_STEP)
START = 1e-9  # of the largest energy and momentum: what runs may differ by at time 0; measured up to 3e-16
FITTED = 0.05  # of its difference from the scheme: what a run may differ from it at the step that is said to explain it
SPEEDS = 10.0  # times what forces may differ by: the energy goes with the velocity squared, 2.3 times measured
TRIALS = 5  # of other steps
MOST_WORK = 2e7  # bodies times steps of a scheme tried at another step


@dataclass(frozen=True)
class Fault:
    """The first sample at which a run is not what it should be.

    Attributes:
        contact: which contact is furthest off; 0 where it is not a contact's force.
        share: by how much, of the largest force (of energy or momentum: of its largest).
        limit: what was allowed.
        words: what shows, and what kinds of fault show like that.
    """

    sample: int
    contact: int
    share: float
    limit: float
    kind: str
    words: str


def first_fault(case: Case, engine: str, run: Trace, expected: Expected) -> Fault | None:
    """The first fault of a run; None where rounding explains all that it differs by from its scheme.

    Faults are only looked for as long as they can be told from chaos.
    """
    shares = shares_apart(run.force_N, expected.scheme.force_N, expected.of_N)
    beyond = first_beyond(shares[: expected.samples], expected.allowed.limit)
    wrong_start = _wrong_start(case, run, expected.scheme)
    if beyond is None:
        return wrong_start or _wrong_speeds(run, expected)
    # rounding explains less of it at first than in the end, so that the fault shows sooner than ``beyond``
    sample, column = first_beyond(shares, np.maximum(expected.stated.limit, expected.explained)) or beyond
    if sample == 0:
        kind, words = SET_UP, _wrong_force_at_start(run, expected.scheme, column)
    elif wrong_start:
        return wrong_start
    else:
        kind, why = _kind_and_why(case, engine, run, expected, sample, column)
        yardstick = "the exact motion" if load_engine(engine).scheme == EXACT else "velocity Verlet at the same step"
        words = (
            f"leaves {yardstick} by {shares[sample, column]:.1e} of the largest force at"
            f" {run.time_s[sample] * 1e6:.6g} µs in contact {column + 1}{why};"
            f" it is off by up to {shares[: expected.samples].max():.1e}"
        )
    return Fault(sample, column + 1, float(shares[sample, column]), expected.allowed.limit, kind, words)


def _wrong_force_at_start(run: Trace, scheme: Trace, column: int) -> str:
    has, should = (float(each.force_N[0, column]) for each in (run, scheme))
    starts = f"starts wrong: at time 0 contact {column + 1} bears {has:.4g} N, where the scene has {should:.4g} N"
    return f"{starts}: set-up, its heights or the law of that contact"


def _wrong_start(case: Case, run: Trace, scheme: Trace) -> Fault | None:
    """Energy or momentum that is not the scene's at time 0: bodies of other speeds or masses."""
    energy, momentum = (float(scale) for scale in motion_scales(case.chain, scheme))
    for name, unit, values, expected, scale in (
        ("kinetic energy", "J", run.kinetic_energy_J, scheme.kinetic_energy_J, energy),
        ("momentum", "N s", run.momentum_N_s, scheme.momentum_N_s, momentum),
    ):
        has, should = float(values[0]), float(expected[0])
        share = abs(has - should) / scale
        if not share <= START:
            told, wanted = (f"{0.0 if abs(value) < START * scale else value:.7g} {unit}" for value in (has, should))
            starts = f"starts wrong: at time 0 its {name} is {told}, where the scene has {wanted}"
            words = f"{starts}: set-up, masses or speeds, or speeds of another time"
            return Fault(0, 0, share, START, SET_UP, words)
    return None


def _wrong_speeds(run: Trace, expected: Expected) -> Fault | None:
    """Kinetic energy that is off where no force is: velocities of another time, or the masses of something else."""
    right_J = expected.scheme.kinetic_energy_J
    scale = float(np.abs(right_J).max()) or 1.0
    share = np.abs(run.kinetic_energy_J - right_J)[: expected.samples] / scale
    allowed = max(SPEEDS * expected.allowed.limit, ROUNDING_MARGIN * expected.rounding_J / scale)
    beyond = share > allowed
    if not beyond.any():
        return None
    sample = int(np.argmax(beyond))
    words = f"its kinetic energy is off by {share[sample]:.1e} of its largest at {run.time_s[sample] * 1e6:.6g} µs"
    words = f"{words}, while its forces are right: model, velocities of another time; up to {share.max():.1e}"
    return Fault(sample, 0, float(share[sample]), allowed, MODEL, words)


def _kind_and_why(case: Case, engine: str, run: Trace, expected: Expected, sample: int, column: int) -> tuple[str, str]:
    """The kind of a fault that does not show at time 0, and the end of its sentence."""
    other = _other_step(case, engine, run, expected)
    if other:
        return ANOTHER_STEP, f": another step, {other}"
    change = np.abs(expected.scheme.force_N[: sample + 1] - expected.scheme.force_N[0]) / expected.largest_N
    if change[:, column].max() <= expected.still(sample):
        return SET_UP, ", before any wave is there: set-up, it does not start in equilibrium (gravity, loads, masses)"
    if change[:sample].max() <= expected.still(sample):
        why = "what strikes there, the law of that contact, or samples of another time"
        return SET_UP, f", with the first force that changes: set-up, {why}"
    most = max(float(expected.explained[sample]), expected.stated.limit)
    return MODEL, f" while a wave passes: model, another law or mass; rounding explains up to {most:.0e}"


def _other_step(case: Case, engine: str, run: Trace, expected: Expected) -> str:
    """Which other step explains a run, in words; empty where none does.

    Until the wave turns, errors go with the step's power p: if the run's are c times those of a step h, its own is
    ``c^(1/p) h``. What is so found is tried, and found anew from there.
    """
    if load_engine(engine).scheme == EXACT:
        return ""
    n, end = case.scene.steps_per_sample, min(expected.turned + 1, expected.samples)
    error = run.force_N[:end] - expected.exact_N[:end]
    off = float(np.abs(run.force_N[:end] - expected.scheme.force_N[:end]).max())
    if off <= expected.allowed.limit * expected.largest_N:
        return ""  # a step shows from the start
    left, steps = {n: off}, n
    own = expected.scheme.force_N[:end] - expected.exact_N[:end]
    for _ in range(TRIALS):
        factor = float((error * own).sum() / (own * own).sum()) if own.any() else 0.0
        if not (np.isfinite(factor) and factor > 0):
            break
        guess = min(steps / factor ** (1 / expected.order), MOST_WORK)
        steps = max(1, round(guess))
        if steps in left or steps * case.scene.samples * case.chain.bodies > MOST_WORK:
            break
        force = forces_of_scheme(case.at(steps), engine)[:end]
        own = force - expected.exact_N[:end]
        left[steps] = float(np.abs(run.force_N[:end] - force).max())
    best = min(left, key=lambda each: left[each])
    if left[best] <= FITTED * off:
        same = f"to {left[best] / expected.largest_N:.0e}" if left[best] else "bit for bit"
        return f"velocity Verlet at {case.scene.run.sample_interval / best * 1e6:.4g} µs does the same {same}"
    furthest = float(np.abs(error).max())
    exact = f"a far smaller one: it follows the exact motion to {furthest / expected.largest_N:.0e}"
    return exact if furthest <= FITTED * off else ""
