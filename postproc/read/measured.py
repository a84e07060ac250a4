"""Measured traces and quoted values of a scene, read from files and texts in SI units.

The files are tables of numbers as oscilloscopes and spreadsheets write them. The headings are the last line of text
above the rows of numbers, or the line above it if it holds units. The separator is the one with which most cells are
numbers. Empty lines and lines that begin with ``#`` are left out.
"""

import csv
import io
import re
from collections.abc import Collection, Iterable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cache
from itertools import groupby, zip_longest
from math import isfinite, nan
from pathlib import Path

import numpy as np

from drivers.base import paths
from drivers.base.errors import InputError
from drivers.base.files import read_file
from drivers.base.messages import near, shorten
from drivers.base.units import to_si
from drivers.chain.chain import Array
from drivers.scene.model import MeasuredEntry, Scene
from postproc.read.observables import PLACEHOLDERS, describe, without_unit

MEASURED = "measured"  # table of entries measured.0, measured.1, ...
TIME, FORCE = "s", "N"
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
csv.field_size_limit(2**31 - 1)  # after a quotation mark without another one the rest of a file is one cell
READINGS = {unit: quantity for unit, quantity in UNITS.items() if unit != TIME}
TIMES = ("time", "t", "x", "x-axis", "x_value", "second", "seconds", "sec", "s", "ms", "us", "µs", "ns")
MIN_SAMPLES = 16
NORMAL = 1.4826  # ratio of standard to median deviation for normal noise
PULSE_MARGIN = 3.0  # standard deviations above the expected maximum of noise alone

Row = tuple[int, list[str]]  # line, cells


@dataclass(frozen=True, eq=False)
class Column:
    """A column of a file.

    Attributes:
        file: File as messages name it; ``line``: line of its headings.
        heading: Heading; ``name``: heading without the unit; ``unit``: unit in the heading or below, empty if none.
        cells: Cells by line, empty where a row ends before; ``decimal``: decimal mark in them.
    """

    file: str
    line: int
    heading: str
    name: str
    unit: str
    cells: Mapping[int, str]
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
        allowed = "a row of headings above them, without #"
        raise InputError(shown, f"line {block[0][0]}", "numbers without headings", allowed)
    (line, headings), (last, units) = above[0], (*above, (above[0][0], []))[1]
    decimal = _decimal(block, separator, shown)
    rows = {place: row for place, row in _rows(text, separator) if place > last}
    if longer := next((place for place, row in rows.items() if len(row) > len(headings)), 0):
        hint = "; decimal commas need semicolons between cells" * (separator == ",")
        allowed = f"{len(headings)}, as many as headings in line {line}{hint}"
        raise InputError(shown, f"line {longer}", f"more than {len(headings)} cells", allowed)
    columns = []
    for index, (heading, below) in enumerate(zip_longest(headings, units, fillvalue="")):
        cells = {place: row[index] if index < len(row) else "" for place, row in rows.items()}
        columns.append(Column(shown, line, heading, *_name_and_unit(heading, below), cells, decimal))
    return columns


def numbers_of(column: Column) -> Array:
    """Finite numbers of a column. Shape (rows,).

    Raises:
        InputError: A cell is empty or no finite number.
    """
    marks = str.maketrans({"_": "x"} if column.decimal == "." else {"_": "x", ".": "x", ",": "."})
    numbers = list[float]()
    for line, cell in column.cells.items():
        try:
            number = float(cell.translate(marks))
        except ValueError:
            number = nan
        if not isfinite(number):
            separated = f', decimals with "{column.decimal}", no thousands separators, quotation marks in pairs'
            allowed = "a finite number" + separated * bool(re.search(r"\d[.,'’\s]\d", cell))
            raise InputError(column.file, f"line {line}, {column.heading}", shorten(cell), allowed)
        numbers.append(number)
    return np.array(numbers)


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
    """Lines that are not empty, by number, without empty cells at the end."""
    if separator == " ":  # no separator before the unit of a heading
        text = re.sub(r"(?<=\w) +(?=[\[(])", "", text)
    reader = csv.reader(io.StringIO(text), delimiter=separator, skipinitialspace=True)
    end = 0
    for row in reader:
        line, end = end + 1, reader.line_num
        cells = [cell.strip() for cell in row]
        while cells and not cells[-1]:
            cells.pop()
        if cells:
            yield line, cells


