"""Velocity Verlet at a fixed step: the scheme of the codes, with overlaps instead of positions.

Internal velocities lag half a step behind, so that one step is one pass over the chain. Recorded velocities belong to
the time of the forces. The first integration loads the compiled code.
"""

from typing import Any

import numpy as np

from validation.reference.hertz_chain import (
    COLUMNS,
    NEVER,
    Array,
    Extremes,
    Flag,
    HertzChain,
    Motion,
    check_timing,
    columns_of_sums,
    hertz_force,
    motion_of,
)


def integrate_verlet(
    chain: HertzChain,
    time_step_s: float,
    steps_per_sample: int,
    samples: int,
    stop: Flag = NEVER,
    *,
    energies: bool = False,
) -> Motion:
    """Integrates from time 0 and samples the motion every ``steps_per_sample`` steps, beginning at time 0.

    Half kick, drift, new forces, half kick: ``v += a dt/2; x += v dt; a = a(x); v += a dt/2``. The work of a drive, and
    with ``energies`` those of the contacts and bodies, are summed over all steps.

    Raises:
        ValueError: the step is not above zero, or a count is below one.
    """
    check_timing(time_step_s, steps_per_sample, samples)
    from validation.reference.verlet_kernels import fill_samples

    arrays, half_kick = _start(chain, time_step_s), 0.5 * time_step_s / chain.mass_kg
    force, overlap, velocity = (np.empty((samples, chain.mass_kg.size)) for _ in range(3))
    sums = np.zeros((samples, columns_of_sums(chain, energies=energies)))
    drive, static = _drive(chain, *arrays[4:6], half_kick), hertz_force(chain.stiffness, chain.overlap_m)
    kept = force, overlap, velocity, sums if sums.size else None
    fill_samples(arrays, drive, time_step_s, steps_per_sample, half_kick, chain.load_N.copy(), *kept, static, stop)
    if energies and chain.elastic:
        sums[:, 2 : 2 + chain.mass_kg.size] = 0.0  # but for rounding
    times = np.arange(samples, dtype=float) * (steps_per_sample * time_step_s)
    return motion_of(chain, times, force, overlap, velocity, sums)


def follow_verlet(chain: HertzChain, time_step_s: float, steps: int, stop: Flag = NEVER) -> Extremes:
    """Extremes of the motion over all steps of ``integrate_verlet``; no contact with a bore."""
    from validation.reference.verlet_kernels import follow

    arrays, n = _start(chain, time_step_s), chain.mass_kg.size
    # rows of one array: separate ones may all begin at the same place of a page and then share few lines of the cache
    load, mass, overlap, speed, nothing = np.zeros((5, n))
    load[:], mass[:] = chain.load_N, chain.mass_kg
    if chain.drive is not None and chain.drive.prescribed:
        mass[chain.drive.body] = 0.0
    drive = _drive(chain, *arrays[4:6])
    kinetic, risen = follow(arrays, drive, time_step_s, steps, load, mass, overlap, speed, stop)
    return Extremes(overlap, nothing, speed, float(kinetic), float(risen))


def _start(chain: HertzChain, time_step_s: float) -> tuple[Any, ...]:
    """Arrays of the kernels (``Arrays``), with velocities half a step before time 0 and force 0 above the chain."""
    force = np.append(chain.force_N, 0.0)
    velocity = chain.velocity_m_s - 0.5 * time_step_s * chain.acceleration_m_s2
    kick, drop = time_step_s / chain.mass_kg, time_step_s * chain.load_N / chain.mass_kg
    damping = np.zeros(0) if chain.elastic else chain.damping
    law = damping, float(chain.alpha) * (not chain.elastic), float(chain.overlap_power)
    return velocity, chain.overlap_m.copy(), force, chain.stiffness, kick, drop, *law


def _drive(chain: HertzChain, *kicks: Array) -> tuple[Array, int, bool, float]:
    """Drive of the kernels (``DriveArrays``); forces do not kick a body that moves as prescribed."""
    drive = chain.drive
    if drive is None:
        return np.zeros((0, COLUMNS)), 0, False, 0.0
    if drive.prescribed:
        for kick in kicks:
            kick[drive.body] = 0.0
    return drive.segments, drive.body, drive.prescribed, float(chain.load_N[drive.body])


def integrate_verlet_absolute(
    chain: HertzChain,
    height_m: Array,
    reach_m: Array,
    time_step_s: float,
    steps_per_sample: int,
    samples: int,
    stop: Flag = NEVER,
) -> Motion:
    """Integrates as ``integrate_verlet``, with heights instead of overlaps as the state, as in the codes.

    The overlap of contact j is ``reach_j - (z_j - z_{j-1})``. The result deviates from ``integrate_verlet`` by the
    rounding of absolute coordinates and its amplification by the motion.

    Args:
        chain: Bodies and contacts; the overlaps are ignored.
        height_m: Height of each body at time 0, shape (bodies,).
        reach_m: Distance of neighbouring bodies (body 1: its height) when they just touch, shape (bodies,).
        time_step_s: As for ``integrate_verlet``.
        steps_per_sample: As for ``integrate_verlet``.
        samples: As for ``integrate_verlet``.
        stop: As for ``integrate_verlet``.

    Returns:
        Motion with arrays of shape (samples, bodies).
    """
    from validation.reference.verlet_kernels import integrate_absolute

    force, height, velocity = (np.empty((samples, chain.mass_kg.size)) for _ in range(3))
    integrate_absolute(
        _drive(chain), chain.mass_kg, chain.stiffness, np.array(height_m), reach_m, chain.velocity_m_s.copy(),
        chain.load_N.copy(), chain.damping, float(chain.alpha) if chain.alpha else None, float(chain.overlap_power),
        np.zeros(len(reach_m) + 1), np.zeros(len(reach_m)), time_step_s, steps_per_sample, force, height,
        velocity, stop,
    )  # fmt: skip
    return Motion(force, height - height_m, velocity)
