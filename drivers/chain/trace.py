"""Trace of a run: the output of every engine and the input of post-processing.

This module defines the columns of its tables, of forces and of positions, and differences between two traces.
"""

import hashlib
from collections import defaultdict
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from drivers.chain.chain import Array, Chain
from validation.reference.hertz_chain import Drive, Motion, hertz_energy, hertz_energy_beyond_tangent

if TYPE_CHECKING:
    import pyarrow as pa

FORCE = "force"  # quantity: forces of all contacts
REST_SHARE = 1e-12  # of the largest force: smaller changes are rounding
MAX_COLUMNS = 2000  # bodies with columns of their own; those of longer chains share a column of lists, a list a sample
CACHED_VALUES = 100_000  # values of an array that stay in a processor's cache
CONTACT, BORE, BORE_FRICTION = "contact_{}_N", "bore_{}_N", "bore_friction_N"
BALANCES = ("kinetic_energy_J", "total_energy_J", "momentum_N_s")
# units by the endings of names of columns, longer endings first
UNITS = {"_N_s": "N s", "_rad_s": "rad/s", "_m_s": "m/s", "_N": "N", "_J": "J", "_m": "m", "_s": "s"}
# columns of the tables: name, with {} for the number of a body; field of a trace; its component
Columns = tuple[tuple[Any, ...], ...]
FORCE_COLUMNS: Columns = (
    ("time_s", "time_s"),
    (CONTACT, "force_N"),
    (BORE_FRICTION, "bore_friction_N"),
    (BORE, "bore_N"),
    *((name, name) for name in ("drive_N", "drive_work_J", "drive_impulse_N_s", *BALANCES)),
)
STATE_COLUMNS: Columns = (
    ("time_s", "time_s"),
    ("body_{}_height_m", "height_m"),
    ("body_{}_velocity_m_s", "velocity_m_s"),
    ("body_{}_x_m", "across_m", 0),
    ("body_{}_x_velocity_m_s", "across_velocity_m_s", 0),
    ("body_{}_y_m", "across_m", 1),
    ("body_{}_y_velocity_m_s", "across_velocity_m_s", 1),
    *((f"body_{{}}_spin_{axis}_rad_s", "spin_rad_s", component) for component, axis in enumerate("xyz")),
)


@dataclass(frozen=True)
class Trace:
    """Samples of a run, all at the same times; those of sideways motion are None for straight chains.

    Attributes:
        time_s: sample times. Shape (samples,).
        force_N: contact forces of the engine along the axis, compression positive. Shape (samples, contacts); column
            j-1 is contact j, below body j.
        kinetic_energy_J: kinetic energy of all bodies. Shape (samples,).
        total_energy_J: kinetic energy, and the change of Hertz energy and of the potential of weight and
            precompression since time 0, without the work of a drive where that is known. Shape (samples,).
        momentum_N_s: momentum of all bodies, upwards positive. Shape (samples,). As the energies NaN at all samples of
            an imported run whose dump does not tell.
        height_m: heights of the centres, or of a flat striker's face. Shape (samples, bodies); None if not kept.
        velocity_m_s: velocities, upwards positive. Shape (samples, bodies); None if not kept.
        bore_friction_N: sum of the bore's friction along the axis on all bodies, upwards positive. Shape (samples,);
            None without a tube.
        across_m: x and y of the centres. Shape (samples, bodies, 2).
        across_velocity_m_s: x and y velocities. Shape (samples, bodies, 2).
        spin_rad_s: spin about x, y and z. Shape (samples, bodies, 3).
        bore_N: force of the bore on each body, towards the axis. Shape (samples, bodies).
        drive_N: force of the drive on its body, upwards positive. Shape (samples,); None without a drive.
        drive_work_J, drive_impulse_N_s: work and impulse of the drive since time 0, integrated with the motion. Those
            of a code are those of its scheme; None before it has been compared with that, and without a drive.
    """

    time_s: Array
    force_N: Array
    kinetic_energy_J: Array
    total_energy_J: Array
    momentum_N_s: Array
    height_m: Array | None = None
    velocity_m_s: Array | None = None
    bore_friction_N: Array | None = None
    across_m: Array | None = None
    across_velocity_m_s: Array | None = None
    spin_rad_s: Array | None = None
    bore_N: Array | None = None
    drive_N: Array | None = None
    drive_work_J: Array | None = None
    drive_impulse_N_s: Array | None = None

    @property
    def place_m(self) -> Array:
        """Positions of the centres, if they were kept: x, y and height. Shape (samples, bodies, 3)."""
        return _vectors(self.height_m, self.across_m)

    @property
    def velocity_xyz_m_s(self) -> Array:
        """Velocities, if they were kept. Shape (samples, bodies, 3)."""
        return _vectors(self.velocity_m_s, self.across_velocity_m_s)


