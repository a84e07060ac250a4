"""The page and its JSON: failures first, equal verdicts in both, hostile texts, damaged files, exit codes."""

import html
import json
import os
import re
from base64 import b64decode, b64encode
from collections import Counter
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from drivers.base import paths
from drivers.base.errors import InputError
from drivers.base.files import DAMAGED
from drivers.chain.trace import until
from validation.chapters import shown_of
from validation.checks import FAIL, NOT_RUN, PASS, share_of_limit, short
from validation.compare.comparison import ComparedScene
from validation.report.parts import Chapter, part_file, store_part
from validation.report.scene_section import scene_row, section_of
from validation.report.write_report import marked, write_report
from validation.tests.helpers.commands import beads
from validation.tests.helpers.runs import blown_up, checks_of, finished
from validation.tests.helpers.scenes import SceneWriter, case_of
from validation.tests.validation.report.conftest import HOSTILE, write_table_1


class Page(HTMLParser):
    """Tags, addresses and labels of a page; scene, engine and verdict of the cells of its table of verdicts."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.tags: Counter[str] = Counter()
        self.addresses: list[str] = []
        self.verdicts: set[tuple[str, str, str]] = set()
        self.row = self.engine = ""
        self.heading = self.inside = False
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags[tag] += 1
        values = {name: value or "" for name, value in attrs}
        self.addresses += [value for name, value in values.items() if name in ("src", "href", "xlink:href")]
        if tag == "table":
            self.inside = "verdicts" in values.get("class", "").split()
        if tag in ("th", "td") and self.inside:
            self.engine, self.heading = values.get("data-label", ""), values.get("scope") == "row"
            self.row = "" if self.heading else self.row
        if tag == "b" and self.inside and "class" in values:
            self.verdicts.add((self.row, self.engine, values.get("class", "").replace("-", " ")))

    def handle_data(self, data: str) -> None:
        if self.inside and self.heading:
            self.row += data.strip()


def page_of(scenes: list[ComparedScene], folder: Path) -> str:
    """Text of the page of scenes, written into a folder."""
    write_report(scenes, folder / "report.html", "make it again", Path("my runs"))
    return (folder / "report.html").read_text()


def json_of(folder: Path) -> dict[str, Any]:
    def refuse(constant: str) -> None:
        raise AssertionError(f"{constant} is not JSON")

    data: dict[str, Any] = json.loads((folder / "report.json").read_text(), parse_constant=refuse)
    return data


def failures(page: str) -> str:
    """Part of the page on failures."""
    return page[page.index('class="failures"') : page.index('class="lead"')]


def unfolded(page: str) -> int:
    """Number of scenes that are open at first."""
    return len(re.findall(r'<details class="scene"[^>]* open>', page))


def test_the_page_stands_alone_with_the_paper_first_and_the_codes_last(compared: ComparedScene, tmp_path: Path) -> None:
    text = page_of([compared], tmp_path)
    page = Page(text)
    assert page.addresses
    assert all(address.startswith(("#", "data:")) for address in page.addresses)
    assert (page.tags["img"], page.tags["figure"]) == (2, 2)
    assert re.search(r"2 passed.*1 failed.*1 not run", text, re.DOTALL)
    assert "ERROR &lt;b&gt;&amp;" in text  # of the failed run
    ids = re.findall(r'<(?:header|section) id="([^"]*)"', text)
    assert ids == ["answer", "figures", "claims", "calibration", "trade", "stability", "elements", "codes", "made"]
    assert re.findall(r'<li><a href="#([^"]*)"', text) == ids
    for target in ("table1", "claims", "fig3", "trade", "stability", "elements", "calibration"):  # none is made yet
        assert f"<code>make {target}</code>" in text, target
    assert "make it again" in text[text.index('<section id="made"') :]


def test_a_failure_is_named_first_with_its_diagnosis_and_a_command_for_details(
    compared: ComparedScene, tmp_path: Path
) -> None:
    run = compared.runs["verlet"]
    late = replace(run)
    object.__setattr__(late, "trace", replace(run.trace, force_N=np.roll(run.trace.force_N, 1, axis=0)))
    runs, absent = compared.runs | {"yade": late}, {"liggghts": "not installed"}
    checks = checks_of(compared.case, runs, absent)
    sick = ComparedScene(compared.case, runs, absent, checks, {"yade": "matches forces a sample <late>"})
    name = scene_row(sick)["engines"]["yade"]["worst"]
    (worst,) = (check for check in sick.of_engine("yade") if check.quantity == name)
    assert max(map(share_of_limit, sick.of_engine("yade"))) == share_of_limit(worst)
    text = page_of([sick], tmp_path)
    assert "yade fails on scene." in failures(text)
    assert "matches forces a sample &lt;late&gt;" in failures(text)
    for words in (worst.quantity, short(worst.value), short(worst.limit), worst.where):
        assert words in html.unescape(failures(text)), words
    again = f"beads compare {compared.case.scene.file} --runs 'my runs'"
    assert f"Look closer: <code>{again}</code>" in html.unescape(text)
    assert json_of(tmp_path)["scenes"][0]["command"] == again
    assert unfolded(text) == 1
    well = page_of([replace(sick, checks=[], diagnoses={})], tmp_path)
    assert 'class="failures"' not in well
    assert unfolded(well) == 0


def test_failed_runs_are_shown_with_their_partial_traces_and_decks(compared: ComparedScene, tmp_path: Path) -> None:
    """A run that blew up and a run that ended early are drawn with the others, on the scale of the others."""
    (deck,) = section_of(compared, paths.RESULTS)["decks"]
    assert deck[:2] == ("yade", "chain.py")
    assert "hertzian=True" in deck[2]
    good = compared.runs["verlet"].trace
    refused = {"yade": blown_up(good, 100), "liggghts": until(good, 60)}
    absent = dict.fromkeys(refused, "failed: unstable <b>")
    checks = checks_of(compared.case, compared.runs, absent)
    sick = replace(compared, absent=absent, checks=checks, refused=refused)
    section = section_of(sick, paths.RESULTS)
    assert section["forces"]
    assert {engine for engine, _, _ in section["decks"]} == {"yade", "liggghts"}
    assert list(section["runs"]) == ["reference", "verlet"]  # observables are of finished runs alone
    assert write_report([sick], tmp_path / "report.html") == {PASS: 2, FAIL: 2}
    yade = json_of(tmp_path)["scenes"][0]["engines"]["yade"]
    assert yade["checks"][0]["where"] == "failed: unstable <b>"


def test_a_scene_without_a_finished_run_shows_partial_traces(compared: ComparedScene, tmp_path: Path) -> None:
    good = compared.runs["verlet"].trace
    refused = {"yade": replace(good, force_N=np.nan * good.force_N)}
    absent = {"yade": "failed: unstable"}
    alone = ComparedScene(compared.case, {}, absent, checks_of(compared.case, {}, absent), {}, refused)
    text = page_of([alone], tmp_path)
    assert "No engine finished this scene" in text
    (drawn, *_) = re.findall(r'alt="Gauge forces[^>]*src="data:image/svg.xml;base64,([^"]*)"', text)
    assert b"yade (failed)" in b64decode(drawn)


def test_chains_at_rest_and_without_gauges_have_a_page(
    scene_file: SceneWriter, shared_runs: Path, tmp_path: Path
) -> None:
    case = case_of(scene_file("free", wall="", striker="", duration="2 us"))
    run = finished(case, "verlet", shared_runs)
    odd = replace(run)
    object.__setattr__(odd, "trace", replace(run.trace, momentum_N_s=run.trace.momentum_N_s - 1e-41))
    checks, others = (checks_of(case, {name: trace}, {}) for name, trace in (("verlet", run), ("yade", odd)))
    assert {check.verdict for check in (*checks, *others)} == {PASS}  # without an error of momentum
    text = page_of([ComparedScene(case, {"verlet": run}, {}, checks)], tmp_path)
    assert Page(text).tags["figure"] == 1  # only the chain can be drawn
    assert "nan" not in text[text.index("<section") :].lower().split()


@pytest.mark.parametrize(
    ("text", "set_as"),
    [
        ("pass 1.2e-9", '<b class="pass" role="img" aria-label="pass">✓</b> <span class="number">1.2e-9</span>'),
        ("fail 2\nat <1>", '<b class="fail">✗ fail</b> 2<small>at &lt;1&gt;</small>'),
        ("not run\nrefused", '<b class="not-run">not run</b> <small>refused</small>'),
        ("differs V_s", '<span class="differs">V<sub>s</sub></span>'),
        ("passes", "passes"),
        ("a pass", "a pass"),
    ],
)
def test_a_verdict_at_the_beginning_of_a_cell_is_marked(text: str, set_as: str) -> None:
    assert marked(text) == set_as


def test_table_1_and_the_scores_of_the_moduli(tmp_path: Path) -> None:
    count = write_table_1(tmp_path)
    score = pd.DataFrame(
        [("score", modulus, force, 7.04, -0.3 * force) for modulus in (600.0, 1460.0) for force in (5.0, 0.06)],
        columns=["source", "modulus_MPa", "force_N", "deviation_pct", "deviation_standard_errors"],
    )
    table = pd.concat([score, pd.DataFrame({"source": ["experiment"]})])
    figures = {"fig3": ("speeds", '<svg xmlns="http://www.w3.org/2000/svg" width="252pt" height="10pt"></svg>')}
    store_part("fig3", Chapter({}, shown=shown_of("fig3", table)), figures, tmp_path)
    text = page_of([], tmp_path)
    shown = [re.findall(r"<t[hd][^>]*>(.*?)</t[hd]>", row) for row in re.findall(r"<tr>(<th scope=.row.*?)</tr>", text)]
    columns = {row[0]: row[1:] for row in shown if len(row) == count + 1}
    assert [values[0] for values in columns.values()] == [
        "153", "168", "5.4", "190", "5.4", "4.0",
        *(f'<span class="reproduced">{cell}</span>' for cell in ("190.2", "5.41", "4.00", "190.0", "5.40", "4.00")),
        '<span class="number">4e-6</span>',
    ]  # fmt: skip
    assert columns["paper, computed: V<sub>s</sub>, m/s"][:2] == ["190", "164"]
    assert [row[1:] for row in shown if len(row) == 3] == [["+7.0"] * 2, ["+7.0"] * 2, ["1.5"] * 2, ["0.0"] * 2]


def test_a_damaged_stored_result_is_named_in_one_line(tmp_path: Path) -> None:
    """The page shows no result that is not as it was stored, or under another name."""
    write_table_1(tmp_path)
    stored = part_file("table1", tmp_path)
    text = stored.read_text()
    for content, found in ((text.replace("1", "2", 1), "altered"), (text[:-9], DAMAGED), ("", DAMAGED)):
        stored.write_text(content)
        with pytest.raises(InputError, match=rf"table1\.json: found .*{found}"):
            write_report([], tmp_path / "report.html")
    stored.unlink()
    part_file("fig4", tmp_path).write_text(text)
    with pytest.raises(InputError, match=r"fig4\.json: .*the result of table1"):
        write_report([], tmp_path / "report.html")


def test_the_same_verdicts_in_both(hostile: Path) -> None:
    written = sorted(path.name for path in hostile.glob("[!.]*"))
    assert written == ["parts", "report.html", "report.json"]
    page, data = (hostile / "report.html").read_text(), json_of(hostile)
    verdicts = {
        kind: {(row["name"], name, cell["verdict"]) for row in data[kind] for name, cell in row["engines"].items()}
        for kind in ("scenes", "independent")
    }
    assert Page(page).verdicts == verdicts["scenes"]
    both = verdicts["scenes"] | verdicts["independent"]
    assert {verdict for _, _, verdict in both} == {PASS, FAIL, NOT_RUN}
    failed = re.findall(r"✗ (\S+) fails on (\S+)\.</b>", failures(page))
    assert sorted(failed) == sorted((engine, name) for name, engine, verdict in both if verdict == FAIL)
    rows = [*data["scenes"], *data["independent"]]
    single = Counter(check["verdict"] for row in rows for cell in row["engines"].values() for check in cell["checks"])
    assert Counter({PASS: 0} | data["counts"]["checks"]) == single


def test_hostile_texts_stay_texts(hostile: Path) -> None:
    page, data = (hostile / "report.html").read_text(), json_of(hostile)
    assert Page(page).tags["script"] == 1  # the script that opens folded parts
    assert not [words for words in ("<script>throw", "</script><", "<img src=x", "throw 3") if words in page]
    assert "49" not in re.findall(r"<summary><h3>(.*?)</h3>", page)[0]
    assert data["scenes"][0]["engines"]["yade"]["diagnosis"] == f"matches {HOSTILE}"


def test_the_json_has_its_provenance(hostile: Path) -> None:
    data = json_of(hostile)
    assert data["schema_version"] == 3
    assert {"date", "commit", "command", "engines", "machine", "libraries"} <= data["made_with"].keys()
    assert data["made_with"]["machine"]["processor"]
    assert all({"version", "command", "sha256"} == made.keys() for made in data["made_with"]["engines"].values())
    verlet = data["scenes"][0]["engines"]["verlet"]
    assert verlet["run"]["status"] == "done"
    assert verlet["run"]["error_budget"]
    assert {"value", "limit", "reason", "where"} <= verlet["checks"][0].keys()
    assert data["scenes"][0]["engines"]["liggghts"]["checks"][0]["value"] is None  # NaN


def test_no_file_is_replaced_unless_both_are_written(compared: ComparedScene, tmp_path: Path) -> None:
    (tmp_path / "report.html").write_text("old")
    (tmp_path / "report.json").mkdir()
    with pytest.raises(OSError, match=r"report\.json"):
        write_report([compared], tmp_path / "report.html")
    assert (tmp_path / "report.html").read_text() == "old"
    assert sorted(path.name for path in tmp_path.iterdir()) == ["report.html", "report.json"]


def test_the_command_writes_both_files_and_records_its_arguments(scene_file: SceneWriter, tmp_path: Path) -> None:
    scene, page = scene_file(), tmp_path / "out" / "page.html"
    words = ("--out", page, "--runs", tmp_path / "runs", "--engine", "verlet", "--allow-missing")
    done = beads("report", scene, *words)
    assert done.returncode == 0, done.stderr
    data = json.loads(page.with_suffix(".json").read_text())
    text = page.read_text()
    assert re.findall(r'<section id="([^"]*)"', text) == ["codes", "made"]
    assert not [words for words in ("Statements", "Table 1", "make claims", "Phys. Rev.") if words in text]
    assert data["made_with"]["command"].startswith(f"beads report {scene}")
    assert data["scenes"][0]["command"].endswith(f" --runs {tmp_path / 'runs'}")
    assert not data["counts"]["checks"].get(FAIL)
    os.mkfifo(tmp_path / "pipe")  # not a real device: the report would replace it if it were not refused
    for wrong, named in (
        (("--out", tmp_path / "page.json"), "JSON"),
        (("--out", tmp_path / "pipe"), "a device"),
        (("--out", "/proc/page.html"), "/proc"),
        ((scene,), "two scenes named"),
        (("missing",), "missing"),
    ):
        refused = beads("report", scene, *wrong, "--runs", tmp_path / "fresh")
        assert refused.returncode == 2
        (line,) = refused.stderr.splitlines()
        assert named in line
        assert not (tmp_path / "fresh").exists(), "a deck was run"


def test_a_scene_shows_its_measured_traces_and_quoted_values(scene_file: SceneWriter, shared_runs: Path) -> None:
    scene = scene_file(chain="sensors = [{ from_wall = 3 }]")
    times_us = np.arange(0.0, 320.0, 2.0)
    readings = pd.DataFrame({"time_us": times_us, "wall_N": 20 * np.exp(-(((times_us - 150) / 12) ** 2))})
    readings.to_csv(scene.parent / "shot.csv", index=False)
    quoted_values = "[[measured]]\nvalues = { wall_peak = '9 N' }\nerrors = { wall_peak = 0.1 }\n"
    scene.write_text(f'{scene.read_text()}{quoted_values}[[measured]]\nfile = "shot.csv"\n')
    words = ("report", scene, "--out", scene.with_suffix(".html"), "--engine", "verlet", "--allow-missing", "--runs")
    figure = {"parameters": ("fitted", '<svg width="11pt"></svg>')}
    store_part(f"fit-{scene.stem}", Chapter({}), figure, scene.parent)
    assert beads(*words, shared_runs).returncode == 0
    page = scene.with_suffix(".html").read_text()
    assert b64encode(b'<svg width="11pt"></svg>').decode() in page  # fitted parameters
    measured = page.split("Measured and computed forces (reference)")[1]
    assert {"wall_impulse_N_s", "shot.csv"} <= set(re.findall(r"[\w.]+", measured))
    assert re.search(r"Do the measurements fit\?.*is the furthest, [\d.e+]+ standard errors", page)
    (scene.parent / "shot.csv").write_text("time_us,wall_N\n1,2\n2,x\n")  # is named before anything runs
    done = beads(*words, scene.parent / "fresh")
    assert (done.returncode, 'line 3, wall_N: found "x"' in done.stderr) == (2, True)
    assert not (scene.parent / "fresh").exists()
