"""Equal verdicts in the page and in JSON, also with hostile texts."""

import json
import re
from collections import Counter
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import pytest

from drivers.base.files import sealed_file
from validation.chapters import write_table
from validation.checks import FAIL, NOT_RUN, PASS, Check, without_run
from validation.compare.comparison import ComparedScene
from validation.report.machine_readable import cpu_name
from validation.report.write_report import write_report
from validation.tests.helpers.commands import beads
from validation.tests.helpers.runs import checks_of, finished
from validation.tests.helpers.scenes import SceneWriter, case_of
from validation.tests.validation.claims.published import published_checks

HOSTILE = """</script><script>throw 1</script><b>&'"{{ 7 * 7 }}]]>\x1b[31m\x00"""


class Table(HTMLParser):
    """Scene, engine and verdict of the cells of the page's table of verdicts; and all tags."""

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
        if tag in ("th", "td") and self.inside:
            self.engine, self.heading = own.get("data-label") or "", own.get("scope") == "row"
            self.row = "" if self.heading else self.row
        if tag == "b" and self.inside:
            self.found.append((self.row, self.engine, (own.get("class") or "").replace("-", " ")))

    def handle_data(self, data: str) -> None:
        if self.inside and self.heading:
            self.row += data.strip()


@pytest.fixture
def hostile(scene_file: SceneWriter, shared_runs: Path) -> ComparedScene:
    """A scene with hostile texts, a failed engine and a missing engine."""
    printable = HOSTILE.replace("\x1b", "").replace("\x00", "")
    case = case_of(scene_file("scene", top=f"title = '''{printable}'''"))
    runs = {engine: finished(case, engine, shared_runs) for engine in ("verlet", "reference")}
    absent = {"liggghts": "not installed", "yade": f"failed: exit code 1: {HOSTILE}"}
    diagnoses = {"yade": f"matches {HOSTILE}"}
    return ComparedScene(case, runs, absent, checks_of(case, runs, absent), {}, diagnoses)


@pytest.fixture
def written(hostile: ComparedScene, tmp_path: Path) -> tuple[str, dict[str, Any]]:
    """Page and JSON of the hostile scene and of cases beyond the paper, one of which fails."""
    folder = tmp_path / "results"
    *checks, second, last = published_checks(("yade", "reference"))
    failed = replace(second, verdict=FAIL, value=2 * second.limit)
    absent = without_run(last.scene, last.engine, "not installed", NOT_RUN)
    write_table(folder / "claims.csv", Check, [*checks, failed, absent])
    write_report([hostile], folder / "report.html", HOSTILE)
    page, data = (
        (folder / "report.html").read_text(),
        json.loads((folder / "report.json").read_text(), parse_constant=no),
    )
    assert sorted(path.name for path in folder.glob("[!.]*")) == ["claims.csv", "report.html", "report.json"]
    return page, data


def test_the_same_verdicts_in_both(written: tuple[str, dict[str, Any]]) -> None:
    page, data = written

    def in_json(kind: str) -> set[tuple[str, str, str]]:
        cells = ((row["name"], engine, cell) for row in data[kind] for engine, cell in row["engines"].items())
        return {(name, engine, cell["verdict"]) for name, engine, cell in cells}

    assert set(Table(page).found) == in_json("scenes")
    found = in_json("scenes") | in_json("independent")
    assert {verdict for _, _, verdict in found} == {PASS, FAIL, NOT_RUN}
    first = page[page.index('class="failures"') : page.index('class="lead"')]
    failed = re.findall(r"✗ (\S+) fails on (\S+)\.</b>", first)
    assert sorted(failed) == sorted((engine, name) for name, engine, verdict in found if verdict == FAIL)
    rows = [row for kind in ("scenes", "independent") for row in data[kind]]
    single = Counter(check["verdict"] for row in rows for cell in row["engines"].values() for check in cell["checks"])
    assert Counter({PASS: 0} | data["counts"]["checks"]) == single


