"""Cases beyond the paper with strong waves: impacts, solitary waves, trains, and their theories."""

from dataclasses import replace
from functools import cache
from math import gamma, isnan, log, pi, sqrt

import numpy as np
from scipy.integrate import solve_ivp
from scipy.interpolate import CubicSpline

from drivers.chain.case import Case
from drivers.chain.chain import Array, Chain, hertz_force
from drivers.chain.trace import Trace, overlaps
from drivers.laws import VISCOELASTIC, restitution_of
from postproc.read.signals import Peak, first_peak, peaks, rising_crossing, sensor_average
from validation.claims.linear_waves import first_wave, sensor_places, velocity_down
from validation.reference.travelling_wave import solve_at_amplitude, solve_travelling_wave, sound_speed

# One impact, of two spheres or of a sphere on a plane: peak force, peak overlap, duration, restitution.
#
# Hertz's law ``F = k d^(3/2)`` with the reduced mass m* and the speed v at which the bodies meet gives
#
#     d_max = (5 m* v^2 / (4 k))^(2/5),   F_max = k d_max^(3/2),   duration = 2 I d_max / v,
#     I = integral from 0 to 1 of dx / sqrt(1 - x^(5/2)) = sqrt(pi) Gamma(7/5) / Gamma(9/10)
#
# (Landau and Lifshitz, Theory of Elasticity, problem 9.1; Johnson, Contact Mechanics, section 11.4).

DURATION = 2 * sqrt(pi) * gamma(7 / 5) / gamma(9 / 10)  # in d_max / v: 2.94328


def impact(case: Case, trace: Trace) -> dict[str, float]:
    """Peak force, peak overlap, restitution, and for elastic bodies the duration."""
    contact = case.chain.bodies - 1  # the top contact
    force = trace.force_N[:, contact]
    closed = np.flatnonzero(force > 0)
    if closed.size < 4 or closed[0] == 0 or closed[-1] == len(force) - 1:
        raise ValueError("the bodies do not meet and separate within run.duration")
    first, last = (_closing(velocity, contact) for velocity in velocity_down(trace)[[0, -1]])
    assert trace.height_m is not None  # recorded with the velocities
    overlap = overlaps(case.chain, trace.height_m)[:, contact]
    strongest, deepest = (first_peak(trace.time_s, signal, "the force has no maximum") for signal in (force, overlap))
    values = {"peak_force_N": strongest.value, "peak_overlap_m": deepest.value, "restitution": -last / first}
    if not case.chain.damped:
        values["duration_s"] = _duration(trace.time_s, force)
    return values


def _duration(time_s: Array, force_N: Array) -> float:
    """Time from closing to opening, by linear extrapolation of ``F^(2/3)``, which is proportional to the overlap.

    The next term of the overlap is of power 7/2 in time: 1/400 of the impact after closing it is linear to 1e-8.
    """
    overlap = np.cbrt(np.maximum(force_N, 0.0)) ** 2
    closed = np.flatnonzero(overlap)

    def zero(near: int, far: int) -> float:
        slope = (overlap[far] - overlap[near]) / (time_s[far] - time_s[near])
        return float(time_s[near] - overlap[near] / slope)

    return zero(closed[-1], closed[-2]) - zero(closed[0], closed[1])


def impact_theory(case: Case) -> dict[str, float]:
    """Hertz's closed form for elastic bodies; the scene's restitution."""
    chain, contact = case.chain, case.chain.bodies - 1
    if np.count_nonzero(chain.stiffness) != 1 or chain.load_N.any():
        raise ValueError("a case with loads or with more than one contact")
    if chain.law.name == VISCOELASTIC:
        return {"restitution": restitution_of(chain.law.value)}
    speed = _closing(chain.velocity_m_s, contact)
    mass, stiffness = float(chain.reduced_mass_kg[contact]), float(chain.stiffness[contact])
    deepest = (5 * mass * speed**2 / (4 * stiffness)) ** 0.4
    return {
        "restitution": 1.0,
        "peak_force_N": hertz_force(stiffness, deepest),
        "peak_overlap_m": deepest,
        "duration_s": DURATION * deepest / speed,
    }


