"""A chain by scipy's DOP853: a solver that shares nothing with the engines nor with the integrators in this repository.

In units of the first bead's mass, a stiffness and a time, bodies from the wall upwards, velocities downwards:

    overlap_j' = v_j - v_(j-1),   m_j v_j' = F_(j+1) - F_j,   F_j = k_j max(overlap_j, 0)^(3/2)
"""

from functools import cache

import numpy as np
from scipy.integrate import solve_ivp
from scipy.interpolate import CubicSpline

from drivers.chain.chain import Array, Chain
from drivers.chain.contact_law import hertz_force
from validation.reference.travelling_wave import solve_travelling_wave

TOLERANCE = 1e-10  # of a step, relative: forces come out to 1e-8 of the largest
SAMPLES_PER_UNIT = 16  # a solitary wave takes four units to pass: peaks of quintics through them are good to 1e-8
REACH = 10.0  # beads from an exact wave's peak: beyond, it is less than the rounding of its largest force


def forces(mass: Array, stiffness: Array, overlap: Array, velocity_down: Array, duration: float) -> tuple[Array, Array]:
    """Times and the forces in all contacts, shape (samples, bodies), of a chain without loads.

    Raises:
        ArithmeticError: scipy gives up.
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
    found = solve_ivp(rates, (0.0, duration), start, "DOP853", time, rtol=TOLERANCE, atol=TOLERANCE)
    if not found.success:
        raise ArithmeticError(f"scipy's DOP853: {found.message}")
    return time, force_of(found.y[:bodies].T)


def forces_of(chain: Chain, duration_s: float) -> tuple[Array, Array]:
    """The same of a chain of the project, in seconds and newtons.

    Raises:
        ArithmeticError: scipy gives up.
        ValueError: the chain has loads or damping, which this does not know.
    """
    if chain.load_N.any() or chain.damping_ratio or chain.lateral is not None:
        raise ValueError("a chain with loads, damping or sideways motion")
    mass, stiffness = float(chain.mass_kg[0]), float(chain.stiffness.max())
    speed = float(np.abs(chain.velocity_m_s).max())
    length = (mass * speed**2 / stiffness) ** 0.4  # of the unit in which all three are 1
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
    """Times and the forces in all contacts, shape (samples, beads), of an exact solitary wave that runs into a wall.

    Masses and stiffnesses are 1; in these units the wave's speed is 1 bead per unit of time.

    Args:
        beads: how many, counted from 1 at the wall; contact j lies half a bead below bead j.
        start: where the peak is at time 0, in beads.
        wall_stiffness: of contact 1, over that of the others.
        duration: in beads that the wave travels.
    """
    wave, place = solve_travelling_wave(), np.arange(1.0, beads + 1) - start

    def at(values: Array, places: Array) -> Array:
        return np.where(np.abs(places) <= REACH, CubicSpline(wave.place, values)(places), 0.0)

    stiffness = np.ones(beads)
    stiffness[0] = wall_stiffness
    overlap = np.cbrt(np.maximum(at(wave.force, place - 0.5), 0.0)) ** 2
    return forces(np.ones(beads), stiffness, overlap, at(wave.velocity, place), duration)
