"""Errors are relative to the largest change: a static load hides none, on random scenes of weak waves."""

from pathlib import Path

import numpy as np
import pytest

from drivers.chain.case import Case, build_case
from drivers.chain.schemes import verlet_of
from drivers.scene.read_scene import read_scene
from postproc.read.observables import observe
from validation.accuracy.assess import assess
from validation.accuracy.budget import AT_REST_NOTE, budget_of, kept_budget
from validation.accuracy.motions import HORIZON, Motions, motions_of
from validation.accuracy.plan import planned_case
from validation.checks import FAIL
from validation.tests.helpers.runs import finished
from validation.tests.helpers.scenes import case_of

PRESSED_CHAIN = """title = "a weak wave in a pressed chain"
[chain]
count = {count}
material = "steel"
diameter = "10 mm"
precompression = "{load:.4g} N"
sensors = [{{ from_wall = 3 }}]
[striker]
material = "steel"
diameter = "10 mm"
speed = "{speed:.4g} m/s"
[wall]
material = "steel"
[run]
duration = "{duration:.6g} us"
sample_interval = "{step:.6g} us"
{last}
"""
LIGHT = """title = "a light striker on a chain under its own weight"
gravity = "9.81 m/s^2"
[chain]
count = {count}
material = "ptfe"
diameter = "{diameter:.4g} mm"
[striker]
material = "alumina"
speed = "{speed:.4g} m/s"
diameter = "{light:.4g} mm"
[wall]
material = "rigid"
[run]
duration = "300 us"
sample_interval = "0.5 us"
time_step = "0.5 us"
"""


def pressed(number: int, share: float, folder: Path, accuracy: float | None = None) -> Case:
    """A random steel chain whose wave is far weaker than its load, at a share of its stable step, or planned."""
    draw = np.random.default_rng(number)
    step_us = share * 10.7 * draw.uniform(0.85, 1.0)
    count = int(draw.integers(40, 60))
    settings = {"count": count, "load": 200 * draw.uniform(0.8, 1.0), "step": step_us}
    settings |= {"speed": 10 ** draw.uniform(-3.5, -2.5), "duration": int(18 * count / step_us) * step_us}
    last = f"accuracy = {accuracy:g}" if accuracy else f'time_step = "{step_us:.6g} us"'
    path = folder / f"pressed-{number}.toml"
    path.write_text(PRESSED_CHAIN.format(**settings, last=last))
    return planned_case(path)


@pytest.mark.parametrize("number", range(2))
def test_a_wrong_wave_on_a_static_load_is_red_and_warned_of(number: int, tmp_path: Path) -> None:
    case = pressed(number, 0.9, tmp_path)
    coarse, exact = verlet_of(case), motions_of(case).exact
    wave_N = exact.force_N - case.chain.force_N
    off_N = np.abs(coarse.force_N - exact.force_N).max()
    assert off_N > 0.02 * np.abs(wave_N).max()  # wrong by much of the wave
    assert off_N < 0.01 * exact.force_N.max()  # and by little of the force
    budget = budget_of(case, "verlet", coarse)
    red = {check.quantity: check for check in budget.checks if check.verdict == FAIL}
    assert red["error: force"].value == pytest.approx(off_N / np.abs(wave_N).max(), rel=1e-9)
    assert "of the largest force" in red["error: force"].where
    if off_N > 0.1 * np.abs(wave_N).max():
        assert any("of the largest change" in line for line in budget.warnings)


def test_a_plan_keeps_its_accuracy_of_the_wave(tmp_path: Path) -> None:
    case = pressed(0, 0.9, tmp_path, accuracy=1e-3)
    exact = Motions(case, "total").exact.force_N
    off_N = np.abs(verlet_of(case).force_N - exact).max()
    assert 2e-4 < off_N / np.abs(exact - exact[0]).max() <= 1e-3
    assert case.scene.steps_per_sample > 1


def test_a_peak_errs_by_its_own_wave(tmp_path: Path) -> None:
    case = pressed(1, 0.9, tmp_path)
    parts = budget_of(case, "verlet", verlet_of(case)).rows
    found, exact = (observe(case.layout, each) for each in (verlet_of(case), motions_of(case).exact))
    budget = {part["quantity"]: part for part in parts}
    for gauge in ("bead_3", "wall"):
        off = (found[f"{gauge}_amplitude_N"] - exact[f"{gauge}_amplitude_N"]) / exact[f"{gauge}_amplitude_N"]
        assert budget[f"{gauge}_peak"]["truncation"] == pytest.approx(off, rel=1e-2)


@pytest.mark.parametrize("number", range(3))
def test_a_growing_energy_under_a_static_load_is_warned_of(number: int, tmp_path: Path) -> None:
    draw = np.random.default_rng(number)
    settings = {"diameter": draw.uniform(4, 8), "light": draw.uniform(0.4, 0.8), "speed": 10 ** draw.uniform(-3, -2)}
    path = tmp_path / "light.toml"
    path.write_text(LIGHT.format(count=int(draw.integers(3, 9)), **settings))
    fine = build_case(read_scene(path))
    contact_us = 1e6 * 2.87 * (0.75**2 * fine.chain.mass_kg[-1] ** 2 / fine.chain.stiffness[-1] ** 2) ** 0.2
    contact_us *= draw.uniform(0.9, 1.1) * settings["speed"] ** -0.2
    step = f"{0.3 * contact_us:.4g} us"
    coarse = build_case(read_scene(path, (f"run.sample_interval={step}", f"run.time_step={step}")))
    trace = verlet_of(coarse)
    kinetic = motions_of(coarse).exact_to_end.trace.kinetic_energy_J.max()
    drift = np.abs(trace.total_energy_J - trace.total_energy_J[0]).max() / kinetic
    said = [line for line in budget_of(coarse, "verlet", trace).warnings if line.startswith("error of the energy")]
    assert bool(said) == (drift > 0.1)
    assert not any("energy" in line for line in budget_of(fine.at(50), "verlet", verlet_of(fine.at(50))).warnings)


def test_a_scene_at_rest_has_a_note(tmp_path: Path) -> None:
    case = pressed(0, 0.5, tmp_path)
    scene = case.scene.model_copy(update={"striker": None})
    still = build_case(scene)
    budget = budget_of(still, "verlet", verlet_of(still))
    assert AT_REST_NOTE in budget.note
    assert abs(budget.rows[0]["whole"]) < 1e-9


def test_the_reference_reports_until_when_it_is_exact(shared_runs: Path) -> None:
    known = assess(finished(case_of("fig4"), "reference", shared_runs), case_of("fig4")).record
    assert known.exact_to is not None
    assert known.exact_to < 1e-11
    assert known.exact_until_s == case_of("fig4").sample_times_s[-1]
    chaotic = case_of("fig4", "run.duration=20 ms", "run.sample_interval=5 us", "run.time_step=1 us")
    run = finished(chaotic, "reference", shared_runs)
    record = assess(run, chaotic).record
    assert record.exact_until_s is not None
    assert record.exact_to is not None
    assert 5e-3 < record.exact_until_s < 20e-3
    assert record.exact_to <= HORIZON
    assert any("later errors are not measured" in line for line in record.warnings or ())
    other = finished(chaotic, "verlet", shared_runs)
    (error,) = [check for check in kept_budget(chaotic, other).checks if check.quantity == "error: force"]
    assert "where the error of the exact motion exceeds 1e-06" in error.where
