"""Peaks, crossings, averages and the observables of waves on signals whose answers are known."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import brentq

from drivers.chain.case import Layout, SensorBead
from drivers.chain.trace import Trace
from postproc.read.observables import going_up, observe, train_envelope
from postproc.read.signals import Peak, integral, peaks, rising_crossing

WIDTH = 60.0


def pulse(time: np.ndarray | float, centre: float) -> np.ndarray:
    """Long-wave solitary wave cos^4 (the paper's Eq. 2)."""
    phase = np.clip((np.asarray(time) - centre) / WIDTH, -0.5, 0.5) * np.pi
    return np.asarray(np.cos(phase) ** 4)


def test_peaks_and_crossings_are_found_between_samples() -> None:
    time = np.arange(0, 200.0)
    signal = 3 * pulse(time, 100.37)
    (peak,) = peaks(time, signal)
    assert peak.time_s == pytest.approx(100.37, abs=1e-5)
    assert peak.value == pytest.approx(3, rel=1e-7)
    for level in (0.002, 0.04, 0.5):
        exact = 100.37 - WIDTH / np.pi * np.arccos(level**0.25)
        assert rising_crossing(time, signal, 3 * level, peak) == pytest.approx(exact, abs=2e-3)
    signal += 0.06 * pulse(time, 170)
    assert len(peaks(time, signal)) == 1, "a small bump is none"
    assert len(peaks(time, signal, prominence=0.01)) == 2
    assert peaks(time, np.ones(200)) == peaks(time, time) == []


def test_integral_of_a_quintic_is_exact() -> None:
    time = np.linspace(0, 2, 9)
    np.testing.assert_allclose(integral(time, time**5), time**6 / 6, atol=1e-14)


def test_a_train_has_an_envelope_if_its_three_maxima_are_positive_and_regular() -> None:
    """``exp(-t / tau)`` through maxima; a late third maximum is a reflection."""
    train = [Peak(1e-4 * place, float(np.exp(-place / 2)), 100 * place) for place in (1, 2, 3)]
    curve = train_envelope(train)
    assert curve is not None
    assert curve[0] == pytest.approx(-5e3)
    for other in ([], [Peak(3e-4, -0.1, 300)], [Peak(5e-4, 0.2, 500)]):
        assert train_envelope([*train[:2], *other]) is None


def test_observables_of_a_made_up_wave_have_their_known_values() -> None:
    """A pulse goes down beads of 1 mm at 1 mm per 10 us, is doubled at the wall and returns with 90 %."""
    time = np.arange(0, 300.0)
    down = [pulse(time, 150 - 10 * place) for place in range(12)]
    up = [0.9 * pulse(time, 150 + 10 * place) for place in range(12)]
    force = 5 + np.column_stack([2 * down[0], *(d + u for d, u in zip(down[1:], up[1:], strict=True))])
    layout = Layout((SensorBead(9, 8.5e-3, 1e-3), SensorBead(6, 5.5e-3, 1e-3)), wall=True, striker=False, load_N=5.0)
    force[:, 0] += pulse(time, 230)
    nothing = np.zeros_like(time)
    values = observe(layout, Trace(time * 1e-6, force, nothing, nothing, nothing), (0.04,))

    def incident(since_us: float) -> float:
        """Mean of two contacts, 5 us before and after its maximum."""
        return float(pulse(since_us, -5) + pulse(since_us, 5)) / 2

    height = incident(0.0)
    cut_us, front_us = (brentq(lambda t, level=level: incident(t) - level * height, -40, 0) for level in (0.04, 0.02))
    expected = {
        "wall_static_N": 5, "wall_peak_N": 7, "wall_peak_2_N": 6, "wall_amplitude_N": 2, "wall_arrival_s": 150e-6,
        "bead_9_arrival_s": 65e-6, "bead_6_arrival_s": 95e-6, "bead_9_amplitude_N": height, "bead_9_pulses": 1,
        "bead_9_reflected_arrival_s": 235e-6, "bead_9_reflected_amplitude_N": 0.9 * height,
        "speed_9_to_6_m_s": 100, "transmission_9_to_6": 1,
        "bead_6_duration_4pct_s": -2e-6 * cut_us, "bead_6_width_4pct_diameters": -0.2 * cut_us,
        "bead_9_front_arrival_s": (65 + front_us) * 1e-6,
    }  # fmt: skip
    for name, value in expected.items():
        assert values[name] == pytest.approx(value, rel=2e-4), name
    assert np.isnan([values["wall_peak_3_N"], values["wall_envelope_per_s"]]).all()


def waves(*heights: float, up: bool = False) -> Trace:
    """Waves of these heights, 100 us apart, that lose 2 % per contact; at 450 us the fourth of 12 contacts opens."""
    time = np.arange(0, 500.0)
    force = np.zeros((500, 12))
    for number, height in enumerate(heights):
        for place in range(12):
            force[:, place] += (
                height * 0.98 ** (11 - place) * pulse(time, 150 + 100 * number + 10 * place * (1 if up else -1))
            )
    force += 0.01
    force[450:, 3] = 0.0
    nothing = np.zeros_like(time)
    return Trace(time * 1e-6, force, nothing, nothing, nothing)


def test_a_train_is_distinguished_from_a_wave_from_below() -> None:
    """The second wave has 40 % of the first; a third of 4 % is no pulse; the contacts are open between them."""
    layout = Layout((SensorBead(9, 8.5e-3, 1e-3), SensorBead(6, 5.5e-3, 1e-3)), wall=False, striker=False, load_N=0.01)
    values = observe(layout, waves(1.0, 0.4, 0.04))
    height = values["bead_9_amplitude_N"]
    expected = {
        "bead_9_pulses": 2, "bead_9_second_amplitude_N": 0.4 * height, "bead_9_second_arrival_s": 165e-6,
        "bead_9_valley_N": 0, "contact_loss_s": 450e-6, "speed_9_to_6_m_s": 100,
        "transmission_9_to_6": 0.98,
    }  # fmt: skip
    for name, value in expected.items():
        assert values[name] == pytest.approx(value, rel=1e-3, abs=1e-9), name
    weak_first = observe(layout, waves(0.04, 1.0))
    assert weak_first["bead_9_amplitude_N"] == pytest.approx(0.04 * height, rel=1e-4)
    assert weak_first["bead_9_pulses"] == 2
    meeting = waves(1.0)
    for place in range(4, 12):
        meeting.force_N[:, place] += pulse(np.arange(0, 500.0), 20 + 10 * place)
    assert observe(layout, meeting)["bead_9_pulses"] == 2
    assert observe(replace(layout, wall=True), meeting)["bead_9_pulses"] == 1, "one goes up before the wall is reached"
    rising = observe(layout, waves(1.0, up=True))
    assert np.isnan([rising["speed_9_to_6_m_s"], rising["transmission_9_to_6"]]).all()
    assert np.isnan([rising["bead_9_second_amplitude_N"], rising["bead_9_valley_N"]]).all()


def test_a_trace_without_a_wave_has_no_peak() -> None:
    time: np.ndarray = np.arange(5) * 1e-6
    nothing = np.zeros(5)
    layout = Layout((SensorBead(1, 1e-3, 1e-3),), wall=True, striker=False, load_N=0.0)
    values = observe(layout, Trace(time, np.ones((5, 2)), nothing, nothing, nothing))
    assert np.isnan(values["wall_peak_N"])
    assert values["wall_static_N"] == 1


@pytest.mark.parametrize(("share", "up"), [(1.0, False), (1.0 + 1e-7, False), (1.001, True)])
def test_a_pulse_goes_up_if_the_bead_gains_momentum_beyond_rounding(share: float, up: bool) -> None:
    """Where two equal waves meet, the contacts below and above a bead are alike: a tie, which does not go up."""
    time = np.linspace(0.0, 1.0, 101)
    above_N = pulse(time, 0.5)
    wave = Peak(0.5, 1.0, 50)
    assert going_up(np.column_stack([share * above_N, above_N]), 1, [wave]) == [wave] * up
