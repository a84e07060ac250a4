"""The trade study: errors against cost, orders of convergence, advice, diagrams."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import partial
from itertools import product
from math import nan
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.ticker import EngFormatter, FuncFormatter, LogLocator, MaxNLocator, NullFormatter

from drivers.base.progress import step
from drivers.chain.chain import Array
from drivers.engines import VERLET, codes, engine_names, in_order
from postproc.draw.style import COLUMN_IN, line_of, marker_of, pyplot
from validation import chapters
from validation.chapters import ADAPTIVE, DONE, ORDER_4, Chapter, Options, Picture, Tables
from validation.trade.ladder import BUDGET_S, SCENES, SHORT_BUDGET_S, SHORT_SCENES, LadderRun, run_ladder
from validation.trade.levers import Lever, measure_levers

TARGETS = tuple(10.0**-k for k in range(2, 9))
ORDER_SPREAD = 0.15  # largest deviation of the order between neighbouring steps, within a straight range
SMOOTH_ORDER, FLAT_ORDER = 3.7, 0.5
BY_SAMPLING = "sampling: the exact motion read from the same samples has this error"
SAMPLING_FACTOR = 30.0  # times the reading error of the exact motion: smaller errors are limited by sampling
MIN_POINTS = 3  # of a straight range
MAX_ERROR = 0.1  # larger errors show no order
QUANTITIES = {
    "force": "force trace",
    "sensor_peak": "sensor peak",
    "wall_peak": "wall peak",
    "arrival": "arrival times",
    "speed": "speed V_s",
    "width": "width",
    "energy": "energy",
    "momentum": "momentum",
}
METHODS = {ORDER_4: ("#56b4e9", "P"), ADAPTIVE: ("#999999", ">")}  # colours and markers of methods that are no engines
COSTS = {"loop_s": "time of the loop, s", "wall_s": "time of a whole run, s"}


@dataclass(frozen=True)
class Order:
    """Order of convergence over the longest straight range.

    Attributes:
        order: slope of log error over log step; NaN if no range is straight.
        from_share, to_share: largest and smallest step of the range, over the stability limit.
        above, below: order between the steps next to either end, outside; NaN without measurements there.
        why_bent: reason why the order ends below the range; empty if it holds to the smallest step.
    """

    scene: str
    method: str
    quantity: str
    order: float = nan
    from_share: float = nan
    to_share: float = nan
    above: float = nan
    below: float = nan
    why_bent: str = ""


@dataclass(frozen=True)
class Advice:
    """Cheapest run that reaches an error of one quantity, by any method or by one; empty if none does."""

    scene: str
    quantity: str
    error_at_most: float
    among: str
    cheapest_by: str
    method: str = ""
    time_step_s: float = nan
    loop_s: float = nan
    wall_s: float = nan
    error: float = nan


def done(rows: pd.DataFrame) -> pd.DataFrame:
    """Finished runs."""
    return rows[rows["status"] == DONE]


def orders(rows: pd.DataFrame) -> Iterator[Order]:
    """Orders of all fixed-step methods in all quantities."""
    fixed = done(rows).dropna(subset=["time_step_s"]).sort_values("time_step_s", ascending=False)
    for scene, method in rows[["scene", "method"]].drop_duplicates().itertuples(index=False):
        own = fixed[(fixed["scene"] == scene) & (fixed["method"] == method)]
        for quantity in QUANTITIES:
            good = own[(own[quantity] > 0) & (own[quantity] <= MAX_ERROR)]
            if len(good) > MIN_POINTS:
                columns = (good[name].to_numpy() for name in ("share_of_limit", "time_step_s", quantity))
                order = _order(Order(scene, method, quantity), *columns)
                yield replace(order, why_bent=_why_bent(order, done(rows[rows["scene"] == scene])))


def _order(order: Order, shares: Array, steps: Array, errors: Array) -> Order:
    """The order over the longest range in which it is the same between neighbouring steps."""
    x, y = np.log(steps), np.log(errors)
    local = np.diff(y) / np.diff(x)
    first = last = 0
    for start, end in product(range(len(local)), range(1, len(local) + 1)):
        if end - start > last - first and np.ptp(local[start:end]) <= 2 * ORDER_SPREAD:
            first, last = start, end
    if last - first < MIN_POINTS - 1:
        return order
    return replace(
        order,
        order=float(np.polyfit(x[first : last + 1], y[first : last + 1], 1)[0]),
        from_share=float(shares[first]),
        to_share=float(shares[last]),
        above=float(local[first - 1]) if first else nan,
        below=float(local[last]) if last < len(local) else nan,
    )


def _why_bent(order: Order, rows: pd.DataFrame) -> str:
    """Reason why errors fall more slowly below the range, from other runs of the scene."""
    if not np.isfinite(order.order):
        return "no straight range"
    if order.order < FLAT_ORDER:
        return BY_SAMPLING
    if order.method == ORDER_4 and order.order < SMOOTH_ORDER:
        return "opening and closing contacts, where the force is only once differentiable"
    if not abs(order.below - order.order) > 2 * ORDER_SPREAD:
        return ""
    finer = rows[rows["share_of_limit"] < 0.99 * order.to_share]
    exact, own, smooth = (
        table.loc[table["method"] == method, order.quantity]
        for table, method in ((rows, ADAPTIVE), (finer, order.method), (finer, VERLET))
    )
    if own.min() < SAMPLING_FACTOR * exact.min():
        return BY_SAMPLING
    if order.method not in (VERLET, ORDER_4) and own.max() > 1.1 * smooth.max():
        return "rounding of heights: the same scheme in overlaps has a smaller error"
    return (
        "a change of sign of the error"
        if order.below > order.order
        else "the largest error moves to another contact or time"
    )


def front(rows: pd.DataFrame, quantity: str, cost: str) -> pd.DataFrame:
    """Pareto front, cheapest first: no other run is both cheaper and more accurate."""
    ordered = rows.sort_values([cost, quantity])
    return ordered[ordered[quantity] < ordered[quantity].cummin().shift(fill_value=np.inf)]


def kept_errors(rows: pd.DataFrame, quantity: str) -> "pd.Series[float]":
    """Errors of finished runs, each at least as large as at all smaller steps, so that none is small by chance."""
    ordered = done(rows).sort_values("share_of_limit")
    return ordered[quantity].fillna(np.inf).groupby(ordered["method"]).cummax()


def advice(rows: pd.DataFrame) -> Iterator[Advice]:
    """Advice by scene, quantity and error: the cheapest run of all and of each method, with and without start-up."""
    for scene, group in rows.groupby("scene", sort=False):
        among = ["any", *group["method"].unique()]
        for quantity in QUANTITIES:
            errors = kept_errors(group, quantity)
            table = group.loc[errors.index].assign(kept=errors)
            records = table.to_dict("records")
            for target, name, cost in product(TARGETS, among, COSTS):
                good = [row for row in records if row["kept"] <= target and name in ("any", row["method"])]
                found = Advice(str(scene), quantity, target, name, cost)
                if good:
                    best = min(good, key=lambda row: row[cost])
                    measured = {key: best[key] for key in ("method", "time_step_s", "loop_s", "wall_s")}
                    found = replace(found, **measured, error=best[quantity])
                yield found


def measure(options: Options) -> dict[str, Any]:
    """Measures ladder and levers; derives advice and orders."""
    short = options.quick
    budget_s, scenes = (SHORT_BUDGET_S, SHORT_SCENES) if short else (BUDGET_S, SCENES)
    with step(chapters.named("the ladder of time steps", options), 1, 2):
        rows = run_ladder(options.budget_s or budget_s, scenes, short=short)
    with step(chapters.named("other ways to save time or error", options), 2, 2):
        levers = [*measure_levers()]
    table = chapters.frame_of(LadderRun, rows)
    return {"trade": rows, "trade-levers": levers, "trade-advice": advice(table), "trade-orders": orders(table)}


def sentences(tables: Tables) -> list[str]:
    """Findings that no table or figure of the page shows."""
    return [_on_extent(tables["trade"]), *_on_orders(tables["trade-orders"])]


def _on_extent(rows: pd.DataFrame) -> str:
    left, unstable = (rows[rows["status"] == status] for status in (chapters.NOT_RUN, chapters.FAILED))
    said = f"{len(rows) - len(left)} of {len(rows)} runs were done"
    if not left.empty:
        said += f"; {len(left)} did not fit the time budget, most of them of {left['scene'].mode()[0]}"
    if not unstable.empty:
        said += (
            f"; {len(unstable)} failed, all at {unstable['share_of_limit'].min():.2g} of the stability limit or more"
        )
    return said + "."


def _on_orders(orders: pd.DataFrame) -> Iterator[str]:
    known = orders[(orders["quantity"] == "force") & orders["order"].notna()]
    for method, own in known.groupby("method", sort=False):
        said = f"The force trace by {method} converges with order {own['order'].min():.2f} to {own['order'].max():.2f}"
        said += f" ({len(own)} scenes) at steps below {own['from_share'].min():.2g} of the stability limit"
        slower = own[own["below"] < own["order"] - 2 * ORDER_SPREAD]
        if not slower.empty:
            bent = [
                f"{row['scene']} below {row['to_share']:.1g} of the limit ({row['why_bent']})"
                for _, row in slower.iterrows()
            ]
            said += f". Errors fall more slowly on {', '.join(bent)}"
        yield said + "."


def figures(tables: Tables) -> dict[str, Picture]:
    """Error against time: the force of every scene against both costs, all quantities of the first scene."""
    rows = tables["trade"]
    scenes = list(rows["scene"].unique())
    pictures = {f"trade-{scene}": Picture(scene, partial(draw_scene, rows, scene)) for scene in scenes}
    return pictures | {"trade-quantities": Picture("", partial(draw_quantities, rows, scenes[0]))}


def draw_scene(rows: pd.DataFrame, scene: str) -> Any:
    """Draws the force error of a scene against both costs."""
    figure, axes = pyplot().subplots(1, 2, figsize=(2 * COLUMN_IN, 3.2), sharey=True, layout="constrained")
    for axis, (cost, label) in zip(axes, COSTS.items(), strict=True):
        _draw(axis, rows, scene, "force", cost)
        axis.set_xlabel(label)
        low, high = axis.get_xlim()
        if high < 1e3 * low:  # a short range of times: plain numbers as labels
            axis.xaxis.set_major_locator(LogLocator(subs=(1.0, 3.0)) if high > 10 * low else MaxNLocator(4))
            axis.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
            axis.xaxis.set_minor_formatter(NullFormatter())
    axes[0].set_ylabel("error of the force trace")
    axes[0].legend(fontsize="x-small")
    figure.suptitle(scene, fontsize="medium")
    return figure


def draw_quantities(rows: pd.DataFrame, scene: str) -> Any:
    """Draws the errors of all quantities of a scene against the time of the loop."""
    figure, axes = pyplot().subplots(4, 2, figsize=(2 * COLUMN_IN, 9.0), sharex=True, layout="constrained")
    for axis, (quantity, words) in zip(axes.flat, QUANTITIES.items(), strict=True):
        _draw(axis, rows, scene, quantity, "loop_s")
        axis.set_title(words, fontsize="small")
    for axis in axes[-1]:
        axis.set_xlabel(COSTS["loop_s"])
    axes[0, 0].legend(fontsize="x-small")
    figure.suptitle(f"{scene}: error against time of the loop", fontsize="medium")
    return figure


def _draw(axis: Any, rows: pd.DataFrame, scene: str, quantity: str, cost: str) -> None:
    """Draws a line for each method, and the Pareto front."""
    shown = done(rows[(rows["scene"] == scene) & (rows[quantity] > 0)])
    for method in in_order(shown["method"]):
        own = shown[shown["method"] == method].sort_values("share_of_limit")
        known = method in engine_names()
        colour, mark = (line_of(method).colour, marker_of(method)["marker"]) if known else METHODS[method]
        axis.plot(own[cost], own[quantity], marker=mark, ms=3.5, lw=0.8, label=method, color=colour)
    best = front(shown, quantity, cost)
    axis.plot(best[cost], best[quantity], color="0.6", linewidth=4, alpha=0.4, zorder=0, label="Pareto front")
    axis.set(xscale="log", yscale="log")


def section(tables: Tables) -> dict[str, Any]:
    """Cheapest code for each error: all quantities of the first scene, the force of the others; and the levers."""
    rows, advised = tables["trade"], tables["trade-advice"]
    first, *others = rows["scene"].unique()
    chosen = [*((first, quantity) for quantity in QUANTITIES), *((scene, "force") for scene in others)]
    reached = advised[(advised["cheapest_by"] == "loop_s") & (advised["method"] != "")]
    measured = rows["method"][rows["method"].isin(codes())].unique()
    among = measured if len(measured) else ["any"]
    reached = reached[reached["among"].isin(among)].sort_values("loop_s", kind="stable")
    best = reached.groupby(["scene", "quantity", "error_at_most"]).first().to_dict("index")
    table = []
    for scene, quantity in chosen:
        runs = [best.get((scene, quantity, target)) for target in TARGETS]
        cells = [(run["method"], *map(_time, (run["time_step_s"], run["loop_s"]))) if run else () for run in runs]
        table.append({"scene": scene, "quantity": QUANTITIES[quantity], "cells": cells})
    return {
        "short": not set(SCENES) <= set(rows["scene"]),
        "table": table,
        "targets": [f"{target:.0e}" for target in TARGETS],
        "levers": tables["trade-levers"].to_dict("records"),
    }


def _time(seconds: float) -> str:
    """A time with two digits and a suitable unit."""
    if pd.isna(seconds):
        return "adaptive"
    return EngFormatter("s")(float(f"{seconds:.2g}"))


CHAPTER = Chapter(
    name="trade",
    title="cost of accuracy",
    tables={"trade": LadderRun, "trade-levers": Lever, "trade-advice": Advice, "trade-orders": Order},
    measure=measure,
    sentences=sentences,
    figures=figures,
    section=section,
)
