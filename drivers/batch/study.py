"""Studies: a base scene, axes of varied values, engines, and tabulated observables."""

import csv
import hashlib
import json
import math
import pickle
import re
from collections.abc import Sequence
from contextlib import suppress
from copy import deepcopy
from dataclasses import dataclass
from fnmatch import fnmatchcase
from functools import cached_property
from io import StringIO
from itertools import chain
from math import ceil, prod
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
from drivers.scene.model import Part, Scene, Title
from drivers.scene.read_scene import find_input, find_scene, library, make_scene, read_toml, read_value, set_value
from drivers.scene.settings import look_up, unit_of

MAX_COUNT = 1_000_000_000
MAX_SAMPLE = 100  # cases that are checked before the first one runs
RESERVED = ("case", "engine", "status", "reason", "force_error_share")  # columns of every table
MAX_VALUES = 1_000_000
FORMS = ("values", "from", "factors", "zip", "seeds", "table")
HEADING = re.compile(r"(?P<key>[^\[\]]+?)(?: *\[(?P<unit>[^\[\]]+)\])?")
NAME = r"^[A-Za-z][A-Za-z0-9_.-]*$"

Choice = dict[str, Any]  # key of a scene -> value as in a scene file

Keys = Annotated[
    tuple[Annotated[str, Field(min_length=1)], ...],
    BeforeValidator(lambda value: (value,) if isinstance(value, str) else value),
]


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
    values: tuple[Any, ...] | None = Field(default=None, strict=False, description="values")
    from_: str | int | float | None = Field(default=None, alias="from", description="first value")
    to: str | int | float | None = Field(default=None, description="last value")
    count: Annotated[int, Field(ge=2, le=MAX_VALUES)] | None = Field(default=None, description="number of values")
    spacing: Literal["linear", "log"] = Field(default="linear", description="spacing of the range")
    factors: tuple[Annotated[float, Field(gt=0, allow_inf_nan=False)], ...] | None = Field(
        default=None, strict=False, description="factors of the base value"
    )
    zip: dict[str, Annotated[tuple[Any, ...], Field(strict=False)]] | None = Field(
        default=None, description="lists by key that vary together"
    )
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
        axes: choices of each axis; a single axis of all, after the base scene, if axes are varied one by one.
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

    @property
    def one_by_one(self) -> bool:
        """True if axes are varied one by one instead of as a grid."""
        return self.file.combine == "one by one"

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
        """Settings of each choice of each axis that differ from the base scene, as text."""

        def settings(choice: Choice) -> list[str]:
            return [f"{key}={value!r}" for key, value in choice.items() if look_up(self.base, key) != value]

        return [list(map(settings, axis)) for axis in self.axes]

    def case_sha256(self, number: int) -> str:
        """Digest of all that the study says about a case; equal cases of several studies have the same."""
        axes = zip(self._settings, self._places(number), strict=True)
        settings = sorted(setting for axis, place in axes for setting in axis[place])
        return hashlib.sha256("\0".join((self._common_sha256, *settings)).encode()).hexdigest()[:32]

    @cached_property
    def count(self) -> int:
        """Number of cases."""
        return prod(map(len, self.axes))

    def _places(self, number: int) -> list[int]:
        """Place of a case on each axis; cases are numbered from 1, and the last axis varies fastest."""
        place, places = number - 1, []
        for axis in reversed(self.axes):
            place, here = divmod(place, len(axis))
            places.append(here)
        return places[::-1]

    def choice(self, number: int) -> Choice:
        """Varied values of a case."""
        choices = (axis[place] for axis, place in zip(self.axes, self._places(number), strict=True))
        return {key: value for choice in choices for key, value in choice.items()}

    @property
    def sample(self) -> list[int]:
        """Numbers of at most ``MAX_SAMPLE`` cases; each value of each axis occurs if there are not more."""
        longest, numbers = max(map(len, self.axes), default=1), []
        for place in range(0, longest, ceil(longest / MAX_SAMPLE)):
            number = 0
            for axis in self.axes:
                number = number * len(axis) + place % len(axis)
            numbers.append(number + 1)
        return numbers

    @cached_property
    def _base_values(self) -> dict[str, Any]:
        """Values of the base scene by column; empty if it is a scene with the varied values only."""
        with suppress(InputError):
            base = make_scene(deepcopy(self.base), self.scene.stem, self.where, self.scene.parent)
            return {name: value_at(base, key) for name, key in self.columns.items()}
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
    scene = _base_scene(file.scene, path, where)
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
            for key in choices[0]:
                for old, old_place in seen.items():
                    if f"{old}.".startswith(f"{key}.") or f"{key}.".startswith(f"{old}."):
                        found = f"{key}, which overlaps {old} of {old_place}"
                        raise InputError(where, place, found, "each key of the scene once")
            seen |= dict.fromkeys(choices[0], place)
            keys = [axis.key[0]] if axis.key else list(choices[0])
            if axis.name and len(keys) > 1:
                raise InputError(where, f"{place}.name", f"{len(keys)} columns", "a name for one column")
            for name, key in ((axis.name or key, key) for key in keys):
                names = {name, column_name(name, key)}
                if names & taken:
                    raise InputError(where, f"{place}.name", f'"{name}", the name of another column', "another name")
                columns[name] = key
                taken |= names
            axes.append(tuple(choices))
    for name in file.engines:
        with gathered(problems, where):
            load_engine(name, where, "engines")
    refuse_any(where, problems)
    for name in also:
        load_engine(name, "--engine")
    study = Study(
        file=file,
        path=path.resolve(),
        where=where,
        scene=scene,
        base=base,
        engines=tuple(dict.fromkeys((*(file.engines or installed(engine_names())), *also))),
        axes=(({}, *chain.from_iterable(axes)),) if file.combine == "one by one" else tuple(axes),
        columns=columns,
    )
    if study.count > MAX_COUNT:
        raise InputError(where, "axis", f"{study.count:.3g} cases", f"at most {MAX_COUNT:,}")
    return study


