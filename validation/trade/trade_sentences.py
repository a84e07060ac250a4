"""Sentences of the trade study that a user can act on, computed from its tables."""

from collections import Counter
from collections.abc import Iterator
from typing import Any

import pandas as pd

from drivers.engines import codes
from validation.studies import Tables
from validation.trade.advice import STRAIGHT, cheapest, done
from validation.trade.climb import FAILED, NOT_RUN


def sentences(tables: Tables) -> list[str]:
    """The sentences, most general first."""
    rows, levers = tables["trade"], tables["trade-levers"]
    return [
        _on_extent(rows),
        *_on_orders(tables["trade-orders"]),
        *_on_cost(rows),
        *_on_steps(levers),
        *_on_machines(levers),
    ]


def _on_extent(rows: pd.DataFrame) -> str:
    left = rows[rows["status"] == NOT_RUN]
    said = f"{len(rows) - len(left)} of {len(rows)} runs were made"
    if not left.empty:
        said += f"; {len(left)}, most of them of {left['scene'].mode()[0]}, did not fit the budget of computing time"
    unstable = rows[rows["status"] == FAILED]
    if not unstable.empty:
        said += f"; {len(unstable)} failed, at {unstable['share_of_limit'].min():.2g} of the stability limit or above"
    return said + "."


def _on_orders(orders: pd.DataFrame) -> Iterator[str]:
    known = orders[(orders["quantity"] == "force") & orders["order"].notna()]
    for method, own in known.groupby("method", sort=False):
        said = f"The force trace by {method} converges with order {own['order'].min():.2f} to {own['order'].max():.2f}"
        said += f" ({len(own)} scenes), from {own['from_share'].min():.2g} of the stability limit on"
        slower = own[own["below"] < own["order"] - 2 * STRAIGHT]
        if not slower.empty:
            bent = [f"{row['scene']} from {row['to_share']:.1g} ({row['why_bent']})" for _, row in slower.iterrows()]
            said += f". Below these shares of the limit errors fall more slowly: {', '.join(bent)}"
        yield said + "."


def _on_cost(rows: pd.DataFrame) -> Iterator[str]:
    first = rows["scene"].iloc[0]
    for code in codes_in(rows):
        part = rows[(rows["scene"] == first) & (rows["method"] == code)]
        costs = []
        for target in (1e-2, 1e-4, 1e-6, 1e-8):
            best = cheapest(part, "force", target, "wall_s")
            if best is not None:
                step_us = best["time_step_s"] * 1e6
                costs.append(f"{target:.0e} costs {best['loop_s']:.2g} s at {step_us:.2g} µs")
        if costs:
            start = (done(part)["wall_s"] - done(part)["in_session_s"]).median()
            yield f"{first} by {code}: an error of {', '.join(costs)}; {start:.2g} s of start-up come on top."
    for target in (1e-4, 1e-6, 1e-8):
        best_of = [cheapest(group, "force", target, "loop_s") for _, group in rows.groupby("scene")]
        used = Counter(str(best["method"]) for best in best_of if best is not None)
        if used:
            counted = ", ".join(f"{name} on {count} of {len(best_of)} scenes" for name, count in used.most_common())
            yield f"Cheapest loop for a force error of {target:.0e}: {counted}."


def codes_in(rows: pd.DataFrame) -> list[str]:
    """The codes that a table has measurements of."""
    return [name for name in codes() if (rows["method"] == name).any()]


def _on_steps(levers: pd.DataFrame) -> Iterator[str]:
    table = levers[levers["lever"] == "Rayleigh fraction"]
    for quantity, word in (("force", "the force trace"), ("wall_peak", "the wall's peak")):
        part = table[table["quantity"] == quantity]
        ranges = []
        for setting in part["setting"].unique():
            errors = part[part["setting"] == setting]["error"]
            ranges.append(f"{errors.min():.1e} to {errors.max():.1e} at {setting}")
        yield f"A fraction of the Rayleigh time does not fix the error: that of {word} is {', '.join(ranges)}."
    part = levers[(levers["lever"] == "softened modulus") & levers["setting"].str.startswith("E/100,")]
    for setting in part["setting"].unique():
        worst = _worst(part[part["setting"] == setting])
        yield (
            f"{setting}: steps {worst['gain']:.1f} times larger; scaled back, {worst['quantity']} is off by"
            f" {worst['error']:.1e}."
        )
    part = levers[(levers["lever"] == "Richardson extrapolation") & (levers["scene"] == "fig4")]
    for _, row in part.iloc[[0, -1]].iterrows():
        yield (
            f"Richardson's extrapolation of fig4 from {row['setting']}: error {row['error']:.1e}; a single run as good"
            f" would take {row['gain']:.2g} times the steps of the pair."
        )
    part = levers[levers["lever"] == "sampling interval"]
    for setting in ("1 us", "10 us"):
        worst = _worst(part[part["setting"] == setting])
        yield f"Samples every {setting} on fig4: {worst['quantity']} is read to {worst['error']:.1e}."


def _on_machines(levers: pd.DataFrame) -> Iterator[str]:
    levers = levers.dropna(subset="gain")
    for _, row in levers[levers["lever"].isin(["two cores", "one process for many"])].iterrows():
        share = f"{row['gain']:.2g} times as fast" if row["gain"] >= 1 else f"{1 / row['gain']:.2g} times as slow"
        yield f"{row['engine']}, {row['lever']} ({row['scene']}, {row['setting']}): {share} as without."
    for _, row in levers[levers["lever"] == "extended precision"].iterrows():
        yield (
            f"{row['engine']}, {row['setting']}: {row['error']:.1e} of the largest force off the scheme in overlaps,"
            f" at {1 / row['gain']:.2g} times the time of double precision."
        )


def _worst(part: pd.DataFrame) -> Any:
    return part.iloc[int(part["error"].to_numpy().argmax())]
