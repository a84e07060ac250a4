"""Kernels of a chain in a tube; imported only for an integration, since the import loads compiled code."""

from math import sqrt

import numpy as np
from numba import njit

from validation.reference.contact_kernels import CACHED, damped_force, elastic_force
from validation.reference.hertz_chain import ENERGY_SHARE, VISCOELASTIC_POWER, Array, Flag

INCREMENTAL, TURNED = 1, 2  # places in LAWS of tube.py
LEAST_TURN = 1e-10  # LAMMPS turns no vector whose force out of the plane is a smaller share of the limit
Three = tuple[float, float, float]
# height of the wall, friction between bodies, radius of the bore, friction with the bore
Numbers = tuple[float, float, float, float]
# One array of each kind, since tuples of arrays would be counted as references in every step.
# rows of bodies, shape (9, bodies); load, and contacts under each body and with the bore
MASS, RADIUS, STIFFNESS, DAMPING, SHEAR, LOAD, BORE_STIFFNESS, BORE_SHEAR, INERTIA = range(9)
# rows of the state, shape (10, bodies, 3); of contacts, then of bore contacts, the stored vector and the last normal
PLACE, VELOCITY, SPIN, FORCE, TORQUE, BORE, KEPT, NORMAL, BORE_KEPT, BORE_NORMAL = range(10)
# rows of marks, shape (3, bodies): axial force of the contact under each body; largest overlaps
AXIAL, OVERLAP, BORE_OVERLAP = range(3)


@njit(cache=CACHED, nogil=True, error_model="numpy")
def run_tube(
    bodies: Array, numbers: Numbers, state: Array, marks: Array, energies: Array, law: int, dt: float, every: int,
    forces: Array, samples: Array, stop: Flag,
) -> None:  # fmt: skip
    """Runs the time loop; fills contact forces and, per body, bore force, place, velocity and spin.

    ``energies`` are those of ``_mark_energies``, none if they are not wanted.
    """
    n = bodies.shape[1]
    _forces(bodies, numbers, state, marks, energies, law, 0.0)
    for j in range(n):  # velocities at -1/2 step
        for axis in range(3):
            state[VELOCITY, j, axis] -= 0.5 * dt * state[FORCE, j, axis] / bodies[MASS, j]
            state[SPIN, j, axis] -= 0.5 * dt * state[TORQUE, j, axis] / bodies[INERTIA, j]
    for step in range((len(forces) - 1) * every + 1):
        if stop[0]:
            return
        if step or law == INCREMENTAL:  # others: the first forces use the velocities at time 0 and zero shear
            _forces(bodies, numbers, state, marks, energies, law, dt)
        if energies.size:
            _mark_energies(bodies, state, energies, dt)
            if not energies[0] < np.inf:
                return
        if step % every == 0:
            sample = step // every
            for j in range(n):
                forces[sample, j] = marks[AXIAL, j]
                for axis in range(3):
                    speed, turn = _at_forces(bodies, state, j, axis, dt)
                    samples[0, sample, j, axis] = state[BORE, j, axis]
                    samples[1, sample, j, axis] = state[PLACE, j, axis]
                    samples[2, sample, j, axis], samples[3, sample, j, axis] = speed, turn
        for j in range(n):
            for axis in range(3):
                state[VELOCITY, j, axis] += dt * state[FORCE, j, axis] / bodies[MASS, j]
                state[PLACE, j, axis] += dt * state[VELOCITY, j, axis]
                state[SPIN, j, axis] += dt * state[TORQUE, j, axis] / bodies[INERTIA, j]


@njit(error_model="numpy", forceinline=True)
def _at_forces(bodies: Array, state: Array, j: int, axis: int, dt: float) -> tuple[float, float]:
    """Velocity and spin at the time of the forces, half a step later."""
    speed = state[VELOCITY, j, axis] + 0.5 * dt * state[FORCE, j, axis] / bodies[MASS, j]
    return speed, state[SPIN, j, axis] + 0.5 * dt * state[TORQUE, j, axis] / bodies[INERTIA, j]


