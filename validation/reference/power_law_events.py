"""Events of contacts with the velocity-power law, ``F = max(0, k d^(3/2) + gamma sgn(d') |d'|^alpha)``.

The force jumps when a contact closes, has a corner when it releases (F reaches 0 while d > 0) or engages again, and a
kink of order alpha when the closing speed d' changes sign (a turning point). Between these events the motion is smooth
if open and released contacts exert no force until their next event, even in stages of a step with positive overlap.
The set of contacts that may exert a force, row ``GRIPS`` of the bodies, is therefore stored separately from the state.
Events are numbered by contact, turning points by contact plus the number of contacts.
"""

from math import sqrt

from numba import njit

from validation.reference.dop853 import (
    DAMPING,
    GRIPS,
    INVERSE_MASS,
    RATES,
    START,
    STIFFNESS,
    STOP,
    KernelLaw,
    closing_speed,
)
from validation.reference.hertz_chain import Array

DEAD_BAND = 1e-13  # share of the scales of overlap and speed: smaller crossings are rounding, no event
# A turning point is an event if its force changes velocities in a step by more than this number of local tolerances.
# Without turning points errors reach 9 times the requested tolerance; with all of them steps are 2 to 5 times more.
MIN_KICK = 1e3
MIN_INTERVAL = 1e-14  # share of the time since the last event: closer events count as simultaneous
NO_EVENT = (-1, 2.0)
RETRY = (0, -1.0)  # repeat the step with a smaller size


@njit(error_model="numpy")
def _grip(rows: Array, row: int, n: int, contact: int, bodies: Array, law: KernelLaw) -> float:
    """``(k d^(3/2))^(1/alpha) + gamma^(1/alpha) d'``, negative after a closed contact has released."""
    overlap, inverse = max(rows[row, contact], 0.0), 1.0 / law.exponent
    spring = (bodies[STIFFNESS, contact] * overlap * sqrt(overlap)) ** inverse
    return float(spring + bodies[DAMPING, contact] ** inverse * closing_speed(rows, row, n, contact, law.below))


@njit(error_model="numpy")
def first_grips(rows: Array, n: int, located: bool, bodies: Array, law: KernelLaw) -> None:
    """Sets ``GRIPS`` at time 0: contacts with overlap, or touching and not separating, that are not released."""
    for j in range(n):
        holds = rows[START, j] >= 0.0 and _grip(rows, START, n, j, bodies, law) >= 0.0
        bodies[GRIPS, j] = 0.0 if bodies[STIFFNESS, j] == 0.0 or (located and not holds) else 1.0 if located else -1.0


@njit(error_model="numpy")
def first_power_event(
    rows: Array, n: int, bodies: Array, law: KernelLaw, scales: tuple[float, float], tolerance: float, elapsed: float,
    until: float, last: int, known: int,
) -> tuple[int, float]:  # fmt: skip
    """First event of a step, and the fraction of the step at which it occurs, by linear interpolation.

    The step goes from time ``elapsed`` to ``until``. Without an event other than ``known`` the result is ``NO_EVENT``.
    ``RETRY`` asks for a shorter step: either several events of one contact fall into the step, or ``GRIPS`` disagreed
    with the state at the start beyond rounding and has been corrected.
    """
    alpha, below = law.exponent, law.below
    first, where = NO_EVENT
    dead, still = DEAD_BAND * scales[0], DEAD_BAND * scales[1]
    span = until - elapsed
    kinked = alpha != 1.0 and alpha != 3.0
    for j in range(n):
        if bodies[STIFFNESS, j] == 0.0:
            continue
        start, end, gamma, holds = rows[START, j], rows[STOP, j], bodies[DAMPING, j], bodies[GRIPS, j] > 0.0
        if j != known:
            tiny = gamma ** (1.0 / alpha) * still
            if not holds and start < 0.0:
                before, after, passed, at_once = start, end, end > dead, start >= -dead
            else:
                sign = 1.0 if holds else -1.0  # sign of the grip while the contact does not change
                before = sign * _grip(rows, START, n, j, bodies, law)
                after = sign * _grip(rows, STOP, n, j, bodies, law)
                passed, at_once = after < -tiny and (holds or end > 0.0), before <= tiny
                if holds and end < -dead and not passed:
                    if start > dead:
                        return RETRY
                    passed, at_once = True, True
            if passed and at_once:
                if known < 0:
                    bodies[GRIPS, j] = 1.0 - bodies[GRIPS, j]
                return RETRY
            if passed and before / (before - after) < where:
                first, where = j, before / (before - after)
        if kinked and holds and n + j != known and n + j != last:
            before, after = closing_speed(rows, START, n, j, below), closing_speed(rows, STOP, n, j, below)
            lightness = bodies[INVERSE_MASS, j] + (bodies[INVERSE_MASS, j - 1] if j > 0 else 0.0)
            kick = gamma * abs(after) ** alpha * lightness * span
            turns = before * after < 0.0 and abs(before) > still and kick > MIN_KICK * tolerance * scales[1]
            if turns and before / (before - after) < where:
                first, where = n + j, before / (before - after)
    if 0 <= first < n and known < 0 and where * span <= MIN_INTERVAL * elapsed:
        bodies[GRIPS, first] = 1.0 - bodies[GRIPS, first]
        return RETRY
    return first, where


@njit(error_model="numpy")
def passing(rows: Array, n: int, event: int, bodies: Array, law: KernelLaw) -> tuple[float, float]:
    """Quantity that is 0 at an event, and its rate of change, at the end of a step whose slope there is filled."""
    contact = event % n
    speed = closing_speed(rows, STOP, n, contact, law.below)
    change = closing_speed(rows, STOP + RATES, n, contact, 0.0)
    if event >= n:
        return speed, change
    if rows[START, contact] < 0.0:  # it closes
        return float(rows[STOP, contact]), speed
    inverse, overlap = 1.0 / law.exponent, max(rows[STOP, contact], 0.0)
    spring = (bodies[STIFFNESS, contact] * overlap * sqrt(overlap)) ** inverse
    rate = bodies[DAMPING, contact] ** inverse * change
    if overlap > 0.0:
        rate += 1.5 * inverse * spring / overlap * speed
    return _grip(rows, STOP, n, contact, bodies, law), rate
