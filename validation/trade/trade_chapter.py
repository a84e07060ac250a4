"""The trade study: errors against cost, orders of convergence, advice, a figure."""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial
from itertools import product
from math import inf
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.ticker import EngFormatter

from drivers.base.progress import step
from drivers.chain.chain import Array
from drivers.engines import VERLET, codes, in_order
from postproc.draw.style import PAGE_IN, line_of, pyplot
from validation.chapters import Chapter, Options, Picture, Tables, frame_of, named
from validation.checks import short
from validation.trade.ladder import (
    BUDGET_S,
    DONE,
    ORDER_4,
    SCENES,
    SHORT_BUDGET_S,
    SHORT_SCENES,
    LadderRun,
    engine_of,
    run_ladder,
)
from validation.trade.levers import Lever, measure_levers

TARGETS = tuple(10.0**-k for k in range(2, 9))
SHOWN_TARGETS = TARGETS[::2]
TYPICAL = 1e-4  # error of the force in sentences
ORDER_SPREAD = 0.15  # largest deviation of the order between neighbouring steps, within a straight range
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
LOOK = {"color": "#777777", "ls": (0, (2, 1)), "marker": "P"}  # of ``ORDER_4``, which is no engine


@dataclass(frozen=True)
class Order:
    """Order of convergence over the longest straight range.

    Attributes:
        order: slope of log error over log step.
        from_share, to_share: largest and smallest step of the range, divided by the stability limit.
    """

    scene: str
    method: str
    quantity: str
    order: float
    from_share: float
    to_share: float


@dataclass(frozen=True)
class Advice:
    """Cheapest run of one method that keeps an error of one quantity; no row if none does."""

    scene: str
    quantity: str
    error_at_most: float
    method: str
    time_step_s: float
    loop_s: float
    error: float


def done(rows: pd.DataFrame) -> pd.DataFrame:
    """Finished runs, from the smallest to the largest step."""
    return rows[rows["status"] == DONE].sort_values("share_of_limit")


def orders(rows: pd.DataFrame) -> Iterator[Order]:
    """Orders of all fixed-step methods in all quantities that have a straight range."""
    fixed = done(rows).dropna(subset=["time_step_s"])[::-1]
    for (scene, method), own in fixed.groupby(["scene", "method"], sort=False):
        for quantity in QUANTITIES:
            good = own[(own[quantity] > 0) & (own[quantity] <= MAX_ERROR)]
            steps, errors = (np.log(good[name].to_numpy()) for name in ("time_step_s", quantity))
            first, last = _straight(steps, errors)
            if last - first >= MIN_POINTS - 1:
                order = float(np.polyfit(steps[first : last + 1], errors[first : last + 1], 1)[0])
                ends = good["share_of_limit"].iloc[[first, last]]
                yield Order(str(scene), str(method), quantity, order, *(float(share) for share in ends))


def _straight(steps: Array, errors: Array) -> tuple[int, int]:
    """Both ends of the longest range in which the order is the same between neighbouring steps; of logarithms."""
    local = np.diff(errors) / np.diff(steps)
    first = last = 0
    for start, end in product(range(len(local)), range(1, len(local) + 1)):
        if end - start > last - first and np.ptp(local[start:end]) <= 2 * ORDER_SPREAD:
            first, last = start, end
    return first, last


def advice(rows: pd.DataFrame) -> Iterator[Advice]:
    """Cheapest runs by scene, method, quantity and error; no error counts that is larger at a smaller step."""
    for (scene, method), own in done(rows).groupby(["scene", "method"], sort=False):
        for quantity in QUANTITIES:
            largest = own[quantity].fillna(inf).cummax()  # so that no error is small by chance
            for target in TARGETS:
                good = own[largest <= target]
                if not good.empty:
                    best = good.loc[good["loop_s"].idxmin()]
                    numbers = (float(best[name]) for name in ("time_step_s", "loop_s", quantity))
                    yield Advice(str(scene), quantity, target, str(method), *numbers)


def measure(options: Options) -> dict[str, Any]:
    """Measures ladder and levers; derives advice and orders."""
    budget_s, scenes = (SHORT_BUDGET_S, SHORT_SCENES) if options.quick else (BUDGET_S, SCENES)
    with step(named("the ladder of time steps", options), 1, 2):
        rows = run_ladder(options.budget_s or budget_s, scenes, short=options.quick)
    with step(named("other ways to save time or error", options), 2, 2):
        levers = [*measure_levers()]
    table = frame_of(LadderRun, rows)
    return {"trade": rows, "trade-levers": levers, "trade-advice": advice(table), "trade-orders": orders(table)}