@njit(error_model="numpy")
def _mark_energies(bodies: Array, state: Array, energies: Array, dt: float) -> None:
    """Updates energies: largest kinetic one (inf after a blow-up), elastic one, total at time 0, its largest rise.

    As in ``verlet_kernels.follow``: the kinetic energy half a step before, the total one at the time of the forces.
    """
    kinetic, total = 0.0, energies[1]
    for j in range(bodies.shape[1]):
        mass, inertia = bodies[MASS, j], bodies[INERTIA, j]
        total -= bodies[LOAD, j] * state[PLACE, j, 2]
        for axis in range(3):
            speed, turn = _at_forces(bodies, state, j, axis, dt)
            kinetic += 0.5 * mass * state[VELOCITY, j, axis] ** 2
            total += 0.5 * mass * speed**2
            if inertia < np.inf:
                kinetic += 0.5 * inertia * state[SPIN, j, axis] ** 2
                total += 0.5 * inertia * turn**2
    if np.isnan(energies[2]):
        energies[2] = total
    energies[0] = max(energies[0], kinetic) if kinetic < np.inf else np.inf
    energies[3] = max(energies[3], total - energies[2])


@njit(error_model="numpy", forceinline=True)
def _forces(bodies: Array, numbers: Numbers, state: Array, marks: Array, energies: Array, law: int, dt: float) -> None:
    """Forces and torques of the present state; shear displacements advance by a step dt, at time 0 by none."""
    for j in range(bodies.shape[1]):
        marks[AXIAL, j] = 0.0
        for axis in range(3):
            state[FORCE, j, axis], state[TORQUE, j, axis], state[BORE, j, axis] = 0.0, 0.0, 0.0
    if energies.size:
        energies[1] = 0.0
    for j in range(bodies.shape[1]):
        state[FORCE, j, 2] += bodies[LOAD, j]
        if bodies[STIFFNESS, j] > 0.0:
            _between(j, bodies, numbers, state, marks, energies, law, dt)
        if bodies[BORE_STIFFNESS, j] > 0.0:
            _in_bore(j, bodies, numbers, state, marks, energies, law, dt)
        if np.isinf(bodies[RADIUS, j]):  # flat striker: stays on the axis
            state[FORCE, j, 0] = state[FORCE, j, 1] = 0.0


