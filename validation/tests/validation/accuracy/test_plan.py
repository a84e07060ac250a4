"""Accuracies in scenes: planned, refused, recorded and reported."""

import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from drivers.base.errors import InputError
from drivers.chain.schemes import verlet_of
from drivers.limits.refusal import beyond_rounding, refuse, unattainable
from postproc.read.residual import residual
from validation.accuracy.budget import budget_of
from validation.accuracy.exact_motion import errors_of, exact_motion_of
from validation.accuracy.plan import auto_engines, capable_engines
from validation.accuracy.plan_report import plan_report
from validation.tests.helpers.commands import beads
from validation.tests.helpers.runs import finished
from validation.tests.helpers.scenes import SceneWriter, case_of

FREE = "run.time_step="


def test_the_step_is_the_largest_that_meets_the_accuracy() -> None:
    case = case_of("fig4", FREE, "run.accuracy=1e-4")
    assert case.plan is not None
    assert case.plan.predicted["force"] <= 1e-4
    coarser = case.at(case.scene.steps_per_sample - 1)
    assert errors_of(coarser, verlet_of(coarser), exact_motion_of(coarser), ("force",))["force"] > 1e-4
    rare = case_of("fig4", FREE, "run.accuracy=1e-4", "run.sample_interval=100 us")  # beyond the stability limit
    assert 1e-7 < rare.scene.time_step_s < 5e-7


def test_named_observables_are_kept_against_true_values() -> None:
    case = case_of("fig4", FREE, "run.accuracy={wall_peak = 1e-5, speed_9_to_5_m_s = 1e-6, energy = 1e-4}")
    fine = exact_motion_of(case_of("fig4", "run.sample_interval=0.1 us"))
    found = errors_of(case, verlet_of(case), exact_motion_of(case), ("wall_peak", "speed_9_to_5", "energy"))
    assert found["wall_peak"] <= 1e-5
    assert found["speed_9_to_5"] <= 1e-6
    assert found["energy"] <= 1e-4
    assert exact_motion_of(case).true["wall_peak"] == pytest.approx(fine.true["wall_peak"], rel=1e-9)


def test_engines_without_the_law_of_a_scene_are_not_chosen() -> None:
    power = case_of("fig4", "contact.dissipation=power", "contact.gamma=1")
    assert capable_engines(power) == ["reference", "verlet", "yade"]


def test_heights_far_away_are_refused_to_codes_with_a_limit_that_holds() -> None:
    settings = (FREE, "chain.origin=1 km")
    case = case_of("fig4", *settings, "run.accuracy=1e-8")
    with pytest.raises(InputError, match=r"run.accuracy: found 1e-08; allowed: at least .* on yade") as refusal:
        refuse(case, "yade")
    assert beyond_rounding(case, "verlet") is None
    assert next(auto_engines(case)) in ("verlet", "reference")
    limit = str(refusal.value).partition("at least ")[2].split()[0]
    assert beyond_rounding(case_of("fig4", *settings, f"run.accuracy={limit}"), "yade") is None


@pytest.mark.parametrize(
    ("accuracy", "message", "settings"),
    [
        ("1e-12", "at least 1e-11", ()),
        *((wrong, "an error above 0 and below 1", ()) for wrong in ("2", "nan", "true", "{}", "{wall_peak = true}")),
        ("{bead_3_peak = 1e-3}", "bead_9_peak", ()),
        ("{wall_peak = 1e-5}", "limited by sampling at any time step", ("run.sample_interval=10 us",)),
        ("1e-6", r"at least 0.*limited by the error of the exact motion", ("run.duration=20 ms",)),
    ],
)
def test_bad_accuracies(accuracy: str, message: str, settings: tuple[str, ...]) -> None:
    with pytest.raises(InputError, match=message) as refusal:
        case_of("fig4", FREE, f"run.accuracy={accuracy}", *settings)
    assert "\n" not in str(refusal.value)


