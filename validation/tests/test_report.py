"""Comparison, verdicts and the report page."""

import re
from collections import Counter
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest

from drivers.tolerances import tolerance
from validation.comparison import (
    compare_case,
    deviation,
    model_tolerance,
    shipped_name,
)
from validation.report import write_report
from validation.rounding import HORIZON
from validation.scenes import ComparedScene
from validation.tests.conftest import SceneWriter, case_of, command_line, finished
from validation.verdict import FAIL, NOT_RUN, PASS


@pytest.fixture
def compared(scene_file: SceneWriter, shared_runs: Path) -> ComparedScene:
    case = case_of(scene_file("scene", chain="sensors = [{from_wall = 4}, {from_wall = 2}]"))
    runs = {engine: finished(case, engine, shared_runs) for engine in ("verlet", "reference")}
    absent = {"liggghts": "not installed", "yade": "failed: exit code 1: ERROR <b>&"}
    return ComparedScene(case, runs, absent, compare_case(case, runs, absent))


def test_a_deviation_says_when_and_where(compared: ComparedScene) -> None:
    trace = compared.runs["verlet"].trace
    force = trace.force_N.copy()
    force[37, 2] += 1e-3
    found = deviation(replace(trace, force_N=force), trace)
    assert found.share == pytest.approx(1e-3 / trace.force_N.max())
    assert (found.time_s, found.contact) == (trace.time_s[37], 3)
    with pytest.raises(ValueError, match="samples"):
        deviation(replace(trace, force_N=force[:5]), trace)


def test_verdicts_count_what_is_missing_apart(compared: ComparedScene) -> None:
    by_engine = {name: {v.verdict for v in compared.verdicts if v.engine == name} for name in ("liggghts", "yade")}
    assert by_engine == {"liggghts": {NOT_RUN}, "yade": {FAIL}}
    assert {v.verdict for v in compared.verdicts if v.engine in compared.runs} == {PASS}


def test_a_wrong_force_turns_red(compared: ComparedScene) -> None:
    run = compared.runs["verlet"]
    stamped_late = replace(run.trace, force_N=np.roll(run.trace.force_N, 1, axis=0))
    late = replace(run)
    object.__setattr__(late, "trace", stamped_late)
    verdicts = compare_case(compared.case, compared.runs | {"yade": late}, {})
    red = {v.quantity for v in verdicts if v.engine == "yade" and v.verdict == FAIL}
    assert {"force against verlet", "force against reference"} <= red


def test_a_chaotic_chain_is_judged_up_to_its_horizon(shared_runs: Path) -> None:
    case = case_of("fig4", "run.duration=20 ms", "run.sample_interval=10 us", "run.time_step=0.5 us")
    run = finished(case, "verlet", shared_runs)
    limit, samples = model_tolerance(case, run.trace)
    assert limit.limit <= 10 * HORIZON
    assert 8e-3 < run.trace.time_s[samples] < 19e-3


def test_a_scenes_own_tolerances_hold_for_that_scene_only() -> None:
    assert shipped_name(case_of("fig4")) == "fig4"
    assert shipped_name(case_of("fig4", "run.time_step=1 us")) is None


def test_every_tolerance_has_a_reason() -> None:
    for kind, quantity in [("model", "force"), ("truncation", "force"), ("energy", "drift"), ("guard", "energy")]:
        assert len(tolerance(kind, quantity).reason) > 20
    assert tolerance("truncation", "force", "fig4").limit == 4e-5
    assert tolerance("truncation", "force", "unknown").limit == tolerance("truncation", "force").limit


class Page(HTMLParser):
    """Collects what the tests ask of a page."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.tags: Counter[str] = Counter()
        self.addresses: list[str] = []
        self.labels: list[str] = []
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags[tag] += 1
        self.addresses += [value or "" for name, value in attrs if name in ("src", "href", "xlink:href")]
        self.labels += [value or "" for name, value in attrs if name == "aria-label"]


def test_the_page_stands_alone(compared: ComparedScene, tmp_path: Path) -> None:
    counts = write_report([compared], tmp_path / "report.html")
    assert counts == {PASS: 2, FAIL: 1, NOT_RUN: 1}
    text = (tmp_path / "report.html").read_text()
    page = Page(text)
    assert all(address.startswith(("#", "data:image/png;base64,")) for address in page.addresses)
    assert page.tags["svg"] == page.tags["figure"] == len(page.labels) == 2  # the gauges and the whole chain
    assert "script" not in page.tags
    assert "ERROR &lt;b&gt;&amp;" in text
    assert text.index('class="verdicts"') < text.index("<section")
    assert re.search(r"2 passed.*1 failed.*1 not run", text, re.DOTALL)


def test_the_wave_on_the_command_line() -> None:
    done = command_line("validation", "wave")
    assert done.returncode == 0
    assert "0.9055157764 k^(1/3)" in done.stdout
    assert "4.989445 at 0.002" in done.stdout


def test_observables_on_the_command_line(scene_file: SceneWriter, shared_runs: Path) -> None:
    folder = finished(case_of(scene_file()), "verlet", shared_runs).folder
    done = command_line("postproc", "observables", folder, "--level", "0.1")
    assert done.returncode == 0
    assert "wall_duration_10pct_s" in done.stdout
    wrong = command_line("postproc", "observables", folder.parent)
    assert wrong.returncode == 2
    assert "run folder" in wrong.stderr
