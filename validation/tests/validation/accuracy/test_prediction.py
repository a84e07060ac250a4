"""Tolerances of truncation errors: tight, with a reason, and red for a run that errs more than its scheme."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from drivers.base.tolerances import tolerance
from drivers.chain.case import Case
from drivers.chain.schemes import verlet_of
from drivers.chain.trace import Trace
from drivers.engines import REFERENCE, TOTAL, VERLET
from drivers.limits.refusal import FORCE
from postproc.read.observables import of_kind
from validation.accuracy import baseline as baselines
from validation.accuracy import schemes
from validation.accuracy.baseline import Baseline, baseline_of
from validation.accuracy.exact_motion import ENERGY, exact_motion_of
from validation.accuracy.prediction import IMPULSE, predict, run_errors
from validation.compare.comparison import compare_case
from validation.compare.verdict import FAIL, PASS, Verdict
from validation.reference.hertz_chain import HertzChain, Motion
from validation.reference.velocity_verlet import integrate_verlet
from validation.tests.helpers.runs import finished
from validation.tests.helpers.scenes import case_of

A_CODE = "yade"  # its traces are made here: it need not be installed
CHANGE = 1e-6
PAPER = ("fig4", "fig5", "fig6b", "fig6d")
Scheme = Callable[[HertzChain, float, int, int], Motion]


def over(baseline: Baseline, engine: str, trace: Trace) -> set[str]:
    """Quantities of a run whose errors exceed the prediction."""
    predicted = predict(baseline, engine)
    errors = run_errors(baseline, trace, baseline.exact)
    return {name for name, error in errors.items() if not error <= predicted.errors[name] + predicted.rest[name]}


def altered(case: Case, **arrays: object) -> Trace:
    """Trace by velocity Verlet of a case with other arrays of its chain."""
    return verlet_of(replace(case, chain=replace(case.chain, **arrays)))  # type: ignore[arg-type]


def by(scheme: Scheme, case: Case, monkeypatch: pytest.MonkeyPatch) -> tuple[Baseline, Trace]:
    """Baseline and run of a case by another scheme in place of velocity Verlet."""
    monkeypatch.setattr(schemes, "integrate_verlet", scheme)
    return Baseline(case, TOTAL), verlet_of(case)


@pytest.mark.parametrize(
    "settings",
    [
        *((scene,) for scene in (*PAPER, "low-amplitude", "steel-chain", "two-spheres", "sphere-on-plane")),
        ("fig4", "run.time_step=0.5 us"),
        ("fig5", "gravity=98.1 m/s^2"),
        ("fig4", "contact.restitution=0.9"),
        ("fig4", "contact.dissipation=power", "contact.gamma=1.25"),
        ("fig4", "run.sample_interval=0.5 us"),
    ],
)
def test_a_faultless_run_is_within_a_tight_limit(settings: tuple[str, ...]) -> None:
    case = case_of(*settings)
    baseline = baseline_of(case)
    assert over(baseline, VERLET, baseline.plain) == set()
    assert over(baseline, A_CODE, baseline.rounded) == set()
    assert not {ENERGY, IMPULSE} & over(baseline, REFERENCE, baseline.exact)
    errors = run_errors(baseline, baseline.plain, baseline.exact)
    for engine in (A_CODE, VERLET):
        predicted = predict(baseline, engine)
        most = 1.05 if engine == VERLET and case.chain.damped else 1.002
        assert predicted.errors[FORCE] + predicted.rest[FORCE] < most * errors[FORCE] + 2e-9
        assert predicted.errors[IMPULSE] == pytest.approx(errors[IMPULSE], rel=0.05, abs=1e-9)


@pytest.mark.parametrize("scene", [*PAPER, "steel-chain"])
def test_a_millionth_more_stiffness_or_less_mass_and_a_step_twice_as_long_are_red(scene: str) -> None:
    case = case_of(scene)
    baseline, chain = baseline_of(case), case.chain
    one = chain.mass_kg.copy()
    one[chain.bodies // 2] *= 1 - CHANGE
    assert FORCE in over(baseline, A_CODE, altered(case, mass_kg=one))
    assert FORCE in over(baseline, A_CODE, altered(case, mass_kg=chain.mass_kg * (1 - CHANGE)))
    assert FORCE in over(baseline, A_CODE, altered(case, stiffness=chain.stiffness * (1 + CHANGE)))
    assert ENERGY in over(baseline, A_CODE, verlet_of(case_of(scene, f"contact.restitution={1 - CHANGE}")))
    twice = over(baseline, A_CODE, verlet_of(case.at(case.scene.steps_per_sample // 2)))
    assert {FORCE, ENERGY, *of_kind(twice, "speed", "peak")} <= twice
    assert of_kind(twice, "peak")


def test_a_stiffer_code_turns_red_in_the_table(shared_runs: Path) -> None:
    case = case_of("fig4")
    runs = {engine: finished(case, engine, shared_runs) for engine in (VERLET, REFERENCE)}
    stiff = replace(runs[VERLET])
    object.__setattr__(stiff, "trace", altered(case, stiffness=case.chain.stiffness * (1 + CHANGE)))
    verdicts = compare_case(case, runs | {A_CODE: stiff}, {})
    assert {each.engine for each in verdicts if each.verdict == FAIL} == {A_CODE}
    red = {each.quantity: each for each in verdicts if each.verdict == FAIL}
    assert {"force against reference", "peak of a gauge", "speed between gauges"} <= set(red)
    assert "velocity Verlet at 0.1 µs has an error of 3.0e-05" in red["force against reference"].where


def test_a_faulty_reference_turns_verlet_red() -> None:
    """Codes are held to what Verlet differs by from the reference, Verlet to what its own steps predict."""
    case = case_of("fig4")
    baseline = Baseline(case, TOTAL)
    soft = replace(case, chain=replace(case.chain, stiffness=case.chain.stiffness * (1 - CHANGE)))
    vars(baseline)["exact_to_end"] = exact_motion_of(soft)
    assert FORCE in over(baseline, VERLET, baseline.plain)


def first_order(chain: HertzChain, step_s: float, every: int, samples: int) -> Motion:
    """Velocity Verlet with contacts that are too stiff by 1e-4 at 0.1 µs, and less at smaller steps."""
    stiffness = chain.stiffness * (1 + 1000 * step_s)
    return integrate_verlet(replace(chain, stiffness=stiffness), step_s, every, samples)


def wrong_coefficient(chain: HertzChain, step_s: float, every: int, samples: int) -> Motion:
    """Velocity Verlet that kicks with 0.5005 in place of 0.5."""
    return integrate_verlet(replace(chain, mass_kg=chain.mass_kg / 1.001), step_s, every, samples)


def late_velocities(chain: HertzChain, step_s: float, every: int, samples: int) -> Motion:
    """Velocities that are recorded half a step before the forces."""
    motion = integrate_verlet(chain, step_s, every, samples)
    net_N = motion.force_N - np.column_stack([motion.force_N[:, 1:], np.zeros(samples)]) + chain.load_N
    return replace(motion, velocity_m_s=motion.velocity_m_s - 0.5 * step_s * net_N / chain.mass_kg)


@pytest.mark.parametrize(
    ("scheme", "quantity"), [(first_order, FORCE), (wrong_coefficient, FORCE), (late_velocities, ENERGY)]
)
@pytest.mark.parametrize("scene", PAPER)
def test_a_scheme_that_is_not_velocity_verlet_turns_verlet_red(
    scene: str, scheme: Scheme, quantity: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    baseline, run = by(scheme, case_of(scene), monkeypatch)
    assert quantity in over(baseline, VERLET, run)


def verdict_on(quantity: str, case: Case, runs: Path) -> Verdict:
    both = {engine: finished(case, engine, runs) for engine in (VERLET, REFERENCE)}
    return next(each for each in compare_case(case, both, {}) if (each.engine, each.quantity) == (VERLET, quantity))


def test_the_general_tolerance_is_an_upper_limit_unless_the_scene_has_an_accuracy(shared_runs: Path) -> None:
    general = tolerance("truncation", "force")
    coarse = verdict_on("force against reference", case_of("fig6d", "run.time_step=1 us"), shared_runs)
    assert (coarse.verdict, coarse.limit, coarse.reason) == (FAIL, general.limit, general.reason)
    assert "of the step predict 1.5e-02" in coarse.where
    asked = case_of("fig6d", "run.time_step=", "run.accuracy=0.05")
    assert asked.plan is not None
    found = verdict_on("force against reference", asked, shared_runs)
    assert found.verdict == PASS
    assert general.limit < found.limit < 1.1 * found.value


def test_unpredicted_errors_have_the_general_tolerance(shared_runs: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    baselines._last.clear()
    monkeypatch.setattr(baselines, "MAX_BODIES", 3)
    case = case_of("fig4")
    for quantity, kind in (("force against reference", ("truncation", "force")), ("energy drift", ("energy", "drift"))):
        found, general = verdict_on(quantity, case, shared_runs), tolerance(*kind)
        assert (found.limit, found.reason, found.verdict) == (general.limit, general.reason, PASS)
    sideways = case_of("oblique-impact")  # its own extrapolation would judge it
    assert predict(Baseline(sideways, TOTAL), VERLET).errors == {}
    assert predict(Baseline(sideways, TOTAL), A_CODE).errors
