"""The file ``inputs/calibration.toml``: ranges of parameters, quoted data, and the fits of ``make calibration``."""

from functools import cache
from typing import Annotated, Literal

from pydantic import Field

from drivers.base import paths
from drivers.base.messages import validate
from drivers.scene.model import Part
from drivers.scene.read_scene import read_toml


class Range(Part):
    """Range of a parameter; quantities are text such as "1 GPa"."""

    low: str | float
    high: str | float
    start: str | float | None = None
    because: str


class QuotedNumber(Part):
    """A number of ``inputs/paper/quoted.toml`` as a datum; ``scale`` converts it to the observable's unit."""

    observable: str
    quoted: str
    scale: float = 1.0
    error: Literal["force", "speed"] | Annotated[float, Field(gt=0, allow_inf_nan=False)]
    fitted: bool = True
    because: str = ""


class QuotedSet(Part):
    """Quoted data of a scene; a list of numbers gives one data set per row.

    ``also`` maps a data set to the row with the same experiment; this row is left out if both are fitted.
    """

    name: str
    scene: str
    set: tuple[str, ...] = Field(default=(), strict=False)
    own: tuple[str, ...] = Field(default=(), strict=False)
    also: dict[str, int] = Field(default_factory=dict)
    number: Annotated[tuple[QuotedNumber, ...], Field(strict=False, min_length=1)]


class Law(Part):
    """A contact law, given by settings, and its free parameters."""

    name: str
    set: Annotated[tuple[str, ...], Field(strict=False)] = ()
    free: Annotated[tuple[str, ...], Field(strict=False)]


class CalibrationFile(Part):
    """The whole file; the short form fits the ``quick`` laws to the first and last selection.

    Attributes:
        range: ranges by key of the scene, or by the last part of a key.
    """

    range: dict[Annotated[str, Field(min_length=1)], Range]
    set: Annotated[tuple[QuotedSet, ...], Field(strict=False, min_length=1)]
    selections: Annotated[tuple[str, ...], Field(strict=False, min_length=1)]
    quick: Annotated[tuple[str, ...], Field(strict=False, min_length=1)]
    law: Annotated[tuple[Law, ...], Field(strict=False, min_length=1)]


@cache
def calibration_file() -> CalibrationFile:
    """Contents of the file.

    Raises:
        InputError: the file has errors.
    """
    return validate(CalibrationFile, read_toml(paths.CALIBRATION), paths.shown(paths.CALIBRATION))
