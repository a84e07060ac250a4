"""Measured traces compared with computed ones: triggers, baselines, pulses with errors, remarks, refused records."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from scipy.interpolate import make_interp_spline

from drivers.base import paths
from drivers.base.errors import InputError
from drivers.chain.trace import Trace
from drivers.run.run import run_case
from drivers.run.run_folder import FORCES
from postproc.paper.simulate import Simulation, case_of, exact
from postproc.read.alignment import AlignedGauge, align, check_length, noise_of
from postproc.read.measured import MeasuredTrace
from postproc.read.misfit import Misfit, gain_remark, misfits, smooth
from postproc.read.observables import observe
from postproc.read.sensors import sensor_signals
from validation.report.scene_section import overlay_of
from validation.tests.helpers import made_up_trace
from validation.tests.helpers.commands import beads
from validation.tests.helpers.runs import edit_record
from validation.tests.helpers.scenes import SceneWriter

TRIGGER_S = 123.456e-6
MEASURED_SETTINGS = (
    "materials.ptfe.youngs_modulus=1.2 GPa",
    "contact.restitution=0.95",
)  # settings of the measured motion
GAIN, BASELINE, DRIFT = 2.1, 0.3, 400.0  # N/V, V, V/s
SEEDS = 50
COVERAGE = 2.0  # standard errors, which contain 95 of 100 normal deviates


@pytest.fixture(scope="module")
def base() -> Simulation:
    return exact(case_of("fig4"))


@pytest.fixture(scope="module")
def other() -> Simulation:
    return exact(case_of("fig4", *MEASURED_SETTINGS))


def measured(
    made: Simulation,
    noise: float = 0.0,
    seed: int = 0,
    interval_us: float = 1.0,
    times_s: np.ndarray[tuple[int], np.dtype[np.float64]] | None = None,
) -> MeasuredTrace:
    """Readings in V of a motion, with white noise relative to each amplitude, an offset and a drift."""
    end_s = float(made.trace.time_s[-1])
    if times_s is None:
        times_s = np.arange(0, TRIGGER_S + end_s, interval_us * 1e-6)
    random, reading = np.random.default_rng(seed), {}
    for gauge, signal in sensor_signals(made.case.layout, made.trace).items():
        force_N = make_interp_spline(made.trace.time_s, signal - signal[0], k=5)(np.clip(times_s - TRIGGER_S, 0, end_s))
        force_N = force_N + random.normal(0.0, noise * made.values[f"{gauge}_amplitude_N"], len(times_s))
        reading[gauge] = force_N / GAIN + BASELINE + DRIFT * times_s
    return MeasuredTrace(Path("shot.csv"), times_s, reading, gain=GAIN, drift=True, unit="V")


def found_in(trace: MeasuredTrace, base: Simulation) -> tuple[list[AlignedGauge], dict[str, Misfit]]:
    gauges = align([trace], base.case.layout, base.trace)
    rows = misfits([smooth(gauge, base.trace) for gauge in gauges], base.case.layout, base.trace)
    return gauges, {row.name: row for row in rows}


def exact_motion_of(made: Simulation, gauges: list[AlignedGauge]) -> dict[str, float]:
    """Observables of the measured motion, with the impulses over the compared readings."""
    values = observe(made.case.layout, made.trace)
    for gauge in gauges:
        signal = sensor_signals(made.case.layout, made.trace)[gauge.gauge]
        force_N = make_interp_spline(made.trace.time_s, signal - signal[0], k=5)(gauge.time_s)
        values[f"{gauge.gauge}_impulse_N_s"] = float(np.trapezoid(force_N, gauge.time_s))
        values[f"{gauge.gauge}_baseline_V"] = BASELINE + DRIFT * TRIGGER_S
    return values | {"trigger_s": TRIGGER_S}


@pytest.mark.long
def test_measured_values_are_within_their_errors(base: Simulation, other: Simulation) -> None:
    """With 50 seeds each at 1, 3 and 5 % noise, 95 of 100 values are within two standard errors."""
    within: dict[str, list[bool]] = {}
    for made, noise, given in ((other, 0.01, True), (base, 0.03, False), (base, 0.05, True)):
        for seed in range(SEEDS):
            trace = measured(made, noise, seed)
            gauges, rows = found_in(replace(trace, trigger_s=TRIGGER_S) if given else trace, base)
            truth = exact_motion_of(made, gauges)
            for name, row in rows.items():
                if name in truth and row.error > 0:
                    within.setdefault(name, []).append(abs(row.measured - truth[name]) <= COVERAGE * row.error)
    assert len(within) == 17
    assert {len(each) for each in within.values()} == {SEEDS, 3 * SEEDS}
    shares = {name: np.mean(each) for name, each in within.items()}
    assert np.mean([np.mean(each) for each in within.values()]) >= 0.95, shares
    assert min(shares.values()) >= 0.88, shares


def test_errors_are_small_for_little_noise(base: Simulation) -> None:
    """With 1 % noise, errors of peaks are below 0.5 %, of the speed below 1 %, of the trigger below 50 ns."""
    _, rows = found_in(measured(base, 0.01), base)
    for name, share in (("bead_9_amplitude_N", 5e-3), ("wall_amplitude_N", 5e-3), ("speed_9_to_5_m_s", 0.01)):
        assert rows[name].error < share * rows[name].measured, name
    assert 0 < rows["trigger_s"].error < 5e-8
    for gauge in ("bead_9", "bead_5", "wall"):
        noise_N = 0.01 * base.values[f"{gauge}_amplitude_N"]
        assert rows[f"{gauge}_residual_rms_N"].measured == pytest.approx(noise_N, rel=0.15)
        assert rows[f"{gauge}_residual_rms_N"].error == pytest.approx(noise_N, rel=0.1)
        assert rows[f"{gauge}_correlation"].measured > 0.998


@pytest.mark.parametrize("noise", [0.005, 0.02, 0.1])
@pytest.mark.parametrize(("readings", "spread"), [(100, 0.2), (200, 0.08), (1000, 0.04), (100_000, 0.015)])
def test_noise_is_found_from_the_readings_alone(base: Simulation, readings: int, spread: float, noise: float) -> None:
    times_s, ratios = np.linspace(0, TRIGGER_S + float(base.trace.time_s[-1]), readings), []
    for seed in range(10 if readings <= 1000 else 1):
        for gauge, reading in measured(base, noise, seed, times_s=times_s).reading.items():
            ratios.append(noise_of(times_s, reading) * GAIN / (noise * base.values[f"{gauge}_amplitude_N"]))
    assert np.mean(ratios) == pytest.approx(1, abs=0.04)
    assert np.std(ratios) < spread
    assert noise_of(times_s, np.round(reading, 1)) >= 0.999 * 0.1 / 12**0.5


def test_readings_without_noise_give_the_observables_of_the_run(base: Simulation) -> None:
    gauges, rows = found_in(measured(base), base)
    assert rows["trigger_s"].measured == pytest.approx(TRIGGER_S, abs=1e-9)
    for name, row in rows.items():
        if name in base.values:
            assert row.computed == base.values[name]
            assert row.measured == pytest.approx(row.computed, rel=2e-3), name
    for gauge in gauges:
        assert np.abs(gauge.force_N - gauge.computed_N).max() < 2e-3 * gauge.computed_N.max()


def test_given_values_are_used(base: Simulation) -> None:
    trace = replace(measured(base, 0.01), trigger_s=TRIGGER_S + 5e-6, noise=0.02, gain_uncertainty=0.1)
    gauges, rows = found_in(trace, base)
    assert (rows["trigger_s"].measured, rows["trigger_s"].error) == (TRIGGER_S + 5e-6, 0.0)
    assert [gauge.noise_N for gauge in gauges] == pytest.approx([0.02 * GAIN] * 3)
    assert rows["bead_9_arrival_s"].difference == pytest.approx(-5e-6, abs=1e-6)
    assert rows["wall_amplitude_N"].gain_error == pytest.approx(0.1 * rows["wall_amplitude_N"].measured)
    assert rows["wall_amplitude_N"].error > rows["wall_amplitude_N"].gain_error
    flat = {name: reading - DRIFT * trace.time_s for name, reading in trace.reading.items()}
    rested, _ = found_in(replace(trace, reading=flat, drift=False, baseline=BASELINE), base)
    assert [gauge.baseline for gauge in rested] == pytest.approx([BASELINE] * 3)
    assert not any(gauge.rest_error_N.any() for gauge in rested)


def test_readings_may_be_irregular_few_or_many(base: Simulation) -> None:
    end_s = TRIGGER_S + float(base.trace.time_s[-1])
    random = np.random.default_rng(3)
    for times_s in (
        np.sort(random.uniform(0, end_s, 700)),
        np.arange(0, end_s, 8e-6),
        np.arange(0, 3 * end_s, 3e-9),
    ):
        gauges, rows = found_in(measured(base, 0.02, times_s=times_s), base)
        for name in ("bead_9_amplitude_N", "bead_5_arrival_s", "wall_amplitude_N", "speed_9_to_5_m_s", "trigger_s"):
            truth = exact_motion_of(base, gauges)[name]
            assert abs(rows[name].measured - truth) < 4 * rows[name].error, (name, len(times_s))
        assert max(len(gauge.time_s) for gauge in gauges) <= 2.1 * len(base.trace.time_s)


def test_gauges_of_one_file_have_one_trigger(base: Simulation) -> None:
    """Gauges in separate entries give the same result as in one entry."""
    whole = measured(base, 0.02)
    parts = [replace(whole, reading={name: reading}) for name, reading in whole.reading.items()]
    together, apart = (align(traces, base.case.layout, base.trace) for traces in ([whole], parts))
    assert [gauge.trigger_s for gauge in apart] == [gauge.trigger_s for gauge in together]
    for one, two in zip(together, apart, strict=True):
        assert np.array_equal(one.force_N, two.force_N)
    with pytest.raises(InputError, match="one trigger per file"):
        align([replace(part, trigger_s=i * 1e-6) for i, part in enumerate(parts)], base.case.layout, base.trace)


def cut(trace: MeasuredTrace, start_s: float, stop_s: float) -> MeasuredTrace:
    kept = (trace.time_s >= start_s) & (trace.time_s <= stop_s)
    reading = {name: values[kept] for name, values in trace.reading.items()}
    return replace(trace, time_s=trace.time_s[kept], reading=reading)


@pytest.mark.parametrize(
    ("start_us", "stop_us", "interval_us", "trigger_us", "found"),
    [
        (0, 900, 1, 2000, "0 readings from -2000"),
        (0, 900, 1, -1000, "0 readings from 1000"),
        (0, 900, 1, 890, "11 readings from -890"),
        (0, 300, 1, 123.456, "us after the trigger"),
        (0, 900, 60, None, "13 readings from -123"),
        (400, 900, 1, 123.456, "0 quiet readings of bead_9"),
    ],
)
def test_records_that_cannot_be_compared_are_named(
    base: Simulation, start_us: float, stop_us: float, interval_us: float, trigger_us: float | None, found: str
) -> None:
    trace = cut(measured(base, 0.01, interval_us=interval_us), start_us * 1e-6, stop_us * 1e-6)
    if start_us:  # one gauge, in the middle of its pulse
        trace = cut(replace(trace, reading={"bead_9": trace.reading["bead_9"]}), 430e-6, 490e-6)
    with pytest.raises(InputError) as caught:
        align([replace(trace, trigger_s=trigger_us and trigger_us * 1e-6)], base.case.layout, base.trace)
    assert caught.value.args[0].endswith("shot.csv")
    assert found in caught.value.args[2]
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(("factor", "unit"), [(1e-6, "s rather than us"), (100, "us rather than ms")])
def test_a_wrong_unit_of_time_is_named(base: Simulation, factor: float, unit: str) -> None:
    trace = measured(base)
    with pytest.raises(InputError, match=f"is the unit of time {unit}?"):
        align([replace(trace, time_s=factor * trace.time_s)], base.case.layout, base.trace)
    brief = measured(base, times_s=np.append(np.arange(400) * 1e-8, 500e-6))
    with pytest.raises(InputError, match="found 8 readings after averaging"):
        align([brief], base.case.layout, base.trace)


@pytest.mark.parametrize(
    ("stop_us", "gain", "length", "on_gain"),
    [
        (1100, GAIN, "", ""),
        (9000, GAIN, "shot.csv: the run ends 0.8 ms after the impact: 8.0", ""),
        (600, GAIN, "no readings from 0.4", "of the run's 0.8 ms, so the wave does not reach wall"),
        (1100, -GAIN, "", 'readings are inverted: measured.0.gain = "2.1 N/V" fits'),
        (1100, GAIN * 700, "", '1000 times the computed force (mV read as V?): measured.0.gain = "1.47 N/V" fits'),
        (1100, GAIN * 1e6, "", "1e+06 times the computed force (uV read as V?): measured.0.gain"),
        (1100, -GAIN / 3e3, "", "inverted and readings are about 0.001 times the computed force (V read as mV?)"),
    ],
)
@pytest.mark.parametrize("noise", [0.01, 0.1])
def test_remarks_name_lengths_and_gains(
    base: Simulation, other: Simulation, stop_us: float, gain: float, length: str, on_gain: str, noise: float
) -> None:
    """Also for a motion of another shape, with the trigger given or found."""
    times_s = np.arange(0, stop_us * 1e-6, 1e-6)
    for made, trigger_s in ((base, None), (base, TRIGGER_S), (other, None), (other, TRIGGER_S)):
        trace = replace(measured(made, noise, times_s=times_s), gain=gain, trigger_s=trigger_s)
        gauges = align([trace], base.case.layout, base.trace)
        onsets_s = {gauge.gauge: gauge.onset_s for gauge in gauges}
        said = check_length(trace, gauges[0].trigger_s, float(base.trace.time_s[-1]), onsets_s)
        assert (length in said) if length else not said
        remarks = [gain_remark(gauge, "measured.0") for gauge in gauges]
        if gain == GAIN:
            assert remarks == [""] * 3
            assert on_gain in said
        else:
            assert all(on_gain in remark for remark in remarks[:1])


def test_a_gauge_that_no_wave_reaches_is_named(base: Simulation) -> None:
    still = Trace(**{**vars(base.trace), "force_N": np.zeros_like(base.trace.force_N)})
    with pytest.raises(InputError, match="at rest in the run"):
        align([measured(base)], base.case.layout, still)


def test_the_example_is_what_it_says() -> None:
    made = made_up_trace.made_up_trace()
    lines = made_up_trace.FILE.read_text().splitlines(keepends=True)
    assert lines[0] == made_up_trace.HEAD
    assert lines[0].startswith("# INVENTED, not an experiment")
    pd.testing.assert_frame_equal(pd.read_csv(made_up_trace.FILE, comment="#"), made, rtol=0, atol=0.1001)


def overlay(*words: str | Path) -> tuple[int, str, str]:
    done = beads("overlay", *words)
    return done.returncode, done.stdout, done.stderr


def rows_of(path: Path) -> dict[tuple[str, str], dict[str, Any]]:
    """Rows of a table of misfits by quantity and source."""
    rows: list[dict[Any, Any]] = pd.read_csv(path).to_dict("records")
    return {(row["quantity"], row["source"]): row for row in rows}


def test_the_command_compares_the_example_with_the_exact_motion(tmp_path: Path) -> None:
    code, said, wrong = overlay("example-measured", "--results", tmp_path)
    assert (code, wrong) == (0, "")
    rows = rows_of(tmp_path / "overlay-example-measured.csv")
    truth = made_up_trace.true_values()
    source = made_up_trace.FILE.name
    for gauge in ("bead_9", "bead_5", "wall"):
        for name in (f"{gauge}_amplitude_N", f"{gauge}_arrival_s"):
            row = rows[name, source]
            assert abs(row["measured"] - truth[name]) < 3 * row["error_by_noise"], name
            assert abs(row["difference_in_errors"]) > 2, name
            assert name in said
    assert rows["speed_9_to_5_m_s", "quoted"]["measured"] == 184.0
    assert rows["speed_9_to_5_m_s", "quoted"]["standard_error"] == pytest.approx(3.68)
    assert {path.suffix for path in tmp_path.glob("[!.]*")} == {".csv", ".png", ".svg"}
    closer = overlay("example-measured", "--results", tmp_path, *(f"--set={each}" for each in made_up_trace.SETTINGS))
    assert closer[0] == 0
    now = rows_of(tmp_path / "overlay-example-measured.csv")
    judged = [row["difference_in_errors"] for (_, origin), row in now.items() if origin == source]
    assert np.nanmax(np.abs(judged)) < 4.0
    assert np.isfinite(judged).sum() == 13


def test_remarks_are_printed_and_reported(tmp_path: Path) -> None:
    settings = "run.duration=0.6 ms", "measured.0.gain=2100 N/V"
    code, _, wrong = overlay("example-measured", "--results", tmp_path, *(f"--set={each}" for each in settings))
    assert code == 0
    length, gain = wrong.splitlines()
    assert "the run ends 0.6 ms after the impact: 0.178 ms of readings after it are not compared" in length
    assert "bead_9, bead_5: readings are about 1000 times the computed force (mV read as V?): measured.0.gain" in gain
    made = exact(case_of("example-measured", *settings))
    assert overlay_of(made.case, "reference", made.trace, paths.RESULTS)["remarks"] == [length, gain]


def test_the_plan_reads_the_measured_files() -> None:
    said = beads("plan", "example-measured")
    assert "measured   inputs/measured/example-measured.csv: 410 readings of bead_9, bead_5\n" in said.stdout
    for setting, problem in (("file=none.csv", "no such file"), ("gain=2 V", "measured.0.gain: found")):
        refused = beads("plan", "example-measured", f"--set=measured.0.{setting}")
        assert (refused.returncode, refused.stdout) == (2, "")
        assert problem in refused.stderr


@pytest.mark.long
def test_the_command_takes_runs_and_files(tmp_path: Path) -> None:
    runs, out = tmp_path / "runs", tmp_path / "out"
    ran = beads("run", "example-measured", "--engine", "verlet", "--runs", runs)
    folder = ran.stdout.split()[-1]
    code, said, wrong = overlay("verlet:example-measured", "--runs", runs, "--results", out)
    assert (code, wrong) == (0, "")
    assert "184" in said
    (by_name,) = out.glob("*.csv")
    own = Path(folder) / "sensors.csv"  # as if measured: no noise, no offset
    assert (Path(folder) / FORCES).is_file()
    code, said, wrong = overlay(folder, "--measured", own, "--results", tmp_path / "own")
    assert (code, wrong) == (0, "")
    peak = rows_of(next((tmp_path / "own").glob("*.csv")))["wall_amplitude_N", own.name]
    assert abs(peak["difference"]) < 1e-3 * peak["computed"]
    assert by_name.name == next((tmp_path / "own").glob("*.csv")).name
    code, said, wrong = overlay("example-measured", "--measured", made_up_trace.FILE, "--results", tmp_path / "again")
    assert (code, wrong) == (0, "")
    assert "quoted" not in said
    assert "bead_9_baseline_V" in said


def test_the_data_are_those_of_the_named_scene_whatever_the_record_is_called(
    scene_file: SceneWriter, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    scene = scene_file(
        "mine", top='[[measured]]\nvalues = { wall_peak = "1 N" }\nerrors = { wall_peak = 0.1 }\nsource = "a book"'
    )
    edit_record(run_case(case_of(scene), "verlet", tmp_path / "runs").folder, scene_name="other")
    code, said, wrong = overlay("verlet:mine", "--runs", tmp_path / "runs", "--results", tmp_path)
    assert (code, wrong) == (0, "")
    assert "wall_peak" in said


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("fig4",), "fig4: measured: no measured data: add a [[measured]] table"),
        pytest.param(("fig4", "--measured", "none.csv"), "no such file", marks=pytest.mark.long),
        (("fig4", "--measured", made_up_trace.FILE), "measured.gauges: found headings"),
        (("example-measured", "--set", "measured.0.gain=2 N/A"), "measured.0.gain: found"),
        pytest.param(("example-measured", "--set", "measured.0.trigger=9 ms"), "triggers", marks=pytest.mark.long),
        pytest.param(
            ("fig4-tube", "--set", "measured=[{file='x.csv'}]"),
            "allowed: an engine that models it",
            marks=pytest.mark.long,
        ),
        (("verlet:example-measured", "--set", "chain.count=9"), "not allowed for a finished run"),
        pytest.param(("nonsense",), "scene not found", marks=pytest.mark.long),
    ],
)
def test_the_command_names_wrong_input(tmp_path: Path, words: tuple[str | Path, ...], message: str) -> None:
    code, said, wrong = overlay(*words, "--results", tmp_path)
    assert (code, said) == (2, "")
    assert message in wrong
    assert len(wrong.splitlines()) == 1


def test_quoted_values_alone_need_no_file(tmp_path: Path) -> None:
    """Quoted values alone give a printed table and no figure."""
    entry = "measured=[{values={bead_9_amplitude='2 N'}, errors={bead_9_amplitude=0.18}}]"
    code, said, wrong = overlay("fig4", "--set", entry, "--results", tmp_path)
    assert (code, wrong) == (0, "")
    assert said.splitlines()[1].split() == ["bead_9_amplitude_N", "quoted", "2", "0.36", "5.3272", "-3.33", "-9.2"]
    assert not [*tmp_path.iterdir()]
