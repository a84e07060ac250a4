"""The exact reference: an adaptive method of order 8, and for loose tolerances a symplectic one of order 4.

The state consists of overlaps and velocities, which avoids cancellation. State and time are compensated for rounding
(Kahan). Steps are those of ``dop853``, in ``s = (t - t_e)^(1/power)`` after the last event t_e, with power 2 for
elastic and power 4 for dissipative chains. If events are located, a step ends at each of them: a contact closes, opens
or, if dissipative, releases (its force reaches zero before the overlap does). A step that ends in an elastic opening
runs in ``s = (t_e - t)^(1/2)``. With the power law (``adaptive_kernels``) a step also ends where the closing speed of a
contact changes sign, and runs in ``s = (t_e - t)^(1/4)``. In rough motions, and with the power law above some
tolerance, events are not located: short steps lead through them.
"""

from functools import partial
from math import ceil, floor, log2, sqrt

import numpy as np

from validation.reference.hertz_chain import (
    COLUMNS,
    ENERGY_SHARE,
    EXPONENT,
    LEAST_WINDOWED,
    NEVER,
    SAME_TIME,
    Array,
    Drive,
    Flag,
    HertzChain,
    Motion,
    columns_of_sums,
    contact_force,
    hertz_energy_beyond_tangent,
    hertz_force,
    motion_of,
    wave,
)

MIN_TOLERANCE = 1e-12  # attainable in double precision with a margin: the smallest measured errors are near 1e-14
ROUNDED_TOLERANCE = 10 * MIN_TOLERANCE  # below, rounding errors are of the size of the tolerance
ROUNDED_SHARE = 0.002  # local divided by requested tolerance there
LEAST_LOCAL = 6e-15  # elsewhere, more than at the tightest tolerance, so that a difference from it tells the error
FIRST_STEP = 1e-3  # share of the time scale
PROBE = 1e-5  # tolerance for which two rough motions are cheap, and fine enough to tell how errors grow
ROUGH = 10.0  # local tolerance of the first, divided by this tolerance
ROUGH_WINDOWED = 1e-8  # that of the first in a window, which errors of looser ones widen
FINER = 0.01  # local tolerance of the second, divided by that of the first
LINEAR = 0.01  # larger differences of the two say nothing on smaller errors
PROBED_SAMPLES = 100
# Measured on the shipped scenes and 200 random ones, by powers of the local tolerance: errors of short steps through
# events fall by a power of 0.8, of 0.6 to 1.1 for nine of ten scenes, and scatter by a factor of 10. Where events are
# located, they fall in proportion if the powers of s suit the damping, and with the power law by a power of 0.9.
ORDER, POWER_LAW_ORDER = 0.75, 0.85
AIM = 0.15  # of the tolerance, for an error that is larger than expected in one scene of 150
SMOOTH_AIM = 0.075  # of errors in proportion to the local tolerance
LEAST_FREE = 1e-9  # local tolerance below which also the power law's events are located, which takes longer above it
LEAST_ROUGH = 1e-10  # local tolerance of the last rough motion
LEAST_SYMPLECTIC = 1e-6  # tolerance from which on the symplectic method costs less
LONGEST_STEP = 0.15  # of the symplectic method, in units of the time in which the scale of overlap is passed
MOST_STEPS = 8  # divided by those of the longest step; with more, the adaptive method costs less
SAME_INTERVAL = 1e-9  # of the duration
SCALE_TIMES = 2001  # times at which a drive is looked at, for scales of errors only


