"""Fits: parameters of synthetic data are recovered, undetermined ones reported, and wrong input is refused."""

from collections.abc import Sequence
from dataclasses import replace
from math import inf
from pathlib import Path

import numpy as np
import pytest

from drivers.base.errors import InputError, RunError
from drivers.chain.case import Case
from drivers.scene.read_scene import read_scene
from postproc.paper.simulate import Simulation, case_of, exact
from postproc.read.alignment import averaged
from postproc.read.sensors import sensor_signals
from validation.calibration.data_sets import DataSet, MeasuredNumber, gauge_parameters, paper_data, scene_data
from validation.calibration.fit import Fit, fit, fitted_at, interval, profile, trade_offs
from validation.calibration.fit_command import LEGEND, lines
from validation.calibration.free import free_parameter
from validation.calibration.outcome import Outcome, Parameter, interval_text, solve, value_text
from validation.calibration.problem import (
    MISSING_RESIDUAL,
    Problem,
    jacobian,
    motion_values,
    pose,
    residual,
    simulated,
)  # fmt: skip
from validation.tests.helpers.commands import beads
from validation.tests.helpers.scenes import SceneWriter

MODULUS, RESTITUTION = "materials.ptfe.youngs_modulus", "contact.restitution"
TRUE = {MODULUS: 1.1e9, RESTITUTION: 0.85}
GAUGES = "sensors = [{ from_wall = 9, mass = '0.116 g' }, { from_wall = 5, mass = '0.116 g' }]"
SETTINGS = tuple(f"{key}={value}{' Pa' * (key == MODULUS)}" for key, value in TRUE.items())


def made_up(
    path: Path, *, settings: Sequence[str] = SETTINGS, noise: float = 0.02, seed: int = 0,
    gauges: Sequence[str] = ("bead_9", "bead_5", "wall"),
) -> Path:  # fmt: skip
    """Synthetic trace of Fig. 4, 40 us before the impact, with offsets and relative noise."""
    simulation, random = exact(case_of("fig4", *settings)), np.random.default_rng(seed)
    time, columns = np.arange(0.0, 0.82e-3, 1e-6), []
    for name, signal in sensor_signals(simulation.case.layout, simulation.trace).items():
        force = np.interp(time - 40e-6, simulation.trace.time_s, signal - signal[0], left=0.0)
        columns.append(force + random.normal(0.3, noise * force.max(), len(time)) if name in gauges else None)
    names = [f"{gauge}_N" for gauge in gauges]
    table = np.column_stack([time, *(column for column in columns if column is not None)])
    np.savetxt(path, table, delimiter=",", header=",".join(["time_s", *names]), comments="")
    return path


def parameter(outcome: Outcome, ending: str) -> Parameter:
    """The row of the parameter whose label has this ending."""
    return next(row for row in outcome.parameters if row.parameter.endswith(ending))


def observed(found: Fit, data: DataSet) -> dict[str, float]:
    """Observables of a data set's scene in the fitted motion."""
    simulation = simulated(data, motion_values(found.problem, data, found.place))
    assert simulation
    return simulation.values


def two_parameters() -> Problem:
    """Force and speed of Fig. 4, with free modulus and restitution."""
    return pose(paper_data(["fig4"], ()), (MODULUS, RESTITUTION))


def test_two_parameters_reproduce_force_and_speed_of_fig_4() -> None:
    """1008 MPa and 0.73 give 2.002 N and 151.99 m/s, and a width of 5.18 diameters at 4 %."""
    problem = two_parameters()
    found = fit(problem)
    assert found.values[MODULUS] == pytest.approx(1008e6, rel=5e-3)
    assert found.values[RESTITUTION] == pytest.approx(0.73, rel=5e-3)
    shown = observed(found, problem.sets[0])
    assert shown["bead_9_amplitude_N"] == pytest.approx(2.0, rel=1e-6)
    assert shown["speed_9_to_5_m_s"] == pytest.approx(152, rel=1e-6)
    assert shown["bead_5_width_4pct_diameters"] == pytest.approx(5.18, rel=5e-3)


