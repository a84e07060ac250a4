"""Measured traces and quoted values of a scene, read from files and texts in SI units."""

import csv
import re
from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass
from difflib import get_close_matches
from pathlib import Path

import numpy as np

from drivers.base import paths
from drivers.base.errors import InputError
from drivers.base.messages import shorten
from drivers.base.units import to_si
from drivers.batch.axes import HEADING
from drivers.chain.chain import Array
from drivers.scene.model import MeasuredEntry, Scene
from postproc.read.observables import PLACEHOLDERS, describe, without_unit

MEASURED = "measured"  # key of a file's entry without a [[measured]] table; otherwise measured.0, measured.1, ...
TIME, FORCE = "s", "N"
READINGS = {FORCE: "force", "V": "voltage", "A": "current", "C": "charge"}
ENDINGS = {prefix + unit for unit in (TIME, *READINGS) for prefix in ("", "k", "m", "u", "µ", "μ", "n", "p")}
MIN_SAMPLES = 16
NORMAL = 1.4826  # ratio of standard to median deviation for normal noise
SEPARATORS = {"\t": "tabs", ";": "semicolons"}
WAY_OUT = "; or write a [[measured]] table in the scene file, see inputs/README.md"
PULSE_MARGIN = 3.0  # standard deviations above the expected maximum of noise alone


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


@dataclass(frozen=True)
class _Column:
    place: int
    heading: str
    name: str  # without the unit
    unit: str  # empty if the heading has no unit


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
    own = {f"{MEASURED}.{place}": entry for place, entry in enumerate(scene.measured)} if scene else {}
    if scene and file:
        asked = file.resolve()
        own = {key: each for key, each in own.items() if each.file and (scene.folder / each.file).resolve() == asked}
    if scene and own:
        return own, scene.folder, scene.file
    if file is None:
        found = "no measured data: add a [[measured]] table to the scene file, or give --measured FILE.csv"
        raise InputError(source, "measured", found)
    return {MEASURED: MeasuredEntry(file=str(file))}, Path(), f"--measured {paths.shown(file)}"


def read_measured(
    entry: MeasuredEntry, folder: Path, gauges: Collection[str], where: str, key: str = "measured"
) -> MeasuredTrace:
    """The trace of an entry that names a file.

    Args:
        entry: Entry of the scene.
        folder: Folder to which the path of the file is relative.
        gauges: Gauges of the scene (``postproc.read.sensors.gauges_of``).
        where: Scene as messages name it.
        key: Key of the entry in the scene, such as ``measured.0``.

    Raises:
        InputError: The file is missing or not a table of numbers, a column or unit is missing or wrong, times do not
            increase, there are fewer than ``MIN_SAMPLES`` samples, or a gauge shows no pulse.
    """
    assert entry.file is not None  # checked by the rules of the scene
    path = folder / entry.file
    if not path.is_file():
        found = "a folder" if path.is_dir() else "no such file"
        allowed = f"a CSV file, relative to {paths.shown(folder)}"
        raise InputError(where, f"{key}.file", f"{found}: {paths.shown(path)}", allowed)
    columns = _columns(path)
    time = _column(columns, entry.time or "time", path, where, f"{key}.time")
    chosen = _gauge_columns(columns, entry, gauges, path, where, key)
    table = _numbers(path, [time, *chosen.values()])
    scale, _ = _unit(time, entry.time_unit, {TIME: "time"}, path, where, f"{key}.time_unit")
    kinds = {gauge: _unit(column, entry.unit, READINGS, path, where, f"{key}.unit") for gauge, column in chosen.items()}
    unit = next(iter(kinds.values()))[1]
    for gauge, (_, other) in kinds.items():
        if other != unit:
            found = f"{gauge} in {other} and {next(iter(kinds))} in {unit}"
            raise InputError(where, f"{key}.gauges", found, "gauges of one unit; use a [[measured]] table per unit")
    time_s = table[0] * scale
    _must_increase(path, time, table[0])
    reading = {gauge: table[place] * kinds[gauge][0] for place, gauge in enumerate(chosen, 1)}
    gain = _gain(entry, unit, where, f"{key}.gain")
    noise = None if entry.noise is None else _in_unit(entry.noise, unit, where, f"{key}.noise")
    if noise is not None and noise <= 0:
        raise InputError(where, f"{key}.noise", shorten(entry.noise), "a standard deviation above 0")
    for gauge, values in reading.items():
        _must_show_pulse(path, chosen[gauge], values * np.sign(gain), noise)
    return MeasuredTrace(
        file=path,
        time_s=time_s,
        reading=reading,
        gain=gain,
        gain_uncertainty=entry.gain_uncertainty,
        trigger_s=entry.trigger,
        baseline=None if entry.baseline is None else _in_unit(entry.baseline, unit, where, f"{key}.baseline"),
        drift=entry.drift,
        noise=noise,
        unit=unit,
    )


