"""Tests of viscoelastic contacts: the law on all engines, restitution, guards, stability limits, attenuation."""

import re
from dataclasses import replace
from itertools import pairwise
from math import sqrt
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from drivers.base.errors import InputError
from drivers.base.tolerances import tolerance
from drivers.chain.chain import Array, arrays_of
from drivers.chain.schemes import verlet_of
from drivers.engines import codes, engine_names, load_engine
from drivers.laws.viscoelastic import damping_ratio, restitution, restitution_with_attraction
from drivers.limits.energy_bounds import certainly_stable, late_damping
from drivers.limits.refusal import inability
from drivers.limits.stable_step import linear_limit, predicted_limit
from drivers.run.guard import energy_error, reason_to_fail
from postproc.read.observables import observe, of_kind
from validation.accuracy.budget import budget_of
from validation.accuracy.exact_motion import exact_motion_of
from validation.checks import PASS
from validation.reference.adaptive import MIN_TOLERANCE, integrate_adaptive
from validation.reference.hertz_chain import HertzChain
from validation.stability.measured_limits import MeasuredChain, measure_limits
from validation.tests.engine.test_results import bounced
from validation.tests.helpers.runs import assessed, finished, need
from validation.tests.helpers.scenes import case_of

ENGINES = engine_names()
DAMPED = "contact.restitution=0.9"
ONE_BODY = ("chain.sensors=[]", "gravity=", "run.duration=0.4 ms")
PAIR, ON_WALL = (*ONE_BODY, "chain.count=1", "wall="), (*ONE_BODY, "chain.count=0")
LONG_CHAIN = (
    "gravity=",
    "wall=",
    "chain.count=60",
    "chain.sensors=[{from_wall=40},{from_wall=30}]",
    "run.duration=2.5 ms",
)


@pytest.mark.parametrize("wanted", [1e-3, 0.05, 0.1353352832366127, 0.1354, 0.3, 0.5, 0.9, 0.99, 0.999999])
def test_the_formula_is_the_impact(wanted: float) -> None:
    ratio = damping_ratio(wanted)
    assert restitution(ratio) == pytest.approx(wanted, rel=1e-14)
    viscous = 2 * ratio * sqrt(1.5)

    def change(time: float, state: Array) -> list[float]:
        overlap = max(state[0], 0.0)
        return [state[1], -max(overlap**1.5 + viscous * overlap**0.25 * state[1], 0.0)]

    def force_ends(time: float, state: Array) -> float:
        return float(max(state[0], 0.0) ** 1.25 + viscous * state[1]) if time > 1e-3 else 1.0

    force_ends.terminal = True  # type: ignore[attr-defined]
    ended = solve_ivp(change, (0, 1000), [0, 1], "DOP853", rtol=1e-11, atol=1e-13, events=force_ends)
    assert -ended.y[1, -1] == pytest.approx(wanted, rel=1e-9)


def test_elastic_contacts_stay_as_they_are() -> None:
    assert damping_ratio(1.0) == 0.0
    assert restitution(0.0) == restitution_with_attraction(0.0) == 1.0


def test_restitution_errs_in_first_order_of_the_step() -> None:
    case = case_of("fig4", *PAIR, "contact.restitution=0.99")
    errors = [abs(bounced(each, verlet_of(each)) / 0.99 - 1) for each in (case.at(10), case.at(160))]
    assert errors[1] < errors[0] / 10


