"""The promise of ``run.accuracy``: never missed, with few more steps than needed, or refused; plans and records."""

import re
from pathlib import Path

import numpy as np
import pytest

from drivers.base.errors import InputError
from drivers.chain.case import Case
from drivers.chain.schemes import verlet_in_heights
from drivers.chain.trace import residual
from drivers.limits import refuse
from validation.accuracy.motions import exact_motion_of
from validation.accuracy.plan import plan_report, unattainable
from validation.tests.helpers.commands import beads
from validation.tests.helpers.random_chains import random_case
from validation.tests.helpers.runs import finished
from validation.tests.helpers.scenes import SceneWriter, case_of

ACCURACIES = (1e-2, 1e-4, 1e-6)
MAX_STEP_RATIO = 1.5  # planned steps over the fewest that meet the accuracy
FREE = "run.time_step="


@pytest.mark.parametrize(
    "number", [pytest.param(number, marks=pytest.mark.accuracy if number >= 4 else ()) for number in range(100)]
)
def test_the_planned_step_meets_the_accuracy_and_is_nearly_the_largest(number: int) -> None:
    whole = random_case(number, accuracy=1e-2)
    truth = exact_motion_of(whole.full or whole, finer=False)
    errors: dict[tuple[str, int], float] = {}
    for accuracy in ACCURACIES:
        case = random_case(number, accuracy=accuracy)
        steps = case.scene.steps_per_sample

        def error_at(steps: int, case: Case = case) -> float:
            """Error of the simplified case against the exact motion of the full one."""
            key = (str(case.elements), steps)
            if key not in errors:
                with np.errstate(over="ignore", invalid="ignore"):
                    errors[key] = float(residual(verlet_in_heights(case.at(steps)), truth.trace).max())
            return errors[key]

        assert error_at(steps) <= accuracy, f"missed {accuracy}"
        assert case.plan is not None
        assert case.plan.predicted["force"] == pytest.approx(error_at(steps), rel=2e-2)
        fewer = {
            each
            for each in np.unique(np.geomspace(1, max(steps / MAX_STEP_RATIO, 1), 12).astype(int))
            if each * MAX_STEP_RATIO < steps
        }
        assert all(not error_at(each) <= accuracy for each in fewer), f"{steps} steps a sample at {accuracy}"


def test_the_step_of_rare_samples_is_below_the_sample_interval() -> None:
    rare = case_of("fig4", FREE, "run.accuracy=1e-4", "run.sample_interval=100 us")  # beyond the stability limit
    assert 1e-7 < rare.scene.time_step_s < 5e-7


def test_an_accuracy_below_the_rounding_of_heights_is_refused_with_a_limit_that_holds() -> None:
    settings = (FREE, "chain.origin=1 km")
    with pytest.raises(InputError, match=r"accuracy: found 1e-08; allowed: at least .* chain.origin near 0") as refusal:
        case_of("fig4", *settings, "run.accuracy=1e-8")
    limit = str(refusal.value).partition("at least ")[2].split()[0]
    case = case_of("fig4", *settings, f"run.accuracy={limit}")
    assert case.plan is not None
    assert case.plan.predicted["force"] <= float(limit)
    assert case_of("fig4", FREE, "run.accuracy=1e-8").plan is not None


@pytest.mark.parametrize(
    ("accuracy", "message", "settings"),
    [
        ("1e-12", "at least 1e-11", ()),
        *((wrong, "an error above 0 and below 1", ()) for wrong in ("2", "nan", "true", "{}", "{wall_peak = true}")),
        ("{bead_3_peak = 1e-3}", "bead_9_amplitude", ()),
        ("{wall_peak = 1e-5}", "limited by sampling at any time step", ("run.sample_interval=10 us",)),
        ("1e-6", r"at least 0.*limited by the error of the exact motion", ("run.duration=20 ms",)),
    ],
)
def test_bad_accuracies(accuracy: str, message: str, settings: tuple[str, ...]) -> None:
    with pytest.raises(InputError, match=message) as refusal:
        case_of("fig4", FREE, f"run.accuracy={accuracy}", *settings)
    assert "\n" not in str(refusal.value)


