"""The trade study: errors against cost, advice, a figure."""

from collections import defaultdict
from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial
from math import inf
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.ticker import EngFormatter

from drivers.engines import VERLET, codes, in_order
from postproc.draw.style import PAGE_IN, line_of, marker_of, pyplot
from validation.chapters import Chapter, Options, Picture, Tables, frame_of
from validation.checks import short
from validation.trade.ladder import (
    BUDGET_S,
    DONE,
    SCENES,
    SHORT_BUDGET_S,
    SHORT_SCENES,
    LadderRun,
    run_ladder,
)
from validation.trade.softening import Softened, soften

TARGETS = tuple(10.0**-k for k in range(2, 9))
SHOWN_TARGETS = TARGETS[::2]
TYPICAL = 1e-4  # error of the force in sentences
STRAIGHT = 0.9e-3, 0.11  # shares of the stability limit between rounding and large errors, which show the order
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


@dataclass(frozen=True)
class Advice:
    """Run with the largest step of one method that keeps an error of one quantity; no row if none does."""

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


def orders(rows: pd.DataFrame) -> dict[str, tuple[float, float]]:
    """Smallest and largest order of convergence of the force over the scenes, by method at a fixed step."""
    fixed = done(rows).dropna(subset=["time_step_s"])
    straight = fixed[fixed["share_of_limit"].between(*STRAIGHT)]
    by_method: dict[str, list[float]] = defaultdict(list)
    for (method, _), part in straight.groupby(["method", "scene"], sort=False):
        if len(part) > 1:
            by_method[str(method)].append(float(np.polyfit(np.log(part["time_step_s"]), np.log(part["force"]), 1)[0]))
    return {method: (min(slopes), max(slopes)) for method, slopes in by_method.items()}


def advice(rows: pd.DataFrame) -> Iterator[Advice]:
    """Largest step by scene, method and quantity that keeps an error, as all smaller measured steps do."""
    for (scene, method), ladder in done(rows).groupby(["scene", "method"], sort=False):
        steps_s, loops_s = ladder["time_step_s"].to_numpy(), ladder["loop_s"].to_numpy()
        for quantity in QUANTITIES:
            errors = ladder[quantity].to_numpy()
            largest = ladder[quantity].fillna(inf).cummax().to_numpy()  # so that no error is small by chance
            for target, good in zip(TARGETS, np.searchsorted(largest, TARGETS, side="right"), strict=True):
                if good:
                    run = steps_s[good - 1], loops_s[good - 1], errors[good - 1]
                    yield Advice(str(scene), quantity, target, str(method), *map(float, run))


def measure(options: Options) -> dict[str, Any]:
    """Measures the ladder and softened beads; derives advice."""
    budget_s, scenes = (SHORT_BUDGET_S, SHORT_SCENES) if options.quick else (BUDGET_S, SCENES)
    rows = run_ladder(options.budget_s or budget_s, scenes, short=options.quick)
    return {"trade": rows, "trade-advice": advice(frame_of(LadderRun, rows)), "trade-softening": soften()}


def sentences(tables: Tables) -> list[str]:
    """Cost of a usual error on the first scene, start-up times, orders of convergence of the force."""
    rows, advised = tables["trade"], tables["trade-advice"]
    scene = rows["scene"].iloc[0]
    costs = [f"{_time(row['loop_s'])} by {row['method']}" for row in _usual(advised, scene).to_dict("records")]
    starts = done(rows)[["method", "start_s"]].drop_duplicates().sort_values("start_s", kind="stable")
    ranges = ", ".join(f"{low:.2f} to {high:.2f} by {name}" for name, (low, high) in orders(rows).items())
    return [
        f"{scene}, error of the force at most {_power(TYPICAL)}: the time loop takes {', '.join(costs)}.",
        f"A process of its own takes {', '.join(f'{_time(s)} ({name})' for name, s in starts.to_numpy())} to start.",
        f"Orders of convergence of the force: {ranges}.",
    ]


