"""Kernels of the exact reference; imported only for an integration, since the import loads compiled code.

With the velocity-power law, ``F = max(0, k d^(3/2) + gamma sgn(d') |d'|^alpha)``, the force jumps when a contact
closes, has a corner when it releases (F reaches 0 while d > 0) or engages again, and a kink of order alpha when the
closing speed d' changes sign (a turning point). Between these events the motion is smooth if open and released contacts
exert no force until their next event, even in stages of a step with positive overlap. The set of contacts that may
exert a force, row ``GRIPS`` of the bodies, is therefore stored separately from the state. Events are numbered by
contact, turning points by contact plus the number of contacts.
"""

from math import sqrt
from typing import Any

import numpy as np
from numba import njit

from validation.reference.contact_kernels import CACHED, elastic_force, root_raised
from validation.reference.dop853 import (
    DAMPED,
    DAMPING,
    ELASTIC,
    ERRORS,
    FORCE,
    GRIPS,
    INVERSE_MASS,
    LAST,
    NEXT,
    POWER_LAW,
    RATES,
    SPARE,
    START,
    STATES,
    STIFFNESS,
    STOP,
    KernelLaw,
    closing_speed,
    drive_until,
    error,
    evaluate_dense,
    prepare_dense,
    slope,
    step,
    step_factor,
    stretch_at,
)
from validation.reference.hertz_chain import EXPONENT, LEAST_WINDOWED, Array, Flag

DENSE_LIMIT = 1e-9  # local tolerance; below it damped forces rise too steeply to interpolate samples
EVENT_OVERLAP = 1e-13  # share of the overlap scale: smaller gaps and overlaps are rounding, no event
TIME_ROUNDING = 4e-16  # of a time that is computed from s, for power 2
TINY = 1e-300  # overlap, for its negative powers
NEAR = 0.1  # times the 2/3 power of the local tolerance, for the force: a step may end so near to a zero of overlap
MAX_TRIES = 12  # iterations of Newton's method for the time of an event
TRIES_ON_POLYNOMIAL = 4  # for the first estimate of this time
MAX_TRIES_BETWEEN = 60  # iterations with bisection as fallback
MAX_REJECTED = 200  # consecutive steps
GROWTH = 3.0  # largest, of the step
MARGIN = 8  # bodies that move uniformly at each edge of the window
SETTLED = 32  # steps after which the window may shrink
QUIET = 1e-3  # share of the local tolerance: smaller changes of velocity, in units of its scale, are none
DEAD_BAND = 1e-13  # share of the scales of overlap and speed: smaller crossings are rounding, no event
# A turning point is an event if its force changes velocities in a step by more than this number of local tolerances.
# Without turning points errors reach 9 times the requested tolerance; with all of them steps are 2 to 5 times more.
MIN_KICK = 1e3
MIN_INTERVAL = 1e-14  # share of the time since the last event: closer events count as simultaneous
NO_EVENT = (-1, 2.0)
RETRY = (0, -1.0)  # repeat the step with a smaller size
# table of the bodies outside the window: overlap and velocity with their rounding errors, time to which they belong
OVERLAP, VELOCITY, SINCE, OUTSIDE = 0, 2, 4, 5


@njit(error_model="numpy", forceinline=True)
def _raised(s: float, power: float) -> float:
    return s * s * s * s if power == 4.0 else s * s


@njit(error_model="numpy", forceinline=True)
def _root(elapsed: float, power: float) -> float:
    root = sqrt(max(elapsed, 0.0))
    return sqrt(root) if power == 4.0 else root