def _fit(rows: list[Row]) -> tuple[float, list[Row], list[Row]]:
    """Share of numbers among the cells of the first block of numbers; the rows of headings and units; the block."""
    counts = [sum(bool(NUMBER.fullmatch(cell)) for cell in cells) for _, cells in rows]
    runs = [list(run) for numeric, run in groupby(range(len(rows)), lambda place: counts[place] > 0) if numeric]
    sizes = [min(BLOCK, sum(counts[place] > 1 for place in run)) for run in runs]
    if not any(sizes):
        return 0.0, [], []
    run = runs[sizes.index(max(sizes))]
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


@dataclass(frozen=True, eq=False)
class MeasuredTrace:
    """One ``[[measured]]`` entry with its file.

    Attributes:
        file: File that was read.
        time_s: Times of the file, increasing, not always equally spaced. Shape (samples,).
        reading: Readings by gauge, in SI units (V, N), with baseline and without gain. Each of shape (samples,).
        gain: Newtons per unit of reading; ``gain_uncertainty``: relative standard error of the gain.
        trigger_s: Time in the file at which the striker meets the chain; None: found from the trace.
        baseline: Reading at rest; None: found from the trace; ``drift``: True if the baseline is a straight line.
        noise: Standard deviation of a reading; None: found from the trace.
        unit: Unit of the readings.
        key: Key of the entry in the scene, such as ``measured.0``.
    """

    file: Path
    time_s: Array
    reading: Mapping[str, Array]
    gain: float = 1.0
    gain_uncertainty: float = 0.0
    trigger_s: float | None = None
    baseline: float | None = None
    drift: bool = False
    noise: float | None = None
    unit: str = FORCE
    key: str = f"{MEASURED}.0"


def entries_of(scene: Scene | None, file: Path | None, source: str) -> tuple[dict[str, MeasuredEntry], Path, str]:
    """``[[measured]]`` entries by key, the folder to which their paths are relative, and their name in messages.

    If a file is given, the entries of the scene for this file; if there are none, an entry for the file alone.

    Args:
        scene: Scene as its file is now; None if the file is gone.
        file: Measured file that replaces those of the scene.
        source: Scene or run as messages name it.

    Raises:
        InputError: There is no measured data.
    """
    kept = {f"{MEASURED}.{place}": entry for place, entry in enumerate(scene.measured)} if scene else {}
    if scene and file:
        asked = file.resolve()
        kept = {key: each for key, each in kept.items() if each.file and (scene.folder / each.file).resolve() == asked}
    if scene and kept:
        return kept, scene.folder, scene.file
    if file is None:
        found = "no measured data: add a [[measured]] table to the scene file, or give --measured FILE.csv"
        raise InputError(source, "measured", found)
    return {f"{MEASURED}.0": MeasuredEntry(file=str(file))}, Path(), f"--measured {paths.shown(file)}"


def read_measured(entry: MeasuredEntry, folder: Path, gauges: Collection[str], where: str, key: str) -> MeasuredTrace:
    """The trace of an entry that names a file.

    Args:
        entry: Entry of the scene.
        folder: Folder to which the path of the file is relative.
        gauges: Gauges of the scene (``postproc.read.signals.gauges_of``).
        where: Scene as messages name it.
        key: Key of the entry in the scene, such as ``measured.0``.

    Raises:
        InputError: The file is missing or not a table of numbers, a column or unit is missing or wrong, times do not
            increase, there are fewer than ``MIN_SAMPLES`` samples, or a gauge shows no pulse.
    """
    assert entry.file is not None  # checked by the rules of the scene
    path = folder / entry.file
    if not path.exists():
        found, allowed = f"no such file: {paths.shown(path)}", f"a CSV file, relative to {paths.shown(folder)}"
        raise InputError(where, f"{key}.file", found, allowed)
    columns = read_scope_file(path)
    time = _time(columns, entry, where, f"{key}.time")
    chosen = _gauge_columns(columns, entry, gauges, where, f"{key}.gauges")
    scale, _ = _unit(time, entry.time_unit, {TIME: "time"}, where, f"{key}.time_unit")
    kinds = {gauge: _unit(column, entry.unit, READINGS, where, f"{key}.unit") for gauge, column in chosen.items()}
    unit, *others = sorted({unit for _, unit in kinds.values()})
    if others:
        found = f"readings in {' and '.join([unit, *others])}"
        raise InputError(where, f"{key}.gauges", found, "gauges of one unit; use a [[measured]] table per unit")
    time_s = numbers_of(time) * scale
    reading = {gauge: numbers_of(column) * kinds[gauge][0] for gauge, column in chosen.items()}
    if len(time_s) < MIN_SAMPLES:
        raise InputError(paths.shown(path), "", f"{len(time_s)} samples", f"at least {MIN_SAMPLES}")
    back = np.flatnonzero(np.diff(time_s) <= 0)
    if back.size:
        (_, before), (line, after) = list(time.cells.items())[back[0] : back[0] + 2]
        raise InputError(time.file, f"line {line}, {time.heading}", f"{after} after {before}", "times that increase")
    gain = _gain(entry, unit, where, f"{key}.gain")
    noise = None if entry.noise is None else _number(entry.noise, unit, where, f"{key}.noise")
    if noise is not None and noise <= 0:
        raise InputError(where, f"{key}.noise", shorten(entry.noise), "a standard deviation above 0")
    for gauge, values in reading.items():
        _must_show_pulse(chosen[gauge], values * np.sign(gain), noise)
    return MeasuredTrace(
        file=path,
        time_s=time_s,
        reading=reading,
        gain=gain,
        gain_uncertainty=entry.gain_uncertainty,
        trigger_s=entry.trigger,
        baseline=None if entry.baseline is None else _number(entry.baseline, unit, where, f"{key}.baseline"),
        drift=entry.drift,
        noise=noise,
        unit=unit,
        key=key,
    )


