"""What the paper's Table 1 and Fig. 3 say, computed by solving for the striker speed that gives an amplitude."""

from functools import cache
from pathlib import Path

import numpy as np
import pandas as pd

from postproc.figures.table1 import COLUMNS, engines_of, table
from postproc.quoted import quoted
from validation.strikes import contact_peak, speed_between_sensors, strike_for

MODULI_MPA = (400, 600, 1000, 1460)
NAMES = dict(zip(("speed", "width-0.2", "width-4"), COLUMNS, strict=True))


def table1(runs: Path) -> dict[str, dict[str, float]]:
    """The fifteen numbers of Table 1's numerical half by claim and engine."""
    found = table(runs)
    return {
        f"table1-{row['force_N']:g}N-{name}": {engine: row[f"{engine}_{column}"] for engine in engines_of(found)}
        for _, row in found.iterrows()
        for name, column in NAMES.items()
    }


@cache
def _deviations() -> pd.DataFrame:
    """Measured over simulated speed, less 1, by force and modulus; the quoted force taken as the contact's."""
    paper = quoted("table1")
    rows = {}
    for force, measured in zip(paper["force_N"], paper["measured_speed_m_s"], strict=True):
        rows[float(force)] = {
            modulus: measured / speed_between_sensors(
                strike_for(force, contact_peak, f"materials.ptfe.youngs_modulus={modulus} MPa")
            ) - 1
            for modulus in MODULI_MPA
        }  # fmt: skip
    return pd.DataFrame(rows).T


def _best(forces: slice) -> float:
    """The modulus of the paper's three whose simulated speeds are nearest, by root mean square, MPa."""
    some = _deviations().iloc[forces][[600, 1000, 1460]]
    errors = (some**2).mean()
    return float(str(errors.idxmin()))


def best_large() -> float:
    """For 5 and 2 N."""
    return _best(slice(0, 2))


def best_small() -> float:
    """For 0.6, 0.1 and 0.06 N."""
    return _best(slice(2, None))


def softer_is_worse() -> float:
    """Deviation at 5 N for 400 MPa over that for 600 MPa."""
    first = _deviations().iloc[0]
    return float(first[400] / first[600])


def modulus_at_low() -> float:
    """Simulated speed for 1000 MPa off the measured one, root mean square over 0.6, 0.1 and 0.06 N, per cent."""
    return float(100 * np.sqrt((_deviations()[1000].iloc[2:] ** 2).mean()))


COMPUTED = {
    "modulus-large": best_large,
    "modulus-small": best_small,
    "modulus-400": softer_is_worse,
    "modulus-1000-fits": modulus_at_low,
}
