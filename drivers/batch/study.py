"""Studies: a base scene, axes of varied values, engines, and tabulated observables."""

import csv
import hashlib
import json
import pickle
import re
from collections.abc import Mapping, Sequence
from contextlib import suppress
from copy import deepcopy
from dataclasses import dataclass
from fnmatch import fnmatchcase
from functools import cached_property
from io import StringIO
from itertools import chain, product
from math import ceil, isfinite, nan, prod
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import BaseModel, BeforeValidator, Field

from drivers.base import paths, units
from drivers.base.cache import content_of
from drivers.base.errors import InputError, InputProblem, gathered, refuse_any
from drivers.base.files import read_file, readable
from drivers.base.messages import shorten, validate
from drivers.chain.case import Case, build_case
from drivers.engines import engine_names, installed, load_engine
from drivers.scene.model import Part, Title
from drivers.scene.read_scene import find_input, find_scene, library, make_scene, read_toml, read_value, set_value
from drivers.scene.settings import look_up, unit_of

MAX_SAMPLE = 100  # cases that are checked before the first one runs
RESERVED = ("case", "engine", "status", "reason", "force_error_share")  # columns of every table
MAX_VALUES = 1_000_000
MAX_KEYS = 1000  # of a table: to refuse a hundred times as many takes ten seconds
FORMS = ("values", "from_", "factors", "zip", "seeds", "table")
HEADING = re.compile(r"(?P<key>[^\[\]]+?)(?: *\[(?P<unit>[^\[\]]+)\])?")
NAME = r"^[A-Za-z][A-Za-z0-9_.-]*$"

Choice = dict[str, Any]  # key of a scene -> value as in a scene file

Keys = Annotated[
    tuple[Annotated[str, Field(min_length=1)], ...],
    BeforeValidator(lambda value: (value,) if isinstance(value, str) else value),
]
Values = Annotated[tuple[Any, ...], Field(strict=False)]

End = str | int | Annotated[float, Field(allow_inf_nan=True)]  # of a range, which refuses others than finite numbers


class Axis(Part):
    """Table ``[[axis]]`` of a study file, in one of six forms.

    ``key`` with ``values``; ``key`` with ``from``, ``to``, ``count`` and ``spacing``; or ``key`` with ``factors`` of
    the base scene's value. With several keys all get the same value. ``zip``: lists of equal length, one for each key.
    ``seeds``: number of random draws. ``table``: a CSV file with a column for each key and a row for each case.
    """

    key: Keys = Field(default=(), strict=False, description="scene key, or keys with the same values")
    name: Annotated[str, Field(pattern=NAME, max_length=60)] | None = Field(
        default=None, description="name of the column"
    )
    values: Values | None = Field(default=None, description="values")
    from_: End | None = Field(default=None, alias="from", description="first value")
    to: End | None = Field(default=None, description="last value")
    count: Annotated[int, Field(ge=2, le=MAX_VALUES)] | None = Field(default=None, description="number of values")
    spacing: Literal["linear", "log"] = Field(default="linear", description="spacing of the range")
    factors: tuple[Annotated[float, Field(gt=0, allow_inf_nan=False)], ...] | None = Field(
        default=None, strict=False, description="factors of the base value"
    )
    zip: dict[str, Values] | None = Field(default=None, description="lists by key that vary together")
    seeds: Annotated[int, Field(ge=1, le=MAX_VALUES)] | None = Field(default=None, description="number of random draws")
    table: str | None = Field(default=None, description="CSV file: a column for each key")


