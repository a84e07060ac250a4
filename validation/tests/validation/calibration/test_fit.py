"""Fits: parameters of synthetic data are recovered, undetermined ones reported, and wrong input is refused."""

from dataclasses import replace
from math import inf
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pandas as pd
import pytest

from drivers.base.errors import InputError, RunError
from drivers.chain.case import Case
from drivers.scene.read_scene import read_scene
from postproc.read.motion import Simulation, case_of, exact
from postproc.read.signals import sensor_signals
from validation.calibration.command import comparison, lines
from validation.calibration.command import fit as fit_laws
from validation.calibration.fit import (
    DATA,
    LAWS,
    PARAMETERS,
    Fit,
    Tables,
    fit,
    interval,
    profile,
    rows_of,
    solve,
    trade_offs,
    value_text,
)
from validation.calibration.parameters import free_parameter
from validation.calibration.problem import (
    MISSING_RESIDUAL,
    DataSet,
    Datum,
    _of_set,
    paper_data,
    parameters_of,
    pose,
    scene_data,
    simulated,
)
from validation.tests.helpers.commands import assert_in_order, beads
from validation.tests.helpers.scenes import SceneWriter

MODULUS, RESTITUTION = "materials.ptfe.youngs_modulus", "contact.restitution"
TRUE = {MODULUS: 1.1e9, RESTITUTION: 0.85}
GAUGES = "sensors = [{ from_wall = 9, mass = '0.116 g' }, { from_wall = 5, mass = '0.116 g' }]"
SETTINGS = tuple(f"{key}={value}{' Pa' * (key == MODULUS)}" for key, value in TRUE.items())
SHORT = ("chain.count=11", "run.duration=0.5 ms")  # of Fig. 4, for quick fits


def made_up(path: Path, *settings: str, noise: float = 0.02) -> Path:
    """Synthetic trace of a short Fig. 4, 40 us before the impact, with offsets and relative noise."""
    simulation, random = exact(case_of("fig4", *SHORT, *(settings or SETTINGS))), np.random.default_rng(0)
    clock_s = simulation.trace.time_s
    time, columns = np.arange(0.0, clock_s[-1] + 20e-6, 1e-6), dict[str, np.ndarray]()
    for name, signal in sensor_signals(simulation.case.layout, simulation.trace).items():
        force = np.interp(time - 40e-6, clock_s, signal - signal[0], left=0.0)
        columns[f"{name}_N"] = force + random.normal(0.3, noise * force.max(), len(time))
    pd.DataFrame({"time_s": time} | columns).to_csv(path, index=False)
    return path


def short_data(trace: Path, *settings: str) -> DataSet:
    return scene_data("fig4", (*SHORT, *settings), trace)


def parameter(tables: Tables, ending: str) -> Any:
    """The row of the parameter whose label has this ending."""
    return next(row for row in rows_of(tables[PARAMETERS]) if row.parameter.endswith(ending))


@pytest.fixture(scope="module")
def outcome() -> tuple[Fit, Tables]:
    """The fit of modulus and restitution to force and speed of Fig. 4."""
    return solve(pose(paper_data(["fig4"], ()), (MODULUS, RESTITUTION)))


def test_two_parameters_reproduce_force_and_speed_of_fig_4(outcome: tuple[Fit, Tables]) -> None:
    """1008 MPa and 0.73 give 2.002 N and 151.99 m/s, a width of 5.18 diameters, and no prediction without either."""
    found, (data,) = outcome[0], outcome[0].problem.sets
    assert found.values[MODULUS] == pytest.approx(1008e6, rel=5e-3)
    assert found.values[RESTITUTION] == pytest.approx(0.73, rel=5e-3)
    simulation = found.problem.motion(data, found.place)
    assert simulation
    assert simulation.values["bead_9_amplitude_N"] == pytest.approx(2.0, rel=1e-6)
    assert simulation.values["speed_9_to_5_m_s"] == pytest.approx(152, rel=1e-6)
    assert simulation.values["bead_5_width_4pct_diameters"] == pytest.approx(5.18, rel=5e-3)
    assert Fit(found.problem, found.place).chi_square == found.chi_square < 1e-12
    assert found.freedom == 0, "two numbers and two scales with priors, four parameters"


