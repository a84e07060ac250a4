"""Limits of the time step, what guards them, scenes at the edge."""

import json
from math import inf
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from drivers.base.errors import InputError
from drivers.base.tolerances import tolerance
from drivers.chain.case import Case
from drivers.chain.chain import Array
from drivers.chain.schemes import verlet_in_heights, verlet_of
from drivers.chain.trace import Trace
from drivers.engines import VERLET, codes, engine_names, installed
from drivers.limits import stable_step, trial
from drivers.limits.energy_bounds import certainly_stable
from drivers.limits.refusal import inability, refuse
from drivers.limits.stable_step import predicted_limit
from drivers.run.compute import compute
from drivers.run.guard import reason_to_fail
from drivers.run.run import run_case
from validation.accuracy.plan_report import plan_report
from validation.chapters import read_section, write_chapter
from validation.checks import FAIL, NOT_RUN, PASS
from validation.report.write_report import write_report
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
from validation.tests.helpers.runs import finished, need, run_and_compare
from validation.tests.helpers.scenes import SceneWriter, case_of

TOO_LARGE = ("--set", "run.time_step=20 us", "--set", "run.sample_interval=20 us")
COARSE = ("run.time_step=8 us", "run.sample_interval=8 us")
SHARES_OF_BOUND = (0.7, 0.85, 0.93, 0.97, 1.0)
QUICK = {each.name: each for each in extremes(quick=True)}


def test_predictions_are_right_on_the_papers_scenes_and_at_random() -> None:
    subjects = [*(MeasuredChain(RANDOM, name, case_of(name)) for name in PAPER), *at_random(20)]
    for limit in measure_limits(subjects, names=()):
        assert 1 <= limit.ratio <= tolerance("stability", "measured").limit, limit


def test_codes_blow_up_where_the_in_repo_scheme_does() -> None:
    for name in codes():
        need(name)
    subjects = [MeasuredChain(RANDOM, "fig5", case_of("fig5")), *at_random(2)]
    limits = measure_limits(subjects, names=codes())
    for subject in subjects:
        own = {limit.method: limit for limit in limits if limit.scene == subject.name}
        assert len({limit.measured_s for limit in own.values()}) == 1
    bad = {limit.bad_s for limit in limits if limit.scene == "fig5"}
    assert len(bad) == 1
    assert bad.pop() < limits[0].measured_s


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
    for number in range(60):
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
    # the bound is of the unluckiest phases of the impacts: of some it has to be near
    settings = ("chain.count=0", "chain.sensors=[]", "gravity=981 m/s^2", "run.duration=25 ms", "run.time_step=1 us")
    speeds = [(*settings, f"striker.speed={speed} m/s") for speed in np.linspace(0.4, 0.6, 8)]
    ratios = [
        limit.ratio for limit in measure_limits([MeasuredChain(RANDOM, "", case_of("fig4", *s)) for s in speeds], ())
    ]
    assert 1 <= min(ratios) <= tolerance("stability", "measured").limit


def check_bound(case: Case) -> None:
    """Verlet gains less than all that is put in at steps up to the bound."""
    limit = predicted_limit(case.chain, float(case.sample_times_s[-1]))
    for share in SHARES_OF_BOUND:
        run = case.sampled_at_every(share * limit)
        assert gain(run, verlet_of(run)) <= 1, f"{case.scene.name} blows up at {share:.2f} of its bound"


@pytest.mark.parametrize("damped", [False, True])
@pytest.mark.parametrize("kind", KINDS)
def test_nothing_blows_up_below_the_bound(kind: str, damped: bool) -> None:
    for number in range(4):
        check_bound(adversarial_case(kind, number, damped=damped))


@pytest.mark.accuracy
@pytest.mark.parametrize("damped", [False, True])
@pytest.mark.parametrize("kind", KINDS)
def test_nothing_blows_up_below_the_bound_of_many(kind: str, damped: bool) -> None:
    for number in range(4, 100):
        check_bound(adversarial_case(kind, number, damped=damped))


@pytest.mark.parametrize("share", [1.3, 1.7, 3.0])
def test_beyond_the_bound_steps_are_refused_where_the_scheme_fails(share: float) -> None:
    refused = []
    for kind in KINDS:
        for number in range(6):
            case = adversarial_case(kind, number)
            run = case.sampled_at_every(share * predicted_limit(case.chain, float(case.sample_times_s[-1])))
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


