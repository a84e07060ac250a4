"""Puts the report together and writes its three files."""

from collections import Counter
from contextlib import ExitStack
from pathlib import Path

from drivers.base import decks as deck
from drivers.base import paths
from drivers.base.files import whole_file
from drivers.engines import in_order
from validation.claims.claims_section import read_section as read_claims
from validation.compare.compared_scenes import ComparedScene
from validation.elements.elements_section import read_section as read_elements
from validation.independent.independent_section import read_section as read_independent
from validation.independent.independent_table import read_verdicts
from validation.report.inline_figures import DARK, WORDS
from validation.report.machine_readable import as_json, as_junit
from validation.report.made_with import made_with, tables_made
from validation.report.page_figures import read_figures, read_table1
from validation.report.scene_section import section_of
from validation.report.spacetime_raster import PLACES
from validation.report.verdict_table import case_rows, counted, scene_row, short, tolerances, with_reasons
from validation.stability.stability_section import read_section as read_stability
from validation.trade.trade_section import read_section as read_trade

AGAIN = "make report"


def write_report(
    scenes: list[ComparedScene], path: Path, command: str = AGAIN, runs: Path | None = None
) -> Counter[str]:
    """Writes the page, and JSON and JUnit XML of its name beside it.

    Args:
        scenes: those that get a section each.
        path: of the page; studies are read from the tables in its folder.
        command: how it is made again.
        runs: where run folders are, if it was told.

    Returns:
        How many pairs of a scene or independent case and an engine passed, failed and were not run.

    Raises:
        InputError: a table or a figure in the folder is damaged.
    """
    results = path.parent
    made = made_with(scenes, command)
    independent = read_independent(results)
    titles = {case["id"]: case["title"] for case in independent.get("cases", [])}
    rows, reasons = with_reasons([scene_row(scene, runs) for scene in scenes])
    cases = case_rows(read_verdicts(results), titles)
    figures, missing = read_figures(results)
    page = deck.render(
        "report/report.html.j2",
        made=made,
        rows=rows,
        cases=cases,
        engines=in_order(engine for row in (*rows, *cases) for engine in row.cells),
        reasons=reasons,
        counts=counted(rows),
        case_counts=counted(cases),
        tolerances=tolerances(scenes),
        scenes=[section_of(scene, row) for scene, row in zip(scenes, rows, strict=True)],
        independent=independent,
        table1=read_table1(results),
        figures=figures,
        missing=missing,
        claims=read_claims(results / paths.CLAIMS_TABLE),
        trade=read_trade(results),
        stability=read_stability(results),
        elements=read_elements(results),
        dark=DARK,
        words=WORDS,
        dates=tables_made(results),
        short=short,
        places=PLACES,
    )
    results.mkdir(parents=True, exist_ok=True)
    _write_all(
        {
            path: page,
            path.with_suffix(".json"): as_json(made, scenes, rows, cases),
            path.with_suffix(".xml"): as_junit(made, rows, cases),
        }
    )
    return counted((*rows, *cases))


def _write_all(texts: dict[Path, str]) -> None:
    """All files, each whole; none is replaced before every one is written."""
    with ExitStack() as drafts:
        for path, text in texts.items():
            drafts.enter_context(whole_file(path)).write_text(text, encoding="utf-8")