def read_traces(scene: Scene, gauges: Collection[str]) -> list[MeasuredTrace]:
    """Traces of all entries of a scene that name a file; raises as ``read_measured`` does."""
    entries = [(f"measured.{place}", entry) for place, entry in enumerate(scene.measured) if entry.file]
    return [read_measured(entry, scene.folder, gauges, scene.file, key) for key, entry in entries]


def read_quoted(
    entry: MeasuredEntry, names: Collection[str], where: str, key: str = "measured"
) -> dict[str, tuple[float, float]]:
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
            alike = get_close_matches(without_unit(stated), known) or list(known)
            raise InputError(where, place, "an unknown observable", ", ".join(alike))
        if name in quoted:
            raise InputError(where, place, f"{without_unit(name)} twice", "each observable once")
        unit = describe(name).unit
        plain = unit in ("", "share", "diameters")
        number = _plain(value, where, place) if plain else _in_unit(value, unit, where, place)
        if number == 0:
            raise InputError(where, place, shorten(value), "a value other than 0, since its error is relative")
        quoted[name] = number, (entry.errors or {})[stated]
    return quoted


def _columns(path: Path) -> list[_Column]:
    """Headings of a file: its first line, apart from empty lines and comments."""
    _, headings = next(_lines(path), (0, []))
    if not headings:
        raise InputError(paths.shown(path), "", "an empty file", "a row of headings and rows of numbers below")
    columns = []
    for place, heading in enumerate(text.strip() for text in headings):
        bracketed = HEADING.fullmatch(heading)
        name, unit = (bracketed["key"].strip(), bracketed["unit"] or "") if bracketed else (heading, "")
        head, _, ending = name.rpartition("_")
        if not unit and head and ending in ENDINGS:
            name, unit = head, ending
        columns.append(_Column(place, heading, name, unit))
    return columns


def _lines(path: Path) -> Iterator[tuple[int, list[str]]]:
    """Lines of a CSV file with cells and without comments, each with its line number."""
    try:
        with path.open(encoding="utf-8-sig", newline="") as file:
            reader = csv.reader(file)
            for cells in reader:
                if any(cell.strip() for cell in cells) and not cells[0].startswith("#"):
                    yield reader.line_num, cells
    except UnicodeDecodeError as error:
        raise InputError(paths.shown(path), "", f"byte 0x{error.object[error.start]:02x}", "UTF-8 text") from error
    except (OSError, csv.Error) as error:
        raise InputError(paths.shown(path), "", str(error), "comma-separated values") from error


def _column(columns: list[_Column], name: str, path: Path, where: str, key: str) -> _Column:
    """The column with this heading, given with or without its unit."""
    found = [column for column in columns if column.heading == name] or [c for c in columns if c.name == name]
    if len(found) == 1:
        return found[0]
    headings = shorten(", ".join(column.heading for column in columns))
    for separator, plural in SEPARATORS.items():
        if len(columns) == 1 and separator in columns[0].heading:
            raise InputError(paths.shown(path), "line 1", f"{plural} between the headings", "commas (CSV)")
    problem = f'{"no" if not found else "more than one"} column "{name}" in {paths.shown(path)}'
    raise InputError(where, key, problem, f"one of the headings of its first line: {headings}{_way_out(key)}")