@njit(cache=CACHED, nogil=True, error_model="numpy")
def fill_states(
    samples: Array, times: Array, chain: Array, drive: Array, law: KernelLaw, located: bool, tolerance: float,
    scales: tuple[float, float], first_step: float, stop: Flag,
) -> bool:  # fmt: skip
    """Fills the states of a chain at all times but the first; True if the integration reached the end.

    A state has overlaps, velocities, and integrals as ``hertz_chain.columns_of_sums`` counts them. Local errors of
    overlaps and velocities stay below ``tolerance`` times their scales in each step. The states are filled into a given
    array: to return one, numba would run Python code, and lose the exception of a signal in it.

    In a long chain only a window of bodies is integrated: those outside move uniformly, as bodies at rest ahead of a
    wave and in free flight behind it do, until they are disturbed at the edge of the window or two of them meet.

    Args:
        samples: the states, the first of them given. Shape (times, size of a state).
        times: times from 0 on.
        chain: the table of bodies, as ``dop853`` describes it.
        drive: segment of the drive, and room for two times.
        law: numbers of the chain.
        located: True if steps end where contacts open and close; False if short steps there are enough.
        tolerance: local error.
        scales: scales of overlap and velocity, to which it is relative.
        first_step: length of the first step.
        stop: flag that ends the integration.
    """
    total, size = chain.shape[1] - 1, samples.shape[1]
    rows, bodies, outside = np.zeros((STATES, size)), chain.copy(), np.zeros((OUTSIDE, total))
    windows = total >= LEAST_WINDOWED and size == 2 * total
    low, n, alarm, settled, quiet = 0, total, np.inf, 0, QUIET * tolerance
    least, most = low, n  # of the next window
    near = scales[0] * max(EVENT_OVERLAP, NEAR * tolerance ** (1.0 / EXPONENT))
    for i in range(size):
        rows[START, i] = samples[0, i]
    power = 4.0 if law.law != ELASTIC else 2.0
    dense_enough = power == 2.0 or tolerance >= DENSE_LIMIT
    if law.law == POWER_LAW:
        _first_grips(rows, n, located, bodies, law)
    drive_until(0.0, bodies, drive, law)
    slope(rows, START, START + RATES, n, size, 1.0, bodies, law)
    nobody: Any = np.int64(-1)  # a literal would make numba compile the called functions again
    since, rest = 0.0, 0.0  # the sum is the time of the last event, from which other times are counted
    s, h, sample, rejected, last = 0.0, _root(first_step, power), 1, 0, nobody

    while sample < times.size:
        if rejected > MAX_REJECTED or stop[0]:
            return False
        elapsed, final = _raised(s, power), (times[-1] - since) - rest
        s_end = min(s + h, _root(final, power))
        target = final if s_end < s + h else _raised(s_end, power)
        if windows and (settled % SETTLED == 0 or since + rest + target >= alarm):
            least, most = 0, total
            if since + rest + target < alarm:
                while least < n - 1 and not _moves(rows, START, n, least, bodies, scales, quiet):
                    least += 1
                most = n
                while most > least + 1 and not _moves(rows, START, n, most - 1, bodies, scales, quiet):
                    most -= 1
                least, most = low + max(least - MARGIN, 0), low + min(most + MARGIN, n)
            settled += 1
        if least != low or most != low + n:
            last = _shifted(last, n, low - least, most - least)
            alarm = _move_window(
                rows, low, n, least, most, since + rest + elapsed, alarm, bodies, chain, outside, scales, quiet
            )
            low, n, size = least, most - least, 2 * (most - least)
            below = outside[VELOCITY, low - 1] if low > 0 else 0.0
            law = KernelLaw(*law[:-1], below)
            slope(rows, START, START + RATES, n, size, 1.0, bodies, law)
            continue
        begin, length, stretch, event, share = s, s_end - s, power, nobody, 2.0
        step(rows, n, size, s, length, power, STOP, bodies, drive, law)
        if located:
            event, share = _first_event(rows, n, bodies, law, scales, tolerance, elapsed, target, last, nobody)
        if share < 0.0:
            drive_until(elapsed, bodies, drive, law)
            slope(rows, START, START + RATES, n, size, 1.0, bodies, law)
            rejected += 1
            h *= 0.5
            continue
        if event >= 0:
            begin, length, stretch, target = _step_to_event(
                rows, n, size, s, length, share, power, target, event, near, bodies, drive, law
            )
            another = nobody
            if length != 0.0 and target <= final:
                another = _first_event(rows, n, bodies, law, scales, tolerance, elapsed, target, last, event)[0]
            if length == 0.0 or target > final or another >= 0:
                rejected += 1
                h *= 0.5 if length == 0.0 or target <= final else 0.98
                continue
        e = error(rows, n, size, begin + length, length, stretch, scales, tolerance, bodies, drive, law)
        if not e <= 1.0:
            rejected += 1
            h *= step_factor(e, 1.0)
            continue
        if n < total:
            if _moves(rows, STOP, n, 0, bodies, scales, quiet):
                least = max(low - MARGIN, 0)
            if _moves(rows, STOP, n, n - 1, bodies, scales, quiet):
                most = min(low + n + MARGIN, total)
            if least < low or most > low + n:
                continue

        most_growth = 1.0 if rejected else GROWTH
        rejected, settled = 0 if target > elapsed else rejected + 1, settled + 1
        if (times[sample] - since) - rest <= target and dense_enough:
            prepare_dense(rows, n, size, begin, length, stretch, bodies, drive, law)
        while sample < times.size and (times[sample] - since) - rest <= target:
            until, row = (times[sample] - since) - rest, SPARE
            part = (_root(until, power) if stretch > 0.0 else _root(target - until, -stretch)) - begin
            if until == target:
                row = STOP
            elif dense_enough:
                evaluate_dense(rows, size, part / length)
            else:
                step(rows, n, size, begin, part, stretch, SPARE, bodies, drive, law)
            _write(samples[sample], times[sample], rows, row, low, n, size, outside)
            sample += 1
        if event >= 0:
            contact, by_power_law = event % n, law.law == POWER_LAW
            if by_power_law and event < n:
                bodies[GRIPS, event] = 1.0 - bodies[GRIPS, event]
            switches = rows[START, contact] < 0.0 or not by_power_law
            if switches and abs(rows[STOP, contact]) <= near:  # only rounding: move it to its row
                rows[STOP + ERRORS, contact] += rows[STOP, contact]
                rows[STOP, contact] = 0.0
            drive_until(target, bodies, drive, law)
            slope(rows, STOP, STOP + RATES, n, size, 1.0, bodies, law)
            further = target + rest
            later = since + further
            kept = later - since
            rest = (since - (later - kept)) + (further - kept)
            since = later
            drive[LAST] = since + rest
            s, h = 0.0, _root(target - elapsed, power) if target > elapsed else h
        else:
            s, h = s_end, length * step_factor(e, most_growth)
        last = event
        for row in range(STOP - START):
            for i in range(size):
                rows[START + row, i] = rows[STOP + row, i]
    return True