class StudyFile(Part):
    """Contents of a study file. With axes one by one, case 1 is the base scene."""

    title: Title = Field(default="", description="title")
    scene: str = Field(description="base scene, by name or file")
    set: dict[str, Any] = Field(default_factory=dict, description="settings of every case")
    engines: tuple[str, ...] = Field(default=(), strict=False, description="engines; else all installed")
    observables: tuple[str, ...] = Field(default=("*",), strict=False, description="patterns of observables")
    figure: tuple[str, ...] = Field(default=(), strict=False, description="observables in the figure")
    combine: Literal["grid", "one by one"] = Field(default="grid", description="one by one: vary one axis at a time")
    limit: units.Duration | None = Field(default=None, description="time limit of a case")
    unsafe: bool = Field(default=False, description="true: run refused cases")
    axis: tuple[Axis, ...] = Field(default=(), strict=False, description="varied keys")


@dataclass(frozen=True)
class Study:
    """Study with its expanded axes.

    Attributes:
        file: contents of the study file.
        path: path of the study file.
        where: study file as named in messages.
        scene: path of the base scene.
        base: tables of the base scene, changed by ``set``.
        engines: names of engines in the order of the table.
        axes: choices of each axis, at least one; a single axis of all, after the base scene, if axes are varied one by
            one.
        columns: key of the scene by the name of its column, without unit.
    """

    file: StudyFile
    path: Path
    where: str
    scene: Path
    base: dict[str, Any]
    engines: tuple[str, ...]
    axes: tuple[tuple[Choice, ...], ...]
    columns: dict[str, str]

    @property
    def name(self) -> str:
        """Name of the study file without its suffix."""
        return self.path.stem

    @cached_property
    def _shape(self) -> tuple[int, ...]:
        """Number of choices of each axis; cases are numbered from 1, and the last axis varies fastest."""
        return tuple(map(len, self.axes))

    @cached_property
    def count(self) -> int:
        """Number of cases."""
        return prod(self._shape)

    @cached_property
    def _common_sha256(self) -> str:
        """Digest of all that the cases have in common: base scene, materials, files that the scenes name."""
        named = {look_up(self.base, "drive.file")}
        for choice in chain.from_iterable(self.axes):
            named |= {choice.get("drive.file"), look_up(choice.get("drive"), "file")}
        files = [path for name in named if isinstance(name, str) and readable(path := self.scene.parent / name)]
        return hashlib.sha256(f"{self.base}\0{library()}\0{content_of(files)}".encode()).hexdigest()

    @cached_property
    def _settings(self) -> list[list[list[str]]]:
        """Texts of the values of each choice of each axis that differ from the base scene."""

        def texts(choice: Choice) -> list[str]:
            return [f"{key}={value!r}" for key, value in choice.items() if look_up(self.base, key) != value]

        return [[*map(texts, axis)] for axis in self.axes]

    def digests(self, numbers: Sequence[int]) -> list[str]:
        """Digest of all that the study says about each case; equal cases of several studies have the same."""
        places, common = np.unravel_index(np.subtract(numbers, 1), self._shape), self._common_sha256
        chosen = (map(texts.__getitem__, place.tolist()) for texts, place in zip(self._settings, places, strict=True))
        cases = ("\0".join((common, *sorted(chain.from_iterable(texts)))) for texts in zip(*chosen, strict=True))
        return [hashlib.sha256(case.encode()).hexdigest()[:32] for case in cases]

    def choice(self, number: int) -> Choice:
        """Varied values of a case."""
        axes = zip(self.axes, np.unravel_index(number - 1, self._shape), strict=True)
        return {key: value for axis, place in axes for key, value in axis[place].items()}

    @property
    def sample(self) -> list[int]:
        """Numbers of at most ``MAX_SAMPLE`` cases; each value of each axis occurs if there are not more."""
        places = np.arange(0, max(self._shape), ceil(max(self._shape) / MAX_SAMPLE))
        return [1 + int(place) for place in np.ravel_multi_index([places] * len(self._shape), self._shape, mode="wrap")]

    @cached_property
    def _base_values(self) -> dict[str, Any]:
        """Values of the base scene by column; empty if it is a scene with the varied values only."""
        with suppress(InputError):
            base = make_scene(deepcopy(self.base), self.scene.stem, self.where, self.scene.parent)
            return {name: in_si(key, look_up(base, key)) for name, key in self.columns.items()}
        return {}

    def values(self, number: int) -> dict[str, Any]:
        """Varied values of a case in SI units, by column with its unit."""
        choice = self.choice(number)
        return {
            column_name(name, key): in_si(key, choice[key]) if key in choice else self._base_values.get(name)
            for name, key in self.columns.items()
        }

    def label(self, number: int) -> str:
        """Label of a case: its varied values by column."""
        choice = self.choice(number)
        values = [f"{name}={choice[key]}" for name, key in self.columns.items() if key in choice]
        return ", ".join(values) or "base"

    def case(self, number: int) -> Case:
        """Build a case.

        Raises:
            InputError: the scene with the values of the case is wrong.
        """
        where = f"{self.where}: case {number} ({shorten(self.label(number)).strip(chr(34))})"
        # five times as fast as copy.deepcopy
        data, choice = pickle.loads(pickle.dumps((self.base, self.choice(number))))
        for key, value in choice.items():
            set_value(data, key, value, where)
        return build_case(make_scene(data, self.scene.stem, where, self.scene.parent))


