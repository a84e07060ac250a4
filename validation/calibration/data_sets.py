"""Data sets: scenes with measured numbers or traces."""

from collections.abc import Mapping, Sequence
from copy import deepcopy
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Any

from drivers.base import paths
from drivers.base.errors import InputError
from drivers.chain.case import Case, build_case
from drivers.engines import REFERENCE
from drivers.limits.refusal import inability
from drivers.scene.model import MeasuredEntry, Scene
from drivers.scene.read_scene import apply_setting, find_scene, make_scene, read_scene, read_toml
from drivers.scene.settings import look_up, unit_of
from postproc.paper.quoted import force_accuracy, quoted
from postproc.paper.simulate import exact
from postproc.read.measured import entries_of, read_measured, read_quoted
from postproc.read.sensors import gauges_of
from validation.calibration.calibration_file import QuotedNumber, calibration_file
from validation.calibration.free import GAIN, TRIGGER, Free, around, bounds_in
from validation.calibration.records import LEEWAY, Record, record_of


@dataclass(frozen=True)
class MeasuredNumber:
    """A measured number.

    Attributes:
        observable: Name of the observable in ``postproc.read.observables``.
        value, error: Value and standard error in the observable's unit.
        fitted: True if the number is fitted, False if it is predicted only.
        because: Reason of an assumed error; empty for a measured one.
        gain: Key of the entry with the gain of its gauge; empty without a gain.
    """

    observable: str
    value: float
    error: float
    fitted: bool = True
    because: str = ""
    gain: str = ""


@dataclass(frozen=True, eq=False)
class DataSet:
    """A scene with its measured data.

    Attributes:
        source: Name of the scene or path of its file.
        tables: Tables of the scene's file with settings applied.
        where: File as messages name it.
        numbers: Measured numbers.
        own: Keys of free parameters of this data set alone.
        records: Measured traces.
        entries: ``[[measured]]`` tables by key, such as ``measured.0``.
    """

    name: str
    source: str
    tables: dict[str, Any]
    where: str
    numbers: tuple[MeasuredNumber, ...] = ()
    own: tuple[str, ...] = ()
    records: tuple[Record, ...] = ()
    entries: Mapping[str, MeasuredEntry] = field(default_factory=dict)

    @property
    def lines(self) -> int:
        """MeasuredNumber of coefficients of the base lines fitted to the traces."""
        return sum(record.lines * len(record.measured.reading) for record in self.records)

    def text(self, key: str, value: float) -> Any:
        """A value as in a scene file: text with its unit, or a plain number."""
        unit = unit_of(key)
        return f"{value!r} {unit}" if unit else value

    @property
    def scene(self) -> Scene:
        """Scene made from the tables."""
        return make_scene(deepcopy(self.tables), library(), self.name, self.where)


@cache
def library() -> dict[str, Any]:
    """Tables of the shipped materials."""
    return read_toml(paths.MATERIALS)


def paper_data(names: Sequence[str], settings: Sequence[str]) -> list[DataSet]:
    """Quoted data sets, with settings applied to their scenes.

    Raises:
        InputError: a data set or setting is unknown.
    """
    known, found = {each.name: each for each in calibration_file().set}, list[DataSet]()
    for name in names:
        if name not in known:
            raise InputError("--quoted", "", name, f"comma-separated names from {', '.join(known)}")
        each = known[name]
        columns = [_column(number) for number in each.number]
        skipped = {row for other, row in each.also.items() if other in names}
        _, tables, where = scene_tables(each.scene, (*each.set, *settings))
        _case(read_scene(each.scene, (*each.set, *settings)))
        for row in range(max(map(len, columns))):
            if row not in skipped:
                numbers = tuple(column[min(row, len(column) - 1)] for column in columns)
                label = f"{name} row {row + 1}" if max(map(len, columns)) > 1 else name
                found.append(DataSet(label, each.scene, tables, where, numbers, each.own))
    return found


def _column(number: QuotedNumber) -> list[MeasuredNumber]:
    """Numbers of a list in ``quoted.toml``, or its single number."""
    stored = look_up(quoted(), number.quoted)
    values = stored if isinstance(stored, tuple) else (stored,)
    if not all(isinstance(value, (int, float)) for value in values):
        raise InputError(
            paths.shown(paths.CALIBRATION), "quoted", number.quoted, "a number of inputs/paper/quoted.toml"
        )
    return [
        MeasuredNumber(
            number.observable,
            value * number.scale,
            abs(value * number.scale) * _share(number.error, value),
            number.fitted,
            number.because,
        )
        for value in values
    ]


