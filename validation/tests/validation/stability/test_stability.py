"""Limits of the time step, what guards them, scenes at the edge."""

from math import inf
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from drivers.limits.energy_bounds import certainly_stable

from drivers.base.errors import InputError
from drivers.base.tolerances import tolerance
from drivers.chain.schemes import verlet_in_heights, verlet_of
from drivers.chain.trace import Trace
from drivers.engines import VERLET, codes, installed
from drivers.limits import stable_step, trial
from drivers.limits.refusal import inability, refuse
from drivers.limits.stable_step import predicted_limit
from validation.accuracy.plan_report import plan_report
from validation.chapters import write_chapter
from validation.checks import NOT_RUN, PASS
from validation.stability import measured_limits
from validation.stability.extremes import NOT_ACCURATE, Extreme, extremes, run_all
from validation.stability.measured_limits import (
    FINENESS,
    PAPER,
    RANDOM,
    SHIPPED,
    MeasuredChain,
    at_random,
    bouncing,
    gain,
    measure_limits,
    random_case,
    sweeps,
)
from validation.stability.rounding_effects import SIGNIFICANCE, energy_of, pressed, rounded
from validation.stability.stability_chapter import CHAPTER
from validation.tests.helpers.adversarial import KINDS, adversarial_case
from validation.tests.helpers.commands import beads
from validation.tests.helpers.runs import finished, need
from validation.tests.helpers.scenes import SceneWriter, case_of

TOO_LARGE = ("run.time_step=20 us", "run.sample_interval=20 us")
COARSE = ("run.time_step=8 us", "run.sample_interval=8 us")
SHARES_OF_BOUND = (0.7, 0.85, 0.93, 0.97, 1.0)
QUICK = {each.name: each for each in extremes(quick=True)}


def words_of(settings: tuple[str, ...]) -> list[str]:
    return [word for setting in settings for word in ("--set", setting)]


@pytest.mark.parametrize("count", [5, pytest.param(40, marks=pytest.mark.accuracy)])
def test_predictions_are_right_on_the_papers_scenes_and_at_random(count: int) -> None:
    names = PAPER if count == 5 else ("low-amplitude", "steel-chain")
    subjects = [*(MeasuredChain(RANDOM, name, case_of(name)) for name in names), *at_random(count)]
    for limit in measure_limits(subjects, names=()):
        assert 1 <= limit.ratio <= tolerance("stability", "measured").limit, limit


@pytest.mark.parametrize("times", [0.97, 1.05])
def test_a_code_that_blows_up_elsewhere_is_scanned_itself(times: float, monkeypatch: pytest.MonkeyPatch) -> None:
    subjects = [MeasuredChain(RANDOM, "fig5", case_of("fig5"))]
    (scheme,) = measure_limits(subjects, names=())
    elsewhere_s = times * scheme.measured_s
    monkeypatch.setattr(
        measured_limits, "_gain_on", lambda _, case: inf if case.scene.time_step_s >= elsewhere_s else 0
    )
    _, code = measure_limits(subjects, names=("a code",))
    assert code.method == "a code"
    assert elsewhere_s <= code.measured_s <= elsewhere_s * (1 + 2 * FINENESS)


def test_the_cheap_bound_never_calls_a_step_stable_that_is_not(monkeypatch: pytest.MonkeyPatch) -> None:
    for number in range(10):
        case = random_case(number, accuracy=0.1)
        duration = float(case.sample_times_s[-1])
        limit = predicted_limit(case.chain, duration)
        assert not certainly_stable(case.chain, duration, 1.0001 * limit)
        with monkeypatch.context() as finer:
            finer.setattr(stable_step, "FINE_STEP_SHARE", 0.01)
            finely = stable_step.stable_step(case.chain, stable_step.reached(case.chain, duration), duration)
            assert limit == pytest.approx(finely, rel=8e-3)


def test_many_impacts_lower_the_limit() -> None:
    limits = measure_limits([*bouncing()][:2], names=())
    assert limits[1].measured_s < 0.85 * limits[0].measured_s
    assert all(limit.ratio >= 1 for limit in limits)


@pytest.mark.parametrize("damped", [False, True])
@pytest.mark.parametrize(
    "numbers", [range(3), pytest.param(range(3, 40), marks=pytest.mark.accuracy)], ids=["few", "many"]
)
@pytest.mark.parametrize("kind", KINDS)
def test_nothing_blows_up_below_the_bound(kind: str, numbers: range, damped: bool) -> None:
    """Verlet gains less than all that is put in at steps up to the bound."""
    for number in numbers:
        case = adversarial_case(kind, number, damped=damped)
        limit = predicted_limit(case.chain, float(case.sample_times_s[-1]))
        for share in SHARES_OF_BOUND:
            run = case.sampled_at_every(share * limit)
            assert gain(run, verlet_of(run)) <= 1, f"{case.scene.name} blows up at {share:.2f} of its bound"


def test_a_scene_too_long_for_a_trial_is_refused_beyond_the_bound(monkeypatch: pytest.MonkeyPatch) -> None:
    case = case_of("fig4")
    limit = predicted_limit(case.chain, float(case.sample_times_s[-1]))
    slightly = case.sampled_at_every(1.01 * limit)
    refuse(slightly, "verlet")
    monkeypatch.setattr(trial, "MAX_BODY_STEPS", 100)
    with pytest.raises(
        InputError, match=r"at most 1.7.* s, the predicted stability limit; a trial at .* takes too long"
    ):
        refuse(slightly, "verlet")
    refuse(case.sampled_at_every(0.99 * limit), "verlet")