def _way_out(key: str) -> str:
    """End of a message on a file that no ``[[measured]]`` table describes; empty for a key of such a table."""
    return "" if re.match(rf"{MEASURED}\.\d", key) else WAY_OUT


def _gauge_columns(
    columns: list[_Column], entry: MeasuredEntry, gauges: Collection[str], path: Path, where: str, key: str
) -> dict[str, _Column]:
    """The column of each measured gauge."""
    has = ", ".join(gauges) or "none: the scene has no gauges"
    if entry.gauges is None:
        like_gauges = [column for column in columns if re.fullmatch(PLACEHOLDERS["gauge"], column.name)]
        for column in like_gauges:
            if column.name not in gauges:
                allowed = f"gauges {has}{_way_out(key)}"
                raise InputError(where, f"{key}.gauges", f"{column.heading} in {paths.shown(path)}", allowed)
        if not like_gauges:
            headings = shorten(", ".join(column.heading for column in columns))
            allowed = f"columns named after the gauges: {has}{_way_out(key) or ', or a heading for each gauge'}"
            raise InputError(where, f"{key}.gauges", f"headings {headings} in {paths.shown(path)}", allowed)
        return {c.name: _column(columns, c.name, path, where, f"{key}.gauges") for c in like_gauges}
    for gauge in entry.gauges:
        if gauge not in gauges:
            raise InputError(where, f"{key}.gauges.{gauge}", "an unknown gauge", has)
    return {gauge: _column(columns, name, path, where, f"{key}.gauges.{gauge}") for gauge, name in entry.gauges.items()}


def _numbers(path: Path, columns: list[_Column]) -> list[Array]:
    """Columns of a file as finite numbers, each of shape (samples,)."""
    import pandas as pd

    shown = paths.shown(path)
    head, headings = next(_lines(path))
    try:
        table = pd.read_csv(
            path, header=None, skiprows=head, comment="#", skipinitialspace=True, encoding="utf-8-sig", low_memory=False
        )
    except pd.errors.EmptyDataError:
        table = pd.DataFrame(columns=range(len(headings)))
    except (ValueError, OSError) as error:  # pandas' own errors are ValueErrors
        _refuse_ragged(path)
        raise InputError(shown, "", str(error), "comma-separated numbers below a row of headings") from error
    if table.shape[1] != len(headings):
        _refuse_ragged(path)
    found = []
    for column in columns:
        values = table[column.place]
        numbers = pd.to_numeric(values, errors="coerce").to_numpy(float)
        strange = ~np.isfinite(numbers) | (values.dtype == bool)
        if strange.any():
            line, cells = _row(path, int(np.argmax(strange)))
            cell = shorten(cells[column.place].strip()) if column.place < len(cells) else "no cell"
            raise InputError(shown, f"line {line}, {column.heading}", cell, "a finite number")
        found.append(numbers)
    if len(table) < MIN_SAMPLES:
        raise InputError(shown, "", f"{len(table)} samples", f"at least {MIN_SAMPLES}")
    return found


def _refuse_ragged(path: Path) -> None:
    """Refuses a file for the first line whose number of cells differs from the number of headings."""
    rows = _lines(path)
    _, headings = next(rows)
    for line, cells in rows:
        if len(cells) != len(headings):
            allowed = f"{len(headings)}, as many as headings"
            raise InputError(paths.shown(path), f"line {line}", f"{len(cells)} cells", allowed)


def _row(path: Path, number: int) -> tuple[int, list[str]]:
    """Line number and cells of a row of numbers; rows are counted from 0."""
    return next(row for place, row in enumerate(_lines(path), -1) if place == number)


