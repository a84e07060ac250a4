"""The error budget: parts that add up, judgements that are red for every fault alone, the horizon of judgements."""

import re
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from drivers.base.tolerances import tolerance
from drivers.chain.case import Case
from drivers.chain.chain import Array
from drivers.chain.schemes import verlet_in_heights, verlet_of
from drivers.chain.trace import Trace, residual, until
from drivers.engines import REFERENCE, VERLET
from drivers.laws import power
from drivers.run import scheme
from drivers.run.scheme import scheme_of
from validation.accuracy import motions as module
from validation.accuracy.budget import AT_REST_NOTE, PARTS, Budget, assess, budget_of, kept_budget
from validation.accuracy.motions import motions_of
from validation.checks import FAIL, PASS
from validation.tests.helpers.random_chains import random_case
from validation.tests.helpers.runs import blown_up, finished
from validation.tests.helpers.scenes import case_of

A_CODE = "yade"  # its traces are made here: it need not be installed
CHANGE = 1e-6
ULP = 1e-12  # a unit in the last place of a static load of 4e3 waves, divided by the wave
Change = Callable[[Array], Array]


@pytest.fixture(autouse=True)
def _no_shared_motions() -> None:
    """Tests replace schemes, so none sees the motions of another."""
    module.cached_motions.cache_clear()
    scheme.cached_scheme.cache_clear()


def as_code(case: Case, **changes: Change) -> Trace:
    """Trace of a case as a code would compute it with some arrays of its chain changed."""
    arrays: dict[str, Any] = {name: change(getattr(case.chain, name).copy()) for name, change in changes.items()}
    return verlet_in_heights(replace(case, chain=replace(case.chain, **arrays)))


def times(factor: float, body: int | slice = slice(None)) -> Change:
    """Multiplies one body's value, counted from 1, or all; -1 is the last."""

    def change(values: Array) -> Array:
        place = body if isinstance(body, slice) or body < 0 else body - 1
        values[place] = values[place] * factor
        return values

    return change


def red(budget: Budget) -> set[str]:
    return {check.quantity for check in budget.checks if check.verdict == FAIL}


def values_of(budget: Budget) -> dict[str, float]:
    return {check.quantity: check.value for check in budget.checks}


@pytest.mark.parametrize(
    "settings",
    [
        ("fig6b",),
        ("two-spheres",),
        ("fig4", "contact.restitution=0.9"),
        ("fig4", "contact.dissipation=power", "contact.gamma=1.25"),
        ("fig4", "run.sample_interval=0.5 us", "run.time_step=0.5 us"),
        ("fig4", "striker="),
        ("fig4", "wall=", "gravity="),
        ("fig4", "chain.bead=[{from_wall=3, gap_below='20 um'}]"),
        ("small-signal",),
        ("fig5-tube", "run.duration=50 us"),
    ],
)
def test_faultless_runs_pass_and_their_parts_add_up(settings: tuple[str, ...]) -> None:
    case = case_of(*settings)
    motions = motions_of(case)
    runs = {VERLET: motions.scheme.plain, A_CODE: motions_of(case, A_CODE).scheme.plain}
    if motions.case.chain.straight:
        runs |= {A_CODE: motions.scheme.rounded, REFERENCE: motions.exact}
    for engine, trace in runs.items():
        budget = budget_of(case, engine, trace)
        assert red(budget) == set()
        for row in budget.error_budget:
            assert row["whole"] == pytest.approx(sum(row[part] for part in PARTS[1:]), rel=1e-9, abs=1e-15)
        exact = motions_of(case, engine).exact
        error = float(residual(until(trace, len(exact.time_s)), exact).max())
        assert values_of(budget)["error: force"] == pytest.approx(error, rel=1e-9, abs=ULP)


