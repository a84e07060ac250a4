"""The exact reference: adaptive order 8 that knows when contacts open and close.

The state is overlaps and velocities, so that nothing cancels. Steps are those of ``dop853``: in
``s = sqrt(t - t_e)`` after the last event t_e; a step in which a contact opens or closes is ended right there,
and one that ends in an opening runs in ``s = sqrt(t_e - t)``.

The force of a contact that loses energy rises like ``(t - t_e)^(1/4)`` when it closes, and is cut off before it opens.
No stretched time makes both smooth, and none is needed: in plain time steps shrink at such an event to some 1e-11 of a
contact's time and grow again, up to sixfold each, which takes tens of steps an event. Every sample ends a step.
"""

from math import sqrt

import numpy as np
from numba import njit

from validation.reference.dop853 import (
    ROWS,
    STAGES,
    Bodies,
    error,
    evaluate_dense,
    prepare_dense,
    slope,
    step,
    step_factor,
)
from validation.reference.hertz_chain import (
    ENERGY_SHARE,
    EXPONENT,
    Array,
    HertzChain,
    Motion,
    contact_force,
    displacements,
)

LEAST_TOLERANCE = 1e-12  # what double precision gives with a margin: measured errors end near 5e-14
LOCAL_SHARE = 0.04  # local tolerance over the one asked for: measured global errors are 0.6 to 9 times the local one
LEAST_DAMPED_TOLERANCE = 1e-11  # of contacts that lose energy: measured 7.6e-12 on eight damped scenes
LOCAL_SHARE_DAMPED = 5e-4  # likewise: measured global errors are 20 to 1000 times the local one
DENSE_LIMIT = 1e-9  # local tolerance below which samples are integrated to, the interpolant being of lower order
EVENT_OVERLAP = 1e-13  # of the overlap scale: contacts that are open or closed by less are at no event
MAX_TRIES = 12  # of Newton's method for the time of an event
FIRST_STEP = 1e-3  # of the time scale
MAX_REJECTED, MAX_REJECTED_DAMPED = 200, 400  # in a row


def integrate_adaptive(chain: HertzChain, time_s: Array, tolerance: float = LEAST_TOLERANCE) -> Motion:
    """Integrates from time 0 with samples at ``time_s``, increasing from 0.

    The largest force error over all contacts and samples stays below ``tolerance`` times the largest force, as
    long as the motion itself does not multiply small errors (a chain that bounces on for long is chaotic). Contacts
    that lose energy are followed to ``LEAST_DAMPED_TOLERANCE`` at best, whatever is asked for.

    Raises:
        ValueError: sample times that do not begin at 0 or do not increase, a tolerance below what double
            precision can give or not below 1.
        ArithmeticError: the motion cannot be followed.
    """
    time_s = np.ascontiguousarray(time_s, dtype=float)
    if time_s.ndim != 1 or not time_s.size or time_s[0] != 0 or not (np.diff(time_s) > 0).all():
        raise ValueError("time_s: expected increasing times that begin at 0")
    if not np.isfinite(time_s[-1]):
        raise ValueError("time_s: not finite")
    if not LEAST_TOLERANCE <= tolerance < 1:
        raise ValueError(f"tolerance: {tolerance:g}, expected from {LEAST_TOLERANCE:g} to below 1")
    n = chain.mass_kg.size
    overlap_scale, speed_scale = scales(chain, float(time_s[-1]))
    start, scale = np.concatenate([chain.overlap_m, chain.velocity_m_s]), np.repeat([overlap_scale, speed_scale], n)
    damping = np.zeros(0) if chain.elastic else chain.damping
    bodies = (1.0 / chain.mass_kg, chain.stiffness, damping, chain.load_N / chain.mass_kg)
    first = FIRST_STEP * overlap_scale / speed_scale
    if chain.elastic:
        states, done = _integrate(start, time_s, bodies, LOCAL_SHARE * tolerance, scale, first)
    else:
        local = LOCAL_SHARE_DAMPED * max(tolerance, LEAST_DAMPED_TOLERANCE)
        states, done = _integrate_damped(start, time_s, bodies, local, scale, first)
    if not done or not np.isfinite(states).all():
        raise ArithmeticError("the adaptive reference cannot follow this motion: its steps shrink to nothing")
    overlap, velocity = np.ascontiguousarray(states[:, :n]), np.ascontiguousarray(states[:, n:])
    return Motion(contact_force(chain, overlap, velocity), displacements(chain, overlap), velocity)


