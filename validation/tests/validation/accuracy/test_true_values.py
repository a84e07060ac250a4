"""Errors of observables, stated and planned, on random scenes of all laws of dissipation.

The true values here are read from 128 times the samples of the scene.
"""

from pathlib import Path

import numpy as np
import pytest

from drivers.chain.case import Case
from drivers.chain.schemes import exact_of, verlet_of
from validation.accuracy.exact_motion import exact_motion_of, quantities
from validation.tests.helpers.scenes import case_of

TRUE_FACTOR = 128
LEAST_ERROR = 1e-8  # smaller errors are not of interest here
ACCURACY = 3e-4
SCENE = """title = "a heavy striker on a short chain"
gravity = "{gravity} m/s^2"
[chain]
count = {count}
material = "ptfe"
diameter = "{diameter:.4g} mm"
sensors = [{{ from_wall = {upper} }}, {{ from_wall = {lower} }}]
[striker]
material = "steel"
diameter = "{diameter:.4g} mm"
mass = "{mass:.4g} mg"
speed = "{speed:.4g} m/s"
[wall]
material = "brass"
[contact]
{law}
[run]
duration = "{duration:.6g} us"
sample_interval = "{step:.6g} us"
{last}
"""


def trains(number: int, folder: Path, last: str = "") -> tuple[Path, float]:
    """A random scene of waves in a train, without dissipation, with the viscoelastic law, and with the power law."""
    draw = np.random.default_rng(number)
    count, diameter, speed = int(draw.integers(5, 8)), draw.uniform(2, 6), 10 ** draw.uniform(-1, 0.3)
    bead_mg = 2200 * np.pi / 6 * diameter**3 / 1e3
    contact_us = 4.0 * diameter * (0.5 / speed) ** 0.2
    damping_N = 8e-3 * bead_mg / contact_us * draw.uniform(0.3, 1)  # a share of the impulse over the time of a contact
    laws = (
        "",
        f"damping_ratio = {draw.uniform(0.01, 0.1):.4g}",
        f'dissipation = "power"\ngamma = {damping_N:.4g}\nalpha = {draw.uniform(1, 2.5):.4g}',
    )
    step_us = contact_us / draw.uniform(15, 40)
    values = {"gravity": draw.choice([0, 9.81]), "count": count, "diameter": diameter, "mass": 4 * bead_mg}
    values |= {
        "law": laws[number % 3],
        "upper": count - 1,
        "lower": count - 4,
        "speed": speed,
        "step": step_us,
        "last": last,
    }
    values["duration"] = int(2.5 * count * contact_us / step_us + 100) * step_us
    path = folder / f"train-{number}.toml"
    path.write_text(SCENE.format(**values))
    return path, step_us


def own_scale(name: str, values: dict[str, float]) -> float:
    """The value that an error is relative to, as the README defines it: of peaks the part above the static load."""
    if "_peak" not in name:
        return abs(values[name])
    gauge = name.partition("_peak")[0]
    return abs(values[name] - (values[f"{gauge}_peak"] - values[f"{gauge}_amplitude"]))


def errors(case: Case, found: dict[str, float], true: dict[str, float]) -> dict[str, float]:
    return {name: abs(found[name] - true[name]) / own_scale(name, true) for name in found.keys() & true.keys()}


@pytest.mark.parametrize("number", range(3))
def test_the_sampling_error_stated_is_the_true_one(number: int, tmp_path: Path) -> None:
    path, step_us = trains(number, tmp_path)
    case = case_of(path, f"run.time_step={step_us:.6g} us")
    motion = exact_motion_of(case)
    stated, right = (
        errors(case, motion.sampled, true)
        for true in (motion.true, quantities(case, exact_of(case, finer=TRUE_FACTOR)))
    )
    seen = {name: error for name, error in right.items() if error > LEAST_ERROR}
    assert len(right) > 12
    assert {name: stated[name] for name in seen} == pytest.approx(seen, rel=0.1)


@pytest.mark.parametrize("number", range(3))
def test_every_planned_accuracy_is_kept_relative_to_its_own_quantity(number: int, tmp_path: Path) -> None:
    path, step_us = trains(number, tmp_path)
    given = case_of(path, f"run.time_step={step_us:.6g} us")
    fine = quantities(given, exact_of(given, finer=TRUE_FACTOR))
    sampled = errors(given, quantities(given, exact_of(given)), fine)
    reachable = sorted(name for name, error in sampled.items() if error < 0.5 * ACCURACY)
    assert len(reachable) > 10
    for name in reachable[:: len(reachable) // 3]:  # of each kind of observable
        case = case_of(path, f'run.accuracy={{"{name}" = {ACCURACY}}}')
        assert errors(case, quantities(case, verlet_of(case)), fine)[name] <= 1.02 * ACCURACY, name
