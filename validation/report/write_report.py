"""``beads report``: run and compare scenes, and write the page with its JSON file."""

import re
from collections import Counter
from collections.abc import Collection, Mapping, Sequence
from contextlib import ExitStack
from functools import partial
from pathlib import Path
from typing import Any

from markupsafe import Markup, escape

from drivers.base import decks as deck
from drivers.base import paths, terminal
from drivers.base.errors import InputError
from drivers.base.files import whole_file
from drivers.base.processes import cores
from drivers.base.terminal import say
from drivers.chain.case import build_case
from drivers.engines import in_order, load_engine
from drivers.run.execute import Place, execute, get_ready
from drivers.scene.read_scene import read_scene
from postproc.figures import captions
from postproc.read.measured import read_traces
from postproc.read.sensors import gauges_of
from validation.chapters import CHAPTERS, QUICK_CHAPTERS, load_chapter, make_parts, read_section, up_to_date
from validation.checks import FAIL, NOT_RUN, PASS, short, table
from validation.compare.comparison import (
    ComparedScene,
    EngineSelection,
    answer,
    display_name,
    listed,
    run_and_compare_all,
)
from validation.report.machine_readable import as_json, made_with, when_made
from validation.report.page_figures import read_figures, read_part
from validation.report.scene_section import case_rows, counted, section_of, tolerances

SUBJECT = "Strongly nonlinear waves in a chain of Teflon beads"
PAPER = ("fig4", "fig5", "fig6b", "fig6d")
POWER = re.compile(r"\d[\d.]*e[+-]?\d+")  # number with a power of ten
SHARING = ("claims",)  # chapters that have runs in common with the figures, and are made after them
BESIDE = Place(processes=True)

# link and heading of each section of the paper's page, by the name of its template; all but the first are chapters
FIGURES = "figures"
SECTIONS = {
    FIGURES: ("Figures", "The paper's figures and Table 1, computed"),
    "claims": ("Statements", "The paper's statements, computed"),
    "calibration": ("Experiment", "The experiment: fitted contact laws"),
    "trade": ("Cost of accuracy", "Cost of accuracy"),
    "stability": ("Stability", "Stability limits of the time step"),
    "elements": ("Elements", "Effects of the modelled elements"),
}


