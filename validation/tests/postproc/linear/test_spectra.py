"""Tests of spectra, transfer functions and harmonics, on made-up signals and on a driven chain."""

import json
from math import pi
from pathlib import Path

import numpy as np
import pytest

from drivers.chain.chain import Array
from postproc.linear.spectra import harmonics_of, spectrum_of, transfer_of
from validation.tests.helpers.commands import beads

TIME_S: Array = np.arange(2000.0) * 1e-6


@pytest.mark.parametrize("window", ["hann", "boxcar", "blackmanharris", "flattop"])
def test_a_sine_shows_its_amplitude(window: str) -> None:
    amplitude = np.abs(spectrum_of(5 + 0.7 * np.sin(2 * pi * 10e3 * TIME_S), window))
    frequency = np.fft.rfftfreq(len(TIME_S), 1e-6)
    place = int(np.argmax(amplitude))
    assert frequency[place] == pytest.approx(10e3, rel=1e-12)
    assert amplitude[place] == pytest.approx(0.7, rel=1e-6)
    assert frequency[1] == pytest.approx(500.0, rel=1e-9)


def test_harmonics_are_exact_over_whole_periods() -> None:
    signal = np.asarray(
        3.0 + sum(a * np.sin(2 * pi * n * 7.3e3 * TIME_S + p) for n, a, p in ((1, 2.0, 0.4), (2, 0.1, -1.1)))
    )
    parts = harmonics_of(TIME_S, signal, 7.3e3)
    assert parts["amplitude"][:3].to_list() == pytest.approx([2.0, 0.1, 0.0], rel=1e-10, abs=1e-12)
    assert parts["phase_rad"][:2].to_list() == pytest.approx([0.4, -1.1], rel=1e-10)
    assert parts["change_share"][:2].max() < 1e-10
    growing = harmonics_of(TIME_S, signal * (1 + 0.1 * (TIME_S > 1e-3)), 7.3e3)
    assert growing["change_share"][0] == pytest.approx(0.1 / 1.1, rel=0.05)
    with pytest.raises(ValueError, match="shorter than a period"):
        harmonics_of(TIME_S, signal, 400.0)
    with pytest.raises(ValueError, match="samples a period"):
        harmonics_of(TIME_S, signal, 400e3)


def test_a_delay_is_a_phase() -> None:
    pulse = np.exp(-(((TIME_S - 6e-4) / 5e-5) ** 2))
    late = 0.5 * np.exp(-(((TIME_S - 6.2e-4) / 5e-5) ** 2))
    transfer = transfer_of(spectrum_of(pulse, "boxcar"), spectrum_of(late, "boxcar"))
    frequency = np.fft.rfftfreq(len(TIME_S), 1e-6)
    band = (frequency > 0) & (frequency < 5e3)
    np.testing.assert_allclose(np.abs(transfer[band]), 0.5, rtol=1e-6)
    np.testing.assert_allclose(np.angle(transfer[band]), -2 * pi * frequency[band] * 2e-5, atol=1e-6)
    assert np.isnan(transfer[-1])


def test_the_command_measures_a_driven_run_or_refuses_in_one_line(tmp_path: Path) -> None:
    runs = ("--runs", tmp_path / "runs", "--results", tmp_path)
    made = beads("run", "driven-steel", "--engine", "verlet", *runs[:2], "--set", "drive.window=none")
    folder = made.stdout.split()[0]
    harmonics = json.loads(beads("spectrum", folder, "--until", "0.625 ms", "--json", *runs).stdout)["harmonics"]
    first = harmonics["drive"][0]
    assert (first["frequency_Hz"], first["amplitude"]) == pytest.approx((8e3, 10.0), rel=1e-6)
    burst = beads("run", "driven-steel", "--engine", "verlet", *runs[:2], "--set", "drive.cycles=4").stdout.split()[0]
    parts = json.loads(beads("spectrum", burst, "--json", *runs).stdout)["harmonics"]
    assert parts["drive"][0]["amplitude"] == pytest.approx(10.0, rel=1e-9)  # silence after it is left out
    assert parts["bead_15"][0]["amplitude"] == pytest.approx(9.0, rel=0.1)  # it comes later
    assert "transfer from drive to wall" in beads("spectrum", folder, *runs).stdout
    assert len(list(tmp_path.glob("spectrum-*.csv"))) == 1
    for option, value, message in [
        ("--to", "bead_3", 'found "bead_3"; allowed: drive, bead_15, bead_5, wall'),
        ("--window", "kaiser", "'kaiser' is not one of 'hann', 'boxcar'"),
        ("--since", "1", 'found "1"; allowed: a quantity in s'),
        ("--since", "0.99 ms", "at least 16 are needed"),
        ("--frequency", "10 Hz", "shorter than a period"),
    ]:
        answer = beads("spectrum", folder, option, value, *runs)
        assert (answer.returncode, answer.stderr.count("\n")) == (2, 1)
        assert message in answer.stderr
