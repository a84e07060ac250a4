"""``beads report``: run and compare scenes, and write the page with its JSON file."""

import datetime
import os
import platform
import re
import time
from collections import Counter
from collections.abc import Collection, Mapping, Sequence
from contextlib import ExitStack
from functools import partial
from importlib.metadata import version
from pathlib import Path
from typing import Any
from urllib.parse import quote

import pandas as pd
from markupsafe import Markup, escape
from pydantic import TypeAdapter

from drivers.base import decks as deck
from drivers.base import paths, terminal
from drivers.base.errors import InputError
from drivers.base.files import whole_file
from drivers.base.terminal import say
from drivers.engines import in_order, load_engine
from drivers.run.execute import Place, execute, get_ready
from drivers.run.run import provenance
from postproc.draw.plot import SPACETIME
from postproc.figures import captions
from postproc.read.measured import read_traces
from postproc.read.signals import gauges_of
from validation.accuracy.budget import text_of
from validation.accuracy.plan import planned_case
from validation.chapters import CHAPTERS, IN_FULL, TABLE, make_parts, up_to_date
from validation.checks import DIFFERS, FAIL, NOT_ACCURATE, NOT_RUN, PASS, REPRODUCED, short, table
from validation.compare.comparison import ComparedScene, EngineSelection, answer, compare_cases, listed
from validation.report.parts import PARTS, read_part
from validation.report.scene_section import case_rows, counted, section_of, source_of, tolerances

SUBJECT = "Strongly nonlinear waves in a chain of Teflon beads"
PAPER = ("fig4", "fig5", "fig6b", "fig6d")
POWER = re.compile(r"\d[\d.]*e[+-]?\d+")  # number with a power of ten
CODE = re.compile("`([^`]+)`")
SUBSCRIPT = re.compile(r"\b([^\W_])_(\w)\b")
VERDICT = re.compile(f"({'|'.join((PASS, FAIL, NOT_RUN, NOT_ACCURATE, REPRODUCED, DIFFERS))})(?: (.*))?")
NARROW, NARROW_WORDS = 60, 40  # characters of the longest texts, and of the longest words, of a row on narrow screens
BESIDE = Place(processes=True)
SCHEMA = 3  # of the JSON file
LEFT_OUT = ("scene", "layout", "elements", "files")  # there of the record of a run
LIBRARIES = ("numpy", "scipy", "numba")
CPUS = Path("/proc/cpuinfo")

