"""Kernels of velocity Verlet; imported only for an integration, since the import loads compiled code."""

from collections.abc import Callable
from math import sqrt
from typing import Any

import numpy as np
from numba import njit

from validation.reference.contact_kernels import copy, drive_value, elastic_force, power_force, root_raised
from validation.reference.hertz_chain import Array, Flag

# velocity, overlap, force (with a 0 above the chain); constants: stiffness, kick, drop, damping (empty for an elastic
# chain), alpha (0 without the power law), power of the overlap in damping
Arrays = tuple[Array, Array, Array, Array, Array, Array, Array, float, float]
DriveArrays = tuple[Array, int, bool, float]  # segments (none without a drive), body, prescribed, constant load


@njit(error_model="numpy", fastmath={"contract"}, forceinline=True)
def _elastic(j: int, overlap: float, _: float, arrays: Arrays) -> float:
    """Force of contact j from its overlap and closing speed."""
    stiffness, closed = arrays[3], max(overlap, 0.0)
    return float(stiffness[j] * (closed * sqrt(closed)))


@njit(error_model="numpy", forceinline=True)
def _damped(j: int, overlap: float, closing: float, arrays: Arrays) -> float:
    """``_elastic`` for dissipative contacts; the damping uses velocities half a step before, as in the codes."""
    stiffness, damping, root = arrays[3], arrays[6], sqrt(max(overlap, 0.0))
    return float(max(stiffness[j] * (overlap * root) + damping[j] * root_raised(root, arrays[8]) * closing, 0.0))


@njit(error_model="numpy", forceinline=True)
def _power(j: int, overlap: float, closing: float, arrays: Arrays) -> float:
    """``_damped`` for the velocity-power law."""
    stiffness, damping, alpha = arrays[3], arrays[6], arrays[7]
    return power_force(stiffness[j], damping[j], alpha, overlap, closing) if overlap >= 0.0 else 0.0


def _sweep_by(law: Callable[..., float], fastmath: bool | set[str] = False) -> Any:
    """Compiled step of all bodies by a contact law, from the wall up."""

    @njit(nogil=True, error_model="numpy", fastmath=fastmath)
    def sweep(arrays: Arrays, dt: float) -> None:
        velocity, overlap, force, _, kick, drop = arrays[:6]
        under, below = force[0], 0.0
        for j in range(overlap.size):
            above = force[j + 1]
            here = velocity[j] + (kick[j] * (under - above) + drop[j])
            velocity[j] = here
            under = above
            closing = below - here
            now = overlap[j] + dt * closing
            below = here
            overlap[j] = now
            force[j] = law(j, now, closing, arrays)

    return sweep


_sweep_elastic = _sweep_by(_elastic, {"contract"})
_sweep_damped, _sweep_power = _sweep_by(_damped), _sweep_by(_power)


@njit(nogil=True, error_model="numpy", forceinline=True)
def _step(arrays: Arrays, dt: float) -> None:
    """One step, by the law of the chain."""
    damping, alpha = arrays[6:8]
    if alpha > 0.0:
        _sweep_power(arrays, dt)
    elif damping.size:
        _sweep_damped(arrays, dt)
    else:
        _sweep_elastic(arrays, dt)


@njit(nogil=True, error_model="numpy")
def _drive(arrays: Arrays, drive: DriveArrays, load: Array, dt: float, step: int) -> float:
    """Sets the load of a driven body, or its velocity until the next step; returns the rate of the drive.

    As in the codes, the damping at a body that moves as prescribed takes the rate at the time of the forces.
    """
    velocity, overlap, force, _, kick, drop, damping, alpha = arrays[:8]
    segments, body, prescribed, constant = drive
    value, rate, _ = drive_value(segments, step * dt)
    if not prescribed:
        load[body] = constant + value
        drop[body] = kick[body] * load[body]
        return rate
    if step > 0 and (damping.size or alpha > 0.0):
        velocity[body] = rate
        for j in range(body, min(body + 2, overlap.size)):
            closing = (velocity[j - 1] if j > 0 else 0.0) - velocity[j]
            if alpha > 0.0:
                force[j] = _power(j, overlap[j], closing, arrays)
            else:
                force[j] = _damped(j, overlap[j], closing, arrays)
    velocity[body] = (drive_value(segments, (step + 1) * dt)[0] - value) / dt
    return rate


