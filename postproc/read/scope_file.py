"""Tables of numbers as oscilloscopes and spreadsheets write them: columns with heading, name and unit.

The headings are the last line of text above the rows of numbers, or the line above it if it holds units. The separator
is the one with which most cells are numbers. Empty lines and lines that begin with ``#`` are left out.
"""

import csv
import io
import re
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from itertools import groupby, zip_longest
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from drivers.base import paths
from drivers.base.errors import InputError
from drivers.base.files import read_file
from drivers.base.messages import shorten
from drivers.base.units import to_si
from drivers.chain.chain import Array

if TYPE_CHECKING:
    import pandas as pd

UNITS = {"s": "time", "N": "force", "V": "voltage", "A": "current", "C": "charge"}
ENDINGS = "|".join(prefix + unit for unit in UNITS for prefix in ("", *"kmuµμnp"))  # of headings such as time_us
HEADING = re.compile(rf"(.+?)\s*(?:[\[(]([^\[\]()]+)[\])]|(?:_|/\s*)({ENDINGS}))")
UNIT_WORD = re.compile("(?<!M)(?:volt|sec|second|newton|amp|ampere|coulomb)s?$", re.IGNORECASE)
BRACKETS = "[]() "
# with thousands separators, and words that are no finite numbers: to distinguish rows of numbers from text
NUMBER = re.compile(r"[+−-]?(?:\.?\d[\d.,'’\s]*(?<![,'’\s])(?:[ed][+-]?\d+)?|nan|inf(?:inity)?|∞)", re.IGNORECASE)
THOUSANDS = re.compile(r"[+-]?[1-9]\d{0,2}(?:[.,]\d{3})+")
SEPARATORS = "\t; ,"  # the first of those that fit equally well
HEAD = 1000  # lines from which separator, decimal mark and headings are found
BLOCK = 16  # rows of numbers, more than the title lines have

Row = tuple[int, list[str]]  # line, cells


@dataclass(frozen=True, eq=False)
class Column:
    """A column of a file.

    Attributes:
        file: File as messages name it; ``line``: line of its headings.
        heading: Heading; ``name``: heading without the unit; ``unit``: unit in the heading or below, empty if none.
        cells: Cells by line: numbers, or if some are no numbers text with ``decimal`` as decimal mark.
    """

    file: str
    line: int
    heading: str
    name: str
    unit: str
    cells: "pd.Series[Any]"
    decimal: str


@cache
def unit_of(text: str) -> tuple[float, str]:
    """Factor from a unit of time or of readings to the SI unit, and the SI unit; empty for any other text."""
    word = UNIT_WORD.sub(lambda match: match[0].lower(), text.strip(BRACKETS))
    for unit in sorted(UNITS, key=lambda unit: not word.endswith(unit)):  # pint is slow to find that units differ
        try:
            return to_si(f"1 {word}", unit), unit
        except ValueError:
            continue
    return 0.0, ""


def read_scope_file(path: Path) -> list[Column]:
    """Columns of a file.

    Raises:
        InputError: The file has no headings above rows of numbers, rows that are longer than the headings, or decimal
            marks that may be thousands separators.
    """
    text, shown = _text(path), paths.shown(path)
    head = "\n".join(text.split("\n", HEAD)[:HEAD])
    fits = [(*_fit(list(_rows(head, separator))), separator) for separator in SEPARATORS]
    _, above, block, separator = max(fits, key=lambda fit: (bool(fit[1]), fit[0]))
    if not block:
        found = f"no table of numbers in the first {HEAD} lines" if text.strip() else "an empty file"
        raise InputError(shown, "", found, "CSV text with numbers below a row of headings, not a workbook")
    if not above:
        raise InputError(
            shown, f"line {block[0][0]}", "numbers without headings", "a row of headings above them, without #"
        )
    (line, headings), (last, units) = above[0], (*above, (above[0][0], []))[1]
    decimal = _decimal(block, separator, shown)
    cells, longer = _cells(text, last, len(headings), separator, decimal)
    if longer:
        allowed = f"{len(headings)}, as many as headings in line {line}, and quotation marks in pairs"
        hint = "; decimal commas need semicolons between cells" * (separator == ",")
        raise InputError(shown, f"line {longer}", f"more than {len(headings)} cells", f"{allowed}{hint}")
    return [
        Column(shown, line, heading, *_name_and_unit(heading, below), cells[place], decimal)
        for place, (heading, below) in enumerate(zip_longest(headings, units, fillvalue=""))
    ]


def numbers_of(column: Column) -> Array:
    """Finite numbers of a column. Shape (rows,).

    Raises:
        InputError: A cell is empty or no finite number.
    """
    import pandas as pd

    cells = column.cells
    if cells.dtype.kind in "iuf":
        numbers = cells.to_numpy(float)
    else:
        points = {} if column.decimal == "." else {ord("."): "x", ord(","): "."}
        numbers = pd.to_numeric(cells.astype(str).str.translate(points), errors="coerce").to_numpy(float)
    finite = np.isfinite(numbers)
    if not finite.all():
        place = int(np.argmin(finite))
        cell = "" if pd.isna(cells.iloc[place]) else str(cells.iloc[place])
        marks = f', decimals with "{column.decimal}", no thousands separators' * bool(re.search(r"\d[.,'’\s]\d", cell))
        key = f"line {cells.index[place]}, {column.heading}"
        raise InputError(column.file, key, shorten(cell), f"a finite number{marks}")
    return numbers