@pytest.mark.parametrize(
    ("scene", "given"), [("fig4", DAMPED), ("fig5", DAMPED), ("fig4", "contact.damping_ratio=0.3")]
)
@pytest.mark.long
def test_codes_have_the_law_of_the_in_repo_scheme(scene: str, given: str, shared_runs: Path) -> None:
    case = case_of(scene, given)
    runs = {engine: finished(case, engine, shared_runs) for engine in ENGINES}
    for run in runs.values():
        assert run.record.warnings == []
        assert run.trace.force_N.min() >= -1e-12 * run.trace.force_N.max()  # nothing pulls
        assert energy_error(case.chain, run.trace).max() < 1e-12
        assert observe(run.layout, run.trace)["energy_lost_J"] > 0.3 * run.trace.total_energy_J[0]
    checks = [check for engine, run in runs.items() for check in budget_of(case, engine, run.trace).checks]
    assert {check.verdict for check in checks} == {PASS}
    model = [check for check in checks if check.quantity == "model: force" and check.engine in codes()]
    stated = tolerance("model", "force").limit
    # the sphere that replaces a damped flat face has larger rounding errors
    assert len(model) == len(codes())
    assert all(each.value < (each.limit if each.engine == "liggghts" else stated) for each in model)
    assert all(each.limit == stated or (scene == "fig5" and each.limit < 20 * stated) for each in model)


def test_the_scheme_converges_in_first_order_to_the_reference() -> None:
    case = case_of("fig4", DAMPED)
    exact = exact_motion_of(case, finer=False).trace.force_N
    forces = [verlet_of(case.at(steps)).force_N for steps in (40, 80, 160)]
    errors = [np.abs(force - exact).max() / exact.max() for force in forces]
    for coarse, fine in pairwise(errors):
        assert 0.9 < np.log2(coarse / fine) < 1.1
    assert np.abs(2 * forces[2] - forces[1] - exact).max() / exact.max() < 2e-6  # extrapolated


@pytest.mark.parametrize(("scene", "given"), [("fig4", 0.5), ("fig5", 0.9), ("fig6b", 0.95), ("table1", 0.7)])
def test_the_reference_reaches_its_tolerance(scene: str, given: float) -> None:
    case = case_of(scene, f"contact.restitution={given}")
    chain, times = arrays_of(case.chain), case.sample_times_s
    other = np.sort(np.append(times, times[:-1] + 0.37 * times[1]))  # other steps on the way
    best = integrate_adaptive(chain, other).force_N[::2]
    for asked in (1e-4, 1e-6, 1e-8, 1e-10, MIN_TOLERANCE):
        error = np.abs(integrate_adaptive(chain, times, asked).force_N - best).max() / best.max()
        assert error < asked + MIN_TOLERANCE


def test_damping_below_zero_is_no_chain() -> None:
    one = np.ones(2)
    with pytest.raises(ValueError, match="damping: below zero"):
        HertzChain(one, one, one, one, one, -one)


def test_the_guard_lets_energy_fall_and_never_rise() -> None:
    case = case_of("fig4", DAMPED)
    trace = verlet_of(case)
    assert reason_to_fail(case, trace) is None
    put_in = trace.total_energy_J[0]
    rising = np.where(trace.time_s > 4e-4, 1e-3 * put_in, 0.0)  # still well below the energy at time 0
    assert "the energy grows by" in str(
        reason_to_fail(case, replace(trace, total_energy_J=trace.total_energy_J + rising))
    )
    falling = replace(trace, total_energy_J=trace.total_energy_J - rising)
    assert reason_to_fail(case, falling) is None
    elastic = case_of("fig4")
    words = str(reason_to_fail(elastic, falling))
    assert re.search("the energy is off by .* times the energy put in; at this time step at most .* is expected", words)


def test_too_much_damping_is_refused_by_liggghts_alone() -> None:
    for setting, found in (("contact.restitution=0.2", "found 0.2"), ("contact.damping_ratio=0.7", "found 0.7")):
        case = case_of("fig4", setting)
        assert f"{setting.partition('=')[0]}: {found}; allowed: on liggghts" in str(inability(case, "liggghts"))
        assert all(inability(case, engine) is None for engine in ENGINES if engine != "liggghts")
    assert inability(case_of("fig4", "contact.restitution=0.214"), "liggghts") is None


