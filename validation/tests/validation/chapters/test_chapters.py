"""Chapters: registered once, for any number of codes; their parts come back as they were stored, or say why not."""

import json
import re
from dataclasses import replace
from math import inf, nan, nextafter
from pathlib import Path

import pandas as pd
import pytest

import drivers.engines
from drivers.base import paths
from drivers.base.errors import InputError
from drivers.base.files import DIGEST, write_sealed
from drivers.engines import installed_codes, load_engine
from validation.chapters import CHAPTERS, Options, elements
from validation.chapters.stability import SHIPPED, Extreme, MeasuredChain, measure_limits, run_all, study, sweeps
from validation.chapters.trade import advice, run_ladder, show_advice
from validation.checks import FAIL, Check
from validation.commands.beads import BEADS
from validation.report.parts import Chapter, Shown, part_file, read_part, write_part
from validation.tests.helpers.scenes import case_of


@pytest.fixture
def no_code(monkeypatch: pytest.MonkeyPatch) -> None:
    """Leaves no code installed; the report of the continuous integration has all."""
    known = [name for name in drivers.engines.engine_names() if load_engine(name).in_repository]
    monkeypatch.setattr(drivers.engines, "engine_names", lambda: known)
    assert installed_codes() == []


def test_studies_are_those_of_the_command_line_and_of_make() -> None:
    assert set(CHAPTERS) <= set(BEADS.commands)
    measured = re.search(r"^MEASURED := (.*)$", (paths.ROOT / "Makefile").read_text(), re.MULTILINE)
    assert measured
    assert set(CHAPTERS) == set(measured[1].split())


@pytest.mark.usefixtures("no_code")
def test_trade_needs_no_code() -> None:
    rows = run_ladder(0.5, ("fig5",))
    assert {"verlet", "reference"} == set(rows["method"])
    assert show_advice(rows, advice(rows)).table.iloc[0, 0] == "fig5, force trace"


@pytest.mark.usefixtures("no_code")
def test_stability_needs_no_code(tmp_path: Path) -> None:
    subjects = [MeasuredChain(SHIPPED, "fig5", case_of("fig5")), *{sweep.group: sweep for sweep in sweeps()}.values()]
    edge = [*run_all([Extreme(name="as it is", scene="fig5")], tmp_path / "runs")]
    assert [*dict.fromkeys(extreme.engine for extreme in edge)] == ["reference", "verlet"]
    chapter = study(measure_limits(subjects), edge, None)
    write_part("stability", chapter, tmp_path)
    assert len(chapter.shown[0].table) == 1
    assert "predicted: verlet" in (tmp_path / "stability-limits.svg").read_text()


@pytest.mark.usefixtures("no_code")
def test_elements_need_no_code(monkeypatch: pytest.MonkeyPatch, shared_runs: Path) -> None:
    asked, chosen = elements.read_elements(), ("gravity", "scatter of masses")
    few = tuple(element for element in asked.element if element.name in chosen)
    fewer = asked.model_copy(update={"element": few, "quick_seeds": 2})
    monkeypatch.setattr(elements, "read_elements", lambda: fewer)
    chapter = elements.measure(Options(quick=True, runs=shared_runs))
    assert set(chapter.tables["elements"]["element"]) == {"gravity", "scatter of masses"}
    assert list(chapter.tables["elements"]["engine"].unique()) == ["verlet"]
    assert [check.verdict for check in chapter.checks] == ["pass"]


TABLE = pd.DataFrame({"name": ["a, “b”", "", "1e3"], "value": [nextafter(0.1, 1), inf, nan], "steps": [3, -1, 10**12]})
CHECK = Check("fig4", "yade", "force", 2.0, 1.0, "a reason", "at the wall", FAIL, 3.0, 1.0)
SHOWN = [
    Shown("folded", "see below", pd.DataFrame([["a", "pass 1"], ["b\nc", "–"]], columns=["name", "value"])),
    Shown("", "", pd.DataFrame([["a", "1", "2"]], columns=["name", "one", "other"])),
    Shown("none", "", pd.DataFrame([], columns=["name", "value"])),
]
CHAPTER = Chapter({"t": TABLE}, ["a finding"], {}, SHOWN, [CHECK], short=True)


def test_a_part_comes_back_as_it_was_stored_and_tables_bit_for_bit(tmp_path: Path) -> None:
    assert write_part("trade", CHAPTER, tmp_path) == [tmp_path / "t.csv"]
    pd.testing.assert_frame_equal(
        pd.read_csv(tmp_path / "t.csv", keep_default_na=False, na_values={"value": ""}), TABLE
    )
    part = read_part("trade", tmp_path)
    assert part
    assert (part.findings, part.checks, part.failed, part.short) == (["a finding"], [CHECK], [CHECK], True)
    for item, stored in zip(SHOWN, part.shown, strict=True):
        assert (stored.heading, stored.text) == (item.heading, item.text)
        pd.testing.assert_frame_equal(stored.table, item.table, check_dtype=False)
    write_part("trade", replace(CHAPTER, tables={}), tmp_path)
    assert not (tmp_path / "t.csv").exists()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"checks": [{"scene": "fig4"}]}, "missing 7 required"),
        ({"shown": [{"heading": ""}]}, "'text'"),
        ({"figures": {"trade": ["a heading", "<svg><g></svg>"]}}, "mismatched tag"),
        ({"figures": {"trade": ["a heading", "<svg></svg>"]}}, "could not convert string to float"),
        ({"name": "claims"}, "the result of claims"),
    ],
)
def test_a_part_of_another_version_is_named_with_the_target_that_writes_it(
    tmp_path: Path, change: dict[str, object], message: str
) -> None:
    write_part("trade", CHAPTER, tmp_path)
    path = part_file("trade", tmp_path)
    stored = json.loads(path.read_text())
    del stored[DIGEST]
    write_sealed(path, stored | change)
    with pytest.raises(InputError, match=rf"trade\.json: .*another version .*{message}.*make trade writes it again"):
        read_part("trade", tmp_path)
