"""The trade study: errors against cost, for every engine and step, and what to use."""

from typing import Any

import pandas as pd

from validation.studies import Options, Study, Tables
from validation.study_tables import frame_of
from validation.trade.advice import QUANTITIES, TARGETS, Advice, Order, advice, cheapest, orders
from validation.trade.climb import Row, climb
from validation.trade.ladder import BUDGET_S
from validation.trade.levers import Lever, pull_all
from validation.trade.trade_sentences import codes_in, sentences
from validation.trade.work_precision import figures

UNITS = ((1.0, "s"), (1e-3, "ms"), (1e-6, "µs"), (1e-9, "ns"))


def measure(options: Options) -> dict[str, Any]:
    """The ladder within a budget of engine time, the levers, and what follows from the ladder."""
    rows = climb(options.budget_s or BUDGET_S)
    table = frame_of(Row, rows)
    return {"trade": rows, "trade-levers": pull_all(), "trade-advice": advice(table), "trade-orders": orders(table)}


def section(tables: Tables) -> dict[str, Any]:
    """Cheapest code for each error: on the first scene in all quantities, on the others of the force."""
    rows = tables["trade"]
    first, *others = rows["scene"].unique()
    chosen = [*((first, quantity) for quantity in QUANTITIES), *((scene, "force") for scene in others)]
    among = rows[rows["method"].isin(codes_in(rows))] if codes_in(rows) else rows
    return {
        "table": [_line(among[among["scene"] == scene], scene, quantity) for scene, quantity in chosen],
        "targets": [f"{target:.0e}" for target in TARGETS],
    }


def _line(rows: pd.DataFrame, scene: str, quantity: str) -> dict[str, Any]:
    """For each error the cheapest run: its code, or method where no code was run, step, and time of the loop."""
    cells: list[tuple[str, ...]] = []
    for target in TARGETS:
        best = cheapest(rows, quantity, target, "loop_s")
        cells.append(() if best is None else (best["method"], _time(best["time_step_s"]), _time(best["loop_s"])))
    return {"scene": scene, "quantity": QUANTITIES[quantity], "cells": cells}


def _time(seconds: float) -> str:
    """Two digits, in the unit in which they are easily read."""
    if pd.isna(seconds):
        return "of its own"
    two = float(f"{seconds:.2g}")
    scale, unit = next(((each, name) for each, name in UNITS if two >= each), UNITS[-1])
    return f"{two / scale:.3g} {unit}"


STUDY = Study(
    name="trade",
    tables={"trade": Row, "trade-levers": Lever, "trade-advice": Advice, "trade-orders": Order},
    measure=measure,
    sentences=sentences,
    figures=figures,
    section=section,
)
