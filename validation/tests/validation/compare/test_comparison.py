"""Comparison of a scene: missing and failed engines, the sentence that sums up the checks."""

import tomllib
from dataclasses import replace

import pytest

from drivers.base import paths
from drivers.base.tolerances import tolerance
from validation.checks import FAIL, NOT_RUN, PASS, Check, share_of_limit, short, worst_of
from validation.compare.answer import answer
from validation.compare.comparison import ComparedScene, missing


def test_missing_engines_are_not_run_and_failed_engines_fail(compared: ComparedScene) -> None:
    by_engine = {name: {check.verdict for check in compared.of_engine(name)} for name in ("liggghts", "yade")}
    assert by_engine == {"liggghts": {NOT_RUN}, "yade": {FAIL}}
    assert {check.verdict for check in compared.checks if check.engine in compared.runs} == {PASS}


def test_every_tolerance_has_a_reason() -> None:
    for kind, quantities in tomllib.loads(paths.TOLERANCES.read_text()).items():
        for quantity in quantities:
            assert len(tolerance(kind, quantity).reason) > 10


@pytest.mark.parametrize(
    ("value", "limit", "share"),
    [(1.0, 2.0, 0.5), (1.0, 0.0, float("inf")), (0.0, 0.0, 0.0), (float("nan"), 1.0, float("inf"))],
)
def test_the_share_of_a_limit(value: float, limit: float, share: float) -> None:
    assert share_of_limit(Check("", "", "", value, limit, "", "", PASS)) == share


def test_the_worst_check_is_a_failure_or_the_closest_to_its_limit(compared: ComparedScene) -> None:
    checks = compared.of_engine("verlet")
    worst = worst_of(checks)
    assert worst is not None
    assert all(share_of_limit(check) <= share_of_limit(worst) for check in checks)
    failed = replace(checks[0], verdict=FAIL)
    assert worst_of([*checks, failed]) == failed
    assert worst_of(compared.of_engine("yade")) is None  # nothing was measured


def test_the_first_sentence_answers_the_question(compared: ComparedScene) -> None:
    def sentences(absent: dict[str, str], *, code: bool = True) -> list[str]:
        checks = [check for check in compared.checks if check.engine in compared.runs]
        runs = dict(compared.runs)
        if code:
            checks += [replace(check, engine="yade") for check in checks if check.engine == "verlet"]
            runs["yade"] = runs["verlet"]
        return answer([ComparedScene(compared.case, runs, absent, [*missing(compared.case, absent), *checks])])

    exact = max(check.value for check in compared.checks if check.quantity == "error: force")
    end = f"with the exact motion to {short(exact)} at this time step"
    (first,) = sentences({})
    assert first.startswith(
        f"Yes: the forces of YADE agree with velocity Verlet at the same step to 0.0 and {end}, for "
    )
    assert first.endswith("s of computing per run.")
    first, last = sentences({"liggghts": "not installed"})
    assert first.startswith("Yes: the forces of YADE agree")
    assert last == "LIGGGHTS did not run on scene."
    first, second = sentences({"liggghts": "failed: exit code 1"})
    assert first == "No: LIGGGHTS fails on scene."
    assert second.startswith("Otherwise, the forces of YADE agree with velocity Verlet at the same step to 0.0")
    first, second = sentences({"liggghts": "failed: exit code 1", "lammps": "failed: exit code 1"})
    assert first == "No: LAMMPS and LIGGGHTS fail on scene."
    first, second, _ = sentences({"liggghts": "not installed"}, code=False)
    assert first == "Not known: no code ran."
    assert second.startswith(f"In this repository, the forces of verlet agree {end}")
    assert answer([]) == ["Not known: no code ran."]


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
