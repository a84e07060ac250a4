"""``beads report``: run and compare scenes, and write the page with its JSON file."""

import re
import shlex
from collections import Counter
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Any

from markupsafe import Markup, escape

from drivers.base import decks as deck
from drivers.base import paths
from drivers.base.errors import InputError, RunError
from drivers.base.files import whole_file
from drivers.base.progress import in_words, say, step
from drivers.chain.case import build_case
from drivers.engines import in_order
from drivers.engines._entries import engines_again
from drivers.scene.read_scene import read_scene
from postproc.read.measured import read_traces
from postproc.read.sensors import gauges_of
from validation.chapters import CHAPTERS, Options, load_chapter, named, read_section, up_to_date, write_chapter
from validation.checks import FAIL, NOT_RUN, PASS, Check, short, table
from validation.compare.answer import answer
from validation.compare.comparison import ComparedScene, run_and_compare_all
from validation.compare.selection import EngineSelection, print_unmet
from validation.report.machine_readable import as_json, made_with, when_made
from validation.report.page_figures import read_figures, read_table1
from validation.report.scene_section import (
    case_rows,
    counted,
    forces_picture,
    scene_row,
    section_of,
    tolerances,
)

PAPER = ("fig4", "fig5", "fig6b", "fig6d")
MAKE_COMMAND = "make report"
POWER = re.compile(r"\d[\d.]*e[+-]?\d+")  # number with a power of ten
NO_SHORT_FORM = ("independent", "claims")  # chapters that are always made in full

# link and heading of each section, by the name of its template, table and ``make`` target
SECTIONS = {
    "independent": ("Independent cases", "Independent cases: are the codes right beyond the paper?"),
    "table1": ("Table 1", "Table 1 of the paper"),
    "claims": ("Claims", "The paper's statements, computed"),
    "figures": ("Figures", "The paper's figures, computed"),
    "trade": ("Cost of accuracy", "Cost of accuracy"),
    "stability": ("Stability", "Stability limits of the time step"),
    "elements": ("Elements", "Effects of the modelled elements"),
    "calibration": ("Calibration", "Parameters fitted to the experiments"),
}
READERS = {"table1": read_table1, "figures": read_figures}  # sections that belong to no chapter


def report(
    sources: list[str], out: Path | None, runs: Path | None, asked: EngineSelection, *, studies: bool = False
) -> int:
    """Run and compare scenes, and write the report; with ``studies`` also make the chapters that are not up to date.

    Chapters are made in their short form, claims and independent cases in full; existing tables of other chapters are
    kept. Without named scenes the report is on the paper's scenes, with its chapters; a report on named scenes has
    none unless ``studies`` are asked for. The exit code is 1 if a verdict fails, a chapter misses a requirement, or a
    required engine did not run.

    Raises:
        InputError: a scene is wrong, two scenes have one name, or the page has the name of a JSON file.
    """
    page, folder = out or paths.RESULTS / "report.html", runs or paths.RUNS
    if page.suffix == ".json":
        raise InputError(f"--out {page}", "", page.suffix, "another ending than that of its JSON file")
    scenes = [read_scene(source) for source in sources or PAPER]
    names = Counter(scene.name for scene in scenes)
    for name in (name for name, count in names.items() if count > 1):
        raise InputError("report", "", f"two scenes named {name}", "scenes of different names")
    for scene in scenes:
        if scene.measured:  # report wrong files before any run
            read_traces(scene, gauges_of(build_case(scene).layout))
    to_come = [name for name in CHAPTERS if studies and not _made(name, page.parent)]
    steps, command = 1 + len(to_come), _command(sources, out, runs, asked, studies=studies)
    sections = tuple(SECTIONS) if studies or not sources else ()
    with step("scenes on all engines, compared", 1, steps):
        compared = [*run_and_compare_all(sources or PAPER, runs=folder, asked=asked)]
        absent = {engine: why for scene in reversed(compared) for engine, why in scene.absent.items()}
        unmet = asked.unmet((engine for scene in compared for engine in scene.ran), absent)
        counts = write_report(compared, page, command, runs, unmet, to_come, sections)
    _announce(page, counts, to_come)
    failed = False
    for number, name in enumerate([*to_come], 2):
        chapter, options = load_chapter(name), Options(page.parent, folder, quick=name not in NO_SHORT_FORM)
        with step(named(chapter.title, options), number, steps):
            try:
                write_chapter(chapter, chapter.measure(options), page.parent)
            except RunError as error:  # continue with the other chapters
                say(f"{name}: {error}")
                failed = True
            to_come.remove(name)
            counts = write_report(compared, page, command, runs, unmet, to_come, sections)
        _announce(page, counts, to_come)
    missed = [check for name in CHAPTERS if studies for check in _failed(name, page.parent)]
    for line in table(missed) if missed else ():
        say(line)
    return 1 if print_unmet(unmet) or counts[FAIL] or missed or failed else 0


