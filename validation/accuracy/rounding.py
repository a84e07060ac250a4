"""What the rounding of absolute coordinates does to a case, measured with the engines' own scheme."""

import numpy as np

from drivers.chain.case import Case
from drivers.chain.chain import Array, sphere_for_face
from drivers.chain.integrator_arrays import arrays_of
from drivers.chain.trace import Trace
from validation.accuracy.error_measures import trace_of, verlet_of
from validation.reference.velocity_verlet import integrate_verlet_absolute

ROUNDING_MARGIN = 10.0  # engines add in another order than the in-repo scheme: rounding of the same size, not the same
HORIZON = 1e-6  # where rounding alone makes this much, pointwise comparison of engines ends


def comparable(rounding_share: Array) -> tuple[float, int]:
    """What rounding alone lets two engines differ by, of the largest force, and for how many samples that is small.

    Args:
        rounding_share: what rounding does to the forces at each sample, over the largest force. Shape (samples,).
    """
    allowed = ROUNDING_MARGIN * np.maximum.accumulate(rounding_share)
    samples = max(1, int(np.searchsorted(allowed, ROUNDING_MARGIN * HORIZON, side="right")))
    return float(allowed[samples - 1]), samples


def heights_and_reach(case: Case) -> tuple[Array, Array]:
    """Heights at time 0, and the distances at which neighbours (body 1 and the height 0) just touch. Shape (bodies,).

    A damped flat face is the large sphere that LIGGGHTS has to take it for.
    """
    chain = case.chain
    flat = np.isinf(chain.radius_m)
    face = sphere_for_face(case.scene, chain)[0] if flat.any() and chain.damping_ratio else 0.0
    radius = np.where(flat, face, chain.radius_m)
    reach = radius + np.concatenate([[chain.wall_height_m], radius[:-1]])
    return np.asarray(chain.height_m + np.where(flat, face, 0.0)), np.asarray(reach)


def verlet_in_heights(case: Case) -> Trace:
    """The case by the scheme of the codes at its step, with absolute heights as its state, as engines hold them."""
    scene, chain = case.scene, case.chain
    height, reach = heights_and_reach(case)
    timing = (scene.time_step_s, scene.steps_per_sample, scene.samples)
    motion = integrate_verlet_absolute(arrays_of(chain), height, reach, *timing)
    return trace_of(case, case.sample_times_s, motion)


def rounding_error(case: Case) -> Array:
    """Largest force difference at each sample between Verlet in heights and in overlaps, in N. Shape (samples,).

    Both do the same arithmetic but for the rounding of heights: a few 1e-18 m a step, which slow beads gather
    and a chaotic chain multiplies.
    """
    return np.asarray(np.abs(verlet_in_heights(case).force_N - verlet_of(case).force_N).max(axis=1))


def rounding_of_heights(case: Case) -> Array:
    """Likewise the largest difference of heights at each sample, in m. Shape (samples,)."""
    heights, overlaps = (np.asarray(scheme(case).height_m) for scheme in (verlet_in_heights, verlet_of))
    return np.asarray(np.abs(heights - overlaps).max(axis=1))
