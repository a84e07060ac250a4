"""One step of DOP853 (Dormand and Prince, order 8) for a Hertz chain, in a stretched time.

Forces go with overlap^(3/2), so where a contact opens or closes at time t_e the motion is smooth in
``s = sqrt|t - t_e|`` but not in t. Steps therefore run in s: with ``t = t_e + sign s^2`` the equations are
``dy/ds = 2 sign s f(y)``, and the method keeps its order through the event.

A state y holds the overlaps, then the velocities. Coefficients are scipy's.
"""

from math import sqrt

import numpy as np
from numba import njit
from scipy.integrate._ivp import dop853_coefficients as tableau

from validation.reference.contact_kernels import elastic_force
from validation.reference.hertz_chain import Array

STAGES = 12
ROWS = 16  # stages, the slope at the end, and three more for dense output
A = np.ascontiguousarray(tableau.A)
B = np.array(tableau.B)
C = np.array(tableau.C)
D = np.ascontiguousarray(tableau.D)
E3 = np.array(tableau.E3)
E5 = np.array(tableau.E5)


@njit(cache=True, error_model="numpy")
def slope(
    state: Array, stretch: float, result: Array, inverse_mass: Array, stiffness: Array, acceleration: Array
) -> None:
    """Writes ``stretch * dy/dt`` to ``result``; ``acceleration`` is that of the loads alone."""
    n = inverse_mass.size
    below, force_below = 0.0, 0.0
    for j in range(n):
        overlap, velocity = state[j], state[n + j]
        result[j] = stretch * (below - velocity)
        below = velocity
        force = elastic_force(stiffness[j], overlap) if overlap > 0.0 else 0.0
        if j > 0:
            result[n + j - 1] = stretch * ((force_below - force) * inverse_mass[j - 1] + acceleration[j - 1])
        force_below = force
    result[2 * n - 1] = stretch * (force_below * inverse_mass[n - 1] + acceleration[n - 1])


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
def step(
    state: Array, s: float, h: float, sign: float, slopes: Array, result: Array,
    inverse_mass: Array, stiffness: Array, acceleration: Array,
) -> None:  # fmt: skip
    """One step from s to s + h; writes the new state to ``result`` and fills the stages of ``slopes``."""
    slope(state, 2.0 * sign * s, slopes[0], inverse_mass, stiffness, acceleration)
    for stage in range(1, STAGES):
        combine(state, h, A[stage], stage, slopes, result)
        slope(result, 2.0 * sign * (s + C[stage] * h), slopes[stage], inverse_mass, stiffness, acceleration)
    combine(state, h, B, STAGES, slopes, result)


@njit(cache=True, error_model="numpy")
def error(
    end: Array, s_end: float, h: float, sign: float, slopes: Array, scale: Array,
    inverse_mass: Array, stiffness: Array, acceleration: Array,
) -> float:  # fmt: skip
    """Largest local error over its scale, by the two embedded formulas; fills the slope at the end."""
    slope(end, 2.0 * sign * s_end, slopes[STAGES], inverse_mass, stiffness, acceleration)
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
def prepare_dense(
    start: Array, end: Array, s: float, h: float, sign: float, slopes: Array, dense: Array, work: Array,
    inverse_mass: Array, stiffness: Array, acceleration: Array,
) -> None:  # fmt: skip
    """Fills the seven rows of ``dense`` for a step whose stages and end slope stand in ``slopes``."""
    for row in range(STAGES + 1, ROWS):
        combine(start, h, A[row], row, slopes, work)
        slope(work, 2.0 * sign * (s + C[row] * h), slopes[row], inverse_mass, stiffness, acceleration)
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
