"""Collisions, reflections and trains of waves: forces relative to the first wave that passes a contact.

A measure reads maxima of contact forces from a run; its theory reads the same maxima from scipy's DOP853, which shares
no code with the engines and the in-repo integrators. In units of the first bead's mass, a stiffness and a time, bodies
from the wall upwards, velocities downwards:

    overlap_j' = v_j - v_(j-1),   m_j v_j' = F_(j+1) - F_j,   F_j = k_j max(overlap_j, 0)^(3/2)
"""

from functools import cache
from math import sqrt

import numpy as np
from scipy.integrate import solve_ivp
from scipy.interpolate import CubicSpline

from drivers.chain.case import Case
from drivers.chain.chain import Array, Chain, hertz_force
from drivers.chain.trace import Trace
from postproc.read.signals import first_peak, peak_in, peaks
from validation.reference.travelling_wave import solve_travelling_wave

TOLERANCE = 1e-10  # relative, per step: errors of forces up to 1e-8 of the largest
SAMPLES_PER_UNIT = 16  # a solitary wave passes in four units; peaks of quintic splines have errors of 1e-8
REACH = 10.0  # beads from the peak of an exact wave; beyond, the force is below rounding
COLLISION = {
    "middle_share": "largest force where the waves meet, divided by that of one wave",
    "outgoing_share": "peak of the outgoing wave divided by that of the incoming wave",
    "secondary_share": "peak of the secondary wave divided by that of the incoming wave",
    "asymmetry": "largest difference of forces in mirrored contacts, divided by the peak of the wave",
    "momentum_share": "largest momentum of the chain, divided by the initial momentum of either half",
}
WALL = {
    "wall_peak_over_incident": "largest force on the wall divided by that of the incoming wave",
    "reflected_over_incident": "force of the reflected wave divided by that of the incoming wave",
}
TRAIN = {
    f"wave_{number}_over_first": f"force of the {word} wave divided by that of the first, 30 contacts below the striker"
    for number, word in enumerate(("second", "third", "fourth", "fifth"), start=2)
}


def forces(mass: Array, stiffness: Array, overlap: Array, velocity_down: Array, duration: float) -> tuple[Array, Array]:
    """Times and contact forces, shape (samples, bodies), of a chain without loads.

    Raises:
        ArithmeticError: scipy does not converge.
    """
    bodies = len(mass)
    above = np.zeros(bodies)
    rate = np.empty(2 * bodies)

    def force_of(overlaps: Array) -> Array:
        closed = np.maximum(overlaps, 0.0)
        return np.asarray(stiffness * closed * np.sqrt(closed))

    def rates(_: float, state: Array) -> Array:
        force, velocity = force_of(state[:bodies]), state[bodies:]
        rate[:bodies] = velocity
        rate[1:bodies] -= velocity[:-1]
        above[:-1] = force[1:]
        rate[bodies:] = (above - force) / mass
        return rate.copy()

    time = np.linspace(0.0, duration, int(SAMPLES_PER_UNIT * duration) + 2)
    start = np.concatenate([overlap, velocity_down])
    solution = solve_ivp(rates, (0.0, duration), start, "DOP853", time, rtol=TOLERANCE, atol=TOLERANCE)
    if not solution.success:
        raise ArithmeticError(f"scipy's DOP853: {solution.message}")
    return time, force_of(solution.y[:bodies].T)


def forces_of(chain: Chain, duration_s: float) -> tuple[Array, Array]:
    """Times and contact forces of a chain of this project, in s and N.

    Raises:
        ArithmeticError: scipy does not converge.
        ValueError: the chain has loads, damping or lateral motion.
    """
    if chain.load_N.any() or chain.damped or not chain.straight:
        raise ValueError("a chain with loads, damping or sideways motion")
    mass, stiffness = float(chain.mass_kg[0]), float(chain.stiffness.max())
    speed = float(np.abs(chain.velocity_m_s).max())
    length = (mass * speed**2 / stiffness) ** 0.4  # unit of length in which mass, stiffness and speed are 1
    time, force = forces(
        chain.mass_kg / mass,
        chain.stiffness / stiffness,
        chain.overlap_m / length,
        -chain.velocity_m_s / speed,
        duration_s * speed / length,
    )
    return time * length / speed, hertz_force(force * stiffness, length)


