"""Tables and sections of the studies: what each measures, says, draws and shows in the report, behind one command.

The study of the room ``validation/<name>`` is ``STUDY`` in its module ``<name>_study``. Its tables are rows of a
frozen dataclass as CSV, read back bit for bit with the types of its fields: ``str``, ``int``, ``float`` (NaN is an
empty cell) or ``bool``. A field annotated as a mapping has a column of numbers for each of its keys, in its place.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, fields
from importlib import import_module
from pathlib import Path
from typing import Any, TypeVar, get_origin

import pandas as pd

from drivers.base import paths
from drivers.base.errors import InputError
from drivers.base.files import whole_file
from drivers.base.progress import say, step
from drivers.engines import missing_codes
from drivers.engines._entries import entry_files
from postproc.draw.product import write_figure
from validation.report.page_figures import read_image, stored_or_drawn

Row = TypeVar("Row")
STUDIES = ("independent", "claims", "trade", "stability", "elements", "calibration")
ORDER_4, ADAPTIVE = "order 4", "adaptive"  # this repository's methods, beside the codes
DONE, FAILED, NOT_RUN = "done", "failed", "not run"  # what came of a run
MADE = {"__pycache__", "tests"}  # folders of which no table depends
Tables = Mapping[str, pd.DataFrame]


def frame_of(kind: type[Row], rows: Iterable[Row]) -> pd.DataFrame:
    """Rows as a table, a column for each field; the columns of ``kind`` where there are no rows."""
    rows = list(rows)
    columns: dict[str, list[Any]] = {}
    for field in fields(kind):  # type: ignore[arg-type]  # a dataclass, which its type does not say
        values = [getattr(row, field.name) for row in rows]
        if _is_mapping(field.type):
            columns |= {key: [each.get(key) for each in values] for key in dict.fromkeys(k for v in values for k in v)}
        else:
            columns[field.name] = values
    return pd.DataFrame(columns)


def write_table(path: Path, kind: type[Row], rows: Iterable[Row]) -> None:
    """Writes rows, whole or not at all."""
    write_frame(path, frame_of(kind, rows))


def write_frame(path: Path, table: pd.DataFrame) -> None:
    """Writes a table, whole or not at all."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with whole_file(path) as draft:
        table.to_csv(draft, index=False)


def read_table(path: Path, kind: type[Row], target: str) -> pd.DataFrame:
    """A table that ``make target`` wrote, by its fields' types; InputError where it is missing or damaged."""
    with refused_if_damaged(path, target):
        types: dict[str, Any] = dict.fromkeys(pd.read_csv(path, nrows=0).columns, float)
        types |= {field.name: field.type for field in fields(kind) if not _is_mapping(field.type)}  # type: ignore[arg-type]
        empty = {name: [""] for name, type_ in types.items() if type_ is float}
        table = pd.read_csv(path, dtype=types, keep_default_na=False, na_values=empty)
        missing = [name for name in types if name not in table.columns]
        if missing:
            raise ValueError(f"no column {missing[0]}")
        return table


def rows_in(table: pd.DataFrame, kind: type[Row]) -> list[Row]:
    """Rows of a table that ``read_table`` read, equal to those that were written."""
    mapped = next((field.name for field in fields(kind) if _is_mapping(field.type)), None)  # type: ignore[arg-type]
    names = {field.name for field in fields(kind)}  # type: ignore[arg-type]
    rows = []
    for record in table.to_dict("records"):
        values: dict[str, Any] = {str(key): value for key, value in record.items() if key in names}
        if mapped:
            values[mapped] = {key: value for key, value in record.items() if key not in names and pd.notna(value)}
        rows.append(kind(**values))
    return rows


@contextmanager
def refused_if_damaged(path: Path, target: str) -> Iterator[None]:
    """Turns what reading a table, or computing from it, stumbles over into an InputError with the make target."""
    allowed = f"the table that make {target} writes"
    try:
        yield
    except FileNotFoundError as error:
        raise InputError(paths.shown(path), "", "no such file", allowed) from error
    except (ValueError, LookupError, TypeError, AttributeError) as error:  # pandas' own errors are ValueErrors
        raise InputError(paths.shown(path), "", f"a damaged table ({error})", allowed) from error


def _is_mapping(annotation: Any) -> bool:
    return get_origin(annotation) in (dict, Mapping)


@dataclass(frozen=True)
class Options:
    """Options of the command; a study takes those that it names on the command line.

    Attributes:
        file: the independent cases.
        quick: the short study.
        budget_s: engine time of all runs; None is the study's own.
    """

    results: Path = paths.RESULTS
    runs: Path = paths.RUNS
    file: Path = paths.INDEPENDENT
    quick: bool = False
    budget_s: float | None = None


