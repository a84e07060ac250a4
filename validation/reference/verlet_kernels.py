"""Kernels of velocity Verlet; imported only for an integration, since the import loads compiled code.

Long chains are divided into tiles that fit the cache. A tile takes many steps at a time and shifts down by one bead per
step, so that every bead finds its neighbours at the right step.
"""

from math import sqrt

import numpy as np
from numba import njit
from numpy.typing import NDArray

from validation.reference.contact_kernels import copy, elastic_force, overlap_power, power_force
from validation.reference.hertz_chain import Array

TILE = 2048  # beads: with six numbers per bead they fit the second-level cache
BLOCK = 128  # steps taken by a tile at a time

# velocity (wall first), overlap, force; constants: stiffness, kick, drop, damping (empty for an elastic chain), alpha
# (0 without the power law)
Arrays = tuple[Array, Array, Array, Array, Array, Array, Array, float]


@njit(nogil=True, error_model="numpy", fastmath={"contract"})
def _sweep(
    below: float, velocity: Array, overlap: Array, force: Array, stiffness: Array, kick: Array, drop: Array, dt: float
) -> None:
    """One step of neighbouring bodies; ``below``: new velocity of the body under them; ``force`` has one more entry."""
    under = force[0]
    for j in range(overlap.size):
        above = force[j + 1]
        here = velocity[j] + (kick[j] * (under - above) + drop[j])
        velocity[j] = here
        under = above
        now = overlap[j] + dt * (below - here)
        below = here
        overlap[j] = now
        closed = max(now, 0.0)
        force[j] = stiffness[j] * overlap_power(closed)


@njit(nogil=True, error_model="numpy")
def _sweep_damped(
    below: float, velocity: Array, overlap: Array, force: Array, stiffness: Array, kick: Array, drop: Array,
    damping: Array, dt: float,
) -> None:  # fmt: skip
    """``_sweep`` for dissipative contacts; the damping uses velocities half a step before, as in the codes."""
    under = force[0]
    for j in range(overlap.size):
        above = force[j + 1]
        here = velocity[j] + (kick[j] * (under - above) + drop[j])
        velocity[j] = here
        under = above
        closing = below - here
        now = overlap[j] + dt * closing
        below = here
        overlap[j] = now
        root = sqrt(max(now, 0.0))
        force[j] = max(stiffness[j] * (now * root) + damping[j] * sqrt(root) * closing, 0.0)


@njit(nogil=True, error_model="numpy")
def _sweep_power(
    below: float, velocity: Array, overlap: Array, force: Array, stiffness: Array, kick: Array, drop: Array,
    damping: Array, alpha: float, dt: float,
) -> None:  # fmt: skip
    """``_sweep_damped`` for the velocity-power law."""
    under = force[0]
    for j in range(overlap.size):
        above = force[j + 1]
        here = velocity[j] + (kick[j] * (under - above) + drop[j])
        velocity[j] = here
        under = above
        closing = below - here
        now = overlap[j] + dt * closing
        below = here
        overlap[j] = now
        force[j] = power_force(stiffness[j], damping[j], alpha, now, closing) if now >= 0.0 else 0.0


@njit(nogil=True, error_model="numpy")
def _step_range(
    arrays: Arrays, dt: float, low: int, high: int, below: float, step: int, every: int,
    places: NDArray[np.int64], recorded: Array,
) -> None:  # fmt: skip
    """One step of the bodies from ``low`` to ``high - 1``; records their forces."""
    velocity, overlap, force, stiffness, kick, drop, damping, alpha = arrays
    if alpha > 0.0:
        _sweep_power(
            below, velocity[low + 1 : high + 1], overlap[low:high], force[low : high + 1],
            stiffness[low:high], kick[low:high], drop[low:high], damping[low:high], alpha, dt,
        )  # fmt: skip
    elif damping.size:
        _sweep_damped(
            below, velocity[low + 1 : high + 1], overlap[low:high], force[low : high + 1],
            stiffness[low:high], kick[low:high], drop[low:high], damping[low:high], dt,
        )  # fmt: skip
    else:
        _sweep(
            below, velocity[low + 1 : high + 1], overlap[low:high], force[low : high + 1],
            stiffness[low:high], kick[low:high], drop[low:high], dt,
        )  # fmt: skip
    _record(force, low, high, step, every, places, recorded)