def _vectors(along: Array | None, across: Array | None) -> Array:
    """Vectors of their parts along and across the axis, which are 0 for straight chains."""
    assert along is not None
    return np.dstack([np.zeros((*along.shape, 2)) if across is None else across, along])


def part_of(trace: Trace, chosen: slice | NDArray[np.intp]) -> Trace:
    """Selected samples of a trace, all columns."""
    return replace(trace, **{name: values[chosen] for name, values in vars(trace).items() if values is not None})


def until(trace: Trace, samples: int) -> Trace:
    """First samples of a trace."""
    return part_of(trace, slice(samples))


def finite_part(trace: Trace) -> Trace | None:
    """Samples before the first value that is not finite; None if there are none."""
    known = np.isfinite(trace.total_energy_J) | np.isnan(trace.total_energy_J).all()
    wrong = ~(np.isfinite(trace.force_N).all(axis=1) & known)
    samples = int(np.argmax(wrong)) if wrong.any() else len(wrong)
    return until(trace, samples) if samples else None


def with_work(trace: Trace, scheme: Trace | Motion) -> Trace:
    """Trace with the work and the impulse of the drive by its scheme, at samples of the scheme or fewer."""
    if trace.drive_work_J is not None or scheme.drive_work_J is None or scheme.drive_impulse_N_s is None:
        return trace
    work, impulse = (values[: len(trace.time_s)] for values in (scheme.drive_work_J, scheme.drive_impulse_N_s))
    return replace(trace, total_energy_J=trace.total_energy_J - work, drive_work_J=work, drive_impulse_N_s=impulse)


def make_trace(
    chain: Chain,
    time_s: Array,
    force_N: Array,
    place_m: Array,
    velocity_m_s: Array,
    spin_rad_s: Array | None = None,
    bore_N: Array | None = None,
    displacement_m: Array | None = None,
) -> Trace:
    """Build a trace with its energies, and for a three-dimensional chain with sideways motion and spin.

    The Hertz energy ``(2/5) k overlap^(5/2)`` is computed from positions. The total energy leaves out its value at time
    0: the energy of a strong precompression has fewer digits than a weak wave needs. Shear energy is not included, so
    with friction the energy may decrease a little and increase again.

    Args:
        chain: the chain.
        time_s: sample times, shape (samples,).
        force_N: contact forces along the axis, shape (samples, bodies).
        place_m: heights of the centres (of a flat striker: its face), shape (samples, bodies); for a
            three-dimensional chain x, y and height, shape (samples, bodies, 3).
        velocity_m_s: velocities, same shape as ``place_m``.
        spin_rad_s: spins, shape (samples, bodies, 3); None if no body turns.
        bore_N: force of the bore on each body, shape (samples, bodies, 3); None without a tube.
        displacement_m: displacements of a straight chain since time 0, shape (samples, bodies), if they are known more
            exactly than from heights.
    """
    height, upward = (place_m, velocity_m_s) if chain.straight else (place_m[..., 2], velocity_m_s[..., 2])
    more: dict[str, Array] = {}
    with np.errstate(over="ignore", invalid="ignore"):  # runs that blow up are reported by the guard
        if not chain.straight:
            across, across_velocity = place_m[:, :, :2], velocity_m_s[:, :, :2]
            spin, by_bore = (np.zeros_like(place_m) if vectors is None else vectors for vectors in (spin_rad_s, bore_N))
            distance = np.maximum(np.hypot(across[:, :, 0], across[:, :, 1]), 1e-300)
            towards_axis = -(across * by_bore[:, :, :2]).sum(axis=2) / distance
            more = {"across_m": across, "across_velocity_m_s": across_velocity}
            more |= {"spin_rad_s": spin, "bore_N": towards_axis}
            if chain.bore_m:
                more["bore_friction_N"] = by_bore[:, :, 2].sum(axis=1)
            stored = _elastic_energy(chain, across, height)
            potential = stored - stored[0] - (height - chain.height_m) @ chain.load_N
            speed = upward**2 + (across_velocity**2).sum(axis=2)
            inertia = 0.4 * chain.mass_kg * chain.sphere_radius_m**2
            kinetic = 0.5 * (speed @ chain.mass_kg + (spin**2).sum(axis=2) @ inertia)
        else:
            moved = height - chain.height_m if displacement_m is None else displacement_m
            potential = potential_energy_change(chain, moved)
            kinetic = 0.5 * (upward**2 @ chain.mass_kg)
            if chain.drive is not None:
                more = {"drive_N": _drive_force(chain, chain.drive, time_s, force_N)}
        momentum = upward @ chain.mass_kg
    return Trace(time_s, force_N, kinetic, kinetic + potential, momentum, height, upward, **more)


