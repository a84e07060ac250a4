"""What the measurements say: orders of convergence with their range, the cheapest way to an error, in words."""

from dataclasses import dataclass, replace
from itertools import product
from typing import Any

import numpy as np
import pandas as pd

from drivers.chain.chain import Array

TARGETS = tuple(10.0**-k for k in range(2, 9))
STRAIGHT = 0.15  # by how much the order between neighbouring steps may stray from the range's
SMOOTH_ORDER, FLAT = 3.7, 0.5
BY_SAMPLING = "samples: the exact motion read from them errs as much"
BY_SAMPLES = 30.0  # times what the exact motion errs by when read from samples: there these begin to count
LEAST = 3  # points of a range
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
    order: float
    from_share: float
    to_share: float
    above: float
    below: float
    why_bent: str


def done(rows: pd.DataFrame) -> pd.DataFrame:
    """The runs that ended well."""
    return rows[rows["status"] == "done"]


def orders(rows: pd.DataFrame) -> list[Order]:
    """Orders of all fixed-step methods in all quantities."""
    found = []
    fixed = done(rows).dropna(subset=["time_step_s"])
    for (scene, method), group in fixed.groupby(["scene", "method"], sort=False):
        ordered = group.sort_values("time_step_s", ascending=False)
        for quantity in QUANTITIES:
            errors = ordered[quantity].to_numpy()
            good = np.isfinite(errors) & (errors > 0)
            if good.sum() > LEAST:
                shares = ordered["share_of_limit"].to_numpy()[good]
                steps = ordered["time_step_s"].to_numpy()[good]
                order = _order(str(scene), str(method), quantity, shares, steps, errors[good])
                found.append(replace(order, why_bent=_why_bent(order, done(rows[rows["scene"] == scene]))))
    return found


def _order(scene: str, method: str, quantity: str, shares: Array, steps: Array, errors: Array) -> Order:
    x, y = np.log(steps), np.log(errors)
    local = np.diff(y) / np.diff(x)
    best = (0, 0)
    for first in range(len(local)):
        last = first
        while last < len(local) and np.ptp(local[first : last + 1]) <= 2 * STRAIGHT:
            last += 1
        if last - first > best[1] - best[0]:
            best = (first, last)
    first, last = best
    if last - first < LEAST - 1:
        nothing = float("nan")
        return Order(scene, method, quantity, nothing, nothing, nothing, nothing, nothing, "no straight range")
    slope = float(np.polyfit(x[first : last + 1], y[first : last + 1], 1)[0])
    above = float(local[first - 1]) if first else float("nan")
    below = float(local[last]) if last < len(local) else float("nan")
    return Order(scene, method, quantity, slope, float(shares[first]), float(shares[last]), above, below, "")


def _why_bent(order: Order, rows: pd.DataFrame) -> str:
    """Why errors stop falling as they did, by what else was measured on the scene at the same steps."""
    if not np.isfinite(order.order):
        return order.why_bent
    if order.order < FLAT:
        return BY_SAMPLING
    if order.method == "order 4" and order.order < SMOOTH_ORDER:
        return "contacts that open and close, where the force is smooth once only"
    if not abs(order.below - order.order) > 2 * STRAIGHT:
        return ""
    exact = rows[rows["method"] == "adaptive"][order.quantity].min()
    own = rows[(rows["method"] == order.method) & (rows["share_of_limit"] < 0.99 * order.to_share)]
    smooth = rows[(rows["method"] == "verlet") & (rows["share_of_limit"] < 0.99 * order.to_share)]
    if own[order.quantity].min() < BY_SAMPLES * exact:
        return BY_SAMPLING
    if order.method not in ("verlet", "order 4") and own[order.quantity].max() > 1.1 * smooth[order.quantity].max():
        return "rounding of heights: the same scheme in overlaps errs less"
    return "a change of sign of the error" if order.below > order.order else "the error of other contacts or times"


def front(errors: Array, times: Array) -> list[int]:
    """Places of the Pareto front, from the cheapest on: nothing is both cheaper and more accurate."""
    places = []
    best = np.inf
    for place in np.lexsort((errors, times)):
        if errors[place] < best:
            best = errors[place]
            places.append(int(place))
    return places


def cheapest(rows: pd.DataFrame, quantity: str, target: float, cost: str) -> Any:
    """The cheapest run with an error of at most the target that all finer steps keep too: none by chance."""
    kept = []
    for _, group in done(rows).groupby("method"):
        ordered = group.sort_values("share_of_limit")
        good = (ordered[quantity] <= target).to_numpy()
        until = len(good) if good.all() else int(np.argmin(good))
        kept.append(ordered.iloc[:until])
    found = pd.concat(kept) if kept else rows.iloc[:0]
    return None if found.empty else found.iloc[int(found[cost].to_numpy().argmin())]


def advice(rows: pd.DataFrame) -> pd.DataFrame:
    """For each scene, quantity and error the cheapest way of all, and by each method, with and without start-up."""
    lines = []
    for scene, group in rows.groupby("scene", sort=False):
        among = {"any": group} | {str(name): part for name, part in group.groupby("method", sort=False)}
        for quantity, target, name, cost in product(QUANTITIES, TARGETS, among, ("loop_s", "wall_s")):
            best = cheapest(among[name], quantity, target, cost)
            line: dict[str, Any] = {
                "scene": scene,
                "quantity": quantity,
                "error_at_most": target,
                "among": name,
                "cheapest_by": cost,
            }
            for key in ("method", "time_step_s", "loop_s", "wall_s", quantity):
                line["error" if key == quantity else key] = None if best is None else best[key]
            lines.append(line)
    return pd.DataFrame(lines)
