"""One step of DOP853 (Dormand and Prince, order 8) for a Hertz chain, in stretched time.

An elastic force is proportional to overlap^(3/2). Around a time t_e at which a contact opens or closes, the motion is
smooth in ``s = |t - t_e|^(1/2)`` but not in t. The force of a dissipative contact that closes starts with
(t - t_e)^(1/4), and the motion is smooth in ``s = (t - t_e)^(1/4)``. Steps are therefore taken in s: with
``t = t_e + s^power`` the equations are ``dy/ds = power s^(power - 1) f(y)``, and the method keeps its order through
the event. Powers -2 and -4 mean ``t = t_e - s^2`` and ``t = t_e - s^4``.

Rows of a state: values (overlaps, then velocities); their rounding errors (Kahan); their slopes dy/dt.
The coefficients are scipy's.
"""

from collections.abc import Callable
from importlib.util import find_spec
from math import sqrt
from pathlib import Path
from runpy import run_path
from typing import Any, TypeVar

import numpy as np
from numba import njit

from validation.reference.contact_kernels import damped_force, elastic_force, power_force
from validation.reference.hertz_chain import Array

STAGES = 12
ROWS = 16  # the stages, the slope at the end, three more stages for dense output
# read from their file: the import of scipy.integrate takes longer than most runs
_scipy = find_spec("scipy")
assert _scipy is not None
assert _scipy.origin is not None
DOP853 = run_path(str(Path(_scipy.origin).parent / "integrate" / "_ivp" / "dop853_coefficients.py"))
C = DOP853["C"]
# rows of FORMULAS: each stage, the end of the step, stages of dense output, two error estimates, dense output
END, FIFTH, THIRD, DENSE = STAGES, ROWS, ROWS + 1, ROWS + 2
FORMULAS = np.zeros((DENSE + 4, ROWS))
FORMULAS[:ROWS], FORMULAS[DENSE:] = DOP853["A"], DOP853["D"]
FORMULAS[FIFTH, : STAGES + 1], FORMULAS[THIRD, : STAGES + 1] = DOP853["E5"], DOP853["E3"]
# per formula: slopes with weights other than 0 (other slopes may not be finite), their weights, their number
TERMS = np.argsort(FORMULAS == 0, axis=1, kind="stable")
WEIGHTS = np.take_along_axis(FORMULAS, TERMS, axis=1)
TERMS[WEIGHTS == 0] = 0
COUNTS = np.count_nonzero(FORMULAS, axis=1)
ROUNDING = 0.5**53  # relative rounding error of a double
# inverse masses, stiffness, damping (empty for an elastic chain), acceleration by the loads alone; with the power law
# also alpha, and for each contact 1 if it may exert a force in the present step, else 0
Bodies = tuple[Any, ...]
POWER_LAW_LENGTH = 6  # length of Bodies with the power law; numba compiles a kernel for each of the two lengths
Kernel = TypeVar("Kernel", bound=Callable[..., Any])


def without_refcounts(kernel: Kernel) -> Kernel:
    """Compiles a function that allocates no arrays; reference counts would take half of a small chain's time."""
    options: dict[str, Any] = {"_nrt": False, "error_model": "numpy"}  # _nrt is missing from numba's stubs
    compiled: Kernel = njit(**options)(kernel)
    return compiled


@without_refcounts
def slope(state: Array, stretch: float, result: Array, bodies: Bodies) -> None:
    """Writes ``stretch * dy/dt`` to ``result``; each loop compiles to vector instructions."""
    if len(bodies) == POWER_LAW_LENGTH:
        _slope_power(state, stretch, result, bodies)
        return
    inverse_mass, stiffness, damping, acceleration = bodies[:4]
    n = inverse_mass.size
    velocity, closing, force = state[n:], result[:n], result[n:]
    closing[0] = -velocity[0]
    for j in range(1, n):
        closing[j] = velocity[j - 1] - velocity[j]
    if damping.size:
        for j in range(n):
            force[j] = damped_force(stiffness[j], damping[j], state[j], closing[j]) if state[j] > 0.0 else 0.0
    else:
        for j in range(n):
            force[j] = elastic_force(stiffness[j], state[j] if state[j] > 0.0 else 0.0)
    for j in range(n - 1):
        force[j] = stretch * ((force[j] - force[j + 1]) * inverse_mass[j] + acceleration[j])
    force[n - 1] = stretch * (force[n - 1] * inverse_mass[n - 1] + acceleration[n - 1])
    for j in range(n):
        closing[j] *= stretch


@without_refcounts
def _slope_power(state: Array, stretch: float, result: Array, bodies: Bodies) -> None:
    """``slope`` for the power law; it is smooth, as the contacts with a force stay the same within a step."""
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


