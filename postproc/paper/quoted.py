"""Numbers that the paper quotes, from ``inputs/paper/quoted.toml``."""

from functools import cache
from typing import Annotated

import numpy as np
import pandas as pd
from pydantic import Field

from drivers.base import paths
from drivers.base.errors import InputError
from drivers.base.messages import validate
from drivers.scene.model import Part
from drivers.scene.read_scene import read_toml

Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
Negative = Annotated[float, Field(lt=0, allow_inf_nan=False)]
Column = Annotated[tuple[Positive, ...], Field(min_length=2, strict=False)]


class Table1(Part):
    """Table 1, one attribute per column."""

    force_N: Column
    measured_duration_us: Column
    measured_speed_m_s: Column
    measured_width_diameters: Column
    computed_speed_m_s: Column
    computed_width_2permille_diameters: Column = Field(alias="computed_width_0.2pct_diameters")
    computed_width_4pct_diameters: Column

    @property
    def frame(self) -> pd.DataFrame:
        """The table with the column names of the file."""
        return pd.DataFrame(self.model_dump(by_alias=True))


class Quoted(Part):
    """Content of the file: Table 1, and numbers named after the figure or part they belong to.

    ``accuracy_`` numbers are relative accuracies of measurements, and the position of a sensor; ``sensor_`` numbers are
    of a sensor bead: both caps together, and the square plate of the gauge between them. The brass plate lies on the
    gauge below the chain. The moduli are those of the paper's calculations, the bulk sound speeds give two of them.
    """

    accuracy_force_large: Positive
    accuracy_force_small: Positive
    accuracy_speed: Positive
    accuracy_sensor_position_m: Positive
    fig4_leading_force_N: Positive
    fig4_speed_m_s: Positive
    fig4_duration_us: Positive
    fig5_measured_envelope_per_us: Negative
    fig5_computed_envelope_per_us: Negative
    fig5_incident_rise_us: Positive
    fig5_incident_decay_per_us: Negative
    fig5_incident_duration_us: Positive
    sensor_caps_g: Positive
    sensor_gauge_g: Positive
    sensor_gauge_side_mm: Positive
    sensor_gauge_thickness_mm: Positive
    brass_mm: Positive
    smallest_force_N: Positive
    ptfe_moduli_MPa: Column
    ptfe_hugoniot_m_s: Positive
    ptfe_ultrasound_m_s: Positive
    table1: Table1

    @property
    def sensor_mass_g(self) -> float:
        """Mass of the whole sensor bead in g."""
        return self.sensor_caps_g + self.sensor_gauge_g


@cache
def quoted() -> Quoted:
    """Content of the file.

    Raises:
        InputError: The file is wrong.
    """
    where = paths.shown(paths.QUOTED)
    numbers = validate(Quoted, read_toml(paths.QUOTED), where)
    rows = len(numbers.table1.force_N)
    for name, column in numbers.table1.model_dump(by_alias=True).items():
        if len(column) != rows:
            raise InputError(where, f"table1.{name}", f"{len(column)} numbers", f"{rows}, as in table1.force_N")
    if len(set(numbers.table1.force_N)) != rows:
        raise InputError(where, "table1.force_N", "the same force twice", "different forces")
    return numbers


def force_accuracy(force_N: float) -> float:
    """Relative accuracy of a measured amplitude.

    Linear in the logarithm of the force, between the accuracies quoted for the largest and smallest force of Table 1.
    """
    paper = quoted()
    ends = np.log([min(paper.table1.force_N), max(paper.table1.force_N)])
    return float(np.interp(np.log(force_N), ends, [paper.accuracy_force_small, paper.accuracy_force_large]))