def test_the_power_law_reproduces_them_with_another_modulus_and_width() -> None:
    """Independent Runge-Kutta integration: 1.02 GPa, width 4.93 at 4 %, envelope -0.0065 per us."""
    settings = ("contact.dissipation=power", "contact.gamma=1")
    problem = pose(paper_data(["fig4"], settings), (MODULUS, "contact.gamma"))
    found = fit(problem)
    assert found.values[MODULUS] == pytest.approx(1.02e9, rel=5e-3)
    assert observed(found, problem.sets[0])["bead_5_width_4pct_diameters"] == pytest.approx(4.93, rel=2e-3)
    (train,) = paper_data(["fig5"], settings)
    assert observed(found, train)["wall_envelope_per_s"] == pytest.approx(-0.0065e6, rel=1e-2)


def test_sensitivities_agree_with_wider_central_differences() -> None:
    problem = two_parameters()
    place = fit(problem).place
    for index in range(len(place)):
        step = np.zeros(len(place))
        step[index] = 1e-3
        central = (residual(problem, place + step) - residual(problem, place - step)) / 2e-3
        np.testing.assert_allclose(jacobian(problem, place)[:, index], central, rtol=2e-3)


def quoting(scene_file: SceneWriter, values: str, errors: str) -> Path:
    path = scene_file(count=21, chain=GAUGES, duration="0.8 ms")
    path.write_text(path.read_text() + f"[[measured]]\nvalues = {{ {values} }}\nerrors = {{ {errors} }}\n")
    return path


def test_one_gauge_cannot_distinguish_gain_and_modulus(scene_file: SceneWriter) -> None:
    path = quoting(scene_file, "bead_9_amplitude = '1 N'", "bead_9_amplitude = 0.05")
    outcome = solve(pose([scene_data(str(path), (), None)], (MODULUS, "measured.0.gain")))
    said = [*trade_offs(outcome.fit)]
    assert any(f"cannot distinguish {MODULUS} and scene: measured.0.gain:" in line for line in said), said
    along = next(line for line in said if "trade off" in line)
    assert f"{MODULUS} +10 %" in along
    assert float(along.rpartition("gain +")[2].rstrip(" %")) == pytest.approx(
        100 * (1.1**0.4 - 1), rel=0.05
    )  # F ~ E^(2/5)
    assert all(row.error == inf and np.isnan(row.low_95pct) for row in outcome.parameters)


def test_one_trace_barely_distinguishes_gain_modulus_and_strike(tmp_path: Path) -> None:
    """Without gravity, the three parameters can be changed together without an effect on the reading.

    The trigger trades off, too: its change is a time, since its zero is arbitrary.
    """
    data = scene_data("fig4", (), made_up(tmp_path / "trace.csv", gauges=["bead_9"]))
    keys = (MODULUS, "striker.speed", "measured.gain")
    outcome = solve(pose([data], keys), quick=True)
    (line,) = (line for line in trade_offs(outcome.fit) if "barely distinguish" in line)
    assert all(key in line for key in keys)
    assert "trigger" not in line or line.rpartition("trigger ")[2].endswith("s")


def test_a_datum_does_not_affect_the_prediction_without_it() -> None:
    (data,) = paper_data(["fig4"], ())
    numbers = [MeasuredNumber("bead_9_amplitude_N", 2.0, 0.1), MeasuredNumber("speed_9_to_5_m_s", 152.0, 5.0)]
    numbers.append(MeasuredNumber("bead_5_duration_4pct_s", 164e-6, 8e-6))

    def prediction_without(speed: float) -> tuple[float, float]:
        numbers[1] = MeasuredNumber("speed_9_to_5_m_s", speed, 5.0)
        sets = [DataSet("fig4", "fig4", data.tables, "here", tuple(numbers))]
        line = solve(pose(sets, (MODULUS, RESTITUTION))).data[1]
        return line.by_the_others, line.fitted

    (first, fitted), (second, moved) = prediction_without(152.0), prediction_without(140.0)
    assert second == pytest.approx(first, rel=1e-4)
    assert abs(moved - fitted) > 1.0


