"""One step of DOP853 (Dormand and Prince, order 8) for a Hertz chain, in plain or in stretched time.

Forces go with overlap^(3/2), so where a contact opens or closes at time t_e the motion is smooth in
``s = sqrt|t - t_e|`` but not in t. Steps of elastic chains therefore run in s: with ``t = t_e + sign s^2`` the
equations are ``dy/ds = 2 sign s f(y)``, and the method keeps its order through the event. A sign of 0 is plain time.

A state y holds the overlaps, then the velocities. Coefficients are scipy's.
"""

from math import sqrt

import numpy as np
from numba import njit
from scipy.integrate import DOP853

from validation.reference.contact_kernels import damped_force, elastic_force
from validation.reference.hertz_chain import Array

STAGES = 12
ROWS = 16  # stages, the slope at the end, and three more for dense output
A = np.zeros((ROWS, ROWS))
A[:STAGES, :STAGES], A[STAGES, :STAGES], A[STAGES + 1 :] = DOP853.A, DOP853.B, DOP853.A_EXTRA
B = np.array(DOP853.B)
C = np.concatenate([DOP853.C, [1.0], DOP853.C_EXTRA])
D = np.ascontiguousarray(DOP853.D)
E3 = np.array(DOP853.E3)
E5 = np.array(DOP853.E5)
# inverse masses, stiffness, damping (empty of an elastic chain), acceleration by the loads alone
Bodies = tuple[Array, Array, Array, Array]


@njit(cache=True, error_model="numpy")
def slope(state: Array, stretch: float, result: Array, bodies: Bodies) -> None:
    """Writes ``stretch * dy/dt`` to ``result``."""
    inverse_mass, stiffness, damping, acceleration = bodies
    n, damped = inverse_mass.size, damping.size > 0
    below, force_below = 0.0, 0.0
    for j in range(n):
        overlap, velocity = state[j], state[n + j]
        closing = below - velocity
        result[j] = stretch * closing
        below = velocity
        force = 0.0
        if overlap > 0.0:
            if damped:
                force = damped_force(stiffness[j], damping[j], overlap, closing)
            else:
                force = elastic_force(stiffness[j], overlap)
        if j > 0:
            result[n + j - 1] = stretch * ((force_below - force) * inverse_mass[j - 1] + acceleration[j - 1])
        force_below = force
    result[2 * n - 1] = stretch * (force_below * inverse_mass[n - 1] + acceleration[n - 1])


@njit(cache=True, error_model="numpy", forceinline=True)
def _stretch(s: float, sign: float) -> float:
    """``dt/ds``; 1 in plain time."""
    return 2.0 * sign * s if sign != 0.0 else 1.0


@njit(cache=True, error_model="numpy")
def combine(state: Array, h: float, weights: Array, rows: int, slopes: Array, result: Array) -> None:
    """Writes ``state + h * weights @ slopes`` to ``result``."""
    result[:] = 0.0
    for row in range(rows):
        weight = h * weights[row]
        if weight != 0.0:
            for i in range(state.size):
                result[i] += weight * slopes[row, i]
    for i in range(state.size):
        result[i] += state[i]


@njit(cache=True, error_model="numpy")
def step(state: Array, s: float, h: float, sign: float, slopes: Array, result: Array, bodies: Bodies) -> None:
    """One step from s to s + h; writes the new state to ``result`` and fills the stages of ``slopes``.

    In plain time the first slope is given: that at the end of the step before.
    """
    if sign != 0.0:
        slope(state, _stretch(s, sign), slopes[0], bodies)
    for stage in range(1, STAGES):
        combine(state, h, A[stage], stage, slopes, result)
        slope(result, _stretch(s + C[stage] * h, sign), slopes[stage], bodies)
    combine(state, h, B, STAGES, slopes, result)


@njit(cache=True, error_model="numpy")
def error(end: Array, s_end: float, h: float, sign: float, slopes: Array, scale: Array, bodies: Bodies) -> float:
    """Largest local error over its scale, by the two embedded formulas; fills the slope at the end."""
    slope(end, _stretch(s_end, sign), slopes[STAGES], bodies)
    largest = 0.0
    for i in range(end.size):
        fifth, third = 0.0, 0.0
        for row in range(STAGES + 1):
            fifth += E5[row] * slopes[row, i]
            third += E3[row] * slopes[row, i]
        if fifth != 0.0:
            ratio = third / fifth  # squares of what a wave has barely reached underflow
            estimate = abs(h * fifth) / sqrt(1.0 + 0.01 * ratio * ratio) / scale[i]
            if not estimate <= largest:  # a NaN counts as largest
                largest = estimate
    return largest


@njit(cache=True, error_model="numpy")
def step_factor(error: float) -> float:
    """Next step over this one, by this one's error over the tolerance: below 1 where it is to be repeated."""
    if not error < 1e300:
        return 0.2
    if error > 1.0:
        return float(max(0.2, 0.9 * error**-0.125))
    return float(min(6.0, max(0.333, 0.9 * error**-0.125))) if error > 0.0 else 6.0


@njit(cache=True, error_model="numpy")
def prepare_dense(
    start: Array, end: Array, s: float, h: float, sign: float, slopes: Array, dense: Array, work: Array, bodies: Bodies
) -> None:
    """Fills the seven rows of ``dense`` for a step whose stages and end slope stand in ``slopes``."""
    for row in range(STAGES + 1, ROWS):
        combine(start, h, A[row], row, slopes, work)
        slope(work, _stretch(s + C[row] * h, sign), slopes[row], bodies)
    for i in range(start.size):
        change = end[i] - start[i]
        dense[0, i] = change
        dense[1, i] = h * slopes[0, i] - change
        dense[2, i] = 2.0 * change - h * (slopes[STAGES, i] + slopes[0, i])
        for row in range(4):
            total = 0.0
            for column in range(ROWS):
                total += D[row, column] * slopes[column, i]
            dense[3 + row, i] = h * total


@njit(cache=True, error_model="numpy")
def evaluate_dense(start: Array, dense: Array, x: float, result: Array) -> None:
    """Writes the state at the share x of the step to ``result``; the interpolant is of order 7."""
    for i in range(start.size):
        value = dense[6, i] * x
        value = (value + dense[5, i]) * (1.0 - x)
        value = (value + dense[4, i]) * x
        value = (value + dense[3, i]) * (1.0 - x)
        value = (value + dense[2, i]) * x
        value = (value + dense[1, i]) * (1.0 - x)
        result[i] = start[i] + (value + dense[0, i]) * x
