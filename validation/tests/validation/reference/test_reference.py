"""In-repo integrators against closed formulas, conservation laws and each other."""

import time
from typing import Any

import numpy as np
import pytest

from drivers.chain.chain import arrays_of
from postproc.read.signals import peaks
from validation.reference import travelling_wave
from validation.reference.adaptive import MIN_TOLERANCE, integrate_adaptive
from validation.reference.hertz_chain import HertzChain, Motion
from validation.reference.symplectic import integrate_symplectic
from validation.reference.travelling_wave import solve_travelling_wave
from validation.reference.velocity_verlet import integrate_verlet, integrate_verlet_absolute
from validation.tests.helpers import high_precision
from validation.tests.helpers.scenes import case_of


def chain_of(count: int, speed: float = 1.0, load: float = 0.0) -> HertzChain:
    """Equal bodies; the top body moves down with ``speed``."""
    one = np.ones(count)
    velocity = np.zeros(count)
    velocity[-1] = -speed
    return HertzChain(1e-4 * one, 1e6 * one, 0 * one, velocity, load * one)


def test_one_impact_is_hertz_theory() -> None:
    """Peak force (5/4 m v^2)^(3/5) k^(2/5) and duration 2.943275 (m^2 / (k^2 v))^(1/5) (5/4)^(2/5)."""
    mass, stiffness, speed = 1e-4, 1e6, 1.0
    chain = chain_of(1, speed)
    duration = 2.9432751 * (1.25 * mass / stiffness) ** 0.4 * speed**-0.2
    time: np.ndarray = np.linspace(0, duration, 1001, dtype=np.float64)
    motion = integrate_adaptive(chain, time)
    assert motion.force_N.max() == pytest.approx((1.25 * mass * speed**2) ** 0.6 * stiffness**0.4, rel=1e-10)
    assert motion.velocity_m_s[-1, 0] == pytest.approx(speed, rel=1e-9)
    assert motion.force_N[-1, 0] == pytest.approx(0, abs=1e-6)


def test_verlet_is_of_second_order() -> None:
    chain = chain_of(6)
    exact = integrate_adaptive(chain, np.linspace(0, 4e-4, 101))
    errors = [
        np.abs(integrate_verlet(chain, 4e-6 / every, every, 101).force_N - exact.force_N).max()
        for every in (16, 32, 64)
    ]
    assert errors[0] / errors[1] == pytest.approx(4, rel=0.05)
    assert errors[1] / errors[2] == pytest.approx(4, rel=0.05)


def energy(chain: HertzChain, motion: Motion) -> np.ndarray:
    overlap = np.maximum(motion.force_N / chain.stiffness, 0) ** (2 / 3)
    kinetic = 0.5 * motion.velocity_m_s**2 @ chain.mass_kg
    total: np.ndarray = kinetic + 0.4 * (motion.force_N * overlap).sum(axis=1) - motion.displacement_m @ chain.load_N
    return total


def test_the_reference_conserves_energy() -> None:
    chain = chain_of(20, load=-1e-3)
    total = energy(chain, integrate_adaptive(chain, np.linspace(0, 1e-3, 200)))
    np.testing.assert_allclose(total, total[0], rtol=1e-9)


def test_the_reference_does_not_depend_on_its_samples() -> None:
    chain = chain_of(10)
    coarse = integrate_adaptive(chain, np.linspace(0, 4e-4, 5))
    fine = integrate_adaptive(chain, np.linspace(0, 4e-4, 401))
    np.testing.assert_allclose(coarse.force_N, fine.force_N[::100], atol=1e-10 * fine.force_N.max())


def test_heights_differ_from_overlaps_by_rounding() -> None:
    chain = chain_of(5)
    height = 1e-3 * np.arange(1.0, 6.0)
    reach = np.full(5, 1e-3)
    far_reach = reach + np.array([100.0, 0, 0, 0, 0])
    exact = integrate_verlet(chain, 1e-7, 10, 300).force_N
    near = integrate_verlet_absolute(chain, height, reach, 1e-7, 10, 300).force_N
    far = integrate_verlet_absolute(chain, height + 100, far_reach, 1e-7, 10, 300).force_N
    assert 0 < np.abs(near - exact).max() < 1e-9
    assert 1e-9 < np.abs(far - exact).max() < 1e-3


