"""The exact reference: adaptive order 8 that knows when contacts open and close.

The state is overlaps and velocities, so that nothing cancels. Steps are those of ``dop853``: in
``s = sqrt(t - t_e)`` after the last event t_e; a step in which a contact opens or closes is ended right there,
and one that ends in an opening runs in ``s = sqrt(t_e - t)``. Contacts that lose energy have events of another kind:
their motion is that of ``damped``.
"""

from math import sqrt

import numpy as np
from numba import njit

from validation.reference import damped
from validation.reference.dop853 import ROWS, error, evaluate_dense, prepare_dense, step
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
DENSE_LIMIT = 1e-9  # local tolerance below which samples are integrated to, the interpolant being of lower order
TINY = 1e-13  # of the overlap scale: contacts that are open or closed by less are at no event
MAX_TRIES = 12  # of Newton's method for the time of an event
FIRST_STEP = 1e-3  # of the time scale

DONE, STUCK = 0, 1


def integrate_adaptive(chain: HertzChain, time_s: Array, tolerance: float = LEAST_TOLERANCE) -> Motion:
    """Integrates from time 0 with samples at ``time_s``, increasing from 0.

    The largest force error over all contacts and samples stays below ``tolerance`` times the largest force, as
    long as the motion itself does not multiply small errors (a chain that bounces on for long is chaotic). Contacts
    that lose energy are followed to ``damped.LEAST_TOLERANCE`` at best, whatever is asked for.

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
    start, inverse = np.concatenate([chain.overlap_m, chain.velocity_m_s]), 1.0 / chain.mass_kg
    free, scale = chain.load_N / chain.mass_kg, np.repeat([overlap_scale, speed_scale], n)
    first = FIRST_STEP * overlap_scale / speed_scale
    if chain.elastic:
        states, status = _integrate(
            start, time_s, inverse, chain.stiffness, free, LOCAL_SHARE * tolerance, scale, first
        )
    else:
        local = damped.LOCAL_SHARE * max(tolerance, damped.LEAST_TOLERANCE)
        states, ended = damped.integrate(
            start, time_s, inverse, chain.stiffness, chain.damping, free, local, scale, first
        )
        status = DONE if ended else STUCK
    if status == STUCK or not np.isfinite(states).all():
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
    start: Array, times: Array, inverse_mass: Array, stiffness: Array, acceleration: Array,
    tolerance: float, scale: Array, first_step: float,
) -> tuple[Array, int]:  # fmt: skip
    """States at all times, shape (samples, 2 bodies), and how it ended."""
    size = start.size
    state, end, work = start.copy(), np.empty(size), np.empty(size)
    slopes, spare, dense = np.zeros((ROWS, size)), np.zeros((ROWS, size)), np.empty((7, size))
    samples = np.empty((times.size, size))
    samples[0] = state
    tiny, final = TINY * scale[0], times[-1]
    time, event_time = 0.0, 0.0
    s, h, sample, rejected = 0.0, sqrt(first_step), 1, 0

    while sample < times.size:
        if rejected > 200:
            return samples, STUCK
        s = sqrt(time - event_time)
        reaches_end = s + h >= sqrt(final - event_time)
        if reaches_end:
            h = sqrt(final - event_time) - s
        step(state, s, h, 1.0, slopes, end, inverse_mass, stiffness, acceleration)
        contact, share = _first_event(state, end, stiffness, tiny)
        begin, length, sign, target = s, h, 1.0, final if reaches_end else event_time + (s + h) ** 2
        if contact >= 0:
            guess = event_time + (s + share * h) ** 2
            begin, length, sign, target = _step_to_event(
                state, time, event_time, guess, contact, slopes, end, inverse_mass, stiffness, acceleration
            )
            if length == 0.0 or target > final or _first_event(state, end, stiffness, tiny, contact)[0] >= 0:
                rejected += 1
                h *= 0.5 if length == 0.0 or target <= final else 0.98
                continue
        e = error(end, begin + length, length, sign, slopes, scale, inverse_mass, stiffness, acceleration) / tolerance
        if not e <= 1.0:
            rejected += 1
            h *= max(0.2, 0.9 * e**-0.125) if e < 1e300 else 0.2
            continue

        rejected = 0 if target > time else rejected + 1
        if sample < times.size and times[sample] <= target and tolerance >= DENSE_LIMIT:
            prepare_dense(state, end, begin, length, sign, slopes, dense, work, inverse_mass, stiffness, acceleration)
        while sample < times.size and times[sample] <= target:
            if times[sample] == target:
                samples[sample] = end
            else:
                origin = event_time if sign > 0.0 else target
                part = sqrt(max(sign * (times[sample] - origin), 0.0)) - begin
                if tolerance >= DENSE_LIMIT:
                    evaluate_dense(state, dense, part / length, samples[sample])
                else:
                    step(state, begin, part, sign, spare, work, inverse_mass, stiffness, acceleration)
                    samples[sample] = work
            sample += 1
        if contact >= 0:
            end[contact] = 0.0
            h = sqrt(target - time)
            event_time = target
        else:
            h *= min(6.0, max(0.333, 0.9 * e**-0.125)) if e > 0.0 else 6.0
        time = target
        state[:] = end
    return samples, DONE


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
    state: Array, time: float, event_time: float, guess: float, contact: int, slopes: Array, end: Array,
    inverse_mass: Array, stiffness: Array, acceleration: Array,
) -> tuple[float, float, float, float]:  # fmt: skip
    """The step that ends where a contact's overlap is zero, found by Newton's method on its end time.

    An opening is approached in ``s = sqrt(t_e - t)``, where the motion is smooth; before a closing there is no force.

    Returns:
        Begin and length of the step in s, sign of the map, time of the event; a length of 0 where none was found.
    """
    n = inverse_mass.size
    opening = state[contact] > 0.0
    for _ in range(MAX_TRIES):
        if opening:
            begin, sign = sqrt(guess - time), -1.0
            length = -begin
        else:
            begin, sign = sqrt(time - event_time), 1.0
            length = sqrt(guess - event_time) - begin
        step(state, begin, length, sign, slopes, end, inverse_mass, stiffness, acceleration)
        rate = (end[n + contact - 1] if contact > 0 else 0.0) - end[n + contact]
        if rate == 0.0:
            break
        change = -end[contact] / rate
        if abs(change) <= 4e-16 * guess + 1e-14 * (guess - time):
            return begin, length, sign, guess
        guess = guess + change if guess + change > time else 0.5 * (guess + time)
    return 0.0, 0.0, 1.0, guess