# link and heading of each section on the paper
FIGURES = "figures"
SECTIONS = {FIGURES: ("Figures", "The paper's figures and Table 1, computed")}
SECTIONS |= {name: (link, heading) for name, (_, link, heading) in CHAPTERS.items()}


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
        InputError: a scene is wrong, two scenes have one name, or the page has the ending of its JSON file.
    """
    page, folder = out or paths.RESULTS / "report.html", runs or paths.RUNS
    if page.suffix == ".json":
        raise InputError(f"--out {page}", "", page.suffix, "another ending than that of its JSON file")
    cases = [planned_case(source) for source in sources or PAPER]
    names = Counter(case.scene.name for case in cases)
    for name in (name for name, count in names.items() if count > 1):
        raise InputError("report", "", f"two scenes named {name}", "scenes of different names")
    sections = tuple(SECTIONS) if studies or not sources else ()
    for case in cases:  # wrong files are reported before any run
        read_traces(case.scene, gauges_of(case.layout))
    for name in () if studies else sections:
        _section(name, page.parent, ())
    to_come = [name for name in (*captions(), *CHAPTERS) if studies and not _made(name, page.parent)]
    sharing = [name for name in to_come if _is_whole(name)]  # chapters after the figures, whose runs they have
    groups = [*filter(None, [sharing]), *([name] for name in to_come if name not in sharing)]
    if place.processes:
        get_ready(make_parts)
    failed = False
    with terminal.counted("scenes on all engines, compared"):
        compared = [*compare_cases(cases, asked.names, folder)]
        unmet = asked.unmet(compared)
        write = partial(write_report, compared, page, command, runs, unmet, to_come, sections)
        counts = write()

    def grow(ended: Collection[str] = ()) -> None:
        """Write the page with the parts that have been made meanwhile, and without those that have failed."""
        nonlocal counts
        made = [name for name in to_come if name in ended or up_to_date(name, page.parent)]
        if made:
            to_come[:] = [name for name in to_come if name not in made]
            counts = write()

    if groups:
        with terminal.counted("figures and chapters, side by side"):
            for group, (said, good) in execute(partial(make_parts, page.parent, folder), groups, place, grow):
                for line in said:
                    say(line)
                grow(group)
                failed |= not good
    stored = [read_part(name, page.parent) for name in CHAPTERS if studies]
    missed = [check for part in filter(None, stored) for check in part.failed]
    for line in table(missed) if missed else ():
        say(line)
    if unmet:
        say("; ".join(unmet.values()))
    return 1 if unmet or counts[FAIL] or missed or failed else 0


def _is_whole(part: str) -> bool:
    """True for a figure, and for a chapter without a short form on the page."""
    return part in captions() or part in IN_FULL


def _made(part: str, results: Path) -> bool:
    """True if a figure or a chapter is up to date; any stored one counts for a chapter with a short form."""
    try:
        return read_part(part, results) is not None and (not _is_whole(part) or up_to_date(part, results))
    except (InputError, OSError) as error:  # such as a folder in place of a file
        say(str(error))
        return False


def write_report(
    scenes: Sequence[ComparedScene],
    path: Path,
    command: str = "",
    runs: Path | None = None,
    unmet: Mapping[str, str] | None = None,
    to_come: Sequence[str] = (),
    names: Sequence[str] = tuple(SECTIONS),
) -> Counter[str]:
    """Write the page, and next to it JSON with its name; no file is replaced before both are written. Print the counts.

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
    cases = case_rows(claims.checks if claims else ())
    about = [section_of(scene, results, runs) for scene in scenes]
    rows = [described["row"] for described in about]
    cells = [(row, engine, cell) for row in (*rows, *cases) for engine, cell in row["engines"].items()]
    ran = in_order({engine for scene in scenes for engine in scene.runs})
    verdicts = {row["name"]: {name: cell["verdict"] for name, cell in row["engines"].items()} for row in cases}
    builds = [
        (name, build["version"], f"`{build['command']}`", f"`{build['sha256']}`")
        for name, build in made["engines"].items()
    ]
    dates = [(file.stem, _utc(file.stat().st_mtime)) for file in sorted((results / PARTS).glob("*.json"))]
    page = deck.render(
        "report/report.html.j2",
        subject=SUBJECT if sections else f"{' and '.join(row['title'] for row in rows)}: do the codes agree?",
        answer=" ".join(answer(scenes, verdicts)),
        codes=listed([load_engine(name).in_print for name in ran if not load_engine(name).in_repository]),
        claims=claims,
        failures=[(row, engine, cell) for row, engine, cell in cells if cell["verdict"] == FAIL],
        made=made,
        builds=pd.DataFrame(builds, columns=["engine", "version", "command", "digest of programs and libraries"]),
        unmet=unmet,
        to_come=to_come,
        verdicts=_verdicts(rows, in_order(engine for _, engine, _ in cells)),
        counts=counted(rows),
        tolerances=tolerances(scenes),
        scenes=about,
        sections=[(name, *SECTIONS[name], section) for name, section in sections.items()],
        dates=pd.DataFrame(dates if sections else [], columns=["part", "made"]),
        short=short,
        typeset=typeset,
        is_wide=is_wide,
        marked=marked,
        in_lines=in_lines,
        shown=paths.shown,
    )
    texts = {path: page, path.with_suffix(".json"): as_json(made, scenes, rows, cases, unmet, to_come)}
    results.mkdir(parents=True, exist_ok=True)
    with ExitStack() as drafts:
        for file, text in texts.items():
            drafts.enter_context(whole_file(file)).write_text(text, encoding="utf-8")
    counts = counted((*rows, *cases))
    line = f"{paths.shown(path)}: {counts[PASS]} passed, {counts[FAIL]} failed, {counts[NOT_RUN]} not run"
    print(line + (f"; to come: {', '.join(to_come)}" if to_come else ""), flush=True)
    return counts


def _section(name: str, results: Path, to_come: Sequence[str]) -> Any:
    """Stored chapter, or the paper's figures: caption, image if it is no table, space-time picture and part of each."""
    if name != FIGURES:
        return None if name in to_come else read_part(name, results)
    stored = {name: None if name in to_come else read_part(name, results) for name in captions()}
    made = [
        {
            "caption": captions()[name],
            "image": part.figures.get(name) if name != TABLE else None,
            "spacetime": part.figures.get(f"{name}-{SPACETIME}"),
            "part": part,
        }
        for name, part in stored.items()
        if part
    ]
    return {"made": made, "missing": [name for name, part in stored.items() if not part]}


def _verdicts(rows: Sequence[Mapping[str, Any]], engines: Sequence[str]) -> pd.DataFrame:
    """Verdict, error of the force and note by scene and engine; each scene links to its section."""
    lines = []
    for row in rows:
        cells = row["engines"]
        link = Markup('<a href="#scene-{}">{}</a>').format(quote(row["name"]), row["name"])
        lines.append([link, *(text_of(cells[engine]["checks"]) if engine in cells else "" for engine in engines)])
    return pd.DataFrame(lines, columns=["scene", *engines], dtype=object)