@pytest.mark.parametrize(
    ("change", "named"),
    [
        ({"mass_kg": [1.0]}, "stiffness"),
        ({"mass_kg": [1.0, 0.0]}, "mass_kg"),
        ({"stiffness": [1.0, -1.0]}, "stiffness"),
        ({"load_N": [np.nan, 0.0]}, "load_N"),
        ({"velocity_m_s": [[1.0, 0.0]]}, "velocity_m_s"),
        ({"alpha": 0.5}, "alpha"),
        ({"alpha": 1.75, "damping": [1.0, 0.0]}, "damping"),
    ],
)
def test_wrong_arrays_are_named(change: dict[str, Any], named: str) -> None:
    names = ("mass_kg", "stiffness", "overlap_m", "velocity_m_s", "load_N")
    with pytest.raises(ValueError, match=named):
        HertzChain(**{name: np.array([1.0, 1.0]) for name in names} | change)


LONG_CASES = ("fig4", "fig5", "fig6b", "fig6d")  # slow in high precision
EXACT = [pytest.param(name, marks=pytest.mark.long if name in LONG_CASES else ()) for name in high_precision.CASES]


@pytest.fixture(scope="module", params=EXACT)
def exact_case(request: pytest.FixtureRequest) -> tuple[HertzChain, np.ndarray, np.ndarray]:
    """Chain, times and contact forces, correct to at least 20 digits."""
    chain, times = high_precision.chain_of(request.param), high_precision.times_of(request.param)
    return arrays_of(chain), times, np.array(list(high_precision.forces_at(chain, times)))


def test_the_true_error_matches_the_requested_tolerance(exact_case: tuple[HertzChain, np.ndarray, np.ndarray]) -> None:
    """At most the tolerance, and at least a thousandth of it, so that no time is wasted."""
    chain, times, exact = exact_case
    for exponent in range(4, 13):
        tolerance = 10.0**-exponent
        error = np.abs(integrate_adaptive(chain, times, tolerance).force_N - exact).max() / exact.max()
        assert 1e-3 * tolerance < error <= tolerance


KINDS = {"light": 6, "flat": 6, "gaps": 3}  # kind of random chain: number of bodies


@pytest.mark.parametrize(
    ("kind", "seed"),
    [pytest.param(kind, seed, marks=[pytest.mark.long] * (seed > 1)) for kind in KINDS for seed in range(12)],
)
def test_random_chains_with_light_beads_flat_strikers_and_damped_gaps_meet_the_tolerance(kind: str, seed: int) -> None:
    chain, times = high_precision.random_chain(kind, seed, KINDS[kind])
    exact = np.array(list(high_precision.forces_at(chain, times)))
    for tolerance in (1e-6, 1e-9, MIN_TOLERANCE):
        error = np.abs(integrate_adaptive(chain, times, tolerance).force_N - exact).max() / exact.max()
        assert error <= tolerance


def test_steps_do_not_resolve_the_rounding_of_forces() -> None:
    """A squeezed bead with a billionth of its neighbours' mass would otherwise need a hundred times more steps."""
    settings = ("gravity=", "striker.speed=2 mm/s", "chain.bead=[{from_wall=20, diameter='4.76 um'}]")
    chain, times, spent_s = arrays_of(case_of("fig4", *settings).chain), np.linspace(0, 3e-4, 151), []
    for tolerance in (1e-10, 1e-10, MIN_TOLERANCE):  # the first compiles
        began = time.process_time()
        integrate_adaptive(chain, times, tolerance)
        spent_s.append(time.process_time() - began)
    assert spent_s[2] < 10 * spent_s[1]


def test_energy_and_momentum_of_fig4_before_the_wall() -> None:
    """Energy and momentum balance including gravity; the paper: 1e-10 and 1e-14."""
    chain = high_precision.chain_of("fig4")
    arrays = arrays_of(chain)
    times = np.linspace(0, 3e-4, 31)
    motion = integrate_adaptive(arrays, times)
    total = energy(arrays, motion)
    assert np.abs(total / total[0] - 1).max() < 1e-13
    momentum = motion.velocity_m_s @ chain.mass_kg
    impulse = (chain.force_N[0] + chain.load_N.sum()) * times  # the wall still carries the weight of the resting beads
    assert np.abs(momentum - momentum[0] - impulse).max() < 1e-14 * abs(momentum[0])


