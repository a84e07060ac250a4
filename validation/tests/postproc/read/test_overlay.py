"""Measured traces compared with computed ones: triggers, baselines, pulses with errors, remarks, refused records."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from scipy.interpolate import make_interp_spline

from drivers.base.errors import InputError
from drivers.chain.trace import part_of
from postproc.draw.overlay import gain_remark, length_remark, misfits
from postproc.read.alignment import AlignedGauge, align, noise_of, residual_of, rounding_of
from postproc.read.measured import MeasuredTrace
from postproc.read.motion import Simulation, case_of, exact
from postproc.read.observables import observe
from postproc.read.signals import sensor_signals
from validation.tests.helpers import made_up_trace
from validation.tests.helpers.commands import beads
from validation.tests.helpers.runs import assessed, edit_record
from validation.tests.helpers.scenes import SceneWriter

TRIGGER_S = 123.456e-6
OTHER = ("materials.ptfe.youngs_modulus=1.2 GPa", "contact.restitution=0.95")  # settings of another motion
GAIN, BASELINE, DRIFT = 2.1, 0.3, 400.0  # N/V, V, V/s
SEEDS = 10
COVERAGE = 2.0  # standard errors, which contain 95 of 100 normal deviates


@pytest.fixture(scope="module")
def base() -> Simulation:
    return exact(case_of("fig4"))


@pytest.fixture(scope="module")
def other() -> Simulation:
    return exact(case_of("fig4", *OTHER))


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


def found_in(trace: MeasuredTrace, base: Simulation) -> tuple[list[AlignedGauge], dict[str, Any]]:
    gauges = align([trace], base)
    table = misfits(gauges, base, {})
    return gauges, {str(row.quantity): row for row in table.itertuples()}


def exact_motion_of(made: Simulation, gauges: list[AlignedGauge]) -> dict[str, float]:
    """Observables of the measured motion, with the impulses over the compared readings."""
    values = observe(made.case.layout, made.trace)
    for gauge in gauges:
        signal = sensor_signals(made.case.layout, made.trace)[gauge.channel.gauge]
        force_N = make_interp_spline(made.trace.time_s, signal - signal[0], k=5)(gauge.time_s)
        values[f"{gauge.channel.gauge}_impulse_N_s"] = float(np.trapezoid(force_N, gauge.time_s))
        values[f"{gauge.channel.gauge}_baseline_V"] = BASELINE + DRIFT * TRIGGER_S
    return values | {"trigger_s": TRIGGER_S}


def test_measured_values_are_within_their_errors(base: Simulation, other: Simulation) -> None:
    """At 1 and 3 % noise 95 of 100 values are within two small standard errors; the residual is the noise."""
    within: dict[str, list[bool]] = {}
    for made, noise, given in ((other, 0.01, True), (base, 0.03, False)):
        for seed in range(SEEDS):
            trace = measured(made, noise, seed)
            gauges, rows = found_in(replace(trace, trigger_s=TRIGGER_S) if given else trace, base)
            truth = exact_motion_of(made, gauges)
            for name, row in rows.items():
                if name in truth and row.standard_error > 0:
                    within.setdefault(name, []).append(abs(row.measured - truth[name]) <= COVERAGE * row.standard_error)
    assert len(within) == 17
    shares = {name: np.mean(hits) for name, hits in within.items()}
    assert np.mean([hit for hits in within.values() for hit in hits]) == pytest.approx(0.955, abs=0.03), shares
    assert min(shares.values()) >= 0.75, shares
    _, rows = found_in(measured(base, 0.01), base)
    for name, share in (("bead_9_amplitude_N", 5e-3), ("wall_amplitude_N", 5e-3), ("speed_9_to_5_m_s", 0.01)):
        assert rows[name].standard_error < share * rows[name].measured, name
    assert 0 < rows["trigger_s"].standard_error < 5e-8
    assert rows["wall_residual_rms_N"].measured == pytest.approx(0.01 * base.values["wall_amplitude_N"], rel=0.15)
    assert rows["wall_residual_rms_N"].standard_error == pytest.approx(0.01 * base.values["wall_amplitude_N"], rel=0.1)
    assert rows["wall_correlation"].measured > 0.998


def test_readings_without_noise_give_the_observables_of_the_run(base: Simulation) -> None:
    gauges, rows = found_in(measured(base), base)
    assert rows["trigger_s"].measured == pytest.approx(TRIGGER_S, abs=1e-9)
    for name, row in rows.items():
        if name in base.values:
            assert row.computed == base.values[name]
            assert row.measured == pytest.approx(row.computed, rel=2e-3), name
    for gauge in gauges:
        assert np.abs(gauge.force_N - gauge.computed_N).max() < 2e-3 * gauge.computed_N.max()
        digits = np.round(gauge.channel.trace.reading[gauge.channel.gauge], 1)
        assert noise_of(gauge.channel.trace.time_s, digits, rounding_of(digits))[0] >= 0.999 * 0.1 / 12**0.5, (
            "the rounding at least"
        )


def test_given_values_are_used(base: Simulation) -> None:
    trace = replace(measured(base, 0.01), trigger_s=TRIGGER_S + 5e-6, noise=0.02, gain_uncertainty=0.1)
    gauges, rows = found_in(trace, base)
    assert (rows["trigger_s"].measured, rows["trigger_s"].standard_error) == (TRIGGER_S + 5e-6, 0.0)
    assert [gauge.channel.noise_N for gauge in gauges] == pytest.approx([0.02 * GAIN] * 3)
    assert rows["bead_9_arrival_s"].difference == pytest.approx(-5e-6, abs=1e-6)
    assert rows["wall_amplitude_N"].error_by_gain == pytest.approx(0.1 * rows["wall_amplitude_N"].measured)
    assert rows["wall_amplitude_N"].standard_error > rows["wall_amplitude_N"].error_by_gain
    flat = {name: reading - DRIFT * trace.time_s for name, reading in trace.reading.items()}
    rested, _ = found_in(replace(trace, reading=flat, drift=False, baseline=BASELINE), base)
    assert [gauge.baseline for gauge in rested] == pytest.approx([BASELINE] * 3)
    assert not any(gauge.rest_error_N.any() for gauge in rested)


def test_readings_may_be_irregular_few_or_many(base: Simulation) -> None:
    end_s = TRIGGER_S + float(base.trace.time_s[-1])
    random = np.random.default_rng(3)
    for times_s in (np.sort(random.uniform(0, end_s, 700)), np.arange(0, end_s, 8e-6), np.arange(0, 3 * end_s, 1e-8)):
        trace = measured(base, 0.02, times_s=times_s)
        noise_N = noise_of(times_s, trace.reading["wall"], 0.0)[0] * GAIN
        assert noise_N == pytest.approx(0.02 * base.values["wall_amplitude_N"], rel=0.4)
        gauges, rows = found_in(trace, base)
        for name in ("bead_9_amplitude_N", "bead_5_arrival_s", "wall_amplitude_N", "speed_9_to_5_m_s", "trigger_s"):
            truth = exact_motion_of(base, gauges)[name]
            assert abs(rows[name].measured - truth) < 4 * rows[name].standard_error, (name, len(times_s))
        assert max(len(gauge.time_s) for gauge in gauges) <= 2.1 * len(base.trace.time_s)


def test_readings_averaged_in_blocks_are_compared_with_the_mean_of_the_motion(base: Simulation) -> None:
    """Blocks of 2 us: the force of a bead in their middle differs from the mean by up to 5e-4 of the peak."""
    trace = replace(measured(base, interval_us=0.5), trigger_s=TRIGGER_S, noise=1e-4)
    coarse = part_of(base.trace, np.arange(0, len(base.trace.time_s), 5))
    for gauge in align([trace], replace(base, trace=coarse))[:2]:  # the samples of a run miss cusps at the wall
        most_N = 1e-4 * base.values[f"{gauge.channel.gauge}_amplitude_N"]
        assert np.abs(gauge.force_N - gauge.computed_N).max() < most_N, gauge.channel.gauge
        off = residual_of(gauge.channel, replace(base, trace=coarse).curves[gauge.channel.gauge], GAIN, TRIGGER_S)
        assert np.abs(off).max() * gauge.channel.noise_N < most_N, gauge.channel.gauge


def test_gauges_of_one_file_have_one_trigger(base: Simulation) -> None:
    """Gauges in separate entries give the same result as in one entry."""
    whole = measured(base, 0.02)
    parts = [replace(whole, reading={name: reading}) for name, reading in whole.reading.items()]
    together, apart = (align(traces, base) for traces in ([whole], parts))
    assert [gauge.channel.trigger_s for gauge in apart] == [gauge.channel.trigger_s for gauge in together]
    for one, two in zip(together, apart, strict=True):
        assert np.array_equal(one.force_N, two.force_N)
    with pytest.raises(InputError, match="one trigger per file"):
        align([replace(part, trigger_s=i * 1e-6) for i, part in enumerate(parts)], base)


def cut(trace: MeasuredTrace, start_us: float, stop_us: float, *gauges: str) -> MeasuredTrace:
    """Readings of some gauges, or all, within a time."""
    kept = (trace.time_s >= start_us * 1e-6) & (trace.time_s <= stop_us * 1e-6)
    reading = {name: trace.reading[name][kept] for name in gauges or trace.reading}
    return replace(trace, time_s=trace.time_s[kept], reading=reading)


@pytest.mark.parametrize(
    ("start_us", "stop_us", "interval_us", "trigger_us", "gauges", "found"),
    [
        (0, 900, 1, 2000, (), "0 readings from -2000"),
        (0, 900, 1, 890, (), "11 readings from -890"),
        (0, 300, 1, 123.456, (), "us after the trigger"),
        (0, 900, 60, None, (), "13 readings from -123"),
        (430, 490, 1, 123.456, ("bead_9",), "0 quiet readings of bead_9"),
    ],
)
def test_records_that_cannot_be_compared_are_named(
    base: Simulation, start_us: float, stop_us: float, interval_us: float, trigger_us: float | None,
    gauges: tuple[str, ...], found: str,
) -> None:  # fmt: skip
    trace = cut(measured(base, 0.01, interval_us=interval_us), start_us, stop_us, *gauges)
    with pytest.raises(InputError) as caught:
        align([replace(trace, trigger_s=trigger_us and trigger_us * 1e-6)], base)
    assert caught.value.args[0].endswith("shot.csv")
    assert found in caught.value.args[2]
    assert "\n" not in str(caught.value)


def test_a_wrong_unit_of_time_and_a_run_at_rest_are_named(base: Simulation) -> None:
    trace = measured(base)
    still = replace(base.trace, force_N=np.zeros_like(base.trace.force_N))
    for factor, run, found in (
        (1e-6, base.trace, "is the unit of time s rather than us?"),
        (100, base.trace, "is the unit of time us rather than ms?"),
        (1, still, "at rest in the run"),
    ):
        with pytest.raises(InputError) as caught:
            align([replace(trace, time_s=factor * trace.time_s)], replace(base, trace=run))
        assert found in str(caught.value)


@pytest.mark.parametrize(
    ("stop_us", "gain", "length", "on_gain"),
    [
        (1100, GAIN, "", ""),
        (9000, GAIN, "ms after the impact, the run until 0.8 ms", ""),
        (600, GAIN, "the run until 0.8 ms, so the wave does not reach it", ""),
        (1100, GAIN * 700, "", '1000 times the computed force (mV read as V?): measured.0.gain = "1.47 N/V" fits'),
        (1100, -GAIN / 3e3, "", "inverted and readings are about 0.001 times the computed force (V read as mV?)"),
    ],
)
def test_remarks_name_lengths_and_gains(
    base: Simulation, other: Simulation, stop_us: float, gain: float, length: str, on_gain: str
) -> None:
    """Also for noise and a motion of another shape, with the trigger given or found."""
    times_s = np.arange(0, stop_us * 1e-6, 1e-6)
    for made, noise, trigger_s in ((base, 0.01, None), (other, 0.1, None), (other, 0.01, TRIGGER_S)):
        trace = replace(measured(made, noise, times_s=times_s), gain=gain, trigger_s=trigger_s)
        gauges = align([trace], base)
        remark = length_remark(gauges[-1], float(base.trace.time_s[-1]))
        assert (length in remark) if length else not remark
        remarks = [gain_remark(gauge) for gauge in gauges]
        assert (on_gain in remarks[0]) if on_gain else remarks == [""] * 3


def overlay(*words: str | Path) -> tuple[int, str, str]:
    done = beads("overlay", *words)
    return done.returncode, done.stdout, done.stderr


def rows_of(path: Path) -> dict[tuple[str, str], dict[str, Any]]:
    """Rows of a table of misfits by quantity and source."""
    rows: list[dict[Any, Any]] = pd.read_csv(path).to_dict("records")
    return {(row["quantity"], row["source"]): row for row in rows}


def test_the_command_compares_the_example_with_the_exact_motion(tmp_path: Path) -> None:
    """The table holds the true values, and remarks on a short run and a wrong gain go to standard error."""
    settings = ("run.duration=0.6 ms", "measured.0.gain=2100 N/V")
    words = [word for setting in settings for word in ("--set", setting)]
    code, said, wrong = overlay("example-measured", *words, "--results", tmp_path)
    assert code == 0
    length, gain = wrong.splitlines()
    assert "bead_9, bead_5, wall: readings from -0.04 to 0.778 ms after the impact, the run until 0.6 ms" in length
    assert "bead_9, bead_5: readings are about 1000 times the computed force (mV read as V?): measured.0.gain" in gain
    rows, truth = rows_of(tmp_path / "overlay-example-measured.csv"), made_up_trace.true_values()
    for gauge, factor in (("bead_9", 1e3), ("bead_5", 1e3), ("wall", 1.0)):
        for name, scale in ((f"{gauge}_amplitude_N", factor), (f"{gauge}_arrival_s", 1.0)):
            row = rows[name, made_up_trace.FILE.name]
            assert abs(row["measured"] - scale * truth[name]) < 3 * row["error_by_noise"], name
            assert abs(row["difference_in_errors"]) > 2, name
            assert name in said
    assert rows["speed_9_to_5_m_s", "quoted"]["measured"] == 184.0
    assert rows["speed_9_to_5_m_s", "quoted"]["standard_error"] == pytest.approx(3.68)
    assert {path.suffix for path in tmp_path.glob("[!.]*")} == {".csv", ".png", ".svg"}


def test_the_plan_reads_the_measured_files() -> None:
    said = beads("plan", "example-measured")
    assert "measured   inputs/measured/example-measured.csv: 410 readings of bead_9, bead_5\n" in said.stdout


def test_runs_are_compared_with_files_and_with_the_scene_as_it_is_now(
    scene_file: SceneWriter, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The run's own signals, as if measured, have its peak; quoted values are those of the scene named."""
    monkeypatch.chdir(tmp_path)
    scene = scene_file(
        "mine", top='[[measured]]\nvalues = { wall_peak = "1 N" }\nerrors = { wall_peak = 0.1 }\nsource = "a book"'
    )
    folder = assessed(case_of(scene), "verlet", tmp_path / "runs").folder
    edit_record(folder, scene_name="other")
    code, said, wrong = overlay("verlet:mine", "--runs", tmp_path / "runs", "--results", tmp_path)
    assert (code, wrong) == (0, "")
    assert "wall_peak" in said
    code, said, wrong = overlay(folder, "--measured", folder / "sensors.csv", "--results", tmp_path / "own")
    assert (code, wrong) == (0, "")
    peak = rows_of(next((tmp_path / "own").glob("*.csv")))["wall_amplitude_N", "sensors.csv"]
    assert abs(peak["difference"]) < 1e-3 * peak["computed"]
    assert "quoted" not in said


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("fig4",), "fig4: measured: no measured data: add a [[measured]] table"),
        (("fig4", "--measured", made_up_trace.FILE), "measured.0.gauges: found headings"),
        (("verlet:example-measured", "--set", "chain.count=9"), "not allowed for a finished run"),
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
