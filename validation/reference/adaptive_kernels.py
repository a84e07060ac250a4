"""Kernels of the exact reference; imported only for an integration, since the import loads compiled code."""

from math import sqrt
from typing import Any

import numpy as np
from numba import njit

from validation.reference.contact_kernels import CACHED, copy, root_raised
from validation.reference.dop853 import (
    POWER_LAW_LENGTH,
    ROWS,
    Bodies,
    drive_until,
    error,
    evaluate_dense,
    prepare_dense,
    slope,
    step,
    step_factor,
    stretch_at,
)
from validation.reference.hertz_chain import EXPONENT, Array, Flag
from validation.reference.power_law_events import closing_speed, first_holds, first_power_event, passing

DENSE_LIMIT = 1e-9  # local tolerance; below it damped forces rise too steeply to interpolate samples
EVENT_OVERLAP = 1e-13  # share of the overlap scale: smaller gaps and overlaps are rounding, no event
TIME_ROUNDING = 4e-16  # of a time that is computed from s, for power 2
TINY = 1e-300  # overlap, for its negative powers
MAX_TRIES = 12  # iterations of Newton's method for the time of an event
TRIES_ON_POLYNOMIAL = 4  # for the first estimate of this time
MAX_TRIES_BETWEEN = 60  # iterations with bisection as fallback
MAX_REJECTED = 200  # consecutive steps


@njit(error_model="numpy", forceinline=True)
def _raised(s: float, power: float) -> float:
    return s * s * s * s if power == 4.0 else s * s


@njit(error_model="numpy", forceinline=True)
def _root(elapsed: float, power: float) -> float:
    root = sqrt(max(elapsed, 0.0))
    return sqrt(root) if power == 4.0 else root


@njit(cache=CACHED, nogil=True, error_model="numpy")
def fill_states(
    samples: Array, start: Array, times: Array, bodies: Bodies, tolerance: float, scale: Array, first_step: float,
    stop: Flag,
) -> bool:  # fmt: skip
    """Fills states of a chain at all times; True if the integration reached the end.

    A state has overlaps, velocities, and integrals as ``hertz_chain.columns_of_sums`` counts them. Local errors of
    overlaps and velocities stay below ``tolerance`` times ``scale``, shape (2 bodies,), in each step. The states are
    filled into a given array: to return one, numba would run Python code, and lose the exception of a signal in it.
    """
    size = start.size
    state, end, work = np.zeros((3, size)), np.zeros((3, size)), np.zeros((3, size))
    slopes, spare, dense = np.zeros((ROWS, size)), np.zeros((ROWS, size)), np.empty((7, size))
    copy(start, samples[0])
    copy(start, state[0])
    return _fill(samples, state, end, work, slopes, spare, dense, times, bodies, tolerance, scale, first_step, stop)


