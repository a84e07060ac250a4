"""The long-wave theory, and the exact wave of the precompressed chain."""

import numpy as np
import pytest

from postproc.paper import strikes
from postproc.read.signals import first_peak
from validation.claims import equations
from validation.reference import travelling_wave
from validation.reference.adaptive import integrate_adaptive
from validation.reference.hertz_chain import HertzChain
from validation.reference.travelling_wave import solve_at_amplitude, solve_at_speed, solve_travelling_wave

PTFE = strikes.Particles(1.46e9, 0.46, 2171.0, 4.76e-3)


def test_the_three_forms_of_equation_3_agree() -> None:
    strain = 0.013
    speed = equations.speed_from_strain(PTFE, strain)
    assert equations.speed_from_velocity(PTFE, speed * strain) == pytest.approx(speed, rel=1e-12)
    assert strikes.speed_from_force(PTFE, PTFE.force_N(strain)) == pytest.approx(speed, rel=4e-4)  # 0.68 is rounded
    assert equations.peak_strain(PTFE, speed) == pytest.approx(strain, rel=1e-12)


def test_weak_waves_are_solitons_at_the_sound_speed_and_strong_ones_feel_no_static_force() -> None:
    free, strong = solve_travelling_wave(), solve_at_amplitude(1e7, 1e-4, 1.0, travelling_wave.MAX_AMPLITUDE)
    assert strong.amplitude == pytest.approx(travelling_wave.MAX_AMPLITUDE, rel=1e-9)
    assert strong.beta == pytest.approx(free.contact_over_average, rel=1e-9)
    unloaded = free.speed_by_force * 1e7 ** (1 / 3) * 1e-4**-0.5 * travelling_wave.MAX_AMPLITUDE ** (1 / 6)
    assert strong.speed == pytest.approx(unloaded, rel=1e-9)
    weak, sound = solve_at_amplitude(1e7, 1e-4, 1.0, 0.05), travelling_wave.sound_speed(1e7, 1e-4, 1.0)
    assert weak.beta == pytest.approx(1, abs=5e-3)
    assert weak.speed / sound - 1 == pytest.approx((1.05 ** (2 / 3) - 1) / 12, rel=0.01)  # Korteweg and de Vries


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
    wave = solve_at_amplitude(k, m, static, peak.value / static)
    assert 5 / (peak.time_s - above.time_s) == pytest.approx(wave.speed, rel=1e-6)
    assert peak.value / mean.value == pytest.approx(wave.beta, rel=1e-6)
