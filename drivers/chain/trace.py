"""The force trace: what every engine's raw output becomes, and where post-processing starts.

Columns of the files that it is kept in, ``forces.parquet`` and ``state.parquet``, are named here alone.
"""

import hashlib
from dataclasses import dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from drivers.chain.chain import Array, Chain
from drivers.chain.contact_law import hertz_energy, hertz_energy_at
from validation.reference.hertz_chain import ENERGY_SHARE, EXPONENT

if TYPE_CHECKING:
    import pandas as pd

# numbers that hardly repeat: 30 % smaller and sooner written than by default
COMPRESSED: dict[str, Any] = {"compression": "zstd", "use_dictionary": False, "use_byte_stream_split": True}
FORCES, STATE, SENSORS = "forces.parquet", "state.parquet", "sensors.csv"  # of a run folder
CONTACT, BORE, BORE_FRICTION = "contact_{}_N", "bore_{}_N", "bore_friction_N"
BALANCES = ("kinetic_energy_J", "total_energy_J", "momentum_N_s")
PLACES = ("body_{}_x_m", "body_{}_y_m", "body_{}_height_m")
VELOCITIES = ("body_{}_x_velocity_m_s", "body_{}_y_velocity_m_s", "body_{}_velocity_m_s")
SPINS = ("body_{}_spin_x_rad_s", "body_{}_spin_y_rad_s", "body_{}_spin_z_rad_s")


@dataclass(frozen=True)
class Sideways:
    """What a three-dimensional run shows beside; arrays of shape (samples, bodies), the first three with an axis more.

    Attributes:
        place_m: of the centres off the axis, x and y.
        velocity_m_s: across the axis, x and y.
        spin_rad_s: about x, y and z.
        bore_N: by which the bore presses on each body, towards the axis.
    """

    place_m: Array
    velocity_m_s: Array
    spin_rad_s: Array
    bore_N: Array


@dataclass(frozen=True)
class Trace:
    """Samples of a run; forces are the engine's own, along the axis, compression positive.

    Attributes:
        time_s: shape (samples,).
        force_N: shape (samples, contacts); column j-1 is contact j, which lies under body j.
        kinetic_energy_J: with velocities at the time of the positions. Shape (samples,).
        total_energy_J: kinetic, Hertz, weight and precompression; weight counted from time 0. Shape (samples,).
        momentum_N_s: of all bodies, upwards positive. Shape (samples,).
        height_m: of the centres (of a flat striker: its face). Shape (samples, bodies); None where not kept.
        velocity_m_s: upwards positive. Shape (samples, bodies); None where not kept.
        bore_friction_N: along the axis, on all bodies together, upwards positive. Shape (samples,); None: no tube.
        sideways: of a three-dimensional run; None of others, and where not kept.
    """

    time_s: Array
    force_N: Array
    kinetic_energy_J: Array
    total_energy_J: Array
    momentum_N_s: Array
    height_m: Array | None = None
    velocity_m_s: Array | None = None
    bore_friction_N: Array | None = None
    sideways: Sideways | None = None


def part_of(trace: Trace, chosen: slice) -> Trace:
    """Some of a trace's samples, with all that it has of them."""

    def cut(values: Any) -> Any:
        if isinstance(values, Sideways):
            return Sideways(*(getattr(values, each.name)[chosen] for each in fields(values)))
        return None if values is None else values[chosen]

    return Trace(*(cut(getattr(trace, each.name)) for each in fields(trace)))


def until(trace: Trace, samples: int) -> Trace:
    """The first samples of a trace."""
    return part_of(trace, slice(samples))


