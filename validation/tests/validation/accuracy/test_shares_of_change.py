"""Errors are relative to the largest change: a static load hides none in a weak wave."""

from pathlib import Path

import numpy as np
import pytest

from drivers.chain.case import Case
from drivers.chain.schemes import verlet_of
from postproc.read.observables import observe
from validation.accuracy.assess import assess
from validation.accuracy.budget import AT_REST_NOTE, budget_of, kept_budget
from validation.accuracy.motions import HORIZON, motions_of
from validation.checks import FAIL
from validation.tests.helpers.runs import finished
from validation.tests.helpers.scenes import case_of


def weak_wave(*settings: str) -> Case:
    """A wave of 2.6e-4 of the load of its chain."""
    return case_of("small-signal", "chain.sensors=[{from_wall=30}]", "run.duration=5 ms", *settings)


def test_a_wrong_wave_on_a_static_load_is_red_and_warned_of() -> None:
    case = weak_wave("run.time_step=40 us", "run.sample_interval=40 us")
    coarse, exact = verlet_of(case), motions_of(case).exact
    wave_N = np.abs(exact.force_N - case.chain.force_N).max()
    off_N = np.abs(coarse.force_N - exact.force_N).max()
    assert off_N > 0.1 * wave_N
    assert off_N < 1e-3 * exact.force_N.max()
    budget = budget_of(case, "verlet", coarse)
    red = {check.quantity: check for check in budget.checks if check.verdict == FAIL}
    assert red["error: force"].value == pytest.approx(off_N / wave_N, rel=1e-9)
    assert "of the largest force" in red["error: force"].where
    assert any("of the largest change" in line for line in budget.warnings)
    seen, right = (observe(case.layout, trace) for trace in (coarse, exact))
    parts = {row["quantity"]: row for row in budget.rows}
    for gauge in ("bead_30", "wall"):
        share = seen[f"{gauge}_amplitude_N"] / right[f"{gauge}_amplitude_N"] - 1
        assert parts[f"{gauge}_peak"]["truncation"] == pytest.approx(share, rel=1e-2)


def test_a_plan_keeps_its_accuracy_of_the_wave() -> None:
    case = weak_wave("run.time_step=", "run.accuracy=1e-3")
    exact = motions_of(case).exact.force_N
    error = np.abs(verlet_of(case).force_N - exact).max() / np.abs(exact - exact[0]).max()
    assert 2e-4 < error <= 1e-3


@pytest.mark.parametrize(("step", "warned"), [("2 us", False), ("6 us", True)])
def test_a_growing_energy_under_a_static_load_is_warned_of(step: str, warned: bool) -> None:
    light = ("striker.diameter=0.6 mm", "striker.mass=0.3 mg", "striker.speed=0.01 m/s", "chain.sensors=[]")
    case = case_of("fig4", *light, f"run.time_step={step}", f"run.sample_interval={step}", "run.duration=0.3 ms")
    warnings = budget_of(case, "verlet", verlet_of(case)).warnings
    assert any(line.startswith("error of the energy up to 0.12 ") for line in warnings) == warned


def test_a_scene_at_rest_has_a_note() -> None:
    still = weak_wave("chain.bead=[]")
    budget = budget_of(still, "verlet", verlet_of(still))
    assert AT_REST_NOTE in budget.note
    assert abs(budget.rows[0]["whole"]) < 1e-9


def test_the_reference_reports_until_when_it_is_exact(shared_runs: Path) -> None:
    known = assess(finished(case_of("fig4"), "reference", shared_runs), case_of("fig4")).record
    assert known.exact_to is not None
    assert known.exact_to < 1e-11
    assert known.exact_until_s == case_of("fig4").sample_times_s[-1]
    chaotic = case_of("fig4", "run.duration=20 ms", "run.sample_interval=5 us", "run.time_step=1 us")
    record = assess(finished(chaotic, "reference", shared_runs), chaotic).record
    assert record.exact_until_s is not None
    assert record.exact_to is not None
    assert 5e-3 < record.exact_until_s < 20e-3
    assert record.exact_to <= HORIZON
    assert any("later errors are not measured" in line for line in record.warnings or ())
    checks = kept_budget(chaotic, finished(chaotic, "verlet", shared_runs)).checks
    (error,) = [check for check in checks if check.quantity == "error: force"]
    assert "where the error of the exact motion exceeds 1e-06" in error.where