def sentences(tables: Tables) -> list[str]:
    """Cost of a usual error on the first scene, start-up times, orders of convergence of the force."""
    rows, advised, found = tables["trade"], tables["trade-advice"], tables["trade-orders"]
    scene = rows["scene"].iloc[0]
    costs = [f"{_time(row['loop_s'])} by {row['method']}" for row in _usual(advised, scene).to_dict("records")]
    starts = done(rows)[["method", "start_s"]].drop_duplicates().sort_values("start_s", kind="stable")
    engines = starts[starts["method"] == starts["method"].map(engine_of)]
    ranges = found[found["quantity"] == "force"].groupby("method", sort=False)["order"].agg(["min", "max"])
    return [
        f"{scene}, error of the force at most {TYPICAL:.0e}: the time loop takes {', '.join(costs)}.",
        f"A process of its own takes {', '.join(f'{_time(s)} ({name})' for name, s in engines.to_numpy())} to start.",
        "Order of convergence of the force: "
        + ", ".join(f"{method} {low:.2f} to {high:.2f}" for method, low, high in ranges.itertuples())
        + f" ({ORDER_4} keeps its order only while no contact opens or closes).",
    ]


def _usual(advised: pd.DataFrame, scene: str) -> pd.DataFrame:
    """Runs of a scene that keep a usual error of the force, cheapest first."""
    kept = (
        np.isclose(advised["error_at_most"], TYPICAL) & (advised["scene"] == scene) & (advised["quantity"] == "force")
    )
    return advised[kept].sort_values("loop_s", kind="stable")


def figures(tables: Tables) -> dict[str, Picture]:
    """Error of the force against time, for all scenes."""
    words = "Largest error of the force against the time of the loop, by scene"
    return {"trade": Picture(words, partial(draw_trade, tables["trade"]))}


def draw_trade(rows: pd.DataFrame) -> Any:
    """Draws the error of the force against the time of the loop: the first scene large, the others small."""
    first, *others = rows["scene"].unique()
    columns = [others[place : place + 2] for place in range(0, len(others), 2)]
    places = [[first, first, *(column[row % len(column)] for column in columns)] for row in range(2)]
    figure = pyplot().figure(figsize=(PAGE_IN, 3.9), layout="constrained")
    axes = figure.subplot_mosaic(places)
    shown = done(rows[rows["force"] > 0])
    for scene, axis in axes.items():
        own = shown[shown["scene"] == scene]
        for method in in_order(own["method"]):
            points = own[own["method"] == method]
            style = line_of(method)
            look = LOOK if method == ORDER_4 else {"color": style.colour, "ls": style.dashes, "marker": style.marker}
            axis.plot(points["loop_s"], points["force"], ms=3.5, lw=0.9, label=method, **look)
        axis.set(xscale="log", yscale="log")
        axis.set_title(scene, loc="left")
    axes[first].set_ylabel("largest error of the force / largest change of a force")
    axes[first].legend(fontsize=7, loc="lower left")
    figure.supxlabel("time of the loop, s", fontsize=8)
    return figure


def section(tables: Tables) -> dict[str, Any]:
    """Time steps that keep an error: all quantities of the first scene, the force of the others; and the levers.

    The steps are those of ``verlet``, the scheme of the codes.
    """
    rows, advised, levers = tables["trade"], tables["trade-advice"], tables["trade-levers"]
    first, *others = rows["scene"].unique()
    by_verlet = advised[advised["method"] == VERLET]
    steps_s = by_verlet.pivot(index=["scene", "quantity"], columns="error_at_most", values="time_step_s")
    chosen = [*((first, quantity) for quantity in QUANTITIES), *((scene, "force") for scene in others)]
    shown = steps_s.reindex(pd.MultiIndex.from_tuples(chosen), columns=SHOWN_TARGETS)
    worst = levers.groupby(["lever", "setting"], sort=False)[["error", "gain"]].max()
    return {
        "short": not set(SCENES) <= set(rows["scene"]),
        "targets": [f"{target:.0e}" for target in SHOWN_TARGETS],
        "advice": [
            [f"{scene}, {QUANTITIES[quantity]}", *map(_time, kept_s), _cheapest_code(advised, scene)]
            for (scene, quantity), *kept_s in shown.itertuples()
        ],
        "levers": [
            [f"{lever}: {setting}", short(error), f"{gain:.1f}" if pd.notna(gain) else None]
            for (lever, setting), error, gain in worst.itertuples()
        ],
    }


def _cheapest_code(advised: pd.DataFrame, scene: str) -> str:
    """Code with the shortest loop at a usual error of the force."""
    by_codes = [name for name in _usual(advised, scene)["method"] if name in codes()]
    return by_codes[0] if by_codes else "–"


def _time(seconds: float) -> str:
    """A time with two digits and a suitable unit; a dash for NaN."""
    return str(EngFormatter("s")(float(f"{seconds:.2g}"))) if pd.notna(seconds) else "–"


CHAPTER = Chapter(
    name="trade",
    title="cost of accuracy",
    tables={"trade": LadderRun, "trade-levers": Lever, "trade-advice": Advice, "trade-orders": Order},
    measure=measure,
    sentences=sentences,
    figures=figures,
    section=section,
)
