"""The stability study as the report shows it, read from its tables."""

from pathlib import Path
from typing import Any

import pandas as pd

from drivers import paths
from drivers.errors import InputError
from postproc.style import inline_svg
from validation.criteria import CRITERIA
from validation.stability.limits import CRITERION_KEYS
from validation.stability.maps import draw_horizons, draw_limits, draw_rounding
from validation.stability.scenes import SHIPPED
from validation.stability.words import LIMITS, WASTEFUL, read_tables, sentences

FIGURES = {
    "limits": (draw_limits, "Predicted steps and users' criteria over the measured limit"),
    "horizons": (draw_horizons, "How long two methods agree to a per cent, by time step"),
    "rounding": (draw_rounding, "Relative error of a contact's force against its overlap"),
}


def read_section(results: Path) -> dict[str, Any]:
    """Sentences, tables and maps; empty without the tables.

    Raises:
        InputError: a table is damaged.
    """
    if not (results / LIMITS).exists():
        return {}
    try:
        tables = read_tables(results)
        return {
            "sentences": sentences(tables),
            "criteria": list(CRITERIA),
            "limits": [_limit(row) for _, row in tables["limits"].iterrows() if row["group"] == SHIPPED],
            "extremes": _extremes(tables["extremes"]),
            "figures": [
                (words, inline_svg(draw(tables[name]), f"stability-{name}"))
                for name, (draw, words) in FIGURES.items()
                if name in tables
            ],
        }
    except (ValueError, KeyError, IndexError, TypeError, AttributeError) as error:
        raise InputError(
            paths.shown(results / LIMITS), "", "a damaged table", "the tables that make stability writes"
        ) from error


def _limit(row: "pd.Series[Any]") -> dict[str, Any]:
    criteria = []
    for key in CRITERION_KEYS:
        share = row[key] / row["measured_s"]
        verdict = "wrong" if share > 1 else "useless" if share > row["bad_s"] / row["measured_s"] else ""
        criteria.append((f"{share:.2f}", verdict or ("wasteful" if share < WASTEFUL else "safe")))
    bad = f"{row['bad_s'] * 1e6:.3g}" if pd.notna(row["bad_s"]) else "–"
    micros = {key: f"{row[f'{key}_s'] * 1e6:.4g}" for key in ("predicted", "measured")}
    named = {"scene": row["scene"], "method": row["method"], "ratio": f"{row['ratio']:.3f}"}
    return named | micros | {"bad": bad, "criteria": criteria}


def _extremes(extremes: pd.DataFrame) -> list[dict[str, Any]]:
    """For each scene its verdict and numbers on every engine."""
    lines = []
    for name, part in extremes.groupby("name", sort=False):
        engines = [
            {
                "engine": row["engine"],
                "verdict": row["verdict"],
                "reason": row["reason"] if pd.notna(row["reason"]) else "",
                "error": _short(row["error"]),
                "model": _short(row["model"]),
                "leaves": f"{row['leaves_reference_s'] * 1e3:.3g} ms" if pd.notna(row["leaves_reference_s"]) else "",
            }
            for _, row in part.iterrows()
        ]
        lines.append({"name": name, "engines": engines, "share": f"{part['share_of_limit'].iloc[0]:.2g}"})
    return lines


def _short(value: float) -> str:
    return f"{value:.0e}" if pd.notna(value) else "–"