@njit(error_model="numpy", forceinline=True)
def _between(
    j: int, bodies: Array, numbers: Numbers, state: Array, marks: Array, energies: Array, law: int, dt: float
) -> None:
    """Contact under body j: sphere on wall, sphere on sphere, or flat striker on sphere."""
    wall, face = j == 0, np.isinf(bodies[RADIUS, j])
    if wall or face:
        nx, ny, nz = 0.0, 0.0, 1.0
        bead = 0 if wall else j - 1
        below = numbers[0] if wall else state[PLACE, j - 1, 2]
        overlap = bodies[RADIUS, bead] - (state[PLACE, j, 2] - below)
    else:
        x, y, z = _vector(state, PLACE, j)
        nx, ny, nz = _vector(state, PLACE, j - 1)
        nx, ny, nz = x - nx, y - ny, z - nz
        apart = sqrt(nx * nx + ny * ny + nz * nz)
        nx, ny, nz = nx / apart, ny / apart, nz / apart
        overlap = bodies[RADIUS, j] + bodies[RADIUS, j - 1] - apart
    # arms end in the middle of the overlap, in YADE at a plane; LAMMPS takes whole radii for speeds, and at a wall
    share = 1.0 if law == INCREMENTAL and (wall or face) else 0.5
    over = 0.0 if face else bodies[RADIUS, j] - share * overlap
    under = 0.0 if wall else bodies[RADIUS, j - 1] - share * overlap
    further = share * overlap if law == TURNED else 0.0
    # velocity of the upper surface relative to the lower: v + n x (arm spin)
    arm = over + further
    x, y, z = _vector(state, SPIN, j)
    wx, wy, wz = arm * x, arm * y, arm * z
    ux, uy, uz = _vector(state, VELOCITY, j)
    if not wall:
        x, y, z = _vector(state, VELOCITY, j - 1)
        ux, uy, uz = ux - x, uy - y, uz - z
        arm = under + further
        x, y, z = _vector(state, SPIN, j - 1)
        wx, wy, wz = wx + arm * x, wy + arm * y, wz + arm * z
    closing = -(ux * nx + uy * ny + uz * nz)
    marks[OVERLAP, j] = max(marks[OVERLAP, j], overlap)
    if overlap <= 0.0:
        _set(state, KEPT, j, (0.0, 0.0, 0.0))
        _set(state, NORMAL, j, (nx, ny, nz))
        return
    root = sqrt(overlap)
    if energies.size:
        energies[1] += ENERGY_SHARE * elastic_force(bodies[STIFFNESS, j], overlap) * overlap
    normal = damped_force(bodies[STIFFNESS, j], bodies[DAMPING, j], VISCOELASTIC_POWER, overlap, closing)
    fx, fy, fz = nx * normal, ny * normal, nz * normal
    if numbers[1] > 0.0:
        ux, uy, uz = (
            ux + closing * nx + ny * wz - nz * wy,
            uy + closing * ny + nz * wx - nx * wz,
            uz + closing * nz + nx * wy - ny * wx,
        )
        tx, ty, tz = _friction(
            j, KEPT, state, (nx, ny, nz), (ux, uy, uz), wall, bodies[SHEAR, j] * root, numbers[1] * normal, dt, law,
        )  # fmt: skip
        fx, fy, fz = fx + tx, fy + ty, fz + tz
        over += further if wall else 0.0
        _add(state, TORQUE, j, -over, (ny * tz - nz * ty, nz * tx - nx * tz, nx * ty - ny * tx))
        if not wall:
            _add(state, TORQUE, j - 1, -under, (ny * tz - nz * ty, nz * tx - nx * tz, nx * ty - ny * tx))
    _set(state, NORMAL, j, (nx, ny, nz))
    marks[AXIAL, j] = fz
    _add(state, FORCE, j, 1.0, (fx, fy, fz))
    if not wall:
        _add(state, FORCE, j - 1, -1.0, (fx, fy, fz))


@njit(error_model="numpy", forceinline=True)
def _vector(state: Array, row: int, j: int) -> Three:
    return state[row, j, 0], state[row, j, 1], state[row, j, 2]


@njit(error_model="numpy", forceinline=True)
def _add(state: Array, row: int, j: int, factor: float, vector: Three) -> None:
    for axis in range(3):
        state[row, j, axis] += factor * vector[axis]


@njit(error_model="numpy", forceinline=True)
def _set(state: Array, row: int, j: int, vector: Three) -> None:
    for axis in range(3):
        state[row, j, axis] = vector[axis]


@njit(error_model="numpy", forceinline=True)
def _in_bore(
    j: int, bodies: Array, numbers: Numbers, state: Array, marks: Array, energies: Array, law: int, dt: float
) -> None:
    """Contact of body j with the bore, an exact cylinder."""
    radius, stiffness = bodies[RADIUS, j], bodies[BORE_STIFFNESS, j]
    x, y = state[PLACE, j, 0], state[PLACE, j, 1]
    off = sqrt(x * x + y * y)
    overlap = radius - (numbers[2] - off)
    nx, ny = (-x / off, -y / off) if off > 0.0 else (0.0, 0.0)
    ux, uy, uz = _vector(state, VELOCITY, j)
    closing = -(ux * nx + uy * ny)
    marks[BORE_OVERLAP, j] = max(marks[BORE_OVERLAP, j], overlap)
    if overlap <= 0.0:
        _set(state, BORE_KEPT, j, (0.0, 0.0, 0.0))
        _set(state, BORE_NORMAL, j, (nx, ny, 0.0))
        return
    root = sqrt(overlap)
    normal = elastic_force(stiffness, overlap)
    if energies.size:
        energies[1] += ENERGY_SHARE * normal * overlap
    fx, fy, fz = nx * normal, ny * normal, 0.0
    if numbers[3] > 0.0:
        arm = radius if law == TURNED else radius - 0.5 * overlap
        wx, wy, wz = _vector(state, SPIN, j)
        wx, wy, wz = arm * wx, arm * wy, arm * wz
        ux, uy, uz = ux + closing * nx + ny * wz, uy + closing * ny - nx * wz, uz + nx * wy - ny * wx
        tx, ty, tz = _friction(
            j, BORE_KEPT, state, (nx, ny, 0.0), (ux, uy, uz), True, bodies[BORE_SHEAR, j] * root,
            numbers[3] * normal, dt, law,
        )  # fmt: skip
        fx, fy, fz = fx + tx, fy + ty, fz + tz
        state[TORQUE, j, 0] -= arm * ny * tz
        state[TORQUE, j, 1] += arm * nx * tz
        state[TORQUE, j, 2] -= arm * (nx * ty - ny * tx)
    _set(state, BORE_NORMAL, j, (nx, ny, 0.0))
    _set(state, BORE, j, (fx, fy, fz))
    _add(state, FORCE, j, 1.0, (fx, fy, fz))


