"""Texts of fits: values with errors and intervals, names of the paper's numbers."""

from math import isfinite, isnan
from typing import Any

import numpy as np
import pandas as pd

from drivers.base.units import quantity

# words for numbers of the paper, by parts of their names
KINDS = {
    "amplitude": "force",
    "contact_force": "force",
    "speed": "speed",
    "full_width": "full width",
    "decay": "decay at the wall",
}


def rows_of(table: pd.DataFrame) -> list[Any]:
    """Rows of a table with their columns as attributes."""
    return [*table.itertuples(index=False)]


def value_text(row: Any, factor: float = 1.0) -> str:
    """Value with its error, multiplied by a factor, to two digits in a suitable unit, and the bound that it is at."""
    at = f" (at its {row.at})" if row.at else ""
    if not isfinite(row.error):
        return f"undetermined: {rounded(row.least, row.unit)} to {rounded(row.most, row.unit)}{at}"
    return with_error(row.value, row.error * factor, row.unit) + at


def with_error(value: float, error: float, unit: str) -> str:
    """Value with its error to two digits, in a suitable unit."""
    scale, places, unit = _digits(value, error, unit)
    return f"{value * scale:.{places}f} ± {error * scale:.{places}f} {unit}".strip()


def interval_text(row: Any, ends: tuple[float, float]) -> str:
    """Interval with digits as in ``value_text``; an open side is the end of the range, in brackets; empty for NaN."""
    if isnan(ends[0]):
        return ""
    scale, places, unit = _digits(row.value, min(row.error, (row.most - row.least) / 10), row.unit)
    shown = [
        f"{end * scale:.{places}f}" if isfinite(end) else f"({limit * scale:.{places}f})"
        for end, limit in zip(ends, (row.least, row.most), strict=True)
    ]
    return f"{shown[0]} .. {shown[1]} {unit}".strip()


def _digits(value: float, error: float, unit: str) -> tuple[float, int, str]:
    """Factor from the SI unit to a suitable unit, decimal places for two digits of the error, name of the unit."""
    scale, unit = suited(value, unit)
    return scale, int(np.clip(1 - np.floor(np.log10(error * scale)), 0, 12)) if error > 0 else 6, unit


def suited(value: float, unit: str) -> tuple[float, str]:
    """Factor from the SI unit to a unit that suits a value, and that unit."""
    if not (unit and value):
        return 1.0, unit
    amount, unit = quantity(float(f"{value:.3g}"), unit).split(" ", 1)
    return float(amount) / float(f"{value:.3g}"), unit


def rounded(value: float, unit: str) -> str:
    """Value to three digits, with its unit."""
    return quantity(float(f"{value:.3g}"), unit) if unit else f"{value:.3g}"


def name_of(data_set: str, datum: str) -> str:
    """Name of a datum: kind and, of a row, its force."""
    kind = next((word for part, word in KINDS.items() if part in datum), datum)
    words = {"table1": "Table 1,", "fig4": "Fig. 4", "fig5": "Fig. 5"}
    named = " ".join(words.get(part, part) for part in data_set.removesuffix(" width").split(" "))
    return f"{named}: {kind}"