@pytest.mark.parametrize("engine", ["liggghts", "reference", "verlet"])
def test_budgets_add_up(engine: str, shared_runs: Path) -> None:
    case = case_of("fig4", FREE, "run.accuracy={force = 1e-4, wall_peak = 1e-3}")
    run = finished(case, engine, shared_runs)
    budget = run.record.error_budget
    assert budget is not None
    assert {"force", "bead_9_peak", "bead_5_arrival", "wall_peak", "speed_9_to_5"} <= {p["quantity"] for p in budget}
    for part in budget:
        parts = sum(part[name] for name in ("model", "rounding", "truncation", "sampling"))
        assert parts == pytest.approx(part["whole"], abs=1e-14)
        assert abs(part["model"]) < 1e-11
    force, accuracy = budget[0], run.record.accuracy
    assert accuracy is not None
    error = float(residual(run.trace, exact_motion_of(case).trace).max())
    assert error <= 1e-4
    assert accuracy["force"]["measured"] == pytest.approx(error, rel=1e-6, abs=1e-11)
    assert abs(force["whole"]) == pytest.approx(error, rel=1e-6, abs=1e-11)
    assert (abs(force["truncation"]) > 1e-5) == (engine != "reference")


def test_a_wrong_law_shows_as_model_error(shared_runs: Path) -> None:
    case = case_of("fig4")
    run = finished(case, "verlet", shared_runs)
    wrong = type(run.trace)(**(vars(run.trace) | {"force_N": run.trace.force_N * 1.001}))
    rows = budget_of(case, "liggghts", wrong).rows
    assert abs(rows[0]["model"]) == pytest.approx(1e-3, rel=0.1)


def test_the_plan_reports_step_errors_and_engine() -> None:
    said = beads("plan", "fig4", "--set", FREE, "--set", "run.accuracy={wall_peak=1e-3, bead_5_peak=1e-3}")
    assert said.returncode == 0
    for words in ("time step", "predicted", "engine", "ten times the error", "a tenth of the error", "stability"):
        assert f"\n{words} " in said.stdout or f" {words} " in said.stdout, words
    assert "time step  largest error of wall_peak, bead_5_peak  " in said.stdout
    assert re.search(r"at the gauges: .*wall_peak \d", said.stdout)
    bounced = beads("plan", "fig4", "--set", "run.duration=20 ms")
    assert re.search(r"^horizon .*beyond, compare energy", bounced.stdout, re.MULTILINE | re.DOTALL)


STEP, ACCURACY = ("run.time_step=1 ns", "run.duration=50 us"), ("run.time_step=", "run.accuracy=1e-2")


@pytest.mark.parametrize("least", [1e-11, 0.0123, 0.9, 0.989, 0.9901, 0.99999, 1.0, np.inf, np.nan])
def test_a_refusal_names_an_attainable_accuracy_that_is_allowed_or_none(least: float) -> None:
    said = str(unattainable(case_of("fig4"), "force", 1e-12, least, "here is why"))
    named = re.search(r"allowed: at least (\S+) here, here is why", said)
    if named is None:
        assert not least <= 0.99
        assert "allowed: none here, here is why" in said
    else:
        assert least <= float(named[1]) <= min(1.1 * least, 0.99)


def run_refuses(path: Path, settings: tuple[str, ...]) -> None:
    refuse(case_of(path, *settings), "reference")


def plan_of(path: Path, settings: tuple[str, ...]) -> list[str]:
    return [*plan_report(path, settings)]


def refusal_by(command: Callable[[Path, tuple[str, ...]], object], path: Path, settings: tuple[str, ...]) -> str:
    """Message of a refusal; empty if there is none."""
    try:
        command(path, settings)
    except InputError as error:
        return str(error)
    return ""


@pytest.mark.parametrize("timing", [STEP, ACCURACY])
def test_a_motion_refused_to_a_run_is_refused_to_its_plan(timing: tuple[str, ...], scene_file: SceneWriter) -> None:
    """From striker speeds at which the beads are pressed a tenth of a radius deep to three radii."""
    path, refused = scene_file(), []
    for speed in np.geomspace(3, 1500, 4):
        settings = (f"striker.speed={speed:.4g} m/s", *timing)
        said = refusal_by(run_refuses, path, settings)
        assert refusal_by(plan_of, path, settings) == said
        refused.append("radii deep" in said)
    assert refused == sorted(refused)
    assert not refused[0]
    assert refused[-1]
