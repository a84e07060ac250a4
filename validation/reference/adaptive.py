"""The exact reference: adaptive 8th order (DOP853) in overlaps and velocities, with dense output."""

import numpy as np
from numba import njit
from scipy.integrate import solve_ivp

from validation.reference.hertz_chain import Array, HertzChain, Motion, displacements, hertz_force

RELATIVE_TOLERANCE = 1e-12
ABSOLUTE_SHARE = 1e-13  # absolute tolerance, as a share of the largest overlap and speed to be expected


def integrate_adaptive(chain: HertzChain, time_s: Array) -> Motion:
    """Integrates from ``time_s[0]`` = 0 to the last of the increasing sample times.

    Raises:
        ValueError: sample times that do not begin at 0 or do not increase.
        ArithmeticError: the integrator gave up.
    """
    time_s = np.asarray(time_s, dtype=float)
    if time_s.ndim != 1 or not time_s.size or time_s[0] != 0 or (np.diff(time_s) <= 0).any():
        raise ValueError("time_s: expected increasing times that begin at 0")
    n = chain.mass_kg.size
    overlap_scale, speed_scale = _scales(chain, float(time_s[-1]))
    result = solve_ivp(
        _derivative,
        (0.0, time_s[-1] if time_s.size > 1 else 1e-300),
        np.concatenate([chain.overlap_m, chain.velocity_m_s]),
        method="DOP853",
        t_eval=time_s,
        rtol=RELATIVE_TOLERANCE,
        atol=ABSOLUTE_SHARE * np.repeat([overlap_scale, speed_scale], n),
        args=(chain.mass_kg, chain.stiffness, chain.load_N),
    )
    if not result.success:
        raise ArithmeticError(f"the adaptive reference gave up: {result.message}")
    overlap, velocity = result.y[:n].T, result.y[n:].T
    return Motion(hertz_force(chain.stiffness, overlap), displacements(chain, overlap), velocity)


@njit(cache=True)
def _derivative(_: float, state: Array, mass: Array, stiffness: Array, load: Array) -> Array:
    n = mass.size
    change = np.empty(2 * n)
    below, force = 0.0, 0.0
    for j in range(n):
        change[j] = below - state[n + j]
        below = state[n + j]
        overlap = state[j]
        force = stiffness[j] * overlap * np.sqrt(overlap) if overlap > 0.0 else 0.0
        change[n + j] = (force + load[j]) / mass[j]
        if j:
            change[n + j - 1] -= force / mass[j - 1]
    return change


def _scales(chain: HertzChain, duration_s: float) -> tuple[float, float]:
    """Overlap and speed that the motion will reach, for the absolute tolerance.

    An impact at speed v compresses a contact by about (m v^2 / k)^(2/5).
    """
    speed = float(np.abs(chain.velocity_m_s).max())
    fall = float(np.abs(chain.load_N / chain.mass_kg).max()) * duration_s
    overlap = float(np.maximum(chain.overlap_m, 0.0).max())
    stiff, mass = float(chain.stiffness.max()), float(chain.mass_kg.max())
    if stiff > 0:
        speed = speed or min(fall, float(np.sqrt(stiff * overlap**2.5 / mass)))
        overlap = max(overlap, (mass * speed**2 / stiff) ** 0.4)
    return overlap or 1e-12, speed or fall or 1e-12
