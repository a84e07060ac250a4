"""Maps of the limits, of horizons, and of what heights cost."""

from functools import partial
from typing import Any

import numpy as np
import pandas as pd

from drivers.engines import codes
from drivers.limits.criteria import CRITERIA
from postproc.draw.style import COLUMN_IN, FAINT, marker_of, pyplot
from validation.stability.measured_limits import CRITERION_KEYS, VERLET
from validation.stability.subjects import SWEEPS
from validation.studies import Picture, Tables

COLOURS = ("#cc79a7", "#e69f00", "#56b4e9")


def figures(tables: Tables) -> dict[str, Picture]:
    """Maps of the tables that are there."""
    drawn = {
        "limits": ("stability", draw_limits, "Predicted steps and users' criteria over the measured limit"),
        "horizons": ("stability-horizons", draw_horizons, "How long two methods agree to a per cent, by time step"),
        "rounding": ("stability-rounding", draw_rounding, "Relative error of a contact's force against its overlap"),
    }
    return {
        f"stability-{name}": Picture(title, partial(draw, tables[table]))
        for name, (table, draw, title) in drawn.items()
        if table in tables
    }


def draw_limits(limits: pd.DataFrame) -> Any:
    """Predicted steps and users' criteria over the measured limit, along each sweep. Returns a figure."""
    figure, grid = pyplot().subplots(2, 2, figsize=(2 * COLUMN_IN, 5.6), sharey=True, layout="constrained")
    for axis, group in zip(grid.flat, SWEEPS, strict=True):
        part = limits[limits["group"] == group].sort_values("value")
        verlet = part[part["method"] == VERLET]
        x, limit = verlet["value"], verlet["measured_s"]
        axis.fill_between(x, verlet["bad_s"] / limit, 1.0, color="0.85", lw=0, label="stable, worse than 10 %")
        axis.axhline(1.0, color="black", lw=0.8)
        for key, label, colour in zip(CRITERION_KEYS, CRITERIA, COLOURS, strict=True):
            axis.plot(x, verlet[key] / limit, color=colour, lw=1.0, label=label)
        for method, own in part.groupby("method"):
            share = own["predicted_s"] / own["measured_s"]
            axis.plot(own["value"], share, ls="", label=f"predicted, {method}", **marker_of(str(method)))
        axis.set_xscale("log")
        axis.set_yscale("log")
        axis.set_xlabel(group)
    for axis in grid[:, 0]:
        axis.set_ylabel("step / measured limit")
    handles, labels = grid[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=4, fontsize="x-small")
    return figure


def draw_horizons(horizons: pd.DataFrame) -> Any:
    """How long pairs agree to a per cent, by time step. Returns a figure."""
    figure, axis = pyplot().subplots(figsize=(COLUMN_IN * 1.4, 2.8), layout="constrained")
    for (one, other), part in horizons.groupby(["one", "other"], sort=False):
        ordered = part.sort_values("time_step_s")
        until = ordered["until_s"].fillna(ordered["duration_s"])
        axis.plot(ordered["time_step_s"] * 1e6, until * 1e3, marker="o", ms=3, lw=1, label=f"{one} and {other}")
    axis.set_xscale("log")
    axis.set_xlabel("time step, µs")
    axis.set_ylabel("agree to 1 % until, ms")
    axis.set_ylim(bottom=0)
    axis.legend(fontsize="x-small")
    return figure


def draw_rounding(rounding: pd.DataFrame) -> Any:
    """Relative error of a contact's force against its overlap, for walls at several heights. Returns a figure."""
    figure, axis = pyplot().subplots(figsize=(COLUMN_IN * 1.7, 3.0), layout="constrained")
    few = rounding[rounding["beads"] == rounding["beads"].min()]
    overlaps_m = np.array(sorted(few["overlap_m"].unique()))
    engines = [name for name in codes() if (few["method"] == name).any()]
    shades = pyplot().get_cmap("viridis")
    heights = sorted(few["height_m"].unique())
    for place, height in enumerate(heights):
        colour = shades(0.9 * place / max(len(heights) - 1, 1))
        for engine in engines:
            own = few[(few["method"] == engine) & (few["height_m"] == height)]
            axis.plot(own["overlap_m"], own["error"], ls="", **marker_of(engine) | {"color": colour})
        bound = 1.5 * np.spacing(max(height, 0.01)) / overlaps_m
        axis.plot(overlaps_m, bound, lw=0.8, color=colour, label=f"wall at {height:g} m")
    for engine in engines:
        axis.plot([], [], ls="", label=engine, **marker_of(engine) | {"color": FAINT})
    axis.set_xscale("log")
    axis.set_yscale("log")
    axis.set_xlabel("overlap, m")
    axis.set_ylabel("relative error of the force")
    axis.set_title("lines: 3/2 of a unit in the last place over the overlap", fontsize="x-small")
    figure.legend(fontsize="x-small", loc="outside right upper")
    return figure
