"""Comparison of a scene: sentences that sum up the checks; missing, failed and required engines."""

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest

from drivers.base.errors import InputError
from drivers.engines import REFERENCE, VERLET, codes, expected_engines, installed_codes, missing_codes
from validation.checks import FAIL, NOT_RUN, PASS, Check, share_of_limit, short, worst_of
from validation.commands import beads as beads_command
from validation.compare.comparison import ComparedScene, EngineSelection, answer, compare_scenes, missing
from validation.tests.helpers.runs import run_and_compare
from validation.tests.helpers.scenes import EnginesWriter, SceneWriter

Command = Callable[..., int]
CODE = codes()[0]
AGREES = "The forces of YADE agree with velocity Verlet at the same step to 0.0 and with the exact motion to "
FAILED = "failed: exit code 1"


def test_the_worst_check_is_a_failure_or_the_closest_to_its_limit(compared: ComparedScene) -> None:
    """A missing engine is not run, and a failed one fails."""
    by_engine = {name: {check.verdict for check in compared.of_engine(name)} for name in ("liggghts", "yade")}
    assert by_engine == {"liggghts": {NOT_RUN}, "yade": {FAIL}}
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


@pytest.mark.parametrize(
    ("absent", "beginnings"),
    [
        ({}, ["Yes.", AGREES]),
        ({"liggghts": "not installed"}, ["Yes.", AGREES, "Not judged, since not run: LIGGGHTS on scene."]),
        ({"liggghts": FAILED, "lammps": FAILED}, ["No: LAMMPS fails on scene; LIGGGHTS fails on scene.", AGREES]),
    ],
)
def test_the_first_sentence_answers_the_question(
    absent: dict[str, str], beginnings: list[str], compared: ComparedScene
) -> None:
    checks = [check for check in compared.checks if check.engine in compared.runs]
    checks += [replace(check, engine="yade") for check in checks if check.engine == "verlet"]
    runs = compared.runs | {"yade": compared.runs["verlet"]}
    sentences = [*answer([ComparedScene(compared.case, runs, absent, [*missing(compared.case, absent), *checks])])]
    assert [sentence[: len(words)] for sentence, words in zip(sentences, beginnings, strict=True)] == beginnings
    (agreement,) = (sentence for sentence in sentences if AGREES in sentence)
    exact = max(check.value for check in checks if check.quantity == "error: force")
    assert f"{short(exact)}, for at most " in agreement


def test_without_a_code_the_answer_is_not_known(compared: ComparedScene) -> None:
    checks = [check for check in compared.checks if check.engine in compared.runs]
    first, second = answer([replace(compared, absent={}, checks=checks)])
    assert first == "Not known whether the codes are right: none of them ran."
    assert second.startswith(
        "The forces of verlet agree with velocity Verlet at the same step to 0.0 and with the exact"
    )


@pytest.mark.parametrize(
    ("failed", "words"),
    [
        ({"error: force"}, "verlet is right but not accurate enough on scene"),
        ({"model: force", "error: force"}, "YADE fails on scene; verlet fails on scene"),
    ],
)
def test_the_first_sentence_tells_wrong_from_inaccurate(compared: ComparedScene, failed: set[str], words: str) -> None:
    checks = [
        replace(check, verdict=FAIL) if check.engine == "verlet" and check.quantity in failed else check
        for check in compared.checks
    ]
    assert words in next(answer([replace(compared, checks=checks)]))


@pytest.fixture
def command(scene_file: SceneWriter, tmp_path: Path, shared_runs: Path, monkeypatch: pytest.MonkeyPatch) -> Command:
    """A comparison or a report of the small scene."""

    def run(name: str, *options: str) -> int:
        place = ["--out", str(tmp_path / "out" / "page.html")] if name == "report" else []
        words = [name, str(scene_file()), "--runs", str(shared_runs), *place, *options]
        monkeypatch.setattr("sys.argv", ["beads", *words])
        return beads_command.answer()

    return run


