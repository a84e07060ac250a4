"""The exact reference: adaptive order 8 that knows when contacts open and close.

The state is overlaps and velocities, so that nothing cancels; it and the clock carry what rounding leaves out of them.
Steps are those of ``dop853``: in ``s = (t - t_e)^(1/power)`` after the last event t_e, with a power of 2 of elastic
chains and of 4 of those that lose energy. A step in which a contact closes, opens or, losing energy, lets go before
it opens is ended right there; one that ends in an elastic opening runs in ``s = (t_e - t)^(1/2)``. By the power law
(``power_law_events``) a step is also ended where the closing speed of a contact changes its sign, and runs towards
that in ``s = (t_e - t)^(1/4)``.
"""

from math import sqrt
from typing import Any

import numpy as np

from validation.reference.hertz_chain import (
    ENERGY_SHARE,
    EXPONENT,
    Array,
    HertzChain,
    Motion,
    contact_force,
    displacements,
)

LEAST_TOLERANCE = 1e-12  # what double precision gives with a margin: measured errors end near 1e-14
LOCAL_SHARE = 0.002  # local tolerance over the one asked for: light and loose beads multiply errors some thousandfold
FIRST_STEP = 1e-3  # of the time scale


def integrate_adaptive(chain: HertzChain, time_s: Array, tolerance: float = LEAST_TOLERANCE) -> Motion:
    """Integrates from time 0 with samples at ``time_s``, increasing from 0.

    The largest force error over all contacts and samples stays below ``tolerance`` times the largest force, as
    long as the motion itself does not multiply small errors more than thousandfold (a chain that bounces on for long
    is chaotic; ``own_error_N`` of ``validation.accuracy.schemes`` measures what is left).

    Raises:
        ValueError: sample times that do not begin at 0 or do not increase, a tolerance below what double
            precision can give or not below 1.
        ArithmeticError: the motion cannot be followed.
    """
    time_s = np.ascontiguousarray(time_s, dtype=float)
    if time_s.ndim != 1 or not time_s.size or time_s[0] != 0 or not (np.diff(time_s) > 0).all():
        raise ValueError("time_s: expected increasing times that begin at 0")
    if not np.isfinite(time_s[-1]):
        raise ValueError("time_s: not finite")
    if not LEAST_TOLERANCE <= tolerance < 1:
        raise ValueError(f"tolerance: {tolerance:g}, expected from {LEAST_TOLERANCE:g} to below 1")
    from validation.reference.adaptive_kernels import follow

    n = chain.mass_kg.size
    overlap_scale, speed_scale = scales(chain, float(time_s[-1]))
    start, scale = np.concatenate([chain.overlap_m, chain.velocity_m_s]), np.repeat([overlap_scale, speed_scale], n)
    damping = np.zeros(0) if chain.elastic else chain.damping
    bodies: tuple[Any, ...] = (1.0 / chain.mass_kg, chain.stiffness, damping, chain.load_N / chain.mass_kg)
    if chain.alpha:
        bodies = (*bodies, float(chain.alpha), np.zeros(n))
    first = FIRST_STEP * overlap_scale / speed_scale
    states, done = follow(start, time_s, bodies, LOCAL_SHARE * tolerance, scale, first)
    if not done or not np.isfinite(states).all():
        raise ArithmeticError("the adaptive reference cannot follow this motion: its steps shrink to nothing")
    overlap, velocity = np.ascontiguousarray(states[:, :n]), np.ascontiguousarray(states[:, n:])
    return Motion(contact_force(chain, overlap, velocity), displacements(chain, overlap), velocity)


def scales(chain: HertzChain, duration_s: float) -> tuple[float, float]:
    """Overlap and speed to measure errors by: those that the energy put in can reach.

    The energy is kinetic and elastic at time 0, and what the loads do by closing gaps.
    """
    energy = 0.5 * float(chain.mass_kg @ chain.velocity_m_s**2)
    energy += ENERGY_SHARE * float(chain.stiffness @ np.maximum(chain.overlap_m, 0.0) ** (1 + EXPONENT))
    fallen = np.minimum(
        np.cumsum(np.maximum(-chain.overlap_m, 0.0)), np.abs(chain.load_N) / chain.mass_kg * duration_s**2
    )
    energy += float(np.abs(chain.load_N) @ fallen)
    if energy == 0.0:  # nothing moves, or all fall together
        energy = float((chain.load_N**2 / chain.mass_kg).sum()) * duration_s**2 or 1e-300
    stiffest = float(chain.stiffness.max()) or 1.0
    return ((1 + EXPONENT) * energy / stiffest) ** ENERGY_SHARE, sqrt(2.0 * energy / float(chain.mass_kg.max()))
