"""The exact reference: an adaptive method of order 8 that locates the opening and closing of contacts.

The state consists of overlaps and velocities, which avoids cancellation. State and time are compensated for rounding
(Kahan). Steps are those of ``dop853``, in ``s = (t - t_e)^(1/power)`` after the last event t_e, with power 2 for
elastic and power 4 for dissipative chains. A step ends at each event: a contact closes, opens or, if dissipative,
releases (its force reaches zero before the overlap does). A step that ends in an elastic opening runs in
``s = (t_e - t)^(1/2)``. With the power law (``power_law_events``) a step also ends where the closing speed of a contact
changes sign, and runs in ``s = (t_e - t)^(1/4)``.
"""

from math import sqrt
from typing import Any

import numpy as np

from validation.reference.hertz_chain import (
    ENERGY_SHARE,
    EXPONENT,
    Array,
    Flag,
    HertzChain,
    Motion,
    contact_force,
    displacements,
)

MIN_TOLERANCE = 1e-12  # attainable in double precision with a margin: the smallest measured errors are near 1e-14
LOCAL_SHARE = 0.002  # local over requested tolerance: light or loose beads amplify errors about a thousandfold
FIRST_STEP = 1e-3  # share of the time scale


def integrate_adaptive(
    chain: HertzChain, time_s: Array, tolerance: float = MIN_TOLERANCE, stop: Flag | None = None
) -> Motion:
    """Integrates from time 0 and samples the motion at ``time_s``, which begins at 0.

    The largest force error over all contacts and samples stays below ``tolerance`` times the largest force if the
    motion amplifies small errors at most a thousandfold. A chain that bounces for long is chaotic;
    ``error_N`` of ``validation.accuracy.exact_motion`` measures the remaining error.

    Raises:
        ValueError: sample times do not begin at 0 or do not increase; the tolerance is below ``MIN_TOLERANCE`` or not
            below 1.
        ArithmeticError: the step size becomes too small.
    """
    time_s = np.ascontiguousarray(time_s, dtype=float)
    if time_s.ndim != 1 or not time_s.size or time_s[0] != 0 or not (np.diff(time_s) > 0).all():
        raise ValueError("time_s: expected increasing times that begin at 0")
    if not np.isfinite(time_s[-1]):
        raise ValueError("time_s: not finite")
    if not MIN_TOLERANCE <= tolerance < 1:
        raise ValueError(f"tolerance: {tolerance:g}, expected from {MIN_TOLERANCE:g} to below 1")
    from validation.reference.adaptive_kernels import fill_states

    n = chain.mass_kg.size
    overlap_scale, speed_scale = scales(chain, float(time_s[-1]))
    start, scale = np.concatenate([chain.overlap_m, chain.velocity_m_s]), np.repeat([overlap_scale, speed_scale], n)
    damping = np.zeros(0) if chain.elastic else chain.damping
    bodies: tuple[Any, ...] = (1.0 / chain.mass_kg, chain.stiffness, damping, chain.load_N / chain.mass_kg)
    bodies += (float(chain.alpha), np.zeros(n)) if chain.alpha else (float(chain.overlap_power),)
    first = FIRST_STEP * overlap_scale / speed_scale
    stop = np.zeros(1, bool) if stop is None else stop
    states = np.empty((time_s.size, start.size))
    done = fill_states(states, start, time_s, bodies, LOCAL_SHARE * tolerance, scale, first, stop)
    if not done or not np.isfinite(states).all():
        raise ArithmeticError("the adaptive reference cannot integrate this motion: its steps become too small")
    overlap, velocity = np.ascontiguousarray(states[:, :n]), np.ascontiguousarray(states[:, n:])
    return Motion(contact_force(chain, overlap, velocity), displacements(chain, overlap), velocity)


def scales(chain: HertzChain, duration_s: float) -> tuple[float, float]:
    """Scales of overlap and speed for errors: the values that the available energy can produce.

    This energy is the kinetic and elastic energy at time 0 and the work of the loads while gaps close.
    """
    energy = 0.5 * float(chain.mass_kg @ chain.velocity_m_s**2)
    energy += ENERGY_SHARE * float(chain.stiffness @ np.maximum(chain.overlap_m, 0.0) ** (1 + EXPONENT))
    fallen = np.minimum(
        np.cumsum(np.maximum(-chain.overlap_m, 0.0)), np.abs(chain.load_N) / chain.mass_kg * duration_s**2
    )
    energy += float(np.abs(chain.load_N) @ fallen)
    if energy == 0.0:  # all bodies are at rest, or all fall together
        energy = float((chain.load_N**2 / chain.mass_kg).sum()) * duration_s**2 or 1e-300
    stiffest = float(chain.stiffness.max()) or 1.0
    return ((1 + EXPONENT) * energy / stiffest) ** ENERGY_SHARE, sqrt(2.0 * energy / float(chain.mass_kg.max()))
