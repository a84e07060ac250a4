"""Studies: a base scene, axes of varied values, engines, and tabulated observables."""

import json
import pickle
import re
from collections.abc import Mapping, Sequence
from contextlib import suppress
from copy import deepcopy
from dataclasses import dataclass
from fnmatch import fnmatchcase
from functools import cache, cached_property, partial
from itertools import chain, product
from math import ceil, isfinite, nan, prod
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import BaseModel, BeforeValidator, Field

from drivers.base import paths, units
from drivers.base.cache import content_of
from drivers.base.errors import InputError, InputProblem, gathered, refuse_any
from drivers.base.files import read_file, readable, sha256_in
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
RANGE = ("from", "to", "count")
FORMS = ("values", "factors", "zip", "seeds", "table")
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
    """Table ``[[axis]]`` of a study file, in one of several forms.

    ``key`` with ``values``, with ``from``, ``to``, ``count`` and ``spacing``, or with both, which are put in order;
    ``key`` with ``factors`` of the base scene's value. With several keys all get the same value. ``zip``: lists of
    equal length, one for each key. ``seeds``: number of random draws. ``table``: a CSV file with a column for each key
    and a row for each case.
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
    def count(self) -> int:
        """Number of cases, which are numbered from 1; the last axis varies fastest."""
        return prod(map(len, self.axes))

    @cached_property
    def _common_sha256(self) -> str:
        """Digest of all that the cases have in common: base scene, materials, files that the scenes name."""
        named = {look_up(self.base, "drive.file")}
        for choice in chain.from_iterable(self.axes):
            named |= {choice.get("drive.file"), look_up(choice.get("drive"), "file")}
        files = [path for name in named if isinstance(name, str) and readable(path := self.scene.parent / name)]
        return sha256_in(f"{self.base}\0{library()}\0{content_of(files)}")

    def digests(self, numbers: Sequence[int]) -> list[str]:
        """Digest of all that the study says about each case; equal cases of several studies have the same."""
        base = cache(partial(look_up, self.base))

        def digest(number: int) -> str:
            changed = [f"{key}={value!r}" for key, value in self.choice(number).items() if base(key) != value]
            return sha256_in("\0".join((self._common_sha256, *sorted(changed))))[:32]

        return [*map(digest, numbers)]

    def choice(self, number: int) -> Choice:
        """Varied values of a case."""
        place, choice = number - 1, Choice()
        for axis in reversed(self.axes):
            place, index = divmod(place, len(axis))
            choice = axis[index] | choice
        return choice

    @property
    def sample(self) -> list[int]:
        """Numbers of at most ``MAX_SAMPLE`` cases; each value of each axis occurs if there are not more."""
        shape = tuple(map(len, self.axes))
        places = np.arange(0, max(shape), ceil(max(shape) / MAX_SAMPLE))
        return [1 + int(place) for place in np.ravel_multi_index([places] * len(shape), shape, mode="wrap")]

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
    axes, columns, problems = [], dict[str, str](), list[InputProblem]()
    taken, seen = {*RESERVED}, dict.fromkeys(file.set, "set")  # names with and without units; keys
    for i, axis in enumerate(file.axis):
        place = f"axis.{i}"
        with gathered(problems, where):
            choices = expand(axis, base, path.parent, where, place)
            for key, (old, old_place) in product(choices[0], seen.items()):
                if f"{old}.".startswith(f"{key}.") or f"{key}.".startswith(f"{old}."):
                    found = f"{key}, which overlaps {old} of {old_place}"
                    raise InputError(where, place, found, "each key of the scene once")
            seen |= dict.fromkeys(choices[0], place)
            for key in axis.key[:1] or choices[0]:
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
    given = axis.model_dump(by_alias=True, exclude_none=True)
    forms = [form for form in (*RANGE, *FORMS) if form in given]
    ranged = {*RANGE} <= {*forms} <= {*RANGE, "values"}
    if not ranged and (len(forms) != 1 or forms[0] in RANGE):
        allowed = f"exactly one of {', '.join(FORMS)}, or from with to, count and perhaps values"
        raise InputError(where, place, ", ".join(forms) or "none of them", allowed)
    if bool(axis.key) != bool(ranged or forms[0] in ("values", "factors")):
        raise InputError(where, f"{place}.key", str(list(axis.key)), f"{'no' if axis.key else 'a'} key with {forms[0]}")
    columns: Mapping[str, Sequence[Any]] = axis.zip or {"seed": range(1, 1 + (axis.seeds or 0))}
    if ranged:
        columns = dict.fromkeys(axis.key, _range(axis, where, place))
    elif axis.values is not None:
        columns = dict.fromkeys(axis.key, axis.values)
    elif axis.factors is not None:
        columns = {key: _multiplied(base, key, axis.factors, where, place) for key in axis.key}
    elif axis.table is not None:
        columns = _table(folder / axis.table, where, f"{place}.table")
    lengths = {key: len(values) for key, values in columns.items()}
    if len({*lengths.values()}) != 1 or not all(lengths.values()):
        found = ", ".join(f"{length} of {key}" for key, length in lengths.items()) or "an empty list"
        raise InputError(where, f"{place}.{forms[0]}", found, "at least one value, and equally many for each key")
    return tuple(dict(zip(columns, row, strict=True)) for row in zip(*columns.values(), strict=True))


def _number_and_unit(value: Any) -> tuple[float, str]:
    """Number and unit of a value, empty for a plain number; ValueError for others."""
    quantity = units.NUMBER_AND_UNIT.fullmatch(str(value))
    return (float(quantity[1]), quantity[2]) if quantity else (float(str(value)), "")  # float(int) fails if huge


def _range(axis: Axis, where: str, place: str) -> list[Any]:
    """Values from one end to the other, both included, and ``values`` at their places; without doubles.

    Whole numbers at both ends give whole numbers.
    """
    ends, log, unit, numbers = (axis.from_, axis.to), axis.spacing == "log", "", [nan, nan]
    with suppress(ValueError):
        unit = _number_and_unit(axis.from_)[1]
        texts = map(str, (*ends, *(axis.values or ())))
        numbers = [units.to_si(text, unit) if unit else float(text) for text in texts]
    low, high, *more = numbers
    if not all(map(isfinite, (high - low, *more))) or (log and min(numbers) <= 0):
        allowed = f'numbers, or quantities of one kind such as "2 m/s"; finite{", above zero" * log}'
        raise InputError(where, f"{place}.from", shorten(", ".join(map(str, (*ends, *(axis.values or ()))))), allowed)
    between = (np.geomspace if log else np.linspace)(low, high, axis.count or 0).tolist()
    if all(isinstance(end, int) for end in ends):
        between = [*map(round, between)]
    values = [f"{value!r} {unit}" if unit else value for value in between]
    pairs = zip((*more, *between), (*(axis.values or ()), *values), strict=True)
    by_number = {float(f"{number:.12g}"): value for number, value in pairs}  # equal but for rounding
    return [by_number[number] for number in sorted(by_number, reverse=high < low)]


def _multiplied(base: dict[str, Any], key: str, factors: Sequence[float], where: str, place: str) -> list[Any]:
    """Products of the value of the base scene at a key, or of that of the library of materials, and factors."""
    value = look_up(base, key)
    value = look_up({"materials": library()}, key) if value is None else value
    try:
        number, unit = _number_and_unit(value)
    except ValueError as error:
        found = f"{'nothing' if value is None else shorten(value)} at {key} of the base scene"
        raise InputError(where, f"{place}.factors", found, "a number or a quantity there") from error
    products = [number * factor for factor in factors]
    if unit:
        return [f"{one!r} {unit}" for one in products]
    return [int(one) if isinstance(value, int) and one.is_integer() else one for one in products]


def _table(path: Path, where: str, place: str) -> dict[str, list[Any]]:
    """Columns of a CSV file; headings are keys, with a unit in brackets for columns of plain numbers."""
    shown = paths.shown(path)
    try:
        lines = [line for line in read_file(path, "a CSV file").decode("utf-8-sig").splitlines() if line.strip()]
        if len(lines) < 2 or lines[0].count(",") >= MAX_KEYS:
            raise ValueError(f"{len(lines)} lines of {lines[0].count(',') + 1 if lines else 0} cells")
        rows = np.loadtxt(lines, str, comments=None, delimiter=",", quotechar='"', ndmin=2).tolist()
    except (FileNotFoundError, ValueError) as error:
        found = "no such file" if isinstance(error, FileNotFoundError) else str(error).partition("; use")[0]
        allowed = f"a CSV file: a line of at most {MAX_KEYS} keys and at least one line of values, one for each key"
        raise InputError(f"{where}: {place}: {shown}", "", found, allowed) from error
    columns: dict[str, list[Any]] = {}
    for heading, *cells in zip(*rows, strict=True):
        match = HEADING.fullmatch(heading.strip())
        key, unit = (match["key"].strip(), match["unit"]) if match else ("", "")
        if not key or key in columns:
            raise InputError(shown, "line 1", shorten(heading), "each key once, such as striker.speed [m/s]")
        columns[key] = [f"{cell.strip()} {unit}" if unit else read_value(cell) for cell in cells]
        for number, value in enumerate(columns[key], start=2):
            if value == "" or (unit and not units.NUMBER_AND_UNIT.fullmatch(value)):
                allowed = f"a plain number, since the heading has its unit ({unit})" if unit else "a value"
                raise InputError(shown, f"line {number}, {key}", shorten(cells[number - 2].strip()), allowed)
    return columns
