"""Errors of observables, stated and planned, on random scenes of all laws of dissipation.

The true values here are read from 128 times the samples of the scene.
"""

import numpy as np
import pytest

from drivers.chain.case import Case
from drivers.chain.schemes import exact_of, verlet_of
from validation.accuracy.exact_motion import exact_motion_of, quantities
from validation.tests.helpers.scenes import case_of

TRUE_FACTOR = 128
LEAST_ERROR = 1e-8  # smaller errors are not of interest here
ACCURACY = 3e-4
LAWS = (
    (),
    ("contact.damping_ratio=0.05",),
    ("contact.dissipation=power", "contact.gamma=0.8", "contact.alpha=1.7"),
)


def train(number: int, *settings: str) -> Case:
    """A random scene of waves in a train: a heavy striker, and each law of dissipation in turn."""
    draw = np.random.default_rng(number)
    count, speed = int(draw.integers(5, 8)), 10 ** draw.uniform(-1, 0.3)
    contact_us = 4.0 * 4.76 * (0.5 / speed) ** 0.2
    step_us = contact_us / draw.uniform(15, 40)
    duration_us = int(2.5 * count * contact_us / step_us + 100) * step_us
    sensors = f"chain.sensors=[{{from_wall={count - 1}}}, {{from_wall={count - 4}}}]"
    striker = ("striker.mass=0.49 g", f"striker.speed={speed:.4g} m/s", f"gravity={draw.choice([0, 9.81])} m/s^2")
    timing = (f"run.duration={duration_us:.6g} us", f"run.sample_interval={step_us:.6g} us")
    step = f"run.time_step={step_us:.6g} us"
    return case_of("fig4", f"chain.count={count}", sensors, *striker, *LAWS[number], *timing, step, *settings)


def own_scale(name: str, values: dict[str, float]) -> float:
    """The value that an error is relative to, as the README defines it: of peaks the part above the static load."""
    if "_peak" not in name:
        return abs(values[name])
    gauge = name.partition("_peak")[0]
    return abs(values[name] - (values[f"{gauge}_peak"] - values[f"{gauge}_amplitude"]))


def errors(case: Case, found: dict[str, float], true: dict[str, float]) -> dict[str, float]:
    return {name: abs(found[name] - true[name]) / own_scale(name, true) for name in found.keys() & true.keys()}


@pytest.mark.parametrize("number", range(3))
def test_the_sampling_error_stated_is_the_true_one(number: int) -> None:
    case = train(number)
    motion = exact_motion_of(case)
    stated, right = (
        errors(case, motion.sampled, true)
        for true in (motion.true, quantities(case, exact_of(case, finer=TRUE_FACTOR)))
    )
    seen = {name: error for name, error in right.items() if error > LEAST_ERROR}
    assert len(right) > 12
    assert {name: stated[name] for name in seen} == pytest.approx(seen, rel=0.1)


@pytest.mark.parametrize("number", range(3))
def test_every_planned_accuracy_is_kept_relative_to_its_own_quantity(number: int) -> None:
    given = train(number)
    fine = quantities(given, exact_of(given, finer=TRUE_FACTOR))
    sampled = errors(given, quantities(given, exact_of(given)), fine)
    reachable = sorted(name for name, error in sampled.items() if error < 0.5 * ACCURACY)
    assert len(reachable) > 8
    for name in reachable[:: len(reachable) // 3]:  # of each kind of observable
        case = train(number, "run.time_step=", f'run.accuracy={{"{name}" = {ACCURACY}}}')
        assert errors(case, quantities(case, verlet_of(case)), fine)[name] <= 1.02 * ACCURACY, name
