"""Figures of fits: parameters with their intervals, and deviations of fitted from measured numbers."""

from collections.abc import Mapping
from typing import Any

import numpy as np
import pandas as pd

from postproc.draw.style import COLUMN_IN, GREY, pyplot

COLOURS = ("#0072b2", "#d55e00", "#555555", "#cc79a7", "#999933", "#56b4e9")
MARKERS = ("o", "s", "v", "D", "P", "^")
ROW_IN, HEAD_IN = 0.55, 0.5
NUMBER_IN, WIDTH_IN = 0.36, 6.8
SPREAD = 0.7  # of the fits of a number, as a share of the distance of two numbers


def draw_parameters(parameters: pd.DataFrame, scales: Mapping[str, tuple[float, str]]) -> Any:
    """A panel for each parameter: value, 68 % (thick) and 95 % interval (thin) of each law.

    Args:
        parameters: Rows of parameters by ``law``, with value, error, intervals and bounds.
        scales: Factor to a suitable unit, and that unit, by parameter.
    """
    shown = parameters[np.isfinite(parameters["error"])]
    names, laws = [*shown["parameter"].unique()] or [""], [*parameters["law"].unique()]
    height = HEAD_IN + len(names) * (ROW_IN + 0.12 * len(laws))
    figure, axes = pyplot().subplots(len(names), 1, figsize=(COLUMN_IN, height), squeeze=False, layout="constrained")
    for axis, name in zip(axes[:, 0], names, strict=True):
        (scale, unit), own = scales.get(name, (1.0, "")), shown[shown["parameter"] == name]
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
