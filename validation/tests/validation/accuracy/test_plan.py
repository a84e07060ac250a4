"""Accuracies in scenes: planned, refused, recorded and reported."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from drivers.base.errors import InputError
from drivers.chain.schemes import verlet_of
from drivers.engines import engine_names
from drivers.limits.refusal import beyond_rounding, refuse
from drivers.limits.stable_step import linear_limit
from validation.accuracy.budget import budget_of
from validation.accuracy.exact_motion import errors_of, exact_motion_of
from validation.accuracy.plan import auto_engines, capable_engines
from validation.tests.helpers import high_precision
from validation.tests.helpers.commands import beads
from validation.tests.helpers.runs import assessed, finished
from validation.tests.helpers.scenes import SceneWriter, StudyWriter, case_of

FREE = "run.time_step="


def test_the_step_is_the_largest_that_meets_the_accuracy() -> None:
    case = case_of("fig4", FREE, "run.accuracy=1e-4")
    assert case.plan is not None
    assert case.plan.predicted["force"] <= 1e-4
    coarser = case.at(case.scene.steps_per_sample - 1)
    assert errors_of(coarser, verlet_of(coarser), exact_motion_of(coarser), ("force",))["force"] > 1e-4


def test_named_observables_are_kept_against_true_values() -> None:
    case = case_of("fig4", FREE, "run.accuracy={wall_peak = 1e-5, speed_9_to_5_m_s = 1e-6, energy = 1e-4}")
    fine = exact_motion_of(case_of("fig4", "run.sample_interval=0.1 us"))
    found = errors_of(case, verlet_of(case), exact_motion_of(case), ("wall_peak", "speed_9_to_5", "energy"))
    assert found["wall_peak"] <= 1e-5
    assert found["speed_9_to_5"] <= 1e-6
    assert found["energy"] <= 1e-4
    assert exact_motion_of(case).true["wall_peak"] == pytest.approx(fine.true["wall_peak"], rel=1e-9)


@pytest.mark.parametrize("interval", ["20 us", "100 us", "800 us"])
def test_samples_coarser_than_the_stability_limit(interval: str) -> None:
    case = case_of("fig4", FREE, "run.accuracy=1e-4", f"run.sample_interval={interval}")
    assert 1e-7 < case.scene.time_step_s < 5e-7


def test_a_chaotic_motion_is_planned_as_far_as_it_is_known() -> None:
    case = case_of("fig4", FREE, "run.accuracy=1e-3", "run.duration=10 ms")
    found = errors_of(case, verlet_of(case), exact_motion_of(case), ("force",))["force"]
    assert found <= 1e-3
    with pytest.raises(InputError, match=r"at least 0.*limited by the error of the exact motion"):
        case_of("fig4", FREE, "run.accuracy=1e-6", "run.duration=20 ms")


def test_the_exact_motion_measures_its_own_error() -> None:
    """The range stated by the docstring of ``error_N`` holds for a further chain with light and loose beads."""
    gaps = "[{from_wall=3, gap_below='20 um'}, {from_wall=5, gap_below='5 um', mass='2 mg'}]"
    settings = ("gravity=", "chain.sensors=[]", "chain.count=5", f"chain.bead={gaps}", "run.sample_interval=10 us")
    case = case_of("fig4", *settings, "run.duration=0.25 ms")
    exact = np.array(list(high_precision.forces_at(case.chain, case.sample_times_s)))
    for tolerance in (1e-5, 1e-7, 1e-9):
        truth = exact_motion_of(case, tolerance, finer=False)
        errors = np.maximum.accumulate(np.abs(truth.trace.force_N - exact).max(axis=1))
        moving = errors > 1e-14 * exact.max()
        assert moving.sum() > 10
        assert (truth.error_N[moving] > errors[moving] / 12).all()
        assert (truth.error_N[moving] < 30 * errors[moving]).all()


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
    ("accuracy", "message"),
    [
        ("1e-12", "at least 1e-11"),
        ("2", "an error above 0 and below 1"),
        ("nan", "an error above 0 and below 1"),
        ("true", "an error above 0 and below 1"),
        ("{}", "an error above 0 and below 1"),
        ("{wall_peak = true}", "an error above 0 and below 1"),
        ("{bead_3_peak = 1e-3}", "bead_9_peak"),
        ("{wall_peak = 1e-10}", "at least 1e-10|limited by sampling|at least"),
    ],
)
def test_bad_accuracies(accuracy: str, message: str) -> None:
    said = beads("plan", "fig4", "--set", FREE, "--set", f"run.accuracy={accuracy}")
    if accuracy != "{wall_peak = 1e-10}":
        assert said.returncode == 2
        assert message in said.stderr
    assert len(said.stderr.splitlines()) == (said.returncode == 2)


def test_samples_limit_the_accuracy_of_gauges() -> None:
    with pytest.raises(InputError, match="limited by sampling at any time step"):
        case_of("fig4", FREE, "run.accuracy={wall_peak = 1e-5}", "run.sample_interval=10 us")


@pytest.mark.parametrize("engine", engine_names())
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
    force = budget[0]
    assert run.record.accuracy is not None
    assert run.record.accuracy["force"]["measured"] <= 1e-4
    assert abs(force["whole"]) == pytest.approx(run.record.accuracy["force"]["measured"], rel=1e-9, abs=1.1e-12)
    truncated = engine != "reference"
    assert (abs(force["truncation"]) > 1e-5) == truncated


def test_a_wrong_law_shows_as_model_error(shared_runs: Path) -> None:
    case = case_of("fig4")
    run = finished(case, "verlet", shared_runs)
    wrong = type(run.trace)(**(vars(run.trace) | {"force_N": run.trace.force_N * 1.001}))
    rows = budget_of(case, "liggghts", wrong).rows
    assert abs(rows[0]["model"]) == pytest.approx(1e-3, rel=0.1)


def test_a_miss_is_a_failure_of_the_command(shared_runs: Path) -> None:
    case = case_of("fig4", FREE, "run.accuracy=1e-2")
    ended = assessed(case, "verlet", shared_runs)
    accuracy = ended.record.accuracy or {}
    worse = replace(ended.record, accuracy=accuracy | {"force": accuracy["force"] | {"measured": 0.5}})
    assert "force has an error of 0.5" in str(replace(ended, record=worse).missed)
    assert ended.missed is None


def test_the_stability_limit_of_two_bodies(scene_file: SceneWriter) -> None:
    chain = case_of(scene_file(count=1, wall="")).chain
    spring = 5e5
    omega = np.sqrt(spring * (1 / chain.mass_kg[0] + 1 / chain.mass_kg[1]))
    assert linear_limit(chain, np.array([0.0, spring])) == pytest.approx(2 / omega, rel=1e-12)


def test_the_plan_reports_step_errors_and_engine() -> None:
    said = beads("plan", "fig4", "--set", FREE, "--set", "run.accuracy=1e-4")
    assert said.returncode == 0
    for word in (
        "time step",
        "predicted",
        "engine",
        "ten times the error",
        "a tenth of the error",
        "time step  error of force  ",
        "horizon",
        "stability",
    ):
        assert word in said.stdout
    assert re.search(r"at the gauges: .*wall_peak \d", said.stdout)
    peaks = beads("plan", "fig4", "--set", FREE, "--set", "run.accuracy={wall_peak=1e-3, bead_5_peak=1e-3}")
    assert "time step  largest error of wall_peak, bead_5_peak  " in peaks.stdout
    bounced = beads("plan", "fig4", "--set", "run.duration=20 ms")
    assert "beyond, compare energy" in bounced.stdout


def test_the_cheapest_engine_runs(tmp_path: Path) -> None:
    said = beads("run", "fig4", "--engine", "auto", "--runs", tmp_path)
    assert said.returncode == 0
    assert len(said.stdout.splitlines()) == 1


@pytest.mark.long
def test_a_study_over_accuracies(study_file: StudyWriter, tmp_path: Path) -> None:
    axes = '[set]\n"run.time_step" = ""\n[[axis]]\nkey = "run.accuracy"\nvalues = [1e-3, {}]\n'
    words = ("--runs", tmp_path / "runs", "--results", tmp_path)
    done = beads("batch", study_file(axes.format("1e-5"), "verlet"), *words)
    assert done.returncode == 0
    errors = np.genfromtxt(tmp_path / "study.csv", delimiter=",", names=True)["force_error_share"]
    assert errors[0] <= 1e-3
    assert errors[1] <= 1e-5
    refused = beads("batch", study_file(axes.format("1e-11"), "liggghts"), *words, "--dry-run")
    assert refused.returncode == 2
    assert "absolute heights" in refused.stderr