@pytest.mark.parametrize("least", [1e-11, 0.0123, 0.9, 0.99, 1.0, np.nan])
def test_a_refusal_names_an_attainable_accuracy_that_is_allowed_or_none(least: float) -> None:
    said = str(unattainable(case_of("fig4"), "force", 1e-12, least, "here is why"))
    named = re.search(r"allowed: at least (\S+) here, here is why", said)
    if named is None:
        assert not least <= 0.94
        assert "allowed: none here, here is why" in said
    else:
        assert least <= float(named[1]) <= min(1.1 * least, 0.99)


@pytest.mark.parametrize("engine", ["liggghts", "reference"])
def test_the_record_of_a_run_has_its_accuracy_and_its_budget(engine: str, shared_runs: Path) -> None:
    case = case_of("fig4", FREE, "run.accuracy={force = 1e-4, wall_peak = 1e-3}")
    run = finished(case, engine, shared_runs)
    budget, accuracy = run.record.error_budget, run.record.accuracy
    assert budget is not None
    assert accuracy is not None
    assert {"force", "bead_9_peak", "bead_5_arrival", "wall_peak", "speed_9_to_5"} <= {p["quantity"] for p in budget}
    assert all(abs(part["model"]) < 1e-11 for part in budget)
    error = float(residual(run.trace, exact_motion_of(case).trace).max())
    assert error <= 1e-4
    assert accuracy["force"]["measured"] == pytest.approx(error, rel=1e-6, abs=1e-11)
    assert abs(budget[0]["whole"]) == pytest.approx(error, rel=1e-6, abs=1e-11)
    assert (abs(budget[0]["truncation"]) > 1e-5) == (engine != "reference")


def test_a_line_of_the_plan_has_the_largest_of_many_errors() -> None:
    lines = [*plan_report("fig4", ("chain.sensors=[{from_wall='2-19'}]",))]
    (gauges,) = (line for line in lines if "at the gauges" in line)
    assert "at the gauges: 36 quantities, the largest errors: wall_peak " in gauges
    assert max(map(len, lines)) < 200


def test_the_plan_reports_step_errors_and_engine() -> None:
    said = beads("plan", "fig4", "--set", FREE, "--set", "run.accuracy={wall_peak=1e-3, bead_5_peak=1e-3}")
    assert said.returncode == 0
    for words in ("time step", "predicted", "engines", "ten times the error", "a tenth of the error", "stability"):
        assert f"\n{words} " in said.stdout or f" {words} " in said.stdout, words
    assert "time step  largest error of wall_peak, bead_5_peak  " in said.stdout
    assert re.search(r"at the gauges: .*wall_peak \d", said.stdout)
    bounced = beads("plan", "fig4", "--set", "run.duration=20 ms")
    assert re.search(r"^horizon .*judged until .* where rounding alone explains", bounced.stdout, re.MULTILINE)


@pytest.mark.parametrize("timing", [("run.time_step=1 ns", "run.duration=50 us"), (FREE, "run.accuracy=1e-2")])
@pytest.mark.parametrize(("speed", "refused"), [("3 m/s", False), ("1.5 km/s", True)])
def test_a_motion_beyond_hertz_is_refused_to_a_run_and_to_its_plan(
    speed: str, refused: bool, timing: tuple[str, ...], scene_file: SceneWriter
) -> None:
    path, settings, messages = scene_file(), (f"striker.speed={speed}", *timing), []
    for command in (lambda: refuse(case_of(path, *settings), "reference"), lambda: [*plan_report(path, settings)]):
        try:
            command()
        except InputError as error:
            messages.append(str(error))
    assert bool(messages) == refused
    if refused:
        assert messages[0] == messages[1]
        assert "striker.speed: found a motion that presses contact 6 " in messages[0]
        assert "radii deep" in messages[0]