def integrate_adaptive(
    chain: HertzChain,
    time_s: Array,
    tolerance: float = MIN_TOLERANCE,
    stop: Flag = NEVER,
    *,
    energies: bool = False,
) -> Motion:
    """Integrates from time 0 and samples the motion at ``time_s``, which begins at 0.

    The work of a drive, and with ``energies`` those of the contacts and bodies, are components of the state.

    The largest force error over all contacts and samples, divided by the largest force, stays below ``tolerance``: of
    200 random chains it is above in one of 150, by up to a factor of 10, and mostly it is 1/50 to 1/5 of it.
    How the motion amplifies local errors is measured by two rough motions, whose difference tells the local tolerance.
    Below ``ROUNDED_TOLERANCE`` nothing is measured. A chain that bounces for long is chaotic; ``error`` of
    ``validation.accuracy.motions`` measures the remaining error.

    Raises:
        ValueError: sample times do not begin at 0 or do not increase; the tolerance is below ``MIN_TOLERANCE`` or not
            below 1.
        ArithmeticError: the step size becomes too small.
    """
    time_s = np.ascontiguousarray(time_s, dtype=float)
    increasing = time_s.ndim == 1 and time_s.size and time_s[0] == 0 and (np.diff(time_s) > 0).all()
    if not increasing or not np.isfinite(time_s[-1]):
        raise ValueError("time_s: expected increasing, finite times that begin at 0")
    if not MIN_TOLERANCE <= tolerance < 1:
        raise ValueError(f"tolerance: {tolerance:g}, expected from {MIN_TOLERANCE:g} to below 1")
    magnitudes = scales(chain, float(time_s[-1]))
    integrate = partial(_states, chain, magnitudes, stop=stop)
    if tolerance < ROUNDED_TOLERANCE:
        states = integrate(time_s, ROUNDED_SHARE * tolerance, located=True, energies=energies)
        return _motion(chain, time_s, states, energies=energies)
    if tolerance >= LEAST_SYMPLECTIC and not energies:
        motion = _symplectic_motion(chain, time_s, tolerance, magnitudes, stop)
        if motion is not None:
            return motion
    every = max(time_s.size // PROBED_SAMPLES, 1)
    windowed = chain.mass_kg.size >= LEAST_WINDOWED and not columns_of_sums(chain, energies=energies)
    few, probed, error = time_s[::every].copy(), 0.0, 1.0
    local = min(ROUGH * max(tolerance, PROBE), ROUGH_WINDOWED if windowed else 1.0)
    forces_N = _forces(chain, integrate(few, local))
    while error > LINEAR and local > LEAST_ROUGH:
        probed, local, rough_N = local, FINER * local, forces_N
        states = integrate(time_s, local, energies=energies) if tolerance >= PROBE else integrate(few, local)
        forces_N = _forces(chain, states[::every] if tolerance >= PROBE else states)
        error = float(np.abs(forces_N - rough_N).max() / (np.abs(forces_N).max() or 1.0))
    if tolerance < PROBE or error * FINER**ORDER > 2 * AIM * tolerance:
        less, located = min(AIM * tolerance / error, 1.0) if error else 1.0, True
        local = probed * less ** (1 / ORDER)
        if not chain.alpha and (4 * chain.overlap_power).is_integer():
            local = probed * less * SMOOTH_AIM / AIM
        elif local < LEAST_FREE:
            local = probed * less ** (1 / POWER_LAW_ORDER)
        else:
            located = False
        states = integrate(time_s, max(local, LEAST_LOCAL), located=located, energies=energies)
    return _motion(chain, time_s, states, energies=energies)


def _symplectic_motion(
    chain: HertzChain, time_s: Array, tolerance: float, magnitudes: tuple[float, float], stop: Flag
) -> Motion | None:
    """Motion by the symplectic method, at steps that are halved until forces change little enough.

    Half the step takes off at least half the error, also where contacts open and close; mostly 3/4 to 15/16.

    None for other than short, elastic, free chains with samples at equal intervals, or as soon as it shows that too
    many steps are needed.
    """
    from validation.reference.symplectic import integrate_symplectic

    n, samples, duration_s = chain.mass_kg.size, time_s.size, float(time_s[-1])
    suits = chain.elastic and chain.drive is None and n < LEAST_WINDOWED and samples > 1
    if not suits or np.ptp(np.diff(time_s)) > SAME_INTERVAL * duration_s:
        return None
    interval_s, longest_s = duration_s / (samples - 1), LONGEST_STEP * magnitudes[0] / magnitudes[1]
    # samples per step and steps per sample, one of which is 1
    every, steps = 2 ** max(floor(log2(longest_s / interval_s)), 0), ceil(interval_s / longest_s)
    rough, most, needed_s = 1, MOST_STEPS * steps, longest_s
    rough_N = np.full((1, n), np.inf)
    while steps <= most and needed_s >= longest_s / MOST_STEPS and not stop[0]:
        taken = (samples - 1) // every + 1
        overlap, velocity = integrate_symplectic(chain, every * interval_s / steps, steps, taken, stop)
        force_N = hertz_force(chain.stiffness, overlap)
        change_N = np.abs(force_N[::rough][: len(rough_N)] - rough_N).max()
        if every == 1 and not stop[0] and change_N <= tolerance * force_N.max():
            return motion_of(chain, time_s, force_N, overlap, velocity, np.empty((samples, 0)))
        if 0 < change_N < np.inf:  # the change by half a step falls as the fourth power of the step, at best
            needed_s = every * interval_s / steps * (tolerance * force_N.max() / change_N) ** 0.25
        rough_N, rough = force_N, min(every, 2)
        every, steps = max(every // 2, 1), steps if every > 1 else 2 * steps
    return None


def _forces(chain: HertzChain, states: Array) -> Array:
    n = chain.mass_kg.size
    return contact_force(chain, states[:, :n], states[:, n : 2 * n])


def _motion(chain: HertzChain, time_s: Array, states: Array, *, energies: bool) -> Motion:
    n, drive = chain.mass_kg.size, chain.drive
    overlap, velocity, sums = states[:, :n], states[:, n : 2 * n].copy(), states[:, 2 * n :]
    if drive is not None and drive.prescribed:
        velocity[:, drive.body] = drive.at(time_s)[1]  # after a kink
    if energies:  # of the work (F - F(0)) d' the rest is elastic
        stored = hertz_energy_beyond_tangent(chain.stiffness, chain.overlap_m, overlap - chain.overlap_m)
        sums[:, 2 : 2 + n] = 0.0 if chain.elastic else sums[:, 2 : 2 + n] - stored
    return motion_of(chain, time_s, contact_force(chain, overlap, velocity), overlap, velocity, sums)


def _states(
    chain: HertzChain, magnitudes: tuple[float, float], time_s: Array, local: float, *, located: bool = False,
    stop: Flag, energies: bool = False,
) -> Array:  # fmt: skip
    """States as ``fill_states`` fills them, at a local tolerance; from kink to kink of a drive.

    Raises:
        ArithmeticError: the step size becomes too small.
    """
    from validation.reference import dop853 as table
    from validation.reference.adaptive_kernels import fill_states

    n, drive, sums = chain.mass_kg.size, chain.drive, np.zeros(columns_of_sums(chain, energies=energies))
    first_s = FIRST_STEP * magnitudes[0] / magnitudes[1]
    states = np.empty((time_s.size, 2 * n + sums.size))
    states[0] = np.concatenate([chain.overlap_m, chain.velocity_m_s, sums])
    bodies = np.zeros((table.STATIC + 1, n + 1))
    acceleration = chain.load_N / chain.mass_kg
    bodies[table.STIFFNESS, :n], bodies[table.DAMPING, :n] = chain.stiffness, chain.damping
    bodies[table.INVERSE_MASS, :n], bodies[table.ACCELERATION, :n] = 1.0 / chain.mass_kg, acceleration
    bodies[table.STATIC, :n] = hertz_force(chain.stiffness, chain.overlap_m)
    kind = table.POWER_LAW if chain.alpha else table.ELASTIC if chain.elastic else table.DAMPED
    law = table.KernelLaw(kind, float(chain.alpha or chain.overlap_power), False, 0, False, 0.0, 0.0, 0.0)

    def fill(part: Array, times: Array, driven: Array, step_s: float) -> None:
        done = fill_states(part, times, bodies, driven, law, located, local, magnitudes, step_s, stop)
        if not done or not np.isfinite(part).all():
            raise ArithmeticError("the adaptive reference cannot integrate this motion: its steps become too small")

    if drive is None:
        fill(states, time_s, np.zeros(COLUMNS + 2), first_s)
        return states
    load_N, constant = float(chain.load_N[drive.body]), float(acceleration[drive.body])
    law = law._replace(driven=True, body=drive.body, prescribed=drive.prescribed, constant=constant, load=load_N)
    if drive.prescribed:
        bodies[table.INVERSE_MASS, drive.body] = 0.0
    start = states[0]
    begins = drive.segments[drive.segments[:, 0] * SAME_TIME < time_s[-1], 0]
    for segment, begin, end in zip(drive.segments, begins, [*begins[1:], time_s[-1]], strict=False):
        first, beyond = np.searchsorted(time_s, np.array([begin, end]) * SAME_TIME, side="right")
        times = np.concatenate([[0.0], time_s[first:beyond] - begin])  # the time of each part begins at 0
        if times[-1] < end - begin:
            times = np.append(times, end - begin)
        part = np.empty((times.size, start.size))
        part[0] = start
        if drive.prescribed:
            part[0, n + drive.body] = wave(segment, 0.0)[1]
        fill(part, times, np.append(segment, [0.0, 0.0]), min(first_s, end - begin))
        states[first:beyond], start = part[1 : 1 + beyond - first], part[-1]
    return states


def scales(chain: HertzChain, duration_s: float) -> tuple[float, float]:
    """Scales of overlap and speed for errors: the values that the available energy can produce.

    This energy is the kinetic and elastic energy at time 0, the work of the loads while gaps close, and the work of a
    drive.
    """
    energy = 0.5 * float(chain.mass_kg @ chain.velocity_m_s**2)
    energy += ENERGY_SHARE * float(chain.stiffness @ np.maximum(chain.overlap_m, 0.0) ** (1 + EXPONENT))
    fallen = np.minimum(
        np.cumsum(np.maximum(-chain.overlap_m, 0.0)), np.abs(chain.load_N) / chain.mass_kg * duration_s**2
    )
    energy += float(np.abs(chain.load_N) @ fallen)
    if chain.drive is not None:
        energy += _typical_work(chain, chain.drive, duration_s)
    if energy == 0.0:  # all bodies are at rest, or all fall together
        energy = float((chain.load_N**2 / chain.mass_kg).sum()) * duration_s**2 or 1e-300
    stiffest = float(chain.stiffness.max()) or 1.0
    return ((1 + EXPONENT) * energy / stiffest) ** ENERGY_SHARE, sqrt(2.0 * energy / float(chain.mass_kg.max()))


def _typical_work(chain: HertzChain, drive: Drive, duration_s: float) -> float:
    """Energy in J that a drive gives to its body, by its largest value and speed: no bound, but a scale.

    A force F moves a free body by its impulse, and a body held by the stiffest contact by an overlap with the force F.
    """
    times = np.linspace(0.0, duration_s, SCALE_TIMES)
    value, rate, _ = drive.at(times)
    largest, mass, stiffest = float(np.abs(value).max()), float(chain.mass_kg[drive.body]), float(chain.stiffness.max())
    if drive.prescribed:
        return float(0.5 * mass * (rate**2).max() + ENERGY_SHARE * stiffest * largest ** (1 + EXPONENT))
    free = float(np.trapezoid(np.abs(value), times)) ** 2 / (2 * mass)
    held = largest * (largest / stiffest) ** (1 / EXPONENT) if stiffest else free
    return float(min(free, held))