def is_wide(table: pd.DataFrame) -> bool:
    """True for a table whose rows are blocks of labelled lines on narrow screens."""
    columns = [[heading, *(marked(str(cell)).striptags() for cell in table[heading])] for heading in table.columns]
    texts = sum(max(map(len, column)) for column in columns)
    words = sum(len(max(" ".join(column).split(), key=len)) for column in columns)
    return texts > NARROW or words > NARROW_WORDS


def typeset(text: str) -> Markup:
    """Text with `code`, subscripts in symbols such as F_m, and numbers with a power of ten kept on one line."""
    unbroken = POWER.sub(r'<span class="number">\g<0></span>', CODE.sub(r"<code>\1</code>", str(escape(text))))
    return Markup(SUBSCRIPT.sub(r"\1<sub>\2</sub>", unbroken))


def in_lines(text: str) -> Markup:
    """Text of a cell; lines after the first are small."""
    first, *others = text.split("\n")
    return typeset(first) + Markup("").join(Markup("<small>{}</small>").format(typeset(line)) for line in others)


def marked(text: str) -> Markup:
    """Text of a cell, in which a verdict at its beginning is marked; see ``parts.Shown``."""
    found = VERDICT.fullmatch(text.partition("\n")[0])
    if not found:
        return in_lines(text)
    verdict, kind = found[1], found[1].replace(" ", "-")
    rest = in_lines(text.removeprefix(verdict).lstrip(" "))
    if verdict in (REPRODUCED, DIFFERS):
        return Markup('<span class="{}">{}</span>').format(kind, rest)
    if verdict == PASS:
        return Markup('<b class="pass" role="img" aria-label="pass">✓</b> {}').format(rest)
    return Markup('<b class="{}">{}</b> {}').format(kind, f"✗ {verdict}" if verdict == FAIL else verdict, rest)


def made_with(scenes: Sequence[ComparedScene], command: str) -> dict[str, Any]:
    """Date, command, commit, engines, libraries and machine of a report."""
    made = provenance()
    records = {name: run.record for scene in scenes for name, run in scene.runs.items()}
    return {
        "date": _utc(time.time()),
        "command": command,
        "commit": made["commit"],
        "uncommitted_changes": made["dirty"],
        "lock_sha256": made["lock_sha256"],
        "engines": {
            name: {"version": run.engine_version, "command": run.executable, "sha256": run.build_sha256}
            for name, run in ((name, records[name]) for name in in_order(records))
        },
        "libraries": {"python": platform.python_version()} | {name: version(name) for name in LIBRARIES},
        "machine": {
            "host": platform.node(),
            "system": platform.platform(),
            "processor": cpu_name(),
            "cores": os.cpu_count() or 1,
        },
    }


def _utc(seconds: float) -> str:
    return datetime.datetime.fromtimestamp(seconds, datetime.UTC).strftime("%Y-%m-%d %H:%M UTC")


def cpu_name() -> str:
    """Processor's name from Linux, else from Python."""
    about = CPUS.read_text(errors="replace") if CPUS.exists() else ""
    named = re.search(r"^model name\s*: *(.+)$", about, re.MULTILINE)
    return named[1] if named else platform.processor() or platform.machine()


def as_json(
    made: dict[str, Any],
    scenes: Sequence[ComparedScene],
    rows: Sequence[Mapping[str, Any]],
    cases: Sequence[Mapping[str, Any]],
    unmet: Mapping[str, str],
    to_come: Sequence[str],
) -> str:
    """Report as JSON, with the names of chapters still to come; NaN and infinities become null."""
    cells = [cell for row in (*rows, *cases) for cell in row["engines"].values()]
    checks = Counter(check.verdict for cell in cells for check in cell["checks"])
    counts = {"scenes": counted(rows), "independent": counted(cases), "checks": checks}
    data = {
        "schema_version": SCHEMA,
        "made_with": made,
        "unmet": unmet,
        "to_come": to_come,
        "counts": {key: {kind: verdicts[kind] for kind in (PASS, FAIL, NOT_RUN)} for key, verdicts in counts.items()},
        "scenes": [_scene(scene, row) for scene, row in zip(scenes, rows, strict=True)],
        "independent": cases,
    }
    text = TypeAdapter(Any).dump_json(data, indent=1, fallback=lambda scalar: scalar.item())
    return f"{text.decode()}\n"


def _scene(scene: ComparedScene, row: Mapping[str, Any]) -> dict[str, Any]:
    case, engines = scene.case, dict(row["engines"])
    for engine, run in scene.runs.items():
        record = {name: value for name, value in vars(run.record).items() if name not in LEFT_OUT}
        engines[engine] = engines[engine] | {"run": {"folder": paths.shown(run.folder)} | record}
    about = {"summary": case.summary, "source": source_of(case.scene), "time_step_s": case.scene.time_step_s}
    return {**row, "engines": engines, **about, "elements": case.elements}