def test_a_bead_that_flies_runs_beyond_the_bound_and_is_warned_of_by_its_error(tmp_path: Path) -> None:
    case = adversarial_case("light bead", 3)
    limit = predicted_limit(case.chain, float(case.sample_times_s[-1]))
    first = trial.first_failure_s(case, limit)
    assert first is not None
    assert first > 3 * limit
    ended = run_case(case.sampled_at_every(2 * limit), "verlet", tmp_path)
    assert ended.done


def test_a_plan_says_what_is_a_bound_and_what_a_trial(tmp_path: Path) -> None:
    lines = [line for line in plan_report("fig4") if line.startswith("stability")]
    assert lines[0].startswith("stability  stable up to ")
    assert float(lines[0].split()[4]) == pytest.approx(17.3, rel=0.01)
    (first,) = (line for line in plan_report("fig4") if "first trial run to blow up: at " in line)
    assert float(first.split()[-2]) > 17.4
    beyond = [*plan_report("fig4", ("run.time_step=18 us", "run.sample_interval=18 us"))]
    assert any("the trial run at this step is stable" in line for line in beyond)
    refused = [*plan_report("fig4", ("run.time_step=20 us", "run.sample_interval=20 us"))]
    assert any("the trial run at this step is unstable" in line and "refused" in line for line in refused)
    assert len(refused) < len(beyond)


FEW_BODIES = [("chain.count=1", "chain.sensors=[]"), ("chain.count=0", "chain.sensors=[]"), ("striker.mass=1e-9 kg",)]


@pytest.mark.parametrize("settings", FEW_BODIES)
def test_limits_of_few_and_of_light_bodies(settings: tuple[str, ...]) -> None:
    case = case_of("fig4", "gravity=", *settings)
    limit = predicted_limit(case.chain, float(case.sample_times_s[-1]))
    gains = [gain(run, verlet_of(run)) for share in (1.0, 1.25) for run in [case.sampled_at_every(share * limit)]]
    assert gains[0] <= 1 < gains[1]


@pytest.mark.long
def test_a_step_that_blows_up_is_refused_and_unsafe_runs_it(tmp_path: Path) -> None:
    words = ("run", "fig4", *TOO_LARGE, "--runs", tmp_path)
    refused = beads(*words)
    assert (refused.returncode, refused.stdout, len(refused.stderr.splitlines())) == (2, "", 1)
    assert "run.time_step: found 2e-05 s; allowed: at most 1.7" in refused.stderr
    assert not list(tmp_path.rglob("run.json"))
    unsafe = beads(*words, "--unsafe")
    assert unsafe.returncode == 1
    for name in ("verlet", *installed(codes())):
        assert f"fig4: {name} failed: unstable at t = " in unsafe.stderr
    assert "reference failed" not in unsafe.stderr  # it has no time step


def test_what_is_allowed_then_is_run(tmp_path: Path) -> None:
    with pytest.raises(InputError) as refused:
        refuse(case_of("fig4", "run.time_step=20 us", "run.sample_interval=20 us"), "verlet")
    step = str(refused.value).partition("at most ")[2].partition(" s,")[0]
    case = case_of("fig4", f"run.time_step={step} s", f"run.sample_interval={step} s")
    refuse(case, "verlet")
    assert run_case(case, "verlet", tmp_path).done


@pytest.mark.parametrize("engine", ["verlet", *codes()])
def test_a_step_that_is_too_coarse_is_done_with_a_warning(engine: str, shared_runs: Path) -> None:
    need(engine)
    ended = finished(case_of("fig4", *COARSE), engine, shared_runs)
    (warning,) = json.loads((ended.folder / "run.json").read_text())["warnings"]
    assert warning.startswith("error of the force up to 0.2")
    assert warning.endswith("cause: the time step")


def test_warnings_are_printed_and_in_the_report(shared_runs: Path, tmp_path: Path) -> None:
    words = [word for setting in COARSE for word in ("--set", setting)]
    said = beads("run", "fig4", *words, "--engine", "verlet", "--runs", shared_runs)
    assert said.returncode == 0
    assert "fig4: verlet warning: error of the force up to 0.2" in said.stderr
    write_report([run_and_compare("fig4", COARSE, runs=shared_runs)], tmp_path / "report.html")
    assert "error of the force up to 0.2" in (tmp_path / "report.html").read_text()


def test_rounding_warns_by_its_own_name(tmp_path: Path) -> None:
    ended = finished(case_of("fig4", "chain.origin=1e6 km"), "liggghts", tmp_path)
    assert ended.record.warnings is not None
    assert "cause: rounding of heights" in ended.record.warnings[0]


