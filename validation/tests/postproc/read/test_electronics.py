"""Electronics of the gauges: exact for signals with known answers, without effect on the run."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from drivers.chain.case import read_layout
from drivers.engines import engine_names, load_engine
from drivers.run.run_folder import open_run
from postproc.read.motion import exact
from postproc.read.observables import observe
from postproc.read.signals import high_passed, sensor_signals
from validation.accuracy.motions import exact_motion_of
from validation.tests.helpers.runs import assessed
from validation.tests.helpers.scenes import SceneWriter, case_of

US = 1e-6
WIDTH_S, CENTRE_S = 60 * US, 200.37 * US  # of a solitary wave in the paper's beads, between samples


def times(samples: int, interval_s: float = US) -> np.ndarray:
    return np.arange(samples, dtype=float) * interval_s


def pulse_and_answer(time_s: np.ndarray, tau_s: float) -> tuple[np.ndarray, np.ndarray]:
    """Long-wave solitary wave cos^4 and the filtered signal in closed form.

    The pulse is a sum of exp(i w t); the answer to each is ``i w tau / (1 + i w tau) (exp(i w t) - exp(-t / tau))``.
    """
    since = np.clip(time_s - CENTRE_S + WIDTH_S / 2, 0, WIDTH_S)
    signal, answer = np.zeros_like(time_s), np.zeros_like(time_s)
    for order, share in enumerate((3 / 8, -1 / 2, 1 / 8)):
        turn = 2j * np.pi * order / WIDTH_S
        passed = turn * tau_s / (1 + turn * tau_s)
        signal += share * np.exp(turn * since).real
        answer += share * (passed * (np.exp(turn * since) - np.exp(-since / tau_s))).real
    leaking = np.maximum(time_s - CENTRE_S - WIDTH_S / 2, 0)
    return signal, answer * np.exp(-leaking / tau_s)


def largest_error(interval_s: float, tau_s: float) -> float:
    """Largest error over the largest filtered value."""
    time = times(round(1.2e-3 / interval_s) + 1, interval_s)
    signal, answer = pulse_and_answer(time, tau_s)
    return float(np.abs(high_passed(time, 5 + signal, tau_s) - answer).max() / np.abs(answer).max())


@pytest.mark.parametrize(("tau_us", "measured"), [(10, 7.9e-8), (1000, 3.5e-10), (100_000, 3.5e-12)])
def test_the_filter_of_a_pulse_is_that_of_the_closed_form(tau_us: float, measured: float) -> None:
    """Linear interpolation would have errors ten thousand times as large: 5.8e-6 at 1 ms."""
    assert largest_error(US, tau_us * US) < 1.5 * measured
    # the fourth derivative of the pulse jumps at its ends: order 5, depending on the position of the ends
    assert largest_error(US / 2, tau_us * US) < largest_error(US, tau_us * US) / 2**4


def test_ramps_and_extreme_time_constants_have_their_known_signals() -> None:
    time = times(1000)
    for samples in (1, 2, 3, 5, 6, 7, 9):
        short = time[:samples]
        expected = 2e6 * 3 * US * -np.expm1(-short / (3 * US))
        np.testing.assert_allclose(high_passed(short, 7 + 2e6 * short, 3 * US), expected, atol=1e-13)
    signal, answer = pulse_and_answer(time, 1e-8)
    for tau_s in (1e10, 1e30):
        np.testing.assert_allclose(high_passed(time, 3 + signal, tau_s), signal, atol=1e-12)
    error = np.abs(high_passed(time, signal, 1e-8) - answer).max()
    assert error < 1e-4 * np.abs(answer).max(), "the polynomial's slope: measured 3e-5"
    assert np.abs(high_passed(time, signal, 1e-30)).max() < 1e-14, "rounding"


def test_gauges_with_electronics_attenuate_fig5() -> None:
    """Tolerances are half of the last digit; the static load is lost, and balances are those of the motion."""
    case = case_of("fig5", "sensor.time_constant=1 ms")
    trace = exact(case).trace
    plain, shown = observe(replace(case.layout, time_constant_s=None), trace), observe(case.layout, trace)
    lost = [1 - shown[name] / plain[name] for name in ("wall_peak_2_N", "wall_peak_3_N")]
    assert lost == [pytest.approx(0.11, abs=0.005), pytest.approx(0.28, abs=0.005)]
    assert plain["wall_static_N"] > 0 == shown["wall_static_N"]
    assert shown["wall_peak_N"] == shown["wall_amplitude_N"] < plain["wall_amplitude_N"]
    balances = [name for name in plain if "energy" in name or "momentum" in name or "impulse" in name]
    assert len(balances) == 6
    assert all(plain[name] == shown[name] for name in balances)


def test_one_run_serves_all_time_constants(scene_file: SceneWriter, tmp_path: Path) -> None:
    """Each folder has its own signals; errors compare filtered with filtered, which 0.1 ms lowers by a third."""
    scene = scene_file(chain="sensors = [{ from_wall = 3 }]")
    decks, runs, forces, signals = [], [], [], []
    for settings in ((), ("sensor.time_constant=0.1 ms",), ()):
        case = case_of(scene, *settings)
        ended = assessed(case, "verlet", tmp_path / "runs")
        run, table = open_run(ended.folder), pd.read_csv(ended.folder / "sensors.csv")
        assert run.layout == case.layout
        for name, signal in sensor_signals(case.layout, run.trace).items():
            np.testing.assert_array_equal(table[f"{name}_N"], signal)
        peak_N, true_N = observe(run.layout, run.trace)["wall_peak_N"], exact_motion_of(case).true["wall_peak"]
        (wall,) = (part for part in run.record.error_budget or () if part["quantity"] == "wall_peak")
        assert wall["whole"] == pytest.approx(peak_N / true_N - 1, abs=1e-9)
        assert 0 < abs(wall["whole"]) < 1e-4
        decks.append([load_engine(name).render(case).files for name in engine_names()])
        runs.append((ended.folder, ended.record.wall_s))
        forces.append((ended.folder / "forces.parquet").read_bytes())
        signals.append((ended.folder / "sensors.csv").read_bytes())
    assert runs[0] == runs[2] != runs[1]
    assert runs[0][1] == runs[1][1], "found, not run again"
    assert decks[0] == decks[1]
    assert forces[0] == forces[1]
    assert signals[0] == signals[2] != signals[1]
    older = dict(run.record.layout)
    del older["time_constant_s"]
    assert read_layout(older) == read_layout(run.record.layout), "older records are read"
