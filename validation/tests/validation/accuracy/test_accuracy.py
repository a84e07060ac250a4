"""The promise of ``run.accuracy`` on random scenes: never missed, with few more steps than needed."""

import numpy as np
import pytest

from drivers.base.tolerances import tolerance
from drivers.chain.case import Case
from drivers.chain.schemes import verlet_of
from drivers.engines import codes
from drivers.run.compute import compute
from postproc.read.residual import residual
from validation.accuracy.exact_motion import exact_motion_of
from validation.stability.measured_limits import at_random, measure_limits, random_case, shipped
from validation.tests.helpers.runs import need

ACCURACIES = (1e-2, 1e-4, 1e-6)
MAX_STEP_RATIO = 1.5  # planned steps over the fewest that meet the accuracy


def numbers(quick: int, count: int) -> list[object]:
    """Numbers of random scenes: the first in the quick tests, the rest in the accuracy tests."""
    return [pytest.param(number, marks=pytest.mark.accuracy if number >= quick else ()) for number in range(count)]


@pytest.mark.parametrize("number", numbers(4, 100))
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
                    errors[key] = float(residual(verlet_of(case.at(steps)), truth.trace).max())
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


@pytest.mark.parametrize("number", numbers(1, 20))
def test_the_codes_keep_the_accuracy(number: int) -> None:
    accuracy = ACCURACIES[number % 2]
    case = random_case(number, accuracy=accuracy)
    truth = exact_motion_of(case.full or case, finer=False)
    for engine in codes():
        need(engine)
        assert residual(compute(case, engine).done, truth.trace).max() <= accuracy, engine


@pytest.mark.accuracy
def test_limits_are_predicted_on_the_papers_scenes_and_at_random() -> None:
    limits = measure_limits([*shipped(), *at_random(40)])
    assert {limit.method for limit in limits} >= {"verlet"}
    outside = [limit for limit in limits if not 1 <= limit.ratio <= tolerance("stability", "measured").limit]
    assert outside == []
