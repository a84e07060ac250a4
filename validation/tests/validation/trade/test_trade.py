"""The trade study: its ladder, its arithmetic, and a small one on real engines."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from drivers.base.errors import InputError
from drivers.limits.criteria import rayleigh_time
from validation.chapters import frame_of, read_section, write_chapter
from validation.tests.helpers.commands import beads
from validation.tests.helpers.runs import need
from validation.tests.helpers.scenes import case_of
from validation.trade.ladder import LadderRun, Rung, affordable, at_step, run_ladder
from validation.trade.levers import rayleigh, sampling, softened
from validation.trade.trade_chapter import CHAPTER, advice, front, orders


def table(errors: list[float], shares: list[float]) -> pd.DataFrame:
    rows = pd.DataFrame({"scene": "s", "method": "m", "status": "done", "share_of_limit": shares})
    rows["time_step_s"] = rows["share_of_limit"] * 1e-6
    rows["loop_s"] = 1 / rows["share_of_limit"]
    for name in ("force", "sensor_peak", "wall_peak", "arrival", "speed", "width", "energy", "momentum"):
        rows[name] = errors
    return rows


def test_an_order_has_its_range_and_a_bend_is_seen() -> None:
    """The range has small errors that fall evenly."""
    shares = [2.0**-place for place in range(-6, 6)]
    large, even, bent = (
        [0.9, 0.8, 0.7, 0.6, 0.5, 0.4],
        [0.05 * share**2 for share in shares[6:10]],
        [0.05 * 0.125**2] * 2,
    )
    found = next(orders(table(large + even + bent, shares)))
    assert found.order == pytest.approx(2)
    assert (found.from_share, found.to_share) == (1.0, 0.125)
    assert found.below == pytest.approx(0)


def test_the_cheapest_is_not_below_its_error_by_chance() -> None:
    rows = table([1e-1, 1e-4, 1e-2, 1e-3, 1e-4], [1.0, 0.5, 0.25, 0.125, 0.0625])
    rows["wall_s"] = rows["loop_s"]
    forces = [each for each in advice(rows) if (each.quantity, each.among) == ("force", "m")]
    steps = {each.error_at_most: each.time_step_s for each in forces if each.cheapest_by == "loop_s"}
    assert steps[1e-3] == 0.125e-6
    assert steps[1e-4] == 0.0625e-6  # the same error at half the limit is small by chance
    assert np.isnan(steps[1e-8])


def test_nothing_beats_the_front() -> None:
    rows = pd.DataFrame({"force": [0.1, 0.7, 1.0, 0.5], "loop_s": [4.0, 3.0, 1.0, 2.0]})
    assert list(front(rows, "force", "loop_s")["force"]) == [1.0, 0.5, 0.1]


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


def test_the_rayleigh_time_of_fig4() -> None:
    assert rayleigh_time(case_of("fig4", "chain.sensors=[]")) == pytest.approx(1.64e-5, rel=0.01)


def test_softening_is_exact_without_gravity_only() -> None:
    found = list(softened())
    free = [lever.error for lever in found if "without gravity" in lever.setting]
    heavy = [lever.error for lever in found if "with gravity" in lever.setting]
    assert max(free) < 1e-10
    assert min(heavy) > 1e-3


@pytest.mark.long
def test_a_small_ladder_on_real_engines(tmp_path: Path) -> None:
    need("liggghts")
    need("yade")
    rows = run_ladder(2.0, ("fig5",))
    found = frame_of(LadderRun, rows)
    slopes = {order.method: order.order for order in orders(found) if order.quantity == "force"}
    assert all(slopes[name] == pytest.approx(2, abs=0.05) for name in ("liggghts", "yade", "verlet"))
    left = found[found["status"] == "not run"]
    assert left["reason"].str.contains("its loop would take").all()
    same = found[found["share_of_limit"].between(0.009, 0.011) & found["method"].isin(["liggghts", "yade", "verlet"])]
    assert len(same) == 3
    assert np.ptp(same["force"].to_numpy()) < 1e-9

    measured = [*sampling(), *rayleigh(), *softened()]
    write_chapter(
        CHAPTER,
        {"trade": rows, "trade-levers": measured, "trade-advice": [*advice(found)], "trade-orders": [*orders(found)]},
        tmp_path,
    )
    section = read_section("trade", tmp_path)
    assert any(
        sentence.startswith("The force trace by liggghts converges with order 2.") for sentence in section["sentences"]
    )
    assert len(section["figures"]) == 1
    (tmp_path / "trade.csv").write_text("scene,method\nfig5,yade\n")
    with pytest.raises(InputError, match="altered since it was written"):
        read_section("trade", tmp_path)
    assert read_section("trade", tmp_path / "nowhere") == {}


@pytest.mark.parametrize("budget", ["0", "-1", "nan", "x"])
def test_bad_budgets(budget: str) -> None:
    said = beads("trade", f"--budget={budget}")
    assert said.returncode == 2
    assert len(said.stderr.splitlines()) == 1