def _closing(velocity_m_s: Array, contact: int) -> float:
    """Closing speed of the bodies at a contact, negative when they separate."""
    below = float(velocity_m_s[contact - 1]) if contact else 0.0
    return below - float(velocity_m_s[contact])


# Collisions, reflections and trains of waves: forces relative to the first wave that passes a contact.
#
# A measure reads maxima of contact forces from a run; its theory reads the same maxima from scipy's DOP853, which
# shares no code with the engines and the in-repo integrators. In units of the first bead's mass, a stiffness and a
# time, bodies from the wall upwards, velocities downwards:
#
#     overlap_j' = v_j - v_(j-1),   m_j v_j' = F_(j+1) - F_j,   F_j = k_j max(overlap_j, 0)^(3/2)

TOLERANCE = 1e-10  # relative, per step: errors of forces up to 1e-8 of the largest
SAMPLES_PER_UNIT = 16  # a solitary wave passes in four units; peaks of quintic splines have errors of 1e-8
REACH = 10.0  # beads from the peak of an exact wave; beyond, the force is below rounding


def forces(mass: Array, stiffness: Array, overlap: Array, velocity_down: Array, duration: float) -> Trace:
    """Times and contact forces, shape (samples, bodies), of a chain without loads; energies and momentum are 0.

    Raises:
        ArithmeticError: scipy does not converge.
    """
    bodies = len(mass)

    def force_of(overlaps: Array) -> Array:
        closed = np.maximum(overlaps, 0.0)
        return np.asarray(stiffness * closed * np.sqrt(closed))

    def rates(_: float, state: Array) -> Array:
        force, velocity = force_of(state[:bodies]), state[bodies:]
        return np.concatenate([np.diff(velocity, prepend=0.0), np.diff(force, append=0.0) / mass])

    time = np.linspace(0.0, duration, int(SAMPLES_PER_UNIT * duration) + 2)
    start = np.concatenate([overlap, velocity_down])
    solution = solve_ivp(rates, (0.0, duration), start, "DOP853", time, rtol=TOLERANCE, atol=TOLERANCE)
    if not solution.success:
        raise ArithmeticError(f"scipy's DOP853: {solution.message}")
    none = np.zeros_like(time)
    return Trace(time, force_of(solution.y[:bodies].T), none, none, none)


def forces_of(chain: Chain, duration_s: float) -> Trace:
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
    start = chain.overlap_m / length, -chain.velocity_m_s / speed
    motion = forces(chain.mass_kg / mass, chain.stiffness / stiffness, *start, duration_s * speed / length)
    force_N = hertz_force(motion.force_N * stiffness, length)
    return replace(motion, time_s=motion.time_s * length / speed, force_N=force_N)


@cache
def led_to_wall(beads: int, start: float, wall_stiffness: float, duration: float) -> Trace:
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
    motion = led_to_wall(HALF_BEADS, HALF_START, wall_stiffness, LAST)
    shares = _collision_shares(motion.time_s, motion.force_N[:, 0], motion.force_N[:, FAR_CONTACT])
    return shares | {"asymmetry": 0.0, "momentum_share": 0.0}


def _collision_shares(time_s: Array, middle_N: Array, beyond_N: Array) -> dict[str, float]:
    """Peaks in the middle and of outgoing waves divided by the incoming wave, from arrays of shape (samples,)."""
    passing, together = peaks(time_s, beyond_N, prominence=WEAKEST_SHARE), first_peak(time_s, middle_N)
    if len(passing) < 3 or isnan(together.value):
        raise ValueError(f"{len(passing)} waves within the run, three expected: incoming, outgoing, secondary")
    incoming, outgoing, secondary = (peak.value for peak in passing[:3])
    return {
        "middle_share": together.value / incoming,
        "outgoing_share": outgoing / incoming,
        "secondary_share": secondary / incoming,
    }


