"""The exact solitary wave led to a wall by scipy, in a chain of masses and stiffnesses 1, in which its speed is 1."""

import numpy as np
from scipy.interpolate import CubicSpline

from drivers.chain.chain import Array
from validation.independent.scipy_chain import forces
from validation.reference.travelling_wave import solve_travelling_wave

REACH = 10.0  # beads from the peak: beyond, the wave is less than the rounding of its largest force


def led_to_wall(beads: int, start: float, wall_stiffness: float, duration: float) -> tuple[Array, Array]:
    """Times and the forces in all contacts, shape (samples, beads), of a wave that runs down into a wall.

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
