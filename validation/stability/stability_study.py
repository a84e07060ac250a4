"""The stability study: limits of the time step, scenes at the edge, long runs, rounding of heights."""

from collections.abc import Callable, Iterable
from typing import Any

import pandas as pd

from drivers.limits.criteria import CRITERIA
from validation.stability.extremes import Outcome, extremes, run_all
from validation.stability.height_rounding import Rounded, measure_rounding
from validation.stability.long_runs import Energy, Horizon, Statistic, energies, horizons, statistics
from validation.stability.measured_limits import CRITERION_KEYS, VERLET, Limit, measure_limits
from validation.stability.stability_maps import figures
from validation.stability.stability_sentences import WASTEFUL, missed, sentences
from validation.stability.subjects import SHIPPED, at_random, bouncing, shipped, sweeps
from validation.studies import Options, Study, Tables

RANDOM_SCENES = 100
LONG: dict[str, Callable[[], Iterable[Any]]] = {
    "stability-energy": energies,
    "stability-horizons": horizons,
    "stability-statistics": statistics,
    "stability-rounding": measure_rounding,
}


def measure(options: Options) -> dict[str, Any]:
    """All of it; the short study leaves out random scenes, most extremes, long runs and rounding."""
    subjects = (
        [*shipped(), *sweeps()] if options.quick else [*shipped(), *sweeps(), *bouncing(), *at_random(RANDOM_SCENES)]
    )
    edge = run_all(extremes(quick=options.quick), options.runs)
    rows = {"stability": measure_limits(subjects), "stability-extremes": edge}
    return rows if options.quick else rows | {name: run() for name, run in LONG.items()}


def section(tables: Tables) -> dict[str, Any]:
    """Limits of the shipped scenes with users' criteria, verdicts at the edge, and whether it is the short study."""
    return {
        "short": not LONG.keys() <= tables.keys(),
        "criteria": list(CRITERIA),
        "methods": list(tables["stability"]["method"].unique()),
        "limits": _limits(tables["stability"]),
        "extremes": _extremes(tables["stability-extremes"]),
    }


def _limits(limits: pd.DataFrame) -> list[dict[str, Any]]:
    """For each shipped scene the predicted step, the measured ones, and users' criteria as shares of Verlet's."""
    lines = []
    for scene, part in limits[limits["group"] == SHIPPED].groupby("scene", sort=False):
        own = part.set_index("method")
        verlet: dict[Any, Any] = own.loc[VERLET].to_dict()
        measured_s = own["measured_s"].reindex(limits["method"].unique())
        shares = [verlet[key] / verlet["measured_s"] for key in CRITERION_KEYS]
        band = verlet["bad_s"] / verlet["measured_s"]
        lines.append(
            {
                "scene": scene,
                "predicted": _micro(verlet["predicted_s"]),
                "measured": [_micro(step_s) for step_s in measured_s],
                "bad": _micro(verlet["bad_s"]),
                "criteria": [(f"{share:.2f}", _usefulness(share, band)) for share in shares],
            }
        )
    return lines


def _usefulness(share: float, band: float) -> str:
    if share > 1:
        return "wrong"
    return "useless" if share > band else "wasteful" if share < WASTEFUL else "safe"


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
                "reason": row["reason"],
                "numbers": [f"{row[key]:.0e}" for key in ("error", "model") if pd.notna(row[key])],
                "leaves": f"{row['leaves_reference_s'] * 1e3:.3g} ms" if pd.notna(row["leaves_reference_s"]) else "",
            }
            for _, row in part.iterrows()
        ]
        lines.append({"name": name, "engines": engines, "share": f"{part['share_of_limit'].iloc[0]:.2g}"})
    return lines


STUDY = Study(
    name="stability",
    tables={
        "stability": Limit,
        "stability-extremes": Outcome,
        "stability-energy": Energy,
        "stability-horizons": Horizon,
        "stability-statistics": Statistic,
        "stability-rounding": Rounded,
    },
    measure=measure,
    sentences=sentences,
    figures=figures,
    section=section,
    missed=missed,
    optional=frozenset(LONG),
)
