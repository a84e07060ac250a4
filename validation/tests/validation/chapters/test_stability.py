"""Limits of the time step, what guards them, scenes at the edge."""

from math import inf
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from drivers import limits
from drivers.base.errors import InputError
from drivers.base.tolerances import tolerance
from drivers.chain.case import Case
from drivers.chain.schemes import verlet_in_heights, verlet_of
from drivers.chain.trace import Trace
from drivers.engines import VERLET, codes, installed
from drivers.limits import refuse, step_limit, why_unstable
from validation.accuracy.plan import plan_report
from validation.chapters import stability
from validation.chapters.stability import (
    FINENESS,
    PAPER,
    SHIPPED,
    Extreme,
    MeasuredChain,
    bouncing,
    energy_of,
    extremes,
    measure_limits,
    run_all,
    study,
    sweeps,
)
from validation.checks import FAIL, NOT_ACCURATE, PASS
from validation.report.parts import write_part
from validation.tests.drivers.engines.test_contact_laws import SETTINGS
from validation.tests.helpers.adversarial import KINDS, adversarial_case
from validation.tests.helpers.commands import beads
from validation.tests.helpers.random_chains import random_case
from validation.tests.helpers.runs import finished, need
from validation.tests.helpers.scenes import case_of

TOO_LARGE = ("run.time_step=20 us", "run.sample_interval=20 us")
COARSE = ("run.time_step=8 us", "run.sample_interval=8 us")
SHARES_OF_LIMIT = (0.7, 0.85, 0.93, 0.97, 1.0)
MORE_ENERGY = 3.0  # times the kinetic energy of the resolved motion: more than a stable step has
PRESSED = "chain.precompression=20 N"
HELD = ("striker=", "gravity=", "chain.sensors=[]", "chain.count=5", PRESSED)
LIGHT = ("chain.bead=[{from_wall=3, mass='1 ug'}]",)
RAMP = "drive={form='ramp', duration='20 us', from_wall=3, "
RESONANT = (
    "chain.count=1", "chain.sensors=[]", "chain.diameter=10 mm", "chain.precompression=100 N", "drive.window=",
    "drive.cycles=", "drive.frequency=20 kHz", "drive.force=50 N", "run.duration=5 ms", "run.sample_interval=50 us",
)  # fmt: skip
QUICK = {each.name: each for each in extremes(quick=True)}


def words_of(settings: tuple[str, ...]) -> list[str]:
    return [word for setting in settings for word in ("--set", setting)]


@pytest.mark.parametrize("count", [5, pytest.param(40, marks=pytest.mark.accuracy)])
def test_predictions_are_right_on_the_papers_scenes_and_at_random(count: int) -> None:
    names = PAPER if count == 5 else ("low-amplitude", "steel-chain")
    subjects = [*(MeasuredChain(SHIPPED, name, case_of(name)) for name in names)]
    subjects += [MeasuredChain("", f"random {number}", random_case(number, accuracy=0.1)) for number in range(count)]
    assert measure_limits(subjects, names=())["ratio"].between(1, tolerance("stability", "measured").limit).all()


@pytest.mark.parametrize("times", [0.97, 1.05])
def test_a_code_that_blows_up_elsewhere_is_scanned_itself(times: float, monkeypatch: pytest.MonkeyPatch) -> None:
    subjects = [MeasuredChain(SHIPPED, "fig5", case_of("fig5"))]
    elsewhere_s = times * measure_limits(subjects, names=())["measured_s"][0]
    gain_on = stability._gain_on

    def gained(method: str, case: Case, step_s: float) -> float:
        return gain_on(VERLET, case, step_s) if method == VERLET else inf if step_s >= elsewhere_s else 0.0

    monkeypatch.setattr(stability, "_gain_on", gained)
    limits = measure_limits(subjects, names=("a code",)).set_index("method")
    assert elsewhere_s <= limits["measured_s"]["a code"] <= elsewhere_s * (1 + 2 * FINENESS)


def test_many_impacts_lower_the_limit() -> None:
    limits = measure_limits([*bouncing()][:2], names=())
    assert limits["measured_s"][1] < 0.85 * limits["measured_s"][0]
    assert limits["ratio"].min() >= 1


def swing_J(case: Case, step_s: float) -> float:
    """Largest kinetic energy of velocity Verlet at a step, by the displacements of steps; inf after a blow-up."""
    with np.errstate(all="ignore"):
        height = verlet_of(case.sampled_at_every(step_s)).height_m
        assert height is not None
        kinetic = 0.5 * (np.diff(height, axis=0) / step_s) ** 2 @ case.chain.mass_kg
    return float(np.nan_to_num(kinetic, nan=inf).max())


