"""Chapters of the report: each measures, writes tables and figures, states its findings, and has a section in the page.

The chapter of the folder ``validation/<name>`` is ``CHAPTER`` in its module ``<name>_chapter``. A table holds the rows
of a frozen dataclass with fields of ``str``, ``int``, ``float`` or ``bool``. It is written as CSV for people, and
stored with the figures for the page, which reads it back bit for bit.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, redirect_stderr
from dataclasses import dataclass, fields
from importlib import import_module
from io import StringIO
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import pandas as pd

from drivers.base import paths
from drivers.base.cache import content_of, load, store
from drivers.base.errors import InputError, RunError
from drivers.base.files import sha256_of, whole_file
from drivers.base.terminal import counted, say
from drivers.engines import entry_files, installed_codes, missing_codes
from postproc.draw.product import write_figure, write_product
from postproc.figures import captions, make_figure
from validation.checks import FAIL, Check, table
from validation.report.page_figures import part_file, read_part, refused_if_damaged, write_part

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

Row = TypeVar("Row", bound="DataclassInstance")
CHAPTERS = ("claims", "calibration", "trade", "stability", "elements")
QUICK_CHAPTERS = CHAPTERS[1:]  # chapters whose short form is enough for the page
Tables = Mapping[str, pd.DataFrame]
Picture = tuple[str, Callable[[], Any] | None]  # heading in the report, and the function that draws the figure


def frame_of(kind: type[Row], rows: Iterable[Row]) -> pd.DataFrame:
    """Rows as a table with one column per field, also if there are no rows."""
    rows = list(rows)
    return _typed(
        pd.DataFrame({field.name: [getattr(row, field.name) for row in rows] for field in fields(kind)}), kind
    )


def _typed(table: pd.DataFrame, kind: type["DataclassInstance"]) -> pd.DataFrame:
    """Columns of the fields of a dataclass, with their types; LookupError if one is missing."""
    types = {field.name: field.type for field in fields(kind)}
    return table[[*types]].astype(types)


def write_table(path: Path, kind: type[Row], rows: Iterable[Row]) -> None:
    """Writes rows as CSV, atomically."""
    _write_csv(path, frame_of(kind, rows))


def _write_csv(path: Path, table: pd.DataFrame) -> None:
    with whole_file(path) as draft:
        table.to_csv(draft, index=False)


def rows_in(table: pd.DataFrame, kind: type[Row]) -> list[Row]:
    """Rows of a table, equal to the rows that it was made of."""
    names = [field.name for field in fields(kind)]
    return [kind(**{name: record[name] for name in names}) for record in table.to_dict("records")]


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


@dataclass(frozen=True)
class Chapter:
    """A chapter, from its runs to its section of the report; tables and figures have the names of their files.

    Attributes:
        title: subject of the chapter in a few words, for progress lines.
        tables: dataclass of the rows of each table; the section exists if the first table does.
        measure: runs everything; returns rows by table, and figures that cannot be drawn from the tables.
        sentences: findings, computed from the tables.
        section: values for the report's template, in addition to sentences and figures.
        figures: heading of each figure and the function that draws it, by name; None if ``measure`` returns the figure.
        judge: checks computed from the tables, besides the checks that tables hold.
        optional: tables that the short form does not write.
    """

    name: str
    title: str
    tables: Mapping[str, type]
    measure: Callable[[Options], Mapping[str, Any]]
    sentences: Callable[[Tables], Sequence[str]]
    section: Callable[[Tables], Mapping[str, Any]]
    figures: Callable[[Tables], Mapping[str, Picture]] = lambda tables: {}
    judge: Callable[[Tables], Iterable[Check]] = lambda tables: ()
    optional: frozenset[str] = frozenset()

    @property
    def main_table(self) -> str:
        """Name of the first table."""
        return next(iter(self.tables))

    def read(self, results: Path) -> Tables:
        """Stored tables, with the types of their fields; none if the chapter has not been made.

        Raises:
            InputError: they are damaged, or of another version.
        """
        stored, _ = read_part(self.name, results)
        with refused_if_damaged(part_file(self.name, results), f"make {self.name}"):
            wanted = {name: kind for name, kind in self.tables.items() if name in stored or name not in self.optional}
            return {name: _typed(stored[name], kind) for name, kind in wanted.items()} if stored else {}

    def failed(self, tables: Tables) -> list[Check]:
        """Failed checks of the chapter."""
        held = (rows_in(tables[name], Check) for name, kind in self.tables.items() if kind is Check)
        return [check for check in (*chain.from_iterable(held), *self.judge(tables)) if check.verdict == FAIL]


def load_chapter(name: str) -> Chapter:
    """Chapter of a folder of this package."""
    chapter = import_module(f"validation.{name}.{name}_chapter").CHAPTER
    assert isinstance(chapter, Chapter)
    return chapter


def run_chapter(chapter: Chapter, options: Options) -> int:
    """Measures, writes tables and figures, prints findings and failed checks; the exit code is 1 if a check fails."""
    with counted(named(chapter.title, options)):
        tables = write_chapter(chapter, chapter.measure(options), options.results)
    for line in chapter.sentences(tables):
        print(line)
    print(f"{paths.shown(options.results / chapter.main_table)}.csv: {len(tables[chapter.main_table])} rows")
    failed = chapter.failed(tables)
    for line in table(failed) if failed else ():
        say(line)
    if missing_codes():
        say(f"not installed, and left out: {', '.join(missing_codes())}")
    return 1 if failed else 0


@contextmanager
def left_out_if_failed(what: str) -> Iterator[None]:
    """Reports a failed run and continues the chapter without its row."""
    try:
        yield
    except RunError as error:
        say(f"{what} is left out: {error}")


def named(what: str, options: Options) -> str:
    """Name of a step for progress lines."""
    return f"{what}, short study" if options.quick else what


def up_to_date(name: str, results: Path) -> bool:
    """True if a chapter or figure was stored since the last change of a source or of the engines."""
    return part_file(name, results).exists() and load(_key_of(name, results)) is not None


def _key_of(name: str, results: Path) -> list[str]:
    return ["made", name, sha256_of(part_file(name, results)), content_of(entry_files()), *installed_codes()]


def write_chapter(chapter: Chapter, measured: Mapping[str, Any], results: Path) -> Tables:
    """Writes figures and tables, deletes those of earlier runs that are no longer made, and returns the tables.

    The page shows the chapter as it was stored last, which is done at the end.
    """
    tables = {name: frame_of(kind, measured[name]) for name, kind in chapter.tables.items() if name in measured}
    results.mkdir(parents=True, exist_ok=True)
    pictures, written = chapter.figures(tables), list[Path]()
    for name, (_, draw) in pictures.items():
        written += write_figure(draw() if draw else measured[name], name, results)
    for name, frame in tables.items():
        _write_csv(results / f"{name}.csv", frame)
    former = (results / f"{name}.csv" for name in chapter.tables if name not in tables)
    drawn = (*results.glob(f"{chapter.name}-*.svg"), *results.glob(f"{chapter.name}-*.png"))
    for path in (*former, *(path for path in drawn if path.stem not in pictures)):
        path.unlink(missing_ok=True)
    write_part(chapter.name, results, tables, written)
    store(_key_of(chapter.name, results), True)
    return tables


def write_paper_figure(name: str, runs: Path, results: Path) -> list[Path]:
    """Makes a figure of the paper with its runs, and returns the written files."""
    product = make_figure(name, runs)
    written = write_product(product, name, results)
    write_part(name, results, {name: product.table}, written)
    store(_key_of(name, results), True)
    return written


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
                    chapter, options = load_chapter(name), Options(results, runs, quick=name in QUICK_CHAPTERS)
                    write_chapter(chapter, chapter.measure(options), results)
            except (RunError, InputError, OSError) as error:
                say(f"{name}: {error}")
                good = False
    return said.getvalue().splitlines(), good


def read_section(name: str, results: Path) -> dict[str, Any]:
    """Values of a chapter's section in the report; empty if the chapter has not been made."""
    chapter = load_chapter(name)
    tables, (_, images) = chapter.read(results), read_part(name, results)
    if not tables:
        return {}
    with refused_if_damaged(part_file(name, results), f"make {name}"):
        figures = [(title, images[stem]) for stem, (title, _) in chapter.figures(tables).items() if stem in images]
        return {"sentences": list(chapter.sentences(tables)), "figures": figures, **chapter.section(tables)}
