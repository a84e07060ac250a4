"""Chapters of the report: each measures, states findings, draws figures, judges, and has a section in the page.

A chapter is a module of this folder with a function ``measure(options)`` that returns a ``Chapter``.
"""

from collections.abc import Iterable
from contextlib import redirect_stderr
from dataclasses import dataclass
from importlib import import_module
from io import StringIO
from pathlib import Path

import numpy as np
import pandas as pd

from drivers.base import paths
from drivers.base.cache import content_of, load, store
from drivers.base.errors import InputError, RunError
from drivers.base.files import sha256_of
from drivers.base.terminal import counted, say
from drivers.engines import entry_files, installed_codes, missing_codes
from postproc.draw.plot import SPACETIME, draw_spacetime
from postproc.figures import captions, make_figure
from postproc.figures.table1 import GROUPS, printed
from validation.checks import REPRODUCED, table
from validation.report.parts import Chapter, Shown, part_file, write_part

# subject for progress lines, link and heading of the section by chapter, in the order of the page
CHAPTERS = {
    "claims": ("published numbers", "Statements", "The paper's statements, computed"),
    "calibration": ("fits to the paper's experiments", "Experiment", "The experiment: fitted contact laws"),
    "trade": ("cost of accuracy", "Cost of accuracy", "Cost of accuracy"),
    "stability": ("limits of stability", "Stability", "Stability limits of the time step"),
    "elements": ("effects of elements", "Elements", "Effects of the modelled elements"),
}
TABLE, SCORED = "table1", "fig3"
LARGE_N = 2.0  # smallest force counted among the large amplitudes of the scores
COMPUTED = ("V_s, m/s", "L/2R, 0.2 %", "L/2R, 4 %")
IN_FULL = ("claims",)  # chapters that the page has in full; the short form is enough for the others


@dataclass(frozen=True)
class Options:
    """Options of the command; each chapter takes some of them.

    Attributes:
        file: file of the independent cases.
        quick: True for the short form.
        budget_s: engine time of all runs in s; None for the default of the chapter.
    """

    results: Path = paths.RESULTS
    runs: Path = paths.RUNS
    file: Path = paths.INDEPENDENT
    quick: bool = False
    budget_s: float | None = None


def measure(name: str, options: Options) -> Chapter:
    """Result of a chapter."""
    chapter: Chapter = import_module(f"{__name__}.{name}").measure(options)
    return chapter


def run_chapter(name: str, options: Options) -> int:
    """Measure, write tables and figures, print findings and failed checks; the exit code is 1 if a check fails."""
    with counted(CHAPTERS[name][0] + ", short study" * options.quick):
        chapter = measure(name, options)
        written = _write(name, chapter, options.results)
    print(*chapter.findings, *map(paths.shown, written), sep="\n")
    for line in table(chapter.failed) if chapter.failed else ():
        say(line)
    if missing_codes():
        say(f"not installed, and left out: {', '.join(missing_codes())}")
    return 1 if chapter.failed else 0


def up_to_date(name: str, results: Path) -> bool:
    """True if a chapter or figure was stored since the last change of a source or of the engines."""
    return part_file(name, results).exists() and load(_key_of(name, results)) is not None


def _key_of(name: str, results: Path) -> list[str]:
    return ["made", name, sha256_of(part_file(name, results)), content_of(entry_files()), *installed_codes()]


def _write(name: str, chapter: Chapter, results: Path) -> list[Path]:
    written = write_part(name, chapter, results)
    store(_key_of(name, results), True)
    return written


def write_paper_figure(name: str, runs: Path, results: Path) -> list[Path]:
    """Make a figure of the paper with its runs and the spacetime diagram of its chains; returns the written files."""
    product, title = make_figure(name, runs), captions()[name].title
    tables, figures = {name: product.table}, {name: (f"{title}, drawn from the runs", product.figure)}
    if product.chains:
        diagram, stem = draw_spacetime(product.chains), f"{name}-{SPACETIME}"
        tables[stem], figures[stem] = diagram.table, (f"{title}: force in every contact against time", diagram.figure)
    return _write(name, Chapter(tables, product.notes, figures, shown_of(name, product.table)), results)


def shown_of(name: str, table: pd.DataFrame) -> list[Shown]:
    """Tables of the page for a figure: Table 1 itself, and the scores of the moduli of the figure of speeds."""
    if name == TABLE:
        return [Shown("", "", _table_1(table))]
    return [Shown("Deviation of measured from computed speeds", "", _scores(table))] if name == SCORED else []


def _table_1(table: pd.DataFrame) -> pd.DataFrame:
    """Texts of Table 1, a column for each amplitude; numbers that equal the paper's are marked."""
    (measured, _, _), *computed = GROUPS
    labels = [f"{measured}: {words}" for words in ("duration, µs", "V_s, m/s", "L/2R")]
    labels += [f"{group}: {words}" for group, _, _ in computed for words in COMPUTED]
    texts: dict[str, list[str]] = {"F_m": [*labels, "deviation of codes"]}
    for row in table.to_dict("records"):
        (force, _), *cells = printed(row)
        texts[f"{force} N"] = [f"{REPRODUCED} {text}" if equal else text for text, equal in cells]
    return pd.DataFrame(texts)


def _scores(table: pd.DataFrame) -> pd.DataFrame:
    """Deviation of measured from computed speeds: a column for each modulus.

    Deviations are in per cent of the computed speed by amplitude, root mean squares in standard errors.
    """
    table = table[table["source"] == "score"]
    at = [f"measured minus computed speed at {force:g} N, %" for force in table["force_N"].unique()]
    texts = {"E": [*at, f"rms from {LARGE_N:g} N, standard errors", "rms below, standard errors"]}
    for modulus, points in table.groupby("modulus_MPa"):
        large = points["force_N"] >= LARGE_N
        rms = [np.sqrt((points["deviation_standard_errors"][which] ** 2).mean()) for which in (large, ~large)]
        deviations = [f"{value:+.1f}" for value in points["deviation_pct"]]
        texts[f"{modulus:g} MPa"] = [*deviations, *(f"{value:.1f}" for value in rms)]
    return pd.DataFrame(texts)


def make_parts(results: Path, runs: Path, names: Iterable[str]) -> tuple[list[str], bool]:
    """Make figures of the paper and chapters for the page, in a process that may be one of several.

    Returns:
        Lines that they say, and False if one of them fails, which does not stop the others.
    """
    good = True
    with redirect_stderr(StringIO()) as said:
        for name in names:
            try:
                if name in captions():
                    write_paper_figure(name, runs, results)
                else:
                    _write(name, measure(name, Options(results, runs, quick=name not in IN_FULL)), results)
            except (RunError, InputError, OSError) as error:
                say(f"{name}: {error}")
                good = False
    return said.getvalue().splitlines(), good
