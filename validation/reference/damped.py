"""The exact reference of chains whose contacts lose energy: DOP853 in plain time, with steps as small as it takes.

The force ``max(0, k d^(3/2) + C d^(1/4) d')`` rises like ``(t - t_e)^(1/4)`` when a contact closes, and is cut off
before it opens. No stretched time makes both smooth, and none is needed: at such an event steps shrink to some 1e-11 of
a contact's time and grow again, up to sixfold each, which takes tens of steps an event. Every sample ends a step.
"""

from math import sqrt

import numpy as np
from numba import njit

from validation.reference.contact_kernels import damped_force
from validation.reference.dop853 import E3, E5, STAGES, A, B, combine
from validation.reference.hertz_chain import Array

LEAST_TOLERANCE = 1e-11  # of the largest force: what is reached at best, measured 7.6e-12 on eight damped scenes
LOCAL_SHARE = 5e-4  # local tolerance over the one asked for: measured global errors are 20 to 1000 times the local one
MOST_REJECTED = 400  # in a row


@njit(cache=True, error_model="numpy")
def slope(
    state: Array, result: Array, inverse_mass: Array, stiffness: Array, damping: Array, acceleration: Array
) -> None:
    """Writes ``dy/dt`` to ``result``; a state holds overlaps, then velocities, ``acceleration`` is the loads' alone."""
    n = inverse_mass.size
    below, force_below = 0.0, 0.0
    for j in range(n):
        overlap, velocity = state[j], state[n + j]
        closing = below - velocity
        result[j] = closing
        below = velocity
        force = 0.0
        if overlap > 0.0:
            force = damped_force(stiffness[j], damping[j], overlap, closing)
        if j > 0:
            result[n + j - 1] = (force_below - force) * inverse_mass[j - 1] + acceleration[j - 1]
        force_below = force
    result[2 * n - 1] = force_below * inverse_mass[n - 1] + acceleration[n - 1]


@njit(cache=True, error_model="numpy")
def integrate(
    start: Array, times: Array, inverse_mass: Array, stiffness: Array, damping: Array, acceleration: Array,
    tolerance: float, scale: Array, first_step: float,
) -> tuple[Array, bool]:  # fmt: skip
    """States at all times, shape (samples, 2 bodies), and whether it got there.

    Local errors of each step stay below ``tolerance`` times ``scale``, shape (2 bodies,).
    """
    size = start.size
    state, end = start.copy(), np.empty(size)
    slopes = np.zeros((STAGES + 1, size))
    samples = np.empty((times.size, size))
    samples[0] = state
    time, h = 0.0, first_step
    slope(state, slopes[0], inverse_mass, stiffness, damping, acceleration)
    for sample in range(1, times.size):
        rejected = 0
        while time < times[sample]:
            left = times[sample] - time
            last = h >= left * (1.0 - 1e-9)
            taken = left if last else h
            for stage in range(1, STAGES):
                combine(state, taken, A[stage], stage, slopes, end)
                slope(end, slopes[stage], inverse_mass, stiffness, damping, acceleration)
            combine(state, taken, B, STAGES, slopes, end)
            slope(end, slopes[STAGES], inverse_mass, stiffness, damping, acceleration)
            e = _error(taken, slopes, scale) / tolerance
            if not e <= 1.0:
                rejected += 1
                if rejected > MOST_REJECTED or time + taken == time:
                    return samples, False
                h = taken * (max(0.2, 0.9 * e**-0.125) if e < 1e300 else 0.2)
                continue
            rejected = 0
            grown = taken * (min(6.0, max(0.333, 0.9 * e**-0.125)) if e > 0.0 else 6.0)
            h = max(h, grown) if last else grown
            time = times[sample] if last else time + taken
            state[:] = end
            slopes[0] = slopes[STAGES]
        samples[sample] = state
    return samples, True


@njit(cache=True, error_model="numpy")
def _error(h: float, slopes: Array, scale: Array) -> float:
    """Largest local error over its scale, by the two embedded formulas."""
    largest = 0.0
    for i in range(scale.size):
        fifth, third = 0.0, 0.0
        for row in range(STAGES + 1):
            fifth += E5[row] * slopes[row, i]
            third += E3[row] * slopes[row, i]
        if fifth != 0.0:
            ratio = third / fifth
            estimate = abs(h * fifth) / sqrt(1.0 + 0.01 * ratio * ratio) / scale[i]
            if not estimate <= largest:  # a NaN counts as largest
                largest = estimate
    return largest
