"""The stability study: limits of the time step, scenes at the edge, long runs, rounding of heights."""

from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from functools import partial
from typing import Any

import numpy as np
import pandas as pd

from drivers.base.progress import step
from drivers.base.tolerances import tolerance
from drivers.engines import VERLET, codes
from drivers.limits.criteria import CRITERIA
from drivers.limits.refusal import FORCE
from postproc.draw.style import COLUMN_IN, GREY, marker_of, pyplot
from validation.accuracy.budget import ERROR, MODEL
from validation.chapters import Chapter, Options, Picture, Tables, named, rows_in
from validation.checks import FAIL, NOT_RUN, PASS, RUN, Check, judged, short
from validation.compare.answer import listed
from validation.stability import measured_limits, rounding_effects
from validation.stability.extremes import NOT_ACCURATE, extremes, run_all
from validation.stability.measured_limits import (
    BOUNCING,
    CRITERION_KEYS,
    JUDGED_GROUPS,
    SHIPPED,
    SWEEPS,
    Limit,
)

RANDOM_SCENES = 100
Part = tuple[str, Callable[[], Iterable[Any]]]  # words for progress lines, and the function that measures
LONG_PARTS: dict[str, Part] = {
    "stability-energy": ("energy over ten million steps", rounding_effects.energies),
    "stability-horizons": ("horizons of pairs of methods", rounding_effects.horizons),
    "stability-statistics": ("means beyond the horizon", rounding_effects.statistics),
    "stability-rounding": ("rounding of heights", rounding_effects.measure_rounding),
}
SMALL_STEP_SHARE = 0.1  # of the measured limit: smaller steps serve accuracy, not stability
COLOURS = ("#cc79a7", "#e69f00", "#56b4e9")


def measure(options: Options) -> dict[str, Any]:
    """Measures limits, extremes, long runs and rounding; the short study omits most scenes and all long runs."""
    more = () if options.quick else (*measured_limits.bouncing(), *measured_limits.at_random(RANDOM_SCENES))
    parts: dict[str, Part] = {
        "stability": (
            "limits of the time step",
            lambda: measured_limits.measure_limits([*measured_limits.shipped(), *measured_limits.sweeps(), *more]),
        ),
        "stability-extremes": ("extreme scenes", lambda: run_all(extremes(quick=options.quick), options.runs)),
    }
    parts |= {} if options.quick else LONG_PARTS
    rows = {}
    for number, (name, (what, run)) in enumerate(parts.items(), 1):
        with step(named(what, options), number, len(parts)):
            rows[name] = [*run()]
    return rows


def sentences(tables: Tables) -> list[str]:
    """Findings that no table or figure of the page shows."""
    said = {
        "stability": _on_limits,
        "stability-extremes": _on_extremes,
        "stability-energy": _on_energy,
        "stability-statistics": _on_statistics,
        "stability-rounding": _on_rounding,
    }
    return [line for name, write in said.items() if name in tables for line in write(tables[name])]


def judge(tables: Tables) -> Iterator[Check]:
    """Are predicted limits of the time step safe, and for the judged groups close to the measured ones?"""
    safe, close = tolerance("stability", "predicted"), tolerance("stability", "measured")
    for row in rows_in(tables["stability"], Limit):
        where = f"unstable from {row.ratio:.3f} of the predicted limit on" if row.ratio > 0 else "never unstable"
        name = row.scene, row.method
        yield judged(*name, "limit: predicted / measured", 1 / row.ratio if row.ratio > 0 else 0.0, safe, where)
        if row.group in JUDGED_GROUPS:
            yield judged(*name, "limit: measured / predicted", row.ratio, close, where)


def _on_limits(limits: pd.DataFrame) -> Iterator[str]:
    ratio, methods = limits["ratio"], sorted(limits["method"].unique())
    above = int((ratio < 1).sum())
    exceeded = f"exceeded {above} times" if above else "never exceeded"
    yield (
        f"The measured limit of the time step is {ratio.min():.2f} to {ratio.max():.2f} times the predicted one, on"
        f" {limits['scene'].nunique()} scenes by {listed(methods)}:"
        f" the prediction {exceeded} the measured limit ({len(ratio)} checks)."
    )
    wide = limits.pivot_table(index="scene", columns="method", values="measured_s")
    others = wide.drop(columns=VERLET)
    if len(others.columns):
        same = int((others.sub(wide[VERLET], axis=0).abs().max(axis=1) < 1e-9 * wide[VERLET]).sum())
        yield f"Codes and verlet become unstable at the same step of the scan on {same} of {len(wide)} scenes."
    bounces = limits[(limits["method"] == VERLET) & (limits["group"] == BOUNCING)]
    if not bounces.empty:
        said = [
            f"{row['scene']}: {row['measured_s'] * 1e6:.3g} µs, {row['ratio']:.2f} of the prediction"
            for _, row in bounces.iterrows()
        ]
        yield f"The limit falls with the number of impacts, as their errors add up: {'; '.join(said)}."


