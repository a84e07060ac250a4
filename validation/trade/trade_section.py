"""The trade study as the report shows it, read from its tables."""

from pathlib import Path
from typing import Any

import pandas as pd

from drivers.base import paths
from drivers.base.errors import InputError
from validation.report.page_figures import Picture, stored_or_drawn
from validation.trade.advice import QUANTITIES, TARGETS, cheapest
from validation.trade.trade_sentences import sentences
from validation.trade.trade_study import LEVERS, TABLE
from validation.trade.work_precision import draw_scene

UNITS = ((1.0, "s"), (1e-3, "ms"), (1e-6, "µs"), (1e-9, "ns"))


def read_section(results: Path) -> dict[str, Any]:
    """Sentences, the table of what to use and the diagrams; empty without the tables.

    Raises:
        InputError: a table is damaged.
    """
    table, levers = results / TABLE, results / LEVERS
    if not (table.exists() and levers.exists()):
        return {}
    try:
        rows = pd.read_csv(table)
        scenes = list(rows["scene"].unique())
        return {
            "sentences": sentences(rows, pd.read_csv(levers)),
            "table": [_line(rows, scene, quantity) for scene in scenes[:1] for quantity in QUANTITIES]
            + [_line(rows, scene, "force") for scene in scenes[1:]],
            "targets": [f"{target:.0e}" for target in TARGETS],
            "figures": [(scene, _figure(results, rows, scene)) for scene in scenes],
        }
    except (ValueError, KeyError, IndexError, TypeError) as error:  # pandas' own errors are ValueErrors
        raise InputError(paths.shown(table), "", "a damaged table", "the tables that make trade writes") from error


def _figure(results: Path, rows: pd.DataFrame, scene: str) -> Picture:
    stored = results / f"trade-{scene}.svg"
    return stored_or_drawn(stored, results / TABLE, lambda: draw_scene(rows, scene))


def _line(rows: pd.DataFrame, scene: str, quantity: str) -> dict[str, Any]:
    """For each error the cheapest code, its step and the time of its loop."""
    part = rows[(rows["scene"] == scene) & rows["method"].isin(["liggghts", "yade"])]
    cells: list[tuple[str, ...]] = []
    for target in TARGETS:
        best = cheapest(part, quantity, target, "loop_s")
        cells.append(() if best is None else (best["method"], _time(best["time_step_s"]), _time(best["loop_s"])))
    return {"scene": scene, "quantity": QUANTITIES[quantity], "cells": cells}


def _time(seconds: float) -> str:
    """Two digits, in the unit in which they are easily read."""
    two = float(f"{seconds:.2g}")
    scale, unit = next(((each, name) for each, name in UNITS if two >= each), UNITS[-1])
    return f"{two / scale:.3g} {unit}"
