"""What the rounding of absolute coordinates does to a case, measured with the engines' own scheme."""

import numpy as np

from drivers.case import Case
from drivers.chain import Array
from validation.arrays import arrays_of
from validation.reference.verlet import integrate_verlet, integrate_verlet_absolute


def rounding_error(case: Case) -> Array:
    """Largest force difference at each sample between Verlet in heights and in overlaps, in N. Shape (samples,).

    Both do the same arithmetic but for the rounding of heights: a few 1e-18 m a step, which slow beads gather
    and a chaotic chain multiplies.
    """
    scene, chain = case.scene, case.chain
    arrays = arrays_of(chain)
    radius = np.where(np.isinf(chain.radius_m), 0.0, chain.radius_m)
    reach = radius + np.concatenate([[chain.wall_height_m], radius[:-1]])
    timing = (scene.time_step_s, scene.steps_per_sample, scene.samples)
    exact = integrate_verlet(arrays, *timing).force_N
    rounded = integrate_verlet_absolute(arrays, chain.height_m, reach, *timing)
    return np.asarray(np.abs(rounded - exact).max(axis=1))