def report(
    sources: Sequence[str],
    out: Path | None,
    runs: Path | None,
    asked: EngineSelection,
    command: str = "",
    *,
    studies: bool = False,
    place: Place = BESIDE,
) -> int:
    """Run and compare scenes, and write the report; with ``studies`` also make what of its parts is not up to date.

    Parts are the figures and the table of the paper, and the chapters, made side by side at a ``place``. Chapters are
    made in their short form, claims in full; existing tables of other chapters are kept. Without named scenes the
    report is on the paper's scenes, with its parts; a report on named scenes has none unless ``studies`` are asked for.
    The exit code is 1 if a verdict fails, a part fails or misses a requirement, or a required engine did not run. The
    page names the ``command`` that makes it.

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
    sections = tuple(SECTIONS) if studies or not sources else ()
    for scene in scenes:  # wrong files are reported before any run
        if scene.measured:
            read_traces(scene, gauges_of(build_case(scene).layout))
    for name in () if studies else sections:
        _section(name, page.parent, ())
    to_come = [name for name in (*captions(), *CHAPTERS) if studies and not _made(name, page.parent)]
    sharing = [name for name in to_come if name in captions() or name in SHARING]
    groups = [*filter(None, [sharing]), *([name] for name in to_come if name not in sharing)]
    if place.processes:
        get_ready(min(cores(), len(groups)), make_parts)
    failed = False
    with terminal.counted("scenes on all engines, compared"):
        compared = [*run_and_compare_all(sources or PAPER, runs=folder, asked=asked)]
        unmet = asked.unmet(compared)
        counts = write_report(compared, page, command, runs, unmet, to_come, sections)
    _announce(page, counts, to_come)

    def grow(ended: Collection[str] = ()) -> None:
        """Write the page with the parts that have been made meanwhile, and without those that have failed."""
        nonlocal counts
        made = [name for name in to_come if name in ended or up_to_date(name, page.parent)]
        if made:
            to_come[:] = [name for name in to_come if name not in made]
            counts = write_report(compared, page, command, runs, unmet, to_come, sections)
            _announce(page, counts, to_come)

    if groups:
        with terminal.counted("figures and chapters, side by side"):
            for group, (said, good) in execute(partial(make_parts, page.parent, folder), groups, place, grow):
                for line in said:
                    say(line)
                grow(group)
                failed |= not good
    chapters = [load_chapter(name) for name in CHAPTERS if studies]
    stored = [(chapter, tables) for chapter in chapters if (tables := chapter.read(page.parent))]
    missed = [check for chapter, tables in stored for check in chapter.failed(tables)]
    for line in table(missed) if missed else ():
        say(line)
    if unmet:
        say("; ".join(unmet.values()))
    return 1 if unmet or counts[FAIL] or missed or failed else 0


def _made(part: str, results: Path) -> bool:
    """True if a figure or a chapter is up to date; any stored one counts for a chapter with a short form."""
    try:
        there = any(read_part(part, results)) if part in captions() else read_section(part, results)
        return bool(there) and (part in QUICK_CHAPTERS or up_to_date(part, results))
    except (InputError, OSError) as error:  # such as a folder in place of a file
        say(str(error))
        return False


def _announce(page: Path, counts: Counter[str], to_come: Sequence[str]) -> None:
    line = f"{paths.shown(page)}: {counts[PASS]} passed, {counts[FAIL]} failed, {counts[NOT_RUN]} not run"
    print(line + (f"; to come: {', '.join(to_come)}" if to_come else ""), flush=True)


def write_report(
    scenes: Sequence[ComparedScene],
    path: Path,
    command: str = "",
    runs: Path | None = None,
    unmet: Mapping[str, str] | None = None,
    to_come: Sequence[str] = (),
    names: Sequence[str] = tuple(SECTIONS),
) -> Counter[str]:
    """Write the page, and next to it JSON with its name; no file is replaced before both are written.

    Args:
        scenes: compared scenes; each has a section.
        path: of the page; figures and chapters are read from its folder.
        command: made the page.
        runs: folder of the run folders if not the default.
        unmet: messages on required engines without a run.
        to_come: names of figures and chapters that are being made; they are not read, since they are outdated.
        names: names of the sections on the paper; none for a page on the scenes alone.

    Returns:
        Numbers of pairs of a scene or independent case and an engine that passed, failed and were not run.

    Raises:
        InputError: a table or a figure in the folder is damaged.
    """
    results, unmet = path.parent, unmet or {}
    made = made_with(scenes, command)
    sections = {name: _section(name, results, to_come) for name in names}
    claims = sections.get("claims")
    cases = case_rows(claims or {})
    about = [section_of(scene, results, runs) for scene in scenes]
    rows = [described["row"] for described in about]
    engines = in_order(engine for row in (*rows, *cases) for engine in row.cells)
    verdicts = {row.name: {name: cell.verdict for name, cell in row.cells.items()} for row in cases}
    page = deck.render(
        "report/report.html.j2",
        subject=SUBJECT if sections else f"{' and '.join(row.title for row in rows)}: do the codes agree?",
        answer=" ".join(answer(scenes, verdicts)),
        codes=listed([display_name(name) for name in engines if not load_engine(name).in_repository]),
        claims=claims,
        failures=[
            (row, engine, cell) for row in (*rows, *cases) for engine, cell in row.cells.items() if cell.verdict == FAIL
        ],
        made=made,
        builds=[(name, build["version"], build["command"], build["sha256"]) for name, build in made["engines"].items()],
        unmet=unmet,
        to_come=to_come,
        verdicts=[(row.name, *map(row.cells.get, engines)) for row in rows],
        engines=engines,
        counts=counted(rows),
        tolerances=tolerances(scenes),
        scenes=about,
        sections=[(name, *SECTIONS[name], section) for name, section in sections.items()],
        dates=when_made(results) if sections else [],
        short=short,
        unbroken=unbroken,
        shown=paths.shown,
    )
    texts = {path: page, path.with_suffix(".json"): as_json(made, scenes, rows, cases, unmet, to_come)}
    results.mkdir(parents=True, exist_ok=True)
    with ExitStack() as drafts:
        for file, text in texts.items():
            drafts.enter_context(whole_file(file)).write_text(text, encoding="utf-8")
    return counted((*rows, *cases))


def _section(name: str, results: Path, to_come: Sequence[str]) -> dict[str, Any]:
    if name == FIGURES:
        return read_figures(results, to_come)
    return {} if name in to_come else read_section(name, results)


def unbroken(text: str) -> Markup:
    """Text whose numbers with a power of ten are kept on one line."""
    return Markup(POWER.sub(r'<span class="number">\g<0></span>', str(escape(text))))
