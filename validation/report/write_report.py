"""``python -m validation report``: compares scenes, running what is not done, and writes the page with JSON and XML."""

import shlex
from collections import Counter
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Any

from drivers.base import decks as deck
from drivers.base import paths
from drivers.base.command_line import engines_again
from drivers.base.errors import InputError, RunError
from drivers.base.files import whole_file
from drivers.base.progress import say, step
from drivers.chain.case import build_case
from drivers.engines import in_order
from drivers.scene.read_scene import read_scene
from postproc.read.measured import read_traces
from postproc.read.sensors import gauges_of
from validation.compare.asked import Asked, print_unmet
from validation.compare.comparison import ComparedScene, run_and_compare_all
from validation.compare.verdict import FAIL, NOT_RUN, PASS
from validation.report.charts import PLACES
from validation.report.machine_readable import as_json, as_junit, made_with, when_made
from validation.report.page_figures import read_figures, read_table1
from validation.report.scene_section import case_rows, counted, scene_row, section_of, short, tolerances
from validation.studies import STUDIES, Options, load_study, named, read_section, up_to_date, write_study

PAPER = ("fig4", "fig5", "fig6b", "fig6d")
AGAIN = "make report"
WHOLE = ("independent", "claims")  # studies that have no short form


# link in the contents and heading of each section, by the name of its template, its table and its ``make`` target
SECTIONS = {
    "independent": ("Independent cases", "Independent cases: are the codes right beyond the paper?"),
    "table1": ("Table 1", "Table 1 of the paper"),
    "claims": ("Claims", "The paper's statements, computed"),
    "figures": ("Figures", "The paper's figures, computed"),
    "trade": ("Cost of accuracy", "What accuracy costs"),
    "stability": ("Stability", "Where it breaks"),
    "elements": ("Elements", "What each element adds"),
    "calibration": ("Calibration", "What the experiments ask for"),
}
READERS = {"table1": read_table1, "figures": read_figures}  # of sections that are no study's


def report(sources: list[str], out: Path | None, runs: Path | None, asked: Asked, *, studies: bool = False) -> int:
    """Runs and compares scenes and writes the report; with ``studies`` it grows by those that are not up to date.

    These are short ones, but for claims and independent cases; a table of another study is left as it is. What was
    made before an interrupt is not made again. The exit code is 1 where a verdict is a failure, a study misses a
    requirement, or an engine that has to run did not.

    Raises:
        InputError: a scene is wrong, a scene is named twice, or the page would take its own files' names.
    """
    page, folder = out or paths.RESULTS / "report.html", runs or paths.RUNS
    if page.suffix in (".json", ".xml"):
        raise InputError(f"--out {page}", "", page.suffix, "another ending: JSON and XML are written beside the page")
    scenes = [read_scene(source) for source in sources or PAPER]
    names = Counter(scene.name for scene in scenes)
    for name in (name for name, count in names.items() if count > 1):
        raise InputError("report", "", f"two scenes named {name}", "scenes of different names")
    for scene in scenes:
        if scene.measured:  # wrong files are named before anything runs
            read_traces(scene, gauges_of(build_case(scene).layout))
    to_come = [name for name in STUDIES if studies and not _made(name, page.parent)]
    steps, command = 1 + len(to_come), _command(sources, out, runs, asked, studies=studies)
    with step("scenes on all engines, compared", 1, steps):
        compared = [*run_and_compare_all(sources or PAPER, runs=folder, asked=asked)]
        unmet = asked.unmet(engine for scene in compared for engine in scene.wall_s)
        counts = write_report(compared, page, command, runs, unmet, to_come)
    _announce(page, counts, to_come)
    failed = False
    for number, name in enumerate([*to_come], 2):
        study, options = load_study(name), Options(page.parent, folder, quick=name not in WHOLE)
        with step(named(study.title, options), number, steps):
            try:
                write_study(study, study.measure(options), page.parent)
            except RunError as error:  # the others are made all the same
                say(f"{name}: {error}")
                failed = True
            to_come.remove(name)
            counts = write_report(compared, page, command, runs, unmet, to_come)
        _announce(page, counts, to_come)
    missed = [line for name in STUDIES if studies for line in _missed(name, page.parent)]
    for line in missed:
        say(line)
    return 1 if print_unmet(unmet) or counts[FAIL] or missed or failed else 0


