"""The long-wave theory, and the exact wave of the precompressed chain."""

import numpy as np
import pytest

from postproc.paper import theory
from validation.claims import equations
from validation.claims.paper_numbers import paper_numbers
from validation.reference import travelling_wave
from validation.reference.adaptive import integrate_adaptive
from validation.reference.hertz_chain import HertzChain
from validation.reference.travelling_wave import solve_at_amplitude, solve_at_speed, solve_travelling_wave

PTFE = theory.Particles(1.46e9, 0.46, 2171.0, 4.76e-3)
AMPLITUDES = (0.1, 1.0, 10.0, 1e3, 1e6)


@pytest.mark.parametrize("power", [1.5, 3.0, 2.0])
def test_the_periodic_solution_satisfies_the_long_wave_equation(power: float) -> None:
    assert theory.stationary_residual(power) < 1e-12


@pytest.mark.parametrize("power", [1.5, 3.0])
def test_a_wave_of_another_length_does_not(power: float) -> None:
    assert theory.stationary_residual(power, stretch=1.01) > 1e-3


@pytest.mark.parametrize("speed", [30.0, 150.0, 400.0])
def test_the_hump_is_that_solution_for_three_halves(speed: float) -> None:
    n, place = 1.5, np.linspace(-0.49, 0.49, 21) * theory.HUMP_LENGTH * PTFE.diameter_m
    amplitude = ((n + 1) / 2 * speed**2 / PTFE.speed_constant_m_s**2) ** (1 / (n - 1))
    angle = (n - 1) * np.sqrt(6 / (n * (n + 1))) * place / PTFE.diameter_m
    assert theory.solitary_strain(PTFE, speed, place) == pytest.approx(amplitude * np.cos(angle) ** (2 / (n - 1)))


def test_the_lattice_tends_to_the_long_wave_equation_with_the_fourth_power_of_the_spacing() -> None:
    assert equations.convergence_order() == pytest.approx(4, abs=0.05)


def test_without_its_dispersive_term_the_order_is_two() -> None:
    def error(beads: int) -> float:
        length, mean, swing = beads * PTFE.diameter_m, 0.01, 0.006
        q, place = 2 * np.pi / length, np.arange(beads + 1) * PTFE.diameter_m
        lattice = theory.lattice_acceleration(PTFE, -mean * place - swing / q * np.sin(q * place))
        strain, slope = mean + swing * np.cos(q * place[:-1]), -swing * q * np.sin(q * place[:-1])
        plain = -(PTFE.speed_constant_m_s**2) * 1.5 * strain**0.5 * slope
        return float(np.abs(lattice - plain).max() / np.abs(lattice).max())

    assert np.log(error(64) / error(256)) / np.log(4) == pytest.approx(2, abs=0.05)


def test_the_three_forms_of_equation_3_agree() -> None:
    strain = 0.013
    speed = theory.speed_from_strain(PTFE, strain)
    assert theory.speed_from_velocity(PTFE, speed * strain) == pytest.approx(speed, rel=1e-12)
    assert theory.speed_from_force(PTFE, PTFE.force_N(strain)) == pytest.approx(speed, rel=4e-4)  # 0.68 is rounded
    assert float(theory.solitary_strain(PTFE, speed, np.zeros(1))[0]) == pytest.approx(strain, rel=1e-12)