def test_without_a_necessary_datum_there_is_no_prediction() -> None:
    for line in solve(two_parameters()).data:
        assert np.isnan(line.by_the_others)


def test_a_profile_that_stays_low_up_to_a_bound_has_an_open_interval() -> None:
    problem = pose(paper_data(["fig4"], ()), (f"{MODULUS}=0.9 GPa..1.1 GPa", RESTITUTION))
    found = fit(problem)
    assert interval(found, 0, 1.0, profile(found, 0)) == (-inf, inf)
    row = replace(solve(problem, quick=True).parameters[0], value=1e9)
    assert interval_text(row, (-inf, inf)) == "(0.900) .. (1.100) GPa"


def test_a_parameter_at_the_end_of_its_range_is_reported() -> None:
    outcome = solve(pose(paper_data(["fig4"], ()), (f"{RESTITUTION}=0.9..0.95",)), quick=True)
    assert f"{RESTITUTION} is at the end of its range, 0.9" in outcome.row.remarks


def test_prior_knowledge_keeps_a_parameter_near_its_value() -> None:
    problem = pose(paper_data(["fig4"], ()), (MODULUS, RESTITUTION, "striker.speed=2.5±1%"))
    row = parameter(solve(problem, quick=True), "striker.speed")
    assert row.value == pytest.approx(2.5, rel=1e-3)
    assert row.error == pytest.approx(0.025, rel=0.05)


@pytest.mark.parametrize(
    ("text", "value", "error"),
    [
        ("striker.speed=0.30±1%", 0.30, 0.003),
        ("striker.speed = 0.30 m/s ± 1 %", 0.30, 0.003),
        ("chain.diameter=9.525±0.005 mm", 9.525e-3, 5e-6),
        ("chain.diameter=9.525 mm +- 5 um", 9.525e-3, 5e-6),
        (f"{RESTITUTION}=0.9+/-0.02", 0.9, 0.02),
        (f"{RESTITUTION}=0.97±0.01", 0.97, 0.01),
    ],
)
def test_prior_knowledge_is_a_value_with_an_error(text: str, value: float, error: float) -> None:
    found = free_parameter(text, read_scene("fig4"), "here")
    assert found.start == pytest.approx(value)
    assert found.prior == pytest.approx(error)
    assert found.low < value < found.high


def test_the_fit_at_a_known_minimum_is_the_same_fit() -> None:
    problem = two_parameters()
    found = fit(problem)
    assert fitted_at(problem, found.place).chi_square == found.chi_square < 1e-12


def test_averaging_readings_scales_their_noise(tmp_path: Path) -> None:
    fine = replace(scene_data("fig4", (), made_up(tmp_path / "trace.csv")).records[0].measured, noise=0.4)
    coarse = averaged(fine, 16.1e-6)
    assert len(coarse.time_s) == len(fine.time_s) // 8
    assert coarse.noise == pytest.approx(0.4 / 8**0.5)
    assert coarse.reading["wall"][3] == pytest.approx(fine.reading["wall"][24:32].mean())


def test_values_have_the_digits_of_their_errors() -> None:
    def text(value: float, error: float) -> str:
        ends = (0.0, 0.0, 0.0, 0.0)
        return value_text(Parameter("", "", MODULUS, "Pa", value, error, *ends, 1e9, 1e8, 1e12, 0.0))

    assert text(1.008603e9, 2.9e8) == "1.01 ± 0.29 GPa"
    assert text(186.92e9, 1e9) == "186.9 ± 1.0 GPa"
    assert text(1e9, inf) == "undetermined: 0.1 GPa to 1000 GPa"


