"""``python -m validation report``: compares scenes, running what is not done, and writes the page with JSON and XML."""

import shlex
import sys
from collections import Counter
from collections.abc import Mapping
from contextlib import ExitStack
from pathlib import Path

from drivers.base import decks as deck
from drivers.base import paths
from drivers.base.command_line import engines_again
from drivers.base.errors import InputError
from drivers.base.files import whole_file
from drivers.engines import in_order
from drivers.scene.read_scene import read_scene
from validation.compare.asked import Asked, print_unmet
from validation.compare.comparison import ComparedScene, run_and_compare
from validation.compare.verdict import FAIL, NOT_RUN, PASS
from validation.report.charts import PLACES
from validation.report.machine_readable import as_json, as_junit, made_with, when_made
from validation.report.page_figures import read_figures, read_table1
from validation.report.scene_section import case_rows, counted, scene_row, section_of, short, tolerances
from validation.studies import read_section

PAPER = ("fig4", "fig5", "fig6b", "fig6d")
AGAIN = "make report"


# link in the contents and heading of each section, by the name of its template, its table and its ``make`` target
SECTIONS = {
    "independent": ("Independent cases", "Independent cases: are the codes right beyond the paper?"),
    "table1": ("Table 1", "Table 1 of the paper"),
    "claims": ("Claims", "The paper's statements, computed"),
    "figures": ("Figures", "The paper's figures, computed"),
    "trade": ("Cost of accuracy", "What accuracy costs"),
    "stability": ("Stability", "Where it breaks"),
    "elements": ("Elements", "What each element adds"),
}
READERS = {"table1": read_table1, "figures": read_figures}  # of sections that are no study's


def report(sources: list[str], out: Path | None, runs: Path | None, asked: Asked) -> int:
    """Runs and compares scenes and writes the report.

    The exit code is 1 where a verdict is a failure or an engine that has to run did not.

    Raises:
        InputError: a scene is wrong, a scene is named twice, or the page would take its own files' names.
    """
    page = out or paths.RESULTS / "report.html"
    if page.suffix in (".json", ".xml"):
        raise InputError(f"--out {page}", "", page.suffix, "another ending: JSON and XML are written beside the page")
    names = Counter(read_scene(source).name for source in sources or PAPER)
    for name in (name for name, count in names.items() if count > 1):
        raise InputError("report", "", f"two scenes named {name}", "scenes of different names")
    compared = []
    for source in sources or PAPER:
        compared.append(run_and_compare(source, runs=runs or paths.RUNS, asked=asked))
        print(f"{source}: compared", file=sys.stderr, flush=True)
    unmet = asked.unmet(engine for scene in compared for engine in scene.wall_s)
    counts = write_report(compared, page, _command(sources, out, runs, asked), runs, unmet)
    print(f"{paths.shown(page)}: {counts[PASS]} passed, {counts[FAIL]} failed, {counts[NOT_RUN]} not run")
    return 1 if print_unmet(unmet) or counts[FAIL] else 0


def _command(sources: list[str], out: Path | None, runs: Path | None, asked: Asked) -> str:
    """The command that makes the same page again; ``make report`` requires engines, too."""
    given = [("--out", out), ("--runs", runs), *(("--engine", name) for name in asked.engines)]
    options = [str(word) for option in given if option[1] is not None for word in option] + engines_again()
    options += ["--allow-missing"] * asked.allow_missing
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
) -> Counter[str]:
    """Writes the page, and JSON and JUnit XML of its name beside it; none is replaced before all are written.

    Each scene gets a section; studies are read from the tables in the page's folder. ``command`` makes the page again;
    ``unmet`` are words on engines that had to run.
    What comes back is how many pairs of a scene or independent case and an engine passed, failed and were not run.

    Raises:
        InputError: a table or a figure in the folder is damaged.
    """
    results = path.parent
    made = made_with(scenes, command)
    sections = {name: READERS[name](results) if name in READERS else read_section(name, results) for name in SECTIONS}
    rows = [scene_row(scene, runs) for scene in scenes]
    cases = case_rows(sections["independent"])
    page = deck.render(
        "report/report.html.j2",
        made=made,
        unmet=unmet or {},
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
        path.with_suffix(".json"): as_json(made, scenes, rows, cases, unmet or {}),
        path.with_suffix(".xml"): as_junit(made, rows, cases, unmet or {}),
    }
    results.mkdir(parents=True, exist_ok=True)
    with ExitStack() as drafts:
        for file, text in texts.items():
            drafts.enter_context(whole_file(file)).write_text(text, encoding="utf-8")
    return counted((*rows, *cases))