def _on_extremes(edge: pd.DataFrame) -> Iterator[str]:
    for engine, part in edge.groupby("engine", sort=False):
        scenes = [verdicts for _, verdicts in part.groupby("scene", sort=False)]
        counts = Counter(_outcome(checks) for checks in scenes)
        said = ", ".join(f"{count} {verdict}" for verdict, count in counts.items())
        yield f"{len(scenes)} extreme scenes by {engine}: {said}."


def _outcome(checks: pd.DataFrame) -> str:
    """Outcome of a scene on an engine: failed, not right, not run, not accurate (by the general ceilings), or pass."""
    found = {*checks["verdict"]}
    if FAIL in found:
        return "failed" if (checks["quantity"] == RUN).any() else "not right"
    return next((verdict for verdict in (NOT_RUN, NOT_ACCURATE) if verdict in found), PASS)


def _on_energy(energy: pd.DataFrame) -> Iterator[str]:
    for scene, part in energy.groupby("scene", sort=False):
        said = []
        for _, row in part.iterrows():
            drift = f"{row['drift']:.1e} ± {row['drift_error']:.0e}"
            drifts = abs(row["drift"]) > rounding_effects.SIGNIFICANCE * row["drift_error"]
            moves = f"drifts by {drift}" if drifts else f"does not drift ({drift})"
            said.append(f"{row['method']} has errors up to {row['largest']:.1e} and {moves}")
        yield f"Energy over {part['steps'].iloc[0]:.0e} steps, {scene}: {'; '.join(said)}."


def _on_statistics(statistics: pd.DataFrame) -> Iterator[str]:
    for quantity, part in statistics.groupby("quantity", sort=False):
        said = ", ".join(f"{row['method']} {row['mean']:.3g} ± {row['error']:.1g}" for _, row in part.iterrows())
        yield f"Beyond the horizon, mean {quantity}: {said}."


def _on_rounding(rounding: pd.DataFrame) -> Iterator[str]:
    many = rounding[rounding["beads"] == rounding["beads"].max()]
    said = ", ".join(f"{row['method']} {row['error']:.0e}" for _, row in many.iterrows())
    yield f"Rounding error in a chain of {int(many['beads'].iloc[0]):,} beads under 1 N: {said}."


def figures(tables: Tables) -> dict[str, Picture]:
    """Figures of the existing tables."""
    drawn = {
        "limits": ("stability", draw_limits, "Predicted limit and usual criteria over the measured limit"),
        "horizons": ("stability-horizons", draw_horizons, "Time until two methods differ by 1 %, by time step"),
        "rounding": ("stability-rounding", draw_rounding, "Relative error of a contact force against the overlap"),
    }
    return {
        f"stability-{name}": Picture(title, partial(draw, tables[table]))
        for name, (table, draw, title) in drawn.items()
        if table in tables
    }


def draw_limits(limits: pd.DataFrame) -> Any:
    """Draws the predicted limit and usual criteria over the measured limit, along each sweep."""
    figure, grid = pyplot().subplots(2, 2, figsize=(2 * COLUMN_IN, 5.6), sharey=True, layout="constrained")
    for axis, group in zip(grid.flat, SWEEPS, strict=True):
        part = limits[limits["group"] == group].sort_values("value")
        verlet = part[part["method"] == VERLET]
        x, limit = verlet["value"], verlet["measured_s"]
        axis.fill_between(x, verlet["bad_s"] / limit, 1.0, color="0.85", lw=0, label="stable, but more than 10 % wrong")
        axis.axhline(1.0, color="black", lw=0.8)
        for key, label, colour in zip(CRITERION_KEYS, CRITERIA, COLOURS, strict=True):
            axis.plot(x, verlet[key] / limit, color=colour, lw=1.0, label=label)
        for method, own in part.groupby("method"):
            share = own["predicted_s"] / own["measured_s"]
            axis.plot(own["value"], share, ls="", label=f"predicted, {method}", **marker_of(str(method)))
        axis.set(xscale="log", yscale="log", xlabel=group)
    for axis in grid[:, 0]:
        axis.set_ylabel("step / measured limit")
    figure.legend(*grid[0, 0].get_legend_handles_labels(), loc="outside lower center", ncols=4, fontsize="x-small")
    return figure


def draw_horizons(horizons: pd.DataFrame) -> Any:
    """Draws the time until pairs of methods differ by 1 %, against the time step."""
    figure, axis = pyplot().subplots(figsize=(COLUMN_IN * 1.4, 2.8), layout="constrained")
    for (one, other), part in horizons.sort_values("time_step_s").groupby(["one", "other"], sort=False):
        until = part["until_s"].fillna(part["duration_s"])
        axis.plot(part["time_step_s"] * 1e6, until * 1e3, marker="o", ms=3, lw=1, label=f"{one} and {other}")
    axis.set(xscale="log", xlabel="time step, µs", ylabel="agree to 1 % until, ms")
    axis.set_ylim(bottom=0)
    axis.legend(fontsize="x-small")
    return figure


