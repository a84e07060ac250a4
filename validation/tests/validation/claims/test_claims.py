"""The paper's statements: the list, the judgement, the numbers."""

from dataclasses import replace
from math import nan
from pathlib import Path

import pytest

from drivers.base.errors import InputError
from postproc.paper.quoted import quoted
from postproc.paper.strikes import COLUMNS
from validation.chapters import frame_of, read_section
from validation.checks import Check
from validation.claims.claim import Claim, Reading, read_claims
from validation.claims.claims_chapter import headline, misfit
from validation.claims.judged import DIFFERS, REPRODUCED, check_of, fault_of, favoured, hangs
from validation.report.page_figures import write_part
from validation.tests.helpers.commands import assert_in_order
from validation.tests.validation.claims.published import published_checks

JudgedClaim = tuple[Claim, list[Check]]

ONE = """[[claim]]
id = "eq1-c"
where = "a"
quote = "b"
kind = "physics"
compute = "equations.convergence_order"
quoted = 1
within = 1
because = "c"
"""
SOLVED = ONE.replace("equations.convergence_order", "single_waves.solved")
READ = """readings = [
  { words = "one way", favoured = "it says so" },
  { words = "another" },
]
"""


def claim(**values: object) -> Claim:
    plain = {"id": "x", "where": "here", "quote": "words", "kind": "physics", "compute": "a.b", "quoted": 2.0}
    return Claim.model_validate(plain | values)


def by_engines(whole: Claim, **computed: float) -> JudgedClaim:
    """A claim with values by engine in its favoured reading."""
    return whole, [check_of(whole, whole.favoured, engine, value) for engine, value in computed.items()]


def verdict_of(whole: Claim, checks: list[Check]) -> str:
    return favoured(whole, checks)["reference"].verdict


def test_verdicts_hold_up_to_their_limits() -> None:
    for values, computed, verdict in (
        ({"within": 0.1}, 2.09, REPRODUCED), ({"within": 0.1}, 2.11, DIFFERS), ({"within": 0.1}, nan, DIFFERS),
        ({"relation": "at most"}, 2.0, REPRODUCED), ({"relation": "at most"}, 2.1, DIFFERS),
        ({"relation": "at least"}, 1.9, DIFFERS), ({"relation": "at least"}, nan, DIFFERS),
    ):  # fmt: skip
        assert verdict_of(*by_engines(claim(**values), reference=computed)) == verdict, (values, computed)


def test_a_difference_nobody_explained_and_engines_that_disagree_are_faults() -> None:
    assert "without an explanation" in fault_of(*by_engines(claim(within=0.1), reference=3.0))
    assert not fault_of(*by_engines(claim(within=0.1, explained="misprint"), reference=3.0))
    assert "explained" in fault_of(*by_engines(claim(within=0.1, explained="misprint"), reference=2.0))
    assert "yade disagree" in fault_of(*by_engines(claim(within=0.1), reference=2.0, yade=2.2))


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        (ONE + READ.replace('favoured = "it says so"', 'favoured = ""'), "0 favoured"),
        (ONE + READ.replace('"another"', '"another", favoured = "too"'), "2 favoured"),
        (ONE + READ.replace('"another"', '"another", arguments = { force_N = 5 }'), "unexpected keyword argument"),
        (ONE + ONE, "twice"),
        (ONE.replace("within = 1", "within = -1"), "greater than 0"),
        (ONE.replace("quoted = 1", "quoted = nan"), "finite"),
        (SOLVED, "missing a required argument: 'force_N'"),
        (SOLVED.replace("quoted", 'arguments = { force_N = 7, column = "speed_m_s" }\nquoted'), "force_N: found 7.0"),
        (ONE.replace("quoted", "arguments = { force_N = 5 }\nquoted"), "unexpected keyword argument 'force_N'"),
        (ONE.replace("convergence_order", "_particles"), "equations._particles"),
        (ONE.replace('because = "c"', ""), "missing key because"),
        (ONE.replace("within = 1\n", ""), "missing key within"),
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
    claims, paper = {whole.id: whole.quoted for whole in read_claims().claim}, quoted()
    for _, row in paper.table1.frame.iterrows():
        for name, column in zip(("speed", "width-0.2", "width-4"), COLUMNS, strict=True):
            assert claims[f"table1-{row['force_N']:g}N-{name}"] == row[f"computed_{column}"]
    for name, value in (
        ("fig4-force", paper.fig4_leading_force_N), ("fig4-speed", paper.fig4_speed_m_s),
        ("fig5-envelope", paper.fig5_computed_envelope_per_us), ("fig5-rise", paper.fig5_incident_rise_us),
        ("fig5-decay", paper.fig5_incident_decay_per_us), ("fig5-duration", paper.fig5_incident_duration_us),
    ):  # fmt: skip
        assert claims[name] == value


def test_a_verdict_is_that_of_the_favoured_reading_and_hangs_where_another_differs() -> None:
    ways = (Reading(words="one way", favoured="it says so"), Reading(words="another"))
    whole = claim(within=0.1, readings=ways)
    for values, verdict, hanging in (
        ((2.0, 2.01), REPRODUCED, False), ((2.0, 3.0), REPRODUCED, True), ((3.0, 2.0), DIFFERS, True),
    ):  # fmt: skip
        checks = [check_of(whole, way, "reference", value) for way, value in zip(ways, values, strict=True)]
        assert verdict_of(whole, checks) == verdict
        assert bool(hangs(checks)) == hanging
        assert ("without an explanation" in fault_of(whole, checks)) == (verdict == DIFFERS)


def test_the_headline_counts_statements_that_can_fail_on_physics() -> None:
    """Two are reproduced, and one differs by our criterion; the cause has a name in the file."""
    cause, words = next(iter(read_claims().causes.items()))
    whole = [
        by_engines(claim(within=0.1), reference=2.0),
        by_engines(claim(within=0.1, ours=True), reference=2.0),
        by_engines(claim(within=0.1, ours=True, explained="misprint", cause=cause), reference=3.0),
        by_engines(claim(within=0.1, kind="certain"), reference=3.0),
    ]
    assert headline(whole).startswith(
        "2 of 3 statements of the paper that can fail on physics are reproduced: 1 of 1 by"
    )
    assert misfit(whole) == f"1 statements differ: {words} (1)."


@pytest.mark.parametrize("damage", ["verdict", "value", "claim"])
def test_a_damaged_table_is_not_shown_as_if_whole(damage: str, tmp_path: Path) -> None:
    first, *others = published_checks()
    changed = {"verdict": [replace(first, verdict="great")], "value": [replace(first, found=nan)], "claim": []}
    write_part("claims", tmp_path, {"claims": frame_of(Check, [first, *others])}, ())
    assert len(read_section("claims", tmp_path)["checks"]) > 100
    write_part("claims", tmp_path, {"claims": frame_of(Check, [*changed[damage], *others])}, ())
    with pytest.raises(InputError) as caught:
        read_section("claims", tmp_path)
    assert_in_order(str(caught.value), "claims.json", "make claims")
