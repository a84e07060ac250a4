"""Fits to traces: parameters and their errors are right, and all laws have the same readings."""

from pathlib import Path

import pytest

from drivers.base.errors import InputError
from validation.calibration.data_sets import scene_data
from validation.calibration.fit import fit
from validation.calibration.outcome import Outcome, solve
from validation.calibration.problem import pose
from validation.tests.validation.calibration.test_fit import (
    MODULUS,
    RESTITUTION,
    SHORT,
    TRUE,
    made_up,
    parameter,
    short_data,
)


@pytest.fixture(scope="module")
def trace(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return made_up(tmp_path_factory.mktemp("measured") / "trace.csv")


def assert_found(outcome: Outcome, true: dict[str, float]) -> None:
    for key, value in true.items():
        row = parameter(outcome, key)
        assert abs(row.value - value) < 3 * row.error, key


def test_a_fit_to_a_trace_recovers_its_parameters(trace: Path) -> None:
    data = short_data(trace)
    outcome = solve(pose([data], (MODULUS, RESTITUTION)))
    assert_found(outcome, TRUE | {"measured.trigger": 40e-6})
    row = parameter(outcome, MODULUS)
    assert row.low_95pct < TRUE[MODULUS] < row.high_95pct
    assert row.error < 5e-3 * TRUE[MODULUS]
    assert (row.high_95pct - row.low_95pct) / 2 == pytest.approx(1.96 * row.error, rel=0.05)
    assert outcome.explained
    assert outcome.fit.chi_square == pytest.approx(outcome.fit.freedom, rel=0.2)
    gauges = sum(len(record.measured.reading) for record in data.records)  # each with the constant of its base line
    assert outcome.fit.freedom == outcome.fit.problem.rows - len(outcome.fit.place) - gauges


def test_laws_are_compared_by_the_same_readings_from_any_start(trace: Path) -> None:
    laws = ("contact.restitution=", f"{MODULUS}=0.5 GPa"), ("contact.dissipation=power", "contact.gamma=2")
    first, second = (short_data(trace, *settings).records[0] for settings in laws)
    assert (first.noise, first.window_s, first.rows) == (second.noise, second.window_s, second.rows)


def test_gauges_of_one_file_share_their_trigger(trace: Path) -> None:
    entry = "{{ file = '{}', gauges = {{ {} = '{}_N' }}, gain_uncertainty = 0.05 }}"
    setting = f"measured=[{', '.join(entry.format(trace, gauge, gauge) for gauge in ('bead_9', 'bead_5'))}]"
    data = scene_data("fig4", (*SHORT, setting, f"{MODULUS}=1.1 GPa"))
    outcome = solve(pose([data], (RESTITUTION,)), quick=True)
    assert [row.parameter for row in outcome.parameters if "trigger" in row.parameter] == ["fig4: measured.0.trigger"]
    true = {"measured.0.gain": 1.0, "measured.1.gain": 1.0, "measured.0.trigger": 40e-6}
    assert_found(outcome, {RESTITUTION: TRUE[RESTITUTION]} | true)
    (_, both) = (f"measured.{place}.trigger={time} us" for place, time in enumerate((40, 41)))
    with pytest.raises(InputError, match="one trigger per file"):
        scene_data("fig4", (*SHORT, setting, "measured.0.trigger=40 us", both))


def test_a_long_record_counts_until_the_end_of_the_run(trace: Path) -> None:
    """Without a trigger, readings count for the run's duration after the first rise."""
    brief = (*SHORT, "run.duration=0.3 ms")
    given = scene_data("fig4", (*brief, f"measured=[{{ file = '{trace}', trigger = '40 us' }}]"))
    assert given.records[0].rows == 341
    assert scene_data("fig4", brief, trace).records[0].rows > 341


def test_a_parameter_of_one_data_set_is_found_with_its_trigger(trace: Path) -> None:
    """With one scene, a parameter of its own is the same model as a shared one."""
    data, keys = short_data(trace, "striker.speed=1 m/s"), ("striker.speed",)
    shared, own = (fit(pose([data], *free), [{}], search=False) for free in ((keys,), ((), keys)))
    assert own.chi_square == pytest.approx(shared.chi_square, rel=1e-4)
    assert own.errors == pytest.approx(shared.errors, rel=1e-2)


def test_a_stated_trigger_may_be_free(trace: Path) -> None:
    """Stated 10 us late; the run ends with the record, so its motion is computed for longer."""
    entry = f"measured=[{{ file = '{trace}', trigger = '50 us' }}]"
    data = scene_data("fig4", (*SHORT, entry, f"{MODULUS}=1.1 GPa"), free_trigger=True)
    outcome = solve(pose([data], (RESTITUTION, "measured.trigger")), quick=True)
    assert_found(outcome, {RESTITUTION: TRUE[RESTITUTION], "trigger": 40e-6})
