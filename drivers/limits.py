"""Limits of a case: stable time steps, overlaps within the range of Hertz's law, what an engine can model.

A time step of velocity Verlet is tried over the whole run, or as much of it as seconds allow.

A step is stable if the total energy of the trial, which can only fall, rises by less than ``GAIN`` times the largest
kinetic energy of the resolved motion, whose step is far below 2 / omega of the overlaps that it reaches. With a drive
the kinetic energy must not rise by more than ``GAIN_DRIVEN`` times that of the resolved motion: the balance of energies
would not do, since a large step may shift the frequency of a mode onto that of the drive. A trial that is resolved
itself needs no other.

``two_over_omega`` assumes that all contacts have their largest stiffness at the same time. It only chooses where to
try: contacts that close one at a time, and only for a few steps, are stable at several times this step.
"""

from dataclasses import dataclass
from functools import lru_cache
from math import floor, log10

import numpy as np

from drivers.base.errors import InputError
from drivers.chain.case import Case
from drivers.chain.chain import Array, Chain, arrays_of, contact_stiffness, hertz_force, tube_arrays_of
from drivers.chain.schemes import endable
from drivers.engines import EXACT, engine_names, load_engine
from validation.reference.adaptive import MIN_TOLERANCE
from validation.reference.hertz_chain import Extremes, Flag
from validation.reference.tube import TOTAL, integrate_tube
from validation.reference.velocity_verlet import follow_verlet

ON_COMMAND = "--unsafe"
RESOLVED = 0.25  # largest step of a resolved motion, divided by 2 / omega
# energy gained by an unstable step / largest kinetic energy. Without a drive less than a doubling: over hundreds of
# impacts the energy wanders, and steps between those tried may double it. With a drive more: a small shift of a
# resonance changes the kinetic energy several times.
GAIN, GAIN_DRIVEN = 0.8, 4.0
REST_SHARE = 1e-6  # of the elastic energy at time 0: less kinetic energy is rest
# bodies times steps of a trial, and of all trials of a scan: some tenths of a second, with a drive some seconds
MAX_WORK, MAX_WORK_3D = 100_000_000, 5_000_000
SCAN_WORK, SCAN_WORK_3D = 10_000_000, 1_000_000
FINENESS, COARSE = 1.002, 1.05  # factors between the steps of a scan; windows of blow-up are narrow
MAX_HALVINGS = 64
SCANNED = 8.0  # largest step of a scan, divided by 2 / omega
EXACT_SHARE = 1e-2  # of an error: allowed error of the exact motion against which it is measured
MAX_TOLERANCE = 1e-6  # of the reference, whose own values count as exact


@dataclass(frozen=True)
class Trial:
    """Motion of a chain by velocity Verlet at one step.

    Attributes:
        step_s: time step.
        until_s: time until which the motion was followed.
        extremes: extreme values of the motion.
        two_over_omega_s: 2 / omega at the largest overlaps.
    """

    step_s: float
    until_s: float
    extremes: Extremes
    two_over_omega_s: float

    @property
    def resolved(self) -> bool:
        """True if the step resolves each contact of the motion."""
        finite = np.isfinite(self.extremes.kinetic_J)
        return bool(finite and self.step_s <= RESOLVED * self.two_over_omega_s)


@lru_cache(maxsize=8)
def trial(chain: Chain, duration_s: float, step_s: float, law: str = TOTAL) -> Trial:
    """Trial at a step over a duration, or over as much of it as ``MAX_WORK`` allows.

    ``law`` is the law of friction of three-dimensional chains.
    """
    straight = chain.straight
    affordable = (MAX_WORK if straight else MAX_WORK_3D) / chain.bodies
    steps = int(max(min(np.ceil(duration_s / step_s * (1 - 1e-12)), affordable), 1))

    def follow(stop: Flag) -> Extremes:
        if straight:
            return follow_verlet(arrays_of(chain), step_s, steps, stop)
        motion = integrate_tube(tube_arrays_of(chain), step_s, steps, 2, law, stop, extremes=True)
        assert motion.extremes is not None
        return motion.extremes

    with np.errstate(all="ignore"):  # too large a step blows up
        reached = endable(follow, work=steps * chain.bodies)
        return Trial(step_s, min(steps * step_s, duration_s), reached, two_over_omega(chain, reached, step_s))


@lru_cache(maxsize=8)
def resolved_trial(case: Case, law: str = TOTAL) -> Trial:
    """Trial at the first of the sample interval, its half, quarter and so on that resolves the motion.

    A drive may have another period than the samples: then the time step is the first.
    """
    step_s = case.scene.run.sample_interval if case.chain.drive is None else case.scene.time_step_s
    for halvings in range(MAX_HALVINGS):
        tried = trial(case.chain, case.duration_s, step_s / 2**halvings, law)
        if tried.resolved:
            break
    return tried


