"""Studies are registered once, and take any number of codes."""

import re
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from itertools import combinations
from pathlib import Path

import pytest

import drivers.engines
from drivers.base import paths
from drivers.chain.case import Case
from drivers.chain.elements import SIDEWAYS
from drivers.engines import installed_codes, load_engine
from drivers.run.run import run_all_done
from postproc.paper.simulate import Simulation, run_codes
from validation.chapters import CHAPTERS, Options, frame_of, load_chapter, read_section, write_chapter
from validation.commands.beads import BEADS
from validation.compare.answer import listed
from validation.elements import elements_chapter, gauge_steps, switches
from validation.elements.switches import read_elements
from validation.stability.extremes import Extreme, run_all
from validation.stability.measured_limits import SHIPPED, MeasuredChain, measure_limits, sweeps
from validation.stability.stability_chapter import CHAPTER as STABILITY
from validation.tests.helpers.scenes import case_of
from validation.trade.ladder import LadderRun, run_ladder
from validation.trade.softening import soften
from validation.trade.trade_chapter import CHAPTER as TRADE
from validation.trade.trade_chapter import advice

ADAPTER = """
from dataclasses import replace
from drivers.engines.verlet import ENGINE as VERLET
ENGINE = replace(VERLET, integrate=None, style=None)
"""
Installer = Callable[[int], list[str]]


@pytest.fixture
def install(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Installer:
    """Leaves so many codes installed, adapters dropped into the folder of engines among them; returns their names."""

    def leave(count: int) -> list[str]:
        names = installed_codes()
        more = [f"added{number}" for number in range(max(0, count - len(names)))]
        for name in more:
            (tmp_path / f"{name}.py").write_text(ADAPTER)
            monkeypatch.delitem(sys.modules, f"drivers.engines.{name}", raising=False)
        monkeypatch.setattr(drivers.engines, "__path__", [*drivers.engines.__path__, str(tmp_path)])
        kept = [*names[:count], *more]
        known = [name for name in drivers.engines.engine_names() if name in kept or load_engine(name).in_repository]
        monkeypatch.setattr(drivers.engines, "engine_names", lambda: known)
        assert installed_codes() == sorted(kept)
        return kept

    return leave


def test_studies_are_those_of_the_command_line_and_of_make() -> None:
    assert set(CHAPTERS) <= set(BEADS.commands)
    assert [load_chapter(name).name for name in CHAPTERS] == list(CHAPTERS)
    measured = re.search(r"^MEASURED := (.*)$", (paths.ROOT / "Makefile").read_text(), re.MULTILINE)
    assert measured
    assert set(CHAPTERS) == set(measured[1].split())


@pytest.mark.long
@pytest.mark.parametrize("count", [0, 1, 3])
def test_trade_takes_any_number_of_codes(count: int, install: Installer, tmp_path: Path) -> None:
    names = install(count)
    rows = run_ladder(0.5, ("fig5",))
    found = frame_of(LadderRun, rows)
    assert {*names, "verlet", "order 4", "reference"} == set(found["method"])
    write_chapter(
        TRADE, {"trade": rows, "trade-advice": advice(found), "trade-softening": soften()}, tmp_path / "results"
    )
    section = read_section("trade", tmp_path / "results")
    assert section["advice"][0][-1] in (names or ["–"])
    for name in names:
        assert f" by {name}" in section["sentences"][0]
        assert f">{name}<" in (tmp_path / "results" / "trade.svg").read_text()


@pytest.mark.parametrize("count", [0, 1, 3])
@pytest.mark.long
def test_stability_takes_any_number_of_codes(count: int, install: Installer, tmp_path: Path) -> None:
    names = install(count)
    subjects = [MeasuredChain(SHIPPED, "fig5", case_of("fig5")), *{each.group: each for each in sweeps()}.values()]
    edge = [*run_all([Extreme(name="as it is", scene="fig5")], tmp_path / "runs")]
    assert [*dict.fromkeys(each.engine for each in edge)] == ["reference", "verlet", *sorted(names)]
    write_chapter(STABILITY, {"stability": measure_limits(subjects), "stability-extremes": edge}, tmp_path / "results")
    section = read_section("stability", tmp_path / "results")
    assert len(section["limits"]) == 1
    assert (
        f"predicted: {listed(['verlet', *sorted(names)])}"
        in (tmp_path / "results" / "stability-limits.svg").read_text()
    )


@pytest.fixture
def on_verlet(monkeypatch: pytest.MonkeyPatch, shared_runs: Path) -> None:
    """Runs of elements on codes are Verlet's, each made once: what counts here is who is asked."""

    def run_all(cases: Mapping[str, Sequence[Case]], _: Path) -> dict[str, list[Simulation]]:
        done = {name: run_codes({"verlet": own}, shared_runs)["verlet"] for name, own in cases.items()}
        return {name: [replace(run, engine=name) for run in own] for name, own in done.items()}

    monkeypatch.setattr(elements_chapter, "run_codes", run_all)
    monkeypatch.setattr(
        switches, "run_all_done", lambda jobs, _: run_all_done([(case, "verlet") for case, _ in jobs], shared_runs)
    )
    monkeypatch.setattr(switches, "ACCURACIES", switches.ACCURACIES[:1])
    monkeypatch.setattr(
        gauge_steps, "RANGES", {"restitution": (gauge_steps.TUBE, ("contact.restitution={0}",), (0.9,))}
    )


@pytest.mark.parametrize("count", [0, pytest.param(1, marks=pytest.mark.long), pytest.param(3, marks=pytest.mark.long)])
@pytest.mark.usefixtures("on_verlet")
def test_elements_takes_any_number_of_codes(
    count: int, install: Installer, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    names = sorted(install(count))
    asked = read_elements()
    chosen = ("gravity", "scatter of masses")
    few = tuple(element for element in asked.element if element.name in chosen)
    fewer = asked.model_copy(update={"element": few, "quick_seeds": 2})
    monkeypatch.setattr(elements_chapter, "read_elements", lambda: fewer)
    results = tmp_path / "results"
    tables = write_chapter(
        elements_chapter.CHAPTER, elements_chapter.measure(Options(quick=True, runs=tmp_path)), results
    )
    assert set(tables["elements"]["element"]) == {"gravity", "scatter of masses"}
    assert list(tables["elements"]["engine"].unique()) == (names or ["verlet"])
    in_tubes = [name for name in names if load_engine(name).models >= SIDEWAYS]
    pairs = [f"{one} {other}" for one, other in combinations(in_tubes, 2)]
    assert list(tables["elements-between"]["codes"].unique()) == pairs
    assert elements_chapter.CHAPTER.failed(tables) == []
    section = read_section("elements", results)
    assert section["short"]
    assert ("fewer than two installed codes model tubes" in " ".join(section["sentences"])) == (not pairs)
    compared = [row[0] for row in section["between"]]
    assert all(f"fig4 without friction, {pair.replace(' ', ' and ')}" in compared for pair in pairs)
    assert [title for title, _ in section["figures"]][1].startswith("fig4: gauge signals")
    assert all(f">{name}<" in (results / "elements.svg").read_text() for name in names)
    assert sorted(path.suffix for path in results.glob("oscilloscope-fig4.*")) == [".png", ".svg"]
