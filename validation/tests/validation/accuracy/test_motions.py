"""Motions of straight and three-dimensional chains, and the differences that rounding explains."""

import pytest

from drivers.base.tolerances import tolerance
from drivers.limits.refusal import FORCE
from postproc.read.residual import residual
from validation.accuracy.motions import AGREEMENT, Motions, motions_of
from validation.tests.helpers.scenes import case_of

DURATION = "run.duration=50 us"


def test_engines_share_what_is_computed_for_a_case_and_a_law_of_friction() -> None:
    first = motions_of(case_of("fig4", DURATION), "liggghts")
    assert motions_of(case_of("fig4", DURATION), "yade") is first
    assert motions_of(case_of("fig4", DURATION, "striker.speed=1 m/s")) is not first
    case = case_of("fig4-tube", DURATION)
    liggghts, yade, verlet = (motions_of(case, engine) for engine in ("liggghts", "yade", "verlet"))
    assert liggghts is verlet
    assert yade is not verlet


def test_another_rounding_is_only_rounding_and_another_step_is_not() -> None:
    case = case_of("fig4", DURATION, "run.time_step=0.5 us")
    motions = Motions(case, "total")
    samples, allowed = motions.samples, motions.explained(FORCE)
    assert 1 < samples <= case.scene.samples
    assert (residual(motions.rounded, motions.plain)[:samples] <= allowed).all()
    assert motions.rounding_bound[:samples].max() <= AGREEMENT
    coarse = Motions(case.at(1), "total")
    assert residual(coarse.plain, motions.plain).max() > allowed.max()


def test_the_scheme_in_a_tube_converges_to_the_extrapolated_motion_by_its_order() -> None:
    whole, half = (Motions(case_of("fig5-tube", DURATION).at(steps), "total") for steps in (10, 20))
    samples = len(whole.exact.time_s)
    errors = [float(residual(each.plain, whole.exact)[:samples].max()) for each in (whole, half)]
    assert whole.order == pytest.approx(2, abs=0.3)
    assert errors[0] / errors[1] == pytest.approx(2**whole.order, rel=0.1)


def test_a_chaotic_chain_is_judged_up_to_its_horizon() -> None:
    case = case_of("fig4", "run.duration=20 ms", "run.sample_interval=10 us", "run.time_step=0.5 us")
    motions = motions_of(case)
    allowed = motions.explained(FORCE)
    assert allowed[0] == motions.tolerance_at(FORCE, 0).limit == tolerance("model", "force").limit
    assert AGREEMENT / 100 < allowed[-1] <= AGREEMENT
    assert 8e-3 < case.sample_times_s[motions.known] < case.sample_times_s[motions.samples] < 19e-3
    assert "where rounding alone explains differences of 0.01" in motions.until_horizon
