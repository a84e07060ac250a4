"""Data sets: scenes with numbers or traces that were measured of them."""

from collections.abc import Sequence
from copy import deepcopy
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field

from drivers.base import paths
from drivers.base.errors import InputError
from drivers.base.messages import validate
from drivers.scene.model import Part, Scene
from drivers.scene.read_scene import find_scene, lay_over, make_scene, read_toml
from drivers.scene.settings import look_up, unit_of
from postproc.paper.quoted import force_accuracy, quoted


@dataclass(frozen=True)
class Number:
    """A measured number.

    Attributes:
        observable: its name in ``postproc.read.observables``.
        value, error: in the observable's unit, with the standard error.
        fitted: whether it is fitted, or only predicted.
        because: why the error is what it is, where it was not measured.
    """

    observable: str
    value: float
    error: float
    fitted: bool = True
    because: str = ""


@dataclass(frozen=True, eq=False)
class DataSet:
    """A scene and what was measured of it.

    Attributes:
        source: the scene, by its name or the path of its file.
        tables: of the scene's file, settings laid over.
        own: keys that are free in this data set by itself.
    """

    name: str
    source: str
    tables: dict[str, Any]
    where: str
    numbers: tuple[Number, ...] = ()
    own: tuple[str, ...] = ()

    @property
    def lines(self) -> int:
        """Coefficients of base lines that are fitted to its traces."""
        return 0

    def text(self, key: str, value: float) -> Any:
        """A value as the scene's file holds it: with its unit, or a plain number."""
        unit = unit_of(key)
        return f"{value!r} {unit}" if unit else value

    @property
    def scene(self) -> Scene:
        """The scene as its file has it."""
        return make_scene(deepcopy(self.tables), library(), self.name, self.where)


@cache
def library() -> dict[str, Any]:
    """Tables of the shipped materials."""
    return read_toml(paths.MATERIALS)


class QuotedNumber(Part):
    """A number of ``inputs/paper/quoted.toml`` as a datum; ``scale`` turns it into the observable's unit."""

    observable: str
    quoted: str
    scale: float = 1.0
    error: Literal["force", "speed"] | Annotated[float, Field(gt=0, allow_inf_nan=False)]
    fitted: bool = True
    because: str = ""


class QuotedSet(Part):
    """What the paper quotes of a scene; a list of numbers makes a data set of each of its rows.

    ``also`` names a data set that is the same experiment as a row, which is left out where both are fitted.
    """

    name: str
    scene: str
    set: tuple[str, ...] = Field(default=(), strict=False)
    own: tuple[str, ...] = Field(default=(), strict=False)
    also: dict[str, int] = Field(default_factory=dict)
    number: Annotated[tuple[QuotedNumber, ...], Field(strict=False, min_length=1)]


class _Sets(Part):
    set: Annotated[tuple[QuotedSet, ...], Field(strict=False, min_length=1)]


@cache
def quoted_sets() -> dict[str, QuotedSet]:
    """What the paper quotes as data, by name.

    Raises:
        InputError: the file is wrong.
    """
    tables = {"set": read_toml(paths.CALIBRATION).get("set", [])}
    return {each.name: each for each in validate(_Sets, tables, paths.shown(paths.CALIBRATION)).set}


def paper_data(names: Sequence[str], settings: Sequence[str]) -> list[DataSet]:
    """Data sets that the paper quotes, settings laid over their scenes.

    Raises:
        InputError: there is no such data set, or no such setting.
    """
    known, found = quoted_sets(), list[DataSet]()
    for name in names:
        if name not in known:
            raise InputError("--quoted", "", name, f"names with commas between them, of {', '.join(known)}")
        each = known[name]
        columns = [_column(number) for number in each.number]
        skipped = {row for other, row in each.also.items() if other in names}
        _, tables, where = scene_tables(each.scene, (*each.set, *settings))
        for row in range(max(map(len, columns))):
            if row not in skipped:
                numbers = tuple(column[min(row, len(column) - 1)] for column in columns)
                label = f"{name} row {row + 1}" if max(map(len, columns)) > 1 else name
                found.append(DataSet(label, each.scene, tables, where, numbers, each.own))
    return found


def _column(number: QuotedNumber) -> list[Number]:
    """The numbers of a list in ``quoted.toml``, or of the one number there."""
    stored = look_up(quoted(), number.quoted)
    values = stored if isinstance(stored, tuple) else (stored,)
    if not all(isinstance(value, (int, float)) for value in values):
        raise InputError(
            paths.shown(paths.CALIBRATION), "quoted", number.quoted, "a number of inputs/paper/quoted.toml"
        )
    accuracy = {"force": force_accuracy, "speed": lambda value: quoted().accuracy.speed}
    shares = [accuracy[number.error](value) if isinstance(number.error, str) else number.error for value in values]
    scaled = [value * number.scale for value in values]
    return [
        Number(number.observable, value, abs(value) * share, number.fitted, number.because)
        for value, share in zip(scaled, shares, strict=True)
    ]


def scene_tables(source: str, settings: Sequence[str]) -> tuple[str, dict[str, Any], str]:
    """Name, tables and place of a scene with settings laid over it.

    Raises:
        InputError: there is no such scene or setting.
    """
    path = find_scene(source)
    tables = read_toml(path)
    for setting in settings:
        lay_over(tables, setting)
    return path.stem, tables, paths.shown(path)


def scene_data(source: str, settings: Sequence[str], measured: Path | None) -> DataSet:
    """What was measured of a scene: its ``[[measured]]`` entries, or one file in their place."""
    raise NotImplementedError
