"""The long-wave theory, and the exact wave of the precompressed chain."""

import numpy as np
import pytest

from postproc.paper import theory
from postproc.read.signals import first_peak
from validation.claims import equations
from validation.claims.paper_numbers import paper_numbers
from validation.reference import travelling_wave
from validation.reference.adaptive import integrate_adaptive
from validation.reference.hertz_chain import HertzChain
from validation.reference.travelling_wave import solve_at_amplitude, solve_at_speed, solve_travelling_wave

PTFE = theory.Particles(1.46e9, 0.46, 2171.0, 4.76e-3)


@pytest.mark.parametrize("power", [1.5, 3.0])
def test_the_periodic_solution_satisfies_the_long_wave_equation_at_its_length_alone(power: float) -> None:
    assert theory.stationary_residual(power) < 1e-12
    assert theory.stationary_residual(power, stretch=1.01) > 1e-3


def test_the_lattice_tends_to_the_long_wave_equation_with_the_fourth_power_of_the_spacing() -> None:
    assert equations.convergence_order() == pytest.approx(4, abs=0.05)


def test_the_three_forms_of_equation_3_agree() -> None:
    strain = 0.013
    speed = theory.speed_from_strain(PTFE, strain)
    assert theory.speed_from_velocity(PTFE, speed * strain) == pytest.approx(speed, rel=1e-12)
    assert theory.speed_from_force(PTFE, PTFE.force_N(strain)) == pytest.approx(speed, rel=4e-4)  # 0.68 is rounded
    assert float(theory.solitary_strain(PTFE, speed, np.zeros(1))[0]) == pytest.approx(strain, rel=1e-12)


def test_limits_of_the_amplitude_are_the_linear_chain_and_the_wave_without_a_static_force() -> None:
    free, ends = solve_travelling_wave(), (travelling_wave.MIN_AMPLITUDE, travelling_wave.MAX_AMPLITUDE)
    weak, strong = (solve_at_amplitude(1e7, 1e-4, 1.0, amplitude) for amplitude in ends)
    assert (weak.amplitude, strong.amplitude) == pytest.approx(ends, rel=1e-9)
    assert weak.beta == pytest.approx(1, abs=1e-3)
    assert weak.speed == pytest.approx(travelling_wave.sound_speed(1e7, 1e-4, 1.0), rel=1e-3)
    assert strong.beta == pytest.approx(free.contact_over_average, rel=1e-9)
    unloaded = free.speed_by_force * 1e7 ** (1 / 3) * 1e-4**-0.5 * (ends[1] + 1) ** (1 / 6)
    assert strong.speed == pytest.approx(unloaded, rel=1e-9)


def test_amplitudes_and_speeds_that_no_wave_has_are_refused() -> None:
    for amplitude in (-1.0, 9e-3, 2e20, float("nan")):
        with pytest.raises(ValueError, match="expected from"):
            solve_at_amplitude(1e7, 1e-4, 1.0, amplitude)
    for mach in (1.0, 1e5):
        with pytest.raises(ValueError, match="above the sound speed"):
            solve_at_speed(1e7, 1e-4, 1.0, mach * travelling_wave.sound_speed(1e7, 1e-4, 1.0))


def test_a_struck_chain_under_a_static_force_settles_to_the_wave() -> None:
    """Speed and beta of the pulse thirty contacts below the strike, against the fixed point."""
    beads, k, m, static = 60, 1.2e8, 1.226e-4, 0.05
    velocity, load = np.zeros(beads), np.zeros(beads)
    velocity[-1], load[-1] = -1.0, -static
    overlap = np.full(beads, (static / k) ** (2 / 3))
    chain = HertzChain(np.full(beads, m), np.full(beads, k), overlap, velocity, load)
    time = np.arange(0, 1.6e-3, 0.5e-6)
    force = integrate_adaptive(chain, time, 1e-11).force_N - static
    peak, above, mean = (first_peak(time, signal) for signal in (force[:, 25], force[:, 30], force[:, 25:27].mean(1)))
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


def test_the_pressure_of_hertz_s_half_ellipsoid_sums_to_the_force() -> None:
    radius_m, pressure_Pa = theory.hertz_contact(PTFE, 5.0)
    assert 2 / 3 * pressure_Pa * np.pi * radius_m**2 == pytest.approx(5.0, rel=1e-12)
    assert radius_m**2 == pytest.approx((5.0 / PTFE.stiffness) ** (2 / 3) * PTFE.diameter_m / 4, rel=1e-12)