def test_hostile_texts_stay_texts(written: tuple[str, dict[str, Any]]) -> None:
    page, data = written
    assert Table(page).tags["script"] == 1  # the script that opens folded parts
    assert "<script>throw" not in page
    assert "</script><b>" not in page
    assert "49" not in re.findall(r"<summary><h3>(.*?)</h3>", page)[0]
    assert data["scenes"][0]["engines"]["yade"]["diagnosis"] == f"matches {HOSTILE}"


def test_the_json_has_its_provenance(written: tuple[str, dict[str, Any]]) -> None:
    _, data = written
    assert data["schema_version"] == 2
    assert {"date", "commit", "command", "engines", "machine", "libraries"} <= data["made_with"].keys()
    assert data["made_with"]["machine"]["cores"] >= 1
    assert all({"version", "command", "sha256"} == own.keys() for own in data["made_with"]["engines"].values())
    own = data["scenes"][0]["engines"]["verlet"]
    assert own["run"]["status"] == "done"
    assert own["run"]["error_budget"]
    assert {"value", "limit", "reason", "where"} <= own["checks"][0].keys()
    absent = data["scenes"][0]["engines"]["liggghts"]["checks"][0]
    assert absent["value"] is None  # NaN


def test_no_file_is_replaced_unless_both_are_written(hostile: ComparedScene, tmp_path: Path) -> None:
    (tmp_path / "report.html").write_text("old")
    (tmp_path / "report.json").mkdir()
    with pytest.raises(OSError, match=r"report\.json"):
        write_report([hostile], tmp_path / "report.html")
    assert (tmp_path / "report.html").read_text() == "old"
    assert sorted(path.name for path in tmp_path.iterdir() if path.suffix != ".toml") == ["report.html", "report.json"]


def test_a_hostile_figure_is_bytes_in_the_page(tmp_path: Path) -> None:
    hostile = '<svg xmlns="http://www.w3.org/2000/svg" width="9pt" onload="throw 1"><script>throw 2</script></svg>'
    with sealed_file(tmp_path / "fig4.svg") as draft:
        draft.write_text(hostile)
    write_report([], tmp_path / "report.html")
    text = (tmp_path / "report.html").read_text()
    assert Table(text).tags["script"] == 1  # the script that opens folded parts
    assert Table(text).tags["img"] == 1
    assert "throw" not in text


@pytest.mark.long
def test_the_command_writes_both_files_and_records_its_arguments(scene_file: SceneWriter, tmp_path: Path) -> None:
    scene, page = scene_file(), tmp_path / "out" / "page.html"
    words = ("--out", page, "--runs", tmp_path / "runs", "--allow-missing")
    done = beads("report", scene, *words)
    assert done.returncode == 0, done.stderr
    data = json.loads(page.with_suffix(".json").read_text())
    assert data["made_with"]["command"].startswith("beads report ")
    assert str(scene) in data["made_with"]["command"]
    assert data["scenes"][0]["command"].endswith(f" --runs {tmp_path / 'runs'}")
    assert FAIL not in data["counts"]["checks"] or data["counts"]["checks"][FAIL] == 0
    for wrong in (("--out", tmp_path / "page.json"), (scene,), ("missing",), ("--out", "/proc/page.html")):
        refused = beads("report", scene, *wrong, "--runs", tmp_path / "fresh")
        assert refused.returncode == 2
        assert len(refused.stderr.splitlines()) == 1
        assert not (tmp_path / "fresh").exists(), "a deck was run"


def test_a_processor_has_a_name(tmp_path: Path) -> None:
    file = tmp_path / "cpuinfo"
    file.write_text("processor : 0\nmodel name : Some Chip: fast\n")
    assert cpu_name(file) == "Some Chip: fast"
    assert cpu_name(tmp_path / "none")


def no(constant: str) -> None:
    raise AssertionError(f"{constant} is not JSON")
