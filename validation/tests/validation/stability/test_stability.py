"""Limits of the time step, what guards them, scenes at the edge."""

from math import inf
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from drivers.base.errors import InputError
from drivers.base.tolerances import tolerance
from drivers.chain.chain import Array
from drivers.chain.schemes import verlet_in_heights, verlet_of
from drivers.chain.trace import Trace
from drivers.engines import VERLET, codes, installed
from drivers.limits import stable_step, trial
from drivers.limits.energy_bounds import certainly_stable
from drivers.limits.refusal import inability, refuse
from drivers.limits.stable_step import linear_limit, predicted_limit
from drivers.run.compute import compute
from drivers.run.guard import reason_to_fail
from validation.accuracy.plan_report import plan_report
from validation.chapters import read_section, write_chapter
from validation.checks import FAIL, NOT_RUN, PASS
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
FEW_BODIES = [("chain.count=1", "chain.sensors=[]"), ("chain.count=0", "chain.sensors=[]"), ("striker.mass=1e-9 kg",)]
SHARES_OF_BOUND = (0.7, 0.85, 0.93, 0.97, 1.0)
QUICK = {each.name: each for each in extremes(quick=True)}


def words_of(settings: tuple[str, ...]) -> list[str]:
    return [word for setting in settings for word in ("--set", setting)]


def test_predictions_are_right_on_the_papers_scenes_and_at_random() -> None:
    subjects = [*(MeasuredChain(RANDOM, name, case_of(name)) for name in PAPER), *at_random(5)]
    for limit in measure_limits(subjects, names=()):
        assert 1 <= limit.ratio <= tolerance("stability", "measured").limit, limit


def test_codes_blow_up_where_the_in_repo_scheme_does() -> None:
    for name in codes():
        need(name)
    limits = measure_limits([MeasuredChain(RANDOM, "fig5", case_of("fig5"))], names=codes())
    assert len(limits) == 1 + len(codes())
    assert len({limit.measured_s for limit in limits}) == len({limit.bad_s for limit in limits}) == 1
    assert limits[0].bad_s < limits[0].measured_s


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
    for number in range(20):
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


def test_beyond_the_bound_steps_are_refused_where_the_scheme_fails() -> None:
    refused = []
    for kind in KINDS:
        for number in range(4):
            case = adversarial_case(kind, number)
            run = case.sampled_at_every(1.7 * predicted_limit(case.chain, float(case.sample_times_s[-1])))
            with np.errstate(all="ignore"):
                fails = reason_to_fail(run, verlet_of(run))
            refused.append(fails is not None)
            if fails is None:
                refuse(run, "verlet")
                continue
            with pytest.raises(InputError, match="a trial at this step is unstable at t = ") as error:
                refuse(run, "verlet")
            assert "\n" not in str(error.value)
    assert any(refused)
    assert not all(refused)


def test_what_outlasts_a_trial_is_refused_beyond_the_bound(monkeypatch: pytest.MonkeyPatch) -> None:
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
    assert lines[0].startswith("stability  stable up to ")
    assert float(lines[0].split()[4]) == pytest.approx(17.3, rel=0.01)
    assert "first trial run to blow up: at " in lines[1]
    assert float(lines[1].split()[-2]) > 17.4
    beyond = [*plan_report("fig4", ("run.time_step=18 us", "run.sample_interval=18 us"))]
    assert any("the trial run at this step is stable" in line for line in beyond)
    refused = [*plan_report("fig4", TOO_LARGE)]
    assert any("the trial run at this step is unstable" in line and "refused" in line for line in refused)
    assert len(refused) < len(beyond)


@pytest.mark.parametrize("settings", FEW_BODIES)
def test_limits_of_few_and_of_light_bodies(settings: tuple[str, ...]) -> None:
    case = case_of("fig4", "gravity=", *settings)
    limit = predicted_limit(case.chain, float(case.sample_times_s[-1]))
    gains = [gain(run, verlet_of(run)) for share in (1.0, 1.25) for run in [case.sampled_at_every(share * limit)]]
    assert gains[0] <= 1 < gains[1]


def test_the_linear_limit_of_two_bodies_is_that_of_their_oscillation(scene_file: SceneWriter) -> None:
    chain = case_of(scene_file(count=1, wall="")).chain
    spring = 5e5
    omega = np.sqrt(spring * (1 / chain.mass_kg[0] + 1 / chain.mass_kg[1]))
    assert linear_limit(chain, np.array([0.0, spring])) == pytest.approx(2 / omega, rel=1e-12)


def test_a_step_that_blows_up_is_refused_and_unsafe_runs_it(tmp_path: Path) -> None:
    words = [
        "run",
        "fig4",
        *words_of(TOO_LARGE),
        "--runs",
        str(tmp_path),
        "--engine",
        "verlet",
        "--engine",
        "reference",
    ]
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
    warning = "error of the force up to 0.2"
    said = beads("run", "fig4", *words_of(COARSE), "--engine", "verlet", "--runs", shared_runs)
    assert said.returncode == 0
    assert f"fig4: verlet warning: {warning}" in said.stderr
    (line,) = finished(case_of("fig4", *COARSE), "verlet", shared_runs).record.warnings or [""]
    assert line.startswith(warning)
    assert line.endswith("cause: the time step")