@pytest.mark.parametrize(
    ("free", "found"),
    [
        ("chain.count", "21"),
        ("run.duration", "0.0016"),
        ("wall.material", "brass"),
        ("contact.bounce", "unknown key"),
        ("contact.restitutoin", "did you mean contact.restitution?"),
        (f"{MODULUS}=1 GPa±0%", "an error above 0"),
        (f"{MODULUS}=70±5", "or a unit"),
        (f"{MODULUS}=1 GPa", "1 GPa"),
        (f"{MODULUS}=2 GPa..1 GPa", "2e+09..1e+09"),
        (f"{MODULUS}=1 N..2 N", "1 N"),
        (f"{RESTITUTION}=0.5..2", "contact.restitution: found 2"),
        ("measured.0.gain", "unknown gauge parameter"),
        ("contact.alpha", 'contact.dissipation = "viscoelastic"'),
    ],
)
def test_unsuitable_free_parameters_are_refused(free: str, found: str) -> None:
    with pytest.raises(InputError) as refused:
        pose(paper_data(["fig4"], ()), (free,))
    assert found in str(refused.value)
    assert "allowed:" in str(refused.value) or "did you mean" in str(refused.value)


def test_repeated_parameters_and_three_dimensional_scenes_are_refused() -> None:
    with pytest.raises(InputError, match="twice"):
        pose(paper_data(["fig4"], ()), (RESTITUTION, RESTITUTION))
    with pytest.raises(InputError, match="models it"):
        paper_data(["fig4"], ("chain.lateral_offset=10 um",))


def test_a_parameter_without_a_value_or_a_range_needs_bounds() -> None:
    scene = read_scene("fig4", ("tube=",))
    with pytest.raises(InputError, match="no starting value"):
        free_parameter("chain.precompression", scene, "here")
    assert free_parameter("chain.precompression=0 N..1 N", scene, "here").value(0.5) == 0.5


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["fig4"], "--free"),
        (["--free", RESTITUTION], "no scene"),
        (["fig4", "--free", RESTITUTION], "add a [[measured]] table to the scene file, or give --measured"),
        (
            ["fig4", "--free", RESTITUTION, "--quoted", "fig9"],
            "did you mean fig5?; allowed: comma-separated names from",
        ),
        (["fig4", "--law", "plastic", "--quoted", "fig4"], "elastic, viscoelastic, power"),
        (["fig4", "--law", "elastic", "--quoted", "fig4"], "no free parameter"),
        (
            ["fig4", "--free", RESTITUTION, "--quoted", "fig4", "--quick", "--predict", "wall_paek"],
            "did you mean wall_peak?",
        ),
        (["fig4", "--free", RESTITUTION, "--quoted", "fig4,fig4"], "each data set once"),
        (["fig4", "--free", RESTITUTION, "--quoted", "fig4", "--measured", "x.csv"], "cannot be combined"),
        (["fig4", "--free", RESTITUTION, "--measured", "nowhere.csv"], "found no such file"),
    ],
)
def test_wrong_requests_end_in_one_line(words: list[str], message: str, tmp_path: Path) -> None:
    done = beads("fit", *words, "--results", tmp_path / "results")
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr.count("\n") == 1
    assert message in done.stderr


@pytest.mark.parametrize("key", ["measured.gain", "measured.0.gain"])
def test_a_single_gauge_entry_needs_no_number(key: str, tmp_path: Path) -> None:
    file_alone = scene_data("fig4", (), made_up(tmp_path / "trace.csv"))
    entry = f"measured=[{{file='{tmp_path / 'trace.csv'}'}}]"
    for data, own in ((file_alone, "measured.gain"), (scene_data("fig4", (entry,), None), "measured.0.gain")):
        assert [free.key for free in gauge_parameters(data, [key])] == [own, own.replace("gain", "trigger")]
    twice = replace(file_alone, entries={f"measured.{place}": file_alone.entries["measured"] for place in (0, 1)})
    with pytest.raises(InputError, match=r"allowed: measured\.0\.gain, measured\.1\.gain"):
        gauge_parameters(twice, ["measured.gain"])