def test_pressed_beads_that_move_at_time_0_are_refused_by_yade_alone(tmp_path: Path) -> None:
    moving = "chain.bead=[{from_wall=3, velocity='0.1 m/s'}]"
    case = case_of("fig4", moving, DAMPED)
    assert "bead 3 pressed and moving" in str(inability(case, "yade"))
    assert inability(case_of("fig4", moving), "yade") is None
    need("liggghts")
    runs = {engine: finished(case, engine, tmp_path) for engine in ("verlet", "liggghts")}
    difference = np.abs(runs["verlet"].trace.force_N - runs["liggghts"].trace.force_N).max()
    assert difference < tolerance("model", "force").limit * runs["verlet"].trace.force_N.max()


@pytest.mark.parametrize("ratio", [0.0, 0.1, 1.0, 5.0])
def test_late_damping_lowers_the_limit_of_an_oscillator(ratio: float) -> None:
    chain = case_of("fig4", *ON_WALL, f"contact.damping_ratio={ratio}").chain
    spring = np.array([1e4])
    step = (sqrt(1 + ratio**2) - ratio) * 2 / sqrt(spring[0] / chain.mass_kg[0])
    assert linear_limit(chain, late_damping(chain, spring, np.zeros(1), step)) == pytest.approx(step, rel=1e-12)


@pytest.mark.parametrize("ratio", [0.03, 0.3, 0.6])
def test_limits_of_damped_chains(ratio: float) -> None:
    given = f"contact.damping_ratio={ratio}"
    pressed = case_of("fig4", "chain.precompression=20 N", given)  # stiff all the time: the limit is sharp
    subjects = [MeasuredChain("damped", "struck", case_of("fig5", given)), MeasuredChain("damped", "pressed", pressed)]
    names = codes() if ratio == 0.6 else ()
    limits = measure_limits(subjects, [name for name in names if load_engine(name).find()])
    for subject in subjects:
        own = [limit for limit in limits if limit.scene == subject.name]
        assert len({limit.measured_s for limit in own}) == 1
        # the striker's contact has its largest stiffness for a moment only
        assert 1 <= own[0].ratio <= (tolerance("stability", "measured").limit if subject.name == "pressed" else 1.5)
        duration = float(subject.case.sample_times_s[-1])
        limit = predicted_limit(subject.case.chain, duration)
        assert not certainly_stable(subject.case.chain, duration, 1.0001 * limit)


def test_an_accuracy_is_kept_by_a_code(shared_runs: Path) -> None:
    need("yade")
    case = case_of("fig4", DAMPED, "run.time_step=", "run.accuracy={force=1e-3, energy=1e-3, wall_peak=1e-3}")
    ended = assessed(case, "yade", shared_runs)
    assert ended.done
    assert ended.missed is None
    with pytest.raises(InputError, match="at least"):
        case_of("fig4", DAMPED, "run.time_step=", "run.accuracy=1e-12")


def test_waves_lose_the_same_share_from_bead_to_bead() -> None:
    places = range(50, 19, -5)
    sensors = f"chain.sensors=[{', '.join(f'{{from_wall={place}}}' for place in places)}]"
    found = {}
    for given, speed in ((0.9, 2.0), (0.9, 0.5), (0.5, 2.0), (1.0, 2.0)):
        case = case_of("table1", *LONG_CHAIN, sensors, f"contact.restitution={given}", f"striker.speed={speed} m/s")
        values = observe(case.layout, exact_motion_of(case, 1e-9, finer=False).trace)
        found[given, speed] = np.array([values[name] for name in of_kind(values, "transmission")])
        assert len(found[given, speed]) == len(places) - 1
        middle = found[given, speed][2:4]  # from bead 40 to bead 30
        assert np.ptp(middle) < 1e-4 or given == 0.5  # there the wave keeps spreading
    np.testing.assert_allclose(found[0.9, 2.0], found[0.9, 0.5], rtol=1e-6)
    assert np.all(np.diff(found[0.5, 2.0]) > 0)  # attenuation decreases
    assert found[1.0, 2.0][3] == pytest.approx(1, abs=1e-6)
    assert found[0.9, 2.0][3] == pytest.approx(0.97727, abs=1e-4)