def test_sensitivities_and_errors_agree_with_wider_central_differences(outcome: tuple[Fit, Tables]) -> None:
    """The errors of as many parameters as numbers are those of the inverted sensitivities."""
    (found, tables) = outcome
    problem, place = found.problem, found.place
    central = np.empty((len(place), len(place)))
    for index, step in enumerate(1e-3 * np.eye(len(place))):
        central[:, index] = (problem.residual(place + step) - problem.residual(place - step)) / 2e-3
    np.testing.assert_allclose(problem.jacobian(place), central, rtol=2e-3)
    slopes = [free.slope(float(x)) for free, x in zip(problem.free, place, strict=True)]
    errors = np.abs(slopes) * np.linalg.norm(np.linalg.inv(central), axis=1)
    assert [*tables[PARAMETERS]["error"]] == pytest.approx(errors, rel=1e-2)


def test_nearly_dependent_sensitivities_are_reported(outcome: tuple[Fit, Tables]) -> None:
    """Two parameters of almost the same effect trade off."""
    sensitivities = 1e3 * np.eye(len(outcome[0].place))
    sensitivities[:2, 1] = 1e3, 50.0
    found = replace(outcome[0])
    vars(found)["jacobian"] = sensitivities
    (line,) = trade_offs(found)
    assert line.startswith(f"the data barely distinguish {MODULUS} and {RESTITUTION}: they trade off along {MODULUS} ")


def quoting(scene_file: SceneWriter, values: str, errors: str) -> Path:
    path = scene_file(count=21, chain=GAUGES, duration="0.8 ms")
    path.write_text(path.read_text() + f"[[measured]]\nvalues = {{ {values} }}\nerrors = {{ {errors} }}\n")
    return path


def test_gains_of_quoted_forces_are_free_with_their_error(scene_file: SceneWriter) -> None:
    path = quoting(scene_file, "bead_9_amplitude = '1 N'", "bead_9_amplitude = 0.05")
    path.write_text(f"{path.read_text()}gain_uncertainty = 0.04\n")
    modulus, gain = parameters_of([scene_data(str(path))], (MODULUS,), ())
    assert (modulus.key, gain.key) == (MODULUS, "measured.0.gain")
    assert (gain.start, gain.prior) == (1.0, 0.04)


def test_one_gauge_cannot_distinguish_gain_and_modulus(scene_file: SceneWriter) -> None:
    path = quoting(scene_file, "bead_9_amplitude = '1 N'", "bead_9_amplitude = 0.05")
    found, tables = solve(pose([scene_data(str(path), (), None)], (MODULUS, "measured.0.gain")))
    said = [*trade_offs(found)]
    assert any(f"cannot distinguish {MODULUS} and scene: measured.0.gain:" in line for line in said), said
    along = next(line for line in said if f"trade off along {MODULUS} +10 %" in line)
    gain = float(along.rpartition("gain +")[2].rstrip(" %"))
    assert gain == pytest.approx(100 * (1.1**0.4 - 1), rel=0.05), "F ~ E^(2/5)"
    assert all(row.error == inf and np.isnan(row.low_95pct) for row in rows_of(tables[PARAMETERS]))


def test_chi_square_without_a_number_is_that_of_a_fit_to_the_others() -> None:
    (data,) = paper_data(["fig4"], ())
    numbers = [
        Datum("bead_9_amplitude_N", 2.0, 0.1),
        Datum("speed_9_to_5_m_s", 145.0, 5.0),
        Datum("bead_5_amplitude_N", 1.9, 0.1),
    ]

    def table_of(*chosen: Datum) -> Tables:
        return solve(pose([DataSet("fig4", "fig4", data.tables, "here", chosen)], (MODULUS,)))[1]

    for number, row in zip(numbers, rows_of(table_of(*numbers)[DATA]), strict=True):
        (others,) = rows_of(table_of(*(each for each in numbers if each != number))[LAWS])
        assert row.chi_square_without == pytest.approx(others.chi_square, rel=0.02, abs=0.02), number.name


