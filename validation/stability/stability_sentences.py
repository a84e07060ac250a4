"""Sentences of the stability study that a user can act on, and what it requires, computed from its tables."""

from collections import Counter
from collections.abc import Iterator

import numpy as np
import pandas as pd

from drivers.limits.criteria import CRITERIA
from validation.stability.long_runs import BEYOND_CHANCE
from validation.stability.measured_limits import CRITERION_KEYS, JUDGED, VERLET, WITHIN
from validation.stability.subjects import BOUNCING, SHIPPED
from validation.studies import Tables

WASTEFUL = 0.1  # of the measured limit: steps below it buy accuracy that stability does not ask for


def sentences(tables: Tables) -> list[str]:
    """The sentences, most general first."""
    limits, edge = tables["stability"], tables["stability-extremes"]
    said = [*_on_limits(limits), *_on_criteria(limits), *_on_extremes(edge)]
    for name, write in OPTIONAL.items():
        said += write(tables[name]) if name in tables else ()
    return said


def missed(tables: Tables) -> list[str]:
    """Where a prediction is wrong, or a scene at the edge fails."""
    limits, edge = tables["stability"], tables["stability-extremes"]
    wrong = limits[limits["group"].isin(JUDGED) & ~limits["ratio"].between(1.0, WITHIN)]
    failed = edge[edge["verdict"].isin(["failed", "timeout"])]
    return [
        *(f"{row['scene']} by {row['method']}: blows up at {row['ratio']:.3f} of the predicted limit, allowed 1 to"
          f" {WITHIN}" for _, row in wrong.iterrows()),
        *(f"{row['name']} on {row['engine']}: {row['verdict']}: {row['reason']}" for _, row in failed.iterrows()),
    ]  # fmt: skip


def _on_limits(limits: pd.DataFrame) -> Iterator[str]:
    scenes = limits["scene"].nunique()
    ratio = limits["ratio"]
    yield (
        f"Steps blow up at {ratio.min():.2f} to {ratio.max():.2f} times the predicted limit, on {scenes} scenes by"
        f" {_listed(sorted(limits['method'].unique()))}; the prediction lies above the measured limit on"
        f" {int((ratio < 1).sum())} of {len(ratio)}."
    )
    wide = limits.pivot_table(index="scene", columns="method", values="measured_s")
    codes = [name for name in wide.columns if name != VERLET]
    if codes:
        same = int((wide[codes].sub(wide[VERLET], axis=0).abs().max(axis=1) < 1e-9 * wide[VERLET]).sum())
        yield f"Codes and the in-repo scheme blow up at the very same step of the scan on {same} of {len(wide)} scenes."
    bounces = limits[(limits["group"] == BOUNCING) & (limits["method"] == VERLET)]
    if not bounces.empty:
        said = [
            f"{row['scene']} blows up at {row['measured_s'] * 1e6:.3g} µs, {row['ratio']:.2f} of the prediction"
            for _, row in bounces.iterrows()
        ]
        yield f"Errors of impacts add up, so that limits fall with them: {'; '.join(said)}."
    shipped = limits[(limits["group"] == SHIPPED) & (limits["method"] == VERLET)]
    share = shipped["bad_s"] / shipped["predicted_s"]
    yield (
        f"On the {SHIPPED} the energy gains a tenth from {share.min():.2f} to {share.max():.2f} of the predicted limit"
        " on: between that and the limit runs are stable and of no use."
    )


def _on_criteria(limits: pd.DataFrame) -> Iterator[str]:
    verlet = limits[limits["method"] == VERLET]
    for key, label in zip(CRITERION_KEYS, CRITERIA, strict=True):
        share, band = verlet[key] / verlet["measured_s"], verlet["bad_s"] / verlet["measured_s"]
        wrong, useless, wasteful = share > 1, (share <= 1) & (share > band), share < WASTEFUL
        yield (
            f"{label} lies between {share.min():.2g} and {share.max():.2g} of the measured limit on {len(verlet)}"
            f" scenes: beyond it on {wrong.sum()}, in the useless band on {useless.sum()}, below a tenth of it on"
            f" {wasteful.sum()}."
        )