def draw_rounding(rounding: pd.DataFrame) -> Any:
    """Draws the relative error of a contact force against the overlap, for walls at several heights."""
    figure, axis = pyplot().subplots(figsize=(COLUMN_IN * 1.7, 3.0), layout="constrained")
    few = rounding[rounding["beads"] == rounding["beads"].min()]
    overlaps_m, heights = (np.array(sorted(few[name].unique())) for name in ("overlap_m", "height_m"))
    engines = [name for name in codes() if (few["method"] == name).any()]
    colours = pyplot().get_cmap("viridis")(0.9 * np.arange(len(heights)) / max(len(heights) - 1, 1))
    for colour, height in zip(colours, heights, strict=True):
        for engine in engines:
            own = few[(few["method"] == engine) & (few["height_m"] == height)]
            axis.plot(own["overlap_m"], own["error"], ls="", **marker_of(engine) | {"color": colour})
        bound = 1.5 * np.spacing(max(height, 0.01)) / overlaps_m
        axis.plot(overlaps_m, bound, lw=0.8, color=colour, label=f"wall at {height:g} m")
    for engine in engines:
        axis.plot([], [], ls="", label=engine, **marker_of(engine) | {"color": GREY})
    axis.set(xscale="log", yscale="log", xlabel="overlap, m", ylabel="relative error of the force")
    axis.set_title("lines: 3/2 of a unit in the last place over the overlap", fontsize="x-small")
    figure.legend(fontsize="x-small", loc="outside right upper")
    return figure


def section(tables: Tables) -> dict[str, Any]:
    """Limits of the shipped scenes with usual criteria, verdicts of extreme scenes, and True for the short study."""
    limits, edge = tables["stability"], tables["stability-extremes"]
    methods = list(limits["method"].unique())
    own = limits[limits["group"] == SHIPPED].groupby("scene", sort=False)
    return {
        "short": not LONG_PARTS.keys() <= tables.keys(),
        "criteria": list(CRITERIA),
        "methods": methods,
        "limits": [{"scene": scene, **_limits(part.set_index("method"), methods)} for scene, part in own],
        "engines": list(edge["engine"].unique()),
        "extremes": [
            (scene, [_cell(checks) for _, checks in part.groupby("engine", sort=False)])
            for scene, part in edge.groupby("scene", sort=False)
        ],
    }


def _limits(by_method: pd.DataFrame, methods: list[str]) -> dict[str, Any]:
    """Predicted and measured limits of a scene, and usual criteria over Verlet's limit."""
    verlet: dict[Any, Any] = by_method.loc[VERLET].to_dict()
    shares = [verlet[key] / verlet["measured_s"] for key in CRITERION_KEYS]
    band = verlet["bad_s"] / verlet["measured_s"]
    return {
        "predicted": _micro(verlet["predicted_s"]),
        "measured": [_micro(step_s) for step_s in by_method["measured_s"].reindex(methods)],
        "bad": _micro(verlet["bad_s"]),
        "criteria": [(f"{share:.2f}", _judged(share, band)) for share in shares],
    }


def _judged(share: float, band: float) -> str:
    if share > 1:
        return "unstable"
    return "more than 10 % wrong" if share > band else "below a tenth" if share < SMALL_STEP_SHARE else "safe"


def _micro(seconds: float) -> str:
    return f"{seconds * 1e6:.4g}" if pd.notna(seconds) else "–"


def _cell(checks: pd.DataFrame) -> tuple[str, str, list[str]]:
    """Outcome of a scene on an engine, the reason for a missing run, and its errors of the force: whole and model."""
    missing = checks[checks["quantity"] == RUN]["where"]
    forces = {row["quantity"]: short(row["value"]) for _, row in checks.iterrows()}
    numbers = [forces[f"{kind}: {FORCE}"] for kind in (ERROR, MODEL) if f"{kind}: {FORCE}" in forces]
    return _outcome(checks), missing.iloc[0] if len(missing) else "", numbers


CHAPTER = Chapter(
    name="stability",
    title="limits of stability",
    tables={
        "stability": Limit,
        "stability-extremes": Check,
        "stability-energy": rounding_effects.Energy,
        "stability-horizons": rounding_effects.Horizon,
        "stability-statistics": rounding_effects.Statistic,
        "stability-rounding": rounding_effects.Rounded,
    },
    measure=measure,
    sentences=sentences,
    figures=figures,
    section=section,
    judge=judge,
    optional=frozenset(LONG_PARTS),
)
