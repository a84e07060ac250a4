"""Tables of numbers as oscilloscopes and spreadsheets write them: columns with heading, name and unit.

The headings are the last line of text above the rows of numbers, or the line above it if it holds units. Separator and
decimal mark are those with which most cells are numbers. Empty lines and lines that begin with ``#`` are left out.
"""

import codecs
import csv
import io
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cache
from itertools import groupby, islice
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from drivers.base import paths
from drivers.base.errors import InputError
from drivers.base.messages import shorten
from drivers.base.units import to_si
from drivers.chain.chain import Array

if TYPE_CHECKING:
    import pandas as pd

UNITS = ("s", "N", "V", "A", "C")  # time and readings
ENDINGS = "|".join(prefix + unit for unit in UNITS for prefix in ("", *"kmuµμnp"))  # of headings such as time_us
HEADING = re.compile(rf"(.+?)\s*(?:[\[(]([^\[\]()]+)[\])]|(?:_|/\s*)({ENDINGS}))")
UNIT_WORD = re.compile("(?:volt|sec|second|newton|amp|ampere|coulomb)s?$", re.IGNORECASE)
BRACKETS = "[]() "
# with thousands separators and words that are no finite numbers, to tell rows of numbers from text
NUMBER = re.compile(r"[+−-]?(?:\.?\d[\d.,'’\s]*(?<![,'’\s])(?:[ed][+-]?\d+)?|nan|inf(?:inity)?|∞)", re.IGNORECASE)
THOUSANDS = re.compile(r"[+-]?[1-9]\d{0,2}(?:[.,]\d{3})+")
SEPARATORS = "\t; ,"  # the first of those that fit equally well
HEAD = 1000  # lines from which separator, decimal mark and headings are found
BLOCK = 16  # rows of numbers, more than those among the title lines
BINARY = re.compile("[\x00-\x08\x0e-\x1f]")

Row = tuple[int, list[str]]  # number of the line, cells


@dataclass(frozen=True)
class Column:
    """Heading of a column with its parts.

    Attributes:
        place: Number of the column, from 0.
        heading: Text in the file.
        name: Heading without the unit.
        unit: Unit in the heading or below it; empty if there is none.
    """

    place: int
    heading: str
    name: str
    unit: str


@dataclass(frozen=True, eq=False)
class ScopeFile:
    """A table in a file.

    Attributes:
        path: File that was read.
        line: Line of the headings.
        columns: All columns.
        cells: Cells below the headings, numbers where a column holds numbers alone.
        text: Text of the file, from which a message takes the line of a row.
        start: Last line above the rows.
        separator: Character between cells; ``decimal``: decimal mark.
    """

    path: Path
    line: int
    columns: tuple[Column, ...]
    cells: "pd.DataFrame"
    text: str
    start: int
    separator: str
    decimal: str


@cache
def unit_of(text: str) -> tuple[float, str] | None:
    """Factor from a unit of time or of readings to the SI unit, and the SI unit; None for any other text."""
    word = UNIT_WORD.sub(lambda match: match[0].lower(), text.strip(BRACKETS))
    for unit in UNITS:
        try:
            return to_si(f"1 {word}", unit), unit
        except ValueError:
            continue
    return None