@cache
def led_to_wall(beads: int, start: float, wall_stiffness: float, duration: float) -> tuple[Array, Array]:
    """Times and contact forces, shape (samples, beads), of an exact solitary wave that runs into a wall.

    Masses and stiffnesses are 1; in these units the wave's speed is 1 bead per unit of time.

    Args:
        beads: number of beads, counted from 1 at the wall; contact j lies half a bead below bead j.
        start: place of the peak at time 0, in beads.
        wall_stiffness: stiffness of contact 1 divided by that of the others.
        duration: distance that the wave travels, in beads.
    """
    wave, place = solve_travelling_wave(), np.arange(1.0, beads + 1) - start

    def at(values: Array, places: Array) -> Array:
        return np.where(np.abs(places) <= REACH, CubicSpline(wave.place, values)(places), 0.0)

    stiffness = np.ones(beads)
    stiffness[0] = wall_stiffness
    overlap = np.cbrt(np.maximum(at(wave.force, place - 0.5), 0.0)) ** 2
    return forces(np.ones(beads), stiffness, overlap, at(wave.velocity, place), duration)


# Two equal solitary waves meet head on in the middle of a free chain: at a contact if the number of beads is even, at a
# bead if it is odd. Each half moves as if its wave ran into a wall: at a contact into one of stiffness 2 sqrt(2) k, as
# the overlap with the wall is half of that between the beads; at a bead, which stays at rest, into one of stiffness k.
# Behind each outgoing wave follows a weak secondary wave, stronger from a contact than from a bead (Santibanez, Munoz,
# Caussarieu, Job and Melo, Phys. Rev. E 84, 026604, 2011). Its final share of the wave is 0.0299 or 0.0085, reached 30
# contacts from the middle (0.0244 and 0.0064 after 5 contacts, 0.0267 and 0.0070 after 10, 0.0298 and 0.0084 after 20).
FAR_CONTACT = 40  # contacts above the middle; from 30 on the secondary wave changes by less than 1e-4
WEAKEST_SHARE = 1e-3  # prominence of a wave divided by the first one; the weakest secondary wave is 8.5e-3 of the wave
HALF_BEADS = 120
HALF_START = FAR_CONTACT + 20.5  # bead of the half chain at which the exact wave starts
LAST = 165.0  # beads that the wave travels until the secondary wave has passed


def collision(case: Case, trace: Trace) -> dict[str, float]:
    """Peaks in the middle and ``FAR_CONTACT`` contacts above, divided by the incoming wave there."""
    chain, force = case.chain, trace.force_N
    middle = (chain.beads + 1) // 2  # or just above the bead there
    if middle + FAR_CONTACT >= chain.beads:
        raise ValueError(f"{chain.beads} beads: none {FAR_CONTACT} contacts above the middle")
    beyond = force[:, middle + FAR_CONTACT]
    inner = force[:, 1:]  # a free chain has no contact 1
    put_in = float(chain.mass_kg @ np.abs(chain.velocity_m_s)) / 2
    return _collision_shares(trace.time_s, force[:, middle], beyond) | {
        "asymmetry": float(np.abs(inner - inner[:, ::-1]).max() / beyond.max()),
        "momentum_share": float(np.abs(trace.momentum_N_s).max() / put_in),
    }


def collision_theory(case: Case) -> dict[str, float]:
    """Shares for an exact solitary wave in half of the chain, before a wall in place of the other half."""
    wall_stiffness = 2 * sqrt(2) if case.chain.beads % 2 == 0 else 1.0
    time, force = led_to_wall(HALF_BEADS, HALF_START, wall_stiffness, LAST)
    return _collision_shares(time, force[:, 0], force[:, FAR_CONTACT]) | {"asymmetry": 0.0, "momentum_share": 0.0}


