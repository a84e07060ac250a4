"""Velocity Verlet at a fixed step: the scheme of LIGGGHTS and YADE, in overlaps instead of positions."""

from math import sqrt

import numpy as np
from numba import njit

from validation.reference.hertz_chain import Array, HertzChain, Motion, displacements


def integrate_verlet(chain: HertzChain, time_step_s: float, steps_per_sample: int, samples: int) -> Motion:
    """Integrates from time 0 with samples every ``steps_per_sample`` steps, the first at time 0.

    Half kick, drift, new forces, half kick: ``v += a dt/2; x += v dt; a = a(x); v += a dt/2``.

    Raises:
        ValueError: a step not above zero, or counts below one.
    """
    if not (np.isfinite(time_step_s) and time_step_s > 0):
        raise ValueError(f"time_step_s: {time_step_s}, expected above zero")
    if steps_per_sample < 1 or samples < 1:
        raise ValueError("steps_per_sample, samples: expected at least one")
    force, overlap, velocity = _integrate(
        chain.mass_kg, chain.stiffness, chain.overlap_m, chain.velocity_m_s, chain.load_N,
        time_step_s, steps_per_sample, samples,
    )  # fmt: skip
    return Motion(force, displacements(chain, overlap), velocity)


@njit(cache=True)
def _integrate(
    mass: Array, stiffness: Array, overlap0: Array, velocity0: Array, load: Array, dt: float, every: int, samples: int
) -> tuple[Array, Array, Array]:
    n = mass.size
    overlap, velocity, force = overlap0.copy(), velocity0.copy(), np.zeros(n + 1)
    forces, overlaps, velocities = np.empty((samples, n)), np.empty((samples, n)), np.empty((samples, n))
    half = 0.5 * dt
    for j in range(n):
        if overlap[j] > 0.0:
            force[j] = stiffness[j] * overlap[j] * sqrt(overlap[j])
    for sample in range(samples):
        forces[sample], overlaps[sample], velocities[sample] = force[:n], overlap, velocity
        if sample == samples - 1:
            break
        for _ in range(every):
            below = 0.0  # the wall stands still
            for j in range(n):
                velocity[j] += half * (force[j] - force[j + 1] + load[j]) / mass[j]
                overlap[j] += dt * (below - velocity[j])
                below = velocity[j]
            for j in range(n):
                force[j] = stiffness[j] * overlap[j] * sqrt(overlap[j]) if overlap[j] > 0.0 else 0.0
            for j in range(n):
                velocity[j] += half * (force[j] - force[j + 1] + load[j]) / mass[j]
    return forces, overlaps, velocities


def integrate_verlet_absolute(
    chain: HertzChain, height_m: Array, reach_m: Array, time_step_s: float, steps_per_sample: int, samples: int
) -> Array:
    """Forces of the same scheme with heights instead of overlaps as its state, as engines hold them.

    The overlap of contact j is ``reach_j - (z_j - z_{j-1})``. What this differs by from ``integrate_verlet`` is
    the rounding of absolute coordinates, and what the motion makes of it.

    Args:
        chain: the bodies and contacts; its overlaps are not used.
        height_m: of each body at time 0, shape (bodies,).
        reach_m: distance of neighbouring bodies (of body 1 and the height 0) that just touch, shape (bodies,).
        time_step_s: as for ``integrate_verlet``.
        steps_per_sample: likewise.
        samples: likewise.

    Returns:
        Shape (samples, bodies).
    """
    return np.asarray(
        _integrate_absolute(
            chain.mass_kg, chain.stiffness, np.array(height_m), reach_m, chain.velocity_m_s, chain.load_N,
            time_step_s, steps_per_sample, samples,
        )
    )  # fmt: skip


@njit(cache=True)
def _integrate_absolute(
    mass: Array, stiffness: Array, height: Array, reach: Array, velocity0: Array, load: Array,
    dt: float, every: int, samples: int,
) -> Array:  # fmt: skip
    n = mass.size
    velocity, force = velocity0.copy(), np.zeros(n + 1)
    forces = np.empty((samples, n))
    half = 0.5 * dt
    for step in range((samples - 1) * every + 1):
        if step:
            for j in range(n):
                velocity[j] += half * (force[j] - force[j + 1] + load[j]) / mass[j]
                height[j] += dt * velocity[j]
        below = 0.0
        for j in range(n):
            overlap = reach[j] - (height[j] - below)
            below = height[j]
            force[j] = stiffness[j] * overlap * sqrt(overlap) if overlap > 0.0 else 0.0
        if step:
            for j in range(n):
                velocity[j] += half * (force[j] - force[j + 1] + load[j]) / mass[j]
        if step % every == 0:
            forces[step // every] = force[:n]
    return forces
