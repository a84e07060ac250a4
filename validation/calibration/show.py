"""Texts and figures of fits: values with errors and intervals, parameters, measured against fitted numbers."""

from collections.abc import Mapping
from math import isfinite, isnan
from typing import Any

import numpy as np
import pandas as pd

from drivers.base.units import quantity
from postproc.draw.style import COLUMN_IN, GREY, pyplot

COLOURS = ("#0072b2", "#d55e00", "#555555", "#cc79a7", "#999933", "#56b4e9")
MARKERS = ("o", "s", "v", "D", "P", "^")
ROW_IN, HEAD_IN = 0.55, 0.5
KINDS = (("amplitude", "force (N)", 1.0), ("contact_force", "force (N)", 1.0), ("speed", "speed (m/s)", 1.0),
         ("full_width", "full width (µs)", 1e6), ("decay", "decay at the wall (1/µs)", -1e-6))  # fmt: skip


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
    scale, unit = _suited(value, unit)
    return scale, int(np.clip(1 - np.floor(np.log10(error * scale)), 0, 12)) if error > 0 else 6, unit


def _suited(value: float, unit: str) -> tuple[float, str]:
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
    kind = next((words.partition(" (")[0] for kind, words, _ in KINDS if kind in datum), datum)
    words = {"table1": "Table 1,", "fig4": "Fig. 4", "fig5": "Fig. 5"}
    named = " ".join(words.get(part, part) for part in data_set.removesuffix(" width").split(" "))
    return f"{named}: {kind}"


def draw_parameters(parameters: pd.DataFrame) -> Any:
    """A panel for each parameter: value, 68 % (thick) and 95 % interval (thin) of each law."""
    shown = parameters[np.isfinite(parameters["error"])]
    names, laws = [*shown["parameter"].unique()] or [""], [*parameters["law"].unique()]
    height = HEAD_IN + len(names) * (ROW_IN + 0.12 * len(laws))
    figure, axes = pyplot().subplots(len(names), 1, figsize=(COLUMN_IN, height), squeeze=False, layout="constrained")
    for axis, name in zip(axes[:, 0], names, strict=True):
        own = rows_of(shown[shown["parameter"] == name])
        scale, unit = _suited(own[0].value, own[0].unit) if own else (1.0, "")
        for place, row in enumerate(own):
            look = laws.index(row.law) % len(COLOURS)
            for low, high, width in ((row.low_95pct, row.high_95pct, 0.9), (row.low_68pct, row.high_68pct, 2.6)):
                ends = max(low, row.least) * scale, min(high, row.most) * scale  # an open interval ends with the range
                axis.plot(ends, [place, place], color=COLOURS[look], lw=width, solid_capstyle="butt")
            axis.plot(row.value * scale, place, MARKERS[look], color=COLOURS[look], ms=5, label=row.law or None)
        title = f"{name.removeprefix('materials.') or 'no parameter is determined'}{f' ({unit})' * bool(unit)}"
        axis.set_title(title, loc="left", fontsize=8)
        axis.set(yticks=[], ylim=(len(own) - 0.4, -0.6))
        axis.locator_params(axis="x", nbins=5)
        axis.ticklabel_format(axis="x", useOffset=False)
    handles, labels = axes[0, 0].get_legend_handles_labels()
    if len(labels) > 1:
        figure.legend(handles, labels, loc="outside upper left", ncols=len(labels), fontsize=7)
    figure.supxlabel("value, 68 % (thick) and 95 % interval", fontsize=8)
    return figure


def draw_data(data: pd.DataFrame, readings: Mapping[str, str]) -> Any:
    """A panel for each kind of number: measured with errors, and fitted by each law with errors.

    Args:
        data: Table of the data of all fits.
        readings: Two drawn readings with their endings in the legend; the second has open markers.
    """
    drawn = data[data["data"].isin([*readings]) & np.isfinite(data["error"])]
    series = [(reading, law) for reading in readings for law in drawn["law"].unique()]
    kinds = [(kind, words, scale) for kind, words, scale in KINDS if drawn["datum"].str.contains(kind).any()]
    counts = [drawn.loc[drawn["datum"].str.contains(kind), "data_set"].nunique() for kind, _, _ in kinds]
    figure, axes = pyplot().subplots(
        len(kinds), 1, figsize=(6.8, 1.2 + 0.62 * sum(counts) + 0.45 * len(kinds)), layout="constrained",
        height_ratios=[count + 0.6 for count in counts], squeeze=False,
    )  # fmt: skip
    for axis, (kind, words, scale) in zip(axes[:, 0], kinds, strict=True):
        own = drawn[drawn["datum"].str.contains(kind)]
        sets = [*own["data_set"].unique()]
        for place, name in enumerate(sets):
            rows = {(row.data, row.law): row for row in rows_of(own[own["data_set"] == name])}
            one = next(iter(rows.values()))
            label = "measured" * (place == 0) or None
            axis.errorbar(
                one.measured * scale, place, xerr=abs(one.error * scale), fmt="k*", lw=1.1, capsize=2, label=label
            )
            for number, (reading, law) in enumerate(series):
                row, look = rows[reading, law], [*drawn["law"].unique()].index(law)
                error = row.fitted_error * abs(scale) if np.isfinite(row.fitted_error) else 0.0
                axis.errorbar(
                    row.fitted * scale, place + (1 + number) / (2 + len(series)), xerr=error, fmt=MARKERS[look], ms=3.5,
                    color=COLOURS[look], elinewidth=0.8, mfc="white" if reading == [*readings][-1] else COLOURS[look],
                    label=law + readings[reading] if place == 0 else None,
                )  # fmt: skip
        names = [name_of(name, kind).partition(":")[0] for name in sets]
        axis.set(yticks=range(len(sets)), yticklabels=names, ylim=(len(sets) - 0.15, -0.4), xlabel=words)
        axis.set_xscale("log" if kind in ("amplitude", "contact_force") else "linear")
        axis.grid(axis="x", color=GREY, lw=0.3)
    handles, labels = axes[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper center", ncols=4, fontsize=7)
    return figure
