"""The paper's statements: the list, the judgement, the numbers."""

import inspect
from importlib import import_module
from pathlib import Path

import pandas as pd
import pytest

from drivers.base.errors import InputError
from drivers.engines import codes
from postproc.paper.quoted import quoted
from postproc.paper.strikes import COLUMNS
from validation.claims.claims_study import (
    DIFFERS,
    EXPERIMENT_ONLY,
    REPRODUCED,
    Claim,
    Judged,
    Row,
    judge_all,
    read_claims,
    row_of,
)
from validation.report.write_report import write_report
from validation.studies import read_section, read_table, rows_in, write_table
from validation.tests.helpers.runs import need

pytestmark = pytest.mark.long


@pytest.fixture(scope="module")
def judged(shared_runs: Path) -> list[Judged]:
    """All claims by all engines, once."""
    for code in codes():
        need(code)
    return judge_all(shared_runs)


ONE = """[[claim]]
id = "eq1-c"
where = "a"
quote = "b"
compute = "equations.speed_constant"
quoted = 1
within = 1
because = "c"
"""
SOLVED = ONE.replace("equations.speed_constant", "simulated.solved")


def claim(**values: object) -> Claim:
    return Claim.model_validate({"id": "x", "where": "here", "quote": "words", "quoted": 2.0} | values)


def test_there_are_enough_and_each_has_its_reason() -> None:
    claims = read_claims()
    assert len(claims) >= 30
    assert len({each.id for each in claims}) == len(claims)
    for each in claims:
        assert each.note if each.experiment else each.because, each.id


def test_everything_that_is_computed_is_a_claim() -> None:
    named = {each.compute for each in read_claims() if each.compute}
    modules = {name.partition(".")[0] for name in named}
    assert len(modules) == 2
    computed = {
        f"{module}.{name}"
        for module in modules
        for name, function in vars(import_module(f"validation.claims.{module}")).items()
        if inspect.isfunction(function) and function.__module__.endswith(module) and not name.startswith("_")
    }
    assert computed == named


@pytest.mark.timeout(400)
def test_no_claim_is_at_fault(judged: list[Judged]) -> None:
    assert {each.claim.id: each.fault for each in judged if each.fault} == {}


def test_what_differs_is_what_was_explained(judged: list[Judged]) -> None:
    assert {each.claim.id for each in judged if each.verdict == DIFFERS} == {
        each.id for each in read_claims() if each.explained
    }


def test_codes_agree_with_the_reference_on_every_simulated_claim(judged: list[Judged]) -> None:
    simulated = [each for each in judged if len(each.computed) > 1]
    assert len(simulated) >= 40
    for each in simulated:
        for code in codes():
            assert each.computed[code] == pytest.approx(each.value, rel=5e-4, abs=1e-9), each.claim.id


@pytest.mark.parametrize(
    ("values", "computed", "verdict"),
    [
        ({"within": 0.1}, 2.09, REPRODUCED),
        ({"within": 0.1}, 2.11, DIFFERS),
        ({"relation": "at most"}, 2.0, REPRODUCED),
        ({"relation": "at most"}, 2.1, DIFFERS),
        ({"relation": "at least"}, 1.9, DIFFERS),
        ({"within": 0.1}, float("nan"), DIFFERS),
        ({"relation": "at least"}, float("nan"), DIFFERS),
        ({"experiment": True}, 7.0, EXPERIMENT_ONLY),
    ],
)
def test_verdicts(values: dict[str, object], computed: float, verdict: str) -> None:
    assert Judged(claim(**values), {"reference": computed}, "").verdict == verdict


