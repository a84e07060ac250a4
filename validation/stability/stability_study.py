"""``python -m validation stability``: measures, and writes tables and maps."""

import sys
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import pandas as pd

from drivers.base import paths
from drivers.base.files import whole_file
from validation.stability import extremes, long_runs
from validation.stability import height_rounding as rounding
from validation.stability import measured_limits as limits
from validation.stability.stability_maps import draw_horizons, draw_limits, draw_rounding
from validation.stability.stability_sentences import LIMITS, TABLES, read_tables, sentences
from validation.stability.subjects import at_random, bouncing, shipped, sweeps

RANDOM_SCENES = 100
MAPS = {"limits": draw_limits, "horizons": draw_horizons, "rounding": draw_rounding}


def stability(results: Path, runs: Path, *, quick: bool = False) -> int:
    """Measures limits, extremes, long runs and rounding; the exit code is 1 where a requirement is missed.

    ``quick`` leaves out random scenes, most extremes, long runs and rounding.
    """
    subjects = [*shipped(), *sweeps(), *([] if quick else (*bouncing(), *at_random(RANDOM_SCENES)))]
    measured: dict[str, Sequence[Any]] = {
        "limits": limits.measure(subjects, _say),
        "extremes": extremes.run_all(extremes.extremes(quick=quick), runs, _say),
    }
    if not quick:
        measured["energy"] = long_runs.energies(_say)
        measured["horizons"] = long_runs.horizons(_say)
        measured["statistics"] = long_runs.statistics(_say)
        measured["rounding"] = rounding.measure(_say)
    tables = write_study(measured, results)
    for line in sentences(tables):
        print(line)
    print(f"{paths.shown(results / LIMITS)}: limits of {len(subjects)} scenes")
    complaints = missed(tables)
    for complaint in complaints:
        print(complaint, file=sys.stderr)
    return 1 if complaints else 0


def write_study(measured: Mapping[str, Sequence[Any]], results: Path) -> dict[str, pd.DataFrame]:
    """Writes tables and maps, and returns the tables; those of a former study that this one has not are removed."""
    results.mkdir(parents=True, exist_ok=True)
    for name, file in TABLES.items():
        if name in measured:
            with whole_file(results / file) as draft:
                pd.DataFrame([asdict(row) for row in measured[name]]).to_csv(draft, index=False)
        else:
            (results / file).unlink(missing_ok=True)
    tables = read_tables(results)
    for name, draw in MAPS.items():
        path = results / f"stability-{name}.svg"
        if name not in tables:
            path.unlink(missing_ok=True)
            continue
        with whole_file(path) as draft:
            draw(tables[name]).savefig(draft, format="svg", metadata={"Date": None})
    return tables


def missed(tables: dict[str, pd.DataFrame]) -> list[str]:
    """Where a prediction is wrong, or a scene at the edge fails."""
    limit, edge = tables["limits"], tables["extremes"]
    judged = limit[limit["group"].isin(limits.JUDGED)]
    wrong = judged[~judged["ratio"].between(1.0, limits.WITHIN)]
    failed = edge[edge["verdict"].isin(["failed", "timeout"])]
    return [
        *(f"{row['scene']} by {row['method']}: blows up at {row['ratio']:.3f} of the predicted limit, allowed 1 to"
          f" {limits.WITHIN}" for _, row in wrong.iterrows()),
        *(f"{row['name']} on {row['engine']}: {row['verdict']}: {row['reason']}" for _, row in failed.iterrows()),
    ]  # fmt: skip


def _say(line: str) -> None:
    print(line, file=sys.stderr, flush=True)
