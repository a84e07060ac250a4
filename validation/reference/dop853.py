"""One step of DOP853 (Dormand and Prince, order 8) for a Hertz chain, in stretched time.

An elastic force goes with overlap^(3/2), so where a contact opens or closes at time t_e the motion is smooth in
``s = |t - t_e|^(1/2)`` but not in t; where one closes that loses energy, its force begins with (t - t_e)^(1/4), and all
is smooth in ``s = (t - t_e)^(1/4)``. Steps therefore run in s: with ``t = t_e + s^power`` the equations are
``dy/ds = power s^(power - 1) f(y)``, and the method keeps its order through the event. Powers of -2 and -4 are
``t = t_e - s^2`` and ``t = t_e - s^4``.

Rows of a state: overlaps, then velocities; what rounding has left out of them (Kahan); their slopes dy/dt.
Coefficients are scipy's.
"""

from math import sqrt
from typing import Any

import numpy as np
from numba import njit
from scipy.integrate import DOP853

from validation.reference.contact_kernels import damped_force, elastic_force, power_force
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
ROUNDING = 0.5**53  # of a double
# inverse masses, stiffness, damping (empty of an elastic chain), acceleration by the loads alone; only of the power
# law its alpha, and for each contact 1 where it may exert a force in the present step, else 0
Bodies = tuple[Any, ...]
BY_POWER = 6  # so many: numba compiles kernels for either length, without the branches of the other


@njit(error_model="numpy")
def slope(state: Array, stretch: float, result: Array, bodies: Bodies) -> None:
    """Writes ``stretch * dy/dt`` to ``result``."""
    if len(bodies) == BY_POWER:
        _slope_power(state, stretch, result, bodies)
        return
    inverse_mass, stiffness, damping, acceleration = bodies[:4]
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


@njit(error_model="numpy")
def _slope_power(state: Array, stretch: float, result: Array, bodies: Bodies) -> None:
    """As ``slope``, by the power law: which contacts exert a force is held through a step, so that it is smooth."""
    inverse_mass, stiffness, gamma, acceleration, alpha, holds = bodies
    n = inverse_mass.size
    below, force_below = 0.0, 0.0
    for j in range(n):
        velocity = state[n + j]
        closing = below - velocity
        result[j] = stretch * closing
        below = velocity
        force = 0.0
        if holds[j] > 0.0:
            force = power_force(stiffness[j], gamma[j], alpha, max(state[j], 0.0), closing)
        if j > 0:
            result[n + j - 1] = stretch * ((force_below - force) * inverse_mass[j - 1] + acceleration[j - 1])
        force_below = force
    result[2 * n - 1] = stretch * (force_below * inverse_mass[n - 1] + acceleration[n - 1])


@njit(error_model="numpy", forceinline=True)
def _stretch(s: float, power: float) -> float:
    """``dt/ds``."""
    return power * s * s * s if abs(power) == 4.0 else power * s


@njit(error_model="numpy")
def weigh(h: float, weights: Array, slopes: Array, result: Array) -> None:
    """Writes ``h * weights @ slopes`` to ``result``."""
    result[:] = 0.0
    for row in range(weights.size):
        weight = h * weights[row]
        if weight != 0.0:
            for i in range(result.size):
                result[i] += weight * slopes[row, i]


@njit(error_model="numpy")
def step(state: Array, s: float, h: float, power: float, slopes: Array, end: Array, bodies: Bodies) -> None:
    """One step from s to s + h; writes values and what rounding left out of them, and fills the stages."""
    start, result = state[0], end[0]
    stretch = _stretch(s, power)
    for i in range(start.size):
        slopes[0, i] = stretch * state[2, i]
    for stage in range(1, STAGES):
        weigh(h, A[stage, :stage], slopes, result)
        for i in range(start.size):
            result[i] += start[i]
        slope(result, _stretch(s + C[stage] * h, power), slopes[stage], bodies)
    weigh(h, B, slopes, end[1])
    for i in range(start.size):
        change = end[1, i] + state[1, i]
        result[i] = start[i] + change
        kept = result[i] - start[i]
        end[1, i] = (start[i] - (result[i] - kept)) + (change - kept)


@njit(error_model="numpy")
def error(
    end: Array, s_end: float, h: float, power: float, slopes: Array, scale: Array, tolerance: float, work: Array,
    bodies: Bodies,
) -> float:  # fmt: skip
    """Largest local error over ``tolerance * scale``, by the two embedded formulas; fills the slope at the end.

    Velocities may err by what rounding of a body's forces makes of them in the step. Where that is more, the body is
    light and squeezed by forces much larger than what moves it, and shorter steps would not lower it.
    """
    slope(end[0], 1.0, end[2], bodies)
    stretch, largest, n = _stretch(s_end, power), 0.0, scale.size // 2
    rounding = ROUNDING * abs(h * stretch) / tolerance
    for i in range(scale.size):
        slopes[STAGES, i] = stretch * end[2, i]
    weigh(1.0, E5, slopes, work[0])
    weigh(1.0, E3, slopes, work[1])
    for i in range(scale.size):
        fifth, third = work[0, i], work[1, i]
        if fifth != 0.0:
            ratio = third / fifth  # squares of what a wave has barely reached underflow
            rounded = rounding * _pressing(i - n, end[0], bodies) * bodies[0][i - n] if i >= n else 0.0
            estimate = abs(h * fifth) / sqrt(1.0 + 0.01 * ratio * ratio) / max(scale[i], rounded)
            if not estimate <= largest:  # a NaN counts as largest
                largest = estimate
    return largest / tolerance


@njit(error_model="numpy", forceinline=True)
def _pressing(body: int, overlap: Array, bodies: Bodies) -> float:
    """Sum of the elastic forces on a body."""
    stiffness = bodies[1]
    above = elastic_force(stiffness[body + 1], max(overlap[body + 1], 0.0)) if body + 1 < stiffness.size else 0.0
    return above + elastic_force(stiffness[body], max(overlap[body], 0.0))


@njit(error_model="numpy")
def step_factor(error: float) -> float:
    """Next step over this one, by this one's error over the tolerance: below 1 where it is to be repeated."""
    if not error < 1e300:
        return 0.2
    if error > 1.0:
        return float(max(0.2, 0.9 * error**-0.125))
    return float(min(6.0, max(0.333, 0.9 * error**-0.125))) if error > 0.0 else 6.0


@njit(error_model="numpy")
def prepare_dense(
    start: Array, end: Array, s: float, h: float, power: float, slopes: Array, dense: Array, work: Array, bodies: Bodies
) -> None:
    """Fills the seven rows of ``dense`` for a step whose stages and end slope stand in ``slopes``."""
    for row in range(STAGES + 1, ROWS):
        weigh(h, A[row, :row], slopes, work)
        for i in range(start.size):
            work[i] += start[i]
        slope(work, _stretch(s + C[row] * h, power), slopes[row], bodies)
    for i in range(start.size):
        change = end[i] - start[i]
        dense[0, i] = change
        dense[1, i] = h * slopes[0, i] - change
        dense[2, i] = 2.0 * change - h * (slopes[STAGES, i] + slopes[0, i])
    for row in range(4):
        weigh(h, D[row], slopes, dense[3 + row])


@njit(error_model="numpy")
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