def _share(error: str | float, value: float) -> float:
    """Relative standard error of a quoted value."""
    if error == "force":
        return force_accuracy(value)
    return quoted().accuracy_speed if error == "speed" else float(error)


def scene_tables(source: str, settings: Sequence[str]) -> tuple[str, dict[str, Any], str]:
    """Name, tables and file of a scene with settings applied.

    Raises:
        InputError: the scene or a setting is unknown.
    """
    path = find_scene(source)
    tables = read_toml(path)
    for setting in settings:
        apply_setting(tables, setting)
    return path.stem, tables, paths.shown(path)


def scene_data(source: str, settings: Sequence[str], file: Path | None) -> DataSet:
    """Data set of a scene from its ``[[measured]]`` entries, or from one file, which needs no entry.

    Raises:
        InputError: there is no measured data, or the scene or its data have errors.
    """
    name, tables, where = scene_tables(source, settings)
    scene = read_scene(source, tuple(settings))
    entries, folder, source_of_data = entries_of(scene, file, where)
    simulation = exact(_case(scene))
    gauges, names = gauges_of(simulation.case.layout), [*simulation.values]
    numbers, records = list[MeasuredNumber](), list[Record]()
    for key, entry in entries.items():
        if entry.file is not None:
            records.append(record_of(key, read_measured(entry, folder, gauges, source_of_data, key), simulation))
        for observable, (value, error_share) in read_quoted(entry, names, source_of_data, key).items():
            numbers.append(MeasuredNumber(observable, value, abs(value) * error_share, gain=key))
    tables.pop("measured", None)
    if any(record.measured.trigger_s is None for record in records):
        apply_setting(tables, f"run.duration={(1 + LEEWAY) * scene.run.duration!r} s")
    return DataSet(name, source, tables, where, tuple(numbers), (), tuple(records), entries)


def _case(scene: Scene) -> Case:
    """Case of a scene; raises InputError if its exact motion cannot be computed."""
    case = build_case(scene)
    if (cannot := inability(case, REFERENCE)) is not None:
        raise cannot
    return case


def gauge_parameters(data: DataSet, asked: Sequence[str]) -> list[Free]:
    """Parameters of a data set's gauges: missing triggers, gains with an uncertainty, and requested ones.

    Args:
        data: Data set with its entries.
        asked: Options such as ``measured.0.gain`` or ``measured.0.trigger=10 us..20 us``. With a single entry its
            number may be left out or, for a file without a ``[[measured]]`` table, given as 0.

    Raises:
        InputError: an option names an unknown entry or key.
    """
    found, options = list[Free](), {option.partition("=")[0].strip(): option for option in asked}
    allowed = ", ".join(f"{key}.{GAIN}" for key in data.entries) or "none, since the data set has no gauge"
    if len(data.entries) == 1:
        (only,) = data.entries
        names = {f"{key}.{end}": f"{only}.{end}" for key in ("measured", "measured.0") for end in (GAIN, TRIGGER)}
        options = {names.get(key, key): option for key, option in options.items()}
    for key in options:
        if key not in {f"{entry}.{end}" for entry in data.entries for end in (GAIN, TRIGGER)}:
            raise InputError(data.where, f"--free {key}", f"unknown gauge parameter; allowed: {allowed}")
    records = {record.key: record for record in data.records}
    for key, entry in data.entries.items():
        option, record = options.get(f"{key}.{GAIN}"), records.get(key)
        gain, uncertainty = record.measured.gain if record else 1.0, entry.gain_uncertainty
        if option or uncertainty:
            ends = bounds_in(option or "", "", data.where) or around(gain)
            found.append(Free(f"{key}.{GAIN}", "", gain, ends[0], ends[1], data.name, uncertainty))
        option = options.get(f"{key}.{TRIGGER}")
        if record and (option or record.measured.trigger_s is None):
            ends = bounds_in(option or "", "s", data.where) or (
                record.trigger_s - record.leeway_s,
                record.trigger_s + record.leeway_s,
            )
            found.append(Free(f"{key}.{TRIGGER}", "s", record.trigger_s, ends[0], ends[1], data.name))
    return found