def read_traces(scene: Scene, gauges: Collection[str]) -> list[MeasuredTrace]:
    """Traces of all entries of a scene that name a file; raises as ``read_measured`` does."""
    entries = [(f"measured.{place}", entry) for place, entry in enumerate(scene.measured) if entry.file]
    return [read_measured(entry, scene.folder, gauges, scene.file, key) for key, entry in entries]


def read_quoted(entry: MeasuredEntry, names: Iterable[str], where: str, key: str) -> dict[str, tuple[float, float]]:
    """Quoted values of an entry, in SI units with their relative standard errors, by observable as in ``names``.

    Args:
        entry: Entry of the scene.
        names: Observables of the scene's runs with their units, as ``observe`` returns them.
        where: Scene as messages name it.
        key: Key of the entry in the scene, such as ``measured.0``.

    Raises:
        InputError: An observable is unknown or named twice, or a unit is missing or wrong.
    """
    known, quoted = {without_unit(name): name for name in names}, dict[str, tuple[float, float]]()
    for stated, value in (entry.values or {}).items():
        place, name = f"{key}.values.{stated}", known.get(without_unit(stated))
        if name is None:
            raise InputError(where, place, "an unknown observable", _listed(known, without_unit(stated)))
        if name in quoted:
            raise InputError(where, place, f"{without_unit(name)} twice", "each observable once")
        unit = describe(name).unit
        number = _number(value, "" if unit in ("share", "diameters") else unit, where, place)
        if number == 0:
            raise InputError(where, place, shorten(value), "a value other than 0, since its error is relative")
        quoted[name] = number, (entry.errors or {})[stated]
    return quoted


def _listed(known: Collection[str], name: str) -> str:
    """Known names, with the one that is nearly this name."""
    return ", ".join(known) + (f" ({meant})" if (meant := near(name, known)) else "")


def _column(columns: list[Column], name: str, where: str, key: str) -> Column:
    """The column with this heading, given with or without its unit."""
    matching = [column for column in columns if column.heading == name] or [c for c in columns if c.name == name]
    if len(matching) != 1:
        headings = _listed([column.heading for column in columns], "" if matching else name)
        problem = f'{"more than one" if matching else "no"} column "{name}" in {columns[0].file}'
        raise InputError(where, key, problem, f"a heading in line {columns[0].line} that is there once: {headings}")
    return matching[0]


def _no_column(columns: list[Column], allowed: str, where: str, key: str) -> InputError:
    headings = ", ".join(column.heading for column in columns)
    return InputError(where, key, f"headings {headings} in line {columns[0].line} of {columns[0].file}", allowed)


def _time(columns: list[Column], entry: MeasuredEntry, where: str, key: str) -> Column:
    """The column of time: that of the entry, or one with a usual name, or the first if its unit is one of time."""
    named = [column for column in columns if column.name.lower() in TIMES]
    candidates = named if len(named) == 1 else [each for each in named or columns[:1] if unit_of(each.unit)[1] == TIME]
    if entry.time is not None:
        candidates = [_column(columns, entry.time, where, key)]
    elif len(candidates) != 1:
        allowed = f'one column "time"; or in [[measured]], such as time = "{(candidates or columns)[0].heading}"'
        raise _no_column(columns, allowed, where, key)
    (time,) = candidates
    return replace(time, unit=time.unit or time.name * (unit_of(time.name)[1] == TIME))