def _made(name: str, results: Path) -> bool:
    """Whether a study need not be made: its table is up to date, or one that may be of the whole study."""
    study = load_study(name)
    return up_to_date(study, results) if name in WHOLE else (results / f"{study.main_table}.csv").exists()


def _missed(name: str, results: Path) -> Sequence[str]:
    study = load_study(name)
    return study.missed(study.read(results)) if (results / f"{study.main_table}.csv").exists() else ()


def _announce(page: Path, counts: Counter[str], to_come: Sequence[str]) -> None:
    said = f"{paths.shown(page)}: {counts[PASS]} passed, {counts[FAIL]} failed, {counts[NOT_RUN]} not run"
    print(said + (f"; to come: {', '.join(to_come)}" if to_come else ""), flush=True)


def _command(sources: list[str], out: Path | None, runs: Path | None, asked: Asked, *, studies: bool) -> str:
    """The command that makes the same page again; ``make report`` requires engines, too."""
    given = [("--out", out), ("--runs", runs), *(("--engine", name) for name in asked.engines)]
    options = [str(word) for option in given if option[1] is not None for word in option] + engines_again()
    options += ["--allow-missing"] * asked.allow_missing + ["--studies"] * (studies and bool(options))
    if not sources and not options:
        return AGAIN
    options += [word for name in asked.require for word in ("--require", name)]
    return shlex.join(["python", "-m", "validation", "report", *sources, *options])


def write_report(
    scenes: list[ComparedScene],
    path: Path,
    command: str = AGAIN,
    runs: Path | None = None,
    unmet: Mapping[str, str] | None = None,
    to_come: Sequence[str] = (),
) -> Counter[str]:
    """Writes the page, and JSON and JUnit XML of its name beside it; none is replaced before all are written.

    Each scene gets a section; studies are read from the tables in the page's folder. ``command`` makes the page again;
    ``unmet`` are words on engines that had to run, ``to_come`` names of studies that are under way.
    What comes back is how many pairs of a scene or independent case and an engine passed, failed and were not run.

    Raises:
        InputError: a table or a figure in the folder is damaged.
    """
    results = path.parent
    made = made_with(scenes, command)
    sections: dict[str, Any] = {name: {} for name in SECTIONS}  # former tables of what is to come are not shown
    for name in (name for name in SECTIONS if name not in to_come):
        sections[name] = READERS[name](results) if name in READERS else read_section(name, results)
    rows = [scene_row(scene, runs) for scene in scenes]
    cases = case_rows(sections["independent"])
    page = deck.render(
        "report/report.html.j2",
        made=made,
        unmet=unmet or {},
        to_come=to_come,
        rows=rows,
        cases=cases,
        engines=in_order(engine for row in (*rows, *cases) for engine in row.cells),
        reasons=list(dict.fromkeys(cell.worst.reason for row in rows for cell in row.cells.values() if cell.worst)),
        counts=counted(rows),
        case_counts=counted(cases),
        tolerances=tolerances(scenes),
        scenes=[section_of(scene, row) for scene, row in zip(scenes, rows, strict=True)],
        sections=[(name, *words, sections[name]) for name, words in SECTIONS.items()],
        dates=when_made(results),
        short=short,
        shown=paths.shown,
        places=PLACES,
    )
    texts = {
        path: page,
        path.with_suffix(".json"): as_json(made, scenes, rows, cases, unmet or {}, to_come),
        path.with_suffix(".xml"): as_junit(made, rows, cases, unmet or {}),
    }
    results.mkdir(parents=True, exist_ok=True)
    with ExitStack() as drafts:
        for file, text in texts.items():
            drafts.enter_context(whole_file(file)).write_text(text, encoding="utf-8")
    return counted((*rows, *cases))
