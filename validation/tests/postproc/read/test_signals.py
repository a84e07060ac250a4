"""Peaks, crossings, widths and averages on signals whose answers are known."""

import numpy as np
import pytest

from drivers.chain.case import Layout, SensorBead
from drivers.chain.trace import Trace
from postproc.read.observables import observe
from postproc.read.sensors import sensor_average
from postproc.read.signals import integral, peaks, rising_crossing


def pulse(time: np.ndarray, centre: float, width: float) -> np.ndarray:
    """Long-wave solitary wave cos^4 with this full width (the paper's Eq. 2)."""
    phase = np.clip((time - centre) / width, -0.5, 0.5) * np.pi
    return np.cos(phase) ** 4


def test_a_peak_between_samples() -> None:
    time = np.arange(0, 200.0)
    (found,) = peaks(time, 3 * pulse(time, 100.37, 60))
    assert found.time_s == pytest.approx(100.37, abs=1e-5)
    assert found.value == pytest.approx(3, rel=1e-7)


def test_small_bumps_are_no_peaks() -> None:
    time = np.arange(0, 300.0)
    signal = pulse(time, 100, 60) + 0.02 * pulse(time, 200, 60)
    assert len(peaks(time, signal)) == 1
    assert len(peaks(time, signal, prominence=0.01)) == 2


@pytest.mark.parametrize("level", [0.002, 0.04, 0.5])
def test_a_crossing_between_samples(level: float) -> None:
    time = np.arange(0, 200.0)
    signal = pulse(time, 100.37, 60)
    exact = 100.37 - 60 / np.pi * np.arccos(level**0.25)
    assert rising_crossing(time, signal, level, peaks(time, signal)[0]) == pytest.approx(exact, abs=2e-3)


def test_no_peak_no_crossing() -> None:
    time = np.arange(0, 10.0)
    assert peaks(time, np.ones(10)) == []
    assert peaks(time, time) == []


def test_integral_of_a_quintic_is_exact() -> None:
    time = np.linspace(0, 2, 9)
    np.testing.assert_allclose(integral(time, time**5), time**6 / 6, atol=1e-14)


def test_a_sensor_shows_the_mean_of_its_contacts() -> None:
    force = np.array([[1.0, 3.0, 5.0]])
    assert sensor_average(force, 1) == [2]
    assert sensor_average(force, 2) == [4]
    assert sensor_average(force, 3) == [2.5], "there is no contact above the top bead"


def test_speed_width_and_reflection_of_a_made_up_wave() -> None:
    """A cos^4 pulse travels down four beads of 1 mm at 100 m/s, is doubled at the wall and returns."""
    time = np.arange(0, 300e-6, 1e-6)
    place = np.arange(4) * 1e-3
    down = [pulse(time, 150e-6 - z / 100, 60e-6) for z in place]
    up = [0.9 * pulse(time, 150e-6 + z / 100, 60e-6) for z in place]
    force = np.column_stack([2 * down[0], *(d + u for d, u in zip(down[1:], up[1:], strict=True))])
    nothing = np.zeros_like(time)
    trace = Trace(time, force, nothing, nothing, nothing)
    layout = Layout((SensorBead(3, 2.5e-3, 1e-3), SensorBead(2, 1.5e-3, 1e-3)), wall=True, striker=False, load_N=0.0)
    values = observe(layout, trace)
    assert values["wall_peak_N"] == pytest.approx(2, rel=1e-6)
    assert values["wall_arrival_s"] == pytest.approx(150e-6, abs=1e-11)


def test_a_trace_without_a_wave_has_no_peak() -> None:
    time: np.ndarray = np.arange(5) * 1e-6
    nothing = np.zeros(5)
    layout = Layout((SensorBead(1, 1e-3, 1e-3),), wall=True, striker=False, load_N=0.0)
    values = observe(layout, Trace(time, np.ones((5, 2)), nothing, nothing, nothing))
    assert np.isnan(values["wall_peak_N"])
    assert values["wall_static_N"] == 1