def test_a_plan_says_what_is_a_bound_and_what_a_trial() -> None:
    lines = [line for line in plan_report("fig4") if line.startswith("stability") or "first trial run" in line]
    assert lines[0].startswith("stability  stable up to 17.3")
    assert "first trial run to blow up: at " in lines[1]
    assert float(lines[1].split()[-2]) > 17.4
    beyond = " ".join(plan_report("fig4", ("run.time_step=18 us", "run.sample_interval=18 us")))
    assert "the trial run at this step is stable" in beyond
    refused = " ".join(plan_report("fig4", TOO_LARGE))
    assert "the trial run at this step is unstable" in refused
    assert "refused" in refused


def test_a_step_that_blows_up_is_refused_and_unsafe_runs_it(tmp_path: Path) -> None:
    engines = ("--engine", "verlet", "--engine", "reference")
    words = ["run", "fig4", *words_of(TOO_LARGE), "--runs", str(tmp_path), *engines]
    refused = beads(*words)
    assert (refused.returncode, refused.stdout, len(refused.stderr.splitlines())) == (2, "", 1)
    assert "run.time_step: found 2e-05 s; allowed: at most 1.7" in refused.stderr
    assert not list(tmp_path.rglob("run.json"))
    step = refused.stderr.partition("at most ")[2].partition(" s,")[0]
    refuse(case_of("fig4", f"run.time_step={step} s", f"run.sample_interval={step} s"), "verlet")
    unsafe = beads(*words, "--unsafe")
    assert unsafe.returncode == 1
    assert "fig4: verlet failed: unstable at t = " in unsafe.stderr
    assert "reference failed" not in unsafe.stderr  # it has no time step


def test_a_step_that_is_too_coarse_is_done_with_a_warning(shared_runs: Path) -> None:
    said = beads("run", "fig4", *words_of(COARSE), "--engine", "verlet", "--runs", shared_runs)
    assert said.returncode == 0
    assert "fig4: verlet warning: error of the force up to 0.2" in said.stderr
    (line,) = finished(case_of("fig4", *COARSE), "verlet", shared_runs).record.warnings or [""]
    assert line.endswith("cause: the time step")


def test_rounding_warns_by_its_own_name(tmp_path: Path) -> None:
    ended = finished(case_of("fig4", "chain.origin=1e6 km"), "liggghts", tmp_path)
    assert ended.record.warnings is not None
    assert "cause: rounding of heights" in ended.record.warnings[0]


def test_a_gap_too_far_for_a_neighbour_search_is_refused(scene_file: SceneWriter, tmp_path: Path) -> None:
    need("liggghts")
    path = scene_file(count=220)
    far = words_of(("chain.bead=[{from_wall=3, gap_below='100 km'}]", "run.duration=20 us"))
    by_name = beads("run", path, *far, "--runs", tmp_path, "--engine", "liggghts")
    assert (by_name.returncode, by_name.stdout) == (2, "")
    assert "on liggghts at most 1e+08 bins" in by_name.stderr
    assert inability(case_of(path), "liggghts") is None


@pytest.mark.long
@pytest.mark.parametrize("name", QUICK)
def test_at_the_edge(name: str, shared_runs: Path) -> None:
    for engine in codes():
        need(engine)
    for check in run_all([QUICK[name]], shared_runs):
        if check.engine == "liggghts" and "neighbour search" in name:
            assert (check.verdict, check.where[:7]) == (NOT_RUN, "refused")
        else:
            assert check.verdict == PASS, check


def test_a_drift_is_distinguished_from_a_random_walk() -> None:
    case = case_of("fig4")
    samples, draw = np.linspace(0, 1, 2000), np.random.default_rng(1)
    nothing = np.zeros((len(samples), 1))
    for energy, drifts in (
        (1e-6 * samples + 1e-8 * draw.normal(size=2000), True),
        (1e-7 * draw.normal(size=2000).cumsum(), False),
    ):
        trace = Trace(samples * case.sample_times_s[-1], nothing, energy, 1 + energy, energy)
        row = energy_of("", "", case, trace)
        assert (abs(row.drift) > SIGNIFICANCE * row.drift_error) == drifts


def test_heights_round_and_overlaps_do_not() -> None:
    near, far = (pressed(1e-4, height) for height in (0.0, 1e3))
    assert max(rounded(case, "", verlet_of(case).force_N).error for case in (near, far)) < 1e-15
    low, high = (rounded(case, "", verlet_in_heights(case).force_N).error for case in (near, far))
    assert high > 1e3 * low


def test_the_study_fails_for_a_limit_that_is_exceeded_or_far(tmp_path: Path, shared_runs: Path) -> None:
    """A coarse run is right but not accurate; files of an earlier study are removed."""
    (tmp_path / "stability-energy.csv").write_text("of an earlier study\n")
    chosen = [MeasuredChain(SHIPPED, "fig5", case_of("fig5")), *{sweep.group: sweep for sweep in sweeps()}.values()]
    edge = [*run_all([Extreme(name="coarse", scene="fig4", set=COARSE)], shared_runs)]
    coarse = {(check.engine, check.quantity.partition(":")[0]) for check in edge if check.verdict == NOT_ACCURATE}
    assert coarse == {(engine, "error") for engine in (VERLET, *installed(codes()))}
    rows: dict[str, list[Any]] = {"stability": measure_limits(chosen, names=()), "stability-extremes": edge}
    tables = write_chapter(CHAPTER, rows, tmp_path)
    assert CHAPTER.failed(tables) == []
    assert not (tmp_path / "stability-energy.csv").exists()
    table = tables["stability"]
    for ratio, failed in ((0.99, len(table)), (1.3, 1)):  # of the shipped scene alone
        table["ratio"] = ratio
        assert len(CHAPTER.failed(tables)) == failed