def _base_scene(source: str, study: Path, where: str) -> Path:
    """Path of the base scene, given by name in ``inputs/scenes`` or by path relative to the study file."""
    try:
        return find_scene(seen_from(study, source)).resolve()
    except (InputError, OSError, ValueError) as error:
        allowed = "the name of a scene, or a scene file relative to the study file"
        raise InputError(where, "scene", shorten(source), allowed) from error


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
    by_key: dict[str, list[str]] = {}
    for pattern in patterns:
        key, _, value = pattern.partition("=")
        known = key in study.columns
        by_key.setdefault(key if known else "", []).append(value if known else pattern)

    def text_at(key: str, number: int) -> str:
        return str(study.choice(number).get(study.columns[key], "")) if key else study.label(number)

    numbers: Sequence[int] = range(1, study.count + 1)
    for key, globs in by_key.items():
        numbers = [number for number in numbers if any(fnmatchcase(text_at(key, number), glob) for glob in globs)]
    if not numbers:
        labels = "; ".join(study.label(number) for number in range(1, min(study.count, 3) + 1))
        raise InputError(f"--only {' --only '.join(patterns)}", "", f"matches no case; labels are such as {labels}")
    return numbers


def column_name(name: str, key: str) -> str:
    """Name of a column with its unit, such as ``striker.speed_m_s``."""
    unit = unit_of(key)
    return f"{name}_{re.sub(r'[/*]', '_', unit.replace('^', ''))}" if unit else name


def in_si(key: str, value: Any) -> Any:
    """Value of a study at a key of the scene, in SI units; a table as JSON, None for a key that is removed."""
    if isinstance(value, str):
        with suppress(ValueError):
            return units.to_si(value, unit_of(key))
        return value or None
    return json.dumps(value) if isinstance(value, (dict, list)) else value


def value_at(scene: Scene, key: str) -> Any:
    """Value of a scene at a key in SI units; None if missing."""
    here = look_up(scene, key)
    if isinstance(here, BaseModel):
        return here.model_dump_json(exclude_none=True, exclude_defaults=True)
    if isinstance(here, (tuple, dict)):
        return json.dumps(here, default=lambda part: part.model_dump(exclude_none=True, exclude_defaults=True))
    return here


def expand(axis: Axis, base: dict[str, Any], folder: Path, where: str, place: str) -> list[Choice]:
    """Choices of an axis, in order.

    Args:
        axis: the axis.
        base: tables of the base scene, whose values factors multiply.
        folder: folder of the study file, to which the paths of tables are relative.
        where: study file as named in messages.
        place: key of the axis in messages.

    Raises:
        InputError: the axis is wrong or has no values.
    """
    given = {form: getattr(axis, "from_" if form == "from" else form) for form in FORMS}
    forms = [form for form, value in given.items() if value is not None]
    if len(forms) != 1:
        raise InputError(where, place, f"{', '.join(forms) or 'none of them'}", f"exactly one of {', '.join(FORMS)}")
    form, value = forms[0], given[forms[0]]
    if bool(axis.key) != (form in ("values", "from", "factors")):
        needs = "a key" if not axis.key else f"no key with {form}"
        raise InputError(where, f"{place}.key", str(list(axis.key)), needs)
    if value == ():
        raise InputError(where, f"{place}.{form}", "an empty list", f"at least one {form.removesuffix('s')}")
    match form:
        case "zip":
            return _zipped(value, where, f"{place}.zip")
        case "table":
            return _table(folder / value, where, f"{place}.table")
        case "seeds":
            return [{"seed": seed} for seed in range(1, value + 1)]
        case "factors":
            return [{key: _multiplied(base, key, factor, where, place) for key in axis.key} for factor in value]
    values = _range(axis, where, place) if form == "from" else value
    return [dict.fromkeys(axis.key, value) for value in values]