@njit(error_model="numpy")
def _moves(rows: Array, row: int, n: int, j: int, bodies: Array, scales: tuple[float, float], quiet: float) -> bool:
    """True if a body does not move uniformly.

    ``quiet`` is the change of velocity, in units of its scale, that counts as none in the time in which a body passes
    the scale of overlap. The overlap must not change, either, unless its force is negligible in the same way.
    """
    least = quiet * scales[1]
    if abs(rows[row + RATES, n + j]) * scales[0] > least * scales[1]:
        return True
    return bool(abs(rows[row + RATES, j]) > least and rows[row, j] > _negligible(bodies, j, scales, quiet))


@njit(error_model="numpy")
def _negligible(bodies: Array, j: int, scales: tuple[float, float], quiet: float) -> float:
    """Overlap of contact j whose force is negligible (``_moves``)."""
    lightness = bodies[INVERSE_MASS, j] + (bodies[INVERSE_MASS, j - 1] if j > 0 else 0.0)
    force = quiet * scales[1] * scales[1] / (scales[0] * lightness)
    return float((force / bodies[STIFFNESS, j]) ** (1.0 / EXPONENT))


@njit(error_model="numpy")
def _move_window(
    rows: Array, low: int, n: int, least: int, most: int, now: float, alarm: float, bodies: Array, chain: Array,
    outside: Array, scales: tuple[float, float], quiet: float,
) -> float:  # fmt: skip
    """Moves the window from n bodies from ``low`` on to those from ``least`` to ``most``.

    Returns:
        Time at which the first two of the bodies outside meet.
    """
    for j in range(n):
        chain[GRIPS, low + j] = bodies[GRIPS, j]
        for part in range(2):
            outside[OVERLAP + part, low + j] = rows[START + part, j]
            outside[VELOCITY + part, low + j] = rows[START + part, n + j]
        outside[SINCE, low + j] = now
    for j in range(least, most):
        if not low <= j < low + n:
            outside[OVERLAP, j] = _outside_overlap(outside, j, outside[VELOCITY, j - 1] if j > 0 else 0.0, now)
            outside[OVERLAP + ERRORS, j], outside[SINCE, j] = 0.0, now
    wide = most - least
    for j in range(wide):
        for part in range(2):
            rows[START + part, j] = outside[OVERLAP + part, least + j]
            rows[START + part, wide + j] = outside[VELOCITY + part, least + j]
        for row in range(len(bodies)):
            bodies[row, j] = chain[row, least + j]
    bodies[FORCE, wide] = 0.0
    if most < chain.shape[1] - 1:
        bodies[FORCE, wide] = elastic_force(chain[STIFFNESS, most], max(outside[OVERLAP, most], 0.0))
    if least == 0 and most == chain.shape[1] - 1:
        return np.inf
    for j in range(low, low + n):
        closing = (outside[VELOCITY, j - 1] if j > 0 else 0.0) - outside[VELOCITY, j]
        if not least <= j < most and closing > 0.0 and chain[STIFFNESS, j] > 0.0:
            further = _negligible(chain, j, scales, quiet) - outside[OVERLAP, j]
            alarm = min(alarm, now + further / closing) if further >= 0.0 else alarm
    return alarm