def test_the_travelling_wave_has_the_known_constants() -> None:
    wave = solve_travelling_wave()
    assert wave.residual < 1e-15
    assert wave.speed_by_force == pytest.approx(0.905516, abs=5e-7)
    assert wave.speed_by_velocity == pytest.approx(0.907470, abs=5e-7)
    assert wave.force_by_velocity == pytest.approx(1.013019, abs=5e-7)
    assert wave.momentum_by_velocity == pytest.approx(1.669971, abs=5e-7)
    assert wave.energy_by_velocity == pytest.approx(1.069323, abs=5e-7)
    assert wave.kinetic_share == pytest.approx(5 / 9, abs=1e-12)
    assert [round(wave.width(x, averaged=True), 3) for x in (0.002, 0.04, 0.5)] == [4.989, 3.839, 2.069]
    assert [round(wave.width(x, averaged=False), 3) for x in (0.002, 0.04, 0.5)] == [4.098, 2.998, 1.412]


def test_the_wave_does_not_depend_on_its_grid(monkeypatch: pytest.MonkeyPatch) -> None:
    fine = solve_travelling_wave()
    monkeypatch.setattr(travelling_wave, "POINTS", 1024)
    coarse = solve_travelling_wave()
    assert coarse.speed_by_force == pytest.approx(fine.speed_by_force, rel=1e-14)
    assert coarse.force_by_velocity == pytest.approx(fine.force_by_velocity, rel=1e-14)


def test_a_chain_of_200_beads_carries_the_exact_wave() -> None:
    """Struck by an equal bead, the leading wave converges to the exact solitary wave."""
    wave, count = solve_travelling_wave(), 200
    one = np.ones(count)
    velocity = np.append(np.zeros(count - 1), -1.0)
    times = np.arange(0, 260, 0.05)
    motion = integrate_adaptive(HertzChain(one, one, 0 * one, velocity, 0 * one), times)
    arrivals = {j: peaks(times, motion.force_N[:, j - 1])[0] for j in (60, 20)}
    speed = 40 / (arrivals[20].time_s - arrivals[60].time_s)
    fastest = peaks(times, -motion.velocity_m_s[:, 19])[0].value
    assert speed / arrivals[20].value ** (1 / 6) == pytest.approx(wave.speed_by_force, rel=1e-8)
    assert speed / fastest**0.2 == pytest.approx(wave.speed_by_velocity, rel=1e-8)
    assert arrivals[20].value / fastest**1.2 == pytest.approx(wave.force_by_velocity, rel=1e-8)
    assert fastest == pytest.approx(0.68163, abs=1e-5)


def test_order_4_pays_while_contacts_stay_closed() -> None:
    """On a precompressed chain the symplectic method has order 4."""
    count, load = 8, 1.0
    one, overlap = np.ones(count), (load / 1e6) ** (2 / 3)
    velocity = np.append(np.zeros(count - 1), -0.02)
    loads = np.append(np.zeros(count - 1), -load)
    chain = HertzChain(1e-4 * one, 1e6 * one, overlap * one, velocity, loads)
    exact = integrate_adaptive(chain, np.linspace(0, 4e-4, 41)).force_N
    errors = [
        np.abs(integrate_symplectic(chain, 1e-5 / every, every, 41).force_N - exact).max() for every in (4, 8, 16)
    ]
    assert np.log2(errors[0] / errors[1]) == pytest.approx(4, abs=0.2)
    assert np.log2(errors[1] / errors[2]) == pytest.approx(4, abs=0.2)


def test_order_4_pays_less_where_contacts_switch() -> None:
    """At opening contacts Hertz's force is not smooth: more accurate than Verlet, but below order 4."""
    chain = chain_of(6)
    exact = integrate_adaptive(chain, np.linspace(0, 4e-4, 101)).force_N
    steps = (16, 32, 64, 128)
    errors = [np.abs(integrate_symplectic(chain, 4e-6 / n, n, 101).force_N - exact).max() for n in steps]
    order = np.log2(errors[0] / errors[-1]) / 3
    assert 2 < order < 3.3
    assert errors[-1] < 0.1 * np.abs(integrate_verlet(chain, 4e-6 / 128, 128, 101).force_N - exact).max()


@pytest.mark.parametrize("tolerance", [1e-13, 0.0, -1.0, 1.0, float("nan")])
def test_unattainable_tolerances_are_refused(tolerance: float) -> None:
    with pytest.raises(ValueError, match="1e-12"):
        integrate_adaptive(chain_of(2), np.array([0.0, 1e-6]), tolerance)


def test_wrong_times_are_named() -> None:
    with pytest.raises(ValueError, match="time_s"):
        integrate_adaptive(chain_of(2), np.array([0.0, 2.0, 1.0]))
    with pytest.raises(ValueError, match="time_step_s"):
        integrate_verlet(chain_of(2), 0.0, 1, 10)