def why_unstable(case: Case, law: str = TOTAL) -> str:
    """Reason why the time step of a case is unstable, by a trial; empty if it is stable."""
    right, step_s = resolved_trial(case, law), case.scene.time_step_s
    if right.until_s < case.duration_s and step_s > SCANNED * right.two_over_omega_s:
        return f"takes too long: the step is {step_s / right.two_over_omega_s:.2g} times 2/omega of the motion"
    return "" if step_s <= right.step_s else _gained(case, right, step_s, law)


def _gained(case: Case, right: Trial, step_s: float, law: str) -> str:
    """Reason why a step is unstable in comparison with a resolved motion; empty if it is stable."""
    chain = case.chain
    tried = trial(chain, right.until_s, step_s, law)
    largest_J = max(right.extremes.kinetic_J, REST_SHARE * chain.resting_J) or 1e-300
    gained_J = tried.extremes.kinetic_J - largest_J if chain.drive else tried.extremes.risen_J
    if gained_J <= (GAIN_DRIVEN if chain.drive else GAIN) * largest_J or tried.resolved:
        return ""
    times = f"{gained_J / largest_J:.2g}" if np.isfinite(gained_J) else "infinitely many"
    return f"gains {times} times the kinetic energy of the motion{until_words(case, tried.until_s)}"


def until_words(case: Case, until_s: float) -> str:
    """End of a sentence on trials: the part of the run that they cover; empty if it is the whole run."""
    whole = until_s >= case.duration_s * (1 - 1e-9)
    return "" if whole else f" (tried until {until_s * 1e3:.4g} of {case.duration_s * 1e3:.4g} ms)"


def step_limit(case: Case, law: str = TOTAL) -> tuple[float, float | None, float]:
    """Limit of the time step of a case, by a scan, since stable and unstable steps alternate.

    The scan begins at a resolved step. Its steps are closer together where trials are cheap; where they are expensive,
    trials follow a part of the run.

    Returns:
        Largest stable step in s, below which all tried steps are stable, inf if no contact closes; the next step, which
        is unstable, None if the scan ended before; and the time in s until which the trials followed the motion.
    """
    chain = case.chain
    right = resolved_trial(case, law)
    guess_s = right.two_over_omega_s
    if not np.isfinite(guess_s):
        return np.inf, None, case.duration_s
    stable_s = RESOLVED * guess_s
    # the work of all trials is that of the first, divided by 1 - 1 / factor
    most = (SCAN_WORK if chain.straight else SCAN_WORK_3D) * stable_s / chain.bodies
    factor = min(max(1 / (1 - min(case.duration_s / most, 0.5)), FINENESS), COARSE)
    until_s = min(case.duration_s, most * (1 - 1 / factor))
    right = trial(chain, until_s, right.step_s, law)
    while _gained(case, right, stable_s, law):  # strong damping
        stable_s /= 2
    while stable_s * factor <= min(SCANNED * guess_s, until_s):
        if _gained(case, right, stable_s * factor, law):
            return stable_s, stable_s * factor, until_s
        stable_s *= factor
    return stable_s, None, until_s


def two_over_omega(chain: Chain, reached: Extremes, step_s: float) -> float:
    """Lower bound of 2 / omega in s with all contacts at the largest overlaps of a motion; inf if none closes.

    The highest frequency is at most that of the row sums of the stiffness matrix (Gershgorin). The codes use the
    closing speed of half a step before, ``M (x+ - 2 x + x-) / dt^2 = -K x - D (x - x-) / dt`` with the slope D of the
    dissipative force; the solution alternates in sign at ``4 M / dt^2 = K + 2 D / dt``, so damping counts as the
    stiffness ``2 D / dt``. A body that moves as prescribed is held.
    """
    inverse = 1 / chain.mass_kg
    if chain.drive is not None and chain.drive.prescribed:
        inverse[chain.drive.body] = 0.0
    deepest = reached.overlap_m
    spring = contact_stiffness(chain.stiffness, deepest)
    if chain.damped:
        slope = chain.law.slope(chain.damping, deepest, reached.speed_m_s)
        spring = spring + 2 / step_s * np.where(deepest > 0, slope, 0.0)
    rows = _rows(inverse, spring)
    if not chain.straight:
        # a shear spring moves bodies across the axis and turns them, with the inertia 2/5 m: 3.5 times a normal one
        in_bore = reached.bore_overlap_m
        sheared = (chain.friction > 0) * chain.shear_stiffness * np.sqrt(deepest)
        dragged = (chain.bore_friction > 0) * chain.bore_shear * np.sqrt(in_bore)
        across = 3.5 * _rows(inverse, sheared) + contact_stiffness(chain.bore_stiffness, in_bore) * inverse
        rows = np.maximum(rows, across) + 3.5 * dragged * inverse
    highest = float(rows.max())
    return float(2 / np.sqrt(highest)) if highest > 0 else np.inf