def test_rounding_warns_by_its_own_name(tmp_path: Path) -> None:
    ended = finished(case_of("fig4", "chain.origin=1e6 km"), "liggghts", tmp_path)
    assert ended.record.warnings is not None
    assert "cause: rounding of heights" in ended.record.warnings[0]


def test_a_motion_beyond_hertz_is_refused(scene_file: SceneWriter) -> None:
    case = case_of(scene_file(), "striker.speed=1 km/s", "run.time_step=1 ns")
    with pytest.raises(InputError, match=r"striker.speed: found a motion that presses contact 6 .* radii deep"):
        refuse(case, "reference")


def test_what_one_engine_cannot_take_others_run(scene_file: SceneWriter, tmp_path: Path) -> None:
    need("liggghts")
    path = scene_file(count=220)
    far = words_of(("chain.bead=[{from_wall=3, gap_below='100 km'}]", "run.duration=20 us"))
    by_name = beads("run", path, *far, "--runs", tmp_path, "--engine", "liggghts")
    assert (by_name.returncode, by_name.stdout) == (2, "")
    assert "on liggghts at most 1e+08 bins" in by_name.stderr
    compared = beads("compare", path, *far, "--runs", tmp_path, "--engine", "liggghts", "--allow-missing")
    assert compared.returncode == 0, compared.stderr
    assert "liggghts   run    " in compared.stdout
    assert "not run: refused: " in compared.stdout
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


def test_a_coarse_run_is_right_but_not_accurate_and_a_step_beyond_the_limit_is_not_run(shared_runs: Path) -> None:
    checks = [*run_all([Extreme(name="", scene="fig4", set=COARSE)], shared_runs)]
    coarse = {(check.engine, check.quantity.partition(":")[0]) for check in checks if check.verdict == NOT_ACCURATE}
    assert {kind for _, kind in coarse} == {"error"}
    assert {engine for engine, _ in coarse} == {VERLET, *installed(codes())}
    assert not [check for check in checks if check.verdict == FAIL]
    too_large = Extreme(name="", scene="fig4", set=TOO_LARGE)
    refused = {check.engine for check in run_all([too_large], shared_runs) if check.where.startswith("refused")}
    assert refused == {VERLET, *installed(codes())}


def test_a_drift_is_distinguished_from_a_random_walk() -> None:
    case = case_of("fig4")
    samples = np.linspace(0, 1, 2000)
    draw = np.random.default_rng(1)

    def trace(energy: Array) -> Trace:
        nothing = np.zeros((len(samples), 1))
        return Trace(samples * case.sample_times_s[-1], nothing, energy, 1 + energy, energy)

    drifting = energy_of("", "", case, trace(1e-6 * samples + 1e-8 * draw.normal(size=2000)))
    assert abs(drifting.drift) > SIGNIFICANCE * drifting.drift_error
    walking = energy_of("", "", case, trace(1e-7 * draw.normal(size=2000).cumsum()))
    assert not abs(walking.drift) > SIGNIFICANCE * walking.drift_error


def test_heights_round_and_overlaps_do_not() -> None:
    near, far = (pressed(1e-4, height) for height in (0.0, 1e3))
    assert max(rounded(case, "", verlet_of(case).force_N).error for case in (near, far)) < 1e-15
    low, high = (rounded(case, "", verlet_in_heights(case).force_N).error for case in (near, far))
    assert high > 1e3 * low
    need("lammps")
    assert rounded(far, "lammps", compute(far, "lammps").done.force_N).error == pytest.approx(high, rel=1e-6)


def test_the_study_fails_for_a_limit_that_is_exceeded_or_far(tmp_path: Path, shared_runs: Path) -> None:
    """Files of an earlier study are removed."""
    (tmp_path / "stability-energy.csv").write_text("of an earlier study\n")
    chosen = [MeasuredChain(SHIPPED, "fig5", case_of("fig5")), *sweeps()][::8]
    edge = Extreme(name="beads <b>", scene="fig4", set=COARSE)
    extreme = [*run_all([edge], shared_runs)]
    rows: dict[str, list[Any]] = {"stability": measure_limits(chosen, names=()), "stability-extremes": extreme}
    tables = write_chapter(CHAPTER, rows, tmp_path)
    assert CHAPTER.failed(tables) == []
    written = ["stability-extremes.csv", "stability-limits.png", "stability-limits.svg", "stability.csv"]
    assert sorted(path.name for path in tmp_path.glob("[!.]*")) == written
    assert "which never exceeds it" in read_section("stability", tmp_path)["sentences"][0]
    table = tables["stability"]
    for ratio, failed in ((0.99, len(table)), (1.3, 1)):  # of the shipped scene alone
        table["ratio"] = ratio
        assert len(CHAPTER.failed(tables)) == failed