def make_trace(
    chain: Chain,
    time_s: Array,
    force_N: Array,
    place_m: Array,
    velocity_m_s: Array,
    spin_rad_s: Array | None = None,
    bore_N: Array | None = None,
) -> Trace:
    """A trace with its energies; of a three-dimensional chain with sideways motion and spin.

    Hertz energy is that of the engine's own forces, ``(2/5) F overlap`` with the overlap ``(F/k)^(2/3)``. Where
    contacts are damped or not in line the force does not tell it: there it is ``(2/5) k overlap^(5/2)`` from places.
    What friction stores in shear is not seen, so with friction the energy may fall a little and return.

    Args:
        chain: the chain.
        time_s: shape (samples,).
        force_N: along the axis. Shape (samples, bodies).
        place_m: of centres, and of a flat striker's face: heights, shape (samples, bodies), or with x and y before
            them, shape (samples, bodies, 3).
        velocity_m_s: likewise.
        spin_rad_s: shape (samples, bodies, 3); left out where nothing turns.
        bore_N: the bore's force on each body, likewise; left out where there is no tube.
    """
    if chain.lateral is None:
        height, upward, sideways, friction = place_m, velocity_m_s, None, None
    else:
        height, upward = place_m[:, :, 2], velocity_m_s[:, :, 2]
        spin, by_bore = (np.zeros_like(place_m) if each is None else each for each in (spin_rad_s, bore_N))
        towards_axis = _towards_axis(place_m[:, :, :2], by_bore[:, :, :2])
        sideways = Sideways(place_m[:, :, :2], velocity_m_s[:, :, :2], spin, towards_axis)
        friction = by_bore[:, :, 2].sum(axis=1) if chain.bore else None
    with np.errstate(over="ignore", invalid="ignore"):  # of a run that blew up, which the guard says in words
        if sideways is not None:
            elastic = _elastic_energy(chain, sideways.place_m, height)
            speed = upward**2 + (sideways.velocity_m_s**2).sum(axis=2)
            inertia = 0.4 * chain.mass_kg * chain.sphere_radius_m**2
            kinetic = 0.5 * (speed @ chain.mass_kg + (sideways.spin_rad_s**2).sum(axis=2) @ inertia)
        else:
            there = chain.stiffness > 0
            kinetic = 0.5 * (upward**2 @ chain.mass_kg)
            if chain.damped:
                pressed = np.maximum(overlaps(chain, height)[:, there], 0.0)
                elastic = hertz_energy(chain.stiffness[there], pressed).sum(axis=1)
            else:
                elastic = hertz_energy_at(chain.stiffness[there], np.maximum(force_N[:, there], 0.0)).sum(axis=1)
        total = kinetic + elastic - (height - chain.height_m) @ chain.load_N
        momentum = upward @ chain.mass_kg
    return Trace(time_s, force_N, kinetic, total, momentum, height, upward, friction, sideways)


def _elastic_energy(chain: Chain, place_m: Array, height_m: Array) -> Array:
    """Hertz energy of all contacts, those with the bore too, from places off the axis and heights. Shape (samples,)."""
    radius = chain.sphere_radius_m
    across = np.diff(place_m, axis=1, prepend=place_m[:, :1])
    across[:, np.isinf(chain.radius_m)] = 0.0  # a flat face is level
    along = np.diff(height_m, axis=1, prepend=chain.wall_height_m)
    overlap = radius + np.append(0.0, radius[:-1]) - np.sqrt((across**2).sum(axis=2) + along**2)
    elastic = hertz_energy(1.0, np.maximum(overlap, 0.0)) @ chain.stiffness
    if chain.bore is not None:
        pressed = np.maximum(chain.bore.overlaps(radius, place_m), 0.0)
        elastic = elastic + ENERGY_SHARE * (pressed ** (1 + EXPONENT)).sum(axis=2) @ chain.bore.stiffness
    return np.asarray(elastic)


def _towards_axis(place_m: Array, bore_N: Array) -> Array:
    """The bore's force on each body towards the axis, from places and forces across it. Shape (samples, bodies)."""
    distance = np.maximum(np.hypot(place_m[:, :, 0], place_m[:, :, 1]), 1e-300)
    with np.errstate(over="ignore", invalid="ignore"):  # of a run that blew up, which the guard says in words
        return np.asarray(-(place_m * bore_N).sum(axis=2) / distance)


def overlaps(chain: Chain, height_m: Array) -> Array:
    """Overlaps from heights, a gap negative. Shape (samples, bodies)."""
    moved = height_m - chain.height_m
    return np.asarray(chain.overlap_m + np.column_stack([np.zeros(len(moved)), moved[:, :-1]]) - moved)


def energy_error_J(energy_J: Array, *, damped: bool, slips: bool) -> Array:
    """By how much a total energy errs: its change; where contacts lose energy, what it gains over its least.

    Where contacts slip their shear holds some that is not seen and comes back: what it gains over its start.
    """
    if slips:
        return np.asarray(np.maximum(energy_J - energy_J[0], 0.0))
    return np.asarray(energy_J - np.fmin.accumulate(energy_J) if damped else np.abs(energy_J - energy_J[0]))