def _drive_force(chain: Chain, drive: Drive, time_s: Array, force_N: Array) -> Array:
    """Force f of the drive, or ``m u'' - N`` of a displacement u with the net force N of contacts and loads."""
    value, _, bend = drive.at(time_s)
    if not drive.prescribed:
        return value
    above = force_N[:, drive.body + 1] if drive.body + 1 < chain.bodies else 0.0
    net = force_N[:, drive.body] - above + chain.load_N[drive.body]
    return np.asarray(chain.mass_kg[drive.body] * bend - net)


def potential_energy_change(chain: Chain, displacement_m: Array) -> Array:
    """Change of Hertz energy and of the potential of the loads since time 0, for a straight chain. Shape (samples,).

    With the overlap change ``x_j`` and the sum ``S_j`` of the loads on all bodies above contact j, the loads do the
    work ``-sum S_j x_j``. Of the terms linear in x, ``sum (F_j(0) + S_j) x_j`` is left, which is zero in equilibrium.

    Args:
        chain: the chain.
        displacement_m: displacements of all bodies since time 0. Shape (samples, bodies).
    """
    unbalanced_N = chain.elastic_N + np.cumsum(chain.load_N[::-1])[::-1]
    parts = np.array_split(displacement_m, -(-displacement_m.size // CACHED_VALUES))
    changes = (-np.diff(part, axis=1, prepend=0.0) for part in parts)
    energies = [
        hertz_energy_beyond_tangent(chain.stiffness, chain.overlap_m, change).sum(axis=1) + change @ unbalanced_N
        for change in changes
    ]
    return np.concatenate(energies)


def _elastic_energy(chain: Chain, place_m: Array, height_m: Array) -> Array:
    """Hertz energy of all contacts, including bore contacts, from positions. Shape (samples,)."""
    radius = chain.sphere_radius_m
    across = np.diff(place_m, axis=1, prepend=place_m[:, :1])
    across[:, np.isinf(chain.radius_m)] = 0.0  # a flat face stays level
    along = np.diff(height_m, axis=1, prepend=chain.wall_height_m)
    overlap = radius + np.append(0.0, radius[:-1]) - np.sqrt((across**2).sum(axis=2) + along**2)
    elastic = hertz_energy(1.0, np.maximum(overlap, 0.0)) @ chain.stiffness
    if chain.bore_m:
        pressed = np.maximum(np.hypot(place_m[..., 0], place_m[..., 1]) + radius - chain.bore_m, 0.0)
        elastic = elastic + hertz_energy(1.0, pressed) @ chain.bore_stiffness
    return np.asarray(elastic)


def overlaps(chain: Chain, height_m: Array) -> Array:
    """Overlaps from heights; a gap is negative. Shape (samples, bodies)."""
    return np.asarray(chain.overlap_m - np.diff(height_m - chain.height_m, axis=1, prepend=0.0))


def digest_of(trace: Trace) -> str:
    """Digest of forces and energies; equal only if all are equal bit for bit."""
    digest = hashlib.sha256()
    for array in (trace.force_N, trace.kinetic_energy_J, trace.total_energy_J, trace.momentum_N_s):
        digest.update(np.ascontiguousarray(array).data)
    return digest.hexdigest()


def table_of_trace(trace: Trace, columns: Columns, about: Mapping[str, str]) -> "pa.Table":
    """Table of those columns that a trace has, with metadata."""
    there = {name: (getattr(trace, field), axis) for name, field, *axis in columns}
    kept = {name: values[(..., *axis)] for name, (values, axis) in there.items() if values is not None}
    return table_of(kept, about)


def fields_in(table: "pa.Table", columns: Columns, bodies: int) -> dict[str, Array]:
    """Fields of a trace from a table that ``table_of_trace`` made; ``to_numpy`` of Arrow would import pandas.

    Raises:
        KeyError, ValueError: the table has columns of another number of bodies.
    """
    parts: dict[str, list[Any]] = defaultdict(list)
    for name, field, *_ in columns:
        numbered = "{}" in name
        if numbered and _together(name) in table.column_names:
            flat = np.from_dlpack(table[_together(name)].combine_chunks().flatten())
            parts[field].append(flat.reshape(len(table), bodies))
        elif numbered and name.format(1) in table.column_names:
            of_bodies = (table[name.format(body)].combine_chunks() for body in range(1, bodies + 1))
            parts[field].append(np.column_stack([*map(np.from_dlpack, of_bodies)]))
        elif name in table.column_names:
            parts[field].append(np.from_dlpack(table[name].combine_chunks()))
    return {field: part[0] if len(part) == 1 else np.stack(part, axis=-1) for field, part in parts.items()}


def table_of(columns: Mapping[str, Array], about: Mapping[str, str]) -> "pa.Table":
    """Table of arrays of shape (samples,), and of arrays of shape (samples, bodies) whose name has ``{}``.

    Each body has a column, numbered from the wall; in long chains a sample has a list. Each column has its ``unit`` as
    metadata, the table has ``about``. ``pa.array`` would import pandas, a third of a run.
    """
    import pyarrow as pa

    def arrow(values: Array) -> pa.Array:
        kind = pa.from_numpy_dtype(values.dtype)
        flat = pa.Array.from_buffers(kind, values.size, [None, pa.py_buffer(np.ascontiguousarray(values))])
        return flat if values.ndim == 1 else pa.FixedSizeListArray.from_arrays(flat, values.shape[1])

    table: dict[str, pa.Array] = {}
    for name, values in columns.items():
        if values.ndim == 1 or values.shape[1] > MAX_COLUMNS:
            table[_together(name)] = arrow(values)
        else:
            table |= {name.format(body): arrow(column) for body, column in enumerate(values.T, start=1)}
    units = {name: next((unit for ending, unit in UNITS.items() if name.endswith(ending)), "") for name in table}
    fields = [pa.field(name, values.type, metadata={"unit": units[name]}) for name, values in table.items()]
    return pa.table([*table.values()], schema=pa.schema(fields, metadata=about))


def _together(name: str) -> str:
    """Name of the column of lists."""
    return name.replace("_{}", "")


def is_at_rest(force_N: Array) -> bool:
    """True if no force changes by more than rounding. Shape (samples, contacts)."""
    change_N, largest_N = _largest(force_N)
    return change_N <= REST_SHARE * largest_N


def largest_change_N(force_N: Array) -> float:
    """Largest ``|F - F(0)|`` of any contact, the scale of force errors. Shape (samples, contacts).

    If nothing moves, the largest force; 1 N if there is no force.
    """
    change_N, largest_N = _largest(force_N)
    return (largest_N if change_N <= REST_SHARE * largest_N else change_N) or 1.0


def _largest(force_N: Array) -> tuple[float, float]:
    """Largest ``|F - F(0)|`` and ``|F|`` of any contact, from the extremes of each: no copy of a large array."""
    low, high, start = force_N.min(axis=0), force_N.max(axis=0), force_N[0]
    return float(np.maximum(high - start, start - low).max()), float(np.maximum(high, -low).max())


def largest_kinetic_J(chain: Chain, motion: Trace) -> float:
    """Largest kinetic energy, the scale of energy errors; if no force changes, at least the Hertz energy at rest."""
    resting_J = chain.resting_J if is_at_rest(motion.force_N) else 0.0
    return max(float(motion.kinetic_energy_J.max()), resting_J) or 1.0


def residual(trace: Trace, reference: Trace) -> Array:
    """Largest difference at each sample, divided by the reference's largest change of force. Shape (samples,)."""
    return np.asarray(np.abs(trace.force_N - reference.force_N).max(axis=1) / largest_change_N(reference.force_N))