@njit(error_model="numpy")
def _fill(
    samples: Array, state: Array, end: Array, work: Array, slopes: Array, spare: Array, dense: Array, times: Array,
    bodies: Bodies, tolerance: float, scale: Array, first_step: float, stop: Flag,
) -> bool:  # fmt: skip
    """Fills all samples after the first, which is the initial state; True if the integration reached the end."""
    power = 4.0 if bodies[2].size else 2.0
    dense_enough = power == 2.0 or tolerance >= DENSE_LIMIT
    if len(bodies) == POWER_LAW_LENGTH:
        first_holds(state[0], bodies)
    drive_until(0.0, bodies)
    slope(state[0], 1.0, state[2], bodies)
    nobody: Any = np.int64(-1)  # a literal would make numba compile the called functions again
    since, rest = 0.0, 0.0  # the sum is the time of the last event, from which other times are counted
    s, h, sample, rejected, last = 0.0, _root(first_step, power), 1, 0, nobody

    while sample < times.size:
        if rejected > MAX_REJECTED or stop[0]:
            return False
        elapsed, final = _raised(s, power), (times[-1] - since) - rest
        s_end = min(s + h, _root(final, power))
        target = final if s_end < s + h else _raised(s_end, power)
        begin, length, stretch = s, s_end - s, power
        step(state, s, length, power, slopes, end, bodies)
        event, share = _first_event(state[0], end[0], bodies, scale, tolerance, elapsed, target, last, nobody)
        if share < 0.0:
            drive_until(elapsed, bodies)
            slope(state[0], 1.0, state[2], bodies)
            rejected += 1
            h *= 0.5
            continue
        if event >= 0:
            if _at_zero_overlap(state[0], event, bodies):
                share = _refined(share, event % bodies[1].size, state[0], end[0], s, length, power, bodies)
            guess = _raised(s + share * length, power)
            begin, length, stretch, target = _step_to_event(state, s, power, guess, target, event, slopes, end, bodies)
            another = nobody
            if length != 0.0 and target <= final:
                another = _first_event(state[0], end[0], bodies, scale, tolerance, elapsed, target, last, event)[0]
            if length == 0.0 or target > final or another >= 0:
                rejected += 1
                h *= 0.5 if length == 0.0 or target <= final else 0.98
                continue
        e = error(end, begin + length, length, stretch, slopes, scale, tolerance, work, bodies)
        if not e <= 1.0:
            rejected += 1
            h *= step_factor(e)
            continue

        rejected = 0 if target > elapsed else rejected + 1
        if (times[sample] - since) - rest <= target and dense_enough:
            prepare_dense(state[0], end[0], begin, length, stretch, slopes, dense, work[0], bodies)
        while sample < times.size and (times[sample] - since) - rest <= target:
            until = (times[sample] - since) - rest
            part = (_root(until, power) if stretch > 0.0 else _root(target - until, -stretch)) - begin
            if until == target:
                copy(end[0], samples[sample])
            elif dense_enough:
                evaluate_dense(state[0], dense, part / length, samples[sample])
            else:
                step(state, begin, part, stretch, spare, work, bodies)
                copy(work[0], samples[sample])
            sample += 1
        if event >= 0:
            contact, switches = event % bodies[1].size, True
            if len(bodies) == POWER_LAW_LENGTH:
                switches = state[0, contact] < 0.0
                if event < bodies[1].size:
                    bodies[5][event] = 1.0 - bodies[5][event]
            if switches and end[0, contact] <= scale[0] * EVENT_OVERLAP:  # only rounding: move it to row 1
                end[1, contact] += end[0, contact]
                end[0, contact] = 0.0
            drive_until(target, bodies)
            slope(end[0], 1.0, end[2], bodies)
            further = target + rest
            later = since + further
            kept = later - since
            rest = (since - (later - kept)) + (further - kept)
            since = later
            bodies[-1][2][0] = since + rest
            s, h = 0.0, _root(target - elapsed, power) if target > elapsed else h
        else:
            s, h = s_end, length * step_factor(e)
        last = event
        for row in range(len(state)):
            copy(end[row], state[row])
    return True


@njit(error_model="numpy")
def _first_event(
    start: Array, end: Array, bodies: Bodies, scale: Array, tolerance: float, elapsed: float, until: float, last: int,
    known: int,
) -> tuple[int, float]:  # fmt: skip
    """First contact that opens, closes or releases in a step (-1: none), and the fraction of the step at which it does.

    The fraction is linearly interpolated. A dissipative contact releases before it opens, except with p = 3/2: its
    opening is the event of the contact plus the number of contacts. With the power law the event is one of
    ``power_law_events``; a negative fraction means that the step must be repeated with a smaller size.
    """
    if len(bodies) == POWER_LAW_LENGTH:
        return first_power_event(start, end, bodies, scale, tolerance, elapsed, until, last, known)
    stiffness, damping = bodies[1], bodies[2]
    n = stiffness.size
    first, where = -1, 2.0
    for j in range(n):
        if j == known or stiffness[j] == 0.0:
            continue
        number, before, after, tiny = j, start[j], end[j], EVENT_OVERLAP * scale[0]
        if before >= 0.0 and damping.size and damping[j] > 0.0:
            if j == last or n + j == last:
                continue
            if bodies[4] == EXPONENT and end[j] < 0.0 and n + j != known:
                number, after = n + j, after if _grip(start, j, bodies) > 0.0 else 0.0
            else:
                before, after = _grip(start, j, bodies), _grip(end, j, bodies)
                tiny = EVENT_OVERLAP * damping[j] * scale[n]
        if before * after < 0.0 and (abs(before) > tiny or abs(after) > tiny):
            share = before / (before - after)
            if share < where:
                first, where = number, share
    return first, where


@njit(error_model="numpy", forceinline=True)
def _at_zero_overlap(state: Array, event: int, bodies: Bodies) -> bool:
    """True if an event is a zero of an overlap: any but the release of a dissipative contact and of the power law."""
    if len(bodies) == POWER_LAW_LENGTH:
        return False
    if event >= bodies[1].size:
        return True
    return not (state[event] > 0.0 and bodies[2].size > 0 and bodies[2][event] > 0.0)


