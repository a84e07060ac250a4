"""What the measurements say: orders of convergence with their range, the cheapest way to an error, in words."""

from dataclasses import dataclass

import numpy as np
import pandas as pd

from drivers.chain import Array

TARGETS = tuple(10.0**-k for k in range(2, 9))
STRAIGHT = 0.15  # by how much the order between neighbouring steps may stray from the range's
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
    """

    scene: str
    method: str
    quantity: str
    order: float
    from_share: float
    to_share: float
    above: float
    below: float


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
                found.append(_order(str(scene), str(method), quantity, shares, steps, errors[good]))
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
        return Order(scene, method, quantity, *[float("nan")] * 5)
    slope = float(np.polyfit(x[first : last + 1], y[first : last + 1], 1)[0])
    above = float(local[first - 1]) if first else float("nan")
    below = float(local[last]) if last < len(local) else float("nan")
    return Order(scene, method, quantity, slope, float(shares[first]), float(shares[last]), above, below)


def front(errors: Array, times: Array) -> Array:
    """Places of the Pareto front, from the cheapest on: nothing is both cheaper and more accurate."""
    places = []
    best = np.inf
    for place in np.lexsort((errors, times)):
        if errors[place] < best:
            best = errors[place]
            places.append(int(place))
    return np.array(places, dtype=int)


def cheapest(rows: pd.DataFrame, quantity: str, target: float, cost: str) -> pd.Series | None:
    """The cheapest run whose error is at most the target, and not below it only by chance: all finer steps keep it."""
    kept = []
    for _, group in done(rows).groupby("method"):
        ordered = group.sort_values("share_of_limit")
        good = (ordered[quantity] <= target).to_numpy()
        until = len(good) if good.all() else int(np.argmin(good))
        kept.append(ordered.iloc[:until])
    found = pd.concat(kept) if kept else rows.iloc[:0]
    return None if found.empty else found.loc[found[cost].idxmin()]


def advice(rows: pd.DataFrame) -> pd.DataFrame:
    """For each scene, quantity and error: the cheapest way of all, and by each code; costs with and without start-up."""
    lines = []
    for scene, group in rows.groupby("scene", sort=False):
        methods = {"any": group} | {str(name): part for name, part in group.groupby("method", sort=False)}
        for quantity in QUANTITIES:
            for target in TARGETS:
                for among, part in methods.items():
                    for cost in ("loop_s", "wall_s"):
                        best = cheapest(part, quantity, target, cost)
                        line = {"scene": scene, "quantity": quantity, "error_at_most": target, "among": among}
                        line |= {"by": cost, "use": None, "time_step_s": np.nan, "cost_s": np.nan, "error": np.nan}
                        if best is not None:
                            line |= {"use": best["method"], "time_step_s": best["time_step_s"]}
                            line |= {"cost_s": best[cost], "error": best[quantity]}
                        lines.append(line)
    return pd.DataFrame(lines)


def sentences(rows: pd.DataFrame, levers: pd.DataFrame) -> list[str]:
    """What a user can act on, computed from the measurements."""
    return [*_on_orders(rows), *_on_cost(rows), *_on_levers(levers)]


def _on_orders(rows: pd.DataFrame) -> list[str]:
    said = []
    table = pd.DataFrame(orders(rows))
    for method, group in table[table["quantity"] == "force"].groupby("method", sort=False):
        known = group.dropna(subset=["order"])
        if known.empty:
            continue
        low, high = known["order"].min(), known["order"].max()
        bends = known[known["below"] < known["order"] - 2 * STRAIGHT]
        bent = ", ".join(f"{row.scene} below {row.to_share:.1g}" for row in bends.itertuples())
        said.append(
            f"The force trace by {method} converges with order {low:.2f} to {high:.2f} over the {len(known)} scenes, up to"
            f" {known['from_share'].max():.2g} of the stability limit"
            + (f"; it bends where rounding takes over ({bent} of the limit)." if bent else ".")
        )
    return said


def _on_cost(rows: pd.DataFrame) -> list[str]:
    said = []
    table = advice(rows)
    for among in [name for name in ("liggghts", "yade") if (table["among"] == name).any()]:
        part = table[(table["among"] == among) & (table["quantity"] == "force") & (table["scene"] == "fig4")]
        costs = []
        for target in (1e-2, 1e-4, 1e-6, 1e-8):
            line = part[(part["error_at_most"] == target) & (part["by"] == "wall_s")].iloc[0]
            if line["use"] is not None:
                costs.append(f"{target:.0e} costs {line['cost_s']:.2f} s at {line['time_step_s'] * 1e6:.2g} µs")
        said.append(f"Fig. 4 with {among}, start-up included: an error of {', '.join(costs)}.")
    best = table[(table["among"] == "any") & (table["quantity"] == "force") & (table["by"] == "loop_s")]
    tight = best[best["error_at_most"] == 1e-6].dropna(subset=["use"])
    names = tight["use"].value_counts()
    if len(names):
        counted = ", ".join(f"{name} on {count}" for name, count in names.items())
        said.append(
            f"To have the force trace to 1e-6 for the least time in the loop: {counted} of {len(tight)} scenes."
        )
    return said


def _on_levers(levers: pd.DataFrame) -> list[str]:
    said = []
    table = levers[levers["lever"] == "Rayleigh fraction"]
    for quantity, word in (("force", "the force trace"), ("wall_peak", "the wall's peak")):
        part = table[table["quantity"] == quantity].groupby("setting", sort=False)["error"]
        ranges = ", ".join(
            f"{setting} {low:.1e} to {high:.1e}"
            for (setting, low), high in zip(part.min().items(), part.max(), strict=True)
        )
        if ranges:
            said.append(f"As a fraction of the Rayleigh time, the error in {word} is: {ranges}.")
    part = levers[levers["lever"] == "softened modulus"]
    for where in ("without gravity", "with gravity"):
        own = part[part["setting"].str.endswith(where)]
        for setting, group in own.groupby("setting", sort=False):
            if setting.startswith("E/100,"):
                worst = group.loc[group["error"].idxmax()]
                said.append(
                    f"A modulus 100 times softer {where} allows steps {worst['gain']:.1f} times larger; scaled back,"
                    f" {worst['quantity']} is off by {worst['error']:.1e}."
                )
    for row in levers[levers["lever"].isin(["two cores", "one process for many"])].itertuples():
        said.append(f"{row.engine}, {row.setting} ({row.scene}): {row.gain:.2g} times as fast.")
    for row in levers[levers["lever"] == "extended precision"].itertuples():
        said.append(f"{row.engine}, {row.setting}: error {row.error:.1e}, {1 / row.gain:.2g} times the time of double.")
    part = levers[(levers["lever"] == "Richardson extrapolation") & (levers["scene"] == "fig4")]
    if len(part):
        row = part.iloc[len(part) // 2]
        said.append(
            f"Richardson's extrapolation on Fig. 4 from {row['setting']}: error {row['error']:.1e}, where one run as good"
            f" would take {row['gain']:.2g} times the steps of both."
        )
    return said