def scales(chain: HertzChain, duration_s: float) -> tuple[float, float]:
    """Overlap and speed to measure errors by: those that the energy put in can reach.

    The energy is kinetic and elastic at time 0, and what the loads do by closing gaps.
    """
    energy = 0.5 * float(chain.mass_kg @ chain.velocity_m_s**2)
    energy += ENERGY_SHARE * float(chain.stiffness @ np.maximum(chain.overlap_m, 0.0) ** (1 + EXPONENT))
    fallen = np.minimum(
        np.cumsum(np.maximum(-chain.overlap_m, 0.0)), np.abs(chain.load_N) / chain.mass_kg * duration_s**2
    )
    energy += float(np.abs(chain.load_N) @ fallen)
    if energy == 0.0:  # nothing moves, or all fall together
        energy = float((chain.load_N**2 / chain.mass_kg).sum()) * duration_s**2 or 1e-300
    stiffest = float(chain.stiffness.max()) or 1.0
    return ((1 + EXPONENT) * energy / stiffest) ** ENERGY_SHARE, sqrt(2.0 * energy / float(chain.mass_kg.max()))


@njit(cache=True, error_model="numpy")
def _integrate(
    start: Array, times: Array, bodies: Bodies, tolerance: float, scale: Array, first_step: float
) -> tuple[Array, bool]:
    """States of an elastic chain at all times, shape (samples, 2 bodies), and whether it got there.

    Local errors of each step stay below ``tolerance`` times ``scale``, shape (2 bodies,).
    """
    size = start.size
    state, end, work = start.copy(), np.empty(size), np.empty(size)
    slopes, spare, dense = np.zeros((ROWS, size)), np.zeros((ROWS, size)), np.empty((7, size))
    samples = np.empty((times.size, size))
    samples[0] = state
    tiny, final = EVENT_OVERLAP * scale[0], times[-1]
    time, event_time = 0.0, 0.0
    s, h, sample, rejected = 0.0, sqrt(first_step), 1, 0

    while sample < times.size:
        if rejected > MAX_REJECTED:
            return samples, False
        s = sqrt(time - event_time)
        reaches_end = s + h >= sqrt(final - event_time)
        if reaches_end:
            h = sqrt(final - event_time) - s
        step(state, s, h, 1.0, slopes, end, bodies)
        contact, share = _first_event(state, end, bodies[1], tiny)
        begin, length, sign, target = s, h, 1.0, final if reaches_end else event_time + (s + h) ** 2
        if contact >= 0:
            guess = event_time + (s + share * h) ** 2
            begin, length, sign, target = _step_to_event(state, time, event_time, guess, contact, slopes, end, bodies)
            if length == 0.0 or target > final or _first_event(state, end, bodies[1], tiny, contact)[0] >= 0:
                rejected += 1
                h *= 0.5 if length == 0.0 or target <= final else 0.98
                continue
        e = error(end, begin + length, length, sign, slopes, scale, bodies) / tolerance
        if not e <= 1.0:
            rejected += 1
            h *= step_factor(e)
            continue

        rejected = 0 if target > time else rejected + 1
        if sample < times.size and times[sample] <= target and tolerance >= DENSE_LIMIT:
            prepare_dense(state, end, begin, length, sign, slopes, dense, work, bodies)
        while sample < times.size and times[sample] <= target:
            if times[sample] == target:
                samples[sample] = end
            else:
                origin = event_time if sign > 0.0 else target
                part = sqrt(max(sign * (times[sample] - origin), 0.0)) - begin
                if tolerance >= DENSE_LIMIT:
                    evaluate_dense(state, dense, part / length, samples[sample])
                else:
                    step(state, begin, part, sign, spare, work, bodies)
                    samples[sample] = work
            sample += 1
        if contact >= 0:
            end[contact] = 0.0
            h = sqrt(target - time)
            event_time = target
        else:
            h *= step_factor(e)
        time = target
        state[:] = end
    return samples, True