@njit(error_model="numpy", forceinline=True)
def _outside_overlap(outside: Array, contact: int, below: float, now: float) -> float:
    """Overlap of a contact above a body with this velocity, under one outside the window."""
    moved = (below - outside[VELOCITY, contact]) * (now - outside[SINCE, contact])
    return float(outside[OVERLAP, contact] + moved)


@njit(error_model="numpy")
def _shifted(event: int, n: int, shift: int, wide: int) -> int:
    """Event of a window of n bodies in one of another width that begins so many bodies below; -1 if it is outside."""
    contact = event % n + shift
    if event < 0 or not 0 <= contact < wide:
        return -1
    return contact + wide * (event // n)


@njit(error_model="numpy")
def _write(sample: Array, now: float, rows: Array, row: int, low: int, n: int, size: int, outside: Array) -> None:
    """Writes the state in a row, and that of the bodies outside the window, to a sample."""
    total, above = outside.shape[1], low + n
    for j in range(n):
        sample[low + j] = rows[row, j]
        sample[total + low + j] = rows[row, n + j]
    for i in range(2 * n, size):
        sample[i] = rows[row, i]
    for j in range(total):
        if not low <= j < above:
            sample[total + j] = outside[VELOCITY, j]
            sample[j] = _outside_overlap(outside, j, sample[total + j - 1] if j > 0 else 0.0, now)


@njit(error_model="numpy")
def _first_event(
    rows: Array, n: int, bodies: Array, law: KernelLaw, scales: tuple[float, float], tolerance: float, elapsed: float,
    until: float, last: int, known: int,
) -> tuple[int, float]:  # fmt: skip
    """First contact that opens, closes or releases in a step (-1: none), and the fraction of the step at which it does.

    The fraction is linearly interpolated. A dissipative contact releases before it opens, except with p = 3/2: its
    opening is the event of the contact plus the number of contacts. With the power law the event is one of
    ``_first_power_event``; a negative fraction means that the step must be repeated with a smaller size.
    """
    if law.law == POWER_LAW:
        return _first_power_event(rows, n, bodies, law, scales, tolerance, elapsed, until, last, known)
    first, where = -1, 2.0
    for j in range(n):
        if j == known or bodies[STIFFNESS, j] == 0.0:
            continue
        number, before, after, tiny = j, rows[START, j], rows[STOP, j], EVENT_OVERLAP * scales[0]
        if before >= 0.0 and law.law == DAMPED and bodies[DAMPING, j] > 0.0:
            if j == last or n + j == last:
                continue
            if law.exponent == EXPONENT and after < 0.0 and n + j != known:
                number, after = n + j, after if _grip(rows, START, n, j, bodies, law) > 0.0 else 0.0
            else:
                before, after = _grip(rows, START, n, j, bodies, law), _grip(rows, STOP, n, j, bodies, law)
                tiny = EVENT_OVERLAP * bodies[DAMPING, j] * scales[1]
        if before * after < 0.0 and (abs(before) > tiny or abs(after) > tiny):
            share = before / (before - after)
            if share < where:
                first, where = number, share
    return first, where


@njit(error_model="numpy")
def _refined(
    rows: Array, n: int, share: float, contact: int, s: float, length: float, power: float, law: KernelLaw
) -> float:
    """Fraction of a step at which an overlap is zero, by the cubic polynomial of its values and speeds at both ends.

    ``share`` is the linear estimate, which is the result if Newton's method on the polynomial leaves the step.
    """
    start = rows[START, contact]
    first = length * stretch_at(s, power) * closing_speed(rows, START, n, contact, law.below)
    last = length * stretch_at(s + length, power) * closing_speed(rows, STOP, n, contact, law.below)
    change = rows[STOP, contact] - start
    square, cube = 3.0 * change - 2.0 * first - last, first + last - 2.0 * change
    x = share
    for _ in range(TRIES_ON_POLYNOMIAL):
        value = start + x * (first + x * (square + x * cube))
        x -= value / (first + x * (2.0 * square + x * 3.0 * cube))
    return x if 0.0 < x < 1.0 else share


@njit(error_model="numpy")
def _grip(rows: Array, row: int, n: int, contact: int, bodies: Array, law: KernelLaw) -> float:
    """``k d^(3/2 - p) + C d'``, negative after a closed dissipative contact has released."""
    overlap, power = max(rows[row, contact], 0.0), law.exponent
    if power <= 0.5:
        spring = bodies[STIFFNESS, contact] * overlap * root_raised(sqrt(overlap), 0.5 - power)
    else:
        spring = bodies[STIFFNESS, contact] * root_raised(sqrt(overlap), 1.5 - power)
    return float(spring + bodies[DAMPING, contact] * closing_speed(rows, row, n, contact, law.below))


@njit(error_model="numpy")
def _step_to_event(
    rows: Array, n: int, size: int, s: float, length: float, share: float, power: float, limit: float, event: int,
    near: float, bodies: Array, drive: Array, law: KernelLaw,
) -> tuple[float, float, float, float]:  # fmt: skip
    """Step that ends at an event, a zero of an overlap, force or speed; Newton's method finds the end time.

    An elastic opening is approached in ``s = sqrt(t_e - t)``, in which the motion is smooth, and a turning point of the
    power law in ``s = (t_e - t)^(1/4)``. Before a contact closes it has no force, so no change of variable is needed.
    All events but releases of dissipative contacts and those of the power law are zeros of an overlap. ``share`` is a
    first estimate of the event's place in the step of this length that was tried, ``limit`` the time of its end.

    Returns:
        Begin and length of the step in s, its power, time of the event; length 0 if the event was not found.
    """
    contact, by_power_law = event % n, law.law == POWER_LAW
    damped = event < n and law.law == DAMPED and bodies[DAMPING, contact] > 0.0
    closed, elapsed = rows[START, contact] > 0.0, _raised(s, power)
    at_zero = not by_power_law and not (closed and damped)
    if at_zero:
        share = _refined(rows, n, share, contact, s, length, power, law)
    guess = _raised(s + share * length, power)
    backwards = 4.0 if by_power_law and event >= n else 2.0 if at_zero and closed else 0.0
    low, high, past, tries = elapsed, 0.0, 0.0, MAX_TRIES
    rounding = TIME_ROUNDING * (3.0 if power == 4.0 else 1.0)  # a finer limit than s**4 resolves is never reached
    if by_power_law:  # Newton's method alone may fail after a release: keep the event bracketed
        high, tries = limit, MAX_TRIES_BETWEEN
        past = _passing(rows, n, event, bodies, law)[0]
    for _ in range(tries):
        begin, length, stretch = s, _root(guess, power) - s, power
        if backwards > 0.0:
            begin, stretch = _root(guess - elapsed, backwards), -backwards
            length = -begin
            drive[NEXT] = guess
        step(rows, n, size, begin, length, stretch, STOP, bodies, drive, law)
        value, rate = rows[STOP, contact], closing_speed(rows, STOP, n, contact, law.below)
        drive_until(guess, bodies, drive, law)
        slope(rows, STOP, STOP + RATES, n, size, 1.0, bodies, law)
        if by_power_law:
            value, rate = _passing(rows, n, event, bodies, law)
        elif not at_zero:
            value = _grip(rows, STOP, n, contact, bodies, law)
            rate *= (1.5 - law.exponent) * bodies[STIFFNESS, contact]
            rate *= max(rows[STOP, contact], TINY) ** (0.5 - law.exponent)
            rate += bodies[DAMPING, contact] * closing_speed(rows, STOP + RATES, n, contact, 0.0)
        if rate == 0.0 and not by_power_law:
            break
        change = -value / rate
        if at_zero:  # to second order, which saves a step
            bend = 0.5 * change * closing_speed(rows, STOP + RATES, n, contact, 0.0) / rate
            change *= 1.0 - bend if abs(bend) < 0.5 else 1.0
        if abs(change) <= rounding * guess + 1e-14 * (guess - elapsed) or (at_zero and abs(value) <= near):
            return begin, length, stretch, guess
        if by_power_law:
            low, high = (low, guess) if value * past > 0.0 else (guess, high)
            guess = guess + change if low < guess + change < high else 0.5 * (low + high)
        else:
            guess = guess + change if guess + change > elapsed else 0.5 * (guess + elapsed)
    return 0.0, 0.0, power, guess


@njit(error_model="numpy")
def _power_grip(rows: Array, row: int, n: int, contact: int, bodies: Array, law: KernelLaw) -> float:
    """``(k d^(3/2))^(1/alpha) + gamma^(1/alpha) d'``, negative after a closed contact has released."""
    overlap, inverse = max(rows[row, contact], 0.0), 1.0 / law.exponent
    spring = (bodies[STIFFNESS, contact] * overlap * sqrt(overlap)) ** inverse
    return float(spring + bodies[DAMPING, contact] ** inverse * closing_speed(rows, row, n, contact, law.below))


@njit(error_model="numpy")
def _first_grips(rows: Array, n: int, located: bool, bodies: Array, law: KernelLaw) -> None:
    """Sets ``GRIPS`` at time 0: contacts with overlap, or touching and not separating, that are not released."""
    for j in range(n):
        holds = rows[START, j] >= 0.0 and _power_grip(rows, START, n, j, bodies, law) >= 0.0
        bodies[GRIPS, j] = 0.0 if bodies[STIFFNESS, j] == 0.0 or (located and not holds) else 1.0 if located else -1.0


@njit(error_model="numpy")
def _first_power_event(
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
                before = sign * _power_grip(rows, START, n, j, bodies, law)
                after = sign * _power_grip(rows, STOP, n, j, bodies, law)
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
def _passing(rows: Array, n: int, event: int, bodies: Array, law: KernelLaw) -> tuple[float, float]:
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
    return _power_grip(rows, STOP, n, contact, bodies, law), rate
