"""The table of misreadings: a right motion recorded wrongly, in signs, orders, time stamps and factors."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from drivers.chain.chain import Array
from validation.compare.variants import Model, number
from validation.reference.hertz_chain import Motion

MAX_VALUES = 4_000_000  # of a motion kept at every step
Misreading = tuple[str, str, Array, slice]  # kind, words, values as they would be read, samples that have any


def misread_forces(model: Model, found_N: Array) -> Iterator[Misreading]:
    """The forces of a case, recorded wrongly; factors are those of the forces found. Shape (samples, bodies)."""
    right, whole = model.motion(len(found_N)).force_N, slice(None)
    for words, values, chosen in _shifted(model, len(found_N), "force_N"):
        yield "time stamps", f"forces stamped {words}", values, chosen
    yield "sign", "forces of the other sign", -right, whole
    yield "order", "contacts in the opposite order", right[:, ::-1], whole
    for j in range(right.shape[1] - 1):
        swapped = right.copy()
        swapped[:, [j, j + 1]] = right[:, [j + 1, j]]
        yield "order", f"contacts {j + 1} and {j + 2} swapped", swapped, whole
    below = np.append(0.0, np.cumsum(model.chain.load_N)[:-1])
    yield "static forces", "forces summed without the loads", right - below, whole
    yield "static forces", "forces less those at time 0", right - right[0], whole
    j = int(np.argmax(np.abs(found_N - right).max(axis=0)))
    for words, places in (("forces", whole), (f"the force of contact {j + 1} alone", slice(j, j + 1))):
        values, part = right.copy(), right[:, places]
        factor = float((found_N[:, places] * part).sum() / ((part**2).sum() or 1.0))
        values[:, places] *= factor
        yield "factor", f"{words} times {number(factor)}", values, whole


def misread_velocities(model: Model, motion: Motion) -> Iterator[Misreading]:
    """The velocities of a case, recorded wrongly."""
    change, size = half_step(model, motion), f"({number(model.time_step_s * 0.5e6)} us)"
    for words, velocity in (
        (f"half a step {size} late", motion.velocity_m_s - change),
        (f"half a step {size} early", motion.velocity_m_s + change),
        ("of the other sign", -motion.velocity_m_s),
    ):
        yield "velocities", f"velocities {words}", velocity, slice(None)
    for words, values, chosen in _shifted(model, len(motion.force_N), "velocity_m_s"):
        yield "velocities", f"velocities {words}", values, chosen


def misread_rises(model: Model, motion: Motion) -> Iterator[Misreading]:
    """What bodies have risen by since time 0, recorded wrongly."""
    for words, values, chosen in _shifted(model, len(motion.force_N), "displacement_m"):
        yield "heights", f"heights {words}", values, chosen
    yield "heights", "heights that do not change", np.zeros_like(motion.displacement_m), slice(None)


def half_step(model: Model, motion: Motion) -> Array:
    """Changes of velocities in half a time step. Shape (samples, bodies)."""
    above = np.hstack([motion.force_N[:, 1:], np.zeros((len(motion.force_N), 1))])
    return np.asarray(0.5 * model.time_step_s * (motion.force_N - above + model.chain.load_N) / model.chain.mass_kg)


def _shifted(model: Model, samples: int, name: str) -> Iterator[tuple[str, Array, slice]]:
    """Values a sample, or one time step, early and late."""
    later = getattr(model.motion(samples + 1), name)
    yield "1 sample early", later[1:], slice(None)
    yield "1 sample late", np.vstack([later[:1], later[:-2]]), slice(1, None)
    every, size = model.steps_per_sample, f"({number(model.time_step_s * 1e6)} us)"
    if not model.exact and every > 1 and samples * every * later.shape[1] <= MAX_VALUES:
        steps = getattr(replace(model, steps_per_sample=1).motion(samples * every + 1), name)
        yield f"one time step {size} early", steps[1::every][:samples], slice(None)
        yield (
            f"one time step {size} late",
            np.vstack([later[:1], steps[every - 1 :: every][: samples - 1]]),
            slice(1, None),
        )
