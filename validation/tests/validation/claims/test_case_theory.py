"""Measures of the cases beyond the paper on made-up signals, and runs and chains that they refuse."""

from collections.abc import Sequence
from functools import cache

import numpy as np
import pytest

from drivers.chain.case import Case, build_case
from drivers.chain.trace import Trace
from drivers.scene.read_scene import read_scene
from postproc.paper.simulate import exact
from validation.claims.cases import MEASURES, pose, read_independent
from validation.claims.measures import bands, linear, weak

CASES = {entry.id: entry for entry in read_independent()}
SMALL, WEAK, AT_CONTACT, AT_BEAD = (
    "linear-limit-1mN", "weak-strike-under-gravity", "head-on-at-contact", "head-on-at-bead"
)  # fmt: skip


@cache
def with_settings(name: str, *settings: str) -> Case:
    """The case of an entry with more settings."""
    entry = CASES[name]
    if entry.scene is None or not settings:
        return pose(entry)[0].case
    return build_case(read_scene(entry.scene, (*entry.set, *settings)))


@cache
def exact_trace(name: str, *settings: str) -> Trace:
    return exact(with_settings(name, *settings)).trace


def test_made_up_records_have_their_known_rates_lines_and_peaks() -> None:
    """A fit finds a rate from any start, a spectrum lines between its samples, a polynomial a peak in noise."""
    time, rate = np.arange(0.0, 100.0, 0.05), 1.0173
    record = 3.0 * linear.response(2, rate * time)
    fitted, amplitude, misfit = linear.fit(time, record, 2, linear.LAST_TAU)
    assert fitted == pytest.approx(rate, rel=1e-12)
    assert amplitude == pytest.approx(record.max(), rel=1e-3)
    assert misfit < 1e-12
    time, true = np.linspace(0.0, 0.04, 4000, endpoint=False), np.array([1234.5, 1467.8, 9876.54])
    signal = np.sin(2 * np.pi * np.outer(time, true) + np.array([0.3, 1.0, 2.0])) @ np.array([[1.0], [0.02], [0.01]])
    assert bands.lines_Hz(time, signal) == pytest.approx(true, rel=5e-6)
    time = np.arange(0.0, 15.0, 0.1)
    noise = 1e-4 * np.random.default_rng(1).normal(size=time.size)
    signal = np.exp(-((time - 4.03) ** 2) / 2) + 2 * np.exp(-((time - 12.0) ** 2) / 2)
    for disturbed, error in ((signal, 2e-5), (signal + noise, 2e-4)):
        peak = weak.leading_peak(time, disturbed)
        assert (peak.time_s, peak.value) == pytest.approx((4.03, 1.0), abs=error)


@pytest.mark.parametrize(
    ("name", "settings", "words"),
    [
        ("two-glass-spheres", ["run.duration=20 us"], "do not meet and separate"),
        ("train-2", ["run.duration=0.5 ms"], "waves at contact 21 within run.duration"),
        ("steel-chain", ["run.duration=0.1 ms"], "within run.duration"),
        (SMALL, ["run.duration=1 ms"], "too short"),
        (SMALL, ["chain.count=20", "chain.bead=[{ from_wall = 20, velocity = '-1 um/s' }]"], "the reflection arrives"),
        (AT_CONTACT, ["run.duration=2.5 ms"], "1 waves within the run"),
        ("cutoff-in-spectrum", ["run.duration=50 us"], "fewer than two lines"),
        ("precompressed-ptfe", ["chain.sensors=[{ from_wall = 40 }]"], "fewer than two sensors"),
        (WEAK, ["run.sample_interval=80 us", "run.time_step=2 us"], "run.sample_interval is too long"),
    ],
)
def test_a_run_that_does_not_show_the_wave_is_named(name: str, settings: Sequence[str], words: str) -> None:
    with pytest.raises(ValueError, match=words):
        MEASURES[CASES[name].measure].measure(with_settings(name, *settings), exact_trace(name, *settings))


@pytest.mark.parametrize(
    ("name", "settings", "words"),
    [
        ("precompressed-ptfe", ["chain.bead=[{ from_wall = 9, mass = '1 g' }]"], "of unequal beads"),
        ("heavy-impurity", ["chain.bead=[{ from_wall = 70, velocity = '-1 um/s' }]"], "not one bead of another mass"),
        ("transfer-in-band", ["run.duration=4 ms"], "too short to separate"),
        ("transfer-in-band", ["drive.cycles=9"], "no sine force that lasts"),
        ("dimer-bands", ["chain.precompression="], "a contact without static load"),
        ("two-glass-spheres", ["gravity=9.81 m/s^2"], "loads"),
    ],
)
def test_a_theory_of_other_chains_is_refused(name: str, settings: Sequence[str], words: str) -> None:
    with pytest.raises(ValueError, match=words):
        MEASURES[CASES[name].measure].theory(with_settings(name, *settings))
