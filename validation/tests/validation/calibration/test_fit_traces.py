"""Fits to traces: parameters and their errors are right, and all laws have the same readings."""

from pathlib import Path

import pytest

from drivers.base.errors import InputError
from validation.calibration.fit import PARAMETERS, Tables, fit, solve
from validation.calibration.problem import pose, scene_data
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


def assert_found(tables: Tables, true: dict[str, float]) -> None:
    for key, value in true.items():
        row = parameter(tables, key)
        assert abs(row.value - value) < 3 * row.error, key


def test_a_fit_to_a_trace_recovers_its_parameters(trace: Path) -> None:
    data = short_data(trace)
    found, tables = solve(pose([data], (MODULUS, RESTITUTION)))
    assert_found(tables, TRUE | {"measured.0.trigger": 40e-6})
    row = parameter(tables, MODULUS)
    assert row.low_95pct < TRUE[MODULUS] < row.high_95pct
    assert row.error < 5e-3 * TRUE[MODULUS]
    assert (row.high_95pct - row.low_95pct) / 2 == pytest.approx(1.96 * row.error, rel=0.05)
    assert found.explained
    assert found.chi_square == pytest.approx(found.freedom, rel=0.2)
    lines = len(data.channels)  # the constants of their base lines
    assert found.freedom == found.problem.rows - len(found.place) - lines


def test_laws_are_compared_by_the_same_readings_from_any_start(trace: Path) -> None:
    laws = ("contact.restitution=", f"{MODULUS}=0.5 GPa"), ("contact.dissipation=power", "contact.gamma=2")
    first, second = (short_data(trace, *settings).channels[0] for settings in laws)
    assert (first.noise, first.window_s, first.counts.sum()) == (second.noise, second.window_s, second.counts.sum())


def test_gauges_of_one_file_share_their_trigger(trace: Path) -> None:
    entry = "{{ file = '{}', gauges = {{ {} = '{}_N' }}, gain_uncertainty = 0.05 }}"
    setting = f"measured=[{', '.join(entry.format(trace, gauge, gauge) for gauge in ('bead_9', 'bead_5'))}]"
    data = scene_data("fig4", (*SHORT, setting, f"{MODULUS}=1.1 GPa"))
    _, tables = solve(pose([data], (RESTITUTION,)), quick=True)
    labels = tables[PARAMETERS]["parameter"]
    assert [*labels[labels.str.contains("trigger")]] == ["fig4: measured.0.trigger"]
    true = {"measured.0.gain": 1.0, "measured.1.gain": 1.0, "measured.0.trigger": 40e-6}
    assert_found(tables, {RESTITUTION: TRUE[RESTITUTION]} | true)
    (_, both) = (f"measured.{place}.trigger={time} us" for place, time in enumerate((40, 41)))
    with pytest.raises(InputError, match="one trigger per file"):
        scene_data("fig4", (*SHORT, setting, "measured.0.trigger=40 us", both))


def test_a_long_record_counts_until_the_end_of_the_run(trace: Path) -> None:
    """Without a trigger, readings count for the run's duration after the first rise."""
    brief = (*SHORT, "run.duration=0.3 ms")
    given = scene_data("fig4", (*brief, f"measured=[{{ file = '{trace}', trigger = '40 us' }}]"))
    assert given.channels[0].counts.sum() == 341
    assert scene_data("fig4", brief, trace).channels[0].counts.sum() > 341


def test_a_parameter_of_one_data_set_is_found_with_its_trigger(trace: Path) -> None:
    """With one scene, a parameter of its own is the same model as a shared one."""
    data, keys = short_data(trace, "striker.speed=1 m/s"), ("striker.speed",)
    shared, own = (fit(pose([data], *free), [{}], search=False) for free in ((keys,), ((), keys)))
    assert own.chi_square == pytest.approx(shared.chi_square, rel=1e-4)
    assert own.errors == pytest.approx(shared.errors, rel=1e-2)


def test_a_stated_trigger_may_be_free(trace: Path) -> None:
    """Stated 10 us late; the run ends with the record, so its motion is computed for longer."""
    entry = f"measured=[{{ file = '{trace}', trigger = '50 us' }}]"
    data = scene_data("fig4", (*SHORT, entry, f"{MODULUS}=1.1 GPa"))
    _, tables = solve(pose([data], (RESTITUTION, "measured.trigger")), quick=True)
    assert_found(tables, {RESTITUTION: TRUE[RESTITUTION], "trigger": 40e-6})
