"""What the paper's Table 1 and Fig. 3 say, computed by solving for the striker speed that gives an amplitude."""

from functools import cache
from pathlib import Path

import numpy as np
import pandas as pd

from postproc.figures.table1 import COLUMNS, engines_of, table
from postproc.quoted import quoted
from validation.strikes import Amplitude, contact_peak, sensor_amplitude, speed_between_sensors, strike_for

MODULI_MPA = (400, 600, 1000, 1460)
LARGE, SMALL = slice(0, 2), slice(2, None)  # rows of Table 1
NAMES = dict(zip(("speed", "width-0.2", "width-4"), COLUMNS, strict=True))


def table1_claims() -> list[str]:
    """The ids of the claims on Table 1's numerical half."""
    return [_claim(force, name) for force in quoted().table1.force_N for name in NAMES]


def _claim(force_N: float, name: str) -> str:
    return f"table1-{force_N:g}N-{name}"


def table1(runs: Path) -> dict[str, dict[str, float]]:
    """The fifteen numbers of Table 1's numerical half by claim and engine."""
    found = table(runs)
    return {
        _claim(row["force_N"], name): {engine: row[f"{engine}_{column}"] for engine in engines_of(found)}
        for _, row in found.iterrows()
        for name, column in NAMES.items()
    }


@cache
def _deviations(reading: Amplitude) -> pd.DataFrame:
    """Measured over simulated speed, less 1, by force and modulus; the measured force is of the given reading."""
    paper = quoted().table1
    rows = {}
    for force, measured in zip(paper.force_N, paper.measured_speed_m_s, strict=True):
        rows[float(force)] = {
            modulus: measured / speed_between_sensors(
                strike_for(force, reading, f"materials.ptfe.youngs_modulus={modulus} MPa")
            ) - 1
            for modulus in MODULI_MPA
        }  # fmt: skip
    return pd.DataFrame(rows).T


def _best(forces: slice, reading: Amplitude = contact_peak) -> float:
    """The modulus of the paper's three whose simulated speeds are nearest, by root mean square, MPa."""
    errors = (_deviations(reading).iloc[forces][[600, 1000, 1460]] ** 2).mean()
    return float(str(errors.idxmin()))


def best_large() -> float:
    """For 5 and 2 N."""
    return _best(LARGE)


def best_small() -> float:
    """For 0.6, 0.1 and 0.06 N."""
    return _best(SMALL)


def best_large_average() -> float:
    """For 5 and 2 N, the measured force read as the sensors' average."""
    return _best(LARGE, sensor_amplitude)


def best_small_average() -> float:
    """For 0.6, 0.1 and 0.06 N, the measured force read as the sensors' average."""
    return _best(SMALL, sensor_amplitude)


def _rms(modulus: int, forces: slice) -> float:
    """Measured speed off the simulated, root mean square over some forces read as the contact's, per cent."""
    return float(100 * np.sqrt((_deviations(contact_peak)[modulus].iloc[forces] ** 2).mean()))


def softer_is_worse() -> float:
    """Deviation at 5 N for 400 MPa over that for 600 MPa."""
    first = _deviations(contact_peak).iloc[0]
    return float(first[400] / first[600])


def modulus_at_low() -> float:
    """Measured speed off the simulated for 1000 MPa, root mean square over 0.6, 0.1 and 0.06 N, per cent."""
    return _rms(1000, SMALL)


def hard_at_low() -> float:
    """The same for 1460 MPa."""
    return _rms(1460, SMALL)


def soft_at_high() -> float:
    """Measured speed off the simulated for 600 MPa, root mean square over 5 and 2 N, per cent."""
    return _rms(600, LARGE)


COMPUTED = {
    "modulus-large": best_large,
    "modulus-small": best_small,
    "modulus-large-average": best_large_average,
    "modulus-small-average": best_small_average,
    "modulus-1460-low": hard_at_low,
    "modulus-600-high": soft_at_high,
    "modulus-400": softer_is_worse,
    "modulus-1000-fits": modulus_at_low,
}