def digest_of(trace: Trace) -> str:
    """Digest of the forces and energies: equal only where they are, bit for bit."""
    digest = hashlib.sha256()
    for array in (trace.force_N, trace.kinetic_energy_J, trace.total_energy_J, trace.momentum_N_s):
        digest.update(np.ascontiguousarray(array).data)
    return digest.hexdigest()


def write_forces(trace: Trace, path: Path) -> None:
    """Writes ``forces.parquet``: time, every contact, what the bore presses with, energies and momentum."""
    import pandas as pd

    columns = {"time_s": trace.time_s} | _numbered(CONTACT, trace.force_N)
    if trace.bore_friction_N is not None:
        columns[BORE_FRICTION] = trace.bore_friction_N
    if trace.sideways is not None:
        columns |= _numbered(BORE, trace.sideways.bore_N)
    columns |= {name: getattr(trace, name) for name in BALANCES}
    pd.DataFrame(columns).to_parquet(path, index=False, **COMPRESSED)


def read_forces(path: Path) -> Trace:
    """Reads ``forces.parquet`` back, bit for bit; the state is not in it."""
    import pandas as pd

    table = pd.read_parquet(path)
    contacts = [name for name in table.columns if name.startswith(CONTACT.split("{")[0])]
    friction = table[BORE_FRICTION].to_numpy(dtype=float) if BORE_FRICTION in table else None
    kinetic, total, momentum = (table[name].to_numpy(dtype=float) for name in BALANCES)
    time, force = table["time_s"].to_numpy(dtype=float), table[contacts].to_numpy(dtype=float)
    return Trace(time, force, kinetic, total, momentum, bore_friction_N=friction)


def read_bore_forces(path: Path, bodies: int) -> Array | None:
    """Forces between the bore and each body from ``forces.parquet``, shape (samples, bodies); None without any."""
    import pandas as pd

    table = pd.read_parquet(path)
    names = [BORE.format(j) for j in range(1, bodies + 1)]
    return _or_zero(table, names) if any(name in table for name in names) else None


def write_state(trace: Trace, path: Path) -> None:
    """Writes ``state.parquet``: height and velocity of each body; of a three-dimensional run x, y and spin too."""
    import pandas as pd

    assert trace.height_m is not None
    assert trace.velocity_m_s is not None
    columns = {"time_s": trace.time_s} | _numbered(PLACES[2], trace.height_m)
    columns |= _numbered(VELOCITIES[2], trace.velocity_m_s)
    side = trace.sideways
    if side is not None:
        for axis in (0, 1):
            columns |= _numbered(PLACES[axis], side.place_m[..., axis])
            columns |= _numbered(VELOCITIES[axis], side.velocity_m_s[..., axis])
        for axis, spin in enumerate(SPINS):
            columns |= _numbered(spin, side.spin_rad_s[..., axis])
    pd.DataFrame(columns).to_parquet(path, index=False, **COMPRESSED)


@dataclass(frozen=True)
class State:
    """Where bodies are and how they move; one that went straight up and down has 0 sideways.

    Attributes:
        time_s: shape (samples,).
        place_m: x, y and height of the centres (of a flat striker: of its face). Shape (samples, bodies, 3).
        velocity_m_s: shape (samples, bodies, 3).
    """

    time_s: Array
    place_m: Array
    velocity_m_s: Array


def read_state(path: Path, bodies: int) -> State:
    """Reads positions and velocities of so many bodies from ``state.parquet``, bit for bit.

    Raises:
        KeyError: a column that is not there.
    """
    import pandas as pd

    table = pd.read_parquet(path)
    names = {pattern: [pattern.format(j) for j in range(1, bodies + 1)] for pattern in (*PLACES, *VELOCITIES)}
    for needed in ("time_s", *names[PLACES[2]], *names[VELOCITIES[2]]):
        if needed not in table:
            raise KeyError(needed)
    place, velocity = (
        np.stack([_or_zero(table, names[pattern]) for pattern in patterns], axis=-1)
        for patterns in (PLACES, VELOCITIES)
    )
    return State(table["time_s"].to_numpy(), place, velocity)


def _numbered(pattern: str, values: Array) -> dict[str, Array]:
    """Columns of an array of shape (samples, bodies), numbered from the wall."""
    return {pattern.format(j): column for j, column in enumerate(values.T, start=1)}


def _or_zero(table: "pd.DataFrame", names: list[str]) -> Array:
    """Columns of a table, 0 where it lacks one. Shape (rows, names)."""
    return np.asarray(table.reindex(columns=names, fill_value=0.0).to_numpy(dtype=float))
