"""``python -m validation stability``: measures, and writes tables and maps."""

import sys
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import pandas as pd

from drivers import paths
from drivers.whole_file import whole_file
from validation.stability import extremes, limits, long_runs, rounding
from validation.stability.maps import draw_horizons, draw_limits, draw_rounding
from validation.stability.scenes import at_random, shipped, sweeps
from validation.stability.words import LIMITS, TABLES, read_tables, sentences

RANDOM_SCENES = 100


def stability(results: Path, runs: Path, *, quick: bool = False) -> int:
    """Measures limits, extremes, long runs and rounding; the exit code is 1 where a requirement is missed.

    ``quick`` leaves out random scenes, most extremes, long runs and rounding.
    """
    subjects = [*shipped(), *sweeps(), *([] if quick else at_random(RANDOM_SCENES))]
    tables: dict[str, Sequence[Any]] = {
        "limits": limits.measure(subjects, _say),
        "extremes": extremes.run_all(extremes.extremes(quick=quick), runs, _say),
    }
    if not quick:
        tables["energy"] = long_runs.energies(_say)
        tables["horizons"] = long_runs.horizons(_say)
        tables["statistics"] = long_runs.statistics(_say)
        tables["rounding"] = rounding.measure(_say)
    for name, rows in tables.items():
        _write(pd.DataFrame([asdict(row) for row in rows]), results / TABLES[name])
    for name in TABLES.keys() - tables.keys():
        (results / TABLES[name]).unlink(missing_ok=True)  # of a former, whole study: tables belong together
    found = read_tables(results)
    for name, draw in (("limits", draw_limits), ("horizons", draw_horizons), ("rounding", draw_rounding)):
        if name in found:
            with whole_file(results / f"stability-{name}.svg") as draft:
                draw(found[name]).savefig(draft, format="svg", metadata={"Date": None})
    for line in sentences(found):
        print(line)
    print(f"{paths.shown(results / LIMITS)}: limits of {len(subjects)} scenes")
    return 0 if _kept(found) else 1


def _kept(tables: dict[str, pd.DataFrame]) -> bool:
    """Whether predictions are right, and nothing at the edge fails."""
    limit, edge = tables["limits"], tables["extremes"]
    judged = limit[limit["group"].isin(limits.JUDGED)]
    wrong = judged[~judged["ratio"].between(1.0, limits.WITHIN)]
    failed = edge[edge["verdict"].isin(["failed", "timeout"])]
    for _, row in wrong.iterrows():
        print(f"{row['scene']} by {row['method']}: measured over predicted limit {row['ratio']:.3f}", file=sys.stderr)
    for _, row in failed.iterrows():
        print(f"{row['name']} on {row['engine']}: {row['verdict']}: {row['reason']}", file=sys.stderr)
    return wrong.empty and failed.empty


def _write(table: pd.DataFrame, path: Path) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    with whole_file(path) as draft:
        table.to_csv(draft, index=False)


def _say(line: str) -> None:
    print(line, file=sys.stderr, flush=True)
