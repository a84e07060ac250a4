"""Kernels of a chain in a tube; imported only for an integration, since the import loads compiled code."""

from math import sqrt

import numpy as np
from numba import njit

from validation.reference.contact_kernels import CACHED, damped_force, elastic_force
from validation.reference.hertz_chain import ENERGY_SHARE, Array, Flag

INCREMENTAL, TURNED = 1, 2  # places in LAWS of tube.py
LEAST_TURN = 1e-10  # LAMMPS turns no vector whose force out of the plane is a smaller share of the limit
Three = tuple[float, float, float]
# mass, radius, stiffness, damping, shear, load; contact with the bore: stiffness, shear
Bodies = tuple[Array, Array, Array, Array, Array, Array, Array, Array]
# height of the wall, friction between bodies, radius of the bore, friction with the bore, power of overlap in damping
Numbers = tuple[float, float, float, float, float]
# place, velocity, spin, force, torque, force of the bore, axial force of the contact under each body
State = tuple[Array, Array, Array, Array, Array, Array, Array]
# stored vectors of contacts and of bore contacts, normals of both at the previous step
Memory = tuple[Array, Array, Array, Array]
# largest overlaps of contacts and of bore contacts; energies as in ``_mark_energies`` (none if they are not wanted)
Marks = tuple[Array, Array, Array]


@njit(cache=CACHED, nogil=True, error_model="numpy")
def run_tube(
    bodies: Bodies, inertia: Array, numbers: Numbers, state: State, memory: Memory, marks: Marks, law: int,
    dt: float, every: int, forces: Array, samples: Array, stop: Flag,
) -> None:  # fmt: skip
    """Runs the time loop; fills contact forces and, per body, bore force, place, velocity and spin."""
    mass = bodies[0]
    place, velocity, spin, force, torque, bore, axial = state
    _forces(bodies, numbers, state, memory, marks, law, dt, dt < 0.0)
    for j in range(mass.size):  # velocities at -1/2 step
        for axis in range(3):
            velocity[j, axis] -= 0.5 * dt * force[j, axis] / mass[j]
            spin[j, axis] -= 0.5 * dt * torque[j, axis] / inertia[j]
    for step in range((len(forces) - 1) * every + 1):
        if stop[0]:
            return
        if step or law == INCREMENTAL:  # others: the first forces use the velocities at time 0 and zero shear
            _forces(bodies, numbers, state, memory, marks, law, dt, dt > 0.0)
        if marks[2].size:
            _mark_energies(mass, inertia, bodies[5], state, marks[2], dt)
            if not marks[2][0] < np.inf:
                return
        if step % every == 0:
            sample = step // every
            for j in range(mass.size):
                forces[sample, j] = axial[j]
                for axis in range(3):
                    samples[0, sample, j, axis] = bore[j, axis]
                    samples[1, sample, j, axis] = place[j, axis]
                    samples[2, sample, j, axis] = velocity[j, axis] + 0.5 * dt * force[j, axis] / mass[j]
                    samples[3, sample, j, axis] = spin[j, axis] + 0.5 * dt * torque[j, axis] / inertia[j]
        for j in range(mass.size):
            for axis in range(3):
                velocity[j, axis] += dt * force[j, axis] / mass[j]
                place[j, axis] += dt * velocity[j, axis]
                spin[j, axis] += dt * torque[j, axis] / inertia[j]


@njit(error_model="numpy")
def _mark_energies(mass: Array, inertia: Array, load: Array, state: State, energies: Array, dt: float) -> None:
    """Updates energies: largest kinetic one (inf after a blow-up), elastic one, total at time 0, its largest rise.

    As in ``verlet_kernels.follow``: the kinetic energy half a step before, the total one at the time of the forces.
    """
    place, velocity, spin, force, torque = state[:5]
    kinetic, total = 0.0, energies[1]
    for j in range(mass.size):
        total -= load[j] * place[j, 2]
        for axis in range(3):
            now = velocity[j, axis] + 0.5 * dt * force[j, axis] / mass[j]
            kinetic += 0.5 * mass[j] * velocity[j, axis] ** 2
            total += 0.5 * mass[j] * now**2
            if inertia[j] < np.inf:
                now = spin[j, axis] + 0.5 * dt * torque[j, axis] / inertia[j]
                kinetic += 0.5 * inertia[j] * spin[j, axis] ** 2
                total += 0.5 * inertia[j] * now**2
    if np.isnan(energies[2]):
        energies[2] = total
    energies[0] = max(energies[0], kinetic) if kinetic < np.inf else np.inf
    energies[3] = max(energies[3], total - energies[2])