# A solitary wave at a wall: peak force at the wall, and peak of the reflected wave at the lowest sensor's contact.
APPROACH = 10  # contacts from the sensor's contact to the start of the exact wave, and beads above the start
REFLECTED_PROMINENCE = 0.02  # of a wave, divided by the range


def wall(case: Case, trace: Trace) -> dict[str, float]:
    """Ratios of the maxima at the wall, and of the reflected wave, to the first wave at the lowest sensor's contact."""
    place = _lowest_sensor(case)
    missing = "no wave at the sensor or at the wall within run.duration"
    incident, wall = (first_peak(trace.time_s, trace.force_N[:, column], missing) for column in (place - 1, 0))
    passing = peaks(trace.time_s, trace.force_N[:, place - 1], REFLECTED_PROMINENCE)
    back = [peak.value for peak in passing if peak.time_s > wall.time_s]
    if not back:
        raise ValueError(f"no reflected wave at contact {place} within run.duration")
    return {
        "wall_peak_over_incident": wall.value / incident.value,
        "reflected_over_incident": max(back) / incident.value,
    }


def wall_theory(case: Case) -> dict[str, float]:
    """Ratios for the exact solitary wave and the ratio of wall stiffness to bead stiffness."""
    chain, place = case.chain, _lowest_sensor(case)
    if chain.load_N.any():
        raise ValueError("a chain under load: its waves are not the exact solitary wave")
    start = place + APPROACH
    # the wave returns to the sensor after 2 place + APPROACH beads and a delay at the wall
    duration = 2.0 * place + APPROACH + 8.0
    stiffness = float(chain.stiffness[0] / chain.stiffness[1])
    return wall(case, led_to_wall(start + APPROACH, start, stiffness, duration))


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
    column = case.chain.bodies - 1 - TRAIN_CONTACTS
    if case.scene.striker is None or column < 1:
        raise ValueError(f"no contact {TRAIN_CONTACTS} below a striker's")
    waves = [peak.value for peak in peaks(trace.time_s, trace.force_N[:, column], TRAIN_PROMINENCE)]
    if len(waves) < 2:
        raise ValueError(f"{len(waves)} waves at contact {column + 1} within run.duration")
    return {f"wave_{number}_over_first": value / waves[0] for number, value in enumerate(waves[1:], start=2)}


def train_theory(case: Case) -> dict[str, float]:
    """Ratios for the same chain by scipy's DOP853."""
    return train(case, forces_of(case.chain, float(case.sample_times_s[-1])))


# A single solitary wave in an uncompressed chain, compared with the exact travelling wave of the discrete chain.
#
# With contact stiffness k and bead mass m the exact wave has, at any amplitude,
#
#     F_m = A k^(2/5) m^(3/5) v_m^(6/5),   c = B (k/m)^(2/5) v_m^(1/5) = C k^(1/3) m^(-1/2) F_m^(1/6) beads per second
#
# and its widths in beads. The long-wave limit (Nesterenko, Dynamics of Heterogeneous Materials, 1.4: the paper's Eqs. 2
# and 3) has C = (4/5)^(1/2), and B = (16/25)^(1/5).

LONG_WAVE_BY_VELOCITY = 0.64**0.2
SOLITARY = (
    "peak_velocity_over_strike", "force_by_velocity", "speed_by_force", "speed_by_velocity",
    "contact_width_4pct_diameters", "contact_width_half_diameters",
    "average_width_4pct_diameters", "average_width_half_diameters",
)  # fmt: skip
WIDTHS = ((False, 0.04), (False, 0.5), (True, 0.04), (True, 0.5))  # True for a sensor's average; share of the peak
FORMATION_CONTACTS = 30  # below the strike: there the wave differs from the exact one by 2e-9


