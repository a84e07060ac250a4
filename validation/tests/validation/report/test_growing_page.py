"""The page is written first and grows by figures and studies; finished ones are not made again."""

import json
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import pytest

from drivers.base import kept, paths
from drivers.base.errors import InputError, RunError
from postproc.draw.product import Product
from postproc.draw.style import pyplot
from postproc.figures import Caption
from validation import chapters
from validation.chapters import Chapter, Options, frame_of, read_section
from validation.checks import FAIL, Check, without_run
from validation.compare.comparison import ComparedScene
from validation.compare.selection import EngineSelection
from validation.report import page_figures, write_report
from validation.report.write_report import report
from validation.tests.helpers.runs import checks_of

Grow = Callable[..., int]
PARTS = ["fig1", "claims", "trade"]


@dataclass(frozen=True)
class Row:
    """Row of a trivial study."""

    value: float


class Parts:
    """A figure and two studies that count how often they are made; ``instead`` replaces the work of one."""

    def __init__(self) -> None:
        self.made: list[str] = []
        self.pages: list[str] = []
        self.instead: dict[str, Callable[[], None]] = {}
        self.failed: list[Check] = []

    def make(self, name: str, folder: Path) -> None:
        self.pages.append((folder / "report.html").read_text())
        self.instead.get(name, lambda: None)()
        self.made.append(name)

    def load(self, name: str) -> Chapter:
        def measure(options: Options) -> Mapping[str, Any]:
            self.make(name, options.results)
            return {name: [Row(1.0)]}

        return Chapter(
            name, f"about {name}", {name: Row}, measure, lambda _: [f"{name} says so"], lambda _: {},
            judge=lambda _: self.failed,
        )  # fmt: skip


