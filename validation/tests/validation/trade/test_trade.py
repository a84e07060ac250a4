"""The trade study: its ladder, its arithmetic, and a small one on real engines."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from validation.chapters import frame_of, read_section, write_chapter
from validation.tests.helpers.commands import beads
from validation.tests.helpers.runs import need
from validation.tests.helpers.scenes import case_of
from validation.trade.ladder import LadderRun, Rung, affordable, at_step, run_ladder
from validation.trade.softening import soften
from validation.trade.trade_chapter import CHAPTER, advice, orders


def table(errors: list[float], shares: list[float]) -> pd.DataFrame:
    rows = pd.DataFrame({"scene": "s", "method": "m", "status": "done", "share_of_limit": shares})
    rows["time_step_s"] = rows["share_of_limit"] * 1e-6
    rows["loop_s"] = 1 / rows["share_of_limit"]
    for name in ("force", "sensor_peak", "wall_peak", "arrival", "speed", "width", "energy", "momentum"):
        rows[name] = errors
    return rows


def test_an_order_is_of_small_steps() -> None:
    shares = [2.0**-place for place in range(14)]
    rows = table([0.5 if share > 0.11 else max(5 * share**2, 4e-6) for share in shares], shares)
    assert orders(rows)["m"] == pytest.approx((2, 2))


def test_the_largest_step_is_not_below_its_error_by_chance() -> None:
    rows = table([1e-1, 1e-4, 1e-2, 1e-3, 1e-4], [1.0, 0.5, 0.25, 0.125, 0.0625])
    steps = {each.error_at_most: each.time_step_s for each in advice(rows) if each.quantity == "force"}
    assert steps[1e-3] == 0.125e-6
    assert steps[1e-4] == 0.0625e-6  # the same error at half the limit is small by chance
    assert 1e-8 not in steps


def test_what_is_too_dear_is_left_out() -> None:
    case = case_of("fig4")
    rungs = [Rung("fig4", "m", case, 1.0, seconds) for seconds in (0.3, 0.1, 5.0, 0.2)]
    kept, left = affordable(rungs, 10.0)
    assert [rung.expected_s for rung in kept] == [0.1, 0.2, 0.3]
    assert [rung.expected_s for rung in left] == [5.0]


def test_steps_larger_than_the_interval_have_fewer_samples() -> None:
    case = case_of("fig4")
    coarse, fine = at_step(case, 0.5, 1.8e-5), at_step(case, 0.01, 1.8e-5)
    assert coarse.scene.time_step_s == coarse.scene.run.sample_interval == 9e-6
    assert fine.scene.samples == case.scene.samples
    assert fine.scene.time_step_s <= 1.8e-7


def test_softening_is_exact_without_gravity_only() -> None:
    found = list(soften())
    assert max(each.error for each in found if "without gravity" in each.setting) < 1e-10
    assert min(each.error for each in found if "with gravity" in each.setting) > 1e-3


@pytest.mark.long
def test_a_small_ladder_on_real_engines(tmp_path: Path) -> None:
    need("liggghts")
    need("yade")
    rows = run_ladder(2.0, ("fig5",), short=True)
    found = frame_of(LadderRun, rows)
    slopes = orders(found)
    assert all(slopes[name] == pytest.approx((2, 2), abs=0.05) for name in ("liggghts", "yade", "verlet"))
    left = found[found["status"] == "not run"]
    assert left["reason"].str.contains("its loop would take").all()
    same = found[found["share_of_limit"].between(0.009, 0.011) & found["method"].isin(["liggghts", "yade", "verlet"])]
    assert np.ptp(same["force"].to_numpy()) < 1e-9

    write_chapter(CHAPTER, {"trade": rows, "trade-advice": advice(found), "trade-softening": soften()}, tmp_path)
    section = read_section("trade", tmp_path)
    assert section["sentences"][0].startswith("fig5, error of the force at most 1e-4: the time loop takes ")
    assert section["advice"][0][0] == "fig5, force trace"


@pytest.mark.parametrize("budget", ["0", "nan", "x"])
def test_bad_budgets(budget: str) -> None:
    said = beads("trade", f"--budget={budget}")
    assert said.returncode == 2
    assert len(said.stderr.splitlines()) == 1
