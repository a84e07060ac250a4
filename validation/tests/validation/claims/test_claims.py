"""The paper's statements: the list, the judgement, the numbers."""

from dataclasses import replace
from functools import partial
from math import nan
from pathlib import Path

import pandas as pd
import pytest

from drivers.base import paths
from drivers.base.errors import InputError
from drivers.chain.case import Case
from postproc.paper import quoted
from postproc.paper.strikes import COLUMNS
from postproc.read.motion import Simulation, exact
from validation.chapters.claims import Claim, Reading, chapter_of, check_of, fault_of, favoured, read_claims
from validation.checks import DIFFERS, REPRODUCED, Check
from validation.claims.chains import table1
from validation.report.scene_section import case_rows
from validation.tests.validation.claims.published import published_checks

ONE = """[[claim]]
id = "eq1-c"
source = "a"
quote = "b"
kind = "physics"
measure = "equations.convergence_order"
expected = 1
absolute = 1
reason = "c"
"""
READ = """readings = [
  { words = "one way", favoured = "it says so" },
  { words = "another" },
]
"""


def claim(**values: object) -> Claim:
    plain = {"id": "x", "source": "here", "reason": "because", "kind": "physics", "measure": "a.b", "expected": 2.0}
    return Claim.model_validate(plain | values)


def by_engines(whole: Claim, **computed: float) -> tuple[Claim, list[Check]]:
    """A claim with values by engine in its favoured reading."""
    return whole, [check_of(whole, whole.favoured.words, engine, value, 2.0) for engine, value in computed.items()]


def verdict_of(whole: Claim, checks: list[Check]) -> str:
    return favoured(whole, checks)["reference"].verdict


def test_verdicts_hold_up_to_their_limits() -> None:
    for values, computed, verdict in (
        ({"absolute": 0.1}, 2.09, REPRODUCED), ({"absolute": 0.1}, 2.11, DIFFERS), ({"absolute": 0.1}, nan, DIFFERS),
        ({"relation": "at most"}, 2.0, REPRODUCED), ({"relation": "at most"}, 2.1, DIFFERS),
        ({"relation": "at least"}, 1.9, DIFFERS), ({"relation": "at least"}, nan, DIFFERS),
    ):  # fmt: skip
        assert verdict_of(*by_engines(claim(**values), reference=computed)) == verdict, (values, computed)


def test_a_difference_nobody_explained_and_engines_that_disagree_are_faults() -> None:
    assert "without an explanation" in fault_of(*by_engines(claim(absolute=0.1), reference=3.0))
    assert not fault_of(*by_engines(claim(absolute=0.1, explained="misprint"), reference=3.0))
    assert "explained" in fault_of(*by_engines(claim(absolute=0.1, explained="misprint"), reference=2.0))
    assert "yade disagree" in fault_of(*by_engines(claim(absolute=0.1), reference=2.0, yade=2.2))


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        (ONE + READ.replace('favoured = "it says so"', 'favoured = ""'), "0 favoured"),
        (ONE + READ.replace('"another"', '"another", favoured = "too"'), "2 favoured"),
        (ONE + ONE, "twice"),
        (ONE.replace("absolute = 1", "absolute = -1"), "greater than 0"),
        (ONE.replace("expected = 1", "expected = nan"), "finite"),
        (ONE.replace("convergence_order", "_particles"), "equations._particles"),
        (ONE.replace('reason = "c"', ""), "reason: missing key"),
        (ONE.replace("absolute = 1\n", ""), "missing key absolute"),
        ("[[claim]\n", "TOML"),
    ],
)
def test_a_broken_list_is_refused_in_one_line(text: str, problem: str, tmp_path: Path) -> None:
    path = tmp_path / "claims.toml"
    path.write_text(text)
    with pytest.raises(InputError) as caught:
        read_claims(path)
    assert problem in str(caught.value)
    assert "\n" not in str(caught.value)