@njit(nogil=True, error_model="numpy")
def _record(
    force: Array, low: int, high: int, step: int, every: int, places: NDArray[np.int64], recorded: Array
) -> None:
    """Records forces after a step that ends a sample interval."""
    if (step + 1) % every == 0:
        for i in range(places.size):
            if low <= places[i] < high:
                recorded[(step + 1) // every, i] = force[places[i]]


@njit(nogil=True, error_model="numpy")
def _advance(
    arrays: Arrays, dt: float, first: int, last: int, rising: bool, falling: bool, done: int, steps: int, every: int,
    places: NDArray[np.int64], recorded: Array, edge: Array,
) -> None:  # fmt: skip
    """Takes ``steps`` steps with the bodies from ``first`` to ``last - 1``.

    With ``rising`` the range begins one body higher at each step, with ``falling`` it ends one body lower, so that no
    body depends on bodies of the other thread; ``fill_between`` computes the bodies left out. A rising range stores
    the force at its lower edge before each step in ``edge``.
    """
    velocity, overlap, force, stiffness, kick, drop, damping, alpha = arrays
    if first == 0 and overlap.size == last <= TILE:  # a single tile needs no slicing at every step
        for step in range(steps):
            if alpha > 0.0:
                _sweep_power(0.0, velocity[1:], overlap, force, stiffness, kick, drop, damping, alpha, dt)
            elif damping.size:
                _sweep_damped(0.0, velocity[1:], overlap, force, stiffness, kick, drop, damping, dt)
            else:
                _sweep(0.0, velocity[1:], overlap, force, stiffness, kick, drop, dt)
            _record(force, first, last, done + step, every, places, recorded)
        return
    start = first
    while start < last + steps:
        for step in range(steps):
            bottom = first + step if rising else first
            low, high = max(start - step, bottom), min(start + TILE - step, last - step if falling else last)
            if high <= low:
                continue
            below = velocity[low]
            if rising and low == bottom:
                edge[step] = force[low]
                below += kick[low - 1] * (force[low - 1] - force[low]) + drop[low - 1]
            _step_range(arrays, dt, low, high, below, done + step, every, places, recorded)
        start += TILE


@njit(cache=True, nogil=True, error_model="numpy")
def advance(
    arrays: Arrays, dt: float, first: int, last: int, rising: bool, falling: bool, done: int, steps: int, every: int,
    places: NDArray[np.int64], recorded: Array, edge: Array,
) -> None:  # fmt: skip
    """Cached entry to ``_advance``: a cached kernel calls no cached kernel, so that rounding is reproducible."""
    _advance(arrays, dt, first, last, rising, falling, done, steps, every, places, recorded, edge)


@njit(cache=True, nogil=True, error_model="numpy")
def fill_samples(
    arrays: Arrays, dt: float, every: int, half_kick: Array, load: Array,
    forces: Array, overlaps: Array, velocities: Array, nowhere: NDArray[np.int64], nothing: Array,
) -> None:  # fmt: skip
    """Fills the samples, the first with the initial state; velocities are shifted to the time of the forces."""
    velocity, overlap, force = arrays[0], arrays[1], arrays[2]
    for sample in range(len(forces)):
        if sample:
            for first in range(0, every, BLOCK):
                steps = min(BLOCK, every - first)
                _advance(arrays, dt, 0, overlap.size, False, False, 0, steps, steps, nowhere, nothing, force)
        for j in range(overlap.size):
            forces[sample, j] = force[j]
            overlaps[sample, j] = overlap[j]
            velocities[sample, j] = velocity[j + 1] + half_kick[j] * (force[j] - force[j + 1] + load[j])


@njit(cache=True, nogil=True, error_model="numpy")
def fill_between(
    arrays: Arrays, dt: float, middle: int, done: int, steps: int, every: int,
    places: NDArray[np.int64], recorded: Array, edge: Array,
) -> None:  # fmt: skip
    """Advances the bodies left out by a falling range up to ``middle - 1`` and a rising range from ``middle``."""
    velocity, force = arrays[0], arrays[2]
    for step in range(steps):
        low, high = middle - 1 - step, middle + step
        later = force[high]
        force[high] = edge[step]
        _step_range(arrays, dt, low, high, velocity[low], done + step, every, places, recorded)
        force[high] = later


@njit(cache=True)
def integrate_absolute(
    mass: Array, stiffness: Array, height: Array, reach: Array, velocity: Array, load: Array, damping: Array,
    alpha: float | None, force: Array, net: Array, attraction: bool, local: float, dt: float, every: int,
    forces: Array, heights: Array, velocities: Array,
) -> None:  # fmt: skip
    """Fills the samples of ``integrate_verlet_absolute``; alpha is None without the power law."""
    n, half = mass.size, 0.5 * dt
    for step in range((len(forces) - 1) * every + 1):
        if step:
            for j in range(n):
                velocity[j] += half * net[j] / mass[j]
                height[j] += dt * velocity[j]
        below = 0.0
        for j in range(n):
            overlap = reach[j] - (height[j] - below)
            below = height[j]
            force[j] = elastic_force(stiffness[j], overlap) if overlap > 0.0 else 0.0
            if overlap > 0.0 and damping[j] > 0.0:
                closing = (velocity[j - 1] if j > 0 else 0.0) - velocity[j]
                if alpha is None:
                    force[j] += damping[j] * sqrt(sqrt(overlap)) * closing
                else:
                    force[j] += damping[j] * np.sign(closing) * abs(closing) ** alpha
                if not attraction:
                    force[j] = max(force[j], 0.0)
        for j in range(n):
            net[j] = force[j] - force[j + 1] + load[j]
            kick = half * net[j] / mass[j] if step else 0.0
            if local > 0.0:
                share = 1.0 - local * np.sign(net[j] * (velocity[j] + kick))
                net[j] *= share
                kick *= share
            velocity[j] += kick
        if step % every == 0:
            copy(force, forces[step // every])
            copy(height, heights[step // every])
            copy(velocity, velocities[step // every])
