"""Events of contacts by the law of a power of the closing speed, ``k d^(3/2) + gamma sgn(d') |d'|^alpha``.

Its force jumps where a contact closes, has a corner where it lets go or holds again, and a kink of order alpha where
the closing speed d' changes its sign. Between these events the motion is smooth, if a contact that is open or has let
go exerts no force until its next event, whatever overlap a stage of a step has: which contacts hold is kept beside
the state. Events are numbered by contact, and turning points by contact plus the number of contacts.
"""

from math import sqrt

from validation.reference.dop853 import Bodies, uncounted
from validation.reference.hertz_chain import Array

DEAD = 1e-13  # of the scales of overlap and speed: events that are passed by less are none
# local tolerances: by what a turning point's force changes velocities in a step in which it is an event. Without such
# events errors are up to 9 times the tolerance asked for, with all of them steps are 2 to 5 times as many
KINK = 1e3
NEAR = 1e-14  # of the time since the last event: an event so soon is at once
NO_EVENT = (-1, 2.0)
NOT_YET = (0, -1.0)  # to be tried again with a shorter step


@uncounted
def closing_speed(state: Array, contact: int) -> float:
    """``d'`` of a contact, in a state or in its slope."""
    velocity = state[state.size // 2 :]
    return float((velocity[contact - 1] if contact > 0 else 0.0) - velocity[contact])


@uncounted
def _grip(state: Array, contact: int, bodies: Bodies) -> float:
    """``(k d^(3/2))^(1/alpha) + gamma^(1/alpha) d'``: below 0 a closed contact has let go."""
    overlap, inverse = max(state[contact], 0.0), 1.0 / bodies[4]
    spring = (bodies[1][contact] * overlap * sqrt(overlap)) ** inverse
    return float(spring + bodies[2][contact] ** inverse * closing_speed(state, contact))


@uncounted
def first_holds(start: Array, bodies: Bodies) -> None:
    """Contacts that hold at time 0: they overlap, or just touch and do not part, and are not let go."""
    stiffness, holds = bodies[1], bodies[5]
    for j in range(holds.size):
        holds[j] = 1.0 if stiffness[j] > 0.0 and start[j] >= 0.0 and _grip(start, j, bodies) >= 0.0 else 0.0


@uncounted
def first_power_event(
    start: Array, end: Array, bodies: Bodies, scale: Array, tolerance: float, elapsed: float, until: float,
    last: int, known: int,
) -> tuple[int, float]:  # fmt: skip
    """The first event of a step by linear interpolation, and where; none but the ``known`` one: ``NO_EVENT``.

    Where a contact does not hold as its state at the start has it, but for rounding of state and time, that is put
    right, and the step is to be tried again, shorter: a share below 0, as where several events of one contact fall into
    the step. It goes from ``elapsed`` to ``until``.
    """
    inverse_mass, stiffness, gamma, _, alpha, holds = bodies
    n = stiffness.size
    first, where = NO_EVENT
    dead, still = DEAD * scale[0], DEAD * scale[n]
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
                sign = 1.0 if holds[j] > 0.0 else -1.0  # of a grip that goes on as it is
                before, after = sign * _grip(start, j, bodies), sign * _grip(end, j, bodies)
                passed, at_once = after < -tiny and (holds[j] > 0.0 or end[j] > 0.0), before <= tiny
                if holds[j] > 0.0 and end[j] < -dead and not passed:
                    if start[j] > dead:
                        return NOT_YET
                    passed, at_once = True, True
            if passed and at_once:
                if known < 0:
                    holds[j] = 1.0 - holds[j]
                return NOT_YET
            if passed and before / (before - after) < where:
                first, where = j, before / (before - after)
        if kinked and holds[j] > 0.0 and n + j != known and n + j != last:
            before, after = closing_speed(start, j), closing_speed(end, j)
            kick = gamma[j] * abs(after) ** alpha * (inverse_mass[j] + (inverse_mass[j - 1] if j > 0 else 0.0)) * span
            turns = before * after < 0.0 and abs(before) > still and kick > KINK * tolerance * scale[n]
            if turns and before / (before - after) < where:
                first, where = n + j, before / (before - after)
    if 0 <= first < n and known < 0 and where * span <= NEAR * elapsed:
        holds[first] = 1.0 - holds[first]
        return NOT_YET
    return first, where


@uncounted
def passing(state: Array, slope: Array, event: int, closes: bool, bodies: Bodies) -> tuple[float, float]:
    """The number that is 0 at an event, and its rate of change, in a state that has this slope."""
    n = bodies[1].size
    contact = event % n
    speed, change = closing_speed(state, contact), closing_speed(slope, contact)
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
