"""Symplectic method of order 4 at a fixed step, to show where higher order pays with Hertz's law.

The method is PEFRL (Omelyan, Mryglod and Folk, Comput. Phys. Commun. 146:188, 2002), with four force evaluations per
step. Hertz's force is only once continuously differentiable where a contact opens or closes; if contacts switch
often, the order falls towards 2.5.
"""

import numpy as np
from numba import njit

from validation.reference.contact_kernels import CACHED, copy, elastic_force
from validation.reference.hertz_chain import Array, HertzChain, Motion, check_timing, displacements, hertz_force

XI, LAMBDA, CHI = 0.1786178958448091, -0.2123418310626054, -0.06626458266981849
DRIFTS = np.array([XI, CHI, 1 - 2 * (CHI + XI), CHI, XI])
KICKS = np.array([0.5 - LAMBDA, LAMBDA, LAMBDA, 0.5 - LAMBDA])


def integrate_symplectic(chain: HertzChain, time_step_s: float, steps_per_sample: int, samples: int) -> Motion:
    """Integrates from time 0 and samples the motion every ``steps_per_sample`` steps, beginning at time 0.

    Raises:
        ValueError: the step is not above zero, or a count is below one.
    """
    check_timing(time_step_s, steps_per_sample, samples)
    overlap, velocity = np.empty((2, samples, chain.mass_kg.size))
    _fill(
        overlap, velocity, chain.overlap_m, chain.velocity_m_s, chain.stiffness, 1 / chain.mass_kg,
        chain.load_N / chain.mass_kg, time_step_s, steps_per_sample,
    )  # fmt: skip
    return Motion(hertz_force(chain.stiffness, overlap), displacements(chain, overlap), velocity)


@njit(cache=CACHED, nogil=True, error_model="numpy")
def _fill(
    overlaps: Array, velocities: Array, start: Array, start_velocity: Array, stiffness: Array, inverse_mass: Array,
    acceleration: Array, dt: float, every: int,
) -> None:  # fmt: skip
    """Fills overlaps and velocities, each of shape (samples, bodies)."""
    n = start.size
    overlap, velocity = start.copy(), start_velocity.copy()
    for step in range((len(overlaps) - 1) * every + 1):
        if step:
            for part in range(DRIFTS.size):
                below = 0.0
                for j in range(n):
                    overlap[j] += DRIFTS[part] * dt * (below - velocity[j])
                    below = velocity[j]
                if part == KICKS.size:
                    break
                above = 0.0
                for j in range(n - 1, -1, -1):
                    closed = max(overlap[j], 0.0)
                    force = elastic_force(stiffness[j], closed)
                    velocity[j] += KICKS[part] * dt * ((force - above) * inverse_mass[j] + acceleration[j])
                    above = force
        if step % every == 0:
            copy(overlap, overlaps[step // every])
            copy(velocity, velocities[step // every])
