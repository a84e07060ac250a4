"""Work-precision diagrams: error against time, the Pareto front drawn through what nothing beats."""

from functools import partial
from typing import Any

import pandas as pd
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

from drivers.engines import engine_names, in_order
from postproc.draw.style import COLUMN_IN, line_of, marker_of, pyplot
from validation.studies import Picture, Tables
from validation.trade.advice import QUANTITIES, done, front
from validation.trade.ladder import ADAPTIVE, ORDER_4

METHODS = {ORDER_4: ("#56b4e9", "D"), ADAPTIVE: ("#999999", "v")}  # colours and markers of what is no engine
COSTS = {"loop_s": "time in the loop, s", "wall_s": "time of a run by itself, s"}


def figures(tables: Tables) -> dict[str, Picture]:
    """The force error of every scene against both costs, and all quantities of the first scene."""
    rows = tables["trade"]
    scenes = list(rows["scene"].unique())
    pictures = {f"trade-{scene}": Picture(scene, partial(draw_scene, rows, scene)) for scene in scenes}
    return pictures | {"trade-quantities": Picture("", partial(draw_quantities, rows, scenes[0]))}


def draw_scene(rows: pd.DataFrame, scene: str) -> Any:
    """The force error of a scene against both costs. Returns a figure."""
    figure, axes = pyplot().subplots(1, 2, figsize=(2 * COLUMN_IN, 3.2), sharey=True, layout="constrained")
    part = done(rows[rows["scene"] == scene])
    for axis, (cost, label) in zip(axes, COSTS.items(), strict=True):
        _draw(axis, part, "force", cost)
        axis.set_xlabel(label)
        if cost == "wall_s":  # start-up keeps it within a decade or two
            axis.xaxis.set_major_locator(LogLocator(subs=(1.0, 3.0)))
            axis.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
            axis.xaxis.set_minor_formatter(NullFormatter())
    axes[0].set_ylabel("error of the force trace")
    axes[0].legend(fontsize="x-small")
    figure.suptitle(scene, fontsize="medium")
    return figure


def draw_quantities(rows: pd.DataFrame, scene: str) -> Any:
    """All quantities of a scene against the time in the loop. Returns a figure."""
    figure, grid = pyplot().subplots(4, 2, figsize=(2 * COLUMN_IN, 9.0), sharex=True, layout="constrained")
    axes = list(grid.flat)
    part = done(rows[rows["scene"] == scene])
    for axis, (quantity, words) in zip(axes, QUANTITIES.items(), strict=True):
        _draw(axis, part, quantity, "loop_s")
        axis.set_title(words, fontsize="small")
    for axis in axes[-2:]:
        axis.set_xlabel(COSTS["loop_s"])
    axes[0].legend(fontsize="x-small")
    figure.suptitle(f"{scene}: error against time in the loop", fontsize="medium")
    return figure


def _draw(axis: Any, part: pd.DataFrame, quantity: str, cost: str) -> None:
    shown = part[part[quantity] > 0]
    for method in in_order(shown["method"]):
        own = shown[shown["method"] == method].sort_values("share_of_limit")
        known = method in engine_names()
        colour, mark = (line_of(method).colour, marker_of(method)["marker"]) if known else METHODS[method]
        axis.plot(own[cost], own[quantity], marker=mark, ms=3.5, lw=0.8, label=method, color=colour)
    best = front(shown, quantity, cost)
    axis.plot(best[cost], best[quantity], color="0.6", linewidth=4, alpha=0.4, zorder=0, label="Pareto front")
    axis.set_xscale("log")
    axis.set_yscale("log")
