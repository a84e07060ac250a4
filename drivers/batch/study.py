"""A study: one base scene, what is varied over it, on which engines, what is tabulated, and what is selected of it."""

import json
import pickle
import re
from collections.abc import Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase
from functools import cached_property
from math import prod
from pathlib import Path
from typing import Any, Literal

from pydantic import BaseModel, Field

from drivers.base import paths, units
from drivers.base.errors import InputError
from drivers.base.messages import shorten, validate
from drivers.batch.axes import Axis, Choice, expand
from drivers.chain.case import Case, build_case
from drivers.engines import engine_names, installed, load_engine
from drivers.scene.model import Part, Scene
from drivers.scene.read_scene import find_input, find_scene, make_scene, read_toml, set_value
from drivers.scene.settings import look_up, unit_of

RESERVED = ("case", "engine", "status", "reason", "force_error_share")  # columns that every table has


class StudyFile(Part):
    """A study as its file holds it.

    Attributes:
        set: laid over the base scene in every case.
        engines: in the order of the table; all that are installed where there are none.
        observables: patterns of the observables to tabulate.
        figure: observables that its figure shows.
        combine: whether axes make a grid, the last one varying fastest, or are varied ``one by one`` about the base
            scene, which is then the first case.
        limit: time limit of a case in seconds; None: by its size.
        unsafe: runs what guards refuse, such as time steps beyond the stability limit.
    """

    title: str = ""
    scene: str
    set: dict[str, Any] = Field(default_factory=dict)
    engines: tuple[str, ...] = Field(default=(), strict=False)
    observables: tuple[str, ...] = Field(default=("*",), strict=False)
    figure: tuple[str, ...] = Field(default=(), strict=False)
    combine: Literal["grid", "one by one"] = "grid"
    limit: units.Duration | None = None
    unsafe: bool = False
    axis: tuple[Axis, ...] = Field(default=(), strict=False)


@dataclass(frozen=True)
class Study:
    """A study ready to be run.

    Attributes:
        path: of its file; ``where``: as messages name it.
        scene: path of the base scene.
        base: the base scene's tables with ``set`` laid over them.
        library: the tables of ``inputs/materials.toml``.
        engines: in the order of the table.
        axes: the choices of each axis.
        columns: scene key by the name of its column, without units.
    """

    file: StudyFile
    path: Path
    where: str
    scene: Path
    base: dict[str, Any]
    library: dict[str, Any]
    engines: tuple[str, ...]
    axes: tuple[tuple[Choice, ...], ...]
    columns: dict[str, str]

    @property
    def name(self) -> str:
        """Name of its file, without the ending."""
        return self.path.stem

    @property
    def one_by_one(self) -> bool:
        """Whether axes are varied one by one instead of as a grid."""
        return self.file.combine == "one by one"

    @cached_property
    def count(self) -> int:
        """How many cases there are."""
        lengths = [len(axis) for axis in self.axes]
        return 1 + sum(lengths) if self.one_by_one else prod(lengths)

    def choice(self, number: int) -> Choice:
        """The values of a case; cases are numbered from 1."""
        if self.one_by_one:
            place = number - 2
            for axis in self.axes:
                if 0 <= place < len(axis):
                    return axis[place]
                place -= len(axis)
            return {}
        place = number - 1
        chosen = []
        for axis in reversed(self.axes):
            place, here = divmod(place, len(axis))
            chosen.append(axis[here])
        return {key: value for part in reversed(chosen) for key, value in part.items()}

    def label(self, number: int) -> str:
        """A case in words: its values, each by the first key of its column."""
        choice = self.choice(number)
        values = [f"{name}={choice[key]}" for name, key in self.columns.items() if key in choice]
        return ", ".join(values) or "base"

    def case(self, number: int) -> Case:
        """A case made ready for any engine.

        Raises:
            InputError: the scene with the case's values is wrong.
        """
        where = f"{self.where}: case {number} ({shorten(self.label(number)).strip(chr(34))})"
        # a deep copy, in a fifth of the time
        data, choice = pickle.loads(pickle.dumps((self.base, self.choice(number))))
        for key, value in choice.items():
            set_value(data, key, value, where)
        return build_case(make_scene(data, self.library, self.scene.stem, where))