@njit(error_model="numpy")
def _refined(
    share: float, contact: int, start: Array, end: Array, s: float, length: float, power: float, bodies: Bodies
) -> float:
    """Fraction of a step at which an overlap is zero, by the cubic polynomial of its values and speeds at both ends.

    ``share`` is the linear estimate, which is the result if Newton's method on the polynomial leaves the step.
    """
    first = length * stretch_at(s, power) * closing_speed(start, contact, bodies)
    last = length * stretch_at(s + length, power) * closing_speed(end, contact, bodies)
    change = end[contact] - start[contact]
    square, cube = 3.0 * change - 2.0 * first - last, first + last - 2.0 * change
    x = share
    for _ in range(TRIES_ON_POLYNOMIAL):
        value = start[contact] + x * (first + x * (square + x * cube))
        x -= value / (first + x * (2.0 * square + x * 3.0 * cube))
    return x if 0.0 < x < 1.0 else share


@njit(error_model="numpy")
def _grip(state: Array, contact: int, bodies: Bodies) -> float:
    """``k d^(3/2 - p) + C d'``, negative after a closed dissipative contact has released."""
    overlap, power = max(state[contact], 0.0), bodies[4]
    if power <= 0.5:
        spring = bodies[1][contact] * overlap * root_raised(sqrt(overlap), 0.5 - power)
    else:
        spring = bodies[1][contact] * root_raised(sqrt(overlap), 1.5 - power)
    return float(spring + bodies[2][contact] * closing_speed(state, contact, bodies))


@njit(error_model="numpy")
def _step_to_event(
    state: Array, s: float, power: float, guess: float, limit: float, event: int, slopes: Array, end: Array,
    bodies: Bodies,
) -> tuple[float, float, float, float]:  # fmt: skip
    """Step that ends at an event, a zero of an overlap, force or speed; Newton's method finds the end time.

    An elastic opening is approached in ``s = sqrt(t_e - t)``, in which the motion is smooth, and a turning point of the
    power law in ``s = (t_e - t)^(1/4)``. Before a contact closes it has no force, so no change of variable is needed.
    ``guess`` is the first estimate of the event's time, ``limit`` a time after the event.

    Returns:
        Begin and length of the step in s, its power, time of the event; length 0 if the event was not found.
    """
    n = bodies[1].size
    contact = event % n
    damped = event < n and bodies[2].size > 0 and bodies[2][contact] > 0.0
    closed, elapsed = state[0, contact] > 0.0, _raised(s, power)
    backwards = 0.0
    if event >= n and len(bodies) == POWER_LAW_LENGTH:
        backwards = 4.0
    elif closed and not damped:
        backwards = 2.0
    low, high, past, tries = elapsed, 0.0, 0.0, MAX_TRIES
    rounding = TIME_ROUNDING * (3.0 if power == 4.0 else 1.0)  # a finer limit than s**4 resolves is never reached
    if len(bodies) == POWER_LAW_LENGTH:  # Newton's method alone may fail after a release: keep the event bracketed
        high, tries = limit, MAX_TRIES_BETWEEN
        past = passing(end[0], end[2], event, state[0, contact] < 0.0, bodies)[0]
    for _ in range(tries):
        begin, length, stretch = s, _root(guess, power) - s, power
        if backwards > 0.0:
            begin, stretch = _root(guess - elapsed, backwards), -backwards
            length = -begin
            bodies[-1][2][1] = guess
        step(state, begin, length, stretch, slopes, end, bodies)
        value, rate = end[0, contact], closing_speed(end[0], contact, bodies)
        drive_until(guess, bodies)
        if len(bodies) == POWER_LAW_LENGTH:
            slope(end[0], 1.0, end[2], bodies)
            value, rate = passing(end[0], end[2], event, state[0, contact] < 0.0, bodies)
        elif closed and damped:
            slope(end[0], 1.0, end[2], bodies)
            value = _grip(end[0], contact, bodies)
            rate *= (1.5 - bodies[4]) * bodies[1][contact] * max(end[0, contact], TINY) ** (0.5 - bodies[4])
            rate += bodies[2][contact] * closing_speed(end[2], contact, bodies)
        if rate == 0.0 and len(bodies) != POWER_LAW_LENGTH:
            break
        change = -value / rate
        if _at_zero_overlap(state[0], event, bodies):  # to second order, which saves a step
            slope(end[0], 1.0, end[2], bodies)
            bend = 0.5 * change * closing_speed(end[2], contact, bodies) / rate
            change *= 1.0 - bend if abs(bend) < 0.5 else 1.0
        if abs(change) <= rounding * guess + 1e-14 * (guess - elapsed):
            return begin, length, stretch, guess
        if len(bodies) == POWER_LAW_LENGTH:
            low, high = (low, guess) if value * past > 0.0 else (guess, high)
            guess = guess + change if low < guess + change < high else 0.5 * (low + high)
        else:
            guess = guess + change if guess + change > elapsed else 0.5 * (guess + elapsed)
    return 0.0, 0.0, power, guess