@njit(error_model="numpy", forceinline=True)
def _forces(
    bodies: Bodies, numbers: Numbers, state: State, memory: Memory, marks: Marks, law: int, dt: float,
    moved: bool,
) -> None:  # fmt: skip
    """Forces and torques of the present state; ``moved``: True if shear displacements advance by one step."""
    radius, load = bodies[1], bodies[5]
    force, torque, bore, axial = state[3:]
    force[:], torque[:], bore[:], axial[:] = 0.0, 0.0, 0.0, 0.0
    marks[2][1:2] = 0.0
    for j in range(radius.size):
        force[j, 2] += load[j]
        if bodies[2][j] > 0.0:
            _between(j, bodies, numbers, state, memory, marks, law, dt, moved)
        if bodies[6][j] > 0.0:
            _in_bore(j, bodies, numbers, state, memory, marks, law, dt, moved)
        if np.isinf(radius[j]):  # flat striker: stays on the axis
            force[j, 0] = force[j, 1] = 0.0


@njit(error_model="numpy", forceinline=True)
def _between(
    j: int, bodies: Bodies, numbers: Numbers, state: State, memory: Memory, marks: Marks, law: int, dt: float,
    moved: bool,
) -> None:  # fmt: skip
    """Contact under body j: sphere on wall, sphere on sphere, or flat striker on sphere."""
    _, radius, stiffness, damping, shear = bodies[:5]
    place, velocity, spin, force, torque, _, axial = state
    wall, face = j == 0, np.isinf(radius[j])
    if wall or face:
        nx, ny, nz = 0.0, 0.0, 1.0
        bead = 0 if wall else j - 1
        below = numbers[0] if wall else place[j - 1, 2]
        overlap = radius[bead] - (place[j, 2] - below)
    else:
        nx, ny, nz = place[j, 0] - place[j - 1, 0], place[j, 1] - place[j - 1, 1], place[j, 2] - place[j - 1, 2]
        apart = sqrt(nx * nx + ny * ny + nz * nz)
        nx, ny, nz = nx / apart, ny / apart, nz / apart
        overlap = radius[j] + radius[j - 1] - apart
    # arms end in the middle of the overlap, in YADE at a plane; LAMMPS takes whole radii for speeds, and at a wall
    share = 1.0 if law == INCREMENTAL and (wall or face) else 0.5
    over = 0.0 if face else radius[j] - share * overlap
    under = 0.0 if wall else radius[j - 1] - share * overlap
    further = share * overlap if law == TURNED else 0.0
    # velocity of the upper surface relative to the lower: v + n x (arm spin)
    arm = over + further
    wx, wy, wz = arm * spin[j, 0], arm * spin[j, 1], arm * spin[j, 2]
    ux, uy, uz = velocity[j, 0], velocity[j, 1], velocity[j, 2]
    if not wall:
        ux, uy, uz = ux - velocity[j - 1, 0], uy - velocity[j - 1, 1], uz - velocity[j - 1, 2]
        arm = under + further
        wx, wy, wz = wx + arm * spin[j - 1, 0], wy + arm * spin[j - 1, 1], wz + arm * spin[j - 1, 2]
    closing = -(ux * nx + uy * ny + uz * nz)
    marks[0][j] = max(marks[0][j], overlap)
    kept, before = memory[0][j], memory[2][j]
    if overlap <= 0.0:
        kept[:] = 0.0
        before[0], before[1], before[2] = nx, ny, nz
        return
    root = sqrt(overlap)
    marks[2][1:2] += ENERGY_SHARE * elastic_force(stiffness[j], overlap) * overlap
    if damping[j] > 0.0:
        normal = damped_force(stiffness[j], damping[j], numbers[4], overlap, closing)
    else:
        normal = elastic_force(stiffness[j], overlap)
    fx, fy, fz = nx * normal, ny * normal, nz * normal
    if numbers[1] > 0.0:
        ux, uy, uz = (
            ux + closing * nx + ny * wz - nz * wy,
            uy + closing * ny + nz * wx - nx * wz,
            uz + closing * nz + nx * wy - ny * wx,
        )
        turning = 0.5 * dt * _turning(j, before, spin, wall)
        tx, ty, tz = _friction(
            kept, before, (nx, ny, nz), (ux, uy, uz), turning, shear[j] * root, numbers[1] * normal, dt, law,
            moved,
        )  # fmt: skip
        fx, fy, fz = fx + tx, fy + ty, fz + tz
        over += further if wall else 0.0
        _add(torque, j, -over, (ny * tz - nz * ty, nz * tx - nx * tz, nx * ty - ny * tx))
        if not wall:
            _add(torque, j - 1, -under, (ny * tz - nz * ty, nz * tx - nx * tz, nx * ty - ny * tx))
    before[0], before[1], before[2] = nx, ny, nz
    axial[j] = fz
    _add(force, j, 1.0, (fx, fy, fz))
    if not wall:
        _add(force, j - 1, -1.0, (fx, fy, fz))


@njit(error_model="numpy", forceinline=True)
def _add(rows: Array, j: int, factor: float, vector: Three) -> None:
    for axis in range(3):
        rows[j, axis] += factor * vector[axis]


@njit(error_model="numpy", forceinline=True)
def _turning(j: int, normal: Array, spin: Array, alone: bool) -> float:
    """Sum of the two bodies' spins about the contact normal."""
    total = 0.0
    for axis in range(3):
        total += normal[axis] * (spin[j, axis] + (0.0 if alone else spin[j - 1, axis]))
    return total


