"""One step of DOP853 (Dormand and Prince, order 8) for a Hertz chain, in stretched time.

An elastic force is proportional to overlap^(3/2). Around a time t_e at which a contact opens or closes, the motion is
smooth in ``s = |t - t_e|^(1/2)`` but not in t. The force of a dissipative contact that closes starts with
(t - t_e)^(1/4), and the motion is smooth in ``s = (t - t_e)^(1/4)``. Steps are therefore taken in s: with
``t = t_e + s^power`` the equations are ``dy/ds = power s^(power - 1) f(y)``, and the method keeps its order through
the event. Powers -2 and -4 mean ``t = t_e - s^2`` and ``t = t_e - s^4``.

The kernels share two tables, so that calls pass few arrays, whose reference counts would take a third of a small
chain's time. ``rows`` holds states, a row each: overlaps, velocities, and integrals of ``hertz_chain.motion_of``, on
which no step size depends. ``bodies`` holds numbers of each body and of the contact under it, and the force of the
contact above the highest body.
"""

from math import sqrt
from typing import NamedTuple

import numpy as np
from numba import njit
from scipy.integrate import DOP853

from validation.reference.contact_kernels import damped_force, elastic_force, power_force, root_raised, segment_value
from validation.reference.hertz_chain import COLUMNS, VISCOELASTIC_POWER, Array

STAGES = 12
# rows of FORMULAS: each stage, the end of the step, stages of dense output, two error estimates, dense output
SLOPES, END = 16, STAGES
FIFTH, THIRD, DENSE = SLOPES, SLOPES + 1, SLOPES + 2
# coefficients by Hairer, Norsett and Wanner, Solving Ordinary Differential Equations I, 2nd edition, 1993, as scipy has
# them: times of the stages, as shares of the step, and weights of the slopes
C = np.array([*DOP853.C, 1.0, *DOP853.C_EXTRA])
FORMULAS = np.zeros((DENSE + 4, SLOPES))
FORMULAS[:STAGES, :STAGES], FORMULAS[END, :STAGES], FORMULAS[END + 1 : SLOPES] = DOP853.A, DOP853.B, DOP853.A_EXTRA
FORMULAS[[FIFTH, THIRD], : STAGES + 1], FORMULAS[DENSE:] = [DOP853.E5, DOP853.E3], DOP853.D
# per formula: slopes with weights other than 0 (other slopes may not be finite), their weights, their number
TERMS = np.argsort(FORMULAS == 0, axis=1, kind="stable")
WEIGHTS = np.take_along_axis(FORMULAS, TERMS, axis=1)
TERMS[WEIGHTS == 0] = 0
COUNTS = np.count_nonzero(FORMULAS, axis=1)
ROUNDING = 0.5**53  # relative rounding error of a double
# rows of the table of states: the slopes dy/ds; at the start of a step values, their rounding errors (Kahan) and their
# slopes dy/dt; the same three at its end; the same of an intermediate result; polynomial of the step; zeros
START = SLOPES
STOP, SPARE, POLYNOMIAL = START + 3, START + 6, START + 9
ZEROS = POLYNOMIAL + 7
STATES = ZEROS + 1
ERRORS, RATES = 1, 2  # after the row of the values
# rows of the table of bodies; GRIPS: 1 if the contact may exert a force in the present step, 0 if not, -1 if its
# overlap decides (only with the power law); STATIC: elastic force at time 0
STIFFNESS, DAMPING, INVERSE_MASS, ACCELERATION, FORCE, GRIPS, STATIC = range(7)
ELASTIC, DAMPED, POWER_LAW = range(3)
LAST, NEXT = COLUMNS, COLUMNS + 1  # of a drive's array, after its segment: times of events since the segment begins


