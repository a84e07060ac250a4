"""Chapters: registered once, for any number of codes; their tables come back as they were written, or say why not."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from math import inf, isnan, nan, nextafter
from pathlib import Path

import pandas as pd
import pytest

import drivers.engines
from drivers.base import paths
from drivers.base.errors import InputError
from drivers.chain.case import Case
from drivers.engines import installed_codes, load_engine
from postproc.paper.simulate import Simulation, run_codes
from validation.chapters import (
    CHAPTERS,
    Chapter,
    Options,
    frame_of,
    load_chapter,
    read_section,
    rows_in,
    write_chapter,
)
from validation.commands.beads import BEADS
from validation.elements import elements_chapter, gauge_steps
from validation.elements.switches import read_elements
from validation.report.page_figures import write_part
from validation.stability.extremes import Extreme, run_all
from validation.stability.measured_limits import SHIPPED, MeasuredChain, measure_limits, sweeps
from validation.stability.stability_chapter import CHAPTER as STABILITY
from validation.tests.helpers.scenes import case_of
from validation.trade.ladder import LadderRun, run_ladder
from validation.trade.softening import soften
from validation.trade.trade_chapter import CHAPTER as TRADE
from validation.trade.trade_chapter import advice


@pytest.fixture
def no_code(monkeypatch: pytest.MonkeyPatch) -> None:
    """Leaves no code installed; the report of the continuous integration has all."""
    known = [name for name in drivers.engines.engine_names() if load_engine(name).in_repository]
    monkeypatch.setattr(drivers.engines, "engine_names", lambda: known)
    assert installed_codes() == []


def test_studies_are_those_of_the_command_line_and_of_make() -> None:
    assert set(CHAPTERS) <= set(BEADS.commands)
    assert [load_chapter(name).name for name in CHAPTERS] == list(CHAPTERS)
    measured = re.search(r"^MEASURED := (.*)$", (paths.ROOT / "Makefile").read_text(), re.MULTILINE)
    assert measured
    assert set(CHAPTERS) == set(measured[1].split())


@pytest.mark.usefixtures("no_code")
def test_trade_needs_no_code(tmp_path: Path) -> None:
    rows = run_ladder(0.5, ("fig5",))
    ladder = frame_of(LadderRun, rows)
    assert {"verlet", "reference"} == set(ladder["method"])
    write_chapter(TRADE, {"trade": rows, "trade-advice": advice(ladder), "trade-softening": soften()}, tmp_path)
    assert read_section("trade", tmp_path)["advice"][0][-1] == "–"


@pytest.mark.usefixtures("no_code")
def test_stability_needs_no_code(tmp_path: Path) -> None:
    subjects = [MeasuredChain(SHIPPED, "fig5", case_of("fig5")), *{sweep.group: sweep for sweep in sweeps()}.values()]
    edge = [*run_all([Extreme(name="as it is", scene="fig5")], tmp_path / "runs")]
    assert [*dict.fromkeys(extreme.engine for extreme in edge)] == ["reference", "verlet"]
    write_chapter(STABILITY, {"stability": measure_limits(subjects), "stability-extremes": edge}, tmp_path)
    assert len(read_section("stability", tmp_path)["limits"]) == 1
    assert "predicted: verlet" in (tmp_path / "stability-limits.svg").read_text()


@pytest.fixture
def on_verlet(monkeypatch: pytest.MonkeyPatch, shared_runs: Path) -> None:
    """Runs of elements on codes are Verlet's, each made once: what counts here is who is asked."""

    def run_all(cases: Mapping[str, Sequence[Case]], _: Path) -> dict[str, list[Simulation]]:
        done = {name: run_codes({"verlet": asked}, shared_runs)["verlet"] for name, asked in cases.items()}
        return {name: [replace(run, engine=name) for run in runs] for name, runs in done.items()}

    asked, chosen = read_elements(), ("gravity", "scatter of masses")
    few = tuple(element for element in asked.element if element.name in chosen)
    ranges = {"restitution": (gauge_steps.TUBE, ("contact.restitution={0}",), (0.9,))}
    monkeypatch.setattr(elements_chapter, "run_codes", run_all)
    monkeypatch.setattr(gauge_steps, "RANGES", ranges)
    fewer = asked.model_copy(update={"element": few, "quick_seeds": 2})
    monkeypatch.setattr(elements_chapter, "read_elements", lambda: fewer)


@pytest.mark.usefixtures("on_verlet", "no_code")
def test_elements_need_no_code(tmp_path: Path) -> None:
    measured = elements_chapter.measure(Options(quick=True, runs=tmp_path))
    tables = write_chapter(elements_chapter.CHAPTER, measured, tmp_path / "results")
    assert set(tables["elements"]["element"]) == {"gravity", "scatter of masses"}
    assert list(tables["elements"]["engine"].unique()) == ["verlet"]
    assert tables["elements-between"].empty
    assert elements_chapter.CHAPTER.failed(tables) == []
    section = read_section("elements", tmp_path / "results")
    assert "fewer than two installed codes model tubes" in " ".join(section["sentences"])


@dataclass(frozen=True)
class Measured:
    """Row of plain fields."""

    name: str
    steps: int
    value: float
    good: bool


ROWS = [
    Measured("a, “b”", 3, nextafter(0.1, 1), True),
    Measured("nan", -1, inf, False),
    Measured("", 0, 5e-324, True),
    Measured("1e3", 10**12, -1.7417412558405728e-05, False),
]


CHAPTER = Chapter("trade", "about trade", {"t": Measured}, lambda _: {}, lambda _: (), lambda _: {})


def test_rows_come_back_bit_for_bit(tmp_path: Path) -> None:
    for rows in (ROWS, []):
        written = write_chapter(CHAPTER, {"t": rows}, tmp_path)["t"]
        stored = CHAPTER.read(tmp_path)["t"]
        pd.testing.assert_frame_equal(stored, written, check_exact=True)
        assert rows_in(stored, Measured) == rows
    write_chapter(CHAPTER, {"t": [Measured("a", 1, nan, True)]}, tmp_path)
    assert (tmp_path / "t.csv").read_text() == "name,steps,value,good\na,1,,True\n"
    assert isnan(rows_in(CHAPTER.read(tmp_path)["t"], Measured)[0].value)


@pytest.mark.parametrize(
    ("columns", "message"),
    [
        ({"name": ["a"], "steps": [1], "value": [2.0]}, "good"),
        ({"name": ["a"], "steps": [1], "value": ["two"], "good": [True]}, "could not convert string to float: 'two'"),
        ({"name": ["a"], "steps": [nan], "value": [2.0], "good": [True]}, "Cannot convert non-finite values"),
    ],
)
def test_a_table_of_another_version_is_named_with_the_target_that_writes_it(
    tmp_path: Path, columns: dict[str, list[object]], message: str
) -> None:
    write_part("trade", tmp_path, {"t": pd.DataFrame(columns)}, ())
    with pytest.raises(InputError, match=rf"trade\.json: .*another version .*{message}.*make trade writes it again"):
        CHAPTER.read(tmp_path)