def _on_extremes(extremes: pd.DataFrame) -> Iterator[str]:
    for engine, part in extremes.groupby("engine", sort=False):
        counts = Counter(part["verdict"])
        said = ", ".join(f"{counts[verdict]} {verdict}" for verdict in sorted(counts))
        yield f"{len(part)} scenes at the edge by {engine}: {said}."
    if extremes["model"].notna().any():
        worst = extremes.iloc[int(np.nanargmax(extremes["model"]))]
        yield (
            f"A code is furthest from the same scheme at the same step on “{worst['name']}”: {worst['model']:.1e} of"
            f" the largest force ({worst['engine']})."
        )


def _on_energy(energy: pd.DataFrame) -> Iterator[str]:
    for scene, part in energy.groupby("scene", sort=False):
        said = []
        for _, row in part.iterrows():
            drift = f"{row['drift']:.1e} ± {row['drift_error']:.0e}"
            drifts = abs(row["drift"]) > BEYOND_CHANCE * row["drift_error"]
            moves = f"drifts by {drift}" if drifts else f"does not drift ({drift})"
            said.append(f"{row['method']} errs by {row['largest']:.1e} and {moves}")
        yield f"Energy over {part['steps'].iloc[0]:.0e} steps, {scene}: {'; '.join(said)}."


def _on_horizons(horizons: pd.DataFrame) -> Iterator[str]:
    for (one, other), part in horizons.groupby(["one", "other"], sort=False):
        until = part["until_s"].fillna(part["duration_s"]) * 1e3
        steps = part["time_step_s"] * 1e6
        yield (
            f"{one} and {other} agree to 1 % for {until.min():.2g} to {until.max():.2g} ms at steps of"
            f" {steps.min():g} to {steps.max():g} µs: {until.iloc[int(np.argmin(steps))]:.2g} ms at the smallest."
        )


def _on_statistics(statistics: pd.DataFrame) -> Iterator[str]:
    for quantity, part in statistics.groupby("quantity", sort=False):
        said = ", ".join(f"{row['method']} {row['mean']:.3g} ± {row['error']:.1g}" for _, row in part.iterrows())
        yield f"Past the horizon, mean {quantity}: {said}."


def _on_rounding(rounding: pd.DataFrame) -> Iterator[str]:
    few = rounding[rounding["beads"] == rounding["beads"].min()]
    for method, part in few.groupby("method", sort=False):
        near, far = (part[part["height_m"] == height]["error"] for height in (0.0, 1e3))
        yield (
            f"Forces at rest by {method}: off by {near.min():.0e} to {near.max():.0e} with the wall at 0, by"
            f" {far.min():.0e} to {far.max():.0e} with it at 1 km (overlaps from {part['overlap_m'].max():.1g} down to"
            f" {part['overlap_m'].min():.1g} m)."
        )
    many = rounding[rounding["beads"] == rounding["beads"].max()]
    said = ", ".join(f"{row['method']} {row['error']:.0e}" for _, row in many.iterrows())
    yield f"In a chain of {int(many['beads'].iloc[0]):,} beads pressed with 1 N: {said}."
    ulp = np.spacing(1.0)
    yield (
        "Heights lose 3/2 of a unit in the last place over the overlap: six digits are left as long as the overlap is"
        f" above {1.5 * ulp * 1e6:.1g} of the height, {1.5 * ulp * 1e6 * 1e9:.1g} nm a metre up. Overlaps lose none."
    )


OPTIONAL = {
    "stability-energy": _on_energy,
    "stability-horizons": _on_horizons,
    "stability-statistics": _on_statistics,
    "stability-rounding": _on_rounding,
}


def _listed(names: list[str]) -> str:
    return ", ".join(names[:-1]) + f" and {names[-1]}" if len(names) > 1 else "".join(names)