@njit(cache=True, error_model="numpy")
def _integrate_damped(
    start: Array, times: Array, bodies: Bodies, tolerance: float, scale: Array, first_step: float
) -> tuple[Array, bool]:
    """As ``_integrate``, of contacts that lose energy, in plain time."""
    state, end = start.copy(), np.empty(start.size)
    slopes = np.zeros((STAGES + 1, start.size))
    samples = np.empty((times.size, start.size))
    samples[0] = state
    time, h = 0.0, first_step
    slope(state, 1.0, slopes[0], bodies)
    for sample in range(1, times.size):
        rejected = 0
        while time < times[sample]:
            left = times[sample] - time
            last = h >= left * (1.0 - 1e-9)
            taken = left if last else h
            step(state, 0.0, taken, 0.0, slopes, end, bodies)
            e = error(end, 0.0, taken, 0.0, slopes, scale, bodies) / tolerance
            if not e <= 1.0:
                rejected += 1
                if rejected > MAX_REJECTED_DAMPED or time + taken == time:
                    return samples, False
                h = taken * step_factor(e)
                continue
            rejected = 0
            grown = taken * step_factor(e)
            h = max(h, grown) if last else grown
            time = times[sample] if last else time + taken
            state[:] = end
            slopes[0] = slopes[STAGES]
        samples[sample] = state
    return samples, True


@njit(cache=True, error_model="numpy")
def _first_event(start: Array, end: Array, stiffness: Array, tiny: float, known: int = -1) -> tuple[int, float]:
    """The contact that opens or closes first in a step, by linear interpolation, and where; -1 where none does."""
    first, where = -1, 2.0
    for j in range(stiffness.size):
        if j == known or stiffness[j] == 0.0 or start[j] * end[j] >= 0.0:
            continue
        if abs(start[j]) > tiny or abs(end[j]) > tiny:
            share = start[j] / (start[j] - end[j])
            if share < where:
                first, where = j, share
    return first, where


@njit(cache=True, error_model="numpy")
def _step_to_event(
    state: Array, time: float, event_time: float, guess: float, contact: int, slopes: Array, end: Array, bodies: Bodies
) -> tuple[float, float, float, float]:  # fmt: skip
    """The step that ends where a contact's overlap is zero, found by Newton's method on its end time.

    An opening is approached in ``s = sqrt(t_e - t)``, where the motion is smooth; before a closing there is no force.

    Returns:
        Begin and length of the step in s, sign of the map, time of the event; a length of 0 where none was found.
    """
    n = bodies[0].size
    opening = state[contact] > 0.0
    for _ in range(MAX_TRIES):
        if opening:
            begin, sign = sqrt(guess - time), -1.0
            length = -begin
        else:
            begin, sign = sqrt(time - event_time), 1.0
            length = sqrt(guess - event_time) - begin
        step(state, begin, length, sign, slopes, end, bodies)
        rate = (end[n + contact - 1] if contact > 0 else 0.0) - end[n + contact]
        if rate == 0.0:
            break
        change = -end[contact] / rate
        if abs(change) <= 4e-16 * guess + 1e-14 * (guess - time):
            return begin, length, sign, guess
        guess = guess + change if guess + change > time else 0.5 * (guess + time)
    return 0.0, 0.0, 1.0, guess