def test_numbers_quoted_twice_are_the_same() -> None:
    claims, paper = {whole.id: whole.expected for whole in read_claims()}, quoted()
    for _, row in pd.DataFrame(paper.table1).iterrows():
        for name, column in zip(("speed", "width-0.2", "width-4"), COLUMNS, strict=True):
            assert claims[f"table1-{row['force_N']:g}N-{name}"] == row[f"computed_{column}"]
    for name, value in (
        ("fig4-force", paper.fig4_leading_force_N), ("fig4-speed", paper.fig4_speed_m_s),
        ("fig5-envelope", paper.fig5_computed_envelope_per_us), ("fig5-rise", paper.fig5_incident_rise_us),
        ("fig5-decay", paper.fig5_incident_decay_per_us), ("fig5-duration", paper.fig5_incident_duration_us),
    ):  # fmt: skip
        assert claims[name] == value


def test_a_verdict_is_that_of_the_favoured_reading() -> None:
    ways = (Reading(words="one way", favoured="it says so"), Reading(words="another"))
    whole = claim(absolute=0.1, readings=ways)
    for values, verdict in (((2.0, 3.0), REPRODUCED), ((3.0, 2.0), DIFFERS)):
        checks = [check_of(whole, way.words, "reference", value, 2.0) for way, value in zip(ways, values, strict=True)]
        assert verdict_of(whole, checks) == verdict
        assert ("without an explanation" in fault_of(whole, checks)) == (verdict == DIFFERS)


def test_the_chapter_leads_with_the_gap_to_the_experiment_and_counts_what_can_fail_on_physics() -> None:
    """All numbers are hit but two: a statement of certain kind, and an explained one of physics with its cause."""
    claims, checks = (*read_claims(), *read_claims(paths.INDEPENDENT)), published_checks()
    missed = {"fig4-amplitudes-agree": 2.7, "power-three": 3.0}
    for whole in claims:
        if whole.id in missed:
            place = next(n for n, check in enumerate(checks) if check.scene == whole.id)
            checks[place] = check_of(whole, "", "reference", missed[whole.id], whole.expected or 0.0)
    physics = sum(whole.kind == "physics" for whole in claims)
    chapter = chapter_of(claims, checks)
    assert "2.7 times the measured force" in chapter.findings[0]
    assert chapter.findings[1].startswith(
        f"{physics - 1} of {physics} statements of the paper that can fail on physics"
    )
    assert chapter.findings[2].startswith("1 differ: the elastic calculation of Fig. 4")
    differing = chapter.shown[0].table
    assert [cell.partition("\n")[0] for cell in differing["computed"]] == ["differs 3", "differs 2.7"]
    faults = {check.scene: check.where for check in chapter.checks}
    assert "without an explanation" in faults["power-three"]
    assert "explained" in faults["collision-secondary"]  # is hit here
    rows = {row["name"] for row in case_rows(chapter.checks)}  # on the page no engine fails by a statement
    assert rows == {whole.id for whole in claims if whole.kind == "case"}
    assert "fig4-amplitudes-agree" not in faults


def weaker(case: Case) -> Simulation:
    """Motion with forces of a thousandth less."""
    motion = exact(case)
    return replace(motion, trace=replace(motion.trace, force_N=0.999 * motion.trace.force_N))


def test_table_1_is_read_at_the_engines_own_amplitude_and_at_one_that_rounds_to_the_printed_one() -> None:
    speed = partial(table1, column="speed_m_s", beads=20, force_is="average of the sensors")
    assert speed(exact, 2.0) == speed(exact, 2.0, rounded=True)  # all numbers of this row follow
    assert speed(weaker, 2.0) / speed(exact, 2.0) == pytest.approx(0.999 ** (-1 / 6), rel=2e-5)  # without gravity
    assert speed(exact, 0.06) > 103.5 > speed(exact, 0.06, rounded=True)