@pytest.mark.parametrize("amplitude", AMPLITUDES)
def test_the_precompressed_wave_is_a_fixed_point_and_finer_grids_change_nothing(
    amplitude: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    wave = solve_at_amplitude(1.5e7, 1.2e-4, 0.02, amplitude)
    assert wave.amplitude == pytest.approx(amplitude, rel=1e-10)
    monkeypatch.setattr(travelling_wave, "POINTS_PER_BEAD", 128)
    monkeypatch.setattr(travelling_wave, "POINTS_PER_BEAD_LONG", 32)
    finer = solve_at_speed(1.5e7, 1.2e-4, 0.02, wave.speed)
    assert finer.beta == pytest.approx(wave.beta, rel=1e-12)
    assert finer.amplitude == pytest.approx(wave.amplitude, rel=1e-10)


def test_its_limits_are_the_linear_chain_and_the_wave_without_a_static_force() -> None:
    free = solve_travelling_wave()
    weak, strong = (solve_at_amplitude(1e7, 1e-4, 1.0, amplitude) for amplitude in (0.02, 1e9))
    assert weak.beta == pytest.approx(1, abs=2e-3)
    assert weak.speed == pytest.approx(travelling_wave.sound_speed(1e7, 1e-4, 1.0), rel=2e-3)
    assert strong.beta == pytest.approx(free.contact_over_average, rel=1e-5)
    assert strong.speed == pytest.approx(free.speed_by_force * 1e7 ** (1 / 3) * 1e-4**-0.5 * 1e9 ** (1 / 6), rel=1e-5)


@pytest.mark.parametrize("amplitude", [pytest.param(1e-2, marks=pytest.mark.long), 1e20])
def test_amplitudes_at_both_ends_of_what_is_offered(amplitude: float) -> None:
    assert solve_at_amplitude(1e7, 1e-4, 1.0, amplitude).amplitude == pytest.approx(amplitude, rel=1e-9)


@pytest.mark.parametrize("amplitude", [0.0, -1.0, 9e-3, 2e20, float("nan")])
def test_amplitudes_beyond_are_refused(amplitude: float) -> None:
    with pytest.raises(ValueError, match="expected from"):
        solve_at_amplitude(1e7, 1e-4, 1.0, amplitude)


@pytest.mark.parametrize("speed", [0.5, 1.0, 1e5])
def test_a_speed_that_no_wave_has_is_refused(speed: float) -> None:
    sound = travelling_wave.sound_speed(1e7, 1e-4, 1.0)
    with pytest.raises(ValueError, match="above the sound speed"):
        solve_at_speed(1e7, 1e-4, 1.0, speed * sound)


def test_a_struck_chain_under_a_static_force_settles_to_the_wave() -> None:
    """Speed and beta of the pulse thirty contacts below the strike, against the fixed point."""
    beads, k, m, static = 60, 1.2e8, 1.226e-4, 0.05
    rest = (static / k) ** (2 / 3)
    velocity = np.zeros(beads)
    velocity[-1] = -1.0
    overlap, load = np.full(beads, rest), np.zeros(beads)
    load[-1] = -static
    chain = HertzChain(np.full(beads, m), np.full(beads, k), overlap, velocity, load)
    time = np.arange(0, 1.6e-3, 0.5e-6)
    force = integrate_adaptive(chain, time, 1e-11).force_N - static
    lower, upper = force[:, 25], force[:, 30]
    from postproc.read.signals import first_peak

    peak, above = first_peak(time, lower), first_peak(time, upper)
    mean = first_peak(time, (lower + force[:, 26]) / 2)
    assert peak is not None
    assert above is not None
    assert mean is not None
    wave = solve_at_amplitude(k, m, static, peak.value / static)
    assert 5 / (peak.time_s - above.time_s) == pytest.approx(wave.speed, rel=1e-6)
    assert peak.value / mean.value == pytest.approx(wave.beta, rel=1e-6)


def test_gauge_faces_sum_to_the_contact_forces() -> None:
    first, second = np.array([3.0, 1.0]), np.array([1.0, 2.0])
    third, fourth = theory.sensor_forces(first, second, 0.023 / 0.116)
    assert third + fourth == pytest.approx(first + second)
    assert (third - fourth) == pytest.approx((first - second) * paper_numbers()["eq5-share"], rel=1e-12)


def test_the_contact_at_5_N() -> None:
    radius_m, pressure_Pa = theory.hertz_contact(PTFE, 5.0)
    # the pressure of Hertz's half-ellipsoid sums to the force
    assert 2 / 3 * pressure_Pa * np.pi * radius_m**2 == pytest.approx(5.0, rel=1e-12)
    overlap = (5.0 / PTFE.stiffness) ** (2 / 3)
    assert radius_m**2 == pytest.approx(overlap * PTFE.diameter_m / 4, rel=1e-12)  # a^2 = R* overlap
