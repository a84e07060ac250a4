"""Studies: a base scene, axes of varied values, engines, and tabulated observables."""

import hashlib
import json
import pickle
import re
from collections.abc import Sequence
from contextlib import suppress
from copy import deepcopy
from dataclasses import dataclass
from fnmatch import fnmatchcase
from functools import cached_property
from itertools import chain
from math import ceil, prod
from pathlib import Path
from typing import Any, Literal

import numpy as np
from pydantic import BaseModel, Field

from drivers.base import paths, units
from drivers.base.cache import content_of
from drivers.base.errors import InputError, InputProblem, gathered, refuse_any
from drivers.base.files import readable
from drivers.base.messages import shorten, validate
from drivers.batch.axes import Axis, Choice, expand
from drivers.chain.case import Case, build_case
from drivers.engines import engine_names, installed, load_engine
from drivers.scene.model import Part, Scene, Title
from drivers.scene.read_scene import find_input, find_scene, library, make_scene, read_toml, set_value
from drivers.scene.settings import look_up, unit_of

MAX_SAMPLE = 100  # cases that are checked before the first one runs
RESERVED = ("case", "engine", "status", "reason", "force_error_share")  # columns of every table


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

    def _places(self, number: int) -> tuple[Any, ...]:
        """Place of a case on each axis; cases are numbered from 1, and the last axis varies fastest."""
        return np.unravel_index(number - 1, [len(axis) for axis in self.axes])

    def choice(self, number: int) -> Choice:
        """Varied values of a case."""
        choices = (axis[place] for axis, place in zip(self.axes, self._places(number), strict=True))
        return {key: value for choice in choices for key, value in choice.items()}

    @property
    def sample(self) -> list[int]:
        """Numbers of at most ``MAX_SAMPLE`` cases; each value of each axis occurs if there are not more."""
        lengths = [len(axis) for axis in self.axes]
        longest = max(lengths, default=1)
        places = range(0, longest, ceil(longest / MAX_SAMPLE))
        return [1 + int(np.ravel_multi_index([place] * len(lengths), lengths, mode="wrap")) for place in places]

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
    return Study(
        file=file,
        path=path.resolve(),
        where=where,
        scene=scene,
        base=base,
        engines=tuple(dict.fromkeys((*(file.engines or installed(engine_names())), *also))),
        axes=(({}, *chain.from_iterable(axes)),) if file.combine == "one by one" else tuple(axes),
        columns=columns,
    )


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
