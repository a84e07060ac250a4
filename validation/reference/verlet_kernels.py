"""Kernels of velocity Verlet; imported only for an integration, since the import loads compiled code."""

from collections.abc import Callable
from math import sqrt
from typing import Any

import numpy as np
from numba import njit

from validation.reference.contact_kernels import CACHED, copy, drive_value, elastic_force, power_force, root_raised
from validation.reference.hertz_chain import ENERGY_SHARE, Array, Flag

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


@njit(cache=CACHED, nogil=True, error_model="numpy")
def follow(
    arrays: Arrays, drive: DriveArrays, dt: float, steps: int, load: Array, mass: Array, overlaps: Array,
    speeds: Array, stop: Flag,
) -> tuple[float, float]:  # fmt: skip
    """Updates the largest overlaps, and speeds while a contact has a force, at all steps from time 0 on.

    These speeds and the kinetic energy are those of half a step before: at the time of the forces the velocities of a
    zigzag from step to step are 0. ``mass`` is 0 for a body whose energy does not count. Returns the largest kinetic
    energy and the largest rise of the total energy, that of a chain without a drive; NaN after a blow-up.
    """
    velocity, overlap, force, stiffness, kick, drop = arrays[:6]
    driven, largest, start, risen, worked = drive[0].size > 0, 0.0, 0.0, 0.0, 0.0
    for step in range(steps + 1):
        if stop[0]:
            break
        if driven:
            _drive(arrays, drive, load, dt, step)
        below, kinetic, total = 0.0, 0.0, 0.0
        for j in range(overlap.size):
            here, closed = velocity[j], max(overlap[j], 0.0)
            if force[j] > 0.0:
                speeds[j] = max(speeds[j], abs(below - here))
            overlaps[j] = max(overlaps[j], overlap[j])
            below = here
            kinetic += 0.5 * mass[j] * here * here
            now = here + 0.5 * (kick[j] * (force[j] - force[j + 1]) + drop[j])
            total += 0.5 * mass[j] * now * now + ENERGY_SHARE * stiffness[j] * closed * closed * sqrt(closed)
            worked += dt * load[j] * here if step else 0.0
        if not kinetic < np.inf:
            return np.nan, np.nan
        start = start if step else total
        largest, risen = max(largest, kinetic), max(risen, total - worked - start)
        _step(arrays, dt)
    return largest, 0.0 if driven else risen


@njit(error_model="numpy")
def _powers(
    arrays: Arrays, drive: DriveArrays, half_kick: Array, load: Array, rate: float, static: Array, powers: Array
) -> None:
    """Fills the integrands of ``hertz_chain.motion_of``; only those of a drive if there is no room for more.

    The first is ``-N`` for a displacement, whose rate may jump between steps.
    """
    velocity, overlap, force, stiffness = arrays[:4]
    n, body, held = overlap.size, drive[1], drive[0].size > 0 and drive[2]
    if drive[0].size:
        net = force[body] - force[body + 1] + load[body]
        powers[1] = -net if held else load[body] - drive[3]
        powers[0] = powers[1] * (1.0 if held else velocity[body] + half_kick[body] * net)
    below = 0.0
    for j in range(n if powers.size > 2 else 0):
        here = rate if held and j == body else velocity[j] + half_kick[j] * (force[j] - force[j + 1] + load[j])
        powers[2 + j] = (force[j] - elastic_force(stiffness[j], max(overlap[j], 0.0))) * (below - here)
        powers[2 + n + j] = (static[j] - force[j]) * here
        below = here


@njit(cache=CACHED, nogil=True, error_model="numpy")
def fill_samples(
    arrays: Arrays, drive: DriveArrays, dt: float, every: int, half_kick: Array, load: Array, forces: Array,
    overlaps: Array, velocities: Array, sums: Array | None, static: Array, stop: Flag,
) -> None:  # fmt: skip
    """Fills the samples, the first with the initial state; velocities are shifted to the time of the forces.

    Integrals are sums over all steps by the trapezoidal rule: so the kinetic energy changes by the work of the forces.
    ``sums`` is None without integrals: numba then compiles a kernel that has none.
    """
    velocity, overlap, force = arrays[:3]
    step, driven, rate = 0, drive[0].size > 0, 0.0
    if driven:
        rate = _drive(arrays, drive, load, dt, step)
    if sums is not None:
        running, powers, before = np.zeros(sums.shape[1]), np.zeros(sums.shape[1]), np.zeros(sums.shape[1])
        _powers(arrays, drive, half_kick, load, rate, static, powers)
    for sample in range(len(forces)):
        for _ in range(every if sample else 0):
            if stop[0]:
                return
            mean_rate = velocity[drive[1]]  # of a body that moves as prescribed, from step to step
            _step(arrays, dt)
            step += 1
            if driven:
                rate = _drive(arrays, drive, load, dt, step)
            if sums is not None:
                copy(powers, before)
                _powers(arrays, drive, half_kick, load, rate, static, powers)
                for i in range(running.size):
                    by_time = dt * mean_rate if i == 0 and drive[2] else dt
                    running[i] += 0.5 * by_time * (before[i] + powers[i])
        for j in range(overlap.size):
            forces[sample, j] = force[j]
            overlaps[sample, j] = overlap[j]
            velocities[sample, j] = velocity[j] + half_kick[j] * (force[j] - force[j + 1] + load[j])
        if driven and drive[2]:
            velocities[sample, drive[1]] = rate
        if sums is not None:
            copy(running, sums[sample])


@njit(cache=CACHED, nogil=True)
def integrate_absolute(
    drive: DriveArrays, mass: Array, stiffness: Array, height: Array, reach: Array, velocity: Array, load: Array,
    damping: Array, alpha: float | None, overlap_power: float, force: Array, net: Array, dt: float, every: int,
    forces: Array, heights: Array, velocities: Array, stop: Flag,
) -> None:  # fmt: skip
    """Fills the samples of ``integrate_verlet_absolute``; alpha is None without the power law."""
    n, half = mass.size, 0.5 * dt
    segments, body, prescribed, constant = drive
    start = height[body]
    for step in range((len(forces) - 1) * every + 1):
        if stop[0]:
            return
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
