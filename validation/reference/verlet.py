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


@njit(cache=True)  # type: ignore[untyped-decorator]
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
