"""Baselines of straight and three-dimensional chains."""

import numpy as np
import pytest

from postproc.read.residual import residual
from validation.accuracy.baseline import HORIZON, ROUNDING_MARGIN, Baseline, baseline_of
from validation.tests.helpers.scenes import case_of

DURATION = "run.duration=50 us"


def test_engines_of_a_case_share_what_is_computed() -> None:
    first = baseline_of(case_of("fig4", DURATION), "liggghts")
    assert baseline_of(case_of("fig4", DURATION), "yade") is first
    assert baseline_of(first.case) is first
    other = baseline_of(case_of("fig4", DURATION, "striker.speed=1 m/s"))
    assert other is not first


def test_engines_share_in_a_tube_what_their_law_of_friction_shares() -> None:
    case = case_of("fig4-tube", DURATION)
    liggghts, yade, verlet = (baseline_of(case, engine) for engine in ("liggghts", "yade", "verlet"))
    assert liggghts is verlet
    assert yade is not verlet
    assert baseline_of(case, "yade") is yade


@pytest.mark.parametrize("scene", ["fig4", "fig5-tube"])
def test_another_rounding_is_only_rounding_and_another_step_is_not(scene: str) -> None:
    case = case_of(scene, DURATION, "run.time_step=0.5 us")
    baseline = Baseline(case, "total")
    samples = baseline.samples
    assert 1 < samples <= case.scene.samples
    apart = residual(baseline.rounded, baseline.plain)[:samples]
    assert (apart <= baseline.allowed.limit).all()
    assert baseline.rounding_bound[:samples].max() <= ROUNDING_MARGIN * HORIZON
    coarse = Baseline(case.at(1), "total")
    assert np.abs(coarse.plain.force_N - baseline.plain.force_N).max() > baseline.allowed.limit * baseline.scale_N


@pytest.mark.parametrize("scene", ["fig4", "fig5-tube"])
def test_the_scheme_converges_to_the_exact_motion_by_its_order(scene: str) -> None:
    whole, half = (Baseline(case_of(scene, DURATION).at(steps), "total") for steps in (10, 20))
    errors = [float(residual(each.in_overlaps, whole.exact).max()) for each in (whole, half)]
    assert whole.order == pytest.approx(2, abs=0.3)
    assert errors[0] / errors[1] == pytest.approx(2**whole.order, rel=0.1)
