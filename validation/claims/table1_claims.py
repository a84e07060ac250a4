"""Claims on Table 1: rows of its solved numerical half, and which modulus its measured speeds speak for."""

import numpy as np
import pandas as pd

from postproc.paper.quoted import quoted
from postproc.paper.strikes import contact_peak, deviations, engines_of, sensor_amplitude

ROWS = {"large": slice(0, 2), "small": slice(2, None)}  # of the table: 5 and 2 N; 0.6, 0.1 and 0.06 N
READINGS = {"contact": contact_peak, "average": sensor_amplitude}


def solved(table: pd.DataFrame, force_N: float, column: str) -> dict[str, float]:
    """A column by every engine, of the strike that gives this amplitude."""
    row = next(row for row in table.to_dict("records") if row["force_N"] == force_N)
    return {engine: row[f"{engine}_{column}"] for engine in engines_of(table)}


def misfit(modulus_MPa: float, forces: str, force_is: str = "contact") -> float:
    """Measured speed off the simulated, root mean square over some forces, per cent."""
    return float(100 * np.sqrt((deviations(modulus_MPa, READINGS[force_is])[ROWS[forces]] ** 2).mean()))


def nearest(forces: str, force_is: str) -> float:
    """The modulus whose simulated speeds are nearest to the measured ones, MPa."""
    return min(quoted().ptfe.moduli_MPa, key=lambda modulus: misfit(modulus, forces, force_is))


def softer_is_worse() -> float:
    """Measured speed off the simulated at 5 N for 400 MPa over the same for 600 MPa."""
    return float(deviations(400, contact_peak)[0] / deviations(600, contact_peak)[0])