@without_refcounts
def weigh(formula: int, h: float, slopes: Array, result: Array) -> None:
    """Writes ``h * FORMULAS[formula] @ slopes`` to ``result``, in blocks of four rows."""
    row, weight = TERMS[formula], WEIGHTS[formula]
    for i in range(result.size):
        result[i] = 0.0
    for k in range(0, COUNTS[formula], 4):
        a, b, c, d = h * weight[k], h * weight[k + 1], h * weight[k + 2], h * weight[k + 3]
        one, two, three, four = slopes[row[k]], slopes[row[k + 1]], slopes[row[k + 2]], slopes[row[k + 3]]
        for i in range(result.size):
            result[i] = result[i] + a * one[i] + b * two[i] + c * three[i] + d * four[i]


@without_refcounts
def step(state: Array, s: float, h: float, power: float, slopes: Array, end: Array, bodies: Bodies) -> None:
    """Takes one step from s to s + h; writes values and their rounding errors to ``end``, stages to ``slopes``."""
    start, result = state[0], end[0]
    stretch = _stretch(s, power)
    for i in range(start.size):
        slopes[0, i] = stretch * state[2, i]
    for stage in range(1, STAGES):
        weigh(stage, h, slopes, result)
        for i in range(start.size):
            result[i] += start[i]
        slope(result, _stretch(s + C[stage] * h, power), slopes[stage], bodies)
    weigh(END, h, slopes, end[1])
    for i in range(start.size):
        change = end[1, i] + state[1, i]
        result[i] = start[i] + change
        kept = result[i] - start[i]
        end[1, i] = (start[i] - (result[i] - kept)) + (change - kept)


@without_refcounts
def error(
    end: Array, s_end: float, h: float, power: float, slopes: Array, scale: Array, tolerance: float, work: Array,
    bodies: Bodies,
) -> float:  # fmt: skip
    """Largest local error over ``tolerance * scale``, by the two embedded formulas; fills the slope at the end.

    The allowed error of a velocity is at least the effect of rounding errors of the body's forces in the step. It
    exceeds the tolerance for light bodies between large, nearly equal forces; shorter steps would not lower it.
    """
    slope(end[0], 1.0, end[2], bodies)
    stretch, largest, n = _stretch(s_end, power), 0.0, scale.size // 2
    rounding = ROUNDING * abs(h * stretch) / tolerance
    for i in range(scale.size):
        slopes[STAGES, i] = stretch * end[2, i]
    weigh(FIFTH, 1.0, slopes, work[0])
    weigh(THIRD, 1.0, slopes, work[1])
    inverse_mass, stiffness = bodies[0], bodies[1]
    fifth, third, estimate, force, rounded = work[0], work[1], work[1], work[2, :n], work[2, n:]
    for j in range(n):
        force[j] = elastic_force(stiffness[j], end[0, j] if end[0, j] > 0.0 else 0.0)
    for j in range(n - 1):
        rounded[j] = rounding * (force[j + 1] + force[j]) * inverse_mass[j]
    rounded[n - 1] = rounding * force[n - 1] * inverse_mass[n - 1]
    for j in range(n):
        force[j] = 0.0  # overlaps get no allowance for rounding
    for i in range(scale.size):
        ratio = third[i] / fifth[i]  # a ratio, since squares of tiny values ahead of a wave underflow
        estimate[i] = abs(h * fifth[i]) / sqrt(1.0 + 0.01 * ratio * ratio) / max(scale[i], work[2, i])
    for i in range(scale.size):
        if fifth[i] != 0.0 and not estimate[i] <= largest:  # a NaN counts as largest
            largest = estimate[i]
    return largest / tolerance


@without_refcounts
def step_factor(error: float) -> float:
    """Ratio of the next step to this step, from its error over the tolerance; below 1 if it must be repeated."""
    if not error < 1e300:
        return 0.2
    if error > 1.0:
        return float(max(0.2, 0.9 * error**-0.125))
    return float(min(6.0, max(0.333, 0.9 * error**-0.125))) if error > 0.0 else 6.0


@without_refcounts
def prepare_dense(
    start: Array, end: Array, s: float, h: float, power: float, slopes: Array, dense: Array, work: Array, bodies: Bodies
) -> None:
    """Fills the seven rows of ``dense`` for a step with its stages and end slope in ``slopes``."""
    for row in range(STAGES + 1, ROWS):
        weigh(row, h, slopes, work)
        for i in range(start.size):
            work[i] += start[i]
        slope(work, _stretch(s + C[row] * h, power), slopes[row], bodies)
    for i in range(start.size):
        change = end[i] - start[i]
        dense[0, i] = change
        dense[1, i] = h * slopes[0, i] - change
        dense[2, i] = 2.0 * change - h * (slopes[STAGES, i] + slopes[0, i])
    for row in range(4):
        weigh(DENSE + row, h, slopes, dense[3 + row])


@without_refcounts
def evaluate_dense(start: Array, dense: Array, x: float, result: Array) -> None:
    """Writes the state at the fraction x of the step to ``result``; the interpolant has order 7."""
    for i in range(start.size):
        value = dense[6, i] * x
        value = (value + dense[5, i]) * (1.0 - x)
        value = (value + dense[4, i]) * x
        value = (value + dense[3, i]) * (1.0 - x)
        value = (value + dense[2, i]) * x
        value = (value + dense[1, i]) * (1.0 - x)
        result[i] = start[i] + (value + dense[0, i]) * x