@njit(error_model="numpy", forceinline=True)
def _in_bore(
    j: int, bodies: Bodies, numbers: Numbers, state: State, memory: Memory, marks: Marks, law: int, dt: float,
    moved: bool,
) -> None:  # fmt: skip
    """Contact of body j with the bore, an exact cylinder."""
    radius, stiffness, shear = bodies[1][j], bodies[6][j], bodies[7][j]
    place, velocity, spin, force, torque, bore, _ = state
    kept, before = memory[1][j], memory[3][j]
    off = sqrt(place[j, 0] * place[j, 0] + place[j, 1] * place[j, 1])
    overlap = radius - (numbers[2] - off)
    nx, ny = (-place[j, 0] / off, -place[j, 1] / off) if off > 0.0 else (0.0, 0.0)
    ux, uy, uz = velocity[j, 0], velocity[j, 1], velocity[j, 2]
    closing = -(ux * nx + uy * ny)
    marks[1][j] = max(marks[1][j], overlap)
    if overlap <= 0.0:
        kept[:] = 0.0
        before[0], before[1] = nx, ny
        return
    root = sqrt(overlap)
    normal = elastic_force(stiffness, overlap)
    marks[2][1:2] += ENERGY_SHARE * normal * overlap
    fx, fy, fz = nx * normal, ny * normal, 0.0
    if numbers[3] > 0.0:
        arm = radius if law == TURNED else radius - 0.5 * overlap
        wx, wy, wz = arm * spin[j, 0], arm * spin[j, 1], arm * spin[j, 2]
        ux, uy, uz = ux + closing * nx + ny * wz, uy + closing * ny - nx * wz, uz + nx * wy - ny * wx
        turning = 0.5 * dt * _turning(j, before, spin, True)
        tx, ty, tz = _friction(
            kept, before, (nx, ny, 0.0), (ux, uy, uz), turning, shear * root, numbers[3] * normal, dt, law,
            moved,
        )  # fmt: skip
        fx, fy, fz = fx + tx, fy + ty, fz + tz
        torque[j, 0] -= arm * ny * tz
        torque[j, 1] += arm * nx * tz
        torque[j, 2] -= arm * (nx * ty - ny * tx)
    before[0], before[1] = nx, ny
    bore[j, 0], bore[j, 1], bore[j, 2] = fx, fy, fz
    _add(force, j, 1.0, (fx, fy, fz))


@njit(error_model="numpy", forceinline=True)
def _friction(
    kept: Array, before: Array, normal: Three, slip: Three, turning: float, stiffness: float, most: float, dt: float,
    law: int, moved: bool,
) -> Three:  # fmt: skip
    """Tangential force on the upper body; updates the stored vector of the contact.

    Args:
        kept: Stored vector: shear displacement or force.
        before: Normal at the previous step.
        normal: Present normal.
        slip: Velocity of the upper surface relative to the lower, in the tangent plane.
        turning: Half of the sum of both bodies' rotations about the normal in this step.
        stiffness: Present tangential stiffness, in N/m.
        most: Coefficient of friction times the normal force.
        dt: Time step.
        law: Place of the law in ``LAWS`` of ``tube``.
        moved: As for ``_forces``.
    """
    x, y, z = kept[0], kept[1], kept[2]
    nx, ny, nz = normal
    if moved and law == INCREMENTAL:
        bx, by, bz = before[0], before[1], before[2]
        ax, ay, az = by * nz - bz * ny, bz * nx - bx * nz, bx * ny - by * nx
        x, y, z = x - (y * az - z * ay), y - (z * ax - x * az), z - (x * ay - y * ax)
        ax, ay, az = turning * bx, turning * by, turning * bz
        x, y, z = x - (y * az - z * ay), y - (z * ax - x * az), z - (x * ay - y * ax)
        x, y, z = x - stiffness * dt * slip[0], y - stiffness * dt * slip[1], z - stiffness * dt * slip[2]
    elif moved and law == TURNED:
        along = x * nx + y * ny + z * nz
        if abs(along) * stiffness > LEAST_TURN * most:
            tx, ty, tz = x - along * nx, y - along * ny, z - along * nz
            across = sqrt(tx * tx + ty * ty + tz * tz)
            scale = sqrt(x * x + y * y + z * z) / across if across > 0.0 else 0.0
            x, y, z = scale * tx, scale * ty, scale * tz
        x, y, z = x + dt * slip[0], y + dt * slip[1], z + dt * slip[2]
    elif moved:
        x, y, z = x + dt * slip[0], y + dt * slip[1], z + dt * slip[2]
        along = x * nx + y * ny + z * nz
        x, y, z = x - along * nx, y - along * ny, z - along * nz
    scale = 1.0 if law == INCREMENTAL else -stiffness
    size = abs(scale) * sqrt(x * x + y * y + z * z)
    if size > most:
        cut = most / size
        x, y, z = x * cut, y * cut, z * cut
    if moved:
        kept[0], kept[1], kept[2] = x, y, z
    return scale * x, scale * y, scale * z