@pytest.mark.parametrize("number", range(3))
@pytest.mark.parametrize("law", [(), ("contact.dissipation=power", "contact.gamma=0.05", "contact.alpha=2.5")])
def test_right_runs_of_random_scenes_are_right_at_any_sampling(number: int, law: tuple[str, ...]) -> None:
    """Forces that jump, flat maxima and coarse samples make no difference by rounding a fault."""
    case = random_case(number, accuracy=1e-4)
    if law:
        case = replace(case, chain=replace(case.chain, law=power(0.05, 2.5)))
    coarse = case.sampled_at_every(case.scene.time_step_s)
    for each in (case, coarse):
        each = replace(each, plan=None, full=None)
        budget = budget_of(each, A_CODE, motions_of(each, A_CODE).scheme.rounded)
        assert {name for name in red(budget) if name.startswith("model")} == set()


@pytest.mark.parametrize("scene", ["fig5", "fig6d"])
def test_a_millionth_more_stiffness_or_less_mass_and_a_step_twice_as_long_are_wrong(scene: str) -> None:
    case = case_of(scene)
    middle = case.chain.bodies // 2
    for changes in (
        {"mass_kg": times(1 - CHANGE, middle)},
        {"mass_kg": times(1 - CHANGE)},
        {"stiffness": times(1 + CHANGE)},
    ):
        assert "model: force" in red(budget_of(case, A_CODE, as_code(case, **changes)))
    lossy = verlet_of(case_of(scene, f"contact.restitution={1 - CHANGE}"))
    assert "model: energy" in red(budget_of(case, A_CODE, lossy))
    coarse = verlet_of(case.at(case.scene.steps_per_sample // 2))
    assert {"model: force", "model: energy", "model: momentum"} <= red(budget_of(case, A_CODE, coarse))


@pytest.mark.parametrize(
    ("settings", "changes", "words"),
    [
        ((), {"stiffness": times(0.707, 1)}, "from the start: the force in contact 1 is "),
        ((), {"load_N": times(0.0)}, "before any wave arrives: the force in contact "),
        ((), {"mass_kg": times(1.05, 5)}, ", in the wave: the force in contact "),
        (("gravity=0 m/s^2",), {"stiffness": times(0.707, 1)}, ", in the wave: the force in contact 1 is "),
    ],
)
def test_the_first_departure_names_time_and_contact(
    settings: tuple[str, ...], changes: dict[str, Change], words: str
) -> None:
    case = case_of("fig4", *settings)
    assert words in scheme_of(case).departure(A_CODE, as_code(case, **changes))


def test_failed_runs_depart_where_they_begin_to() -> None:
    case = case_of("fig4")
    bent, right = as_code(case, stiffness=times(0.7, -1)), as_code(case)
    departure_of = partial(scheme_of(case).departure, A_CODE)
    for samples in (300, 2):
        assert departure_of(until(bent, samples)) == departure_of(bent) != ""
        assert departure_of(until(right, samples)) == ""
    assert " from 200 µs" in departure_of(blown_up(right, 200))


def test_the_ceiling_judges_unless_the_scene_asks_for_an_accuracy() -> None:
    general = tolerance("truncation", "force")
    coarse = case_of("fig6d", "run.time_step=1 us")
    budget = budget_of(coarse, VERLET, verlet_of(coarse))
    fig4 = case_of("fig4")
    judged = values_of(budget_of(fig4, VERLET, verlet_of(fig4))).keys()
    assert {f"error: {name}" for name in ("force", "energy", "peaks", "speeds")} <= judged
    (check,) = [check for check in budget.checks if check.quantity == "error: force"]
    assert (check.verdict, check.limit, check.reason) == (FAIL, general.limit, general.reason)
    asked = case_of("fig6d", "run.time_step=", "run.accuracy=0.05")
    (check,) = [check for check in budget_of(asked, VERLET, verlet_of(asked)).checks if check.quantity[:5] == "error"]
    assert (check.verdict, check.limit) == (PASS, 0.05)
    assert check.value > general.limit
    bent = as_code(asked, stiffness=times(1.1))
    assert "error: force" in red(budget_of(asked, VERLET, bent))


def test_the_effect_of_elements_left_out_is_part_of_the_error() -> None:
    case = case_of("fig4", "contact.restitution=0.9999", "run.time_step=", "run.accuracy=1e-2")
    assert case.full is not None
    assert case.plan is not None
    trace = verlet_of(case)
    budget = budget_of(case, VERLET, trace)
    row = budget.error_budget[0]
    assert row["whole"] == pytest.approx(sum(row[part] for part in (*PARTS[1:], "elements")), rel=1e-9)
    off = float(residual(trace, motions_of(case.full).exact).max())
    assert abs(row["whole"]) == pytest.approx(off, rel=1e-6)
    assert values_of(budget)["error: force"] == pytest.approx(off, rel=1e-3)


def test_where_the_exact_motion_is_not_known_only_the_model_is_judged(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "MAX_BODIES", 3)
    case = case_of("fig4")
    budget = budget_of(case, A_CODE, verlet_in_heights(case))
    assert set(values_of(budget)) == {"model: force", "model: energy", "model: momentum"}
    assert budget.error_budget == []
    assert "too expensive" in budget.error_note
    assert red(budget_of(case, A_CODE, as_code(case, stiffness=times(1 + CHANGE)))) != set()


def test_a_wrong_wave_on_a_static_load_is_red_and_warned_of() -> None:
    """Errors are relative to the largest change: a wave of 2.6e-4 of the load of its chain."""
    sampling = ("run.time_step=40 us", "run.sample_interval=40 us")
    case = case_of("small-signal", "chain.sensors=[{from_wall=30}]", "run.duration=5 ms", *sampling)
    coarse, exact = verlet_of(case), motions_of(case).exact
    wave_N = np.abs(exact.force_N - case.chain.force_N).max()
    off_N = np.abs(coarse.force_N - exact.force_N).max()
    assert off_N > 0.1 * wave_N
    assert off_N < 1e-3 * exact.force_N.max()
    budget = budget_of(case, VERLET, coarse)
    failed = {check.quantity: check for check in budget.checks if check.verdict == FAIL}
    assert failed["error: force"].value == pytest.approx(off_N / wave_N, rel=1e-9)
    assert "of the largest force" in failed["error: force"].where
    assert any(line.startswith("error of the force") for line in budget.warnings)


def test_a_growing_energy_under_a_static_load_is_warned_of() -> None:
    light = ("striker.diameter=0.6 mm", "striker.mass=0.3 mg", "striker.speed=0.01 m/s", "chain.sensors=[]")
    case = case_of("fig4", *light, "run.time_step=6 us", "run.sample_interval=6 us", "run.duration=0.3 ms")
    warnings = budget_of(case, VERLET, verlet_of(case)).warnings
    assert any(
        re.match(r"error of the energy 0\.12, above 0\.01: at .*; cause: the time step", line) for line in warnings
    )


def test_a_scene_at_rest_has_a_note() -> None:
    still = case_of("small-signal", "chain.bead=[]", "chain.sensors=[]", "run.duration=1 ms")
    budget = budget_of(still, VERLET, verlet_of(still))
    assert AT_REST_NOTE in budget.error_note
    assert abs(budget.error_budget[0]["whole"]) < 1e-9


def test_a_chaotic_chain_is_judged_up_to_its_horizon(shared_runs: Path) -> None:
    case = case_of("fig4", "run.duration=20 ms", "run.sample_interval=5 us", "run.time_step=1 us")
    motions = motions_of(case)
    allowed = motions.scheme.explained("force")
    assert allowed[0] == tolerance("model", "force").limit
    assert scheme.AGREEMENT / 100 < allowed[-1] <= scheme.AGREEMENT
    assert all(8e-3 < case.sample_times_s[horizon] < 19e-3 for horizon in (motions.known, motions.scheme.samples))
    record = assess(finished(case, REFERENCE, shared_runs), case).record
    assert record.exact_until_s is not None
    assert record.exact_to is not None
    assert 5e-3 < record.exact_until_s < 20e-3
    assert record.exact_to <= module.HORIZON
    assert any("later errors are not measured" in line for line in record.warnings or ())
    checks = kept_budget(case, finished(case, VERLET, shared_runs)).checks
    (error,) = [check for check in checks if check.quantity == "error: force"]
    assert "where the error of the exact motion exceeds 1e-06" in error.where
