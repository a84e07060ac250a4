"""Events of contacts with the velocity-power law, ``F = max(0, k d^(3/2) + gamma sgn(d') |d'|^alpha)``.

The force jumps when a contact closes, has a corner when it releases (F reaches 0 while d > 0) or engages again, and a
kink of order alpha when the closing speed d' changes sign (a turning point). Between these events the motion is smooth
if open and released contacts exert no force until their next event, even in stages of a step with positive overlap.
The set of contacts that may exert a force, ``holds``, is therefore stored separately from the state. Events are
numbered by contact, turning points by contact plus the number of contacts.
"""

from math import sqrt

from numba import njit

from validation.reference.dop853 import Bodies
from validation.reference.hertz_chain import Array

DEAD_BAND = 1e-13  # share of the scales of overlap and speed: smaller crossings are rounding, no event
# A turning point is an event if its force changes velocities in a step by more than this number of local tolerances.
# Without turning points errors reach 9 times the requested tolerance; with all of them steps are 2 to 5 times more.
MIN_KICK = 1e3
MIN_INTERVAL = 1e-14  # share of the time since the last event: closer events count as simultaneous
NO_EVENT = (-1, 2.0)
RETRY = (0, -1.0)  # repeat the step with a smaller size


@njit(error_model="numpy")
def closing_speed(state: Array, contact: int, bodies: Bodies) -> float:
    """Closing speed ``d'`` of a contact from a state, or its rate of change from a slope."""
    velocity = state[bodies[1].size :]
    return float((velocity[contact - 1] if contact > 0 else 0.0) - velocity[contact])


@njit(error_model="numpy")
def _grip(state: Array, contact: int, bodies: Bodies) -> float:
    """``(k d^(3/2))^(1/alpha) + gamma^(1/alpha) d'``, negative after a closed contact has released."""
    overlap, inverse = max(state[contact], 0.0), 1.0 / bodies[4]
    spring = (bodies[1][contact] * overlap * sqrt(overlap)) ** inverse
    return float(spring + bodies[2][contact] ** inverse * closing_speed(state, contact, bodies))


@njit(error_model="numpy")
def first_holds(start: Array, bodies: Bodies) -> None:
    """Sets ``holds`` at time 0: contacts with overlap, or touching and not separating, that are not released."""
    stiffness, holds = bodies[1], bodies[5]
    for j in range(holds.size):
        holds[j] = 1.0 if stiffness[j] > 0.0 and start[j] >= 0.0 and _grip(start, j, bodies) >= 0.0 else 0.0


@njit(error_model="numpy")
def first_power_event(
    start: Array, end: Array, bodies: Bodies, scale: Array, tolerance: float, elapsed: float, until: float,
    last: int, known: int,
) -> tuple[int, float]:  # fmt: skip
    """First event of a step, and the fraction of the step at which it occurs, by linear interpolation.

    The step goes from time ``elapsed`` to ``until``. Without an event other than ``known`` the result is ``NO_EVENT``.
    ``RETRY`` asks for a shorter step: either several events of one contact fall into the step, or ``holds`` disagreed
    with the state at the start beyond rounding and has been corrected.
    """
    inverse_mass, stiffness, gamma, _, alpha, holds = bodies[:6]
    n = stiffness.size
    first, where = NO_EVENT
    dead, still = DEAD_BAND * scale[0], DEAD_BAND * scale[n]
    span = until - elapsed
    kinked = alpha != 1.0 and alpha != 3.0
    for j in range(n):
        if stiffness[j] == 0.0:
            continue
        if j != known:
            tiny = gamma[j] ** (1.0 / alpha) * still
            if holds[j] == 0.0 and start[j] < 0.0:
                before, after, passed, at_once = start[j], end[j], end[j] > dead, start[j] >= -dead
            else:
                sign = 1.0 if holds[j] > 0.0 else -1.0  # sign of the grip while the contact does not change
                before, after = sign * _grip(start, j, bodies), sign * _grip(end, j, bodies)
                passed, at_once = after < -tiny and (holds[j] > 0.0 or end[j] > 0.0), before <= tiny
                if holds[j] > 0.0 and end[j] < -dead and not passed:
                    if start[j] > dead:
                        return RETRY
                    passed, at_once = True, True
            if passed and at_once:
                if known < 0:
                    holds[j] = 1.0 - holds[j]
                return RETRY
            if passed and before / (before - after) < where:
                first, where = j, before / (before - after)
        if kinked and holds[j] > 0.0 and n + j != known and n + j != last:
            before, after = closing_speed(start, j, bodies), closing_speed(end, j, bodies)
            kick = gamma[j] * abs(after) ** alpha * (inverse_mass[j] + (inverse_mass[j - 1] if j > 0 else 0.0)) * span
            turns = before * after < 0.0 and abs(before) > still and kick > MIN_KICK * tolerance * scale[n]
            if turns and before / (before - after) < where:
                first, where = n + j, before / (before - after)
    if 0 <= first < n and known < 0 and where * span <= MIN_INTERVAL * elapsed:
        holds[first] = 1.0 - holds[first]
        return RETRY
    return first, where


@njit(error_model="numpy")
def passing(state: Array, slope: Array, event: int, closes: bool, bodies: Bodies) -> tuple[float, float]:
    """Quantity that is 0 at an event, and its rate of change, for a state with this slope."""
    n = bodies[1].size
    contact = event % n
    speed, change = closing_speed(state, contact, bodies), closing_speed(slope, contact, bodies)
    if event >= n:
        return speed, change
    if closes:
        return float(state[contact]), speed
    inverse, overlap = 1.0 / bodies[4], max(state[contact], 0.0)
    spring = (bodies[1][contact] * overlap * sqrt(overlap)) ** inverse
    rate = bodies[2][contact] ** inverse * change
    if overlap > 0.0:
        rate += 1.5 * inverse * spring / overlap * speed
    return _grip(state, contact, bodies), rate
