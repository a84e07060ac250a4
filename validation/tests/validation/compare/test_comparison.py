"""Comparison of a scene: missing and failed engines, the sentences that sum up the checks."""

from dataclasses import replace

import pytest

from validation.checks import FAIL, NOT_RUN, PASS, Check, share_of_limit, short, worst_of
from validation.compare.answer import answer
from validation.compare.comparison import ComparedScene, missing


def test_missing_engines_are_not_run_and_failed_engines_fail(compared: ComparedScene) -> None:
    by_engine = {name: {check.verdict for check in compared.of_engine(name)} for name in ("liggghts", "yade")}
    assert by_engine == {"liggghts": {NOT_RUN}, "yade": {FAIL}}
    assert {check.verdict for check in compared.checks if check.engine in compared.runs} == {PASS}


def test_the_worst_check_is_a_failure_or_the_closest_to_its_limit(compared: ComparedScene) -> None:
    checks = compared.of_engine("verlet")
    worst = worst_of(checks)
    assert worst is not None
    assert all(share_of_limit(check) <= share_of_limit(worst) for check in checks)
    failed = replace(checks[0], verdict=FAIL)
    assert worst_of([*checks, failed]) == failed
    assert worst_of(compared.of_engine("yade")) is None  # nothing was measured
    values = {(1.0, 2.0): 0.5, (1.0, 0.0): float("inf"), (0.0, 0.0): 0.0, (float("nan"), 1.0): float("inf")}
    for (value, limit), share in values.items():
        assert share_of_limit(Check("", "", "", value, limit, "", "", PASS)) == share


AGREES = "the forces of YADE agree with velocity Verlet at the same step to 0.0 and with the exact motion to "
FAILED = "failed: exit code 1"


@pytest.mark.parametrize(
    ("absent", "beginnings"),
    [
        ({}, [f"Yes: {AGREES}"]),
        ({"liggghts": "not installed"}, [f"Yes: {AGREES}", "LIGGGHTS did not run on scene."]),
        ({"liggghts": FAILED}, ["No: LIGGGHTS fails on scene.", f"Otherwise, {AGREES}"]),
        ({"liggghts": FAILED, "lammps": FAILED}, ["No: LAMMPS and LIGGGHTS fail on scene.", f"Otherwise, {AGREES}"]),
    ],
)
def test_the_first_sentence_answers_the_question(
    absent: dict[str, str], beginnings: list[str], compared: ComparedScene
) -> None:
    checks = [check for check in compared.checks if check.engine in compared.runs]
    checks += [replace(check, engine="yade") for check in checks if check.engine == "verlet"]
    runs = compared.runs | {"yade": compared.runs["verlet"]}
    sentences = answer([ComparedScene(compared.case, runs, absent, [*missing(compared.case, absent), *checks])])
    assert [sentence[: len(words)] for sentence, words in zip(sentences, beginnings, strict=True)] == beginnings
    (agreement,) = (sentence for sentence in sentences if AGREES in sentence)
    exact = max(check.value for check in checks if check.quantity == "error: force")
    assert f"{short(exact)} at this time step, for " in agreement


def test_without_a_code_the_answer_is_not_known(compared: ComparedScene) -> None:
    checks = [check for check in compared.checks if check.engine in compared.runs]
    first, second = answer([replace(compared, absent={}, checks=checks)])
    assert first == "Not known whether the codes are right: none of them ran."
    assert second.startswith("In this repository, the forces of verlet agree with the exact motion to ")
    assert answer([]) == ["Not known whether the codes are right: none of them ran."]


@pytest.mark.parametrize(
    ("failed", "words"),
    [
        ({"error: force"}, "verlet is right but not accurate enough on scene"),
        ({"model: force", "error: force"}, "YADE and verlet fail on scene"),
    ],
)
def test_the_first_sentence_tells_wrong_from_inaccurate(compared: ComparedScene, failed: set[str], words: str) -> None:
    checks = [
        replace(check, verdict=FAIL) if check.engine == "verlet" and check.quantity in failed else check
        for check in compared.checks
    ]
    assert words in answer([replace(compared, checks=checks)])[0]