def test_the_printed_tables_have_only_filled_columns() -> None:
    quick = solve(two_parameters(), quick=True)
    said = [*lines(quick)]
    assert said[0].split("  ")[0] == "parameter"
    assert LEGEND[0] in said
    assert LEGEND[1] not in said
    (heading,) = (line for line in said if line.startswith("datum"))
    assert heading.split() == ["datum", "measured", "fitted", "deviation"]


def test_errors_are_enlarged_where_the_model_does_not_explain_the_data() -> None:
    """Elastic beads cannot give both the measured force and the measured speed."""
    problem = pose(paper_data(["fig4"], ("contact.restitution=",)), (f"{MODULUS}=1.4 GPa..1.5 GPa",))
    outcome = solve(problem, quick=True)
    assert not outcome.explained
    assert outcome.enlargement == pytest.approx(np.sqrt(outcome.fit.chi_square))
    assert any(f"enlarged {outcome.enlargement:.2g} times" in line for line in lines(outcome))
    assert "the model does not explain the data" in [*lines(outcome)]


def test_a_missing_number_counts_ten_standard_errors_and_has_no_slope(scene_file: SceneWriter) -> None:
    """At a restitution of 0.73 the wall shows no third maximum."""
    path = quoting(scene_file, "wall_peak_3 = '1 N'", "wall_peak_3 = 0.05")
    problem = pose([scene_data(str(path), ("contact.restitution=0.73",))], (RESTITUTION,))
    assert residual(problem, problem.start) == [MISSING_RESIDUAL]
    assert not jacobian(problem, problem.start).any()


GLASS = """gravity = "9.81 m/s^2"
[materials.borosilicate]
youngs_modulus = "63 GPa"
poisson_ratio = 0.2
density = "2230 kg/m^3"
[chain]
count = 16
material = "borosilicate"
diameter = "5 mm"
sensors = [{ from_wall = 12 }, { from_wall = 4 }]
[striker]
material = "steel"
diameter = "5 mm"
speed = "0.6264 m/s"
[wall]
material = "steel"
[run]
duration = "0.6 ms"
sample_interval = "0.5 us"
time_step = "50 ns"
"""


@pytest.mark.parametrize(
    ("restitution", "tolerance"), [(0.9464630234378835, 1e-6), (0.9315601020946589, 1e-6), (0.9152761582644078, 1e-7)]
)
def test_the_exact_motion_exists_where_the_first_release_is_late(
    restitution: float, tolerance: float, tmp_path: Path
) -> None:
    """Here Newton's method cannot find the time of the first release to 4e-16: s**4 has a larger rounding error."""
    scene = tmp_path / "glass.toml"
    scene.write_text(GLASS, encoding="utf-8")
    case = case_of(scene, f"{RESTITUTION}={restitution}")
    found, finer = exact(case, tolerance).trace.force_N, exact(case).trace.force_N
    assert np.abs(found - finer).max() < tolerance * np.abs(finer).max()


def without_motion(monkeypatch: pytest.MonkeyPatch, above: float) -> None:
    """Lets the integration fail for restitutions above a limit."""

    def integrated(case: Case, tolerance: float) -> Simulation:
        if case.scene.contact.given.get("restitution", 1.0) > above:
            raise ArithmeticError("its steps become too small")
        return exact(case, tolerance)

    simulated.cache_clear()
    monkeypatch.setattr("validation.calibration.problem.exact", integrated)


def test_a_fit_avoids_points_without_a_motion(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """The best point, 0.85, has no motion: the fit ends at the edge of the gap."""
    problem = pose([scene_data("fig4", (f"{MODULUS}=1.1 GPa",), made_up(tmp_path / "trace.csv"))], (RESTITUTION,))
    without_motion(monkeypatch, above=0.8)
    found = fit(problem)
    simulated.cache_clear()
    assert found.values[RESTITUTION] == pytest.approx(0.8, abs=2e-3)
    assert np.isfinite(found.residual).all()
    without_motion(monkeypatch, above=0.0)
    with pytest.raises(RunError, match="cannot be computed at the starting values or at any other point"):
        fit(replace(problem))
    simulated.cache_clear()
