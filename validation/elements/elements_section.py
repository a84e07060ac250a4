"""The study of elements as the report shows it, read from its tables and figures."""

from pathlib import Path
from typing import Any

import pandas as pd

from drivers.base import paths
from drivers.base.errors import InputError
from validation.elements.element_figures import draw_effects
from validation.elements.elements_sentences import TABLES, read_tables, sentences
from validation.elements.switches import read_elements
from validation.report.page_figures import Picture, read_picture, stored_or_drawn


def read_section(results: Path) -> dict[str, Any]:
    """Sentences, tables and figures, and whether it is the short study; empty without the tables.

    Raises:
        InputError: a table is damaged.
    """
    if not all((results / file).exists() for file in TABLES.values()):
        return {}
    try:
        tables = read_tables(results)
        effects = tables["effects"]
        names = list(effects["observable"].unique())
        return {
            "sentences": sentences(tables),
            "short": not {subject.name for subject in read_elements().scene} <= set(effects["scene"]),
            "observables": names,
            "effects": {scene: _rows(own, names) for scene, own in effects.groupby("scene", sort=False)},
            "figures": [
                ("Effect of each element against its cost", _effects(results, effects)),
                *_oscilloscopes(results, effects["scene"].unique()),
            ],
        }
    except (ValueError, KeyError, IndexError, TypeError, AttributeError) as error:
        found = "a damaged table"
        raise InputError(paths.shown(results / TABLES["effects"]), "", found, "what make elements writes") from error


def _effects(results: Path, effects: pd.DataFrame) -> Picture:
    table = results / TABLES["effects"]
    return stored_or_drawn(results / "elements.svg", table, lambda: draw_effects(effects))


def _oscilloscopes(results: Path, scenes: Any) -> list[tuple[str, Picture]]:
    """What gauges show of each scene; those that were not drawn are left out."""
    figures = []
    for scene in scenes:
        figure = read_picture(results / f"oscilloscope-{scene}.svg")
        if figure:
            words = f"{scene}: what the gauges show, from the elastic line to the gauge's electronics"
            figures.append((words, figure))
    return figures


def _rows(effects: pd.DataFrame, names: list[str]) -> list[dict[str, Any]]:
    rows = []
    for (element, engine), own in effects.groupby(["element", "engine"], sort=False):
        by_name = own.set_index("observable")
        cells = [_cell(by_name["change"].get(name), by_name["spread"].get(name)) for name in names]
        cost, ratio = own["cost_ns"].iloc[0], own["cost_ratio"].iloc[0]
        rows.append(
            {"element": element, "engine": engine, "cells": cells, "cost": f"{cost:.3g}", "ratio": f"{ratio:.2f}"}
        )
    return rows


def _cell(change: Any, spread: Any) -> str:
    if change is None or pd.isna(change):
        return "–"
    return f"{100 * change:+.3g}" + (f" ± {100 * spread:.1g}" if pd.notna(spread) else "")
