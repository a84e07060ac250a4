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
from validation.calibration.certainty import RISES, Certainty, predictions, profile
from validation.calibration.data_sets import DataSet, MeasuredNumber, gauge_parameters, paper_data, scene_data
from validation.calibration.fit import fit, fitted_at
from validation.calibration.fit_command import LEGEND, FitRequest, lines, write_fitted
from validation.calibration.free import Free, free_parameter
from validation.calibration.outcome import interval_text, solve, value_text
from validation.calibration.problem import Problem, jacobian, own_values, pose, predicted, residual, simulated
from validation.tests.helpers.commands import beads
from validation.tests.helpers.scenes import SceneWriter

MODULUS, RESTITUTION = "materials.ptfe.youngs_modulus", "contact.restitution"
TRUE = {MODULUS: 1.1e9, RESTITUTION: 0.85}
GAUGES = "sensors = [{ from_wall = 9, mass = '0.116 g' }, { from_wall = 5, mass = '0.116 g' }]"


def made_up(
    path: Path, *, noise: float = 0.02, seed: int = 0, gauges: Sequence[str] = ("bead_9", "bead_5", "wall")
) -> Path:
    """Synthetic trace of Fig. 4 with ``TRUE`` parameters, 40 us before the impact, offsets, and relative noise."""
    settings = (f"{MODULUS}={TRUE[MODULUS]} Pa", f"{RESTITUTION}={TRUE[RESTITUTION]}")
    simulation, random = exact(case_of("fig4", *settings)), np.random.default_rng(seed)
    time, columns = np.arange(0.0, 0.82e-3, 1e-6), []
    for name, signal in sensor_signals(simulation.case.layout, simulation.trace).items():
        force = np.interp(time - 40e-6, simulation.trace.time_s, signal - signal[0], left=0.0)
        columns.append(force + random.normal(0.3, noise * force.max(), len(time)) if name in gauges else None)
    names = [f"{gauge}_N" for gauge in gauges]
    table = np.column_stack([time, *(column for column in columns if column is not None)])
    np.savetxt(path, table, delimiter=",", header=",".join(["time_s", *names]), comments="")
    return path


def two_parameters() -> Problem:
    """Force and speed of Fig. 4, with free modulus and restitution."""
    return pose(paper_data(["fig4"], ()), (MODULUS, RESTITUTION))


def test_two_parameters_reproduce_force_and_speed_of_fig_4() -> None:
    """1008 MPa and 0.73 give 2.002 N and 151.99 m/s, and a width of 5.18 diameters at 4 %."""
    problem = two_parameters()
    found = fit(problem)
    assert found.values[MODULUS] == pytest.approx(1008e6, rel=5e-3)
    assert found.values[RESTITUTION] == pytest.approx(0.73, rel=5e-3)
    shown = predicted(problem.sets[0], own_values(problem, problem.sets[0], found.place))
    assert shown["bead_9_amplitude_N"] == pytest.approx(2.0, rel=1e-6)
    assert shown["speed_9_to_5_m_s"] == pytest.approx(152, rel=1e-6)
    assert shown["bead_5_width_4pct_diameters"] == pytest.approx(5.18, rel=5e-3)


def test_the_power_law_reproduces_them_with_another_modulus_and_width() -> None:
    """Independent Runge-Kutta integration: 1.02 GPa, width 4.93 at 4 %, envelope -0.0065 per us."""
    settings = ("contact.dissipation=power", "contact.gamma=1")
    problem = pose(paper_data(["fig4"], settings), (MODULUS, "contact.gamma"))
    found = fit(problem)
    assert found.values[MODULUS] == pytest.approx(1.02e9, rel=5e-3)
    values = own_values(problem, problem.sets[0], found.place)
    assert predicted(problem.sets[0], values)["bead_5_width_4pct_diameters"] == pytest.approx(4.93, rel=2e-3)
    (train,) = paper_data(["fig5"], settings)
    assert predicted(train, values)["wall_envelope_per_s"] == pytest.approx(-0.0065e6, rel=1e-2)


def test_sensitivities_agree_with_wider_central_differences() -> None:
    problem = two_parameters()
    place = fit(problem).place
    for index in range(2):
        step = np.zeros(2)
        step[index] = 1e-3
        central = (residual(problem, place + step) - residual(problem, place - step)) / 2e-3
        np.testing.assert_allclose(jacobian(problem, place)[:, index], central, rtol=2e-3)


