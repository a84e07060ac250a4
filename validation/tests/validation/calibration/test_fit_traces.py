"""Fits to traces: parameters and their errors are right, and all laws have the same readings."""

from pathlib import Path

import numpy as np
import pytest

from drivers.base.errors import InputError
from validation.calibration.data_sets import scene_data
from validation.calibration.fit import fit
from validation.calibration.outcome import Outcome, solve
from validation.calibration.problem import pose
from validation.tests.validation.calibration.test_fit import MODULUS, RESTITUTION, TRUE, made_up, parameter


def assert_found(outcome: Outcome, true: dict[str, float]) -> None:
    for key, value in true.items():
        row = parameter(outcome, key)
        assert abs(row.value - value) < 3 * row.error, key


def test_a_fit_to_a_trace_recovers_its_parameters(tmp_path: Path) -> None:
    data = scene_data("fig4", (), made_up(tmp_path / "trace.csv"))
    outcome = solve(pose([data], (MODULUS, RESTITUTION)))
    assert_found(outcome, TRUE | {"measured.trigger": 40e-6})
    row = parameter(outcome, MODULUS)
    assert row.low_95pct < TRUE[MODULUS] < row.high_95pct
    assert row.error < 3e-3 * TRUE[MODULUS]
    assert (row.high_95pct - row.low_95pct) / 2 == pytest.approx(1.96 * row.error, rel=0.05)
    assert outcome.explained
    assert outcome.fit.chi_square == pytest.approx(outcome.fit.freedom, rel=0.2)
    gauges = sum(len(record.measured.reading) for record in data.records)  # each with the constant of its base line
    assert outcome.fit.freedom == outcome.fit.problem.rows - len(outcome.fit.place) - gauges


REPEATS = 20
LAWS = {
    "elastic": ("contact.restitution=",),
    "viscoelastic": ("contact.restitution=0.9",),
    "power": ("contact.dissipation=power", "contact.gamma=2"),
}


def test_errors_are_the_scatter_of_repeats(tmp_path: Path) -> None:
    """Noise of 5 %: deviations in standard errors have a mean square of 1, and chi-square is that of noise."""
    start, off, chi_square = TRUE | {"fig4: measured.trigger": 40e-6}, [], []
    for seed in range(REPEATS):
        data = scene_data("fig4", (), made_up(tmp_path / "trace.csv", noise=0.05, seed=seed))
        found = fit(pose([data], (MODULUS, RESTITUTION)), [start], search=False)
        chi_square.append(found.chi_square / found.freedom)
        off.append((np.array([*found.values.values()]) - [*start.values()]) / found.errors)
    assert np.mean(np.square(off)) == pytest.approx(1.0, abs=0.35)
    assert np.mean(np.abs(off) < 1.96) > 0.88
    assert np.mean(chi_square) == pytest.approx(1.0, abs=0.03)


def test_laws_are_compared_by_the_same_readings_from_any_start(tmp_path: Path) -> None:
    trace = made_up(tmp_path / "trace.csv")
    records = [
        scene_data("fig4", (*LAWS[law], f"{MODULUS}={start} GPa"), trace).records[0]
        for law in LAWS
        for start in (0.5, 2.0)
    ]
    for record in records[1:]:
        assert (record.noise, record.window_s, record.rows) == (records[0].noise, records[0].window_s, records[0].rows)


def test_gauges_of_one_file_share_their_trigger(tmp_path: Path) -> None:
    trace = made_up(tmp_path / "trace.csv")
    entry = "{{ file = '{}', gauges = {{ {} = '{}_N' }}, gain_uncertainty = 0.05 }}"
    setting = f"measured=[{', '.join(entry.format(trace, gauge, gauge) for gauge in ('bead_9', 'bead_5'))}]"
    data = scene_data("fig4", (setting, f"{MODULUS}=1.1 GPa"))
    outcome = solve(pose([data], (RESTITUTION,)), quick=True)
    assert [row.parameter for row in outcome.parameters if "trigger" in row.parameter] == ["fig4: measured.0.trigger"]
    true = {"measured.0.gain": 1.0, "measured.1.gain": 1.0, "measured.0.trigger": 40e-6}
    assert_found(outcome, {RESTITUTION: TRUE[RESTITUTION]} | true)
    (_, both) = (f"measured.{place}.trigger={time} us" for place, time in enumerate((40, 41)))
    with pytest.raises(InputError, match="one trigger per file"):
        scene_data("fig4", (setting, "measured.0.trigger=40 us", both))


def test_a_long_record_counts_until_the_end_of_the_run(tmp_path: Path) -> None:
    """Without a trigger, readings count for the run's duration after the first rise, at 0.29 ms."""
    trace = made_up(tmp_path / "trace.csv")
    entry = f"measured=[{{ file = '{trace}', trigger = '40 us' }}]"
    given, found = (
        scene_data("fig4", ("run.duration=0.5 ms", *more), file) for more, file in (((entry,), None), ((), trace))
    )
    assert given.records[0].rows == 541
    assert found.records[0].rows > 541


def test_a_parameter_of_one_data_set_is_found_with_its_trigger(tmp_path: Path) -> None:
    """With one scene, a parameter of its own is the same model as a shared one."""
    data, keys = scene_data("fig4", ("striker.speed=1 m/s",), made_up(tmp_path / "trace.csv")), ("striker.speed",)
    shared, own = fit(pose([data], keys)), fit(pose([data], (), keys))
    assert own.chi_square == pytest.approx(shared.chi_square, rel=1e-4)
    assert own.errors == pytest.approx(shared.errors, rel=1e-2)


def test_a_stated_trigger_may_be_free(tmp_path: Path) -> None:
    """Stated 10 us late; the run ends with the record, so its motion is computed for longer."""
    entry = f"measured=[{{ file = '{made_up(tmp_path / 'trace.csv')}', trigger = '50 us' }}]"
    data = scene_data("fig4", (entry, f"{MODULUS}=1.1 GPa"), free_trigger=True)
    outcome = solve(pose([data], (RESTITUTION, "measured.trigger")), quick=True)
    assert_found(outcome, {RESTITUTION: TRUE[RESTITUTION], "trigger": 40e-6})
