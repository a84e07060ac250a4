"""The promise of ``run.accuracy`` on random scenes: never missed, with few more steps than needed."""

from pathlib import Path

import numpy as np
import pytest

from drivers.base.tolerances import tolerance
from drivers.chain.case import Case
from drivers.chain.schemes import verlet_of
from drivers.engines import codes
from postproc.read.residual import residual
from validation.accuracy.exact_motion import exact_motion_of
from validation.stability.measured_limits import at_random, measure_limits, random_case, shipped
from validation.tests.helpers.runs import finished

ACCURACIES = (1e-2, 1e-3, 1e-4, 1e-5, 1e-6)
MAX_STEP_RATIO = 1.5  # planned steps over the fewest that meet the accuracy
QUICK, ALL, BY_CODES = range(8), range(8, 200), range(30)


def check_steps(number: int) -> None:
    """The planned step meets each accuracy, and no step more than 1.5 times as large does."""
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
                    errors[key] = float(residual(verlet_of(case.at(steps)), truth.trace).max())
            return errors[key]

        assert error_at(steps) <= accuracy, f"missed {accuracy}"
        assert case.plan is not None
        assert case.plan.predicted["force"] == pytest.approx(error_at(steps), rel=2e-2)
        fewer = {
            each
            for each in np.unique(np.geomspace(1, max(steps / MAX_STEP_RATIO, 1), 40).astype(int))
            if each * MAX_STEP_RATIO < steps
        }
        assert all(not error_at(each) <= accuracy for each in fewer), f"{steps} steps a sample at {accuracy}"


@pytest.mark.parametrize("number", QUICK)
def test_no_miss_and_few_more_steps_than_needed(number: int) -> None:
    check_steps(number)


@pytest.mark.accuracy
@pytest.mark.parametrize("number", ALL)
def test_no_miss_on_many_scenes(number: int) -> None:
    check_steps(number)


def check_codes(number: int, runs: Path) -> None:
    """The codes keep the accuracy, and their records show it."""
    accuracy = ACCURACIES[number % 3]
    case = random_case(number, accuracy=accuracy)
    truth = exact_motion_of(case.full or case, finer=False)
    for engine in codes():
        run = finished(case, engine, runs)
        own = float(residual(run.trace, truth.trace).max())
        assert own <= accuracy
        assert run.record.accuracy is not None
        assert run.record.accuracy["force"]["measured"] == pytest.approx(own, rel=1e-6)


def test_a_code_keeps_it(shared_runs: Path) -> None:
    check_codes(0, shared_runs)


@pytest.mark.accuracy
@pytest.mark.parametrize("number", BY_CODES)
def test_all_codes_keep_it(number: int, shared_runs: Path) -> None:
    check_codes(number, shared_runs)


@pytest.mark.accuracy
def test_limits_are_predicted_on_the_papers_scenes_and_100_random_ones() -> None:
    limits = measure_limits([*shipped(), *at_random(100)])
    assert {limit.method for limit in limits} >= {"verlet"}
    outside = [limit for limit in limits if not 1 <= limit.ratio <= tolerance("stability", "measured").limit]
    assert outside == []
