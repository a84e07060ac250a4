"""The calibration study: laws fitted to the quoted data, its tables, sentences, figures and section."""

import re
from collections.abc import Mapping
from math import inf, nan
from pathlib import Path

import pandas as pd
import pytest

from postproc.paper.calibrated import calibrated
from validation.calibration import calibration_chapter
from validation.calibration.calibration_chapter import CHAPTER, DATA, MAIN, PROFILES, REMARKS, judge, sentences
from validation.calibration.calibration_file import calibration_file
from validation.calibration.data_sets import paper_data
from validation.calibration.laws import fit_one
from validation.calibration.problem import MISSING_RESIDUAL, jacobian, pose, residual
from validation.calibration.rows import Parameter
from validation.chapters import frame_of, read_section, write_chapter
from validation.checks import FAIL, Check


def failed(tables: Mapping[str, pd.DataFrame]) -> list[Check]:
    return [check for check in judge(tables) if check.verdict == FAIL]


def test_fits_to_fig_4_give_tables_sentences_and_figures(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    whole = calibration_file()
    monkeypatch.setattr(
        calibration_chapter, "calibration_file", lambda: whole.model_copy(update={"selections": ("fig4",)})
    )
    laws = [law for law in whole.law if law.name in ("elastic theory", "viscoelastic")]
    parts = zip(*(fit_one(law, "fig4", False) for law in laws), strict=True)
    rows = {name: [row for each in part for row in each] for name, part in zip(CHAPTER.tables, parts, strict=True)}
    assert [*rows] == [MAIN, DATA, PROFILES, REMARKS]
    theory, fitted = sentences(write_chapter(CHAPTER, rows, tmp_path))
    assert "deviations in standard errors: fig4: force +9.2, fig4: speed +2.7" in theory
    assert "ptfe.youngs_modulus 1.01 ± 0.29 GPa (95 %: 0.54 .. 1.70 GPa); contact.restitution 0.729 ± 0.096" in fitted
    section = read_section("calibration", tmp_path)
    assert [fit["verdict"] for fit in section["summary"]] == ["no fit", "no test"]
    assert len(section["figures"]) == 2
    envelopes = {line["name"]: line["cells"][0][0] for line in section["data"] if "envelope through" in line["name"]}
    assert [float(value) for value in envelopes.values()] == pytest.approx([-0.0065, -0.0060, -0.0049], abs=6e-5)


def test_an_experiment_counts_once() -> None:
    """Row 2 of Table 1 is the wave of Fig. 4."""
    assert len(paper_data(["table1"], ())) == 5
    names = [each.name for each in paper_data(["fig4", "table1"], ())]
    assert names == ["fig4", "table1 row 1", "table1 row 3", "table1 row 4", "table1 row 5"]


def test_every_quoted_number_has_an_error_with_a_reason() -> None:
    """Errors are stated by the paper or assumed for a given reason."""
    for data in paper_data(["fig4", "table1", "fig5"], ()):
        for number in data.numbers:
            assert number.error > 0
            assert number.because or number.observable in ("bead_9_amplitude_N", "speed_9_to_5_m_s")


@pytest.mark.long
def test_dissipation_and_a_softer_bead_explain_all_quoted_data() -> None:
    """The best fit lies where the third maximum at the wall is about to vanish; a descent alone ends above it."""
    (law,) = [law for law in calibration_file().law if law.name == "viscoelastic"]
    parameters, data, _, remarks = fit_one(law, "fig4, table1, fig5", True)
    assert parameters[0].chi_square == pytest.approx(7.54, abs=0.1)
    assert parameters[0].value == pytest.approx(0.785e9, rel=0.02)
    assert all(abs(row.off) < 2 for row in data if row.counts)
    assert any("lies at this edge" in remark.sentence for remark in remarks)
    assert failed({MAIN: frame_of(Parameter, parameters)}) == []  # the figures are drawn with this fit


def test_a_fit_that_differs_from_the_parameters_of_the_figures_is_a_failure() -> None:
    """Differences above a tenth of the error in value or error fail, and so does a missing fit."""
    file = calibrated()

    def changed(**by_errors: float) -> list[Check]:
        fits = (
            Parameter(
                file.law, file.data, each.key, each.unit, each.value + by_errors.get("value", 0.0) * each.error,
                each.error * (1 + by_errors.get("error", 0.0)), nan, nan, nan, nan, 1.0, 1, 0.5,
            )
            for each in file.parameter
        )  # fmt: skip
        return failed({MAIN: frame_of(Parameter, fits)})

    assert changed(value=0.09) == changed(error=-0.09) == []
    for checks in (
        changed(value=0.11),
        changed(value=-0.11),
        changed(error=0.11),
        changed(value=nan),
        changed(error=inf),
    ):
        assert len(checks) == len(file.parameter)
    check = changed(value=0.11)[0]
    assert (check.scene, check.quantity) == ("inputs/paper/calibrated.toml", "materials.ptfe.youngs_modulus")
    assert re.match(r"7.845e\+08 ± .* Pa; the fit gives 7.9178e\+08 ± 6.62e\+07 Pa", check.where)
    check = failed({MAIN: frame_of(Parameter, ())})[0]
    assert (check.engine, check.where) == ("viscoelastic", f"{file.parameter[0].key}: no fit to fig4, table1, fig5")


def test_a_missing_number_counts_ten_standard_errors_and_has_no_slope() -> None:
    """At restitution 0.73 Fig. 5 has no third maximum at the wall, and so no envelope."""
    problem = pose(paper_data(["fig5"], ("contact.restitution=0.73",)), ("contact.restitution",))
    assert residual(problem, problem.start) == [MISSING_RESIDUAL]
    assert not jacobian(problem, problem.start).any()
