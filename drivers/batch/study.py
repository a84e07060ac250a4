"""A study: one base scene, what is varied over it, on which engines, and what is tabulated."""

import pickle
from dataclasses import dataclass
from functools import cached_property
from math import prod
from pathlib import Path
from typing import Any, Literal

from pydantic import Field

from drivers.base import paths, units
from drivers.base.errors import InputError
from drivers.base.messages import shorten, validate
from drivers.batch.axes import Axis, Choice, expand
from drivers.chain.case import Case, build_case
from drivers.engines import engine_names, installed
from drivers.scene.model import Part
from drivers.scene.overrides import set_value
from drivers.scene.read_scene import find_input, find_scene, make_scene, read_toml

RESERVED = ("case", "engine", "status", "reason", "force_error_share")  # columns that every table has


class StudyFile(Part):
    """A study as its file holds it.

    ``set`` is laid over the base scene in every case. ``combine`` says whether axes make a grid, the last one
    varying fastest, or are varied ``one by one`` about the base scene, which is then the first case. ``unsafe`` runs
    what guards refuse.
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
        name: of its file, without the ending.
        path: of its file; ``where``: as messages name it.
        scene: path of the base scene.
        base: the base scene's tables with ``set`` laid over them.
        library: the tables of ``inputs/materials.toml``.
        engines: in the order of the table; all that are installed where the file names none.
        observables: patterns of the observables to tabulate.
        figure: observables that its figure shows.
        limit_s: time limit of a case; None: by its size.
        unsafe: runs what guards refuse, such as time steps beyond the stability limit.
        axes: the choices of each axis.
        one_by_one: axes are varied one by one instead of as a grid.
        columns: scene key by the name of its column, without units.
    """

    name: str
    path: Path
    where: str
    title: str
    scene: Path
    base: dict[str, Any]
    library: dict[str, Any]
    engines: tuple[str, ...]
    observables: tuple[str, ...]
    figure: tuple[str, ...]
    limit_s: float | None
    unsafe: bool
    axes: tuple[tuple[Choice, ...], ...]
    one_by_one: bool
    columns: dict[str, str]

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
        data, choice = pickle.loads(
            pickle.dumps((self.base, self.choice(number)))
        )  # a deep copy, in a fifth of the time
        for key, value in choice.items():
            set_value(data, key, value, where)
        return build_case(make_scene(data, self.library, self.scene.stem, where))


def find_study(source: str | Path) -> Path:
    """The path of a study file, given by path or by the name of one in ``inputs/studies``.

    Raises:
        InputError: there is none.
    """
    return find_input(source, paths.STUDIES, "study")


def read_study(source: str | Path) -> Study:
    """The study of a file.

    Raises:
        InputError: anything wrong with the file, its axes, or its base scene.
    """
    path = find_study(source)
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
            clash = next(
                (old for old in seen if f"{old}.".startswith(f"{key}.") or f"{key}.".startswith(f"{old}.")), None
            )
            if clash is not None:
                raise InputError(where, place, f"{key} beside {clash} of {seen[clash]}", "each key of the scene once")
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
        if name not in engine_names():
            raise InputError(where, "engines", f'"{name}"', ", ".join(engine_names()))
    return Study(
        name=path.stem,
        path=path.resolve(),
        where=where,
        title=file.title,
        scene=scene,
        base=base,
        library=read_toml(paths.MATERIALS),
        engines=tuple(dict.fromkeys(file.engines)) or installed(engine_names()),
        observables=file.observables,
        figure=file.figure,
        limit_s=file.limit,
        unsafe=file.unsafe,
        axes=tuple(axes),
        one_by_one=file.combine == "one by one",
        columns=columns,
    )


def _base_scene(source: str, study: Path, where: str) -> Path:
    """The base scene: by its name in ``inputs/scenes``, or as a path from the study file's folder."""
    try:
        return find_scene(source if "." not in source and "/" not in source else study.parent / source).resolve()
    except (InputError, OSError, ValueError) as error:
        allowed = "a scene file, as seen from the study, or the name of a scene"
        raise InputError(where, "scene", shorten(source), allowed) from error