@pytest.fixture
def parts(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Parts:
    own = Parts()

    def make_figure(name: str, _: Path) -> Product:
        own.make(name, tmp_path / "results")
        return Product(pyplot().figure(), frame_of(Row, [Row(2.0)]))

    def captions() -> dict[str, Caption]:
        return {"fig1": Caption("Fig. 1", "A finding.", "A caption.")}

    monkeypatch.setattr(write_report, "CHAPTERS", ("claims", "trade"))
    monkeypatch.setattr(write_report, "SECTIONS", {"figures": ("Figures", "All figures")})
    monkeypatch.setattr(chapters, "make_figure", make_figure)
    for module in (write_report, chapters):
        monkeypatch.setattr(module, "load_chapter", own.load)
    for module in (write_report, page_figures):
        monkeypatch.setattr(module, "captions", captions)
    return own


@pytest.fixture
def grow(parts: Parts, compared: ComparedScene, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Grow:
    """Report of a compared scene with studies, as a function."""
    absent = {"yade": "not installed"}
    scene = replace(compared, absent=absent, checks=checks_of(compared.case, compared.runs, absent))
    monkeypatch.setattr(write_report, "run_and_compare_all", lambda *_, **__: [scene])
    page, asked = tmp_path / "results" / "report.html", EngineSelection(allow_missing=True)
    return lambda **options: report(
        [compared.case.scene.file], page, None, asked, "make it", **{"studies": True} | options
    )


def to_come(tmp_path: Path) -> list[str]:
    found: list[str] = json.loads((tmp_path / "results" / "report.json").read_text())["to_come"]
    return found


def test_the_page_is_announced_before_any_part_and_names_the_parts_to_come(
    parts: Parts, grow: Grow, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert grow() == 0
    lines = capsys.readouterr().out.splitlines()
    assert [line.partition("to come: ")[2] for line in lines] == ["fig1, claims, trade", "claims, trade", "trade", ""]
    assert parts.made == PARTS
    named = [re.findall(r"Still to come, while <code>make it</code> is running: (.*)\. Load", p) for p in parts.pages]
    assert named == [["fig1, claims, trade"], ["claims, trade"], ["trade"]]
    assert "fig1 is still to come" in parts.pages[0]
    assert "A finding." in parts.pages[1]
    assert to_come(tmp_path) == []
    assert "to come" not in (tmp_path / "results" / "report.html").read_text()


def test_a_report_on_named_scenes_is_on_these_scenes_alone(grow: Grow, parts: Parts, tmp_path: Path) -> None:
    assert grow(studies=False) == 0
    assert parts.made == []
    text = (tmp_path / "results" / "report.html").read_text()
    assert re.findall(r"<h1>(.*)</h1>", text) == ["scene: do the codes agree?"]
    assert re.findall(r'<section id="([^"]*)"', text) == ["codes", "made"]
    assert re.findall(r'<li><a href="#([^"]*)"', text) == ["answer", "codes", "made"]
    assert re.findall(r'<details class="scene"[^>]*( open)>', text) == [" open"]
    assert not [words for words in ("Statements", "Table 1", "make claims", "Phys. Rev.") if words in text]
    assert json.loads((tmp_path / "results" / "report.json").read_text())["independent"] == []


@pytest.mark.parametrize("name", ["fig1", "trade"])
def test_parts_made_before_an_interrupt_are_not_made_again(name: str, parts: Parts, grow: Grow, tmp_path: Path) -> None:
    def interrupt() -> None:
        raise KeyboardInterrupt

    parts.instead[name] = interrupt
    with pytest.raises(KeyboardInterrupt):
        grow()
    assert to_come(tmp_path) == PARTS[PARTS.index(name) :]
    parts.instead.clear()
    assert grow() == 0
    assert parts.made == PARTS
    assert grow() == 0
    assert parts.made == PARTS


def test_figures_and_claims_are_made_again_if_a_source_is_newer_and_other_tables_stay(
    parts: Parts, grow: Grow, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert grow() == 0
    newer = tmp_path / "root" / "drivers" / "new.py"
    newer.parent.mkdir(parents=True)
    newer.touch()
    monkeypatch.setattr(paths, "ROOT", tmp_path / "root")
    for each in (kept._program, kept.digest_of_sources):
        each.cache_clear()
    assert grow() == 0
    assert parts.made == [*PARTS, "fig1", "claims"]
    monkeypatch.undo()
    for each in (kept._program, kept.digest_of_sources):
        each.cache_clear()


@pytest.mark.parametrize(("name", "ending"), [("claims", "csv"), ("trade", "csv"), ("fig1", "svg")])
def test_damaged_files_are_made_again_with_one_line(
    name: str, ending: str, parts: Parts, grow: Grow, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert grow() == 0
    file = tmp_path / "results" / f"{name}.{ending}"
    file.write_text(file.read_text().replace("1", "2"))
    capsys.readouterr()
    assert grow() == 0
    assert parts.made == [*PARTS, name]
    lines = [line for line in capsys.readouterr().err.splitlines() if file.name in line]
    assert len(lines) == 1
    assert "altered since it was written" in lines[0]


def test_a_folder_in_place_of_a_table_stops_its_part_alone(
    parts: Parts, grow: Grow, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "results" / "fig1.csv").mkdir(parents=True)
    assert grow() == 1
    assert parts.made == [*PARTS]
    assert "fig1: [Errno" in capsys.readouterr().err
    assert to_come(tmp_path) == []
    assert grow() == 1  # the others are not made again
    assert parts.made == [*PARTS, "fig1"]


def test_a_damaged_figure_is_named_before_any_run(
    parts: Parts, grow: Grow, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert grow() == 0
    file = tmp_path / "results" / "fig1.svg"
    file.write_text(file.read_text().replace("1", "2"))
    monkeypatch.setattr(write_report, "run_and_compare_all", lambda *_, **__: pytest.fail("runs"))
    with pytest.raises(InputError, match=r"fig1\.svg"):
        report([], tmp_path / "results" / "report.html", None, EngineSelection(), "make it")
    assert parts.made == [*PARTS]


@pytest.mark.parametrize("name", ["fig1", "claims"])
def test_a_part_that_fails_leaves_the_others_and_the_page(
    name: str, parts: Parts, grow: Grow, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    def fail() -> None:
        raise RunError("a bead was lost")

    parts.instead[name] = fail
    assert grow() == 1
    assert parts.made == [part for part in PARTS if part != name]
    assert f"{name}: a bead was lost" in capsys.readouterr().err
    assert to_come(tmp_path) == []


def test_a_chapter_is_complete_with_its_main_table(parts: Parts, grow: Grow, tmp_path: Path) -> None:
    """A study that is stopped while it writes has no main table, and is made again."""
    assert grow() == 0
    main = tmp_path / "results" / "trade.csv"

    def stopped(_: chapters.Tables) -> Mapping[str, chapters.Picture]:
        raise KeyboardInterrupt

    broken = replace(parts.load("trade"), figures=stopped)
    with pytest.raises(KeyboardInterrupt):
        chapters.write_chapter(broken, {"trade": [Row(1.0)]}, main.parent)
    assert not main.exists()
    assert read_section("trade", main.parent) == {}
    assert grow() == 0
    assert parts.made == [*PARTS, "trade"]


def test_every_call_reports_a_missed_requirement(parts: Parts, grow: Grow, capsys: pytest.CaptureFixture[str]) -> None:
    parts.failed = [without_run("fig4", "yade", "the limit is wrong", FAIL)]
    for _ in range(2):
        assert grow() == 1
        assert capsys.readouterr().err.count("the limit is wrong") == 2  # once for each study
    assert parts.made == PARTS