@pytest.mark.parametrize("damped", [False, True])
@pytest.mark.parametrize(
    "numbers", [range(1), pytest.param(range(1, 20), marks=pytest.mark.accuracy)], ids=["few", "many"]
)
@pytest.mark.parametrize("kind", KINDS)
def test_nothing_blows_up_below_the_limit(kind: str, numbers: range, damped: bool) -> None:
    for number in numbers:
        case = adversarial_case(kind, number, damped=damped)
        limit_s, right_J = step_limit(case)[0], swing_J(case, case.scene.time_step_s / 4)
        for share in SHARES_OF_LIMIT:
            gained = swing_J(case, share * limit_s) / right_J
            assert gained <= MORE_ENERGY, f"{case.scene.name} blows up at {share:.2f} of its limit"


@pytest.mark.parametrize("pressed_by", [(), (PRESSED,)], ids=["struck", "pressed"])
@pytest.mark.parametrize("law", ["elastic", "viscoelastic", "kuwabara-kono", "power"])
def test_the_limit_is_close_to_the_first_step_whose_energy_rises(law: str, pressed_by: tuple[str, ...]) -> None:
    case = case_of("fig4", *SETTINGS.get(law, ()), *pressed_by)
    (stable_s, unstable_s, _), right_J = step_limit(case), swing_J(case, case.scene.time_step_s)

    def gain(step_s: float) -> float:
        with np.errstate(all="ignore"):
            energy = verlet_of(case.sampled_at_every(step_s)).total_energy_J
            return float(np.nan_to_num(energy - energy[0], nan=inf).max()) / right_J

    step_s = stable_s / 2
    while gain(step_s) <= limits.GAIN:
        step_s *= 1.01
    assert step_s / stable_s > 0.99
    assert unstable_s is None or (step_s < 1.02 * stable_s and gain(unstable_s) > limits.GAIN)


def test_the_energy_of_a_body_that_moves_as_prescribed_does_not_count() -> None:
    """Unless a force drives it: half a kilogram at the speed of the ramp."""
    heavy, slow = "chain.bead=[{from_wall=3, mass='0.5 kg'}]", RAMP + "displacement='-0.1 um'}"
    light, same = (limits.resolved_trial(case_of("fig4", *HELD, slow, *more)) for more in ((), (heavy,)))
    assert light.extremes.kinetic_J == pytest.approx(same.extremes.kinetic_J, rel=1e-9)


def test_a_light_bead_that_is_held_does_not_limit_the_step() -> None:
    """Unless a force drives it."""
    held, free = RAMP + "displacement='-0.1 um'}", RAMP + "force='-1 N'}"
    limits = [step_limit(case_of("fig4", *HELD, *each))[0] for each in ((held,), (held, *LIGHT), (free, *LIGHT))]
    assert limits[1] == pytest.approx(limits[0], rel=0.01)
    assert limits[2] < 0.01 * limits[0]


def test_near_a_resonance_the_limit_is_where_the_motion_grows_many_times() -> None:
    case = case_of("driven-steel", *RESONANT)
    (stable_s, unstable_s, _), right_J = step_limit(case), swing_J(case, case.scene.time_step_s)
    assert unstable_s is not None
    assert not why_unstable(case.sampled_at_every(0.9 * stable_s))
    assert "times the kinetic energy of the motion" in why_unstable(case.sampled_at_every(unstable_s))
    assert swing_J(case, 0.9 * stable_s) < 5 * right_J < swing_J(case, unstable_s)


@pytest.mark.parametrize(("step", "trials"), [((), 1), (COARSE, 2)])
def test_a_resolved_step_needs_no_second_trial(step: tuple[str, ...], trials: int) -> None:
    case = case_of("fig4", *step)
    limits.trial.cache_clear()
    limits.resolved_trial.cache_clear()
    assert not why_unstable(case)
    assert limits.trial.cache_info().misses == trials


def test_a_run_too_long_for_a_trial_is_tried_in_part(monkeypatch: pytest.MonkeyPatch) -> None:
    case = case_of("fig4", *TOO_LARGE, "striker.speed=2.01 m/s")
    monkeypatch.setattr(limits, "MAX_WORK", 240 * case.chain.bodies)  # resolved at 2.5 us
    with pytest.raises(InputError, match=r"at most 1.* s; .* \(tried until 0\.\d+ of 0\.8 ms\)"):
        refuse(case, "verlet")


def test_a_plan_says_which_trials_blow_up() -> None:
    stable, blows_up, *_ = (line for line in plan_report("fig4") if line.startswith("stability") or "next one" in line)
    assert stable.startswith("stability  stable up to 18.2")
    assert "µs, by trials; this run uses 0.547 % of that" in stable
    assert "the next one, at 18.3" in blows_up
    refused = " ".join(plan_report("fig4", TOO_LARGE))
    assert "a trial at this step gains " in refused
    assert "the run is refused" in refused


