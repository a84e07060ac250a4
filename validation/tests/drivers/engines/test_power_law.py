"""Tests of the power law of dissipation: reference, Verlet, codes, stability limits, plans."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from drivers.base.errors import InputError
from drivers.base.tolerances import tolerance
from drivers.chain.case import Case
from drivers.chain.chain import arrays_of
from drivers.chain.schemes import heights_and_reach, trace_of, verlet_of
from drivers.chain.trace import energy_error_J
from drivers.engines import codes
from drivers.laws.power import Power
from drivers.limits.refusal import inability
from postproc.read.observables import observe
from validation.accuracy.exact_motion import exact_motion_of
from validation.reference.adaptive import MIN_TOLERANCE, integrate_adaptive
from validation.reference.hertz_chain import HertzChain
from validation.reference.velocity_verlet import integrate_verlet, integrate_verlet_absolute
from validation.stability.measured_limits import RANDOM, MeasuredChain, measure_limits, random_case
from validation.tests.helpers import high_precision
from validation.tests.helpers.by_power import Array, forces_at
from validation.tests.helpers.runs import assessed, finished, need
from validation.tests.helpers.scenes import case_of

POWER = 'contact.dissipation="power"'
EXACT = 1e-10  # of the largest force
SAMPLES = 40
LASTS_S = {"fig4": 8e-4, "fig5": 1.2e-3, "fig6b": 6e-4}
LAWS = [(1.75, 1), (1.75, 10), (1, 3), (1.25, 3), (2, 3), (3, 3)]
RUNS = [*(("fig4", *law) for law in LAWS), ("fig6b", 1.75, 1)]
LONG_RUNS = [run for run in ((scene, *law) for scene in ("fig5", "fig6b") for law in LAWS) if run not in RUNS]
FITTED = ("contact.gamma=1.2515069300612442", "materials.ptfe.youngs_modulus=1020235658.0736736 Pa")


def by_power(scene: str, gamma: float, alpha: float | None = None, *settings: str) -> Case:
    """Case with the power law."""
    law = (POWER, f"contact.gamma={gamma}", *([] if alpha is None else [f"contact.alpha={alpha}"]))
    return case_of(scene, *law, *settings)


def random_chain(kind: str, seed: int, bodies: int) -> tuple[HertzChain, Array]:
    """Random struck chain with light beads, a flat striker or gaps, and any gamma; and sample times."""
    chain, times = high_precision.random_chain(kind, seed, bodies)
    draw = np.random.default_rng([seed, 99])
    alpha = float(draw.choice([1, 1.1, 1.25, 1.5, 1.75, 1.9, 2, 2.6, 3]))
    gamma = 10 ** draw.uniform(-3, 2.3)  # an elastic impact has some 10 N
    return replace(chain, damping=np.full(bodies, gamma), alpha=alpha), times


@pytest.mark.parametrize(
    ("scene", "alpha", "gamma"), [*RUNS, *(pytest.param(*run, marks=pytest.mark.long) for run in LONG_RUNS)]
)
def test_the_reference_is_exact_and_its_energy_never_grows(scene: str, alpha: float, gamma: float) -> None:
    case = by_power(scene, gamma, alpha)
    times = np.linspace(0, LASTS_S[scene], SAMPLES + 1)
    exact = forces_at(arrays_of(case.chain), times)
    for tolerance_asked in (MIN_TOLERANCE, 1e-9, 1e-6):
        motion = integrate_adaptive(arrays_of(case.chain), times, tolerance_asked)
        error = np.abs(motion.force_N - exact).max() / exact.max()
        assert error <= max(tolerance_asked, EXACT)
    fine = np.linspace(0, LASTS_S[scene], 2001)
    energy_J = trace_of(case, fine, integrate_adaptive(arrays_of(case.chain), fine)).total_energy_J
    assert energy_error_J(energy_J, damped=True, slips=False).max() <= 1e-14 * energy_J[0]
    assert energy_J[-1] < 0.9 * energy_J[0]


@pytest.mark.parametrize(
    ("kind", "seed"),
    [pytest.param(kind, seed, marks=[pytest.mark.long] * (seed > 2)) for kind in ("light", "flat", "gaps")
     for seed in range(12)],
)  # fmt: skip
def test_contacts_that_open_close_again_and_let_go_come_out_exact(kind: str, seed: int) -> None:
    chain, times = random_chain(kind, seed, 6)
    exact = forces_at(chain, times)
    error = np.abs(integrate_adaptive(chain, times).force_N - exact).max() / exact.max()
    assert error <= EXACT


@pytest.mark.parametrize("settings", [(), ("gravity=",), ("wall=",), ("gravity=", "wall=")])
@pytest.mark.parametrize(("alpha", "gamma"), [(1.75, 1e-9), (1.75, 1e-6), (1, 1e-6), (2, 1e-9), (1.3, 30), (1.75, 1e3)])
def test_motions_are_followed_whatever_gamma(settings: tuple[str, ...], alpha: float, gamma: float) -> None:
    chain = arrays_of(by_power("fig4", gamma, alpha, *settings).chain)
    times = np.linspace(0, 1.5e-3, 31)
    exact = integrate_adaptive(chain, times).force_N
    for asked in (1e-9, 1e-6):
        assert np.abs(integrate_adaptive(chain, times, asked).force_N - exact).max() <= asked * exact.max()
    if gamma < 1e-8:  # nearly elastic
        elastic = integrate_adaptive(arrays_of(case_of("fig4", *settings).chain), times).force_N
        assert 0 < np.abs(exact - elastic).max() < 1e-6 * elastic.max()


def test_a_chain_at_rest_stays_at_rest() -> None:
    chain = arrays_of(by_power("fig4", 3).chain)
    away = np.where(np.arange(chain.mass_kg.size) < chain.mass_kg.size - 1, chain.overlap_m, -1e-3)
    resting = replace(chain, velocity_m_s=0 * away, overlap_m=away)
    force_N = integrate_adaptive(resting, np.linspace(0, 5e-3, 51)).force_N
    np.testing.assert_allclose(force_N[:, :-1], force_N[:1, :-1] * np.ones((51, 1)), rtol=1e-9)


def test_bodies_that_just_touch_start_with_the_force_just_after() -> None:
    case = by_power("fig4", 3)
    chain, first_N = case.chain, 3 * 2**1.75
    assert chain.force_N[-1] == pytest.approx(first_N, rel=1e-15)
    for motion in (
        integrate_adaptive(arrays_of(chain), case.sample_times_s[:2]),
        integrate_verlet(arrays_of(chain), 1e-7, 10, 2),
        integrate_verlet_absolute(arrays_of(chain), *heights_and_reach(case), 1e-7, 10, 2),
    ):
        assert motion.force_N[0, -1] == pytest.approx(first_N, rel=1e-9)
        np.testing.assert_allclose(motion.force_N[0, :-1], chain.force_N[:-1], rtol=1e-6)
    parting = replace(arrays_of(chain), velocity_m_s=-chain.velocity_m_s)
    assert integrate_verlet(parting, 1e-7, 1, 2).force_N[0, -1] == 0


def test_without_gamma_contacts_are_elastic_bit_for_bit() -> None:
    plain, none = case_of("fig5"), by_power("fig5", 0)
    np.testing.assert_array_equal(verlet_of(none).force_N, verlet_of(plain).force_N)
    np.testing.assert_array_equal(exact_motion_of(none, 1e-9).trace.force_N, exact_motion_of(plain, 1e-9).trace.force_N)
    assert not none.chain.damped
    assert none.summary == plain.summary


@pytest.mark.parametrize("alpha", [1, 1.75, 3])
def test_velocity_verlet_is_of_first_order_by_a_power(alpha: float) -> None:
    chain = arrays_of(by_power("fig4", 3, alpha).chain)
    exact = integrate_adaptive(chain, np.linspace(0, 8e-4, 801)).force_N
    errors = [np.abs(integrate_verlet(chain, 1e-6 / n, n, 801).force_N - exact).max() for n in (50, 100, 200)]
    assert np.log2(errors[0] / errors[1]) == pytest.approx(1, abs=0.03)
    assert np.log2(errors[1] / errors[2]) == pytest.approx(1, abs=0.03)


def test_heights_differ_from_overlaps_by_rounding_by_a_power() -> None:
    case = by_power("fig5", 3)
    scene, (height, reach) = case.scene, heights_and_reach(case)
    step, every = scene.time_step_s, scene.steps_per_sample
    there = integrate_verlet_absolute(arrays_of(case.chain), height, reach, step, every, scene.samples).force_N
    assert 0 < np.abs(there - verlet_of(case).force_N).max() < 1e-9 * there.max()


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ((POWER,), "contact.gamma: missing key; give a number of 0 or more"),
        (("contact.gamma=3",), 'contact.gamma: found 3 with contact.dissipation = "viscoelastic"'),
        (("contact.alpha=2",), 'contact.alpha: found 2 with contact.dissipation = "viscoelastic"'),
        (
            (POWER, "contact.gamma=3", "contact.restitution=0.9"),
            "contact.restitution: found 0.9 with contact.dissipation",
        ),
        (
            (POWER, "contact.gamma=3", "contact.damping_ratio=0"),
            "contact.damping_ratio: found 0 with contact.dissipation",
        ),
        ((POWER, "contact.gamma=-1"), "contact.gamma: found -1; allowed: 0 or more"),
        ((POWER, "contact.gamma=3", "contact.alpha=0.9"), "contact.alpha: found 0.9; allowed: 1 or more"),
        ((POWER, "contact.gamma=3", "contact.alpha=3.1"), "contact.alpha: found 3.1; allowed: at most 3"),
        (
            ('contact.dissipation="linear"',),
            "contact.dissipation: found \"linear\"; allowed: 'kuwabara-kono', 'power' or 'viscoelastic'",
        ),
        ((POWER, "contact.gamma=3", "seed=1", "chain.lateral_offset=30 um"), "beads that move sideways"),
    ],
)
def test_wrong_keys_are_named_in_one_line(settings: tuple[str, ...], message: str) -> None:
    with pytest.raises(InputError) as error:
        case_of("fig4", *settings)
    assert message in str(error.value)
    assert "\n" not in str(error.value)


def test_codes_that_have_no_such_law_refuse_it_by_name() -> None:
    refused = {name: message for name in codes() if (message := inability(by_power("fig4", 3), name))}
    assert set(refused) == {"lammps", "liggghts"}
    assert {name for name in codes() if inability(by_power("fig4", 3, 1), name) is None} == {"lammps", "yade"}
    assert 'on lammps 1, or contact.dissipation = "viscoelastic"' in str(refused["lammps"])
    assert "on liggghts another law, since it has no such damping" in str(refused["liggghts"])
    assert not any(inability(by_power("fig4", 0), name) for name in codes())


@pytest.mark.parametrize(("engine", "alpha"), [("lammps", 1), ("yade", 1.75)])
@pytest.mark.parametrize("scene", ["fig4", "fig5", "fig6b"])
def test_codes_agree_with_their_scheme(scene: str, engine: str, alpha: float, tmp_path: Path) -> None:
    need(engine)
    case = by_power(scene, 3, alpha)
    run = finished(case, engine, tmp_path)
    assert run.record.warnings == []
    difference = np.abs(run.trace.force_N - verlet_of(case).force_N).max()
    assert difference < tolerance("model", "force").limit * run.trace.force_N.max()


def random_limits(numbers: range) -> list[float]:
    """Measured over predicted stability limits of random scenes with the power law; NaN if no step blows up."""
    subjects = []
    for number in numbers:
        case = random_case(number, accuracy=0.1)
        draw = np.random.default_rng([number, 77])
        alpha, chain = float(draw.choice([1, 1.1, 1.25, 1.5, 1.75, 2, 2.5, 3])), case.chain
        speed = np.abs(chain.velocity_m_s).max()
        impact_N = (1.25 * chain.reduced_mass_kg.min() * speed**2) ** 0.6 * chain.stiffness.max() ** 0.4
        gamma = float(impact_N * 10 ** draw.uniform(-3, 0.3) / speed**alpha)
        subjects.append(
            MeasuredChain(RANDOM, case.scene.name, replace(case, chain=replace(chain, law=Power(gamma, alpha))))
        )
    return [limit.ratio for limit in measure_limits(subjects, ())]


MORE = [pytest.param(range(first, first + 50), marks=pytest.mark.long) for first in (10, 60, 110, 160)]


@pytest.mark.parametrize("numbers", [range(10), *MORE])
def test_no_random_scene_blows_up_below_the_limit_predicted(numbers: range) -> None:
    ratios = np.array(random_limits(numbers))
    print(f"{np.isfinite(ratios).mean():.2f} of {ratios.size} blow up, from {np.nanmin(ratios):.4f} of the limit on")
    assert np.isfinite(ratios).mean() > 0.5  # strongly damped scenes are stable at all steps tried
    assert np.nanmin(ratios) >= 1
    assert np.nanquantile(ratios, 0.2) <= 1.25


def test_an_accuracy_is_kept_by_a_power(shared_runs: Path) -> None:
    case = by_power("fig4", 3, None, "run.time_step=", "run.accuracy={force=1e-3, energy=1e-3, wall_peak=1e-3}")
    ended = assessed(case, "verlet", shared_runs)
    assert ended.done
    assert ended.missed is None


def test_a_gamma_that_changes_too_little_is_left_out() -> None:
    asked = ("run.time_step=", "run.accuracy=1e-3")
    for gamma, modelled in ((1e-6, False), (1.0, True)):
        case = by_power("fig4", gamma, None, *asked)
        assert case.models("damping") == modelled
        assert case.chain.damped == modelled
        if not modelled:
            assert "left out" in next(each.reason for each in case.elements if each.name == "damping")


def test_a_run_keeps_its_law(tmp_path: Path) -> None:
    case = by_power("fig4", 3)
    run = finished(case, "verlet", tmp_path)
    assert run.record.warnings == []
    assert run.layout.damped
    np.testing.assert_array_equal(run.trace.force_N, verlet_of(case).force_N)
    exact = finished(case, "reference", tmp_path)
    assert np.abs(exact.trace.force_N - exact_motion_of(case, finer=False).trace.force_N).max() < 1e-10


def test_force_and_speed_of_fig_4_take_a_modulus_and_a_gamma() -> None:
    """Fitted to 2 N and 152 m/s; the other numbers are from an independent Runge-Kutta method of order 4."""
    fig4, fig5 = (case_of(scene, POWER, *FITTED) for scene in ("fig4", "fig5"))
    seen = observe(fig4.layout, exact_motion_of(fig4, 1e-9).trace)
    assert seen["bead_9_amplitude_N"] == pytest.approx(2.0, rel=1e-9)
    assert seen["speed_9_to_5_m_s"] == pytest.approx(152, rel=1e-9)
    assert seen["bead_5_width_4pct_diameters"] == pytest.approx(4.93, abs=0.005)
    envelope = observe(fig5.layout, exact_motion_of(fig5, 1e-9).trace)["wall_envelope_per_s"]
    assert envelope == pytest.approx(-0.0065e6, abs=0.00005e6)