def test_a_fit_to_a_trace_recovers_its_parameters(tmp_path: Path) -> None:
    data = scene_data("fig4", (), made_up(tmp_path / "trace.csv"))
    outcome = solve(pose([data], (MODULUS, RESTITUTION)))
    found = dict(zip([free.key for free in outcome.fit.problem.free], outcome.certainty.errors, strict=True))
    for key, true in (TRUE | {"measured.trigger": 40e-6}).items():
        value = next(value for label, value in outcome.fit.values.items() if label.endswith(key))
        assert abs(value - true) < 3 * found[key], key
    assert found[MODULUS] < 3e-3 * TRUE[MODULUS]
    assert outcome.explained
    assert outcome.fit.chi_square == pytest.approx(outcome.fit.freedom, rel=0.2)
    low, high = outcome.profiles[MODULUS].interval(RISES["95 %"])
    assert (high - low) / 2 == pytest.approx(1.96 * found[MODULUS], rel=0.05)


@pytest.mark.long
@pytest.mark.timeout(600)
def test_the_true_values_lie_within_95_percent_errors_in_95_of_100_repeats(tmp_path: Path) -> None:
    """95 of 100 draws of noise lie within 1.96 standard errors, up to 2.5 standard deviations of the count."""
    inside = {MODULUS: 0, RESTITUTION: 0}
    for seed in range(100):
        data = scene_data("fig4", (), made_up(tmp_path / "trace.csv", seed=seed))
        problem = pose([data], (MODULUS, RESTITUTION))
        found = fit(problem)
        errors = Certainty(found).errors
        for index, key in enumerate(inside):
            inside[key] += bool(abs(found.values[key] - TRUE[key]) < 1.96 * errors[index])
    assert 89.5 < min(inside.values()) <= max(inside.values()) < 100, inside


def quoting(scene_file: SceneWriter, values: str, errors: str) -> Path:
    path = scene_file(count=21, chain=GAUGES, duration="0.8 ms")
    path.write_text(path.read_text() + f"[[measured]]\nvalues = {{ {values} }}\nerrors = {{ {errors} }}\n")
    return path


def test_one_gauge_cannot_distinguish_gain_and_modulus(scene_file: SceneWriter) -> None:
    path = quoting(scene_file, "bead_9_amplitude = '1 N'", "bead_9_amplitude = 0.05")
    outcome = solve(pose([scene_data(str(path), (), None)], (MODULUS, "measured.0.gain")))
    said = [*outcome.sentences()]
    assert any(f"cannot distinguish {MODULUS} and scene: measured.0.gain:" in line for line in said), said
    along = next(line for line in said if "trade off" in line)
    assert f"{MODULUS} +10 %" in along
    assert float(along.rpartition("gain +")[2].rstrip(" %")) == pytest.approx(
        100 * (1.1**0.4 - 1), rel=0.05
    )  # F ~ E^(2/5)
    assert (outcome.certainty.errors == inf).all()
    assert not outcome.profiles


def test_one_trace_barely_distinguishes_gain_modulus_and_strike(tmp_path: Path) -> None:
    """Without gravity, the three parameters can be changed together without an effect on the reading."""
    data = scene_data("fig4", (), made_up(tmp_path / "trace.csv", gauges=["bead_9"]))
    keys = (MODULUS, "striker.speed", "measured.gain")
    outcome = solve(pose([data], keys), quick=True)
    assert any("barely distinguish" in line and all(key in line for key in keys) for line in outcome.sentences())


def test_a_datum_does_not_affect_the_prediction_without_it() -> None:
    (data,) = paper_data(["fig4"], ())
    numbers = [MeasuredNumber("bead_9_amplitude_N", 2.0, 0.1), MeasuredNumber("speed_9_to_5_m_s", 152.0, 5.0)]
    numbers.append(MeasuredNumber("bead_5_duration_4pct_s", 164e-6, 8e-6))

    def prediction_without(speed: float) -> tuple[float, float]:
        numbers[1] = MeasuredNumber("speed_9_to_5_m_s", speed, 5.0)
        sets = [DataSet("fig4", "fig4", data.tables, "here", tuple(numbers))]
        _, line, _ = predictions(fit(pose(sets, (MODULUS, RESTITUTION))))
        return line.without, line.fitted

    (first, fitted), (second, moved) = prediction_without(152.0), prediction_without(140.0)
    assert second == pytest.approx(first, rel=1e-4)
    assert abs(moved - fitted) > 1.0


def test_without_a_necessary_datum_there_is_no_prediction() -> None:
    for line in predictions(fit(two_parameters())):
        assert np.isnan(line.without)


def test_a_profile_that_stays_low_up_to_a_bound_has_an_open_interval() -> None:
    problem = pose(paper_data(["fig4"], ()), (f"{MODULUS}=0.9 GPa..1.1 GPa", RESTITUTION))
    found = fit(problem)
    low, high = profile(found, 0).interval(1.0)
    assert (low, high) == (-inf, inf)
    free, error = problem.free[0], float(Certainty(found).errors[0])
    assert interval_text(free, (low, high), 1e9, error) == "(0.900) .. (1.100) GPa"