def test_a_step_that_blows_up_is_refused_and_unsafe_runs_it(tmp_path: Path) -> None:
    engines = ("--engine", "verlet", "--engine", "reference")
    words = ["run", "fig4", *words_of(TOO_LARGE), "--runs", str(tmp_path), *engines]
    refused = beads(*words)
    assert (refused.returncode, refused.stdout, len(refused.stderr.splitlines())) == (2, "", 1)
    assert "run.time_step: found 2e-05 s; allowed: at most 1.82" in refused.stderr
    assert not list(tmp_path.rglob("run.json"))
    step = refused.stderr.partition("at most ")[2].partition(" s;")[0]
    refuse(case_of("fig4", f"run.time_step={step} s", f"run.sample_interval={step} s"), "verlet")
    unsafe = beads(*words, "--unsafe")
    assert unsafe.returncode == 1
    assert "fig4: verlet failed: unstable at t = " in unsafe.stderr
    assert "reference failed" not in unsafe.stderr  # it has no time step


@pytest.mark.parametrize("engine", [VERLET, "lammps"])
def test_an_unstable_run_of_its_scheme_is_done(engine: str, tmp_path: Path) -> None:
    need(engine)
    step = ("run.time_step=10.9 us", "run.sample_interval=10.9 us")
    settings = words_of(("contact.damping_ratio=0.3", PRESSED, *step))
    words = ["run", "fig4", *settings, "--engine", engine, "--runs", str(tmp_path)]
    assert "times the kinetic energy" in beads(*words).stderr
    unsafe = beads(*words, "--unsafe")
    assert unsafe.returncode == 0, unsafe.stderr
    assert "failed" not in unsafe.stderr


def test_a_step_that_is_too_coarse_is_done_with_a_warning(shared_runs: Path) -> None:
    said = beads("run", "fig4", *words_of(COARSE), "--engine", "verlet", "--runs", shared_runs)
    assert said.returncode == 0
    assert "fig4: verlet warning: error of the force " in said.stderr
    lines = finished(case_of("fig4", *COARSE), "verlet", shared_runs).record.warnings or [""]
    assert {line.rpartition("; ")[2] for line in lines} == {"cause: the time step"}


def test_rounding_warns_by_its_own_name(tmp_path: Path) -> None:
    ended = finished(case_of("fig4", "chain.origin=1e6 km"), "liggghts", tmp_path)
    assert ended.record.warnings is not None
    assert "cause: rounding of heights" in ended.record.warnings[0]


@pytest.mark.long
@pytest.mark.parametrize("name", QUICK)
def test_at_the_edge(name: str, shared_runs: Path) -> None:
    for engine in codes():
        need(engine)
    for check in run_all([QUICK[name]], shared_runs):
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
        row = energy_of(case, trace)
        assert (abs(row["drift"]) > 3 * row["drift_error"]) == drifts


def test_heights_round_and_overlaps_do_not() -> None:
    """Forces at time 0 against the exact ones, of a chain at rest."""
    rest = ("striker=", "gravity=", "chain.sensors=[]", "chain.count=3", "chain.precompression=1e-4 N")
    short = ("run.duration=1 ns", "run.sample_interval=1 ns", "run.time_step=1 ns")
    errors = {}
    for height in ("0 m", "1 km"):
        case = case_of("fig4", *rest, *short, f"chain.origin={height}")
        for scheme in (verlet_of, verlet_in_heights):
            error = scheme(case).force_N[0] / case.chain.force_N - 1
            errors[scheme, height] = np.abs(error[1:]).max()
    assert max(errors[verlet_of, "0 m"], errors[verlet_of, "1 km"]) < 1e-15
    assert errors[verlet_in_heights, "1 km"] > 1e3 * errors[verlet_in_heights, "0 m"]


def test_forces_are_wrong_well_below_the_limit() -> None:
    case = case_of("fig4")
    (limit,) = measure_limits([MeasuredChain(SHIPPED, "fig4", case)], names=()).to_dict("records")
    assert 0.2 < limit["wrong_s"] / limit["measured_s"] < 0.4


@pytest.mark.long
def test_the_study_fails_for_a_limit_that_is_exceeded_or_far(tmp_path: Path, shared_runs: Path) -> None:
    """A coarse run is right but not accurate; tables of a longer study are removed."""
    chosen = [MeasuredChain(SHIPPED, "fig5", case_of("fig5")), *{sweep.group: sweep for sweep in sweeps()}.values()]
    edge = [*run_all([Extreme(name="coarse", scene="fig4", set=COARSE)], shared_runs)]
    coarse = {(check.engine, check.quantity.partition(":")[0]) for check in edge if check.verdict == NOT_ACCURATE}
    assert coarse == {(engine, "error") for engine in (VERLET, *installed(codes()))}
    limits = measure_limits(chosen, names=())
    case = case_of("fig4")
    energy = pd.DataFrame([{"scene": "fig4", "method": VERLET, **energy_of(case, verlet_of(case))}])
    for energies, names in ((energy, {"stability", "stability-energy"}), (None, {"stability"})):
        write_part("stability", study(limits, edge, energies), tmp_path)
        assert {path.stem for path in tmp_path.glob("*.csv")} == {*names, "stability-extremes"}
    for ratio, failed in ((1.0, 0), (0.99, len(limits)), (1.3, 1)):  # of the shipped scene alone
        checks = study(limits.assign(ratio=ratio), edge, None).checks
        assert [check.verdict for check in checks].count(FAIL) == failed
