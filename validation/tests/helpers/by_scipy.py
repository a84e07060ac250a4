"""Independent motion of chains by scipy's DOP853, whose step control finds the kinks and jumps of forces."""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

from validation.reference.hertz_chain import HertzChain

Array = NDArray[np.float64]
RTOL, ATOL = 1e-13, 1e-14  # ATOL of the largest overlap and speed


def forces_at(chain: HertzChain, times_s: Array, drive: Callable[[float], float] | None = None) -> Array:
    """Contact forces at increasing times. Shape (times, contacts).

    ``drive`` is the force on the driven body by time, or its velocity if its motion is prescribed.
    """
    n, power = chain.mass_kg.size, 0.0 if chain.alpha else chain.overlap_power

    def velocities(time: float, state: Array) -> Array:
        velocity = state[n:].copy()
        if drive and chain.drive and chain.drive.prescribed:
            velocity[chain.drive.body] = drive(time)
        return velocity

    def contacts(overlap: Array, closing: Array) -> Array:
        touches, deep = (overlap > 0) | ((overlap == 0) & (closing > 0)), np.maximum(overlap, 0)
        lost = chain.damping * deep**power * np.sign(closing) * np.abs(closing) ** (chain.alpha or 1)
        held = np.maximum(chain.stiffness * deep**1.5 + lost, 0)
        return np.where(touches & (chain.stiffness > 0), held, 0.0)

    def rate(time: float, state: Array) -> Array:
        closing = -np.diff(velocities(time, state), prepend=0.0)
        force = contacts(state[:n], closing)
        net = force - np.append(force[1:], 0.0) + chain.load_N
        if drive and chain.drive and not chain.drive.prescribed:
            net[chain.drive.body] += drive(time)
        return np.concatenate([closing, net / chain.mass_kg])

    speed = max(float(np.abs(chain.velocity_m_s).max()), 1e-3)
    length = (1.25 * chain.mass_kg.max() * speed**2 / chain.stiffness.max()) ** 0.4
    start, scales = np.concatenate([chain.overlap_m, chain.velocity_m_s]), np.repeat([length, speed], n)
    solved = solve_ivp(rate, (0, times_s[-1]), start, "DOP853", times_s, rtol=RTOL, atol=ATOL * scales)
    states = zip(times_s, solved.y.T, strict=True)
    return np.array([contacts(state[:n], -np.diff(velocities(time, state), prepend=0.0)) for time, state in states])