def test_missing_engines_are_failures_unless_allowed(
    no_codes: None, command: Command, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A required engine has to run, and without ``--allow-missing`` one of the codes."""
    assert not installed_codes()
    assert command("compare") == 1
    *_, line = capsys.readouterr().err.splitlines()  # after lines of progress, on a slow machine
    assert line.startswith("no established code ran: install one of ")
    assert all(code in line for code in codes())
    assert command("compare", "--allow-missing") == 0
    assert "no established code" not in capsys.readouterr().err
    assert command("compare", "--engine", VERLET) == 1  # the baseline is no code
    for options in (("--require", CODE, "--allow-missing"), ("--engine", CODE)):
        assert command("compare", *options) == 1
        *_, line = capsys.readouterr().err.splitlines()
        assert line.startswith(f"{CODE} is required and did not run: not installed; it comes with ")
    assert command("compare", "--engine", CODE, "--allow-missing") == 0
    assert command("report", "--require", CODE) == 1
    (unmet,) = json.loads((tmp_path / "out" / "page.json").read_text())["unmet"].values()
    assert unmet.startswith(f"{CODE} is required and did not run")
    assert unmet in (tmp_path / "out" / "page.html").read_text().replace("&#39;", "'")
    for option in ("--engine", "--require"):
        with pytest.raises(InputError, match=f'{option}: found "abacus"; allowed: .*{VERLET}'):
            command("compare", option, "abacus")


def test_of_an_optional_engine_that_is_missing_nothing_is_said_unless_it_is_required(
    engines_file: EnginesWriter, command: Command, capsys: pytest.CaptureFixture[str]
) -> None:
    entry = f'adapter = "{CODE}"\ncommand = "is-nowhere"\n'
    engines_file(f"[gone]\n{entry}[spare]\n{entry}optional = true\n")
    for names in (missing_codes(), expected_engines()):
        assert ("gone" in names, "spare" in names) == (True, False)
    assert command("compare", "--allow-missing") == 0
    printed = capsys.readouterr().out
    assert ("gone" in printed, "spare" in printed) == (True, False)
    assert command("compare", "--allow-missing", "--require", "spare") == 1
    assert "spare is required and did not run: not installed" in capsys.readouterr().err


def test_a_required_engine_that_refuses_the_scene_is_named_with_its_refusal(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """``reference`` models straight chains only, and needs no installation."""
    words = ["compare", "fig4-tube", "--set", "run.duration=20 us", "--runs", str(tmp_path / "runs")]
    words += ["--require", REFERENCE, "--allow-missing", "--engine", VERLET]
    monkeypatch.setattr("sys.argv", ["beads", *words])
    assert beads_command.answer() == 1
    said = capsys.readouterr()
    last = said.err.splitlines()[-1]
    assert last.startswith(f"{REFERENCE} is required and did not run: refused: "), last
    assert f"; not run: {REFERENCE}" in said.out.partition("\n")[0]


def test_a_selected_code_the_baseline_and_the_reference_are_enough(
    scene_file: SceneWriter, shared_runs: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for code in installed_codes()[:1]:
        asked = EngineSelection((code,), require=(code,))
        assert compare_scenes([str(scene_file())], (), shared_runs, asked, unsafe=False, brief=True) == 0
        said = capsys.readouterr()
        assert "did not run" not in said.err
        rows = [line for line in said.out.splitlines() if " pass: " in line]
        assert [row.split()[1] for row in rows] == [code, REFERENCE, VERLET]  # the closest check of each


def test_a_run_that_failed_did_run(scene_file: SceneWriter, tmp_path: Path) -> None:
    """The step is above the stability limit: only an unsafe run takes it."""
    (tmp_path / "coarse.toml").write_text(scene_file(step="50 us").read_text().replace('"1 us"', '"50 us"'))
    asked = EngineSelection((VERLET,))
    compared = run_and_compare(tmp_path / "coarse.toml", runs=tmp_path / "runs", asked=asked, unsafe=True)
    assert compared.absent[VERLET].startswith("failed")
    assert VERLET not in asked.unmet([compared])
    assert not [check for check in compared.checks if check.verdict == NOT_RUN]
