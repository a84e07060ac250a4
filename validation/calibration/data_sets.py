"""Data sets: scenes with measured numbers or traces."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache
from math import hypot, sqrt
from pathlib import Path
from typing import Any

from drivers.base import paths
from drivers.base.errors import InputError
from drivers.chain.case import Case, build_case
from drivers.engines import REFERENCE
from drivers.limits import inability
from drivers.scene.model import MeasuredEntry, Scene
from drivers.scene.read_scene import apply_setting, find_scene, make_scene, read_scene, read_toml
from drivers.scene.settings import look_up, unit_of
from postproc.paper.quoted import force_accuracy, quoted
from postproc.paper.simulate import exact
from postproc.read.measured import entries_of, read_measured, read_quoted
from postproc.read.observables import describe
from postproc.read.sensors import gauges_of
from validation.calibration.calibration_file import Answer, QuotedNumber, QuotedSet, calibration_file
from validation.calibration.free import GAIN, TRIGGER, Free, around, did_you_mean, stated
from validation.calibration.readings import Record, records_of

LONGER = 2.0  # a run divided by the scene's duration, if a trigger has to be found
SCALES = {"force": "force_scale", "speed": "speed_scale"}  # nuisance parameter of a kind of error
READING = "reading"  # table of the keys of nuisance parameters
CUT = f"{READING}.cut"


@dataclass(frozen=True)
class MeasuredNumber:
    """A measured number.

    Attributes:
        observable: Name of an observable or of a reading, with its unit.
        value, error: Value and standard error in the observable's unit; the error without common parts.
        because: Reason of an assumed error; empty for a stated one.
        divisor: Key of the parameter by which the computed number is divided; empty without one.
    """

    observable: str
    value: float
    error: float
    because: str = ""
    divisor: str = ""


@dataclass(frozen=True, eq=False)
class DataSet:
    """A scene with its measured data.

    Attributes:
        source: Name of the scene or path of its file.
        tables: Tables of the scene's file with settings applied, as JSON: data sets with the same tables share motions.
        where: File as messages name it.
        numbers: Measured numbers.
        own: Keys of free parameters of this data set alone.
        records: Measured traces.
        entries: ``[[measured]]`` tables by key, such as ``measured.0``.
        duration: Duration of the scene's run; that of the tables is longer if a trigger has to be found.
    """

    name: str
    source: str
    tables: str
    where: str
    numbers: tuple[MeasuredNumber, ...] = ()
    own: tuple[str, ...] = ()
    records: tuple[Record, ...] = ()
    entries: Mapping[str, MeasuredEntry] = field(default_factory=dict)
    duration: str = ""

    @property
    def lines(self) -> int:
        """Number of coefficients of the base lines fitted to the traces."""
        return sum(record.lines * len(record.measured.reading) for record in self.records)

    @property
    def rows(self) -> int:
        """Number of residuals."""
        return len(self.numbers) + sum(record.rows * len(record.measured.reading) for record in self.records)

    @property
    def scene(self) -> Scene:
        """Scene made from the tables."""
        return make_scene(json.loads(self.tables), self.name, self.where)


def text_of(key: str, value: float) -> Any:
    """A value as in a scene file: text with its unit, or a plain number."""
    unit = unit_of(key)
    return f"{value!r} {unit}" if unit else value


def paper_data(names: Sequence[str], settings: Sequence[str] = (), answers: Sequence[Answer] = ()) -> list[DataSet]:
    """Quoted data sets, with settings applied to their scenes.

    Args:
        names: Names of data sets of ``inputs/calibration.toml``.
        settings: Settings of all scenes, such as those of a law.
        answers: Readings of the sentences that the paper leaves open.

    Raises:
        InputError: A data set or setting is unknown.
    """
    known, data = {quoted_set.name: quoted_set for quoted_set in calibration_file().set}, list[DataSet]()
    for name in names:
        if name not in known:
            allowed = f"comma-separated names from {', '.join(known)}"
            raise InputError("--quoted", "", f"{name}; {did_you_mean(name, known)}".rstrip("; "), allowed)
        data += _rows_of(
            known[name], [row for other, row in known[name].also.items() if other in names], settings, answers
        )
    return data


def _rows_of(
    asked: QuotedSet, skipped: Sequence[int], settings: Sequence[str], answers: Sequence[Answer]
) -> list[DataSet]:
    """Data sets of the rows of a quoted set."""
    changes = [setting for answer in answers for setting in answer.set.get(asked.name, ())]
    everything = (*asked.set, *settings, *changes)
    _, tables, where = scene_tables(asked.scene, everything)
    _case(read_scene(asked.scene, everything))
    columns, data = [_column(number, answers) for number in asked.number], list[DataSet]()
    for row in range(max(map(len, columns))):
        numbers = tuple(column[min(row, len(column) - 1)] for column in columns)
        first = numbers[0]
        unit = describe(first.observable).unit or first.observable.rpartition("_")[2]
        label = f"{asked.name} {first.value:g} {unit}" if max(map(len, columns)) > 1 else asked.name
        if row not in skipped:
            data.append(DataSet(label, asked.scene, json.dumps(tables), where, numbers, asked.own))
    return data


def _column(number: QuotedNumber, answers: Sequence[Answer]) -> list[MeasuredNumber]:
    """Numbers of a list in ``quoted.toml``, or its single number."""
    stored = look_up(quoted(), number.quoted)
    values = stored if isinstance(stored, tuple) else (stored,)
    if not all(isinstance(value, (int, float)) for value in values):
        allowed = "a number of inputs/paper/quoted.toml"
        raise InputError(paths.shown(paths.CALIBRATION), "quoted", number.quoted, allowed)
    name = next((said.read[number.observable] for said in answers if number.observable in said.read), number.observable)
    shared = {} if any(answer.independent for answer in answers) else _nuisances()
    common = {key.removeprefix(f"{READING}."): free.prior for key, free in shared.items() if free.prior}
    scale, numbers = SCALES.get(str(number.error), ""), []
    for place, value in enumerate(values):
        own_error = sqrt(max(_share(number.error, value) ** 2 - common.get(scale, 0.0) ** 2, 0.0)) * abs(value)
        rounding = number.rounding[place] / sqrt(3) if number.rounding and common else 0.0
        error, divisor = hypot(own_error, rounding) * number.scale, f"{READING}.{scale}" if scale in common else ""
        numbers.append(MeasuredNumber(name, value * number.scale, error, number.because, divisor))
    return numbers


def _share(error: str | float, value: float) -> float:
    """Relative standard error of a quoted value, with its common part."""
    if error == "force":
        return force_accuracy(value)
    return quoted().accuracy_speed if error == "speed" else float(error)


@cache
def _nuisances() -> dict[str, Free]:
    """Nuisance parameters of quoted numbers, by key."""
    where = paths.shown(paths.CALIBRATION)
    asked = {f"{READING}.{nuisance.key}": nuisance.free for nuisance in calibration_file().nuisance}
    return {key: stated(f"{key}={bounds}", "", where, None, None) for key, bounds in asked.items()}


def nuisances(sets: Sequence[DataSet], answers: Sequence[Answer] = ()) -> tuple[list[Free], dict[str, float]]:
    """Nuisance parameters that the numbers of some data sets need, and values of those that an answer fixes."""
    numbers = [number for data in sets for number in data.numbers]
    needed = {number.divisor for number in numbers} | {CUT for number in numbers if "_full_width" in number.observable}
    fixed = {f"{READING}.{key}": value for answer in answers for key, value in answer.fixed.items()}
    return [free for key, free in _nuisances().items() if key in needed and key not in fixed], fixed


def scene_tables(source: str, settings: Sequence[str]) -> tuple[str, dict[str, Any], str]:
    """Name, tables and file of a scene with settings applied.

    Raises:
        InputError: The scene or a setting is unknown.
    """
    path = find_scene(source)
    tables = read_toml(path)
    for setting in settings:
        apply_setting(tables, setting)
    return path.stem, tables, paths.shown(path)


def scene_data(
    source: str, settings: Sequence[str] = (), file: Path | None = None, *, free_trigger: bool = False
) -> DataSet:
    """Data set of a scene from its ``[[measured]]`` entries, or from one file, which needs no entry.

    Args:
        source: Name of the scene or path of its file.
        settings: Settings applied to the scene.
        file: Measured file that replaces those of the scene.
        free_trigger: True if a stated trigger is free.

    Raises:
        InputError: There is no measured data, or the scene or its data have errors.
    """
    name, tables, where = scene_tables(source, settings)
    scene = read_scene(source, tuple(settings))
    entries, folder, source_of_data = entries_of(scene, file, where)
    simulation = exact(_case(scene))
    gauges, names = gauges_of(simulation.case.layout), [*simulation.values]
    traces = {
        key: read_measured(entry, folder, gauges, source_of_data, key)
        for key, entry in entries.items()
        if entry.file is not None
    }
    numbers = [
        MeasuredNumber(observable, value, abs(value) * share, divisor=f"{key}.{GAIN}" * observable.endswith("_N"))
        for key, entry in entries.items()
        for observable, (value, share) in read_quoted(entry, names, source_of_data, key).items()
    ]
    records = records_of(traces, scene.run.duration, scene.run.sample_interval)
    tables.pop("measured", None)
    duration = tables["run"]["duration"]
    if free_trigger or any(record.trigger_s is None for record in records):
        apply_setting(tables, f"run.duration={LONGER * scene.run.duration!r} s")
    return DataSet(name, source, json.dumps(tables), where, tuple(numbers), (), tuple(records), entries, duration)


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
        InputError: An option names an unknown entry or key, or the trigger of an entry that shares another's.
    """
    options = {option.partition("=")[0].strip(): option for option in asked}
    if len(data.entries) == 1:
        (only,) = data.entries
        names = {f"{key}.{end}": f"{only}.{end}" for key in ("measured", "measured.0") for end in (GAIN, TRIGGER)}
        options = {names.get(key, key): f"{names.get(key, key)}{text[len(key) :]}" for key, text in options.items()}
    records = {record.key: record for record in data.records}
    known = [f"{key}.{GAIN}" for key in data.entries] + [
        f"{record.key}.{TRIGGER}" for record in data.records if record.key == record.trigger_key
    ]
    for key in options:
        if key not in known:
            allowed = ", ".join(known) or "none, since the data set has no gauge"
            raise InputError(data.where, f"--free {key}", f"unknown gauge parameter; allowed: {allowed}")
    parameters = list[Free]()
    for key, entry in data.entries.items():
        record, name = records.get(key), f"{key}.{GAIN}"
        gain, share = record.measured.gain if record else 1.0, entry.gain_uncertainty
        if name in options or share:
            free = stated(options.get(name, name), "", data.where, gain, around(gain), data.name)
            unit = f"N/{record.measured.unit}" if record and record.measured.unit != "N" else ""
            parameters.append(replace(free, prior=free.prior or share * abs(gain), unit=unit))
        name = f"{key}.{TRIGGER}"
        if name in known and record and (name in options or record.trigger_s is None):
            text, middle_s = options.get(name, name), sum(record.window_s) / 2
            start_s = middle_s if record.trigger_s is None else record.trigger_s
            parameters.append(stated(text, "s", data.where, start_s, record.window_s, data.name))
    return parameters
