"""The force trace: what every engine's raw output becomes, and where post-processing starts."""

import hashlib
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from drivers.chain.chain import Array, Chain

FORCES = "forces.parquet"


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

    def cut(values: Array | None) -> Array | None:
        return None if values is None else values[chosen]

    side = trace.sideways
    return Trace(
        time_s=trace.time_s[chosen],
        force_N=trace.force_N[chosen],
        kinetic_energy_J=trace.kinetic_energy_J[chosen],
        total_energy_J=trace.total_energy_J[chosen],
        momentum_N_s=trace.momentum_N_s[chosen],
        height_m=cut(trace.height_m),
        velocity_m_s=cut(trace.velocity_m_s),
        bore_friction_N=cut(trace.bore_friction_N),
        sideways=side and Sideways(*(getattr(side, name)[chosen] for name in side.__dataclass_fields__)),
    )


def until(trace: Trace, samples: int) -> Trace:
    """The first samples of a trace."""
    return part_of(trace, slice(samples))


def make_trace(chain: Chain, time_s: Array, force_N: Array, height_m: Array, velocity_m_s: Array) -> Trace:
    """A trace with its energies: Hertz energy (2/5) F overlap from the engine's own forces.

    A contact's overlap is ``(F/k)^(2/3)``, so that its energy is that of the force that acted. Where contacts are
    damped the force does not tell it: there it is the heights' overlap, and the energy ``(2/5) k overlap^(5/2)``.
    """
    existing = chain.stiffness > 0
    force = np.maximum(force_N[:, existing], 0.0)
    with np.errstate(over="ignore", invalid="ignore"):  # of a run that blew up, which the guard says in words
        if chain.damping_ratio:
            overlap = np.maximum(overlaps(chain, height_m)[:, existing], 0.0)
            hertz = 0.4 * chain.stiffness[existing] * overlap**2.5
        else:
            hertz = 0.4 * force * (force / chain.stiffness[existing]) ** (2 / 3)
        kinetic = 0.5 * (velocity_m_s**2 @ chain.mass_kg)
        potential = -((height_m - chain.height_m) @ chain.load_N)
        momentum = velocity_m_s @ chain.mass_kg
        total = kinetic + hertz.sum(axis=1) + potential
    return Trace(time_s, force_N, kinetic, total, momentum, height_m, velocity_m_s)


def make_sideways_trace(
    chain: Chain,
    time_s: Array,
    force_N: Array,
    height_m: Array,
    velocity_m_s: Array,
    bore_friction_N: Array | None,
    sideways: Sideways,
) -> Trace:
    """A trace of a three-dimensional chain: Hertz energy ``(2/5) k overlap^(5/2)`` from places, sideways motion, spin.

    What friction stores in shear is not seen, so with friction the energy may fall a little and return.
    """
    radius = np.where(np.isinf(chain.radius_m), 0.0, chain.radius_m)
    with np.errstate(over="ignore", invalid="ignore"):
        across = np.diff(sideways.place_m, axis=1, prepend=sideways.place_m[:, :1])
        across[:, np.isinf(chain.radius_m)] = 0.0  # a flat face is level
        along = np.diff(height_m, axis=1, prepend=chain.wall_height_m)
        overlap = radius + np.append(0.0, radius[:-1]) - np.sqrt((across**2).sum(axis=2) + along**2)
        hertz = 0.4 * np.maximum(overlap, 0.0) ** 2.5 @ chain.stiffness
        bore = chain.lateral.bore if chain.lateral else None
        if bore is not None:
            pressed = bore.overlaps(radius, sideways.place_m)
            hertz = hertz + 0.4 * (np.maximum(pressed, 0.0) ** 2.5).sum(axis=2) @ bore.stiffness
        speed = velocity_m_s**2 + (sideways.velocity_m_s**2).sum(axis=2)
        inertia = 0.4 * chain.mass_kg * radius**2
        kinetic = 0.5 * (speed @ chain.mass_kg + (sideways.spin_rad_s**2).sum(axis=2) @ inertia)
        total = kinetic + hertz - (height_m - chain.height_m) @ chain.load_N
    momentum = velocity_m_s @ chain.mass_kg
    return Trace(time_s, force_N, kinetic, total, momentum, height_m, velocity_m_s, bore_friction_N, sideways)


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

    columns = {"time_s": trace.time_s}
    columns |= {f"contact_{j}_N": column for j, column in enumerate(trace.force_N.T, start=1)}
    if trace.bore_friction_N is not None:
        columns["bore_friction_N"] = trace.bore_friction_N
    if trace.sideways is not None:
        columns |= {f"bore_{j}_N": column for j, column in enumerate(trace.sideways.bore_N.T, start=1)}
    columns |= {
        "kinetic_energy_J": trace.kinetic_energy_J,
        "total_energy_J": trace.total_energy_J,
        "momentum_N_s": trace.momentum_N_s,
    }
    pd.DataFrame(columns).to_parquet(path, index=False)


def read_forces(path: Path) -> Trace:
    """Reads ``forces.parquet`` back, bit for bit; the state is not in it."""
    import pandas as pd

    table = pd.read_parquet(path)
    contacts = [name for name in table.columns if name.startswith("contact_")]
    energies = ("kinetic_energy_J", "total_energy_J", "momentum_N_s")
    friction = table["bore_friction_N"].to_numpy(dtype=float) if "bore_friction_N" in table else None
    kinetic, total, momentum = (table[name].to_numpy(dtype=float) for name in energies)
    time, force = table["time_s"].to_numpy(dtype=float), table[contacts].to_numpy(dtype=float)
    return Trace(time, force, kinetic, total, momentum, bore_friction_N=friction)


def write_state(trace: Trace, path: Path) -> None:
    """Writes ``state.parquet``: height and velocity of each body; of a three-dimensional run x, y and spin too."""
    import pandas as pd

    assert trace.height_m is not None
    assert trace.velocity_m_s is not None
    columns = {"time_s": trace.time_s}
    columns |= {f"body_{j}_height_m": column for j, column in enumerate(trace.height_m.T, start=1)}
    columns |= {f"body_{j}_velocity_m_s": column for j, column in enumerate(trace.velocity_m_s.T, start=1)}
    if trace.sideways is not None:
        for axis, (place, velocity) in enumerate(
            zip(trace.sideways.place_m.T, trace.sideways.velocity_m_s.T, strict=True)
        ):
            columns |= {f"body_{j}_{'xy'[axis]}_m": column for j, column in enumerate(place, start=1)}
            columns |= {f"body_{j}_{'xy'[axis]}_velocity_m_s": column for j, column in enumerate(velocity, start=1)}
        for axis, spin in enumerate(trace.sideways.spin_rad_s.T):
            columns |= {f"body_{j}_spin_{'xyz'[axis]}_rad_s": column for j, column in enumerate(spin, start=1)}
    pd.DataFrame(columns).to_parquet(path, index=False)