def read_study(source: str | Path, also: Sequence[str] = ()) -> Study:
    """Read a study file, given by path or by name in ``inputs/studies``; ``also`` names further engines.

    Raises:
        InputError: anything wrong with the file, its axes or its base scene, or an unknown engine.
    """
    path = find_input(source, paths.STUDIES, "study")
    where = paths.shown(path)
    file = validate(StudyFile, read_toml(path), where)
    try:
        scene = find_scene(seen_from(path, file.scene)).resolve()
    except (InputError, OSError, ValueError) as error:
        allowed = "the name of a scene, or a scene file relative to the study file"
        raise InputError(where, "scene", shorten(file.scene), allowed) from error
    base = read_toml(scene)
    for key, value in file.set.items():
        set_value(base, key, value, f"{where}: set")
    axes = []
    columns: dict[str, str] = {}
    taken = {*RESERVED}  # names with and without units
    seen = dict.fromkeys(file.set, "set")
    problems: list[InputProblem] = []
    for i, axis in enumerate(file.axis):
        place = f"axis.{i}"
        with gathered(problems, where):
            choices = expand(axis, base, path.parent, where, place)
            for key, (old, old_place) in product(choices[0], seen.items()):
                if f"{old}.".startswith(f"{key}.") or f"{key}.".startswith(f"{old}."):
                    found = f"{key}, which overlaps {old} of {old_place}"
                    raise InputError(where, place, found, "each key of the scene once")
            seen |= dict.fromkeys(choices[0], place)
            keys = axis.key[:1] or [*choices[0]]
            for key in keys:
                name = axis.name or key
                names = {name, column_name(name, key)}
                if names & taken:
                    raise InputError(where, f"{place}.name", f'"{name}", the name of another column', "another name")
                columns[name] = key
                taken |= names
            axes.append(choices)
    for name in file.engines:
        with gathered(problems, where):
            load_engine(name, where, "engines")
    refuse_any(where, problems)
    for name in also:
        load_engine(name, "--engine")
    if file.combine == "one by one":
        axes = [({}, *chain.from_iterable(axes))]
    return Study(
        file=file,
        path=path.resolve(),
        where=where,
        scene=scene,
        base=base,
        engines=tuple(dict.fromkeys((*(file.engines or installed(engine_names())), *also))),
        axes=tuple(axes) or (({},),),
        columns=columns,
    )


def seen_from(file: Path, source: str) -> str | Path:
    """A plain name unchanged; a path relative to the folder of ``file``."""
    return source if "." not in source and "/" not in source else file.parent / source