@dataclass(frozen=True)
class Picture:
    """Figure of a study, stored as SVG and PNG.

    Attributes:
        title: its heading in the report; empty where it is not shown there.
        draw: makes it from the tables; None where it takes more than they hold, and comes with what was measured.
        numbers: what is plotted, where it is stored beside the figure.
    """

    title: str
    draw: Callable[[], Any] | None
    numbers: pd.DataFrame | None = None


@dataclass(frozen=True)
class Study:
    """A study, from its runs to its section of the report; tables and figures are known by their files' stems.

    Attributes:
        title: what it measures, in a few words.
        tables: dataclass of each table's rows; the first table is the one that the section stands on.
        measure: runs everything; rows by table, and by their names the figures that take more than tables hold.
        sentences: what the tables say, computed from them.
        section: what the report's template takes beside sentences and figures.
        figures: pictures by name.
        missed: requirements that are not met, a line each.
        optional: tables that the short study leaves out.
    """

    name: str
    title: str
    tables: Mapping[str, type]
    measure: Callable[[Options], Mapping[str, Any]]
    sentences: Callable[[Tables], Sequence[str]]
    section: Callable[[Tables], Mapping[str, Any]]
    figures: Callable[[Tables], Mapping[str, Picture]] = lambda tables: {}
    missed: Callable[[Tables], Sequence[str]] = lambda tables: ()
    optional: frozenset[str] = frozenset()

    @property
    def main_table(self) -> str:
        """Name of the table that the section stands on."""
        return next(iter(self.tables))

    def read(self, results: Path) -> Tables:
        """Tables of a results folder; InputError where one is damaged, or missing and not optional."""
        there = [name for name in self.tables if name not in self.optional or (results / f"{name}.csv").exists()]
        return {name: read_table(results / f"{name}.csv", self.tables[name], self.name) for name in there}


def load_study(name: str) -> Study:
    """The study of a room."""
    study = import_module(f"validation.{name}.{name}_study").STUDY
    assert isinstance(study, Study)
    return study


def run_study(study: Study, options: Options) -> int:
    """Measures, writes tables and figures, says what they mean; the exit code is 1 where a requirement is missed."""
    with step(named(study.title, options)):
        tables = write_study(study, study.measure(options), options.results)
    for line in study.sentences(tables):
        print(line)
    print(f"{paths.shown(options.results / study.main_table)}.csv: {len(tables[study.main_table])} rows")
    missed = study.missed(tables)
    for line in missed:
        say(line)
    if missing_codes():
        say(f"without what is not installed: {', '.join(missing_codes())}")
    return 1 if missed else 0


def named(what: str, options: Options) -> str:
    """A step in words; those of a short study take other times."""
    return f"{what}, short study" if options.quick else what


def up_to_date(study: Study, results: Path) -> bool:
    """Whether the study's table is there, and newer than all that the project and its engines are made of."""
    table = results / f"{study.main_table}.csv"
    folders = (paths.ROOT / name for name in ("inputs", "templates", "drivers", "postproc", "validation"))
    sources = [file for folder in folders for file in folder.rglob("*.*") if not MADE & {*file.parts}]
    newest = max(file.stat().st_mtime for file in (*sources, *entry_files()))
    return table.exists() and table.stat().st_mtime > newest


def write_study(study: Study, measured: Mapping[str, Any], results: Path) -> Tables:
    """Writes tables and figures, removes those of a former study that this one has not, and returns the tables."""
    rows = {name: list(measured[name]) for name in study.tables if name in measured}
    for name, kind in study.tables.items():
        if name in rows:
            write_table(results / f"{name}.csv", kind, rows[name])
        else:
            (results / f"{name}.csv").unlink(missing_ok=True)
    tables = study.read(results)
    pictures = study.figures(tables)
    for name, picture in pictures.items():
        write_figure(picture.draw() if picture.draw else measured[name], name, results)
        if picture.numbers is not None:
            write_frame(results / f"{name}.csv", picture.numbers)
    for path in (*results.glob(f"{study.name}-*.svg"), *results.glob(f"{study.name}-*.png")):
        if path.stem not in pictures:
            path.unlink()
    return tables


def read_section(name: str, results: Path) -> dict[str, Any]:
    """Sentences, figures and rows of a study as the report shows them; empty without its tables."""
    study = load_study(name)
    main = results / f"{study.main_table}.csv"
    if not main.exists():
        return {}
    tables = study.read(results)
    with refused_if_damaged(main, name):
        figures = []
        for stem, picture in study.figures(tables).items():
            stored = results / f"{stem}.svg"
            image = stored_or_drawn(stored, main, picture.draw) if picture.draw else read_image(stored)
            if picture.title and image:
                figures.append((picture.title, image))
        return {"sentences": list(study.sentences(tables)), "figures": figures, **study.section(tables)}
