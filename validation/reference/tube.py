"""Velocity Verlet for beads in a tube, in three dimensions with spin: the scheme of the codes.

Forces at step n follow from positions at n and velocities and spins at n - 1/2. Then ``v += dt F/m``, ``x += dt v``,
and the spin is advanced in the same way with the inertia ``2/5 m r^2``. Normal forces follow ``hertz_chain`` along the
lines of centres. The tangential force follows one of three laws:

* total: the contact stores the shear displacement, projected onto the present tangent plane; the force is the whole
  displacement times the present stiffness (LIGGGHTS' ``tangential history``);
* incremental: the contact stores the force, rotated with the contact, and adds the displacement of each step times the
  present stiffness (YADE's ``Law2_ScGeom_MindlinPhys_Mindlin`` and ``ScGeom::rotate``);
* turned: as total, but before the displacement of a step is added, the stored one is turned into the present tangent
  plane at its full length, and surfaces have the speeds of whole radii (LAMMPS' ``tangential mindlin``).

All laws limit the force, and scale the stored vector accordingly, to the coefficient of friction times the normal
force. A contact that opens loses the stored vector.
"""

import numpy as np

from validation.reference.hertz_chain import NEVER, Extremes, Flag, TubeChain, TubeMotion, check_timing

LAWS = TOTAL, INCREMENTAL, TURNED = "total", "incremental", "turned"


def integrate_tube(
    chain: TubeChain,
    time_step_s: float,
    steps_per_sample: int,
    samples: int,
    law: str = TOTAL,
    stop: Flag = NEVER,
    *,
    extremes: bool = False,
) -> TubeMotion:
    """Integrates from time 0 and samples the motion every ``steps_per_sample`` steps, beginning at time 0.

    ``law`` is the law of the tangential force, one of ``LAWS``. With ``extremes`` it ends at a blow-up.

    Raises:
        ValueError: the step is not above zero, a count is below one, or the law is unknown.
    """
    check_timing(time_step_s, steps_per_sample, samples)
    if law not in LAWS:
        raise ValueError(f"law: {law}, expected {', '.join(LAWS)}")
    from validation.reference import tube_kernels as rows

    n = chain.mass_kg.size
    turning = np.isfinite(chain.radius_m) & chain.turns
    inertia = np.where(turning, 0.4 * chain.mass_kg * chain.radius_m**2, np.inf)
    bodies = np.array([chain.mass_kg, chain.radius_m, chain.stiffness, chain.damping, chain.shear, chain.load_N,
                       chain.bore_stiffness, chain.bore_shear, inertia])  # fmt: skip
    numbers = float(chain.wall_m), float(chain.friction), float(chain.bore_m), float(chain.bore_friction)
    state, marks = np.zeros((rows.BORE_NORMAL + 1, n, 3)), np.zeros((rows.BORE_OVERLAP + 1, n))
    state[rows.PLACE], state[rows.VELOCITY] = chain.place_m, chain.velocity_m_s
    energies = np.array([0.0, 0.0, np.nan, 0.0] if extremes else [])
    forces, kept = np.empty((samples, n)), np.empty((4, samples, n, 3))
    timing = (LAWS.index(law), time_step_s, steps_per_sample)
    rows.run_tube(bodies, numbers, state, marks, energies, *timing, forces, kept, stop)
    reached = None
    if extremes:
        kinetic, _, _, risen = energies.tolist() if energies[0] < np.inf else [np.nan] * 4
        reached = Extremes(marks[rows.OVERLAP], marks[rows.BORE_OVERLAP], np.zeros(n), kinetic, risen)
    return TubeMotion(forces, kept[0], kept[1], kept[2], kept[3], reached)
