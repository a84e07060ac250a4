"""The page is written first and grows by figures and studies; finished ones are not made again."""

import json
import re
import time
from collections.abc import Callable
from pathlib import Path

import pandas as pd
import pytest

from drivers.base import cache, paths
from drivers.base.errors import InputError, RunError
from drivers.run.execute import Place
from postproc.draw.plot import Product, pyplot
from postproc.figures import Caption
from validation import chapters
from validation.checks import FAIL, Check, without_run
from validation.compare.comparison import ComparedScene, EngineSelection
from validation.report import write_report
from validation.report.parts import Chapter, read_part, write_part
from validation.report.write_report import report

Grow = Callable[..., int]
PARTS = ["fig1", "claims", "trade"]


class Parts:
    """A figure and two studies that count how often they are made; ``instead`` replaces the work of one.

    Attributes:
        patient: True to make each part when the page shows those made before.
    """

    def __init__(self, results: Path) -> None:
        self.results = results
        self.made: list[str] = []
        self.patient = False
        self.pages: list[str] = []
        self.instead: dict[str, BaseException] = {}
        self.failed: list[Check] = []

    def make(self, name: str) -> None:
        page, until_s = self.results / "report.html", time.monotonic() + 10
        while self.patient and {*self.made} & {*to_come_on(page.read_text())} and time.monotonic() < until_s:
            time.sleep(0.02)
        self.pages.append(page.read_text())
        if name in self.instead:
            raise self.instead[name]
        self.made.append(name)

    def measure(self, name: str, _: object) -> Chapter:
        self.make(name)
        return Chapter({name: pd.DataFrame({"value": [1.0]})}, [f"{name} says so", "and so"], checks=self.failed)

    def make_figure(self, name: str, _: Path) -> Product:
        self.make(name)
        return Product(pyplot().figure(), pd.DataFrame({"value": [2.0]}))

    @property
    def to_come(self) -> list[str]:
        found: list[str] = json.loads((self.results / "report.json").read_text())["to_come"]
        return found

    def damage(self, file: str) -> None:
        """Alter a file that has been written."""
        (self.results / file).write_text((self.results / file).read_text().replace("1", "2", 1))


def to_come_on(page: str) -> list[str]:
    """Parts that a page names as still to come."""
    named = re.search(r"Still to come, while <code>make it</code> is running: (.*)\. Load", page)
    return named[1].split(", ") if named else []