def _collision_shares(time_s: Array, middle_N: Array, beyond_N: Array) -> dict[str, float]:
    """Peaks in the middle and of outgoing waves divided by the incoming wave, from arrays of shape (samples,)."""
    passing, together = peaks(time_s, beyond_N, prominence=WEAKEST_SHARE), first_peak(time_s, middle_N)
    if len(passing) < 3 or together is None:
        raise ValueError(f"{len(passing)} waves within the run, three expected: incoming, outgoing, secondary")
    incoming, outgoing, secondary = (peak.value for peak in passing[:3])
    shares = (together.value / incoming, outgoing / incoming, secondary / incoming)
    return dict(zip(COLLISION, shares, strict=False))


# A solitary wave at a wall: peak force at the wall, and peak of the reflected wave at the lowest sensor's contact.
APPROACH = 10  # contacts from the sensor's contact to the start of the exact wave, and beads above the start
REFLECTED_PROMINENCE = 0.02  # of a wave, divided by the range


def reflection(case: Case, trace: Trace) -> dict[str, float]:
    """Ratios of the maxima at the lowest sensor's contact and at the wall."""
    return _reflection_ratios(_lowest_sensor(case), trace.time_s, trace.force_N)


def reflection_theory(case: Case) -> dict[str, float]:
    """Ratios for the exact solitary wave and the ratio of wall stiffness to bead stiffness."""
    chain, place = case.chain, _lowest_sensor(case)
    if chain.load_N.any():
        raise ValueError("a chain under load: its waves are not the exact solitary wave")
    start = place + APPROACH
    # the wave returns to the sensor after 2 place + APPROACH beads and a delay at the wall
    duration = 2.0 * place + APPROACH + 8.0
    stiffness = float(chain.stiffness[0] / chain.stiffness[1])
    return _reflection_ratios(place, *led_to_wall(start + APPROACH, start, stiffness, duration))


def _reflection_ratios(place: int, time_s: Array, force_N: Array) -> dict[str, float]:
    """Ratios to the first wave that passes contact ``place``."""
    missing = "no wave at the sensor or at the wall within run.duration"
    incident, wall = (peak_in(time_s, force_N[:, column], missing) for column in (place - 1, 0))
    passing = peaks(time_s, force_N[:, place - 1], REFLECTED_PROMINENCE)
    back = [peak.value for peak in passing if peak.time_s > wall.time_s]
    if not back:
        raise ValueError(f"no reflected wave at contact {place} within run.duration")
    return dict(zip(WALL, (wall.value / incident.value, max(back) / incident.value), strict=True))


def _lowest_sensor(case: Case) -> int:
    """Number of the lowest sensor bead; the contact below the bead is read."""
    if case.scene.wall is None or not case.scene.chain.sensors:
        raise ValueError("no wall, or no sensor to read the wave at")
    return min(case.scene.chain.sensor_at)


# A train of solitary waves behind a heavy striker, read thirty contacts below the striker's, under the thirtieth bead
# from the top. There the ratios of the waves are final to 1e-3 for strikers of up to four bead masses; for eight the
# fourth still gains 5 %.
TRAIN_CONTACTS = 30  # below the striker's
TRAIN_PROMINENCE = 1e-3  # of a wave, divided by the range


def train(case: Case, trace: Trace) -> dict[str, float]:
    """Ratios of the maxima at the contact."""
    return _train_ratios(case, trace.time_s, trace.force_N)


def train_theory(case: Case) -> dict[str, float]:
    """Ratios for the same chain by scipy's DOP853."""
    return _train_ratios(case, *forces_of(case.chain, float(case.sample_times_s[-1])))


def _train_ratios(case: Case, time_s: Array, force_N: Array) -> dict[str, float]:
    column = case.chain.bodies - 1 - TRAIN_CONTACTS
    if case.scene.striker is None or column < 1:
        raise ValueError(f"no contact {TRAIN_CONTACTS} below a striker's")
    waves = [peak.value for peak in peaks(time_s, force_N[:, column], TRAIN_PROMINENCE)]
    if len(waves) < 2:
        raise ValueError(f"{len(waves)} waves at contact {column + 1} within run.duration")
    return {name: value / waves[0] for name, value in zip(TRAIN, waves[1:], strict=False)}
