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


class Accuracy(Part):
    """Accuracies of the measurements: relative ones, and the position of a sensor."""

    force_large: Positive
    force_small: Positive
    speed: Positive
    sensor_position_m: Positive


class Fig4(Part):
    """Quoted results of the experiment of Fig. 4."""

    leading_force_N: Positive
    speed_m_s: Positive
    duration_us: Positive


class Fig5(Part):
    """Quoted results of experiment and calculation of Fig. 5."""

    measured_envelope_per_us: Negative
    computed_envelope_per_us: Negative
    incident_rise_us: Positive
    incident_decay_per_us: Negative
    incident_duration_us: Positive


class SensorParts(Part):
    """Parts of a sensor bead: both caps together, and the square plate of the gauge between them."""

    caps_g: Positive
    gauge_g: Positive
    gauge_side_mm: Positive
    gauge_thickness_mm: Positive

    @property
    def mass_g(self) -> float:
        """Mass of the whole sensor bead in g."""
        return self.caps_g + self.gauge_g


class WallGauge(Part):
    """Brass plate on top of the gauge below the chain."""

    brass_mm: Positive


class Ptfe(Part):
    """Young's moduli in the paper's calculations, and the bulk sound speeds that give two of them."""

    moduli_MPa: Column
    hugoniot_m_s: Positive
    ultrasound_m_s: Positive


class Smallest(Part):
    """Smallest measured wave."""

    force_N: Positive


class Quoted(Part):
    """Content of the file."""

    table1: Table1
    accuracy: Accuracy
    fig4: Fig4
    fig5: Fig5
    sensor: SensorParts
    smallest: Smallest
    wall_gauge: WallGauge
    ptfe: Ptfe


@cache
def quoted() -> Quoted:
    """Content of the file.

    Raises:
        InputError: The file is wrong.
    """
    where = paths.shown(paths.QUOTED)
    found = validate(Quoted, read_toml(paths.QUOTED), where)
    rows = len(found.table1.force_N)
    for name, column in found.table1.model_dump(by_alias=True).items():
        if len(column) != rows:
            raise InputError(where, f"table1.{name}", f"{len(column)} numbers", f"{rows}, as in table1.force_N")
    if len(set(found.table1.force_N)) != rows:
        raise InputError(where, "table1.force_N", "the same force twice", "different forces")
    return found


def force_accuracy(force_N: float) -> float:
    """Relative accuracy of a measured amplitude.

    Linear in the logarithm of the force, between the accuracies quoted for the largest and smallest force of Table 1.
    """
    forces, accuracy = quoted().table1.force_N, quoted().accuracy
    ends = np.log([min(forces), max(forces)])
    return float(np.interp(np.log(force_N), ends, [accuracy.force_small, accuracy.force_large]))