class KernelLaw(NamedTuple):
    """Numbers that hold for all bodies.

    Attributes:
        law: ``ELASTIC``, ``DAMPED`` or ``POWER_LAW``.
        exponent: of the overlap in damping, or alpha of the power law.
        driven: True if there is a drive.
        body: driven body.
        prescribed: True if it moves as prescribed, with an inverse mass of 0.
        constant: its acceleration by its constant load.
        load: this load.
        below: velocity of what is below the lowest body; the last, since it changes with a window.
    """

    law: int
    exponent: float
    driven: bool
    body: int
    prescribed: bool
    constant: float
    load: float
    below: float


@njit(error_model="numpy", forceinline=True)
def closing_speed(rows: Array, row: int, n: int, contact: int, below: float) -> float:
    """Closing speed ``d'`` of a contact from values or, with 0 as velocity ``below`` the lowest body, from slopes."""
    return float((rows[row, n + contact - 1] if contact > 0 else below) - rows[row, n + contact])


@njit(error_model="numpy", forceinline=True)
def slope(rows: Array, row: int, result: int, n: int, size: int, stretch: float, bodies: Array, law: KernelLaw) -> None:
    """Writes ``stretch * dy/dt`` of the values in a row to another row; most loops compile to vector instructions."""
    at_once = stretch if law.law == ELASTIC else 1.0
    rows[result, 0] = at_once * (law.below - rows[row, n])
    for j in range(1, n):
        rows[result, j] = at_once * (rows[row, n + j - 1] - rows[row, n + j])
    if law.law == ELASTIC:
        for j in range(n):
            bodies[FORCE, j] = elastic_force(bodies[STIFFNESS, j], max(rows[row, j], 0.0))
    elif law.law == DAMPED and law.exponent == VISCOELASTIC_POWER:
        for j in range(n):
            stiffness, damping, overlap = bodies[STIFFNESS, j], bodies[DAMPING, j], max(rows[row, j], 0.0)
            bodies[FORCE, j] = damped_force(stiffness, damping, VISCOELASTIC_POWER, overlap, rows[result, j])
    elif law.law == DAMPED:
        for j in range(n):  # a loop of its own, so that the other one compiles to vector instructions
            bodies[FORCE, j] = root_raised(sqrt(max(rows[row, j], 0.0)), law.exponent)
        for j in range(n):
            elastic = elastic_force(bodies[STIFFNESS, j], max(rows[row, j], 0.0))
            bodies[FORCE, j] = max(elastic + bodies[DAMPING, j] * bodies[FORCE, j] * rows[result, j], 0.0)
    else:
        for j in range(n):
            bodies[FORCE, j] = 0.0
            if bodies[GRIPS, j] > 0.0 or bodies[GRIPS, j] < 0.0 <= rows[row, j]:
                overlap, closing = max(rows[row, j], 0.0), rows[result, j]
                force = power_force(bodies[STIFFNESS, j], bodies[DAMPING, j], law.exponent, overlap, closing)
                bodies[FORCE, j] = force
    for j in range(n):
        net = (bodies[FORCE, j] - bodies[FORCE, j + 1]) * bodies[INVERSE_MASS, j]
        rows[result, n + j] = stretch * (net + bodies[ACCELERATION, j])
    if law.law != ELASTIC:
        for j in range(n):
            rows[result, j] *= stretch
    if size > 2 * n:
        _powers(rows, row, result, n, size, stretch, bodies, law)


@njit(error_model="numpy")
def _powers(
    rows: Array, row: int, result: int, n: int, size: int, stretch: float, bodies: Array, law: KernelLaw
) -> None:
    """Writes ``stretch`` times the integrands of ``hertz_chain.motion_of``, with the forces of all contacts.

    For a contact it is ``(F - F(0)) d'``, which stays smooth when the overlap of a released contact reaches 0.
    """
    first = 2 * n
    rows[result, first], rows[result, first + 1] = 0.0, 0.0
    if law.driven:
        by_drive = bodies[FORCE, law.body + 1] - bodies[FORCE, law.body] - law.load
        if not law.prescribed:
            by_drive = (bodies[ACCELERATION, law.body] - law.constant) / bodies[INVERSE_MASS, law.body]
        rows[result, first] = stretch * by_drive * rows[row, n + law.body]
        rows[result, first + 1] = stretch * by_drive
    if size > first + 2:
        for j in range(n):
            further = stretch * (bodies[FORCE, j] - bodies[STATIC, j])
            rows[result, first + 2 + j] = further * closing_speed(rows, row, n, j, law.below)
            rows[result, first + 2 + n + j] = -further * rows[row, n + j]


