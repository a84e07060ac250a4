"""The calibration study: laws fitted to what the paper quotes, its tables, sentences, figures and section."""

from math import inf, nan
from pathlib import Path

import pytest

from postproc.paper.calibrated import calibrated
from validation.calibration import calibration_study
from validation.calibration.calibration_study import DATA, MAIN, PROFILES, REMARKS, STUDY, missed, sentences
from validation.calibration.data_sets import paper_data
from validation.calibration.laws import fit_one, plan
from validation.calibration.problem import NOT_SEEN, jacobian, pose, residual
from validation.calibration.rows import Parameter
from validation.studies import frame_of, read_section, write_study


def test_laws_on_fig_4_are_written_told_and_drawn(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    whole = plan()
    monkeypatch.setattr(calibration_study, "plan", lambda: whole.model_copy(update={"selections": ("fig4",)}))
    laws = [law for law in whole.law if law.name in ("elastic theory", "viscoelastic")]
    parts = zip(*(fit_one(law, "fig4", False) for law in laws), strict=True)
    rows = {name: [row for each in part for row in each] for name, part in zip(STUDY.tables, parts, strict=True)}
    assert [*rows] == [MAIN, DATA, PROFILES, REMARKS]
    theory, fitted = sentences(write_study(STUDY, rows, tmp_path))
    assert "missed, in standard errors: fig4: force by +9.2, fig4: speed by +2.7" in theory
    assert "ptfe.youngs_modulus 1.01 ± 0.29 GPa (95 %: 0.54 .. 1.70 GPa); contact.restitution 0.729 ± 0.096" in fitted
    section = read_section("calibration", tmp_path)
    assert [fit["verdict"] for fit in section["summary"]] == ["no fit", "no test"]
    assert len(section["figures"]) == 2
    envelopes = {line["name"]: line["cells"][0][0] for line in section["data"] if "envelope through" in line["name"]}
    assert [float(value) for value in envelopes.values()] == pytest.approx([-0.0065, -0.0060, -0.0049], abs=6e-5)


def test_an_experiment_counts_once() -> None:
    """The second row of Table 1 is the wave of Fig. 4."""
    assert len(paper_data(["table1"], ())) == 5
    names = [each.name for each in paper_data(["fig4", "table1"], ())]
    assert names == ["fig4", "table1 row 1", "table1 row 3", "table1 row 4", "table1 row 5"]


def test_what_is_quoted_has_an_error_with_a_reason() -> None:
    """Stated by the paper, or assumed because of something."""
    for data in paper_data(["fig4", "table1", "fig5"], ()):
        for number in data.numbers:
            assert number.error > 0
            assert number.because or number.observable in ("bead_9_amplitude_N", "speed_9_to_5_m_s")


@pytest.mark.long
def test_dissipation_and_a_softer_bead_explain_all_that_is_quoted() -> None:
    """The best fit rests where the wall's third maximum is about to vanish: a descent alone ends above it."""
    (law,) = [law for law in plan().law if law.name == "viscoelastic"]
    parameters, data, _, remarks = fit_one(law, "fig4, table1, fig5", True)
    assert parameters[0].chi_square == pytest.approx(7.54, abs=0.1)
    assert parameters[0].value == pytest.approx(0.785e9, rel=0.02)
    assert all(abs(row.off) < 2 for row in data if row.counts)
    assert any("rests at that edge" in remark.sentence for remark in remarks)
    assert missed({MAIN: frame_of(Parameter, parameters)}) == []  # the figures are drawn with this fit


def test_a_fit_that_departs_from_the_parameters_of_the_figures_is_a_failure() -> None:
    """By more than a tenth of the error, in the value or in the error; and one that is not there."""
    file = calibrated()

    def told(**by_errors: float) -> list[str]:
        fits = (
            Parameter(
                file.law, file.data, each.key, each.unit, each.value + by_errors.get("value", 0.0) * each.error,
                each.error * (1 + by_errors.get("error", 0.0)), nan, nan, nan, nan, 1.0, 1, 0.5,
            )
            for each in file.parameter
        )  # fmt: skip
        return missed({MAIN: frame_of(Parameter, fits)})

    assert told(value=0.09) == told(error=-0.09) == []
    for lines in (told(value=0.11), told(value=-0.11), told(error=0.11), told(value=nan), told(error=inf)):
        assert len(lines) == len(file.parameter)
    assert told(value=0.11)[0].startswith("inputs/paper/calibrated.toml: materials.ptfe.youngs_modulus: 7.845e+08 ± ")
    assert told(value=0.11)[0].endswith("Pa; the fit gives 7.9178e+08 ± 6.62e+07 Pa")
    assert "no fit of the law viscoelastic to fig4, table1, fig5" in missed({MAIN: frame_of(Parameter, ())})[0]


def test_what_is_not_seen_counts_ten_standard_errors_and_has_no_slope() -> None:
    """At 0.73 Fig. 5's wall shows no third maximum, so no envelope."""
    problem = pose(paper_data(["fig5"], ("contact.restitution=0.73",)), ("contact.restitution",))
    assert residual(problem, problem.start) == [NOT_SEEN]
    assert not jacobian(problem, problem.start).any()
