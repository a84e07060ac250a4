"""Measured traces and quoted values as a scene names them: read from their files and texts, in SI units."""

import csv
import re
from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass, replace
from difflib import get_close_matches
from pathlib import Path

import numpy as np

from drivers.base import paths
from drivers.base.errors import InputError
from drivers.base.messages import shorten
from drivers.base.units import to_si
from drivers.batch.axes import HEADING
from drivers.chain.chain import Array
from drivers.scene.model import Measured, Scene
from postproc.read.observables import PLACEHOLDERS, describe, without_unit

TIME, FORCE = "s", "N"
READINGS = {FORCE: "force", "V": "voltage", "A": "current", "C": "charge"}
ENDINGS = {prefix + unit for unit in (TIME, *READINGS) for prefix in ("", "k", "m", "u", "µ", "μ", "n", "p")}
LEAST_SAMPLES = 16
NORMAL = 1.4826  # standard deviation over median deviation, of normal noise
STANDS_OUT = 3.0  # standard deviations above the largest that noise alone is expected to reach


@dataclass(frozen=True, eq=False)
class MeasuredTrace:
    """One ``[[measured]]`` entry with its file.

    Attributes:
        file: that was read.
        time_s: as in the file, increasing, not always equally spaced. Shape (samples,).
        reading: by gauge, in SI units (V, N), without baseline and gain. Each of shape (samples,).
        gain: newtons per reading; ``gain_uncertainty``: its relative standard error.
        trigger_s: time in the file at which the striker meets the chain; None: to be found.
        baseline: reading at rest; None: to be found; ``drift``: that is a straight line.
        noise: standard deviation of a reading; None: to be found.
        unit: of the readings.
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
class Quoted:
    """A value that somebody quotes, in the SI unit of its observable, with its relative standard error."""

    value: float
    error_share: float


@dataclass(frozen=True)
class _Column:
    place: int
    heading: str
    name: str  # without the unit
    unit: str  # empty where the heading names none


def entries_of(scene: Scene | None, file: Path | None, source: str) -> tuple[dict[str, Measured], Path, str]:
    """``[[measured]]`` entries by key, the folder from which their paths are seen, and where they stand, in words.

    Those of a scene, of which only those for a file that is given; an entry of headings alone where there is none.

    Args:
        scene: as its file has it; None where that is gone.
        file: in place of the scene's files.
        source: what is asked about, as messages name it.

    Raises:
        InputError: nothing was measured.
    """
    own = {f"measured.{place}": entry for place, entry in enumerate(scene.measured)} if scene else {}
    if scene and file:
        asked = file.resolve()
        own = {key: each for key, each in own.items() if each.file and (scene.folder / each.file).resolve() == asked}
    if scene and own:
        return own, scene.folder, scene.file
    if file is None:
        raise InputError(
            source, "measured", "nothing", "a [[measured]] table in the scene file, or --measured FILE.csv"
        )
    return {"measured": Measured(file=str(file))}, Path(), f"--measured {paths.shown(file)}"


def read_measured(
    entry: Measured, folder: Path, gauges: Collection[str], where: str, key: str = "measured"
) -> MeasuredTrace:
    """The trace of an entry that names a file.

    Args:
        entry: of the scene.
        folder: from which its path is seen.
        gauges: those that the scene has (``postproc.read.sensors.gauges_of``).
        where: the scene as messages name it.
        key: the entry's in the scene, such as ``measured.0``.

    Raises:
        InputError: there is no such file, it is no table of numbers, it lacks a column, a unit is missing or is none
            of its quantity, times do not increase, there are fewer than ``LEAST_SAMPLES``, or a gauge shows no pulse.
    """
    assert entry.file is not None  # the scene's rules see to that
    path = folder / entry.file
    if not path.is_file():
        found = f'no such file: "{paths.shown(path)}"'
        raise InputError(where, f"{key}.file", found, "a CSV file, its path as seen from the scene file")
    columns = _columns(path)
    time = _column(columns, entry.time or "time", path, where, f"{key}.time")
    chosen = _gauge_columns(columns, entry, gauges, path, where, key)
    table = _numbers(path, [time, *chosen.values()])
    scale, _ = _unit(time, entry.time_unit, {TIME: "time"}, path, where, f"{key}.time_unit")
    kinds = {gauge: _unit(column, entry.unit, READINGS, path, where, f"{key}.unit") for gauge, column in chosen.items()}
    unit = next(iter(kinds.values()))[1]
    for gauge, (_, other) in kinds.items():
        if other != unit:
            found = f"{gauge} in {other} beside {next(iter(kinds))} in {unit}"
            raise InputError(where, f"{key}.gauges", found, "gauges of one unit: a [[measured]] table for each")
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
    """The traces of all entries of a scene that name a file; ``read_measured`` says what is refused."""
    entries = [(f"measured.{place}", entry) for place, entry in enumerate(scene.measured) if entry.file]
    return [read_measured(entry, scene.folder, gauges, scene.file, key) for key, entry in entries]


def averaged(trace: MeasuredTrace, step_s: float) -> MeasuredTrace:
    """The trace with the means of blocks, where there are more than two readings in a time; noise is that of a mean."""
    block = max(1, int(step_s / 2 / float(np.median(np.diff(trace.time_s)))))
    whole = len(trace.time_s) // block * block

    def means(values: Array) -> Array:
        return np.asarray(values[:whole].reshape(-1, block).mean(axis=1))

    reading = {gauge: means(values) for gauge, values in trace.reading.items()}
    noise = None if trace.noise is None else trace.noise / block**0.5
    return replace(trace, time_s=means(trace.time_s), reading=reading, noise=noise)


def read_quoted(entry: Measured, names: Collection[str], where: str, key: str = "measured") -> dict[str, Quoted]:
    """The values of an entry that quotes some, by observable as ``names`` has it.

    Args:
        entry: of the scene.
        names: observables that the scene's runs have, with their units, as ``observe`` gives them.
        where: the scene as messages name it.
        key: the entry's in the scene, such as ``measured.0``.

    Raises:
        InputError: the scene has no such observable, one is named twice, or a unit is missing or is none of its own.
    """
    known, quoted = {without_unit(name): name for name in names}, dict[str, Quoted]()
    for stated, value in (entry.values or {}).items():
        place, name = f"{key}.values.{stated}", known.get(without_unit(stated))
        if name is None:
            alike = get_close_matches(without_unit(stated), known) or list(known)
            raise InputError(where, place, "no observable of the scene", ", ".join(alike))
        if name in quoted:
            raise InputError(where, place, f"{without_unit(name)} twice", "each observable once")
        unit = describe(name).unit
        plain = unit in ("", "share", "diameters")
        number = _plain(value, where, place) if plain else _in_unit(value, unit, where, place)
        if number == 0:
            raise InputError(where, place, shorten(value), "another value than 0, of which the error is a share")
        quoted[name] = Quoted(number, (entry.errors or {})[stated])
    return quoted


def _columns(path: Path) -> list[_Column]:
    """The headings of a file, its first line that is neither empty nor a comment."""
    _, headings = next(_lines(path), (0, []))
    if not headings:
        raise InputError(paths.shown(path), "", "an empty file", "a row of headings, and rows of numbers below it")
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
    """Lines of a CSV file that hold cells, each with its number; no comments."""
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
    """The column that a heading names, with or without its unit."""
    found = [column for column in columns if column.heading == name] or [c for c in columns if c.name == name]
    if len(found) == 1:
        return found[0]
    headings = shorten(", ".join(column.heading for column in columns))
    told = f'{"no" if not found else "more than one"} column "{name}" in {paths.shown(path)}'
    raise InputError(where, key, told, f"one of the headings of its first line, which are {headings}")


def _gauge_columns(
    columns: list[_Column], entry: Measured, gauges: Collection[str], path: Path, where: str, key: str
) -> dict[str, _Column]:
    """The column of each measured gauge."""
    has = ", ".join(gauges) or "none: the scene has no gauges"
    if entry.gauges is None:
        like_gauges = [column for column in columns if re.fullmatch(PLACEHOLDERS["gauge"], column.name)]
        for column in like_gauges:
            if column.name not in gauges:
                raise InputError(where, f"{key}.gauges", f"{column.heading} in {paths.shown(path)}", f"gauges {has}")
        if not like_gauges:
            headings = shorten(", ".join(column.heading for column in columns))
            allowed = f"a heading by gauge, or columns named after gauges: {has}"
            raise InputError(where, f"{key}.gauges", f"headings {headings} in {paths.shown(path)}", allowed)
        return {c.name: _column(columns, c.name, path, where, f"{key}.gauges") for c in like_gauges}
    for gauge in entry.gauges:
        if gauge not in gauges:
            raise InputError(where, f"{key}.gauges.{gauge}", "no gauge of the scene", has)
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
            told = shorten(cells[column.place].strip()) if column.place < len(cells) else "nothing"
            raise InputError(shown, f"line {line}, {column.heading}", told, "a finite number")
        found.append(numbers)
    if len(table) < LEAST_SAMPLES:
        raise InputError(shown, "", f"{len(table)} samples", f"at least {LEAST_SAMPLES}")
    return found


def _refuse_ragged(path: Path) -> None:
    """Refuses a file for the first line that has other cells than headings."""
    rows = _lines(path)
    _, headings = next(rows)
    for line, cells in rows:
        if len(cells) != len(headings):
            allowed = f"{len(headings)}, as many as there are headings"
            raise InputError(paths.shown(path), f"line {line}", f"{len(cells)} cells", allowed)


def _row(path: Path, number: int) -> tuple[int, list[str]]:
    """The line of a row of numbers, counted from 0, and its cells."""
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
    """How many of the SI unit make one of a column's, and that unit: the heading's, or the one that the entry states.

    Raises:
        InputError: there is none, it is none of the quantity, or both differ.
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
        raise InputError(paths.shown(path), column.heading, "no unit", f"{words}, {example}")
    if factors[0] != factors[-1]:
        raise InputError(where, key, f'"{stated}" beside "{column.heading}"', "one unit")
    return factors[0]


