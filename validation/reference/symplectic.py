"""Symplectic method of order 4 at a fixed step, the cheapest for elastic chains and errors of 1e-4 to 1e-7.

The method is PEFRL (Omelyan, Mryglod and Folk, Comput. Phys. Commun. 146:188, 2002), with four force evaluations per
step. Hertz's force is only once continuously differentiable where a contact opens or closes; if contacts switch
often, the order falls towards 2.5.
"""

import numpy as np
from numba import njit

from validation.reference.contact_kernels import CACHED, elastic_force
from validation.reference.hertz_chain import NEVER, Array, Flag, HertzChain, check_timing

XI, LAMBDA, CHI = 0.1786178958448091, -0.2123418310626054, -0.06626458266981849
DRIFTS = np.array([XI, CHI, 1 - 2 * (CHI + XI), CHI])  # a last one, XI, is joined to the first of the next step
KICKS = np.array([0.5 - LAMBDA, LAMBDA, LAMBDA, 0.5 - LAMBDA])


def integrate_symplectic(
    chain: HertzChain, time_step_s: float, steps_per_sample: int, samples: int, stop: Flag = NEVER
) -> tuple[Array, Array]:
    """Integrates an elastic chain from time 0 and samples the motion every ``steps_per_sample`` steps.

    Returns:
        Overlaps and velocities. Shape (samples, bodies).

    Raises:
        ValueError: the step is not above zero, or a count is below one.
    """
    check_timing(time_step_s, steps_per_sample, samples)
    overlap, velocity = np.zeros((2, samples, chain.mass_kg.size))
    _fill(
        overlap, velocity, chain.overlap_m.copy(), chain.velocity_m_s, chain.stiffness, 1 / chain.mass_kg,
        chain.load_N / chain.mass_kg, time_step_s, steps_per_sample, stop,
    )  # fmt: skip
    return overlap, velocity


@njit(cache=CACHED, nogil=True, error_model="numpy")
def _fill(
    overlaps: Array, velocities: Array, overlap: Array, velocity: Array, stiffness: Array, inverse_mass: Array,
    acceleration: Array, dt: float, every: int, stop: Flag,
) -> None:  # fmt: skip
    """Fills overlaps and velocities, shape (samples, bodies); the loops over bodies compile to vector instructions."""
    n = overlap.size
    force, speed = np.zeros((2, n + 1))  # forces begin below bodies, velocities with that of the wall
    for j in range(n):
        speed[j + 1] = velocity[j]
    for sample in range(len(overlaps)):
        drift = 0.0  # left of the step before
        for _ in range(every if sample else 0):
            if stop[0]:
                return
            for part in range(DRIFTS.size):
                drift, kick = drift + DRIFTS[part] * dt, KICKS[part] * dt
                for j in range(n):
                    overlap[j] += drift * (speed[j] - speed[j + 1])
                    force[j] = elastic_force(stiffness[j], max(overlap[j], 0.0))
                for j in range(n):
                    speed[j + 1] += kick * ((force[j] - force[j + 1]) * inverse_mass[j] + acceleration[j])
                drift = 0.0
            drift = XI * dt
        for j in range(n):
            overlap[j] += drift * (speed[j] - speed[j + 1])
            overlaps[sample, j], velocities[sample, j] = overlap[j], speed[j + 1]