@njit(error_model="numpy", forceinline=True)
def stretch_at(s: float, power: float) -> float:
    """``dt/ds``."""
    return power * s * s * s if abs(power) == 4.0 else power * s


@njit(error_model="numpy", forceinline=True)
def drive_until(elapsed: float, bodies: Array, drive: Array, law: KernelLaw) -> None:
    """Sets the acceleration of the driven body without contact forces, at a time since the last event."""
    if law.driven:
        value, _, bend = segment_value(drive, drive[LAST] + elapsed)
        by_force = law.constant + value * bodies[INVERSE_MASS, law.body]
        bodies[ACCELERATION, law.body] = bend if law.prescribed else by_force


@njit(error_model="numpy", forceinline=True)
def _drive_at(s: float, power: float, bodies: Array, drive: Array, law: KernelLaw) -> None:
    """``drive_until`` at a place s; with a negative power, s counts back from the next event."""
    if law.driven:
        raised = s * s * s * s if abs(power) == 4.0 else s * s
        drive_until(raised if power > 0.0 else drive[NEXT] - raised, bodies, drive, law)


@njit(error_model="numpy", forceinline=True)
def weigh(rows: Array, size: int, formula: int | np.int64, h: float, start: int | np.int64, result: int) -> None:
    """Writes row ``start`` plus ``h * FORMULAS[formula] @ slopes`` to row ``result``, four slopes at a time."""
    row, weight = TERMS[formula], WEIGHTS[formula]
    for k in range(0, COUNTS[formula], 4):
        a, b, c, d = h * weight[k], h * weight[k + 1], h * weight[k + 2], h * weight[k + 3]
        one, two, three, four = row[k], row[k + 1], row[k + 2], row[k + 3]
        if k == 0:
            for i in range(size):
                more = a * rows[one, i] + b * rows[two, i] + c * rows[three, i] + d * rows[four, i]
                rows[result, i] = rows[start, i] + more
        else:  # a loop of its own: one with two rows that may be the same does not compile to vector instructions
            for i in range(size):
                rows[result, i] += a * rows[one, i] + b * rows[two, i] + c * rows[three, i] + d * rows[four, i]


@njit(error_model="numpy")
def step(
    rows: Array, n: int, size: int, s: float, h: float, power: float, stop: int, bodies: Array, drive: Array,
    law: KernelLaw,
) -> None:  # fmt: skip
    """Takes a step from s to s + h; fills the slopes, and from row ``stop`` on the values and their rounding errors."""
    stretch = stretch_at(s, power)
    for i in range(size):
        rows[0, i] = stretch * rows[START + RATES, i]
    for stage in range(1, STAGES):
        weigh(rows, size, stage, h, START, stop)
        _drive_at(s + C[stage] * h, power, bodies, drive, law)
        slope(rows, stop, stage, n, size, stretch_at(s + C[stage] * h, power), bodies, law)
    weigh(rows, size, END, h, START + ERRORS, stop + ERRORS)
    for i in range(size):
        start, change = rows[START, i], rows[stop + ERRORS, i]
        result = start + change
        kept = result - start
        rows[stop, i] = result
        rows[stop + ERRORS, i] = (start - (result - kept)) + (change - kept)