def solitary_wave(case: Case, trace: Trace) -> dict[str, float]:
    """Velocity, force and widths at the lower sensor, speed from the upper to the lower sensor."""
    lower, upper = sensor_places(case)
    time = trace.time_s
    force, before = first_wave(time, trace.force_N[:, lower - 1]), first_wave(time, trace.force_N[:, upper - 1])
    velocity = first_wave(time, velocity_down(trace)[:, lower - 1]).value
    speed = (upper - lower) / (force.time_s - before.time_s)
    stiffness, mass = float(case.chain.stiffness[lower]), float(case.chain.mass_kg[lower - 1])
    average = sensor_average(trace.force_N, lower)
    widths = [
        _width_s(time, average if averaged else trace.force_N[:, lower - 1], share) * speed
        for averaged, share in WIDTHS
    ]
    by_velocity = speed / ((stiffness / mass) ** 0.4 * velocity**0.2)
    by_force = speed / (stiffness ** (1 / 3) * mass**-0.5 * force.value ** (1 / 6))
    strength = force.value / (stiffness**0.4 * mass**0.6 * velocity**1.2)
    return _by_quantity(
        velocity / float(np.abs(case.chain.velocity_m_s).max()), strength, by_force, by_velocity, *widths
    )


def solitary_wave_theory(case: Case) -> dict[str, float]:
    """Constants of the exact wave; its amplitude from scipy's integration of the strike."""
    wave, chain = solve_travelling_wave(), case.chain
    speed = float(np.abs(chain.velocity_m_s).max())
    stiffness, mass = float(chain.stiffness[-1]), float(chain.mass_kg[0])
    time_unit = (mass / stiffness) ** 0.4 * speed**-0.2
    motion = forces_of(chain, 1.3 * FORMATION_CONTACTS * time_unit)
    peak = first_wave(motion.time_s, motion.force_N[:, -1 - FORMATION_CONTACTS]).value
    velocity = (peak / (wave.force_by_velocity * stiffness**0.4 * mass**0.6)) ** (5 / 6)
    widths = [wave.width(share, averaged=averaged) for averaged, share in WIDTHS]
    return _by_quantity(velocity / speed, wave.force_by_velocity, wave.speed_by_force, wave.speed_by_velocity, *widths)


def _by_quantity(*values: float) -> dict[str, float]:
    named = dict(zip(SOLITARY, values, strict=True))
    return named | {"speed_below_long_wave": 1 - named["speed_by_velocity"] / LONG_WAVE_BY_VELOCITY}


def _width_s(time_s: Array, values: Array, share: float) -> float:
    """Time from rising through a share of the first peak to falling through it."""
    peak = first_wave(time_s, values)
    level = share * peak.value
    # the falling edge is a rising edge in reversed time
    mirrored = Peak(-peak.time_s, peak.value, len(values) - 1 - peak.sample)
    fall = -rising_crossing(-time_s[::-1], values[::-1], level, mirrored)
    return fall - rising_crossing(time_s, values, level, peak)


# A solitary wave in a precompressed chain: its speed against three theories at the same dynamic force.
#
# Exact: the travelling wave of the discrete chain with this peak force (``validation.reference.travelling_wave``). Long
# waves: the paper's Eq. (4), with the sound speed c_0 and ``f = ((F_0 + F_d) / F_0)^(2/3)``,
#
#     V = c_0 sqrt((4/15) (3 + 2 f^(5/2) - 5 f)) / (f - 1)
#
# Uncompressed: the exact wave of the chain without precompression whose peak force is F_d. The ratio to its speed is
# the tuning by precompression of Daraio, Nesterenko, Herbold and Jin (Phys. Rev. E 73, 026610, 2006).


def precompressed_wave(case: Case, trace: Trace) -> dict[str, float]:
    """Speed from the upper to the lower sensor, divided by those that belong to the peak force of the lower."""
    lower, upper = sensor_places(case)
    chain, static_N = case.chain, case.scene.chain.precompression
    near, far = (first_wave(trace.time_s, trace.force_N[:, place - 1] - static_N) for place in (upper, lower))
    speed, peak_N = (upper - lower) / (far.time_s - near.time_s), far.value
    stiffness, mass = float(chain.stiffness[lower]), float(chain.mass_kg[lower])
    sound = sound_speed(stiffness, mass, static_N)
    f = (1 + peak_N / static_N) ** (2 / 3)
    uncompressed = solve_travelling_wave().speed_by_force * stiffness ** (1 / 3) * mass**-0.5 * peak_N ** (1 / 6)
    return {
        "speed_over_exact": speed / solve_at_amplitude(stiffness, mass, static_N, peak_N / static_N).speed,
        "speed_over_long_wave": speed / sound * (f - 1) / sqrt(4 / 15 * (3 + 2 * f**2.5 - 5 * f)),
        "speed_over_uncompressed": speed / uncompressed,
    }