def test_a_profile_that_stays_low_up_to_a_bound_has_an_open_interval() -> None:
    problem = pose(paper_data(["fig4"], ()), (f"{MODULUS}=0.9 GPa..1.1 GPa", RESTITUTION))
    found = fit(problem, [{MODULUS: 1.008e9, RESTITUTION: 0.73}], search=False)
    assert interval(found, 0, 1.0, profile(found, 0)) == (-inf, inf)


def test_a_range_ends_a_parameter_and_prior_knowledge_keeps_it_near_its_value() -> None:
    def solved(free: str) -> Any:
        _, tables = solve(pose(paper_data(["fig4"], ()), (f"{RESTITUTION}={free}",)), quick=True)
        return parameter(tables, RESTITUTION)

    assert value_text(solved("0.9..0.95")).endswith("(at its lower bound)")
    row = solved("0.9±0.001")
    assert not row.at
    assert row.value == pytest.approx(0.9, rel=1e-3)
    assert row.error == pytest.approx(0.001, rel=0.05)


def test_prior_knowledge_is_a_value_with_an_error() -> None:
    for text, value, error in (
        ("striker.speed = 0.30 m/s ± 1 %", 0.30, 0.003),
        ("chain.diameter=9.525±0.005 mm", 9.525e-3, 5e-6),
        ("chain.diameter=9.525 mm +- 5 um", 9.525e-3, 5e-6),
        (f"{RESTITUTION}=0.9+/-0.02", 0.9, 0.02),
        (f"{MODULUS}=1e9±5e7", 1e9, 5e7),
    ):
        free = free_parameter(text, read_scene("fig4"), "here")
        assert (free.start, free.prior) == pytest.approx((value, error))
        assert free.low < value < free.high


def test_values_have_the_digits_of_their_errors() -> None:
    def text(value: float, error: float) -> str:
        return value_text(SimpleNamespace(unit="Pa", value=value, error=error, at="", least=1e8, most=1e12))

    assert text(1.008603e9, 2.9e8) == "1.01 ± 0.29 GPa"
    assert text(186.92e9, 1e9) == "186.9 ± 1.0 GPa"
    assert text(1e9, inf) == "undetermined: 0.1 GPa to 1000 GPa"


@pytest.mark.parametrize(
    ("free", "found", "allowed"),
    [
        ("chain.count", "chain.count", "allowed:"),
        ("wall.material", "wall.material", "allowed:"),
        ("contact.restitutoin", "", "did you mean contact.restitution?"),
        (f"{MODULUS}=70±5", "", "or a unit"),
        (f"{MODULUS}=2 GPa..1 GPa", "2 GPa..1 GPa", "allowed:"),
        (f"{RESTITUTION}=0.5..2", "contact.restitution: found 2", "allowed:"),
        ("measured.0.gain", "measured.0.gain", "allowed: none"),
        ("contact.alpha", 'contact.dissipation = "viscoelastic"', ""),
        ("chain.precompression", "no starting value", ""),
        ("sensor.time_constant=±1%", "found ±1%", "which the scene may state"),
    ],
)
def test_unsuitable_free_parameters_are_refused(free: str, found: str, allowed: str) -> None:
    with pytest.raises(InputError) as refused:
        pose(paper_data(["fig4"], ("tube=",)), (free,))
    assert_in_order(str(refused.value), found, allowed)


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["fig4"], "--free"),
        (["fig4", "--free", RESTITUTION], "add a [[measured]] table to the scene file, or give --measured"),
        (["--free", RESTITUTION, "--quoted", "fig9"], "did you mean fig5?"),
        (["--law", "plastic", "--quoted", "fig4"], "did you mean elastic?"),
        (["--law", "power,1.5", "--quoted", "fig4"], "--law power: found 1.5; allowed: constants as KEY=VALUE"),
        (["--free", RESTITUTION, "--quoted", "fig4,fig4"], "each once"),
        (
            ["fig4", "--free", RESTITUTION, "--quoted", "fig4", "--measured", "x.csv"],
            "--quoted: not allowed with scenes",
        ),
        (["fig4", "--free", RESTITUTION, "--measured", "nowhere.csv"], "found no such file"),
    ],
)
def test_wrong_requests_end_in_one_line(words: list[str], message: str, tmp_path: Path) -> None:
    done = beads("fit", *words, "--results", tmp_path / "results")
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr.count("\n") == 1
    assert message in done.stderr


