"""Equal verdicts in the page, in JSON and in JUnit XML, also with hostile texts."""

import json
import math
import re
from base64 import b64decode
from collections import Counter
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import pytest

from drivers.base import decks as deck
from postproc.draw.style import pyplot, svg_of
from validation.compare.comparison import ComparedScene, compare_case
from validation.compare.verdict import FAIL, NOT_RUN, PASS, Verdict, share_of_tolerance
from validation.independent.independent_study import Line
from validation.independent.posed_cases import read_independent
from validation.report.charts import PLACES, chart_of
from validation.report.machine_readable import cpu_name
from validation.report.page_figures import image_of
from validation.report.scene_section import worst_of
from validation.report.write_report import write_report
from validation.studies import write_table
from validation.tests.helpers.commands import command_line
from validation.tests.helpers.runs import finished
from validation.tests.helpers.scenes import SceneWriter, case_of

HOSTILE = """</script><script>throw 1</script><b>&'"{{ 7 * 7 }}]]>\x1b[31m\x00"""


class Table(HTMLParser):
    """Cells of the page's verdict tables, and all tags."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.tags: Counter[str] = Counter()
        self.found: list[tuple[str, str, str]] = []
        self.row = self.engine = ""
        self.heading = self.inside = False
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags[tag] += 1
        own = dict(attrs)
        if tag == "table":
            self.inside = "verdicts" in (own.get("class") or "").split()
        if tag == "th" and self.inside:
            self.row, self.heading = "", own.get("scope") == "row"
        if tag == "td":
            self.engine = own.get("data-label") or ""
        if tag == "b" and self.inside and self.engine:
            self.found.append((self.row, self.engine, (own.get("class") or "").replace("-", " ")))

    def handle_data(self, data: str) -> None:
        if self.heading:
            self.row += data.strip()

    def handle_endtag(self, tag: str) -> None:
        if tag == "th":
            self.heading = False
        if tag == "table":
            self.inside = False


@pytest.fixture
def hostile(scene_file: SceneWriter, shared_runs: Path) -> ComparedScene:
    """A scene with hostile texts, a failed engine and a missing engine."""
    printable = HOSTILE.replace("\x1b", "").replace("\x00", "")
    case = case_of(scene_file("scene", top=f"title = '''{printable}'''"))
    runs = {engine: finished(case, engine, shared_runs) for engine in ("verlet", "reference")}
    absent = {"liggghts": "not installed", "yade": f"failed: exit code 1: {HOSTILE}"}
    diagnoses = {"yade": f"matches {HOSTILE}"}
    return ComparedScene(case, runs, absent, compare_case(case, runs, absent), {}, diagnoses)


@pytest.fixture
def written(hostile: ComparedScene, tmp_path: Path) -> tuple[str, dict[str, Any], ElementTree.Element]:
    """Page, JSON and XML of the hostile scene and of independent cases, one of which fails."""
    folder = tmp_path / "results"
    lines = [line_of(entry.id, entry.title, engine, PASS)
             for entry in read_independent() for engine in ("yade", "reference")]  # fmt: skip
    lines[0] = replace(lines[0], verdict=FAIL, error=0.5)
    lines[2] = replace(lines[2], verdict=NOT_RUN, quantity="run", why="not installed", within=math.nan, error=math.nan)
    write_table(folder / "independent.csv", Line, lines)
    write_report([hostile], folder / "report.html", HOSTILE)
    page, data = (
        (folder / "report.html").read_text(),
        json.loads((folder / "report.json").read_text(), parse_constant=no),
    )
    assert sorted(path.name for path in folder.iterdir()) == [
        "independent.csv",
        "report.html",
        "report.json",
        "report.xml",
    ]
    return page, data, ElementTree.parse(folder / "report.xml").getroot()


def test_the_same_verdicts_in_all_three(written: tuple[str, dict[str, Any], ElementTree.Element]) -> None:
    page, data, root = written
    shown = set(Table(page).found)
    rows = [row for kind in ("scenes", "independent") for row in data[kind]]
    in_json = {(row["name"], engine, own["verdict"]) for row in rows for engine, own in row["engines"].items()}
    assert shown == in_json
    assert {verdict for _, _, verdict in in_json} == {PASS, FAIL, NOT_RUN}

    single = Counter(v["verdict"] for row in rows for own in row["engines"].values() for v in own["verdicts"])
    tests = root.findall("testsuite/testcase")
    assert Counter({PASS: 0} | data["counts"]["verdicts"]) == single
    assert len(tests) == single.total() == int(root.attrib["tests"])
    assert len(root.findall(".//failure")) == single[FAIL] == int(root.attrib["failures"])
    assert len(root.findall(".//skipped")) == single[NOT_RUN] == int(root.attrib["skipped"])
    names = [(test.attrib["classname"], test.attrib["name"]) for test in tests]
    assert len(set(names)) == len(names)
    for suite in root.findall("testsuite"):
        assert int(suite.attrib["tests"]) == len(suite.findall("testcase"))
        if suite.attrib["name"].startswith("independent."):
            assert {test.attrib["time"] for test in suite} == {"0.250"}
            assert suite.attrib["time"] == "0.500"  # two engines


def test_hostile_texts_stay_texts(written: tuple[str, dict[str, Any], ElementTree.Element]) -> None:
    page, data, root = written
    assert Table(page).tags["script"] == 2  # the values of the chart, and the script that shows them
    assert "<script>throw" not in page
    assert "</script><b>" not in page
    assert "49" not in re.findall(r"<h2>(.*?)</h2>", page)[0]
    assert data["scenes"][0]["engines"]["yade"]["diagnosis"] == f"matches {HOSTILE}"
    failure = root.find("testsuite/testcase[@classname='scenes.scene.yade']/failure")
    assert failure is not None
    assert "<b>&" in (failure.text or "")
    assert "matches </script>" in (failure.text or "")
    assert "python -m validation compare" in (failure.text or "")


def test_hostile_texts_stay_in_the_data_of_a_chart(hostile: ComparedScene) -> None:
    traces = {engine: run.trace for engine, run in hostile.runs.items()}
    chart = chart_of(hostile.case.layout, traces)
    odd = replace(chart, panels=[replace(panel, title=HOSTILE) for panel in chart.panels])
    text = deck.render("report/chart.html.j2", name=HOSTILE, chart=odd, places=PLACES, label=HOSTILE)
    tags = Table(text).tags
    assert (tags["script"], tags["b"]) == (1, 0)
    found = re.search(r"<script[^>]*>(.*?)</script>", text, re.DOTALL)
    assert found
    assert json.loads(found[1])["panels"][0]["title"] == HOSTILE


def test_the_json_has_its_provenance(written: tuple[str, dict[str, Any], ElementTree.Element]) -> None:
    _, data, _ = written
    assert data["schema_version"] == 1
    assert {"date", "commit", "command", "engines", "machine", "libraries"} <= data["made_with"].keys()
    assert data["made_with"]["machine"]["cores"] >= 1
    assert all({"version", "command", "sha256"} == own.keys() for own in data["made_with"]["engines"].values())
    own = data["scenes"][0]["engines"]["verlet"]
    assert own["run"]["status"] == "done"
    assert own["run"]["error_budget"]
    assert {"value", "limit", "reason", "where"} <= own["verdicts"][0].keys()
    absent = data["scenes"][0]["engines"]["liggghts"]["verdicts"][0]
    assert absent["value"] is None  # NaN


def test_no_file_is_replaced_unless_all_are_written(hostile: ComparedScene, tmp_path: Path) -> None:
    (tmp_path / "report.html").write_text("old")
    (tmp_path / "report.xml").mkdir()
    with pytest.raises(OSError, match=r"report\.xml"):
        write_report([hostile], tmp_path / "report.html")
    assert (tmp_path / "report.html").read_text() == "old"
    assert sorted(path.name for path in tmp_path.iterdir() if path.suffix != ".toml") == ["report.html", "report.xml"]


def test_the_worst_verdict_has_the_largest_share_and_nan_is_worse() -> None:
    verdicts = [verdict(1e-3, 1e-2), verdict(5e-9, 1e-8), verdict(0.0, 0.0)]
    assert worst_of(verdicts) is verdicts[1]
    assert worst_of([*verdicts, verdict(math.nan, 1.0)]) != verdicts[1]
    assert worst_of([verdict(math.nan, math.nan)]) is None
    assert share_of_tolerance(verdict(1.0, 0.0)) == math.inf
    expected = replace(verdict(9.0, 10.0), predicted=9.0)  # the error is as predicted
    assert share_of_tolerance(expected) == 0
    assert worst_of([expected, verdicts[0]]) is verdicts[0]


def test_a_picture_is_its_file_with_rounded_coordinates() -> None:
    """Texts keep their digits; images in the file, clipping, hatches and symbols stay."""
    figure, axis = pyplot().subplots(figsize=(2, 2))
    axis.plot(range(200), [x % 7 for x in range(200)], "o", label="once = 3.14159 < url(http://example.org)")
    axis.imshow([[0, 1], [1, 0]])
    axis.bar([0, 1], [1, 2], hatch="//")
    axis.legend()
    text = svg_of(figure)
    picture = image_of(text)
    kind, _, data = picture.address.partition(",")
    assert kind == "data:image/svg+xml;base64"
    shown = b64decode(data).decode()
    whole, small = ElementTree.fromstring(text), ElementTree.fromstring(shown)
    assert [each.tag for each in small.iter()] == [each.tag for each in whole.iter()]
    assert "once = 3.14159 &lt; url(http://example.org)" in shown
    assert len(shown) < 0.95 * len(text)
    for each, own in zip(whole.iter(), small.iter(), strict=True):
        for name in ("x", "y"):
            assert float(own.get(name, 0)) == pytest.approx(float(each.get(name, 0)), abs=0.01)
    assert picture.width_px == round(1.6 * float(whole.attrib["width"].removesuffix("pt")))


def test_a_hostile_figure_is_bytes_in_the_page(tmp_path: Path) -> None:
    hostile = '<svg xmlns="http://www.w3.org/2000/svg" width="9pt" onload="throw 1"><script>throw 2</script></svg>'
    (tmp_path / "fig4.svg").write_text(hostile)
    write_report([], tmp_path / "report.html")
    text = (tmp_path / "report.html").read_text()
    assert Table(text).tags["script"] == 1  # the script that shows the values of charts
    assert Table(text).tags["img"] == 1
    assert "throw" not in text


@pytest.mark.long
def test_the_command_writes_all_three_files_and_records_its_arguments(scene_file: SceneWriter, tmp_path: Path) -> None:
    scene, page = scene_file(), tmp_path / "out" / "page.html"
    words = ("--out", page, "--runs", tmp_path / "runs", "--allow-missing")
    done = command_line("validation", "report", scene, *words)
    assert done.returncode == 0, done.stderr
    data = json.loads(page.with_suffix(".json").read_text())
    assert data["made_with"]["command"].startswith("python -m validation report ")
    assert str(scene) in data["made_with"]["command"]
    assert data["scenes"][0]["command"].endswith(f" --runs {tmp_path / 'runs'}")
    assert ElementTree.parse(page.with_suffix(".xml")).getroot().attrib["failures"] == "0"
    for wrong in (("--out", tmp_path / "page.json"), (scene,), ("missing",), ("--out", "/proc/page.html")):
        refused = command_line("validation", "report", scene, *wrong, "--runs", tmp_path / "fresh")
        assert refused.returncode == 2
        assert len(refused.stderr.splitlines()) == 1
        assert not (tmp_path / "fresh").exists(), "a deck was run"


def test_a_processor_has_a_name(tmp_path: Path) -> None:
    file = tmp_path / "cpuinfo"
    file.write_text("processor : 0\nmodel name : Some Chip: fast\n")
    assert cpu_name(file) == "Some Chip: fast"
    assert cpu_name(tmp_path / "none")


def verdict(value: float, limit: float) -> Verdict:
    return Verdict("scene", "verlet", "force", value, limit, "because", "there", PASS if value <= limit else FAIL)


def line_of(case: str, title: str, engine: str, word: str) -> Line:
    """Line of the table of independent cases."""
    return Line(case, title, "", engine, "peak_force_N", "N", "theory", 1.0, 1.0, 0.0, "relative", 0.1, word, "",
                "a reason of some length", "a source", 0.25)  # fmt: skip


def no(constant: str) -> None:
    raise AssertionError(f"{constant} is not JSON")