def _usual(advised: pd.DataFrame, scene: str) -> pd.DataFrame:
    """Runs of a scene that keep a usual error of the force, cheapest first."""
    kept = (
        np.isclose(advised["error_at_most"], TYPICAL) & (advised["scene"] == scene) & (advised["quantity"] == "force")
    )
    return advised[kept].sort_values("loop_s", kind="stable")


def figures(tables: Tables) -> dict[str, Picture]:
    """Error of the force against time, for all scenes."""
    caption = "Largest error of the force against the time of the loop, by scene"
    return {"trade": (caption, partial(draw_trade, tables["trade"]))}


def draw_trade(rows: pd.DataFrame) -> Any:
    """Draws the error of the force against the time of the loop: the first scene large, the others small."""
    first, *others = rows["scene"].unique()
    columns = [others[place : place + 2] for place in range(0, len(others), 2)]
    places = [[first, first, *(column[row % len(column)] for column in columns)] for row in range(2)]
    figure = pyplot().figure(figsize=(PAGE_IN, 3.9), layout="constrained")
    axes = figure.subplot_mosaic(places)
    shown = done(rows[rows["force"] > 0])
    for scene, axis in axes.items():
        of_scene = shown[shown["scene"] == scene]
        for method in in_order(of_scene["method"]):
            points = of_scene[of_scene["method"] == method]
            look = line_of(method) | {"marker": marker_of(method)["marker"]}
            axis.plot(points["loop_s"], points["force"], label=method, **look | {"ms": 3.5, "lw": 0.9})
        axis.set(xscale="log", yscale="log")
        axis.set_title(scene, loc="left")
    axes[first].set_ylabel("largest error of the force / largest change of a force")
    axes[first].legend(fontsize=7, loc="lower left")
    figure.supxlabel("time of the loop, s", fontsize=8)
    return figure


def section(tables: Tables) -> dict[str, Any]:
    """Time steps that keep an error: all quantities of the first scene, the force of the others; and softened beads.

    The steps are those of ``verlet``, the scheme of the codes, for errors that a code keeps.
    """
    rows, advised, softened = tables["trade"], tables["trade-advice"], tables["trade-softening"]
    first, *others = rows["scene"].unique()
    by_verlet, by_codes = advised[advised["method"] == VERLET], advised[advised["method"].isin(codes())]
    if not by_codes.empty:  # their rounding may be larger than a small error
        by_verlet = by_verlet.merge(by_codes[["scene", "quantity", "error_at_most"]].drop_duplicates())
    steps_s = by_verlet.pivot(index=["scene", "quantity"], columns="error_at_most", values="time_step_s")
    chosen = [*((first, quantity) for quantity in QUANTITIES), *((scene, "force") for scene in others)]
    shown = steps_s.reindex(pd.MultiIndex.from_tuples(chosen), columns=SHOWN_TARGETS)
    worst = softened.groupby("setting", sort=False)[["error", "gain"]].max()
    return {
        "short": not set(SCENES) <= set(rows["scene"]),
        "targets": [_power(target) for target in SHOWN_TARGETS],
        "advice": [
            [
                f"{scene}, {QUANTITIES[quantity]}",
                *map(_time, kept_s),
                next(iter(_usual(by_codes, scene)["method"]), "–"),
            ]
            for (scene, quantity), *kept_s in shown.itertuples()
        ],
        "softened": [[setting, short(error), f"{gain:.1f}"] for setting, error, gain in worst.itertuples()],
    }


def _power(error: float) -> str:
    return f"1e{round(np.log10(error))}"


def _time(seconds: float) -> str:
    """A time with two digits and a suitable unit; a dash for NaN."""
    return str(EngFormatter("s")(float(f"{seconds:.2g}"))) if pd.notna(seconds) else "–"


CHAPTER = Chapter(
    name="trade",
    title="cost of accuracy",
    tables={"trade": LadderRun, "trade-advice": Advice, "trade-softening": Softened},
    measure=measure,
    sentences=sentences,
    figures=figures,
    section=section,
)