def test_a_parameter_at_the_end_of_its_range_is_reported() -> None:
    outcome = solve(pose(paper_data(["fig4"], ()), (f"{RESTITUTION}=0.9..0.95",)), quick=True)
    assert f"{RESTITUTION} is at the end of its range, 0.9" in [*outcome.sentences()]


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
    free = Free(MODULUS, "Pa", 1e9, 1e8, 1e10)
    assert value_text(free, 1.008603e9, 2.9e8) == "1.01 ± 0.29 GPa"
    assert value_text(free, 1.1014e9, 1.4e6) == "1.1014 ± 0.0014 GPa"
    assert value_text(free, 1e9, inf) == "undetermined: 0.1 GPa to 10 GPa"


def test_a_fitted_scene_has_its_comments_and_the_fitted_values(tmp_path: Path) -> None:
    trace = made_up(tmp_path / "trace.csv")
    outcome = solve(
        pose([scene_data("table1", ("chain.count=21", "run.duration=0.8 ms"), trace)], (RESTITUTION,)), quick=True
    )
    path = write_fitted("table1", ("chain.count=21",), outcome, tmp_path / "results")
    assert "# the amplitudes of the table correspond to" in path.read_text()
    scene = read_scene(path)
    assert (scene.name, scene.chain.count) == ("fit-table1", 21)
    assert scene.contact.restitution == pytest.approx(outcome.fit.values[RESTITUTION], rel=1e-5)
    (entry,) = scene.measured
    assert (scene.folder / str(entry.file)).samefile(trace)
    assert entry.trigger == pytest.approx(outcome.fit.values["table1: measured.trigger"], rel=1e-5)


def test_a_value_in_an_inline_table_is_replaced_there(tmp_path: Path) -> None:
    """A comment inside an inline table is invalid TOML."""
    outcome = solve(pose(paper_data(["fig4"], ()), ("chain.sensors.0.mass", RESTITUTION)), quick=True)
    scene = read_scene(write_fitted("fig4", (), outcome, tmp_path))
    assert scene.chain.sensors[0].mass == pytest.approx(outcome.fit.values["chain.sensors.0.mass"], rel=1e-5)


def test_a_fitted_scene_keeps_triggers_that_are_given(tmp_path: Path) -> None:
    data = [scene_data("example-measured", (), None)]
    outcome = solve(pose(data, (RESTITUTION,)), quick=True)
    scene = read_scene(write_fitted("example-measured", (), outcome, tmp_path))
    assert [entry.trigger for entry in scene.measured] == [entry.trigger for entry in data[0].entries.values()]


@pytest.mark.parametrize(
    ("free", "found"),
    [
        ("chain.count", "21"),
        ("run.duration", "0.0014"),
        ("wall.material", "brass"),
        ("contact.bounce", "unknown key"),
        (f"{MODULUS}=1 GPa", "1 GPa"),
        (f"{MODULUS}=2 GPa..1 GPa", "2e+09..1e+09"),
        (f"{MODULUS}=1 N..2 N", "1 N"),
        ("measured.0.gain", "unknown gauge parameter"),
        ("contact.alpha", 'contact.dissipation = "viscoelastic"'),
    ],
)
def test_unsuitable_free_parameters_are_refused(free: str, found: str) -> None:
    with pytest.raises(InputError) as refused:
        pose(paper_data(["fig4"], ()), (free,))
    assert found in str(refused.value)
    assert "allowed:" in str(refused.value)


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
        (["fig4", "--free", RESTITUTION, "--quoted", "fig9"], "fig4, table1, fig5"),
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


def test_a_trace_with_a_wrong_unit_of_time_is_refused(tmp_path: Path) -> None:
    trace = made_up(tmp_path / "trace.csv")
    trace.write_text(trace.read_text().replace("time_s", "time_ms"))
    with pytest.raises(InputError, match=r"run\.duration"):
        scene_data("fig4", (), trace)


def test_the_command_writes_tables_and_the_scene(tmp_path: Path) -> None:
    free = ("--free", MODULUS, "--free", RESTITUTION)
    done = beads("fit", "fig4", *free, "--quoted", "fig4", "--quick", "--results", tmp_path)
    assert done.returncode == 0, done.stderr
    assert "1.01 ± 0.29 GPa" in done.stdout
    assert {path.name for path in tmp_path.glob("[!.]*")} == {"fit-fig4.csv", "fit-fig4-data.csv", "fit-fig4.toml"}
    assert FitRequest(("fig4",), free).quoted == ()


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
    assert said[0].split() == ["parameter", "value", "start"]
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
        if (case.scene.contact.restitution or 1.0) > above:
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
