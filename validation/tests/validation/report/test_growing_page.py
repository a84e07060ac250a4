"""The page is written first and grows by its studies; finished studies are not made again."""

import json
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

from drivers.base import kept, paths
from drivers.base.errors import RunError
from validation.chapters import Chapter, Options
from validation.checks import FAIL, Check, without_run
from validation.compare.selection import EngineSelection
from validation.report import write_report
from validation.report.write_report import report
from validation.tests.helpers.scenes import SceneWriter

Grow = Callable[..., int]


@dataclass(frozen=True)
class Row:
    """Row of a trivial study."""

    value: float


class Studies:
    """Two studies that count how often they are made; ``instead`` replaces the work of a study."""

    def __init__(self) -> None:
        self.made: list[str] = []
        self.pages: list[str] = []
        self.instead: dict[str, Callable[[], None]] = {}
        self.failed: list[Check] = []

    def load(self, name: str) -> Chapter:
        def measure(options: Options) -> Mapping[str, Any]:
            self.pages.append((options.results / "report.html").read_text())
            self.instead.get(name, lambda: None)()
            self.made.append(name)
            return {name: [Row(1.0)]}

        return Chapter(
            name, f"about {name}", {name: Row}, measure, lambda _: [f"{name} says so"], lambda _: {},
            judge=lambda _: self.failed,
        )  # fmt: skip


@pytest.fixture
def studies(monkeypatch: pytest.MonkeyPatch) -> Studies:
    own = Studies()
    monkeypatch.setattr(write_report, "CHAPTERS", ("claims", "trade"))
    monkeypatch.setattr(write_report, "load_chapter", own.load)
    monkeypatch.setattr(write_report, "read_section", lambda *_: {})
    return own


@pytest.fixture
def grow(studies: Studies, scene_file: SceneWriter, tmp_path: Path, shared_runs: Path) -> Grow:
    """Report of the small scene, as a function."""
    page = tmp_path / "results" / "report.html"
    return lambda: report([str(scene_file())], page, shared_runs, EngineSelection(allow_missing=True), studies=True)


def to_come(tmp_path: Path) -> list[str]:
    found: list[str] = json.loads((tmp_path / "results" / "report.json").read_text())["to_come"]
    return found


def test_the_page_is_announced_before_any_study_and_names_the_studies_to_come(
    studies: Studies, grow: Grow, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert grow() == 0
    first, second, third = capsys.readouterr().out.splitlines()
    assert first.endswith(" not run; to come: claims, trade")
    assert second.endswith(" not run; to come: trade")
    assert third.endswith(" not run")
    assert studies.made == ["claims", "trade"]
    links = [re.findall(r"Still to come, while .*: (.*)\. Load", page) for page in studies.pages]
    assert links == [["Claims, Cost of accuracy"], ["Cost of accuracy"]]
    assert to_come(tmp_path) == []
    assert "Still to come" not in (tmp_path / "results" / "report.html").read_text()


def test_a_report_on_named_scenes_is_on_these_scenes_alone(
    scene_file: SceneWriter, tmp_path: Path, shared_runs: Path
) -> None:
    page = tmp_path / "results" / "report.html"
    assert (
        report(
            [str(scene_file("steel", top="title = 'Steel beads'"))],
            page,
            shared_runs,
            EngineSelection(allow_missing=True),
        )
        == 0
    )
    text = page.read_text()
    assert "<h1>Steel beads: do the codes agree?</h1>" in text
    assert re.findall(r'<section id="([^"]*)"', text) == ["scene-steel"]
    assert re.findall(r'<li><a href="#([^"]*)"', text) == ["verdicts", "scene-steel"]
    assert not [words for words in ("Statements of the paper", "Table 1", "Independent cases") if words in text]
    assert json.loads(page.with_suffix(".json").read_text())["independent"] == []


def test_studies_made_before_an_interrupt_are_not_made_again(studies: Studies, grow: Grow, tmp_path: Path) -> None:
    def interrupt() -> None:
        raise KeyboardInterrupt

    studies.instead["trade"] = interrupt
    with pytest.raises(KeyboardInterrupt):
        grow()
    assert to_come(tmp_path) == ["trade"]
    studies.instead.clear()
    assert grow() == 0
    assert studies.made == ["claims", "trade"]
    assert grow() == 0
    assert studies.made == ["claims", "trade"]


def test_claims_are_made_again_if_a_source_is_newer_and_other_tables_stay(
    studies: Studies, grow: Grow, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert grow() == 0
    newer = tmp_path / "root" / "drivers" / "new.py"
    newer.parent.mkdir(parents=True)
    newer.touch()
    monkeypatch.setattr(paths, "ROOT", tmp_path / "root")
    for each in (kept._program, kept.digest_of_sources):
        each.cache_clear()
    assert grow() == 0
    assert studies.made == ["claims", "trade", "claims"]
    monkeypatch.undo()
    for each in (kept._program, kept.digest_of_sources):
        each.cache_clear()


@pytest.mark.parametrize("name", ["claims", "trade"])
def test_damaged_tables_are_made_again_with_one_line(
    name: str, studies: Studies, grow: Grow, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert grow() == 0
    table = tmp_path / "results" / f"{name}.csv"
    table.write_text(table.read_text().replace("1.0", "2.0"))
    capsys.readouterr()
    assert grow() == 0
    assert studies.made == ["claims", "trade", name]
    lines = [line for line in capsys.readouterr().err.splitlines() if f"{name}.csv" in line]
    assert len(lines) == 1
    assert "altered since it was written" in lines[0]


def test_a_study_that_fails_leaves_the_others_and_the_page(
    studies: Studies, grow: Grow, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    def fail() -> None:
        raise RunError("a bead was lost")

    studies.instead["claims"] = fail
    assert grow() == 1
    assert studies.made == ["trade"]
    assert "claims: a bead was lost" in capsys.readouterr().err
    assert to_come(tmp_path) == []


def test_every_call_reports_a_missed_requirement(
    studies: Studies, grow: Grow, capsys: pytest.CaptureFixture[str]
) -> None:
    studies.failed = [without_run("fig4", "yade", "the limit is wrong", FAIL)]
    for _ in range(2):
        assert grow() == 1
        assert capsys.readouterr().err.count("the limit is wrong") == 2  # once for each study
    assert studies.made == ["claims", "trade"]
