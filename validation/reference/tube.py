"""Velocity Verlet of beads in a tube, in three dimensions with spin: the scheme of LIGGGHTS and YADE.

Forces at step n follow from places at n and velocities and spins at n - 1/2, then ``v += dt F/m``, ``x += dt v`` and
likewise the spin with the inertia ``2/5 m r^2``. Normal forces are those of ``hertz_chain`` along the lines of centres;
friction's law is one of two:

* total: the shear displacement is kept, projected onto the present tangent plane, and the force is all of it times the
  present stiffness (LIGGGHTS' ``tangential history``);
* incremental: the force is kept, turned with the contact, and gets each step's displacement times the present
  stiffness (YADE's ``Law2_ScGeom_MindlinPhys_Mindlin`` and ``ScGeom::rotate``).

Both cut the force, and with it what is kept, back to friction times the normal force; contacts that open forget it.
"""

from functools import partial

import numpy as np

from validation.reference.hertz_chain import Extremes, TubeChain, TubeMotion, check_timing

TOTAL, INCREMENTAL = "total", "incremental"


def integrate_tube(
    chain: TubeChain, time_step_s: float, steps_per_sample: int, samples: int, law: str = TOTAL
) -> TubeMotion:
    """Integrates from time 0 and keeps the motion every ``steps_per_sample`` steps, the first at time 0.

    Friction follows the ``total`` or the ``incremental`` law.

    Raises:
        ValueError: a step not above zero, counts below one, or another law.
    """
    check_timing(time_step_s, steps_per_sample, samples)
    if law not in (TOTAL, INCREMENTAL):
        raise ValueError(f'law: {law}, expected "{TOTAL}" or "{INCREMENTAL}"')
    from validation.reference.tube_kernels import run_tube

    n = chain.mass_kg.size
    bodies = (chain.mass_kg, chain.radius_m, chain.stiffness, chain.damping, chain.shear, chain.load_N,
              chain.bore_stiffness, chain.bore_shear)  # fmt: skip
    numbers = (float(chain.wall_m), float(chain.friction), float(chain.bore_m), float(chain.bore_friction))
    turning = np.isfinite(chain.radius_m) & chain.turns
    inertia = np.where(turning, 0.4 * chain.mass_kg * chain.radius_m**2, np.inf)
    rows, flat = partial(np.zeros, (n, 3)), partial(np.zeros, n)
    place, velocity = chain.place_m.copy(), chain.velocity_m_s.copy()
    state = (place, velocity, rows(), rows(), rows(), rows(), flat())
    marks = (flat(), flat(), flat(), flat(), flat(), flat(), flat())
    memory = (rows(), rows(), rows(), rows())
    forces, kept = np.empty((samples, n)), np.empty((4, samples, n, 3))
    timing = (law == INCREMENTAL, time_step_s, steps_per_sample)
    run_tube(bodies, inertia, numbers, state, memory, marks, *timing, forces, kept)
    extremes = Extremes(marks[0], marks[1], marks[3], marks[4], marks[6])
    return TubeMotion(forces, kept[0], kept[1], kept[2], kept[3], extremes)
