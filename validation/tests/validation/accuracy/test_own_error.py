"""The error that the exact motion states of itself is not below its true error, measured in 40 digits."""

import numpy as np
import pytest

from drivers.chain.case import Case
from postproc.read.residual import largest_change_N
from validation.accuracy.exact_motion import exact_motion_of
from validation.tests.helpers import high_precision
from validation.tests.helpers.adversarial import adversarial_case
from validation.tests.helpers.scenes import case_of

SAMPLES = 12
GAPS = "chain.bead=[{from_wall=3, gap_below='20 um'}, {from_wall=5, gap_below='5 um', mass='2 mg'}]"
LOOSE = ("gravity=", "chain.sensors=[]", "chain.count=5", GAPS, "run.sample_interval=10 us", "run.duration=0.25 ms")


def pressed_case(number: int) -> Case:
    """A random chain of steel balls under 1 mN to 30 N, struck at 1e-8 m/s to 0.1 m/s."""
    draw = np.random.default_rng(number)
    count, load_N, speed_m_s = int(draw.integers(1, 6)), 10 ** draw.uniform(-3, 1.5), 10 ** draw.uniform(-8, -1)
    contact_s = 3e-5 * load_N ** (-1 / 6)
    chain = ("chain.sensors=[]", f"chain.count={count}", f"chain.precompression={load_N} N")
    timing = (f"run.sample_interval={contact_s} s", f"run.time_step={contact_s} s", f"run.duration={30 * contact_s} s")
    return case_of("steel-chain", *chain, f"striker.speed={speed_m_s} m/s", *timing)


def true_and_stated(case: Case) -> tuple[float, float]:
    """True and stated force error of the exact motion over the largest change of force, over some samples."""
    chosen = np.arange(0, case.scene.samples, max(1, case.scene.samples // SAMPLES))
    motion = exact_motion_of(case, finer=False)
    right = np.array(list(high_precision.forces_at(case.chain, case.sample_times_s[chosen])))
    change_N = largest_change_N(motion.trace.force_N)
    true = float(np.abs(motion.trace.force_N[chosen] - right).max()) / change_N
    return true, float(motion.error_N[chosen[-1]]) / change_N


@pytest.mark.parametrize(
    ("kind", "number", "damped"),
    [("light bead", 6, False), ("light striker", 2, True), ("bounces", 5, True), ("gaps", 10, False)],
)
def test_the_stated_error_is_no_less_than_the_true_one(kind: str, number: int, damped: bool) -> None:
    true, stated = true_and_stated(adversarial_case(kind, number, damped=damped))
    assert 0.99e-13 < stated < 1e-8
    assert true <= stated


@pytest.mark.parametrize("number", range(2))
def test_a_static_load_makes_the_stated_error_no_smaller(number: int) -> None:
    true, stated = true_and_stated(pressed_case(number))
    assert true <= stated <= 30 * max(true, 1e-13)


def test_errors_at_looser_tolerances_are_in_the_range_of_the_docstring() -> None:
    """The range stated by the docstring of ``error_N`` holds for a further chain with light and loose beads."""
    case = case_of("fig4", *LOOSE)
    exact = np.array(list(high_precision.forces_at(case.chain, case.sample_times_s)))
    for tolerance in (1e-5, 1e-9):
        truth = exact_motion_of(case, tolerance, finer=False)
        errors = np.maximum.accumulate(np.abs(truth.trace.force_N - exact).max(axis=1))
        moving = errors > 1e-14 * exact.max()
        assert moving.sum() > 10
        assert (truth.error_N[moving] > errors[moving] / 12).all()
        assert (truth.error_N[moving] < 30 * errors[moving]).all()