def _text(path: Path) -> str:
    """Text of a file, with line feeds alone at the ends of lines and without comments."""
    data = read_file(path, "a CSV file")
    try:
        text = data.decode("utf-16" if data[:2] in (b"\xff\xfe", b"\xfe\xff") else "utf-8-sig")
    except UnicodeDecodeError:
        text = data.decode("latin-1")
    text = text.replace("\r\n", "\n").replace("\r", "\n")
    return re.sub(r"^[ \t]*#.*$", "", text, flags=re.MULTILINE) if "#" in text else text


def _rows(text: str, separator: str) -> Iterator[Row]:
    """Lines that are not empty, up to the first that is no CSV, without empty cells at the end."""
    if separator == " ":  # no separator before the unit of a heading
        text = re.sub(r"(?<=\w) +(?=[\[(])", "", text)
    reader = csv.reader(io.StringIO(text), delimiter=separator, skipinitialspace=True)
    try:
        for row in reader:
            cells = [" ".join(cell.split()) for cell in row]
            if any(cells):
                yield reader.line_num, cells[: max(place for place, cell in enumerate(cells, 1) if cell)]
    except csv.Error:
        return


def _fit(rows: list[Row]) -> tuple[float, list[Row], list[Row]]:
    """Share of numbers among the cells of the first block of numbers; the rows of headings and units; the block."""
    counts = [sum(bool(NUMBER.fullmatch(cell)) for cell in cells) for _, cells in rows]
    runs = [list(run) for _, run in groupby(range(len(rows)), lambda place: counts[place] > 0)]
    table = [any(counts[place] and len(rows[place][1]) > 1 for place in run) for run in runs]
    if not any(table):
        return 0.0, [], []
    weights = [(min(BLOCK, sum(counts[place] > 1 for place in run)), has) for run, has in zip(runs, table, strict=True)]
    run = runs[weights.index(max(weights))]
    share = sum(counts[place] for place in run) / sum(bool(cell) for place in run for cell in rows[place][1])
    above, block = rows[max(0, run[0] - 2) : run[0]], rows[run[0] : run[-1] + 1]
    if len(above) == 2 and not (len(above[0][1]) >= len(above[1][1]) and _are_units(above[1][1])):
        above = above[1:]
    if not above or len(above[0][1]) < 2:
        return share, [], block
    first = next(place for place, (_, cells) in enumerate(rows) if cells == above[0][1])  # headings may be repeated
    return share, rows[first : first + len(above)], rows[first + len(above) : run[-1] + 1]


def _are_units(cells: list[str]) -> bool:
    """True if most cells are units or in brackets, one of them a unit of time."""
    units = [unit_of(cell)[1] or cell[0] in BRACKETS for cell in cells if cell]
    return "s" in units and 2 * sum(map(bool, units)) > len(units)


def _cells(text: str, last: int, width: int, separator: str, decimal: str) -> tuple["pd.DataFrame", int]:
    """Cells below a line in as many columns as headings, by line; the line of the first longer row, or 0."""
    import pandas as pd

    below = text.split("\n", last)[-1]
    blank = next(re.finditer(r"(?:[ \t]*\n)*", below)).end()
    start, sep = last + 1 + below.count("\n", 0, blank), r"\s+" if separator == " " else separator
    try:
        first = pd.read_csv(io.StringIO(below[blank:]), sep=sep, header=None, nrows=1, skipinitialspace=True)
        cells = pd.read_csv(
            io.StringIO(below[blank:]),
            sep=sep,
            decimal=decimal,
            names=range(max(width, first.shape[1])),
            skipinitialspace=True,
            skip_blank_lines=False,  # the index counts lines
            keep_default_na=False,
            na_values=[""],
            low_memory=False,
        ).dropna(how="all")
    except pd.errors.ParserError as error:  # too many cells, or a quotation mark without its end
        place = re.search(r"in line (\d+)", str(error))
        return pd.DataFrame(), start - 1 + int(place[1] if place else 1)
    cells.index += start
    longer = cells.index[cells.iloc[:, width:].notna().any(axis=1)].tolist()
    return cells, longer[0] if longer else 0


def _name_and_unit(heading: str, below: str) -> tuple[str, str]:
    """Heading without its unit, and the unit in it or below it; two units of one kind make an unknown one."""
    match, below = HEADING.fullmatch(heading), below.strip(BRACKETS)
    name, stated = (match[1], match[2] or match[3]) if match else (heading, "")
    one, other = unit_of(stated if below else ""), unit_of(below)
    differ = one != other and one[1] == other[1]
    return name, f"{stated} and {below}" if differ else below or stated


def _decimal(block: list[Row], separator: str, shown: str) -> str:
    """Decimal mark of a block; refuses commas, and points with semicolons, that may separate thousands."""
    numbers = [(line, cell) for line, cells in block for cell in cells if NUMBER.fullmatch(cell)]
    points, commas = ([number for number in numbers if re.search(rf"\{mark}[^.,]*$", number[1])] for mark in ".,")
    decimal, marked = (",", commas) if commas and len(commas) >= len(points) else (".", points)
    if marked and (decimal == "," or separator == ";") and all(THOUSANDS.fullmatch(cell) for _, cell in marked):
        line, cell = marked[0]
        allowed = f"numbers without thousands separators, decimals not all of three digits, such as {cell}0"
        raise InputError(shown, f"line {line}", f'"{cell}", thousands or decimals', allowed)
    return decimal
