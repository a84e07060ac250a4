"""Required engines that did not run: named, counted as failures, and recorded."""

import json
from collections.abc import Callable
from pathlib import Path

import pytest

from drivers.base.errors import InputError
from drivers.engines import REFERENCE, VERLET, codes, installed_codes
from validation.checks import NOT_RUN
from validation.commands.beads import answer
from validation.compare.compare_command import compare_scenes
from validation.compare.selection import EngineSelection
from validation.tests.helpers.runs import run_and_compare
from validation.tests.helpers.scenes import EnginesWriter, SceneWriter

Command = Callable[..., int]
CODE = codes()[0]


@pytest.fixture
def command(scene_file: SceneWriter, tmp_path: Path, shared_runs: Path, monkeypatch: pytest.MonkeyPatch) -> Command:
    """A comparison or a report of the small scene."""

    def run(name: str, *options: str) -> int:
        place = ["--out", str(tmp_path / "out" / "page.html")] if name == "report" else []
        words = [name, str(scene_file()), "--runs", str(shared_runs), *place, *options]
        monkeypatch.setattr("sys.argv", ["beads", *words])
        return answer()

    return run


@pytest.fixture
def without_codes(engines_file: EnginesWriter) -> None:
    """Gives every code a command that does not exist."""
    engines_file("".join(f'[{code}]\ncommand = "{code}-is-nowhere"\n' for code in codes()))
    assert not installed_codes()


@pytest.mark.usefixtures("without_codes")
def test_without_a_code_nothing_passes(command: Command, capsys: pytest.CaptureFixture[str]) -> None:
    assert command("compare") == 1
    *_, line = capsys.readouterr().err.splitlines()  # after lines of progress, on a slow machine
    assert line.startswith("no established code ran: install one of ")
    assert all(code in line for code in codes())
    assert command("compare", "--allow-missing") == 0
    assert "no established code" not in capsys.readouterr().err
    assert command("compare", "--engine", VERLET) == 1  # the baseline is no code


@pytest.mark.usefixtures("without_codes")
def test_a_required_engine_that_is_missing_is_a_failure(command: Command, capsys: pytest.CaptureFixture[str]) -> None:
    for options in (("--require", CODE, "--allow-missing"), ("--engine", CODE)):
        assert command("compare", *options) == 1
        *_, line = capsys.readouterr().err.splitlines()
        assert line.startswith(f"{CODE} is required and did not run: not installed; it comes with ")
    assert command("compare", "--engine", CODE, "--allow-missing") == 0


@pytest.mark.usefixtures("without_codes")
def test_the_file_for_programs_has_unmet_requirements(command: Command, tmp_path: Path) -> None:
    assert command("report", "--require", CODE) == 1
    data = json.loads((tmp_path / "out" / "page.json").read_text())
    assert data["unmet"].keys() == {CODE}
    assert data["made_with"]["command"].endswith(f" --require {CODE} --engines {tmp_path}/own-engines.toml")
    assert data["scenes"][0]["command"].endswith(f" --engines {tmp_path}/own-engines.toml")
    assert data["unmet"][CODE].startswith(f"{CODE} is required and did not run")
    assert data["unmet"][CODE] in (tmp_path / "out" / "page.html").read_text().replace("&#39;", "'")


def test_a_required_engine_that_refuses_the_scene_is_named_with_its_refusal(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """``reference`` models straight chains only, as LAMMPS does, and needs no installation."""
    words = ["compare", "fig4-tube", "--set", "run.duration=20 us", "--runs", str(tmp_path / "runs")]
    words += ["--require", REFERENCE, "--allow-missing", "--engine", VERLET]
    monkeypatch.setattr("sys.argv", ["beads", *words])
    assert answer() == 1
    said = capsys.readouterr()
    last = said.err.splitlines()[-1]
    assert last.startswith(f"{REFERENCE} did not run: refused: "), last
    assert "required" not in last
    assert said.out.startswith(f"fig4-tube: not judged: {REFERENCE} did not run (refused: ")
    assert "the rest: pass: " in said.out.partition("\n")[0]


@pytest.mark.parametrize("option", ["--engine", "--require"])
def test_an_unknown_engine_is_wrong_input(option: str, command: Command) -> None:
    with pytest.raises(InputError, match=f'{option}: found "abacus"; allowed: .*{VERLET}'):
        command("compare", option, "abacus")


def test_a_selected_code_the_baseline_and_the_reference_are_enough(
    scene_file: SceneWriter, command: Command, shared_runs: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for code in installed_codes()[:1]:
        compared = run_and_compare(scene_file(), runs=shared_runs, asked=EngineSelection((code,)))
        assert [*compared.runs] == [code, REFERENCE, VERLET]
        assert not compared.absent
        assert command("compare", "--engine", code) == 0
        assert "did not run" not in capsys.readouterr().err
        asked = EngineSelection((code,), require=(code,))
        assert compare_scenes([str(scene_file())], (), shared_runs, asked, unsafe=False, brief=True) == 0
        rows = [line for line in capsys.readouterr().out.splitlines() if " pass: " in line]
        assert [row.split()[1] for row in rows] == [code, REFERENCE, VERLET]  # the closest check of each


def test_a_run_that_failed_did_run(scene_file: SceneWriter, tmp_path: Path) -> None:
    """The step is above the stability limit: only an unsafe run takes it."""
    scene = scene_file(step="50 us").read_text().replace('"1 us"', '"50 us"')
    (tmp_path / "coarse.toml").write_text(scene)
    compared = run_and_compare(
        tmp_path / "coarse.toml", runs=tmp_path / "runs", asked=EngineSelection((VERLET,)), unsafe=True
    )
    assert compared.absent[VERLET].startswith("failed")
    assert VERLET in compared.ran
    assert not [check for check in compared.checks if check.verdict == NOT_RUN]