def test_a_difference_nobody_explained_and_engines_that_disagree_are_faults() -> None:
    assert "without an explanation" in Judged(claim(within=0.1), {"reference": 3.0}, "").fault
    assert not Judged(claim(within=0.1, explained="misprint"), {"reference": 3.0}, "").fault
    assert "yade disagree" in Judged(claim(within=0.1), {"reference": 2.0, "yade": 2.2}, "").fault


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("claim = []\n", "at least 1 item"),
        (ONE + ONE, "twice"),
        (ONE.replace("within = 1", "within = -1"), "above 0"),
        (ONE.replace("within = 1", "within = inf"), "finite"),
        (ONE.replace("quoted = 1", "quoted = nan"), "finite"),
        (ONE.replace("quoted = 1", "quoted = true"), "quoted"),
        (SOLVED, "missing a required argument: 'force_N'"),
        (SOLVED.replace("quoted", 'arguments = { force_N = 7, column = "speed_m_s" }\nquoted'), "force_N: found 7.0"),
        (ONE.replace("quoted", "arguments = { force_N = 5 }\nquoted"), "unexpected keyword argument 'force_N'"),
        (ONE.replace("speed_constant", "_particles"), "equations._particles"),
        (ONE.replace("speed_constant", "quoted"), "equations.quoted"),
        (ONE.replace("equations.", "os."), "os.speed_constant"),
        (ONE.replace('because = "c"', ""), "no because"),
        ('[[claim]]\nid = "nobody"\nwhere = "a"\nquote = "b"\nquoted = 1\nwithin = 1\n', "nobody"),
        (ONE.replace("within = 1\n", ""), "no within"),
        (ONE.replace("quoted = 1", 'quoted = "one"'), "quoted"),
        (ONE.replace("within", "withn"), "withn"),
        ("", "claim"),
        ("[[claim]\n", "TOML"),
    ],
)
def test_a_broken_list_is_refused_in_one_line(text: str, complaint: str, tmp_path: Path) -> None:
    path = tmp_path / "claims.toml"
    path.write_text(text)
    with pytest.raises(InputError) as caught:
        read_claims(path)
    assert complaint in str(caught.value)
    assert "\n" not in str(caught.value)


def test_an_explanation_without_a_difference_is_a_fault() -> None:
    assert "explained" in Judged(claim(within=0.1, explained="misprint"), {"reference": 2.0}, "").fault


def test_what_was_computed_is_told_in_full(judged: list[Judged]) -> None:
    for each in judged:
        assert not each.how.startswith(("The same", "Its ", "Their ", "For ", "They ")), each.claim.id


def test_numbers_quoted_twice_are_the_same() -> None:
    claims, table = {each.id: each.quoted for each in read_claims()}, quoted().table1.frame
    for _, row in table.iterrows():
        for name, column in zip(("speed", "width-0.2", "width-4"), COLUMNS, strict=True):
            assert claims[f"table1-{row['force_N']:g}N-{name}"] == row[f"computed_{column}"]
    paper = quoted()
    assert claims["fig4-force"] == paper.fig4.leading_force_N
    assert claims["fig4-speed"] == paper.fig4.speed_m_s
    assert claims["fig4-duration"] == paper.fig4.duration_us
    assert claims["fig5-envelope"] == paper.fig5.computed_envelope_per_us
    assert claims["fig5-rise"] == paper.fig5.incident_rise_us
    assert claims["fig5-decay"] == paper.fig5.incident_decay_per_us
    assert claims["fig5-duration"] == paper.fig5.incident_duration_us


def test_the_table_has_a_row_a_claim_and_keeps_the_digits(judged: list[Judged], tmp_path: Path) -> None:
    write_table(tmp_path / "claims.csv", Row, map(row_of, judged))
    table = pd.read_csv(tmp_path / "claims.csv").set_index("id")
    assert len(table) == len(judged)
    assert {"reference", *codes()} <= set(table.columns)
    assert table.loc["energy-in-five", "reference"] == pytest.approx(99.9999955, abs=5e-8)
    assert list(table.columns[-4:]) == ["difference", "verdict", "why", "how"]
    section = read_section("claims", tmp_path)
    assert sum(len(rows) for rows in section["rows"].values()) == len(judged)
    assert section["engines"] == [*codes(), "reference"]
    assert [row.how for row in rows_in(read_table(tmp_path / "claims.csv", Row, "claims"), Row)] == [
        each.how for each in judged
    ]


@pytest.mark.parametrize("damage", ["", "id,where\n", "\x00\xff", "cut", "verdict"])
def test_a_damaged_table_is_not_shown_as_if_whole(damage: str, judged: list[Judged], tmp_path: Path) -> None:
    path = tmp_path / "claims.csv"
    write_table(path, Row, map(row_of, judged))
    whole = path.read_text()
    damaged = {"cut": whole[: len(whole) // 2], "verdict": whole.replace(",reproduced,", ",great,")}.get(damage, damage)
    path.write_bytes(damaged.encode("latin-1", errors="replace") if damage == "\x00\xff" else damaged.encode())
    with pytest.raises(InputError) as caught:
        read_section("claims", tmp_path)
    assert "claims.csv" in str(caught.value)
    assert "make claims" in str(caught.value)


def test_the_page_shows_every_verdict(judged: list[Judged], tmp_path: Path) -> None:
    write_table(tmp_path / "claims.csv", Row, map(row_of, judged))
    write_report([], tmp_path / "report.html")
    page = (tmp_path / "report.html").read_text()
    for each in judged:
        assert f">{each.claim.id}<" in page
    assert "our criterion" in page