@njit(error_model="numpy")
def error(
    rows: Array, n: int, size: int, s_end: float, h: float, power: float, scales: tuple[float, float],
    tolerance: float, bodies: Array, drive: Array, law: KernelLaw,
) -> float:  # fmt: skip
    """Largest local error divided by ``tolerance * scales``, by the two embedded formulas; fills the slope at the end.

    The allowed error of a velocity is at least the effect of rounding errors of the body's forces in the step. It
    exceeds the tolerance for light bodies between large, nearly equal forces; shorter steps would not lower it.
    """
    _drive_at(s_end, power, bodies, drive, law)
    slope(rows, STOP, STOP + RATES, n, size, 1.0, bodies, law)
    stretch, largest = stretch_at(s_end, power), 0.0
    rounding = ROUNDING * abs(h * stretch) / tolerance
    for i in range(size):
        rows[STAGES, i] = stretch * rows[STOP + RATES, i]
    weigh(rows, 2 * n, FIFTH, h, ZEROS, SPARE)
    for i in range(2 * n):
        fifth, scale = rows[SPARE, i], scales[0] if i < n else scales[1]
        if abs(fifth) <= largest * scale:  # the estimate is smaller still
            continue
        third, j = 0.0, i - n
        for k in range(COUNTS[THIRD]):
            third += h * WEIGHTS[THIRD, k] * rows[TERMS[THIRD, k], i]
        ratio = third / fifth  # a ratio, since squares of tiny values ahead of a wave underflow
        if j >= 0:
            force = elastic_force(bodies[STIFFNESS, j], max(rows[STOP, j], 0.0))
            above = elastic_force(bodies[STIFFNESS, j + 1], max(rows[STOP, j + 1], 0.0)) if j + 1 < n else 0.0
            scale = max(scale, rounding * (force + above) * bodies[INVERSE_MASS, j])
        estimate = abs(fifth) / sqrt(1.0 + 0.01 * ratio * ratio) / scale
        if not estimate <= largest:  # a NaN counts as largest
            largest = estimate
    return largest / tolerance


@njit(error_model="numpy")
def step_factor(error: float, most: float) -> float:
    """Ratio of the next step to this step, at most ``most``, from its error divided by the tolerance.

    It is below 1 if the step must be repeated. Without a margin for contacts that open and close, and with growth in
    the step after a repeated one, a third of all steps would be repeated.
    """
    if not error < 1e300:
        return 0.2
    return float(min(most, max(0.2 if error > 1.0 else 0.333, 0.8 * error**-0.125))) if error > 0.0 else most


@njit(error_model="numpy")
def prepare_dense(
    rows: Array, n: int, size: int, s: float, h: float, power: float, bodies: Array, drive: Array, law: KernelLaw
) -> None:
    """Fills the polynomial of the step that ``step`` took, with the slope at its end."""
    for stage in range(STAGES + 1, SLOPES):
        weigh(rows, size, stage, h, START, SPARE)
        _drive_at(s + C[stage] * h, power, bodies, drive, law)
        slope(rows, SPARE, stage, n, size, stretch_at(s + C[stage] * h, power), bodies, law)
    for i in range(size):
        change = rows[STOP, i] - rows[START, i]
        rows[POLYNOMIAL, i] = change
        rows[POLYNOMIAL + 1, i] = h * rows[0, i] - change
        rows[POLYNOMIAL + 2, i] = 2.0 * change - h * (rows[STAGES, i] + rows[0, i])
    for row in range(4):
        weigh(rows, size, DENSE + row, h, ZEROS, POLYNOMIAL + 3 + row)


@njit(error_model="numpy")
def evaluate_dense(rows: Array, size: int, x: float) -> None:
    """Writes the state at the fraction x of the step to row ``SPARE``; the interpolant has order 7."""
    for i in range(size):
        value = rows[POLYNOMIAL + 6, i] * x
        value = (value + rows[POLYNOMIAL + 5, i]) * (1.0 - x)
        value = (value + rows[POLYNOMIAL + 4, i]) * x
        value = (value + rows[POLYNOMIAL + 3, i]) * (1.0 - x)
        value = (value + rows[POLYNOMIAL + 2, i]) * x
        value = (value + rows[POLYNOMIAL + 1, i]) * (1.0 - x)
        rows[SPARE, i] = rows[START, i] + (value + rows[POLYNOMIAL, i]) * x
