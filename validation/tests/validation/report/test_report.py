"""Comparison, verdicts and the report page."""

import html
import json
import os
import platform
import re
from base64 import b64decode
from collections import Counter
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from drivers.base import paths
from drivers.base.errors import InputError
from drivers.base.files import SEALS, sealed_file
from drivers.chain.trace import until
from drivers.run.run import provenance
from postproc.figures.table1 import EXACT_LONGER
from postproc.paper.quoted import quoted
from postproc.paper.strikes import COLUMNS, SPREAD
from postproc.read.run_tables import errors
from validation.accuracy.budget import budget_of, first_departure
from validation.chapters import write_frame
from validation.checks import FAIL, NOT_RUN, PASS, share_of_limit, short
from validation.compare.comparison import ComparedScene
from validation.report.scene_section import scene_row, section_of
from validation.report.write_report import write_report
from validation.tests.helpers.commands import beads
from validation.tests.helpers.runs import blown_up, checks_of, finished
from validation.tests.helpers.scenes import SceneWriter, case_of


class Page(HTMLParser):
    """Tags, addresses and labels of a page."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.tags: Counter[str] = Counter()
        self.addresses: list[str] = []
        self.labels: list[str] = []
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags[tag] += 1
        self.addresses += [value or "" for name, value in attrs if name in ("src", "href", "xlink:href")]
        self.labels += [value or "" for name, value in attrs if name in ("aria-label", "alt")]


def test_the_page_stands_alone(compared: ComparedScene, tmp_path: Path) -> None:
    counts = write_report([compared], tmp_path / "report.html")
    assert counts == {PASS: 2, FAIL: 1, NOT_RUN: 1}
    text = (tmp_path / "report.html").read_text()
    page = Page(text)
    assert page.addresses
    assert all(address.startswith(("#", "data:")) for address in page.addresses)
    assert (page.tags["img"], page.tags["figure"]) == (2, 2)
    assert sum(label.startswith(("Gauge forces", "Force in every contact")) for label in page.labels) == 2
    assert re.search(r"2 passed.*1 failed.*1 not run", text, re.DOTALL)


def test_the_paper_comes_first_and_the_codes_last(compared: ComparedScene, tmp_path: Path) -> None:
    text = page_of(compared, tmp_path)
    ids = re.findall(r'<(?:header|section) id="([^"]*)"', text)
    assert ids == ["answer", "figures", "claims", "calibration", "trade", "stability", "elements", "codes", "made"]
    assert re.findall(r'<li><a href="#([^"]*)"', text) == ids
    codes = text[text.index('<section id="codes"') : text.index('<section id="made"')]
    assert codes.index('aria-label="Verdicts"') < codes.index('<details class="scene"')


def test_how_the_page_was_made_is_its_end(compared: ComparedScene, tmp_path: Path) -> None:
    write_report([compared], tmp_path / "report.html", "make it again")
    text = (tmp_path / "report.html").read_text()
    end = text[text.index('<section id="made"') :]
    for words in ("make it again", platform.node(), "numpy", provenance()["commit"][:12]):
        assert words in html.unescape(end), words


def test_a_failure_is_named_first_with_its_diagnosis_and_a_command_for_details(
    compared: ComparedScene, tmp_path: Path
) -> None:
    sick = late(compared)
    (row,) = [scene_row(sick)]
    worst = row.cells["yade"].worst
    assert worst is not None
    assert max(map(share_of_limit, sick.of_engine("yade"))) == share_of_limit(worst)
    counts = write_report([sick], tmp_path / "report.html")
    assert counts[FAIL] == 1
    text = (tmp_path / "report.html").read_text()
    first = text[text.index('class="failures"') : text.index('class="lead"')]
    assert "yade fails on scene." in first
    assert "matches forces a sample &lt;late&gt;" in first
    assert f"beads compare {compared.case.scene.file}" in first
    for words in (worst.quantity, short(worst.value), short(worst.limit), worst.where):
        assert words in html.unescape(first), words
    assert re.findall(r'<details class="scene"[^>]*( open)>', text) == [" open"]
    well = page_of(replace(sick, checks=[], diagnoses={}), tmp_path)
    assert 'class="failures"' not in well
    assert re.findall(r'<details class="scene"[^>]*( open)>', well) == []
    assert "ERROR &lt;b&gt;&amp;" in page_of(compared, tmp_path)  # a failed run


def test_the_partial_trace_of_a_failed_run_is_shown(compared: ComparedScene, tmp_path: Path) -> None:
    """A run that blew up and a run that ended early are drawn with the others, on the scale of the others."""
    good = compared.runs["verlet"].trace
    refused = {"yade": blown_up(good, 100), "liggghts": until(good, 60)}
    absent = dict.fromkeys(refused, "failed: unstable <b>")
    departures = {"yade": first_departure(compared.case, "yade", refused["yade"])}
    checks = checks_of(compared.case, compared.runs, absent)
    sick = replace(compared, absent=absent, checks=checks, departures=departures, refused=refused)
    section = section_of(sick, paths.RESULTS)
    assert section["forces"]
    assert section["departures"] == [*departures.items()]
    assert {engine for engine, _, _ in section["decks"]} == {"yade", "liggghts"}
    assert list(section["runs"]) == ["reference", "verlet"]  # observables are of finished runs alone
    counts = write_report([sick], tmp_path / "report.html")
    assert counts == {PASS: 2, FAIL: 2}
    own = json.loads((tmp_path / "report.json").read_text())["scenes"][0]["engines"]["yade"]
    assert "from 100 µs" in own["departure"]
    assert own["checks"][0]["where"] == "failed: unstable <b>"


def test_a_failed_run_without_a_trace_has_its_deck(compared: ComparedScene) -> None:
    section = section_of(compared, paths.RESULTS)
    assert [(engine, file) for engine, file, _ in section["decks"]] == [("yade", "chain.py")]
    assert "hertzian=True" in section["decks"][0][2]


@pytest.mark.parametrize("numbers", [True, False])
def test_a_scene_without_a_finished_run_shows_partial_traces(
    numbers: bool, compared: ComparedScene, tmp_path: Path
) -> None:
    good = compared.runs["verlet"].trace
    refused = {"yade": blown_up(good, 100) if numbers else replace(good, force_N=np.nan * good.force_N)}
    absent = {"yade": "failed: unstable"}
    alone = ComparedScene(compared.case, {}, absent, checks_of(compared.case, {}, absent), {}, {}, refused)
    assert "No engine finished this scene" in page_of(alone, tmp_path)
    (drawn, *_) = re.findall(r'alt="Gauge forces[^>]*src="data:image/svg.xml;base64,([^"]*)"', page_of(alone, tmp_path))
    assert b"yade (failed)" in b64decode(drawn)


def test_the_command_for_details_finds_the_same_runs(compared: ComparedScene, tmp_path: Path) -> None:
    write_report([late(compared)], tmp_path / "report.html", "again", Path("my runs"))
    again = f"beads compare {compared.case.scene.file} --runs 'my runs'"
    assert f"Look closer: <code>{html.escape(again, quote=False)}</code>" in (
        (tmp_path / "report.html").read_text().replace("&#39;", "'")
    )
    assert json.loads((tmp_path / "report.json").read_text())["scenes"][0]["command"] == again


def test_missing_studies_are_named_with_their_command(tmp_path: Path) -> None:
    write_report([], tmp_path / "report.html")
    text = (tmp_path / "report.html").read_text()
    for target in ("table1", "claims", "fig3", "trade", "stability", "elements", "calibration"):
        assert f"<code>make {target}</code>" in text, target


def test_table_1_has_a_row_per_amplitude_and_the_figure_of_speeds_has_its_scores(tmp_path: Path) -> None:
    table = quoted().table1.frame
    exact = {f"reference_{name}": table[f"computed_{name}"] * (1 + 1e-3) for name in COLUMNS}
    longer = {f"{EXACT_LONGER}_{name}": table[f"computed_{name}"] for name in COLUMNS}
    write_frame(tmp_path / "table1.csv", table.assign(**exact, **longer, **{SPREAD: 4.2e-6}))
    score = pd.DataFrame(
        [("score", modulus, force, 7.04, -0.3 * force) for modulus in (600.0, 1460.0) for force in (5.0, 0.06)],
        columns=["source", "modulus_MPa", "force_N", "deviation_pct", "deviation_standard_errors"],
    )
    write_frame(tmp_path / "fig3.csv", pd.concat([score, pd.DataFrame({"source": ["experiment"]})]))
    with sealed_file(tmp_path / "fig3.svg") as draft:
        draft.write_text('<svg xmlns="http://www.w3.org/2000/svg" width="252pt" height="10pt"></svg>')
    write_report([], tmp_path / "report.html")
    text = (tmp_path / "report.html").read_text()
    shown = [re.findall(r"<t[hd][^>]*>(.*?)</t[hd]>", row) for row in re.findall(r"<tr>(<th scope=.row.*?)</tr>", text)]
    equal = [f"<b>{cell}</b>" for cell in ("190.2", "5.41", "4.00", "190.0", "5.40", "4.00")]
    assert ["5", "153", "168", "5.4", "190", "5.4", "4.0", *equal, "4e-6"] in shown
    assert [len(row) for row in shown].count(14) == len(table)
    scores = [[modulus, "+7.0", "+7.0", "1.5", "0.0"] for modulus in ("600", "1460")]
    assert [row for row in shown if len(row) == 5] == scores
    assert 'data-label="measured minus computed speed, %, at 5 N"' in text
    assert "F<sub>m</sub>" in text
    write_frame(tmp_path / "fig3.csv", pd.DataFrame({"source": ["score"], "force_N": [1]}))
    with pytest.raises(InputError, match=r"fig3\.csv"):
        write_report([], tmp_path / "report.html")


@pytest.mark.parametrize(
    ("file", "content"), [("table1.csv", "force_N\n1"), ("fig4.svg", "<svg><g></svg>"), ("claims.csv", "id\n1")]
)
def test_a_damaged_file_is_named_in_one_line(file: str, content: str, tmp_path: Path) -> None:
    (tmp_path / file).write_text(content)
    with pytest.raises(InputError, match=f"{file}: found a file without its digest"):
        write_report([], tmp_path / "report.html")
    with sealed_file(tmp_path / file) as draft:  # by another version
        draft.write_text(content)
    with pytest.raises(InputError, match=file):
        write_report([], tmp_path / "report.html")
    assert {path.name for path in tmp_path.iterdir()} == {file, SEALS}


def test_a_chain_without_gauges_and_without_forces_has_a_page(
    scene_file: SceneWriter, shared_runs: Path, tmp_path: Path
) -> None:
    case = case_of(scene_file("free", wall="", striker="", duration="2 us"))
    runs = {"verlet": finished(case, "verlet", shared_runs)}
    text = page_of(ComparedScene(case, runs, {}, checks_of(case, runs, {})), tmp_path)
    assert Page(text).tags["figure"] == 1  # only the chain can be drawn
    assert "nan" not in text[text.index("<section") :].lower().split()


def page_of(scene: ComparedScene, folder: Path) -> str:
    """Page of one scene."""
    write_report([scene], folder / "page.html")
    return (folder / "page.html").read_text()


def late(compared: ComparedScene) -> ComparedScene:
    """The scene with forces of YADE delayed by a sample, and a diagnosis."""
    run = compared.runs["verlet"]
    odd = replace(run)
    object.__setattr__(odd, "trace", replace(run.trace, force_N=np.roll(run.trace.force_N, 1, axis=0)))
    runs = compared.runs | {"yade": odd}
    absent = {"liggghts": "not installed"}
    checks = checks_of(compared.case, runs, absent)
    return ComparedScene(compared.case, runs, absent, checks, {}, {"yade": "matches forces a sample <late>"})


def test_a_chain_at_rest_has_no_momentum_error(scene_file: SceneWriter, shared_runs: Path) -> None:
    case = case_of(scene_file("rest", striker=""))
    run = finished(case, "verlet", shared_runs)
    odd = replace(run)
    object.__setattr__(odd, "trace", replace(run.trace, momentum_N_s=run.trace.momentum_N_s - 1e-41))
    runs = {"verlet": run, "yade": odd}
    assert {check.verdict for check in checks_of(case, runs, {})} == {PASS}
    assert budget_of(case, "yade", odd.trace).departure == ""


def test_a_device_is_refused_as_the_page(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")  # not a real device: the report would replace it if it were not refused
    done = beads("report", "--out", tmp_path / "pipe")
    assert (done.returncode, len(done.stderr.splitlines())) == (2, 1)
    assert "a device" in done.stderr


def test_the_wave_on_the_command_line() -> None:
    done = beads("wave")
    assert done.returncode == 0
    assert "0.9055157764 k^(1/3)" in done.stdout
    assert "4.989445 at 0.002" in done.stdout


def test_observables_on_the_command_line(scene_file: SceneWriter, shared_runs: Path) -> None:
    run = finished(case_of(scene_file()), "verlet", shared_runs)
    done = beads("observables", run.folder, "--level", "0.1")
    assert done.returncode == 0
    assert "wall_duration_10pct_s" in done.stdout
    (peak,) = (line for line in done.stdout.splitlines() if line.startswith("wall_peak_N"))
    assert float(peak.split()[2]) == pytest.approx(errors(run)["whole"].abs()["wall_peak"], rel=0.05)
    wrong = beads("observables", run.folder.parent)
    assert wrong.returncode == 2
    assert "run folder" in wrong.stderr