def select(study: Study, patterns: Sequence[str]) -> Sequence[int]:
    """Numbers of the cases that match patterns; without patterns all.

    A pattern is ``KEY=GLOB`` for a varied value, or a glob for the whole label. Of several patterns of one key any may
    match; all keys have to match.

    Raises:
        InputError: no case matches.
    """
    by_column: dict[str, list[str]] = {}
    for pattern in patterns:
        name = pattern.partition("=")[0]
        by_column.setdefault(name if name in study.columns else "", []).append(pattern)

    def text(name: str, number: int) -> str:
        return f"{name}={study.choice(number).get(study.columns[name], '')}" if name else study.label(number)

    numbers: Sequence[int] = range(1, study.count + 1)
    for name, globs in by_column.items():
        numbers = [number for number in numbers if any(fnmatchcase(text(name, number), glob) for glob in globs)]
    if not numbers:
        labels = "; ".join(study.label(number) for number in range(1, min(study.count, 3) + 1))
        raise InputError(f"--only {' --only '.join(patterns)}", "", f"matches no case; labels are such as {labels}")
    return numbers


def column_name(name: str, key: str) -> str:
    """Name of a column with its unit, such as ``striker.speed_m_s``."""
    unit = unit_of(key)
    return f"{name}_{re.sub(r'[/*]', '_', unit.replace('^', ''))}" if unit else name


def in_si(key: str, value: Any) -> Any:
    """Value at a key of a scene or its file, in SI units; tables and lists as JSON, None for a key that is removed."""
    if isinstance(value, str):
        with suppress(ValueError):
            return units.to_si(value, unit_of(key))
        return value or None
    if isinstance(value, (BaseModel, dict, list, tuple)):
        return json.dumps(value, default=lambda part: part.model_dump(exclude_none=True, exclude_defaults=True))
    return value


def expand(axis: Axis, base: dict[str, Any], folder: Path, where: str, place: str) -> tuple[Choice, ...]:
    """Choices of an axis, in order: the rows of the table of its keys and values, in whichever form it is written.

    Args:
        axis: the axis.
        base: tables of the base scene, whose values factors multiply.
        folder: folder of the study file, to which the paths of tables are relative.
        where: study file as named in messages.
        place: key of the axis in messages.

    Raises:
        InputError: the axis is wrong or has no values.
    """
    forms = [form.strip("_") for form in FORMS if getattr(axis, form) is not None]
    if len(forms) != 1:
        found, allowed = ", ".join(forms) or "none of them", ", ".join(form.strip("_") for form in FORMS)
        raise InputError(where, place, found, f"exactly one of {allowed}")
    if bool(axis.key) != (forms[0] in ("values", "from", "factors")):
        needs = f"no key with {forms[0]}" if axis.key else "a key"
        raise InputError(where, f"{place}.key", str(list(axis.key)), needs)
    columns: Mapping[str, Sequence[Any]] = {"seed": range(1, 1 + (axis.seeds or 0))}
    if axis.values is not None:
        columns = dict.fromkeys(axis.key, axis.values)
    elif axis.from_ is not None:
        columns = dict.fromkeys(axis.key, _range(axis, where, place))
    elif axis.factors is not None:
        columns = {key: _multiplied(base, key, axis.factors, where, place) for key in axis.key}
    elif axis.zip is not None:
        columns = axis.zip
    elif axis.table is not None:
        columns = _table(folder / axis.table, where, f"{place}.table")
    lengths = {key: len(values) for key, values in columns.items()}
    if not all(lengths.values()) or not lengths:
        raise InputError(where, f"{place}.{forms[0]}", "an empty list", "at least one value for each key")
    if len({*lengths.values()}) > 1:
        found = ", ".join(f"{length} of {key}" for key, length in lengths.items())
        raise InputError(where, f"{place}.{forms[0]}", found, "lists of equal length")
    return tuple(dict(zip(columns, row, strict=True)) for row in zip(*columns.values(), strict=True))


