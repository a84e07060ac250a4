"""The trade study: its ladder and its arithmetic."""

import pandas as pd
import pytest

from validation.chapters import trade
from validation.chapters.trade import advice, affordable, at_step, orders, run_ladder, soften
from validation.tests.helpers.commands import beads
from validation.tests.helpers.scenes import case_of


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
    advised = advice(rows)
    steps = advised[advised["quantity"] == "force"].set_index("error_at_most")["time_step_s"]
    assert steps[1e-3] == 0.125e-6
    assert steps[1e-4] == 0.0625e-6  # the same error at half the limit is small by chance
    assert 1e-8 not in steps


def test_dear_runs_are_left_out_and_large_steps_have_fewer_samples() -> None:
    case = case_of("fig4")
    rungs = [{"expected_s": seconds} for seconds in (0.3, 0.1, 5.0, 0.2)]
    kept, left = affordable(rungs, 10.0)
    assert [rung["expected_s"] for rung in kept] == [0.1, 0.2, 0.3]
    assert [rung["expected_s"] for rung in left] == [5.0]
    coarse, fine = at_step(case, 0.5, 1.8e-5), at_step(case, 0.01, 1.8e-5)
    assert coarse.scene.time_step_s == coarse.scene.run.sample_interval == 9e-6
    assert fine.scene.samples == case.scene.samples
    assert fine.scene.time_step_s <= 1.8e-7


def test_softening_is_exact_without_gravity_and_saves_no_step() -> None:
    softened = soften()
    similar = softened["setting"].str.contains("without gravity")
    assert softened[similar]["error"].max() < 1e-10
    assert softened[~similar]["error"].min() > 1e-3
    assert softened["limit"].min() > 2
    assert softened["steps"].between(0.95, 1.01).all()


def test_a_small_ladder_is_of_second_order(monkeypatch: pytest.MonkeyPatch) -> None:
    """The codes have the scheme of verlet."""
    monkeypatch.setattr(trade, "installed_codes", list)
    rows = run_ladder(0.1, ("fig5",))
    assert orders(rows)["verlet"] == pytest.approx((2, 2), abs=0.05)
    assert {"verlet", "reference"} == set(rows["method"])
    left = rows[rows["status"] == "not run"]
    assert len(left)
    assert left["reason"].str.contains("its loop would take").all()


@pytest.mark.parametrize("budget", ["0", "nan", "x"])
def test_bad_budgets(budget: str) -> None:
    said = beads("trade", f"--budget={budget}")
    assert said.returncode == 2
    assert len(said.stderr.splitlines()) == 1
