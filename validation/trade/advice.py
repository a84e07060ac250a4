"""What the measurements say: orders of convergence with their range, and the cheapest way to an error."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import product
from math import nan
from typing import Any

import numpy as np
import pandas as pd

from drivers.chain.chain import Array
from validation.studies import ADAPTIVE, DONE, ORDER_4, VERLET

TARGETS = tuple(10.0**-k for k in range(2, 9))
STRAIGHT = 0.15  # by how much the order between neighbouring steps may stray from the range's
SMOOTH_ORDER, FLAT_ORDER = 3.7, 0.5
BY_SAMPLING = "samples: the exact motion read from them errs as much"
BY_SAMPLES = 30.0  # times what the exact motion errs by when read from samples: there these begin to count
LEAST_POINTS = 3  # of a range
QUANTITIES = {
    "force": "the force trace",
    "sensor_peak": "a sensor's peak",
    "wall_peak": "the wall's peak",
    "arrival": "arrival times",
    "speed": "the speed V_s",
    "width": "the width",
    "energy": "the energy",
    "momentum": "the momentum",
}


@dataclass(frozen=True)
class Order:
    """Order of convergence over the longest straight range.

    Attributes:
        order: slope of log error over log step; NaN where no range is straight.
        from_share, to_share: of the stability limit, the range's ends.
        above, below: the order between neighbouring steps beyond either end; NaN where nothing was measured there.
        why_bent: what shows beyond the lower end; empty where the order holds to the last step.
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
    """Cheapest way to an error of one quantity, among all methods or by one; empty where nothing reaches it."""

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
    """The runs that ended well."""
    return rows[rows["status"] == DONE]


def orders(rows: pd.DataFrame) -> Iterator[Order]:
    """Orders of all fixed-step methods in all quantities."""
    fixed = done(rows).dropna(subset=["time_step_s"]).sort_values("time_step_s", ascending=False)
    for scene, method in rows[["scene", "method"]].drop_duplicates().itertuples(index=False):
        own = fixed[(fixed["scene"] == scene) & (fixed["method"] == method)]
        for quantity in QUANTITIES:
            good = own[np.isfinite(own[quantity]) & (own[quantity] > 0)]
            if len(good) > LEAST_POINTS:
                columns = (good[name].to_numpy() for name in ("share_of_limit", "time_step_s", quantity))
                order = _order(Order(scene, method, quantity), *columns)
                yield replace(order, why_bent=_why_bent(order, done(rows[rows["scene"] == scene])))


def _order(order: Order, shares: Array, steps: Array, errors: Array) -> Order:
    """The same with its longest range within which the order between neighbouring steps hardly changes."""
    x, y = np.log(steps), np.log(errors)
    local = np.diff(y) / np.diff(x)
    first = last = 0
    for start, end in product(range(len(local)), range(1, len(local) + 1)):
        if end - start > last - first and np.ptp(local[start:end]) <= 2 * STRAIGHT:
            first, last = start, end
    if last - first < LEAST_POINTS - 1:
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
    """Why errors stop falling as they did, by what else was measured on the scene at the same steps."""
    if not np.isfinite(order.order):
        return "no straight range"
    if order.order < FLAT_ORDER:
        return BY_SAMPLING
    if order.method == ORDER_4 and order.order < SMOOTH_ORDER:
        return "contacts that open and close, where the force is smooth once only"
    if not abs(order.below - order.order) > 2 * STRAIGHT:
        return ""
    finer = rows[rows["share_of_limit"] < 0.99 * order.to_share]
    exact, own, smooth = (
        table.loc[table["method"] == method, order.quantity]
        for table, method in ((rows, ADAPTIVE), (finer, order.method), (finer, VERLET))
    )
    if own.min() < BY_SAMPLES * exact.min():
        return BY_SAMPLING
    if order.method not in (VERLET, ORDER_4) and own.max() > 1.1 * smooth.max():
        return "rounding of heights: the same scheme in overlaps errs less"
    return "a change of sign of the error" if order.below > order.order else "the error of other contacts or times"


def front(rows: pd.DataFrame, quantity: str, cost: str) -> pd.DataFrame:
    """The Pareto front, from the cheapest on: nothing is both cheaper and more accurate."""
    ordered = rows.sort_values([cost, quantity])
    return ordered[ordered[quantity] < ordered[quantity].cummin().shift(fill_value=np.inf)]


def reaching(rows: pd.DataFrame, quantity: str, target: float) -> pd.DataFrame:
    """Runs with an error of at most the target that all finer steps keep too: none by chance."""
    ordered = done(rows).sort_values("share_of_limit")
    good = (ordered[quantity] <= target).astype(int)
    return ordered[good.groupby(ordered["method"]).cummin() == 1]


def cheapest(rows: pd.DataFrame, quantity: str, target: float, cost: str) -> Any:
    """The cheapest run that reaches an error; None where none does."""
    kept = reaching(rows, quantity, target)
    return None if kept.empty else kept.iloc[int(kept[cost].to_numpy().argmin())]


def advice(rows: pd.DataFrame) -> Iterator[Advice]:
    """For each scene, quantity and error the cheapest way of all, and by each method, with and without start-up."""
    for scene, group in rows.groupby("scene", sort=False):
        among = {"any": group} | {str(name): part for name, part in group.groupby("method", sort=False)}
        for quantity, target, name in product(QUANTITIES, TARGETS, among):
            kept = reaching(among[name], quantity, target)
            for cost in ("loop_s", "wall_s"):
                found = Advice(str(scene), quantity, target, name, cost)
                if not kept.empty:
                    best = kept.iloc[int(kept[cost].to_numpy().argmin())]
                    measured = {key: best[key] for key in ("method", "time_step_s", "loop_s", "wall_s")}
                    found = replace(found, **measured, error=best[quantity])
                yield found