def _factor(text: str, allowed: Mapping[str, str]) -> tuple[float, str] | None:
    for unit in allowed:
        try:
            return to_si(f"1 {text}", unit), unit
        except ValueError:
            continue
    return None


def _gain(entry: Measured, unit: str, where: str, key: str) -> float:
    """Newtons per SI unit of the readings."""
    if unit == FORCE:
        gain = 1.0 if entry.gain is None else _plain(entry.gain, where, key)
    elif entry.gain is None:
        raise InputError(where, key, f"nothing, for readings in {unit}", f'force per reading, such as "2.1 N/{unit}"')
    else:
        gain = _in_unit(entry.gain, f"N/{unit}", where, key)
    if gain == 0:
        raise InputError(where, key, "0", "a gain that is not 0; one below 0 turns the trace over")
    return gain


def _in_unit(stated: str | float, unit: str, where: str, key: str) -> float:
    """A stated value in an SI unit."""
    if isinstance(stated, str):
        try:
            return to_si(stated, unit)
        except ValueError:
            pass
    unit = unit.replace("1/", "") + "^-1" * unit.startswith("1/")  # texts of units begin with a letter
    raise InputError(where, key, shorten(stated), f'a number with its unit, such as "2 {unit}"')


def _plain(stated: str | float, where: str, key: str) -> float:
    if isinstance(stated, str):
        raise InputError(where, key, shorten(stated), "a plain number")
    return float(stated)


def _must_show_pulse(path: Path, column: _Column, values: Array, noise: float | None) -> None:
    """Refuses readings of which none rises above the others by more than noise.

    Without a noise, it is that of second differences: they leave nothing of what changes slowly.
    """
    risen = values - np.median(values)
    differences = np.abs(np.diff(values, 2))
    deviation = NORMAL * float(np.median(differences)) / np.sqrt(6) if noise is None else noise
    limit = (np.sqrt(2 * np.log(len(values))) + STANDS_OUT) * deviation
    if not risen.max() > limit:
        found = "a constant" if not np.ptp(values) else "no pulse: nothing rises above noise"
        turned = "; a gain below 0 turns the trace over" * bool(-risen.min() > limit)
        raise InputError(paths.shown(path), column.heading, found, f"readings with a pulse in them{turned}")