def precompressed_wave_theory(case: Case) -> dict[str, float]:
    """Both theories of the precompressed chain; ValueError for a chain to which they do not apply."""
    chain = case.chain
    beads, between = slice(0, chain.beads), slice(1, chain.beads)
    unequal = any(values.min() < values.max() for values in (chain.mass_kg[beads], chain.stiffness[between]))
    if not case.scene.chain.precompression or case.scene.axial_gravity or unequal:
        raise ValueError("a chain without precompression, with gravity or of unequal beads")
    return {"speed_over_exact": 1.0, "speed_over_long_wave": 1.0}


# Waves in chains of unequal beads: tapered, decorated with light beads, and with one impurity.
#
# Tapered: successive binary collisions pass the velocity from bead to bead by ``v_(k+1)/v_k = 2/(1 + m_(k+1)/m_k)``
# (binary collision approximation: Harbola, Rosas, Esposito and Lindenberg, Phys. Rev. E 80, 031303, 2009). The
# logarithm is accurate to a share of the order of the taper.
#
# Decorated: light beads m between heavy beads M follow without inertia, so a wave is that of a chain of heavy beads
# with a renormalised mass and interaction (Harbola, Rosas, Romero and Lindenberg, arXiv:0909.2627): M + m, and two
# Hertz contacts in series, ``k / 2^(3/2)``. The error is of the order of m/M.


def taper(case: Case, trace: Trace) -> dict[str, float]:
    """Change of the peak velocity between the two sensors, as a logarithm, divided by that by binary collisions."""
    lower, upper = sensor_places(case)
    velocity, mass = velocity_down(trace), case.chain.mass_kg
    near, far = (first_wave(trace.time_s, velocity[:, place - 1]).value for place in (upper, lower))
    collisions = np.log(2 / (1 + mass[lower - 1 : upper - 1] / mass[lower:upper])).sum()
    return {"change_over_collisions": log(far / near) / float(collisions)}


def taper_theory(case: Case) -> dict[str, float]:
    """Unity; ValueError for equal beads."""
    lower, upper = sensor_places(case)
    if np.ptp(case.chain.mass_kg[lower - 1 : upper]) == 0:
        raise ValueError("equal beads between the sensors: nothing decays")
    return {"change_over_collisions": 1.0}


def decorated_chain(case: Case, trace: Trace) -> dict[str, float]:
    """Speed between two heavy beads with sensors, divided by that of the effective chain at the same peak velocity."""
    lower, upper = sensor_places(case)
    chain, velocity = case.chain, velocity_down(trace)
    near, far = (first_wave(trace.time_s, velocity[:, place - 1]) for place in (upper, lower))
    stiffness = float(chain.stiffness[lower]) / 2**1.5
    mass = float(chain.mass_kg[lower - 1] + chain.mass_kg[lower])
    effective = solve_travelling_wave().speed_by_velocity * (stiffness / mass) ** 0.4 * far.value**0.2
    return {"speed_over_effective": (upper - lower) / 2 / (far.time_s - near.time_s) / effective}


def decorated_chain_theory(case: Case) -> dict[str, float]:
    """Unity; ValueError if the sensors are not on the heavy beads of a dimer."""
    lower, upper = sensor_places(case)
    mass = case.chain.mass_kg[lower - 1 : upper]
    if (upper - lower) % 2 or np.ptp(mass[::2]) or np.ptp(mass[1::2]) or mass[0] <= mass[1]:
        raise ValueError("sensors that are not on two heavy beads of a chain of alternating beads")
    return {"speed_over_effective": 1.0}
