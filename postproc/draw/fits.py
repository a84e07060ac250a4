"""Texts and figures of fits: values with errors and intervals, and deviations of fitted from measured numbers."""

from math import isfinite, isnan
from typing import Any

import numpy as np
import pandas as pd

from drivers.base.units import quantity
from postproc.draw.style import COLUMN_IN, GREY, pyplot

COLOURS = ("#0072b2", "#d55e00", "#555555", "#cc79a7", "#999933", "#56b4e9")
MARKERS = ("o", "s", "v", "D", "P", "^")
ROW_IN, HEAD_IN = 0.55, 0.5
NUMBER_IN, WIDTH_IN = 0.36, 6.8
SPREAD = 0.7  # of the fits of a number, as a share of the distance of two numbers
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
    kind = next((word for part, word in KINDS.items() if part in datum), datum)
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
        own = shown[shown["parameter"] == name]
        scale, unit = _suited(own["value"].iloc[0], own["unit"].iloc[0]) if len(own) else (1.0, "")
        for place, row in enumerate(own.to_dict("records")):
            look = laws.index(row["law"]) % len(COLOURS)
            for share, width in (("95pct", 0.9), ("68pct", 2.6)):
                low, high = max(row[f"low_{share}"], row["least"]), min(row[f"high_{share}"], row["most"])
                axis.plot(
                    [low * scale, high * scale], [place] * 2, color=COLOURS[look], lw=width, solid_capstyle="butt"
                )
            axis.plot(row["value"] * scale, place, MARKERS[look], color=COLOURS[look], ms=5, label=row["law"] or None)
        title = name.removeprefix("materials.") or "no parameter is determined"
        axis.set_title(f"{title}{f' ({unit})' * bool(unit)}", loc="left", fontsize=8)
        axis.set(yticks=[], ylim=(len(own) - 0.4, -0.6))
        axis.locator_params(axis="x", nbins=5)
        axis.ticklabel_format(axis="x", useOffset=False)
    handles, labels = axes[0, 0].get_legend_handles_labels()
    if len(labels) > 1:
        figure.legend(handles, labels, loc="outside upper left", ncols=len(labels), fontsize=7)
    figure.supxlabel("value, 68 % (thick) and 95 % interval", fontsize=8)
    return figure


def draw_deviations(data: pd.DataFrame) -> Any:
    """Fitted minus measured numbers in standard errors of the measurement, with the errors of the fits.

    Args:
        data: Rows by ``number`` (name with measured value), ``law`` and ``fit`` (law with its reading), with
            ``off`` and ``error``; fits after the first one of a law have open markers.
    """
    numbers, fits = [*data["number"].unique()], data[["law", "fit"]].drop_duplicates()
    laws = [*fits["law"].unique()]
    height = 1.0 + NUMBER_IN * len(numbers)
    figure, axis = pyplot().subplots(figsize=(WIDTH_IN, height), layout="constrained")
    axis.axvspan(-1, 1, color=GREY, alpha=0.15, lw=0)
    axis.axvline(0, color="k", lw=0.8)
    for place, (law, fit, repeated) in enumerate(fits.assign(again=fits["law"].duplicated()).itertuples(index=False)):
        own, look = data[data["fit"] == fit], laws.index(law) % len(COLOURS)
        rows = own["number"].map(numbers.index) + SPREAD * ((place + 0.5) / len(fits) - 0.5)
        axis.errorbar(
            own["off"], rows, xerr=own["error"], ls="none", marker=MARKERS[look], ms=4, elinewidth=0.8,
            color=COLOURS[look], mfc="white" if repeated else COLOURS[look], label=fit,
        )  # fmt: skip
    axis.set(yticks=range(len(numbers)), yticklabels=numbers, ylim=(len(numbers) - 0.5, -0.5))
    axis.set_xlabel("fitted minus measured, in standard errors of the measurement (grey: one)")
    figure.legend(loc="outside upper center", ncols=3, fontsize=7)
    return figure