@njit(error_model="numpy", forceinline=True)
def _friction(
    j: int, kept: int, state: Array, normal: Three, slip: Three, alone: bool, stiffness: float, most: float,
    dt: float, law: int,
) -> Three:  # fmt: skip
    """Tangential force on the upper body; updates the stored vector of the contact.

    Args:
        j: Place of the contact.
        kept: Row of the stored vector, shear displacement or force; the next one has the normal at the previous step.
        state: As for ``_forces``.
        normal: Present normal.
        slip: Velocity of the upper surface relative to the lower, in the tangent plane.
        alone: True if no body is below.
        stiffness: Present tangential stiffness, in N/m.
        most: Coefficient of friction times the normal force.
        dt: Time step, 0 at time 0.
        law: Place of the law in ``LAWS`` of ``tube``.
    """
    x, y, z = _vector(state, kept, j)
    nx, ny, nz = normal
    if law == INCREMENTAL:
        bx, by, bz = _vector(state, kept + 1, j)
        turning = 0.0  # of both bodies about this normal, half of it
        for axis in range(3):
            spin = state[SPIN, j, axis] + (0.0 if alone else state[SPIN, j - 1, axis])
            turning += state[kept + 1, j, axis] * spin
        turning = 0.5 * dt * turning
        ax, ay, az = by * nz - bz * ny, bz * nx - bx * nz, bx * ny - by * nx
        x, y, z = x - (y * az - z * ay), y - (z * ax - x * az), z - (x * ay - y * ax)
        ax, ay, az = turning * bx, turning * by, turning * bz
        x, y, z = x - (y * az - z * ay), y - (z * ax - x * az), z - (x * ay - y * ax)
        x, y, z = x - stiffness * dt * slip[0], y - stiffness * dt * slip[1], z - stiffness * dt * slip[2]
    elif law == TURNED:
        along = x * nx + y * ny + z * nz
        if abs(along) * stiffness > LEAST_TURN * most:
            tx, ty, tz = x - along * nx, y - along * ny, z - along * nz
            across = sqrt(tx * tx + ty * ty + tz * tz)
            scale = sqrt(x * x + y * y + z * z) / across if across > 0.0 else 0.0
            x, y, z = scale * tx, scale * ty, scale * tz
        x, y, z = x + dt * slip[0], y + dt * slip[1], z + dt * slip[2]
    else:
        x, y, z = x + dt * slip[0], y + dt * slip[1], z + dt * slip[2]
        along = x * nx + y * ny + z * nz
        x, y, z = x - along * nx, y - along * ny, z - along * nz
    scale = 1.0 if law == INCREMENTAL else -stiffness
    size = abs(scale) * sqrt(x * x + y * y + z * z)
    if size > most:
        cut = most / size
        x, y, z = x * cut, y * cut, z * cut
    _set(state, kept, j, (x, y, z))
    return scale * x, scale * y, scale * z
