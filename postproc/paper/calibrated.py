"""Parameters of the chains with dissipation, from ``inputs/paper/calibrated.toml``."""

from functools import cache
from typing import Annotated

from pydantic import Field

from drivers.base import paths
from drivers.base.messages import validate
from drivers.scene.model import Part
from drivers.scene.read_scene import read_toml
from postproc.paper.quoted import Positive


class CalibratedParameter(Part):
    """A key of a scene with its fitted value and standard error, in the SI unit of the key.

    ``low`` and ``high`` bound the fits of all laws, over all readings of the paper, that hold.
    """

    key: str
    unit: str = ""
    value: Positive
    error: Positive
    low: Positive
    high: Positive


class Calibrated(Part):
    """The file: a law of dissipation, the reading of the paper for which it was fitted, and the parameters found.

    Attributes:
        findings: sentences on the fits of all readings.
        cuts: cut at which durations are read, chi-square, degrees of freedom, probability, and restitution.
    """

    law: str
    reading: str
    findings: Annotated[tuple[str, ...], Field(strict=False)]
    cuts: Annotated[tuple[Annotated[tuple[str, ...], Field(strict=False)], ...], Field(strict=False)]
    parameter: Annotated[tuple[CalibratedParameter, ...], Field(strict=False, min_length=1)]

    @property
    def settings(self) -> tuple[str, ...]:
        """Settings for a scene."""
        return tuple(f"{parameter.key}={parameter.value!r} {parameter.unit}".rstrip() for parameter in self.parameter)


@cache
def calibrated() -> Calibrated:
    """The content of the file.

    Raises:
        InputError: the file is wrong.
    """
    return validate(Calibrated, read_toml(paths.CALIBRATED), paths.shown(paths.CALIBRATED))