@pytest.fixture
def parts(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Parts:
    parts = Parts(tmp_path / "results")
    monkeypatch.setattr(write_report, "CHAPTERS", ("claims", "trade"))
    monkeypatch.setattr(write_report, "SECTIONS", {"figures": ("Figures", "All figures")})
    monkeypatch.setattr(write_report, "compare_cases", lambda *_, **__: [])
    monkeypatch.setattr(chapters, "make_figure", parts.make_figure)
    monkeypatch.setattr(chapters, "measure", parts.measure)
    for module in (write_report, chapters):
        monkeypatch.setattr(module, "captions", lambda: {"fig1": Caption("Fig. 1", "A finding.", "A caption.")})
    return parts


@pytest.fixture
def grow(parts: Parts) -> Grow:
    """Report with studies, as a function of its scenes."""
    page, asked = parts.results / "report.html", EngineSelection(allow_missing=True)
    return lambda *scenes, studies=True: report(scenes, page, None, asked, "make it", studies=studies, place=Place(1))


def test_the_page_is_announced_before_any_part_and_names_the_parts_to_come(
    parts: Parts, grow: Grow, capsys: pytest.CaptureFixture[str]
) -> None:
    parts.patient = True
    assert grow() == 0
    lines = capsys.readouterr().out.splitlines()
    assert [line.partition("to come: ")[2] for line in lines] == ["fig1, claims, trade", "claims, trade", "trade", ""]
    assert parts.made == PARTS
    assert [to_come_on(page) for page in parts.pages] == [PARTS, PARTS[1:], PARTS[2:]]
    assert "fig1 is still to come" in parts.pages[0]
    assert "A finding." in parts.pages[1]
    assert parts.to_come == []
    assert "to come" not in (parts.results / "report.html").read_text()


def test_an_engine_that_fails_gives_exit_code_1(
    grow: Grow, compared: ComparedScene, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(write_report, "compare_cases", lambda *_, **__: [compared])
    assert grow(compared.case.scene.file, studies=False) == 1


@pytest.mark.parametrize("name", ["fig1", "trade"])
def test_parts_made_before_an_interrupt_are_not_made_again(name: str, parts: Parts, grow: Grow) -> None:
    parts.instead[name] = KeyboardInterrupt()
    with pytest.raises(KeyboardInterrupt):
        grow()
    assert name in parts.to_come
    parts.instead.clear()
    for _ in range(2):
        assert grow() == 0
        assert sorted(parts.made) == sorted(PARTS)


def test_figures_and_claims_are_made_again_if_a_source_is_newer_and_other_tables_stay(
    parts: Parts, grow: Grow, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert grow() == 0
    newer = tmp_path / "root" / "drivers" / "new.py"
    newer.parent.mkdir(parents=True)
    newer.touch()
    with monkeypatch.context() as changed:
        changed.setattr(paths, "ROOT", tmp_path / "root")
        for function in (cache._program, cache.digest_of_sources):
            function.cache_clear()
        assert grow() == 0
    assert parts.made == [*PARTS, "fig1", "claims"]
    for function in (cache._program, cache.digest_of_sources):
        function.cache_clear()


@pytest.mark.parametrize("file", ["parts/claims.json", "parts/trade.json", "parts/fig1.json"])
def test_damaged_files_are_made_again_with_one_line(
    file: str, parts: Parts, grow: Grow, capsys: pytest.CaptureFixture[str]
) -> None:
    assert grow() == 0
    parts.damage(file)
    capsys.readouterr()
    assert grow() == 0
    assert parts.made == [*PARTS, Path(file).stem]
    (line,) = [line for line in capsys.readouterr().err.splitlines() if file in line]
    assert "altered since it was written" in line


def test_an_edited_table_or_picture_is_an_output_that_nothing_reads(parts: Parts, grow: Grow) -> None:
    assert grow() == 0
    page = (parts.results / "report.html").read_text()
    for file in ("claims.csv", "fig1.csv", "fig1.svg"):
        parts.damage(file)
    assert grow() == 0
    assert parts.made == PARTS
    made = page.index('<section id="made"') if '<section id="made"' in page else len(page)
    assert (parts.results / "report.html").read_text()[:made] == page[:made]


def test_a_damaged_figure_is_named_before_any_run(parts: Parts, grow: Grow, monkeypatch: pytest.MonkeyPatch) -> None:
    assert grow() == 0
    parts.damage("parts/fig1.json")
    monkeypatch.setattr(write_report, "compare_cases", lambda *_, **__: pytest.fail("runs"))
    with pytest.raises(InputError, match=r"fig1\.json"):
        grow(studies=False)


@pytest.mark.parametrize(("name", "failure"), [("fig1", OSError), ("claims", RunError)])
def test_a_part_that_fails_leaves_the_others_and_the_page(
    name: str, failure: type[Exception], parts: Parts, grow: Grow, capsys: pytest.CaptureFixture[str]
) -> None:
    parts.instead[name] = failure("a bead was lost")
    assert grow() == 1
    assert parts.made == [part for part in PARTS if part != name]
    assert f"{name}: a bead was lost" in capsys.readouterr().err
    assert parts.to_come == []


def test_a_chapter_is_stored_when_all_its_files_are_written(parts: Parts, grow: Grow) -> None:
    """A chapter that is stopped while it writes is not on the page."""
    (parts.results / "trade-more.csv").mkdir(parents=True)
    table = pd.DataFrame({"value": [1.0]})
    with pytest.raises(OSError, match=r"trade-more\.csv"):
        write_part("trade", Chapter({"trade": table, "trade-more": table}), parts.results)
    assert read_part("trade", parts.results) is None
    (parts.results / "trade-more.csv").rmdir()
    assert grow() == 0
    assert parts.made == PARTS


def test_every_call_reports_a_missed_requirement(parts: Parts, grow: Grow, capsys: pytest.CaptureFixture[str]) -> None:
    parts.failed = [without_run("fig4", "yade", "the limit is wrong", FAIL)]
    for _ in range(2):
        assert grow() == 1
        assert capsys.readouterr().err.count("the limit is wrong") == 2  # once for each study
    assert parts.made == PARTS
