"""Numbers of the paper: those that it quotes, and the parameters fitted to them for its chains with dissipation."""

from functools import cache
from typing import Annotated, Any

import numpy as np
from pydantic import Field

from drivers.base import paths
from drivers.base.errors import InputError
from drivers.base.messages import validate
from drivers.scene.model import Part, Positive
from drivers.scene.read_scene import read_toml

Column = Annotated[tuple[float, ...], Field(strict=False, min_length=5, max_length=5)]
Texts = Annotated[tuple[str, ...], Field(strict=False)]


class Quoted(Part, extra="allow"):
    """Content of ``inputs/paper/quoted.toml``: Table 1 by column, and numbers named after their figure or part.

    ``accuracy_`` numbers are relative accuracies of measurements, and the position of a sensor; ``sensor_`` numbers are
    of a sensor bead: both caps together, and the square plate of the gauge between them. The brass plate lies on the
    gauge below the chain. The moduli are those of the paper's calculations, the bulk sound speeds give two of them.
    """

    __pydantic_extra__: dict[str, float | Annotated[tuple[float, ...], Field(strict=False)]]
    table1: dict[str, Column]

    def __getattr__(self, key: str) -> Any:
        """Number, or numbers, of a key; an InputError if the file lacks it."""
        if key not in self.__pydantic_extra__:
            raise InputError(paths.shown(paths.QUOTED), key, "missing key")
        return self.__pydantic_extra__[key]

    @property
    def sensor_mass_g(self) -> float:
        """Mass of the whole sensor bead in g."""
        return float(self.sensor_caps_g + self.sensor_gauge_g)


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
    """Content of ``inputs/paper/calibrated.toml``: a law of dissipation, its parameters, and what all fits show.

    Attributes:
        reading: the reading of the paper for which the law was fitted.
        findings: sentences on the fits of all readings.
        cuts: cut at which durations are read, chi-square, degrees of freedom, probability, and restitution.
    """

    law: str
    reading: str
    findings: Texts
    cuts: Annotated[tuple[Texts, ...], Field(strict=False)]
    parameter: Annotated[tuple[CalibratedParameter, ...], Field(strict=False, min_length=1)]

    @property
    def settings(self) -> tuple[str, ...]:
        """Settings for a scene."""
        return tuple(f"{parameter.key}={parameter.value!r} {parameter.unit}".rstrip() for parameter in self.parameter)


@cache
def quoted() -> Quoted:
    """Content of the file of quoted numbers.

    Raises:
        InputError: The file is wrong.
    """
    return validate(Quoted, read_toml(paths.QUOTED), paths.QUOTED)


@cache
def calibrated() -> Calibrated:
    """Content of the file of calibrated parameters.

    Raises:
        InputError: The file is wrong.
    """
    return validate(Calibrated, read_toml(paths.CALIBRATED), paths.CALIBRATED)


def force_accuracy(force_N: float) -> float:
    """Relative accuracy of a measured amplitude.

    Linear in the logarithm of the force, between the accuracies quoted for the largest and smallest force of Table 1.
    """
    paper = quoted()
    ends = np.log([min(paper.table1["force_N"]), max(paper.table1["force_N"])])
    return float(np.interp(np.log(force_N), ends, [paper.accuracy_force_small, paper.accuracy_force_large]))