def _must_increase(path: Path, column: _Column, time: Array) -> None:
    back = np.diff(time) <= 0
    if back.any():
        place = int(np.argmax(back))
        line, _ = _row(path, place + 1)
        found = f"{time[place + 1]:.9g} after {time[place]:.9g}"
        raise InputError(paths.shown(path), f"line {line}, {column.heading}", found, "times that increase")


def _unit(
    column: _Column, stated: str | None, allowed: Mapping[str, str], path: Path, where: str, key: str
) -> tuple[float, str]:
    """Factor from the unit of a column to the SI unit, and the SI unit; the heading or the entry gives the unit.

    Raises:
        InputError: The unit is missing or belongs to another quantity, or heading and entry differ.
    """
    words = f"a unit of {' or '.join(allowed.values())}"
    example = f'in the heading ("{column.name} [{"us" if TIME in allowed else "mV"}]") or as {key.rpartition(".")[2]}'
    texts = {paths.shown(path): column.unit, where: stated or ""}
    found = {place: _factor(text, allowed) for place, text in texts.items() if text}
    for place, factor in found.items():
        if factor is None:
            named = column.heading if texts[place] == column.unit else key
            raise InputError(place, named, f'the unit "{texts[place]}"', words)
    factors = [factor for factor in found.values() if factor]
    if not factors:
        raise InputError(paths.shown(path), column.heading, f"missing unit: {words}, {example}")
    if factors[0] != factors[-1]:
        raise InputError(where, key, f'"{stated}" for a column "{column.heading}"', "one unit")
    return factors[0]


def _factor(text: str, allowed: Mapping[str, str]) -> tuple[float, str] | None:
    for unit in allowed:
        try:
            return to_si(f"1 {text}", unit), unit
        except ValueError:
            continue
    return None


def _gain(entry: MeasuredEntry, unit: str, where: str, key: str) -> float:
    """Newtons per SI unit of the readings."""
    if unit == FORCE:
        gain = 1.0 if entry.gain is None else _plain(entry.gain, where, key)
    elif entry.gain is None:
        found = f'missing key: readings in {unit} need a gain such as "2.1 N/{unit}"{_way_out(key)}'
        raise InputError(where, key, found)
    else:
        gain = _in_unit(entry.gain, f"N/{unit}", where, key)
    if gain == 0:
        raise InputError(where, key, "0", "a gain other than 0; a negative gain inverts the trace")
    return gain


def _in_unit(stated: str | float, unit: str, where: str, key: str) -> float:
    """A stated value in an SI unit."""
    if isinstance(stated, str):
        try:
            return to_si(stated, unit)
        except ValueError:
            pass
    unit = unit.replace("1/", "") + "^-1" * unit.startswith("1/")  # texts of units begin with a letter
    _, _, other = str(stated).partition(" ")
    allowed = f"a number in {unit}, not in {other[:20]}," if other else "a number with its unit,"
    raise InputError(where, key, shorten(stated), f'{allowed} such as "2 {unit}"')


def _plain(stated: str | float, where: str, key: str) -> float:
    if isinstance(stated, str):
        raise InputError(where, key, shorten(stated), "a plain number")
    return float(stated)


def _must_show_pulse(path: Path, column: _Column, values: Array, noise: float | None) -> None:
    """Refuses readings without a maximum above the noise.

    If no noise is given, it is estimated from second differences, which remove slow changes.
    """
    risen = values - np.median(values)
    differences = np.abs(np.diff(values, 2))
    deviation = NORMAL * float(np.median(differences)) / np.sqrt(6) if noise is None else noise
    limit = (np.sqrt(2 * np.log(len(values))) + PULSE_MARGIN) * deviation
    if not risen.max() > limit:
        found = "a constant" if not np.ptp(values) else "no pulse: nothing rises above noise"
        inverted = "; a negative gain inverts the trace" * bool(-risen.min() > limit)
        raise InputError(paths.shown(path), column.heading, found, f"readings with a pulse{inverted}")
