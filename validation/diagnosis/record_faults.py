"""Faults of what was recorded, not of the motion: signs, orders, time stamps, constants."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from drivers.chain.chain import Array
from validation.diagnosis.faulty_model import Model, Motion, moved
from validation.diagnosis.variants import MOST_PLACES, number

MOST = 4_000_000  # values of a motion kept at every step
SHIFTS = 3  # samples
Recorded = tuple[str, str, Array, slice]  # kind, words, forces as they would be read, samples that have any


def recorded(model: Model, forces_N: Array) -> Iterator[Recorded]:
    """The forces of the scene, recorded wrongly.

    Args:
        model: the scene's.
        forces_N: as the run has them, from which constants and a factor are taken. Shape (samples, bodies).
    """
    samples = len(forces_N)
    right = moved(model, samples).force_N
    whole = slice(0, samples)
    yield from _stamped(model, right, samples)
    yield "sign", "forces of the other sign", -right, whole
    yield "order", "contacts in the opposite order", right[:, ::-1], whole
    for by, words in ((1, "the contact below its own"), (-1, "the contact above its own")):
        yield "order", f"forces of {words} in each place", np.roll(right, by, axis=1), whole
    for j in range(right.shape[1] - 1 if right.shape[1] <= MOST_PLACES else 0):
        swapped = right.copy()
        swapped[:, [j, j + 1]] = right[:, [j + 1, j]]
        yield "order", f"contacts {j + 1} and {j + 2} swapped", swapped, whole
    yield "static forces", "forces less those at time 0", right - right[0], whole
    for kind, words, sums in _sums(model):
        yield kind, words, right + sums, whole
    yield "factor", "no forces at all", np.zeros_like(right), whole
    factor = float((forces_N * right).sum() / ((right**2).sum() or 1.0))
    yield "factor", f"forces times {number(factor)}", factor * right, whole
    wrong = np.abs(forces_N - right).max(axis=0)
    j = int(np.argmax(wrong))
    column = right[:, j]
    own = float(forces_N[:, j] @ column / ((column**2).sum() or 1.0))
    alone = right.copy()
    alone[:, j] = own * column
    yield "factor", f"the force of contact {j + 1} alone times {number(own)}", alone, whole
    apart = forces_N.mean(axis=0) - right.mean(axis=0)
    largest = float(apart[np.argmax(np.abs(apart))])
    yield "constant", f"forces that are off by a constant in each contact, up to {largest:.3g} N", right + apart, whole


def _sums(model: Model) -> Iterator[tuple[str, str, Array]]:
    below = np.append(0.0, np.cumsum(model.load_N)[:-1])
    yield "static forces", "forces summed without the loads", -below
    yield "static forces", "forces summed with loads of the other sign", -2 * below


def _stamped(model: Model, right: Array, samples: int) -> Iterator[Recorded]:
    every, dt = model.steps_per_sample, model.time_step_s
    for shift in range(1, min(SHIFTS, samples - 1) + 1):
        words = f"forces stamped {shift} sample{'s' if shift > 1 else ''}"
        late = np.vstack([right[:1].repeat(shift, axis=0), right[:-shift]])
        yield "time stamps", f"{words} late", late, slice(shift, samples)
        later = moved(model, samples + shift).force_N[shift:]
        yield "time stamps", f"{words} early", later, slice(0, samples)
    if every == 1 or samples * every * right.shape[1] > MOST:
        return
    steps = moved(replace(model, steps_per_sample=1), samples * every + 1).force_N
    for shift in [*range(1, min(every, 20)), *([every // 2] if every > 40 else [])]:
        words = f"forces stamped {'one time step' if shift == 1 else f'{shift} time steps'}"
        size = f"({number(dt * 1e6)} us{' each' if shift > 1 else ''})"
        early = steps[shift::every][:samples]
        yield "time stamps", f"{words} {size} early", early, slice(0, samples)
        late = np.vstack([right[:1], steps[every - shift :: every][: samples - 1]])
        yield "time stamps", f"{words} {size} late", late, slice(1, samples)


def moving(model: Model, motion: Motion) -> Iterator[tuple[str, Array, Array]]:
    """Kinetic energy and momentum as recorded velocities could give them, in words; shapes (samples,)."""
    samples, half = len(motion.force_N), 0.5 * model.time_step_s
    size = f"({number(half * 1e6)} us)"
    for words, velocity in (
        (f"velocities half a step {size} late", 2 * motion.velocity_m_s - motion.later_m_s),
        (f"velocities half a step {size} early", motion.later_m_s),
        ("velocities of the other sign", -motion.velocity_m_s),
    ):
        yield words, *sums_of(model, velocity)
    early = moved(model, samples + 1).velocity_m_s[1:]
    yield "velocities a sample early", *sums_of(model, early)
    yield "velocities a sample late", *sums_of(model, np.vstack([motion.velocity_m_s[:1], motion.velocity_m_s[:-1]]))
    if model.steps_per_sample > 1 and samples * model.steps_per_sample * model.bodies <= MOST:
        steps = moved(replace(model, steps_per_sample=1), samples * model.steps_per_sample + 1).velocity_m_s
        every = model.steps_per_sample
        late = np.vstack([steps[:1], steps[every - 1 :: every][: samples - 1]])
        yield f"velocities one time step ({number(2e6 * half)} us) early", *sums_of(model, steps[1::every][:samples])
        yield f"velocities one time step ({number(2e6 * half)} us) late", *sums_of(model, late)


def sums_of(model: Model, velocity_m_s: Array) -> tuple[Array, Array]:
    """Kinetic energy and momentum of all bodies. Shapes (samples,)."""
    return 0.5 * (velocity_m_s**2 @ model.mass_kg), velocity_m_s @ model.mass_kg