def test_errors_are_enlarged_where_the_model_does_not_explain_the_data() -> None:
    """Elastic beads cannot give both the measured force and the measured speed."""
    problem = pose(paper_data(["fig4"], ("contact.restitution=",)), (f"{MODULUS}=1.4 GPa..1.5 GPa",))
    found, tables = solve(problem, quick=True)
    said = [*lines(found, tables)]
    assert not found.explained
    assert found.enlargement == pytest.approx(np.sqrt(found.chi_square))
    assert any(f"enlarged {found.enlargement:.3g} times" in line for line in said)
    assert "the model does not explain the data" in said


def test_a_law_without_parameters_is_compared_by_its_chi_square(scene_file: SceneWriter, tmp_path: Path) -> None:
    """Elastic beads have no parameter of dissipation, and a speed has no gain."""
    path = quoting(
        scene_file, "speed_9_to_5 = '100 m/s', wall_arrival = '0.7 ms'", "speed_9_to_5 = 0.01, wall_arrival = 0.01"
    )
    fitted = fit_laws(path, laws=("elastic", "viscoelastic"), quick=True, results=tmp_path)
    elastic, viscoelastic = fitted.fits.values()
    assert (elastic.values, elastic.freedom) == ({}, 2)
    assert ([*viscoelastic.values], viscoelastic.freedom) == ([RESTITUTION], 1)
    assert elastic.chi_square > viscoelastic.chi_square
    assert "no law explains the data; viscoelastic comes nearest" in [*comparison(fitted)]


def test_a_missing_number_counts_ten_standard_errors_and_has_no_slope(scene_file: SceneWriter) -> None:
    """At a restitution of 0.73 the wall shows no third maximum."""
    path = quoting(scene_file, "wall_peak_3 = '1 N'", "wall_peak_3 = 0.05")
    problem = pose([scene_data(str(path), ("contact.restitution=0.73",))], (RESTITUTION,))
    assert problem.residual(problem.start) == [MISSING_RESIDUAL]
    assert not problem.jacobian(problem.start).any()


def without_motion(monkeypatch: pytest.MonkeyPatch, above: float) -> None:
    """Lets the integration fail for restitutions above a limit."""

    def integrated(case: Case, tolerance: float) -> Simulation:
        if (case.scene.contact.restitution or 1.0) > above:
            raise ArithmeticError("its steps become too small")
        return exact(case, tolerance)

    simulated.cache_clear()
    _of_set.cache_clear()
    monkeypatch.setattr("validation.calibration.problem.exact", integrated)


def test_a_fit_avoids_points_without_a_motion(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """The best point, 0.85, has no motion: the fit ends at the edge of the gap."""
    problem = pose([short_data(made_up(tmp_path / "trace.csv"), f"{MODULUS}=1.1 GPa")], (RESTITUTION,))
    without_motion(monkeypatch, above=0.8)
    found = fit(problem)
    simulated.cache_clear()
    assert found.values[RESTITUTION] == pytest.approx(0.8, abs=2e-3)
    assert np.isfinite(found.residual).all()
    without_motion(monkeypatch, above=0.0)
    with pytest.raises(RunError, match="cannot be computed at the starting values or at any other point"):
        fit(replace(problem))
    simulated.cache_clear()
