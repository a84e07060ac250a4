"""Chapters of the report: each measures, writes tables and figures, states its findings, and has a section in the page.

The chapter of the folder ``validation/<name>`` is ``CHAPTER`` in its module ``<name>_chapter``. A table holds the rows
of a frozen dataclass as CSV, read back bit for bit with the types of the fields: ``str``, ``int``, ``float`` (NaN is an
empty cell) or ``bool``.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, fields
from importlib import import_module
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import pandas as pd

from drivers.base import paths
from drivers.base.errors import RunError
from drivers.base.files import csv_of, read_sealed_file, remove_sealed_file, sealed_file, sha256_of, table_in
from drivers.base.kept import content_of, keep, recall
from drivers.base.progress import counted, say
from drivers.engines import installed_codes, missing_codes
from drivers.engines._entries import entry_files
from postproc.draw.product import write_figure, write_product
from postproc.figures import make_figure
from validation.checks import FAIL, Check, table
from validation.report.page_figures import read_image, refused_if_damaged

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

Row = TypeVar("Row", bound="DataclassInstance")
CHAPTERS = ("claims", "calibration", "trade", "stability", "elements")
Tables = Mapping[str, pd.DataFrame]
Picture = tuple[str, Callable[[], Any] | None]  # heading in the report, and the function that draws the figure


def frame_of(kind: type[Row], rows: Iterable[Row]) -> pd.DataFrame:
    """Rows as a table with one column per field, also if there are no rows."""
    rows, types = list(rows), {field.name: field.type for field in fields(kind)}
    return pd.DataFrame({name: [getattr(row, name) for row in rows] for name in types}).astype(types)


def write_table(path: Path, kind: type[Row], rows: Iterable[Row]) -> None:
    """Writes rows as CSV, atomically."""
    write_frame(path, frame_of(kind, rows))


def write_frame(path: Path, table: pd.DataFrame) -> None:
    """Writes a table as CSV, atomically."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with sealed_file(path) as draft:
        draft.write_bytes(csv_of(table))


def read_table(path: Path, kind: type[Row], target: str) -> pd.DataFrame:
    """Table written by ``make target``, with the types of its fields; InputError if it is missing or damaged."""
    with refused_if_damaged(path, target):
        content = read_sealed_file(path, f"the table that make {target} writes")
        types = {field.name: field.type for field in fields(kind)}
        empty = {name: [""] for name, type_ in types.items() if type_ is float}
        table = table_in(content, dtype=types, keep_default_na=False, na_values=empty)
        missing = [name for name in types if name not in table.columns]
        if missing:
            raise ValueError(f"no column {missing[0]}")
        return table


def rows_in(table: pd.DataFrame, kind: type[Row]) -> list[Row]:
    """Rows of a table from ``read_table``, equal to the rows that were written."""
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
        """Tables of a results folder; InputError if one is damaged, or missing without being optional."""
        there = [name for name in self.tables if name not in self.optional or (results / f"{name}.csv").exists()]
        return {name: read_table(results / f"{name}.csv", self.tables[name], self.name) for name in there}

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


def up_to_date(main_table: Path) -> bool:
    """True if the table of a chapter or figure was written since the last change of a source or of the engines."""
    return main_table.exists() and recall(_key_of(main_table)) is not None


def _key_of(main_table: Path) -> list[str]:
    return ["made", main_table.stem, sha256_of(main_table), content_of(entry_files()), *installed_codes()]


def write_chapter(chapter: Chapter, measured: Mapping[str, Any], results: Path) -> Tables:
    """Writes figures and tables, deletes files of earlier runs that are no longer made, and returns the tables.

    The main table is deleted first and written last: without it the chapter is not made.
    """
    tables = {name: frame_of(kind, measured[name]) for name, kind in chapter.tables.items() if name in measured}
    for name in chapter.tables:
        if name == chapter.main_table or name not in tables:
            remove_sealed_file(results / f"{name}.csv")
    results.mkdir(parents=True, exist_ok=True)
    pictures = chapter.figures(tables)
    for name, (_, draw) in pictures.items():
        write_figure(draw() if draw else measured[name], name, results)
    for path in (*results.glob(f"{chapter.name}-*.svg"), *results.glob(f"{chapter.name}-*.png")):
        if path.stem not in pictures:
            remove_sealed_file(path)
    for name, frame in reversed(tables.items()):
        write_frame(results / f"{name}.csv", frame)
    keep(_key_of(results / f"{chapter.main_table}.csv"), True)
    return tables


def write_paper_figure(name: str, runs: Path, results: Path) -> list[Path]:
    """Makes a figure of the paper with its runs, and returns the written files."""
    written = write_product(make_figure(name, runs), name, results)
    keep(_key_of(written[0]), True)
    return written


def read_section(name: str, results: Path) -> dict[str, Any]:
    """Values of a chapter's section in the report; empty if the chapter has no tables yet."""
    chapter = load_chapter(name)
    main = results / f"{chapter.main_table}.csv"
    if not main.exists():
        return {}
    tables = chapter.read(results)
    with refused_if_damaged(main, name):
        drawn = chapter.figures(tables).items()
        images = [(title, read_image(results / f"{stem}.svg", name)) for stem, (title, _) in drawn]
        figures = [(title, image) for title, image in images if image]
        return {"sentences": list(chapter.sentences(tables)), "figures": figures, **chapter.section(tables)}
