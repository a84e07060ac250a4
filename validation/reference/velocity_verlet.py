"""Velocity Verlet at a fixed step: the scheme of LIGGGHTS, YADE and LAMMPS, in overlaps instead of positions.

Inside, velocities stand half a step behind, so that one pass over the chain makes one step; recorded velocities
belong to the time of the forces. Compiled code is loaded by the first integration.
"""

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from validation.reference.hertz_chain import Array, HertzChain, Motion, check_timing, contact_force, displacements

if TYPE_CHECKING:
    from validation.reference.verlet_kernels import Arrays

LEAST_FOR_TWO = 50_000  # beads below which a second thread does not pay


def integrate_verlet(chain: HertzChain, time_step_s: float, steps_per_sample: int, samples: int) -> Motion:
    """Integrates from time 0 and keeps the whole motion every ``steps_per_sample`` steps, the first at time 0.

    Half kick, drift, new forces, half kick: ``v += a dt/2; x += v dt; a = a(x); v += a dt/2``.

    Raises:
        ValueError: a step not above zero, or counts below one.
    """
    check_timing(time_step_s, steps_per_sample, samples)
    from validation.reference.verlet_kernels import fill_samples

    arrays, half_kick = _start(chain, time_step_s), 0.5 * time_step_s / chain.mass_kg
    motion = Motion(*(np.empty((samples, chain.mass_kg.size)) for _ in range(3)))
    kept = (motion.force_N, motion.displacement_m, motion.velocity_m_s)
    none = np.zeros(0, dtype=np.int64), np.zeros((0, 0))
    fill_samples(arrays, time_step_s, steps_per_sample, half_kick, chain.load_N, *kept, *none)
    return Motion(motion.force_N, displacements(chain, motion.displacement_m), motion.velocity_m_s)


def record_contacts(
    chain: HertzChain,
    time_step_s: float,
    steps_per_sample: int,
    samples: int,
    contacts: NDArray[np.int64],
    *,
    threads: int = 1,
    progress: Callable[[int], object] | None = None,
) -> Array:
    """Forces of some contacts of a long chain, in constant memory.

    Args:
        chain: the chain.
        time_step_s: the time step.
        steps_per_sample: steps from sample to sample, the first at time 0.
        samples: how many.
        contacts: which, counted from 1 as in the rest of the project.
        threads: 1 or 2; a second one serves chains of 50 000 beads and more.
        progress: called with the number of steps done since its last call, such as ``tqdm.update``.

    Returns:
        Shape (samples, contacts), in N.

    Raises:
        ValueError: a step not above zero, counts below one, contacts that do not exist, threads other than 1 or 2.
    """
    check_timing(time_step_s, steps_per_sample, samples)
    places = np.asarray(contacts, dtype=np.int64) - 1
    n = chain.mass_kg.size
    if places.ndim != 1 or (places < 0).any() or (places >= n).any():
        raise ValueError(f"contacts: expected numbers from 1 to {n}")
    if threads not in (1, 2):
        raise ValueError(f"threads: {threads}, expected 1 or 2")
    from validation.reference.verlet_kernels import BLOCK, advance, fill_between

    arrays = _start(chain, time_step_s)
    recorded = np.empty((samples, places.size))
    recorded[0] = arrays[2][places]
    total, middle = steps_per_sample * (samples - 1), n // 2
    edge = np.zeros(BLOCK)
    with ThreadPoolExecutor(2) as pool:
        for first in range(0, total, BLOCK):
            steps = min(BLOCK, total - first)
            rest = (first, steps, steps_per_sample, places, recorded, edge)
            if threads == 1 or n < LEAST_FOR_TWO:
                advance(arrays, time_step_s, 0, n, False, False, *rest)
            else:
                lower = pool.submit(advance, arrays, time_step_s, 0, middle - 1, False, True, *rest)
                advance(arrays, time_step_s, middle, n, True, False, *rest)
                lower.result()
                fill_between(arrays, time_step_s, middle, *rest)
            if progress is not None:
                progress(steps)
    return recorded


def _start(chain: HertzChain, time_step_s: float) -> "Arrays":
    """Velocities of half a step before time 0 behind the wall's, overlaps, forces (none above the last), constants."""
    force = np.append(contact_force(chain, chain.overlap_m, chain.velocity_m_s), 0.0)
    acceleration = (force[:-1] - force[1:] + chain.load_N) / chain.mass_kg
    velocity = np.append(0.0, chain.velocity_m_s - 0.5 * time_step_s * acceleration)
    kick, drop = time_step_s / chain.mass_kg, time_step_s * chain.load_N / chain.mass_kg
    damping = np.zeros(0) if chain.elastic else chain.damping
    return velocity, chain.overlap_m.copy(), force, chain.stiffness, kick, drop, damping, float(chain.alpha)


def integrate_verlet_absolute(
    chain: HertzChain,
    height_m: Array,
    reach_m: Array,
    time_step_s: float,
    steps_per_sample: int,
    samples: int,
    *,
    attraction: bool = False,
    local_damping: float = 0.0,
) -> Motion:
    """The same scheme with heights instead of overlaps as its state, as engines hold them.

    The overlap of contact j is ``reach_j - (z_j - z_{j-1})``. What this differs by from ``integrate_verlet`` is
    the rounding of absolute coordinates, and what the motion makes of it.

    Args:
        chain: the bodies and contacts; its overlaps are not used.
        height_m: of each body at time 0, shape (bodies,).
        reach_m: distance of neighbouring bodies (of body 1 and the height 0) that just touch, shape (bodies,).
        time_step_s: as for ``integrate_verlet``.
        steps_per_sample: likewise.
        samples: likewise.
        attraction: whether contacts that lose energy may pull, which a code may be told.
        local_damping: d of Cundall's non-viscous damping, ``a (1 - d sign(a v))``, which a code may add.

    Returns:
        Every array of shape (samples, bodies).
    """
    from validation.reference.verlet_kernels import integrate_absolute

    motion = Motion(*(np.empty((samples, chain.mass_kg.size)) for _ in range(3)))
    integrate_absolute(
        chain.mass_kg, chain.stiffness, np.array(height_m), reach_m, chain.velocity_m_s.copy(), chain.load_N,
        chain.damping, float(chain.alpha) if chain.alpha else None, np.zeros(len(reach_m) + 1),
        np.zeros(len(reach_m)), attraction, local_damping, time_step_s, steps_per_sample,
        motion.force_N, motion.displacement_m, motion.velocity_m_s,
    )  # fmt: skip
    return Motion(motion.force_N, motion.displacement_m - height_m, motion.velocity_m_s)