def _rows(inverse_kg: Array, spring_N_m: Array) -> Array:
    """Row sums of a chain of springs that bound its eigenvalues, in 1/s^2. Shape (bodies,)."""
    below = spring_N_m * np.append(0.0, np.sqrt(inverse_kg[1:] * inverse_kg[:-1]))
    return np.asarray((spring_N_m + np.append(spring_N_m[1:], 0.0)) * inverse_kg + below + np.append(below[1:], 0.0))


def needed_tolerance(case: Case) -> float:
    """Tolerance of the reference that determines the force error of a run to 1 %: a power of ten.

    At a step of x times 2 / omega, the force error of velocity Verlet is 0.25 x^2 times the largest change or more on
    all shipped scenes. Powers of ten let cases of similar steps share a run of the reference.
    """
    chain = case.chain
    if not chain.straight:  # no reference
        return MAX_TOLERANCE
    right = resolved_trial(case)
    force = hertz_force(chain.stiffness, right.extremes.overlap_m)
    change = float((force - chain.elastic_N).max() / (force.max() or 1.0))
    share = case.scene.time_step_s / right.two_over_omega_s
    return float(10.0 ** floor(log10(min(max(EXACT_SHARE * share**2 * change, MIN_TOLERANCE), MAX_TOLERANCE))))


def refuse(case: Case, engine: str, override: str = ON_COMMAND) -> None:
    """Refuse a case that would fail on an engine; ``override`` is the option that runs it anyway, for the message.

    Raises:
        InputError: the time step blows up in a trial; an overlap exceeds a radius; the engine cannot model the case; or
            the scene has an accuracy and no time step was planned for it.
    """
    if case.scene.run.accuracy is not None and case.plan is None:
        raise InputError(case.scene.file, "run.accuracy", "no time step is planned for it here; give run.time_step")
    if cannot := inability(case, engine):
        raise cannot
    interface = load_engine(engine)
    shear = TOTAL if case.chain.straight else interface.shear  # all engines share the trials of a straight chain
    refuse_depth(case, override, shear)
    if interface.scheme != EXACT and (problem := why_unstable(case, shear)):
        rounded_down_s = 0.995 * step_limit(case, shear)[0]
        allowed = f"at most {rounded_down_s:.3g} s; a trial {problem} ({override} runs it)"
        raise InputError(case.scene.file, "run.time_step", f"{case.scene.time_step_s:g} s", allowed)


def inability(case: Case, engine: str) -> InputError | None:
    """Error that says why an engine cannot model a case; None if the engine can."""
    interface, needed = load_engine(engine), case.reasons.keys()
    missing = [name for name in needed if name not in interface.models]
    if missing:
        able = ", ".join(name for name in engine_names() if load_engine(name).models >= needed)
        found = f'"{engine}" for a scene with {", ".join(missing)}'
        allowed = f"an engine that models it: {able}" if able else "none, since no engine models the scene"
        return InputError(case.scene.file, "", found, allowed)
    law = case.chain.law.name
    if case.chain.damped and law not in interface.dissipation:
        allowed = " or ".join(f'"{name}"' for name in sorted(interface.dissipation))
        return InputError(case.scene.file, "contact.dissipation", f'"{law}"', f"on {engine} {allowed}")
    if problem := interface.refusal(case):
        key, found, allowed = problem
        return InputError(case.scene.file, key, found, f"on {engine} {allowed}")
    return None


def refuse_depth(case: Case, override: str = ON_COMMAND, shear: str = TOTAL) -> None:
    """Refuse overlaps of contacts, or with the bore, of a radius or more.

    Raises:
        InputError: a motion that reaches them.
    """
    chain, reached = case.chain, resolved_trial(case, shear).extremes
    pressed = np.where(chain.stiffness > 0, reached.overlap_m / chain.smaller_radius_m, 0.0)  # there may be no wall
    for key, what, depth, where in (
        ("striker.speed" if case.scene.striker else "chain", "contact", pressed, ""),
        ("chain", "body", reached.bore_overlap_m / chain.radius_m, " into the bore"),
    ):
        if (depth >= 1).any():
            place = int(np.argmax(depth))
            found = f"a motion that presses {what} {place + 1} {depth[place]:.3g} radii deep{where}"
            allowed = f"overlaps below a radius, the range of Hertz's law ({override} runs it)"
            raise InputError(case.scene.file, key, found, allowed)