@njit(cache=True, nogil=True, error_model="numpy")
def follow(
    arrays: Arrays, drive: DriveArrays, dt: float, begin: int, times: int, half_kick: Array, load: Array,
    reduced: Array, approach: Array, overlaps: Array, closings: Array, impacts: Array, speeds: Array,
) -> None:  # fmt: skip
    """Updates the extremes by the state at some times from step ``begin`` on, each followed by a step.

    With the power law, bodies that just touch may have a force. A contact that touches at time 0 makes no impact.
    ``approach`` holds the closing speeds one step before of contacts with a gap; else 0.
    """
    velocity, overlap, force, stiffness = arrays[:4]
    for step in range(begin, begin + times):
        if drive[0].size:
            _drive(arrays, drive, load, dt, step)
        below = 0.0
        for j in range(overlap.size):
            here = velocity[j] + half_kick[j] * (force[j] - force[j + 1] + load[j])
            closing = below - here
            below = here
            pressed, apart = force[j] > 0.0, overlap[j] <= 0.0
            if pressed:
                impacts[j] += 0.5 * reduced[j] * approach[j] ** 2
            if pressed or (apart and closing > 0.0):
                speeds[j] = max(speeds[j], abs(closing))
            approach[j] = 0.0
            if stiffness[j] > 0.0:
                overlaps[j] = max(overlaps[j], overlap[j])
                if not pressed or apart:
                    closings[j] = max(closings[j], closing)
                if not pressed and overlap[j] < 0.0:
                    approach[j] = max(closing, 0.0)
        _step(arrays, dt)


@njit(cache=True, nogil=True, error_model="numpy")
def fill_samples(
    arrays: Arrays, drive: DriveArrays, dt: float, every: int, half_kick: Array, load: Array,
    forces: Array, overlaps: Array, velocities: Array, stop: Flag,
) -> None:  # fmt: skip
    """Fills the samples, the first with the initial state; velocities are shifted to the time of the forces."""
    velocity, overlap, force = arrays[:3]
    step, driven, rate = 0, drive[0].size > 0, 0.0
    if driven:
        rate = _drive(arrays, drive, load, dt, step)
    for sample in range(len(forces)):
        for _ in range(every if sample else 0):
            if stop[0]:
                return
            _step(arrays, dt)
            step += 1
            if driven:
                rate = _drive(arrays, drive, load, dt, step)
        for j in range(overlap.size):
            forces[sample, j] = force[j]
            overlaps[sample, j] = overlap[j]
            velocities[sample, j] = velocity[j] + half_kick[j] * (force[j] - force[j + 1] + load[j])
        if driven and drive[2]:
            velocities[sample, drive[1]] = rate


@njit(cache=True, nogil=True)
def integrate_absolute(
    drive: DriveArrays, mass: Array, stiffness: Array, height: Array, reach: Array, velocity: Array, load: Array,
    damping: Array, alpha: float | None, overlap_power: float, force: Array, net: Array, dt: float, every: int,
    forces: Array, heights: Array, velocities: Array,
) -> None:  # fmt: skip
    """Fills the samples of ``integrate_verlet_absolute``; alpha is None without the power law."""
    n, half = mass.size, 0.5 * dt
    segments, body, prescribed, constant = drive
    start = height[body]
    for step in range((len(forces) - 1) * every + 1):
        if step:
            for j in range(n):
                velocity[j] += half * net[j] / mass[j]
                height[j] += dt * velocity[j]
        if segments.size:
            value, rate, _ = drive_value(segments, step * dt)
            if prescribed:
                height[body], velocity[body] = start + value, rate
            else:
                load[body] = constant + value
        below = 0.0
        for j in range(n):
            overlap = reach[j] - (height[j] - below)
            below = height[j]
            force[j] = elastic_force(stiffness[j], overlap) if overlap > 0.0 else 0.0
            if overlap > 0.0 and damping[j] > 0.0:
                closing = (velocity[j - 1] if j > 0 else 0.0) - velocity[j]
                if alpha is None:
                    lost = damping[j] * root_raised(sqrt(overlap), overlap_power) * closing
                else:
                    lost = damping[j] * np.sign(closing) * abs(closing) ** alpha
                force[j] = max(force[j] + lost, 0.0)
        for j in range(n):
            net[j] = force[j] - force[j + 1] + load[j] if j != body or not prescribed else 0.0
            velocity[j] += half * net[j] / mass[j] if step else 0.0
        if step % every == 0:
            copy(force, forces[step // every])
            copy(height, heights[step // every])
            copy(velocity, velocities[step // every])