def read_study(source: str | Path, also: Sequence[str] = ()) -> Study:
    """The study of a file, given by its path or by the name of one in ``inputs/studies``, ``also`` on these engines.

    Raises:
        InputError: anything wrong with the file, its axes, or its base scene, or no such engine.
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
    seen = dict.fromkeys(file.set, "set")
    for i, axis in enumerate(file.axis):
        place = f"axis.{i}"
        choices = expand(axis, base, path.parent, where, place)
        for key in choices[0]:
            for old in seen:
                if f"{old}.".startswith(f"{key}.") or f"{key}.".startswith(f"{old}."):
                    raise InputError(where, place, f"{key} beside {old} of {seen[old]}", "each key of the scene once")
        seen |= dict.fromkeys(choices[0], place)
        keys = [axis.key[0]] if axis.key else list(choices[0])
        if axis.name and len(keys) > 1:
            raise InputError(where, f"{place}.name", f"{len(keys)} columns", "a name for one column")
        for name, key in ((axis.name or key, key) for key in keys):
            if name in columns or name in RESERVED:
                raise InputError(where, f"{place}.name", f'"{name}", a column already', "another name")
            columns[name] = key
        axes.append(tuple(choices))
    for name in file.engines:
        load_engine(name, where, "engines")
    for name in also:
        load_engine(name, "--engine")
    return Study(
        file=file,
        path=path.resolve(),
        where=where,
        scene=scene,
        base=base,
        library=read_toml(paths.MATERIALS),
        engines=tuple(dict.fromkeys((*(file.engines or installed(engine_names())), *also))),
        axes=tuple(axes),
        columns=columns,
    )


def _base_scene(source: str, study: Path, where: str) -> Path:
    """The base scene: by its name in ``inputs/scenes``, or as a path from the study file's folder."""
    try:
        return find_scene(seen_from(study, source)).resolve()
    except (InputError, OSError, ValueError) as error:
        allowed = "a scene file, as seen from the study, or the name of a scene"
        raise InputError(where, "scene", shorten(source), allowed) from error


def seen_from(file: Path, source: str) -> str | Path:
    """A name in ``inputs`` as it is, any other source as a path from the file's folder."""
    return source if "." not in source and "/" not in source else file.parent / source


@dataclass(frozen=True)
class Selection:
    """Engines in the order of the study, and numbers of cases."""

    engines: tuple[str, ...]
    numbers: Sequence[int]

    def slice_of(self, part: int, parts: int) -> Sequence[int]:
        """The cases of a part, counted from 1: every so many-th, so that parts cost about the same."""
        return self.numbers[part - 1 :: parts]

    def slices_with_work(self, todo: list[int], parts: int) -> list[int]:
        """Which of the parts hold a case that is not done."""
        places = {number: place for place, number in enumerate(self.numbers)}
        return sorted({places[number] % parts + 1 for number in todo})


def select(study: Study, engines: Sequence[str], patterns: Sequence[str]) -> Selection:
    """The engines and cases that are asked for; without engines or patterns all of them.

    A pattern is ``KEY=GLOB`` on the value that the study has there, or a glob on the case's whole label. Patterns of
    one key add up, different keys narrow down.

    Raises:
        InputError: no case that matches.
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
        raise InputError(f"--only {' --only '.join(patterns)}", "", "no case", f"patterns of labels such as {labels}")
    chosen = tuple(name for name in study.engines if name in engines or not engines)
    return Selection(chosen, numbers)


def column_name(name: str, key: str) -> str:
    """A column's name with its unit, such as ``striker.speed_m_s``."""
    unit = unit_of(key)
    return f"{name}_{re.sub(r'[/*]', '_', unit.replace('^', ''))}" if unit else name


def value_at(scene: Scene, key: str) -> Any:
    """Value of a scene at a key, in SI units; None where there is none."""
    here = look_up(scene, key)
    if isinstance(here, BaseModel):
        return here.model_dump_json(exclude_none=True, exclude_defaults=True)
    if isinstance(here, (tuple, dict)):
        return json.dumps(here, default=lambda part: part.model_dump(exclude_none=True, exclude_defaults=True))
    return here
