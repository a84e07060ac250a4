"""Electronics of the gauges: exact for signals with known answers, without effect on the run."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from drivers.batch.study_commands import batch
from drivers.chain.case import Case, read_layout
from drivers.chain.schemes import verlet_of
from drivers.chain.trace import Trace
from drivers.engines import engine_names, load_engine
from drivers.run.execute import Place
from drivers.run.run_folder import EndedRun, open_run
from postproc.paper.simulate import exact
from postproc.read.observables import observe
from postproc.read.sensors import high_passed, sensor_signals
from postproc.read.signals import Peak, envelope, peaks, train_envelope
from validation.accuracy.budget import budget_of
from validation.accuracy.exact_motion import exact_motion_of
from validation.commands.batch_commands import request_of
from validation.tests.helpers.runs import assessed
from validation.tests.helpers.scenes import SceneWriter, StudyWriter, case_of

US = 1e-6
WIDTH_S, CENTRE_S = 60 * US, 200.37 * US  # of a solitary wave in the paper's beads, between samples
ONE_MS = "sensor.time_constant=1 ms"


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


@pytest.mark.parametrize(("tau_us", "measured"), [(10, 7.9e-8), (200, 1.8e-9), (1000, 3.5e-10), (100_000, 3.5e-12)])
def test_a_pulse_with_a_known_answer(tau_us: float, measured: float) -> None:
    """Linear interpolation would have errors ten thousand times as large: 5.8e-6 at 1 ms."""
    assert largest_error(US, tau_us * US) < 1.5 * measured
    # the fourth derivative of the pulse jumps at its ends: order 5, depending on the position of the ends
    assert largest_error(US / 2, tau_us * US) < largest_error(US, tau_us * US) / 2**4


def test_fig5_against_finer_samples() -> None:
    """Contacts open and close with the power 3/2, which lowers the order: measured 1.5e-7; linear: 3e-6."""
    fine = case_of("fig5", ONE_MS, "run.sample_interval=0.2 us", "chain.sensors=[{ from_wall = 11 }]")
    trace = exact(fine).trace
    coarse = Trace(
        trace.time_s[::5], trace.force_N[::5], trace.kinetic_energy_J[::5], trace.total_energy_J[::5],
        trace.momentum_N_s[::5],
    )  # fmt: skip
    true, found = sensor_signals(fine.layout, trace), sensor_signals(fine.layout, coarse)
    errors = {name: np.abs(found[name] - true[name][::5]).max() / true[name].max() for name in true}
    assert set(errors) == {"bead_11", "wall"}
    assert max(errors.values()) < 3e-7, errors


def test_fig5_looks_attenuated() -> None:
    """Numbers of the elastic Fig. 5 behind 1 ms; tolerances are half of the last digit."""
    case = case_of("fig5", ONE_MS)
    trace = exact(case).trace
    plain, shown = observe(replace(case.layout, time_constant_s=None), trace), observe(case.layout, trace)
    lost = [1 - shown[name] / plain[name] for name in ("wall_peak_2_N", "wall_peak_3_N")]
    assert lost == [pytest.approx(0.11, abs=0.005), pytest.approx(0.28, abs=0.005)]
    rates = [values["wall_envelope_per_s"] * US for values in (plain, shown)]
    assert rates == [pytest.approx(-0.0060, abs=5e-5), pytest.approx(-0.0072, abs=5e-5)]


def test_peaks_of_the_wall_are_maxima_of_what_it_shows() -> None:
    """A spline through a signal plus a constant is the spline plus the constant, except for rounding."""
    for constant in (None, 1e-3):
        case = case_of("fig5")
        layout, trace = replace(case.layout, time_constant_s=constant), exact(case).trace
        values, maxima = observe(layout, trace), peaks(trace.time_s, sensor_signals(layout, trace)["wall"])
        names = ("wall_peak_N", "wall_peak_2_N", "wall_peak_3_N")
        assert [values[name] for name in names] == pytest.approx([peak.value for peak in maxima[:3]], rel=1e-12)
        assert values["wall_envelope_per_s"] == pytest.approx(envelope(maxima[:3]).rate_per_s, rel=1e-10)


def test_a_missing_envelope_is_nan() -> None:
    two = [Peak(1e-4, 3.0, 100), Peak(2e-4, 1.0, 200)]
    assert train_envelope(two) is None
    assert train_envelope([*two, Peak(3e-4, -0.1, 300)]) is None
    assert train_envelope([*two, Peak(3e-4, 1 / 3, 300)]) is not None
    values = observe(case_of("fig5", "run.duration=0.5 ms").layout, exact(case_of("fig5", "run.duration=0.5 ms")).trace)
    assert values["wall_peak_2_N"] > 0
    assert np.isnan([values["wall_peak_3_N"], values["wall_envelope_per_s"]]).all()


def test_a_huge_time_constant_leaves_the_change() -> None:
    time = times(1000)
    signal = 3 + pulse_and_answer(time, 1.0)[0]
    for tau_s in (1e10, 1e30):
        np.testing.assert_allclose(high_passed(time, signal, tau_s), signal - 3, atol=1e-12)


def test_a_time_constant_below_the_samples_leaves_the_slope() -> None:
    time = times(1000)
    signal, _ = pulse_and_answer(time, 1.0)
    _, answer = pulse_and_answer(time, 1e-8)
    shown = high_passed(time, signal, 1e-8)
    slope = np.gradient(signal, time, edge_order=2)
    assert np.abs(shown - answer).max() < 1e-4 * np.abs(answer).max(), "the polynomial's slope: measured 3e-5"
    assert np.abs(shown - 1e-8 * slope).max() < 0.02 * np.abs(answer).max(), "second differences over 60 samples"
    assert np.abs(high_passed(time, signal, 1e-30)).max() < 1e-14, "rounding"


@pytest.mark.parametrize("samples", range(1, 10))
def test_a_ramp_is_exact_however_short(samples: int) -> None:
    time = times(samples)
    expected = 2e6 * 3 * US * -np.expm1(-time / (3 * US))
    np.testing.assert_allclose(high_passed(time, 7 + 2e6 * time, 3 * US), expected, atol=1e-13)


def test_observables_are_what_the_gauge_shows() -> None:
    case = case_of("fig4", ONE_MS)
    trace = exact(case).trace
    plain, shown = observe(replace(case.layout, time_constant_s=None), trace), observe(case.layout, trace)
    assert plain.keys() == shown.keys()
    for gauge in ("bead_9", "bead_5", "wall"):
        assert plain[f"{gauge}_static_N"] > 0
        assert shown[f"{gauge}_static_N"] == 0
        assert shown[f"{gauge}_peak_N"] == shown[f"{gauge}_amplitude_N"] < plain[f"{gauge}_amplitude_N"]
    balances = [name for name in plain if "energy" in name or "momentum" in name or "impulse" in name]
    assert len(balances) == 8
    assert {name: plain[name] for name in balances} == {name: shown[name] for name in balances}


def test_a_gauge_that_is_far_too_fast_shows_no_pulse() -> None:
    case = case_of("fig4", "sensor.time_constant=1e-20 s")
    assert np.isnan(observe(case.layout, exact(case).trace)["wall_peak_N"])


def small(scene_file: SceneWriter, *settings: str) -> Case:
    return case_of(scene_file(chain="sensors = [{ from_wall = 3 }]"), *settings)


def test_decks_do_not_depend_on_the_electronics(scene_file: SceneWriter) -> None:
    for name in engine_names():
        decks = [load_engine(name).render(small(scene_file, *settings)).files for settings in ((), (ONE_MS,))]
        assert decks[0] == decks[1]


def test_one_run_serves_all_time_constants(scene_file: SceneWriter, tmp_path: Path) -> None:
    runs = tmp_path / "runs"
    rereads: list[tuple[EndedRun, bytes, bytes]] = []
    for settings in ((), (ONE_MS,), ("sensor.time_constant=0.1 ms",), (), (ONE_MS,)):
        case = small(scene_file, *settings)
        ended = assessed(case, "verlet", runs)
        assert ended.done
        forces, sensors = ((ended.folder / name).read_bytes() for name in ("forces.parquet", "sensors.csv"))
        rereads.append((ended, forces, sensors))
        run, table = open_run(ended.folder), pd.read_csv(ended.folder / "sensors.csv")
        assert run.layout == case.layout
        for name, signal in sensor_signals(case.layout, run.trace).items():
            np.testing.assert_array_equal(table[f"{name}_N"], signal)
        values = observe(run.layout, run.trace)
        (wall,) = (part for part in run.record.error_budget or () if part["quantity"] == "wall_peak")
        assert wall["whole"] == pytest.approx(
            values["wall_peak_N"] / exact_motion_of(case).true["wall_peak"] - 1, abs=1e-9
        )
    assert len({ended.folder for ended, _, _ in rereads}) == 3
    assert len({ended.record.wall_s for ended, _, _ in rereads}) == 1, "found, not run again"
    assert len({forces for _, forces, _ in rereads}) == 1
    tables = [sensors for _, _, sensors in rereads]
    assert len(set(tables[:3])) == 3
    assert tables[3:] == tables[:2]


def test_older_records_are_read(scene_file: SceneWriter, tmp_path: Path) -> None:
    ended = assessed(small(scene_file), "verlet", tmp_path / "runs")
    stored = dict(ended.record.layout)
    del stored["time_constant_s"]
    assert read_layout(stored) == read_layout(ended.record.layout)


def test_exact_motion_and_run_are_filtered_alike(scene_file: SceneWriter) -> None:
    """A time constant of a few pulses lowers the peak by a third: a filter missing on one side would show."""
    whole = {}
    for tau in ("", "0.1 ms"):
        case = small(scene_file, *([f"sensor.time_constant={tau}"] if tau else []))
        rows = budget_of(case, "verlet", verlet_of(case)).rows
        whole[tau] = {row["quantity"]: row["whole"] for row in rows}
    assert whole[""].keys() == whole["0.1 ms"].keys()
    assert 0 < abs(whole["0.1 ms"]["wall_peak"]) < 1e-4
    assert whole[""]["wall_peak"] != whole["0.1 ms"]["wall_peak"]


def test_an_accuracy_of_filtered_quantities(scene_file: SceneWriter, tmp_path: Path) -> None:
    asked = ("run.time_step=", "run.accuracy={ wall_peak = 1e-5, bead_3_reflected_amplitude = 1e-4 }")
    ended = assessed(small(scene_file, ONE_MS, *asked), "verlet", tmp_path / "runs")
    assert ended.done
    assert ended.missed is None
    assert ended.record.accuracy is not None
    assert set(ended.record.accuracy) == {"wall_peak", "bead_3_reflected_amplitude"}


def test_a_study_of_time_constants(study_file: StudyWriter, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    tables = ["", *(f'{{ time_constant = "{constant}" }}' for constant in ("1 ms", "0.1 ms"))]
    values = ", ".join(each or '""' for each in tables)
    path = str(study_file(f'[[axis]]\nkey = "sensor"\nname = "gauge"\nvalues = [{values}]', "verlet"))
    runs, results = tmp_path / "runs", tmp_path / "results"
    assert batch(request_of(path, runs), results, Place(1, processes=True)) == 0
    table = pd.read_parquet(results / "study.parquet")
    cases = [case_of(tmp_path / "scene.toml", *([f"sensor={each}"] if each else [])) for each in tables]
    expected = [observe(case.layout, verlet_of(case))["wall_peak_N"] for case in cases]
    assert len(set(expected)) == 3
    assert list(table["wall_peak_N"]) == pytest.approx(expected, rel=1e-12)
    assert table["force_error_share"].nunique() == 1, "the forces are the same"
    capsys.readouterr()
    assert batch(request_of(path, runs), results, Place(1, processes=True), dry_run=True) == 0
    assert "verlet  3 done, 0 to do" in capsys.readouterr().out