def read_scope_file(path: Path) -> ScopeFile:
    """Columns of a file.

    Raises:
        InputError: The file is not text, has no headings above rows of numbers or rows of another length, or its
            decimal marks may be thousands separators.
    """
    import pandas as pd

    text, shown = _text(path), paths.shown(path)
    head = "\n".join(text.split("\n", HEAD)[:HEAD])
    choices = [_found(list(_rows(head, separator)), separator) for separator in SEPARATORS]
    _, separator, above, block = max(choices, key=lambda choice: choice[0])
    if not block:
        found = "no rows of two or more numbers" if text.strip() else "an empty file"
        raise InputError(
            shown, "", found, "a row of headings, and below it rows of numbers between commas or semicolons"
        )
    if not above:
        raise InputError(shown, f"line {block[0][0]}", "no headings above the numbers", "a row of headings, without #")
    (line, headings), (start, units) = above[0], above[-1]
    headings = _trimmed(headings)
    units = [*(units if len(above) > 1 else []), *[""] * len(headings)]
    columns = tuple(_column(place, *both) for place, both in enumerate(zip(headings, units, strict=False)))
    decimal = _decimal(block, separator, shown)
    below = text.split("\n", start)[start]
    settings = {"sep": r"\s+" if separator == " " else separator, "decimal": decimal, "skipinitialspace": True}
    blank = {"keep_default_na": False, "na_values": [""]}
    try:
        cells = pd.read_csv(io.StringIO(below), header=None, low_memory=False, **settings, **blank).dropna(how="all")
    except pd.errors.ParserError as error:
        _refuse_ragged(_below(text, separator, start), len(columns), line, separator, shown)
        raise InputError(shown, "", str(error), "rows with as many cells as headings") from error
    if len(block[0][1]) < len(columns) or cells.iloc[:, len(columns) :].notna().any(axis=None):
        _refuse_ragged(_below(text, separator, start), len(columns), line, separator, shown)
    return ScopeFile(path, line, columns, cells, text, start, separator, decimal)


def numbers_of(file: ScopeFile, column: Column) -> Array:
    """Finite numbers of a column. Shape (rows,).

    Raises:
        InputError: A cell is empty or no finite number.
    """
    import pandas as pd

    values = file.cells[column.place]
    if values.dtype.kind not in "iuf":
        texts = values.astype(str)
        if file.decimal == ",":
            texts = texts.str.replace(".", "x").str.replace(",", ".")
        values = pd.to_numeric(texts, errors="coerce")
    numbers = values.to_numpy(float)
    finite = np.isfinite(numbers)
    if not finite.all():
        line, cells = row_of(file, int(np.argmin(finite)))
        cell = shorten(cells[column.place]) if column.place < len(cells) else "no cell"
        marks = f', decimals with "{file.decimal}", no thousands separators' * bool(re.search(r"\d[.,'’\s]\d", cell))
        raise InputError(paths.shown(file.path), f"line {line}, {column.heading}", cell, f"a finite number{marks}")
    return numbers


def row_of(file: ScopeFile, row: int) -> Row:
    """Line number and cells of a row, counted from 0 below the headings."""
    return next(islice(_below(file.text, file.separator, file.start), row, None))


def _text(path: Path) -> str:
    """Text of a file with lines that end with ``\\n``, and with empty lines for comments."""
    try:
        data = path.read_bytes()
    except OSError as error:
        raise InputError(paths.shown(path), "", str(error), "a file that can be read") from error
    wide = data.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE))
    try:
        text = data.decode("utf-16" if wide else "utf-8-sig")
    except UnicodeDecodeError:
        text = data.decode("latin-1")
    if binary := BINARY.search(text):
        found = f"character 0x{ord(binary[0]):02x}, not text"
        raise InputError(paths.shown(path), "", found, "a CSV file; export a workbook or a binary waveform as CSV")
    text = text.replace("\r\n", "\n").replace("\r", "\n")
    return re.sub(r"^[ \t]*#.*$", "", text, flags=re.MULTILINE) if "#" in text else text


def _rows(text: str, separator: str) -> Iterator[Row]:
    """Lines that are not empty, up to the first that is no CSV."""
    lines = iter(io.StringIO(text))
    if separator == " ":  # no separator before the unit of a heading
        lines = (re.sub(r"(?<=\w) +(?=[\[(])", "", line) for line in lines)
    reader = csv.reader(lines, delimiter=separator, skipinitialspace=True)
    try:
        for cells in reader:
            if any(cell.strip() for cell in cells):
                yield reader.line_num, [" ".join(cell.split()) for cell in cells]
    except csv.Error:
        return