def _made(name: str, results: Path) -> bool:
    """True if a chapter is up to date; an existing table counts for a chapter with a short form."""
    chapter = load_chapter(name)
    if not (results / f"{chapter.main_table}.csv").exists():
        return False
    try:
        chapter.read(results)
    except InputError as error:
        say(str(error))
        return False
    return name not in NO_SHORT_FORM or up_to_date(chapter, results)


def _failed(name: str, results: Path) -> Sequence[Check]:
    chapter = load_chapter(name)
    return chapter.failed(chapter.read(results)) if (results / f"{chapter.main_table}.csv").exists() else ()


def _announce(page: Path, counts: Counter[str], to_come: Sequence[str]) -> None:
    line = f"{paths.shown(page)}: {counts[PASS]} passed, {counts[FAIL]} failed, {counts[NOT_RUN]} not run"
    print(line + (f"; to come: {', '.join(to_come)}" if to_come else ""), flush=True)


def _command(sources: list[str], out: Path | None, runs: Path | None, asked: EngineSelection, *, studies: bool) -> str:
    """Command that makes the same page again; ``make report`` requires engines as well."""
    given = [("--out", out), ("--runs", runs), *(("--engine", name) for name in asked.engines)]
    options = [str(word) for option in given if option[1] is not None for word in option] + engines_again()
    options += ["--allow-missing"] * asked.allow_missing + ["--studies"] * (studies and bool(options))
    if not sources and not options:
        return MAKE_COMMAND
    options += [word for name in asked.require for word in ("--require", name)]
    return shlex.join(["beads", "report", *sources, *options])


def write_report(
    scenes: list[ComparedScene],
    path: Path,
    command: str = MAKE_COMMAND,
    runs: Path | None = None,
    unmet: Mapping[str, str] | None = None,
    to_come: Sequence[str] = (),
    sections: Sequence[str] = tuple(SECTIONS),
) -> Counter[str]:
    """Write the page, and next to it JSON with its name; no file is replaced before both are written.

    Args:
        scenes: compared scenes; each has a section.
        path: of the page; chapters are read from tables in its folder.
        command: makes the page again.
        runs: folder of the run folders if not the default.
        unmet: messages on required engines without a run.
        to_come: names of chapters that are being made.
        sections: names of the sections that follow the scenes.

    Returns:
        Numbers of pairs of a scene or independent case and an engine that passed, failed and were not run.

    Raises:
        InputError: a table or a figure in the folder is damaged.
    """
    results = path.parent
    made = made_with(scenes, command)
    shown: dict[str, Any] = {name: {} for name in sections}  # a chapter to come is not read: its tables are outdated
    for name in (name for name in shown if name not in to_come):
        shown[name] = READERS[name](results) if name in READERS else read_section(name, results)
    rows = [scene_row(scene, runs) for scene in scenes]
    cases = [*case_rows(shown.get("independent", {}))]
    page = deck.render(
        "report/report.html.j2",
        subject=rows[0].title if len(rows) == 1 and not sections else "Bead chains",
        answer=unbroken(
            " ".join(
                answer(scenes, {row.name: {name: cell.verdict for name, cell in row.cells.items()} for row in cases})
            )
        ),
        claims=claim_counts(shown.get("claims", {})),
        made=made,
        unmet=unmet or {},
        to_come=to_come,
        rows=rows,
        cases=cases,
        engines=in_order(engine for row in (*rows, *cases) for engine in row.cells),
        reasons=list(dict.fromkeys(cell.worst.reason for row in rows for cell in row.cells.values() if cell.worst)),
        counts=counted(rows),
        case_counts=counted(cases),
        case_checks=sum(len(cell.checks) for row in cases for cell in row.cells.values()),
        tolerances=tolerances(scenes),
        scenes=[section_of(scene, row) for scene, row in zip(scenes, rows, strict=True)],
        brief=forces_picture(scenes[0], gauges=1) if scenes else None,
        sections=[(name, *SECTIONS[name], section) for name, section in shown.items()],
        dates=when_made(results),
        short=short,
        in_words=in_words,
        unbroken=unbroken,
        shown=paths.shown,
    )
    texts = {
        path: page,
        path.with_suffix(".json"): as_json(made, scenes, rows, cases, unmet or {}, to_come),
    }
    results.mkdir(parents=True, exist_ok=True)
    with ExitStack() as drafts:
        for file, text in texts.items():
            drafts.enter_context(whole_file(file)).write_text(text, encoding="utf-8")
    return counted((*rows, *cases))


def unbroken(text: str) -> Markup:
    """Text whose numbers with a power of ten are kept on one line."""
    return Markup(POWER.sub(r'<span class="number">\g<0></span>', str(escape(text))))


def claim_counts(claims: Mapping[str, Any]) -> dict[str, int]:
    """Numbers of the paper's statements that are reproduced, differ and are not tested; empty without the chapter."""
    if not claims:
        return {}
    counts = {verdict: len(rows) for verdict, rows in claims["rows"].items()}
    return counts | {"untested": len(claims["untested"])}