def test_a_motion_beyond_hertz_is_refused(scene_file: SceneWriter) -> None:
    case = case_of(scene_file(), "striker.speed=1 km/s", "run.time_step=1 ns")
    with pytest.raises(InputError, match=r"striker.speed: found a motion that presses contact 6 .* radii deep"):
        refuse(case, "reference")


@pytest.mark.long
def test_what_one_engine_cannot_take_others_run(scene_file: SceneWriter, tmp_path: Path) -> None:
    need("liggghts")
    far = ("chain.bead=[{from_wall=3, gap_below='100 km'}]", "run.duration=20 us")
    path = scene_file(count=220)
    words = ("run", path, "--set", far[0], "--set", far[1], "--runs", tmp_path)
    by_name = beads(*words, "--engine", "liggghts")
    assert (by_name.returncode, by_name.stdout) == (2, "")
    assert "on liggghts at most 1e+08 bins" in by_name.stderr
    everywhere = beads(*words)
    assert everywhere.returncode == 0, everywhere.stderr
    assert "not run on liggghts" in everywhere.stderr
    assert len(everywhere.stdout.split()) == len(installed(engine_names())) - 1
    checks = run_and_compare(path, far, runs=tmp_path).checks
    assert {check.verdict for check in checks if check.engine == "liggghts"} == {"not run"}
    assert inability(case_of(path), "liggghts") is None


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=pytest.mark.long if "thousand times smaller" in name else ()) for name in QUICK]
)
@pytest.mark.long
def test_at_the_edge(name: str, shared_runs: Path) -> None:
    for engine in codes():
        need(engine)
    for check in run_all([QUICK[name]], shared_runs):
        if check.engine == "liggghts" and "neighbour search" in name:
            assert (check.verdict, check.where[:7]) == (NOT_RUN, "refused")
        else:
            assert check.verdict == PASS, check


def test_a_coarse_run_is_right_but_not_accurate(shared_runs: Path) -> None:
    checks = [*run_all([Extreme(name="", scene="fig4", set=COARSE)], shared_runs)]
    coarse = {(check.engine, check.quantity.partition(":")[0]) for check in checks if check.verdict == NOT_ACCURATE}
    assert ("verlet", "error") in coarse
    assert {kind for _, kind in coarse} == {"error"}
    assert "reference" not in {engine for engine, _ in coarse}
    assert not [check for check in checks if check.verdict == FAIL]


def test_a_step_beyond_the_limit_is_not_run(shared_runs: Path) -> None:
    too_large = Extreme(name="", scene="fig4", set=("run.time_step=20 us", "run.sample_interval=20 us"))
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
    for name in codes():
        need(name)
        for case, error in ((near, low), (far, high)):
            assert rounded(case, name, compute(case, name).done.force_N).error == pytest.approx(error, rel=1e-6)


def test_the_study_from_tables_to_the_page(tmp_path: Path, shared_runs: Path) -> None:
    chosen = [MeasuredChain(SHIPPED, "fig5", case_of("fig5")), *sweeps()][::4]
    edge = Extreme(name="beads <b>", scene="fig4", set=COARSE)
    (tmp_path / "stability-energy.csv").write_text("of an earlier study\n")
    (tmp_path / "stability-horizons.svg").write_text("of an earlier study\n")
    rows: dict[str, list[Any]] = {
        "stability": measure_limits(chosen, names=()),
        "stability-extremes": [*run_all([edge], shared_runs)],
    }
    tables = write_chapter(CHAPTER, rows, tmp_path)
    assert CHAPTER.failed(tables) == []
    written = ["stability-extremes.csv", "stability-limits.png", "stability-limits.svg", "stability.csv"]
    assert sorted(path.name for path in tmp_path.glob("[!.]*")) == written
    section = read_section("stability", tmp_path)
    assert "which never exceeds it" in section["sentences"][0]
    assert len(section["figures"]) == 1
    write_report([], tmp_path / "report.html")
    page = (tmp_path / "report.html").read_text()
    assert "beads &lt;b&gt;" in page
    assert "Stability limits of the time step" in page
    assert "the short study, <code>make stability</code> makes the full one" in page
    table = tables["stability"]
    table["ratio"] = 0.99
    assert len(CHAPTER.failed(tables)) == len(table)
    table["ratio"] = 1.3
    assert len(CHAPTER.failed(tables)) == (table["group"] == SHIPPED).sum()
    (tmp_path / "stability.csv").write_text("group,scene\nshipped scenes,fig4\n")
    with pytest.raises(InputError, match="altered since it was written"):
        read_section("stability", tmp_path)
    assert read_section("stability", tmp_path / "nowhere") == {}