def _below(text: str, separator: str, start: int) -> Iterator[Row]:
    """Rows below a line."""
    return (row for row in _rows(text, separator) if row[0] > start)


def _trimmed(cells: list[str]) -> list[str]:
    """Cells without the empty ones at the end."""
    return cells[: max((place for place, cell in enumerate(cells, 1) if cell), default=0)]


def _found(rows: list[Row], separator: str) -> tuple[tuple[bool, float], str, list[Row], list[Row]]:
    """How well a separator fits; the separator, the rows of headings and units, and the first block of numbers."""
    counts = [sum(bool(NUMBER.fullmatch(cell)) for cell in cells) for _, cells in rows]
    runs = [list(run) for _, run in groupby(range(len(rows)), lambda place: counts[place] > 0)]
    weights = [min(BLOCK, sum(counts[place] > 1 for place in run)) for run in runs]
    if not any(weights):
        return (False, 0.0), separator, [], []
    run = runs[weights.index(max(weights))]
    first, last = run[0], run[-1]
    above, block = rows[max(0, first - 2) : first], rows[first : last + 1]
    if len(above) < 2 or len(above[0][1]) != len(above[1][1]) or not _are_units(above[1][1]):
        above = above[-1:]
    if above and len(_trimmed(above[0][1])) < 2:
        above = []
    share = sum(counts[first : last + 1]) / sum(bool(cell) for _, cells in block for cell in cells)
    return (bool(above), share), separator, above, block


def _are_units(cells: list[str]) -> bool:
    """True if all cells are in brackets, or most are units, one of them of time."""
    filled = [cell for cell in cells if cell]
    units = [unit for cell in filled if (unit := unit_of(cell))]
    in_brackets = all(cell[0] in BRACKETS and cell[-1] in BRACKETS for cell in filled)
    return in_brackets or (2 * len(units) > len(filled) and any(unit == UNITS[0] for _, unit in units))


def _column(place: int, heading: str, below: str) -> Column:
    """Column with a heading and a unit below it, or none; two units of one kind are one unknown unit."""
    match, below = HEADING.fullmatch(heading), below.strip(BRACKETS)
    name, own = (match[1], match[2] or match[3]) if match else (heading, "")
    if not below or below == own:
        return Column(place, heading, name, own)
    one, other = unit_of(own), unit_of(below)
    if one and other and one[1] == other[1]:
        return Column(place, heading, name, below if one == other else f"{own} and {below}")
    return Column(place, heading, name if match and match[2] else heading, below)


def _decimal(block: Sequence[Row], separator: str, shown: str) -> str:
    """Decimal mark of the numbers in some rows."""
    numbers = [(line, cell) for line, cells in block for cell in cells if NUMBER.fullmatch(cell)]
    marks = {mark: [(line, cell) for line, cell in numbers if mark in cell] for mark in ".,"}
    decimal = "," if marks[","] and not marks["."] else "."
    unclear = marks[decimal] if decimal == "," or separator == ";" else []
    if unclear and all(THOUSANDS.fullmatch(cell) for _, cell in unclear):
        line, cell = unclear[0]
        allowed = f"no thousands separators; decimals that are not all of three digits, such as {cell}0"
        raise InputError(shown, f"line {line}", f'"{cell}", thousands or decimals', allowed)
    return decimal


def _refuse_ragged(rows: Iterator[Row], width: int, headings: int, separator: str, shown: str) -> None:
    """Refuses the first row with more or fewer cells than headings."""
    for line, cells in rows:
        filled = len(_trimmed(cells))
        if filled > width or len(cells) < width:
            hint = "; decimal commas need semicolons between cells" * (separator == "," and filled > width)
            allowed = f"{width}, as many as headings in line {headings}{hint}"
            raise InputError(shown, f"line {line}", f"{filled} cells", allowed)