def _zipped(lists: dict[str, tuple[Any, ...]], where: str, place: str) -> list[Choice]:
    lengths = {key: len(values) for key, values in lists.items()}
    if not lists or 0 in lengths.values():
        raise InputError(where, place, "an empty list", "keys with at least one value each")
    if len(set(lengths.values())) > 1:
        found = ", ".join(f"{length} of {key}" for key, length in lengths.items())
        raise InputError(where, place, found, "lists of equal length")
    return [dict(zip(lists, row, strict=True)) for row in zip(*lists.values(), strict=True)]


def _range(axis: Axis, where: str, place: str) -> list[Any]:
    """Values from one end to the other, both included; whole numbers at both ends give whole numbers."""
    if axis.from_ is None or axis.to is None or axis.count is None:
        missing = "count" if axis.to is not None else "to"
        raise InputError(where, f"{place}.{missing}", "missing key; give from, to and count")
    low, unit = _number(axis.from_, where, f"{place}.from")
    high, other = _number(axis.to, where, f"{place}.to")
    if unit != other:
        try:
            high = units.to_si(str(axis.to), unit)
        except ValueError as error:
            allowed = f"a quantity in {unit or 'plain numbers'}, as from has"
            raise InputError(where, f"{place}.to", shorten(str(axis.to)), allowed) from error
    ends, log = f"{axis.from_} to {axis.to}", axis.spacing == "log"
    if not math.isfinite(high - low):
        raise InputError(where, f"{place}.from", shorten(ends), "a finite range")
    if log and not (low > 0 and high > 0):
        raise InputError(where, f"{place}.from", ends, 'ends above zero for spacing = "log"')
    values = (np.geomspace if log else np.linspace)(low, high, axis.count).tolist()
    if isinstance(axis.from_, int) and isinstance(axis.to, int):
        return list(dict.fromkeys(round(value) for value in values))
    return [f"{value!r} {unit}" if unit else value for value in values]


def _number(value: str | int | float, where: str, place: str) -> tuple[float, str]:
    """Number and unit of a value; the unit is empty for a plain number."""
    number, unit = str(value), ""
    if isinstance(value, str):
        match = units.NUMBER_AND_UNIT.fullmatch(value)
        if match is None:
            raise InputError(where, place, shorten(value), 'a number with its unit, such as "2 m/s", or a plain number')
        number, unit = match.groups()
    if not math.isfinite(float(number)):
        raise InputError(where, place, shorten(value), "a finite number")
    return float(number), unit


def _multiplied(base: dict[str, Any], key: str, factor: float, where: str, place: str) -> Any:
    """Value of the base scene at a key, times a factor."""
    value = look_up(base, key)
    if value is None and key.startswith("materials."):
        value = look_up(library(), key.removeprefix("materials."))
    if isinstance(value, (int, float)) and not isinstance(value, bool):
        product = float(str(value)) * factor  # by its text: float() fails for very large whole numbers
        return int(product) if isinstance(value, int) and product.is_integer() else product
    match = units.NUMBER_AND_UNIT.fullmatch(value) if isinstance(value, str) else None
    if match is None:
        found = f"{'nothing' if value is None else shorten(value)} at {key} of the base scene"
        raise InputError(where, f"{place}.factors", found, "a number or a quantity there")
    return f"{float(match.group(1)) * factor!r} {match.group(2)}"


def _table(path: Path, where: str, place: str) -> list[Choice]:
    """Rows of a CSV file; headings are keys, with a unit in brackets for columns of plain numbers."""
    shown = paths.shown(path)
    try:
        content = read_file(path, "a CSV file").decode("utf-8-sig")
        rows = [row for row in csv.reader(StringIO(content, newline=""), strict=True) if row]
    except (FileNotFoundError, ValueError, csv.Error) as error:
        found = "no such file" if isinstance(error, FileNotFoundError) else str(error)
        raise InputError(where, place, f"{shown}: {found}", "a readable CSV file") from error
    if len(rows) < 2:
        raise InputError(shown, "", f"{len(rows)} lines", "a line of keys and at least one line of values")
    columns: dict[str, str] = {}
    for heading in rows[0]:
        match = HEADING.fullmatch(heading.strip())
        if match is None:
            raise InputError(shown, "line 1", shorten(heading), "a key of the scene, such as striker.speed [m/s]")
        if match["key"].strip() in columns:
            raise InputError(shown, "line 1", "a key twice", "each key once")
        columns[match["key"].strip()] = match["unit"] or ""
    choices = []
    for number, row in enumerate(rows[1:], start=2):
        if len(row) != len(columns):
            raise InputError(shown, f"line {number}", f"{len(row)} values", f"{len(columns)}, one for each key")
        cells = zip(columns.items(), row, strict=True)
        choices.append({key: _cell(cell.strip(), unit, shown, f"line {number}, {key}") for (key, unit), cell in cells})
    return choices


def _cell(text: str, unit: str, where: str, place: str) -> Any:
    if not unit:
        if not text:
            raise InputError(where, place, "empty cell; give a value")
        return read_value(text)
    with suppress(ValueError):
        if math.isfinite(float(text)):
            return f"{text} {unit}"
    raise InputError(where, place, shorten(text), f"a plain number, since the heading has its unit ({unit})")