def _gauge_columns(
    columns: list[Column], entry: MeasuredEntry, gauges: Collection[str], where: str, key: str
) -> dict[str, Column]:
    """The column of each measured gauge."""
    chosen = entry.gauges or {c.name: c.name for c in columns if re.fullmatch(PLACEHOLDERS["gauge"], c.name)}
    for gauge, name in chosen.items():
        if gauge not in gauges:
            allowed = _listed(gauges, gauge) or "none: the scene has no gauges"
            raise InputError(where, f"{key}.{gauge}", f'an unknown gauge for "{name}" in {columns[0].file}', allowed)
    if not chosen:
        example = f'gauges = {{ {next(iter(gauges), "wall")} = "{columns[1].heading}" }}'
        allowed = f"the gauges {', '.join(gauges)}; or in [[measured]], such as {example}"
        raise _no_column(columns, allowed, where, key)
    return {gauge: _column(columns, name, where, f"{key}.{gauge}") for gauge, name in chosen.items()}


def _unit(column: Column, stated: str | None, allowed: Mapping[str, str], where: str, key: str) -> tuple[float, str]:
    """Factor from the unit of a column to the SI unit, and the SI unit; the file or the entry gives the unit.

    Raises:
        InputError: The unit is missing or belongs to another quantity, or file and entry differ.
    """
    texts = [text for text in (column.unit, stated) if text]
    words, name = " or ".join(allowed.values()), f'"{column.heading}" in {column.file}'
    if not texts:
        example = f'{key.rpartition(".")[2]} = "{"us" if TIME in allowed else "mV"}" or another unit of {words}'
        raise InputError(where, key, f"missing key: {name} has no unit; write in [[measured]], such as {example}")
    for text in texts:
        if unit_of(text)[1] not in allowed:
            raise InputError(where, key, f'the unit "{text}" for {name}', f"a unit of {words}")
    if len({unit_of(text) for text in texts}) > 1:
        raise InputError(where, key, f"the units {' and '.join(texts)} for {name}", "one unit")
    return unit_of(texts[0])


def _gain(entry: MeasuredEntry, unit: str, where: str, key: str) -> float:
    """Newtons per SI unit of the readings."""
    plain, stated = unit == FORCE, 1.0 if entry.gain is None else entry.gain
    if entry.gain is None and not plain:
        example = f'such as gain = "2.1 N/{unit}" or "0.5 {unit}/N"'
        raise InputError(where, key, f"missing key: readings in {unit} need a gain in [[measured]], {example}")
    if not plain and re.search(r"/ *\w*N$", str(stated).rstrip()):  # as data sheets of gauges give it
        with suppress(ValueError, ZeroDivisionError):
            return 1 / to_si(str(stated), f"{unit}/N")
    gain = _number(stated, "" if plain else f"N/{unit}", where, key)
    if gain == 0:
        raise InputError(where, key, "0", "a gain other than 0; a negative gain inverts the trace")
    return gain


def _number(stated: str | float, unit: str, where: str, key: str) -> float:
    """A stated value in an SI unit, or a plain number."""
    if not unit and not isinstance(stated, str):
        return float(stated)
    if unit and isinstance(stated, str):
        with suppress(ValueError):
            return to_si(stated, unit)
    unit = unit.replace("1/", "") + "^-1" * unit.startswith("1/")  # texts of units begin with a letter
    allowed = f'a number in {unit}, such as "2 {unit}"' if unit else "a plain number"
    raise InputError(where, key, shorten(stated), allowed)


def _must_show_pulse(column: Column, values: Array, noise: float | None) -> None:
    """Refuses readings without a maximum above the noise.

    If no noise is given, it is estimated from second differences, which remove slow changes.
    """
    risen = values - np.median(values)
    differences = np.abs(np.diff(values, 2))
    deviation = NORMAL * float(np.median(differences)) / np.sqrt(6) if noise is None else noise
    limit = (np.sqrt(2 * np.log(len(values))) + PULSE_MARGIN) * deviation
    if not risen.max() > limit:
        found = "a constant" if not np.ptp(values) else "no pulse: nothing rises above noise"
        inverted = "; a gain of the other sign inverts the trace" * bool(-risen.min() > limit)
        raise InputError(column.file, column.heading, found, f"readings with a pulse{inverted}")