def _range(axis: Axis, where: str, place: str) -> list[Any]:
    """Values from one end to the other, both included; whole numbers at both ends give whole numbers."""
    for key in ("to", "count"):
        if getattr(axis, key) is None:
            raise InputError(where, f"{place}.{key}", "missing key; give from, to and count")
    ends, log = (axis.from_, axis.to), axis.spacing == "log"
    quantity = units.NUMBER_AND_UNIT.fullmatch(str(axis.from_))
    unit = quantity[2] if quantity else ""
    low = high = nan
    with suppress(ValueError):
        low, high = (units.to_si(str(end), unit) if unit else float(str(end)) for end in ends)
    if not isfinite(high - low) or (log and min(low, high) <= 0):
        allowed = f'two numbers, or quantities of one kind such as "2 m/s"; finite{", above zero" * log}'
        raise InputError(where, f"{place}.from", shorten(f"{axis.from_} to {axis.to}"), allowed)
    values = (np.geomspace if log else np.linspace)(low, high, axis.count or 0).tolist()
    if all(isinstance(end, int) for end in ends):
        return list(dict.fromkeys(map(round, values)))
    return [f"{value!r} {unit}" if unit else value for value in values]


def _multiplied(base: dict[str, Any], key: str, factors: Sequence[float], where: str, place: str) -> list[Any]:
    """Products of the value of the base scene at a key, or of that of the library of materials, and factors."""
    value = look_up(base, key)
    if value is None:
        value = look_up({"materials": library()}, key)
    if type(value) in (int, float):
        products = [float(str(value)) * factor for factor in factors]  # by its text: float() fails for huge integers
        return [int(one) if type(value) is int and one.is_integer() else one for one in products]
    quantity = units.NUMBER_AND_UNIT.fullmatch(str(value))
    if quantity is None:
        found = f"{'nothing' if value is None else shorten(value)} at {key} of the base scene"
        raise InputError(where, f"{place}.factors", found, "a number or a quantity there")
    return [f"{float(quantity[1]) * factor!r} {quantity[2]}" for factor in factors]


def _table(path: Path, where: str, place: str) -> dict[str, list[Any]]:
    """Columns of a CSV file; headings are keys, with a unit in brackets for columns of plain numbers."""
    shown = paths.shown(path)
    try:
        content = read_file(path, "a CSV file").decode("utf-8-sig")
        rows = [row for row in csv.reader(StringIO(content, newline=""), strict=True) if row]
    except (FileNotFoundError, ValueError, csv.Error) as error:
        found = "no such file" if isinstance(error, FileNotFoundError) else str(error)
        raise InputError(where, place, f"{shown}: {found}", "a readable CSV file") from error
    if len(rows) < 2 or len(rows[0]) > MAX_KEYS:
        allowed = f"a line of at most {MAX_KEYS} keys and at least one line of values"
        raise InputError(shown, "", f"{len(rows)} lines of {len(rows[0]) if rows else 0} cells", allowed)
    for number, row in enumerate(rows, start=1):
        if len(row) != len(rows[0]):
            raise InputError(shown, f"line {number}", f"{len(row)} values", f"{len(rows[0])}, one for each key")
    columns: dict[str, list[Any]] = {}
    for heading, *cells in zip(*rows, strict=True):
        match = HEADING.fullmatch(heading.strip())
        key, unit = (match["key"].strip(), match["unit"]) if match else ("", "")
        if not key or key in columns:
            raise InputError(shown, "line 1", shorten(heading), "each key once, such as striker.speed [m/s]")
        places = (f"line {number}, {key}" for number in range(2, len(rows) + 1))
        columns[key] = [_cell(cell.strip(), unit, shown, place) for cell, place in zip(cells, places, strict=True)]
    return columns


def _cell(text: str, unit: str | None, where: str, place: str) -> Any:
    """Value of a cell; a quantity if the heading has a unit."""
    if unit and units.NUMBER_AND_UNIT.fullmatch(f"{text} {unit}"):
        return f"{text} {unit}"
    if unit or not text:
        allowed = f"a plain number, since the heading has its unit ({unit})" if unit else "a value"
        raise InputError(where, place, shorten(text), allowed)
    return read_value(text)
