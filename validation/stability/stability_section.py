"""The stability study as the report shows it, read from its tables."""

from math import nan
from pathlib import Path
from typing import Any

import pandas as pd

from drivers.base import paths
from drivers.base.errors import InputError
from drivers.limits.criteria import CRITERIA
from validation.report.page_figures import Picture, stored_or_drawn
from validation.stability.measured_limits import CRITERION_KEYS
from validation.stability.stability_maps import draw_horizons, draw_limits, draw_rounding
from validation.stability.stability_sentences import LIMITS, TABLES, WASTEFUL, read_tables, sentences
from validation.stability.subjects import SHIPPED

FIGURES = {
    "limits": (draw_limits, "Predicted steps and users' criteria over the measured limit"),
    "horizons": (draw_horizons, "How long two methods agree to a per cent, by time step"),
    "rounding": (draw_rounding, "Relative error of a contact's force against its overlap"),
}


def read_section(results: Path) -> dict[str, Any]:
    """Sentences, tables and maps, and whether it is the short study; empty without the tables.

    Raises:
        InputError: a table is damaged.
    """
    if not (results / LIMITS).exists():
        return {}
    try:
        tables = read_tables(results)
        return {
            "sentences": sentences(tables),
            "short": not set(FIGURES) <= tables.keys(),
            "criteria": list(CRITERIA),
            "methods": list(tables["limits"]["method"].unique()),
            "limits": _limits(tables["limits"]),
            "extremes": _extremes(tables["extremes"]),
            "figures": [
                (words, _figure(results, tables[name], name)) for name, (_, words) in FIGURES.items() if name in tables
            ],
        }
    except (ValueError, KeyError, IndexError, TypeError, AttributeError) as error:
        raise InputError(
            paths.shown(results / LIMITS), "", "a damaged table", "the tables that make stability writes"
        ) from error


def _figure(results: Path, table: pd.DataFrame, name: str) -> Picture:
    stored = results / f"stability-{name}.svg"
    return stored_or_drawn(stored, results / TABLES[name], lambda: FIGURES[name][0](table))


def _limits(limits: pd.DataFrame) -> list[dict[str, Any]]:
    """For each shipped scene the predicted step, the measured ones, and users' criteria as shares of Verlet's."""
    lines = []
    for scene, part in limits[limits["group"] == SHIPPED].groupby("scene", sort=False):
        own: dict[Any, dict[Any, Any]] = part.set_index("method").to_dict("index")
        verlet, criteria = own["verlet"], []
        for key in CRITERION_KEYS:
            share = verlet[key] / verlet["measured_s"]
            verdict = "wrong" if share > 1 else "useless" if share > verlet["bad_s"] / verlet["measured_s"] else ""
            criteria.append((f"{share:.2f}", verdict or ("wasteful" if share < WASTEFUL else "safe")))
        lines.append(
            {
                "scene": scene,
                "predicted": _micro(verlet["predicted_s"]),
                "measured": [
                    _micro(own[method]["measured_s"] if method in own else nan) for method in limits["method"].unique()
                ],
                "bad": _micro(verlet["bad_s"]),
                "criteria": criteria,
            }
        )
    return lines


def _micro(seconds: float) -> str:
    return f"{seconds * 1e6:.4g}" if pd.notna(seconds) else "–"


def _extremes(extremes: pd.DataFrame) -> list[dict[str, Any]]:
    """For each scene its verdict and numbers on every engine."""
    lines = []
    for name, part in extremes.groupby("name", sort=False):
        engines = [
            {
                "engine": row["engine"],
                "verdict": row["verdict"],
                "reason": row["reason"] if pd.notna(row["reason"]) else "",
                "numbers": [_short(row[key]) for key in ("error", "model") if pd.notna(row[key])],
                "leaves": f"{row['leaves_reference_s'] * 1e3:.3g} ms" if pd.notna(row["leaves_reference_s"]) else "",
            }
            for _, row in part.iterrows()
        ]
        lines.append({"name": name, "engines": engines, "share": f"{part['share_of_limit'].iloc[0]:.2g}"})
    return lines


def _short(value: float) -> str:
    return f"{value:.0e}"
