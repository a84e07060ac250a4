"""The stability study: limits of the time step, scenes at the edge, long runs, rounding of heights."""

from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from functools import partial
from typing import Any

import numpy as np
import pandas as pd

from drivers.base.terminal import counted
from drivers.base.tolerances import tolerance
from drivers.chain.trace import FORCE
from drivers.engines import VERLET, codes
from postproc.draw.style import COLUMN_IN, PAGE_IN, marker_of, pyplot
from validation.accuracy.budget import ERROR
from validation.accuracy.plan import CRITERIA
from validation.chapters import Chapter, Options, Picture, Tables, named, rows_in
from validation.checks import FAIL, NOT_RUN, PASS, RUN, Check, judged, short
from validation.compare.comparison import listed
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
ENERGY = "stability-energy"
Part = tuple[str, Callable[[], Iterable[Any]]]  # words for progress lines, and the function that measures
LONG_PARTS: dict[str, Part] = {
    ENERGY: ("energy over ten million steps", rounding_effects.energies),
    "stability-horizons": ("horizons of pairs of methods", rounding_effects.horizons),
    "stability-rounding": ("rounding of heights", rounding_effects.measure_rounding),
}
COLOURS = ("#cc79a7", "#e69f00", "#0072b2")
COINCIDING: dict[str, Any] = {"marker": "o", "ms": 3.5, "mfc": "none", "color": "black"}  # several methods
SAME = 5e-3  # methods that differ by less are drawn as one
DASHES = ("-", (0, (5, 1.5)), (0, (1, 1)))


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
    for name, (what, run) in parts.items():
        with counted(named(what, options)):
            rows[name] = [*run()]
    return rows


def judge(tables: Tables) -> Iterator[Check]:
    """Are predicted limits of the time step safe, and for the judged groups close to the measured ones?"""
    safe, close = tolerance("stability", "predicted"), tolerance("stability", "measured")
    for row in rows_in(tables["stability"], Limit):
        where = f"unstable from {row.ratio:.3f} of the predicted limit on" if row.ratio > 0 else "never unstable"
        name = row.scene, row.method
        yield judged(*name, "limit: predicted / measured", 1 / row.ratio if row.ratio > 0 else 0.0, safe, where)
        if row.group in JUDGED_GROUPS:
            yield judged(*name, "limit: measured / predicted", row.ratio, close, where)


def sentences(tables: Tables) -> list[str]:
    """Limits, extreme scenes and long runs in a sentence each."""
    said = [_on_limits(tables["stability"]), _on_extremes(tables["stability-extremes"])]
    return [*said, _on_energy(tables[ENERGY])] if ENERGY in tables else said


def _on_limits(limits: pd.DataFrame) -> str:
    ratio, methods = limits["ratio"], sorted(limits["method"].unique())
    above = int((ratio < 1).sum())
    exceeded = f"exceeds it {above} times" if above else "never exceeds it"
    wide = limits.pivot_table(index="scene", columns="method", values="measured_s")
    same = int((wide.sub(wide[VERLET], axis=0).abs().max(axis=1) < 1e-9 * wide[VERLET]).sum())
    return (
        f"The measured limit of the time step is {ratio.min():.2f} to {ratio.max():.2f} times the predicted one, which"
        f" {exceeded} in {len(ratio)} measurements; {listed(methods)} become unstable at the same measured step"
        f" on {same} of {len(wide)} scenes."
    )


def _on_extremes(edge: pd.DataFrame) -> str:
    outcomes = [_outcome(checks) for _, checks in edge.groupby(["scene", "engine"], sort=False)]
    said = ", ".join(f"{count} {verdict}" for verdict, count in Counter(outcomes).items())
    return f"{edge['scene'].nunique()} extreme scenes on {edge['engine'].nunique()} engines: {said}."


def _on_energy(energy: pd.DataFrame) -> str:
    drifting = energy[energy["drift"].abs() > rounding_effects.SIGNIFICANCE * energy["drift_error"]]
    names = [f"{row['method']}, {row['scene']}: {row['drift']:.1e}" for _, row in drifting.iterrows()]
    return (
        f"Over {energy['steps'].max():.0e} steps the energy errs by at most {energy['largest'].max():.1e} of the"
        f" largest kinetic energy, and drifts in {len(drifting)} of {len(energy)} runs"
        f"{f' ({listed(names)})' if names else ''}."
    )


def _outcome(checks: pd.DataFrame) -> str:
    """Outcome of a scene on an engine; not accurate means an error above a general ceiling."""
    verdicts = {*checks["verdict"]}
    return next((verdict for verdict in (FAIL, NOT_RUN, NOT_ACCURATE) if verdict in verdicts), PASS)


def figures(tables: Tables) -> dict[str, Picture]:
    """Figures of the existing tables."""
    drawn = {
        "limits": ("stability", draw_limits, "Predicted limit and usual criteria, divided by the measured limit"),
        "horizons": ("stability-horizons", draw_horizons, "Time until two methods differ by 1 %, by time step"),
        "rounding": ("stability-rounding", draw_rounding, "Relative error of a contact force against the overlap"),
    }
    return {
        f"stability-{name}": (title, partial(draw, tables[table]))
        for name, (table, draw, title) in drawn.items()
        if table in tables
    }


def draw_limits(limits: pd.DataFrame) -> Any:
    """Draws the predicted limit and usual criteria, divided by the measured limit, along each sweep."""
    figure, grid = pyplot().subplots(1, 4, figsize=(PAGE_IN, 2.6), sharey=True, layout="constrained")
    for axis, group in zip(grid, SWEEPS, strict=True):
        part = limits[limits["group"] == group].sort_values("value")
        verlet = part[part["method"] == VERLET]
        x, limit = verlet["value"], verlet["measured_s"]
        axis.fill_between(x, verlet["bad_s"] / limit, 1.0, color="0.85", lw=0, label="stable, but more than 10 % wrong")
        axis.axhline(1.0, color="black", lw=0.8)
        for key, label, colour, dashes in zip(CRITERION_KEYS, CRITERIA, COLOURS, DASHES, strict=True):
            axis.plot(x, verlet[key] / limit, color=colour, ls=dashes, lw=1.2, label=label)
        for methods, points in _coinciding(part, "value", "measured_s", list(limits["method"].unique())):
            share = points["predicted_s"] / points["measured_s"]
            mark = COINCIDING if methods[1:] else marker_of(methods[0])
            axis.plot(points["value"], share, ls="", label=f"predicted: {listed(methods)}", **mark)
        axis.set(xscale="log", yscale="log", xlabel=group)
    grid[0].set_ylabel("step / measured limit")
    handles = {label: handle for axis in grid for handle, label in zip(*axis.get_legend_handles_labels(), strict=True)}
    figure.legend(handles.values(), handles.keys(), loc="outside lower center", ncols=5, fontsize=7)
    return figure


def _coinciding(table: pd.DataFrame, x: str, y: str, methods: list[str]) -> Iterator[tuple[list[str], pd.DataFrame]]:
    """Methods with equal values, with the rows of the first of them: they are drawn as one."""
    left = [method for method in methods if (table["method"] == method).any()]
    columns = {method: table[table["method"] == method].set_index(x)[y].sort_index() for method in left}
    while left:
        same = [
            name for name in left if np.allclose(columns[name], columns[left[0]], rtol=SAME, atol=0, equal_nan=True)
        ]
        yield same, table[table["method"] == left[0]]
        left = [name for name in left if name not in same]


def draw_horizons(horizons: pd.DataFrame) -> Any:
    """Draws the time until pairs of methods differ by 1 %, against the time step; pairs of one kind look the same."""
    kinds = {"two codes": DASHES[0], "a code and verlet": DASHES[1], "verlet and reference": DASHES[2]}
    figure, axis = pyplot().subplots(figsize=(COLUMN_IN, 2.6), layout="constrained")
    for (_, other), part in horizons.sort_values("time_step_s").groupby(["one", "other"]):
        kind = [*kinds][0 if other in codes() else 1 if other == VERLET else 2]
        until_s = part["until_s"].fillna(part["duration_s"])
        axis.plot(part["time_step_s"] * 1e6, until_s * 1e3, lw=1, label=kind, ls=kinds[kind], color="black")
    axis.set(xscale="log", xlabel="time step, µs", ylabel="agree to 1 % until, ms")
    axis.set_ylim(bottom=0)
    handles = dict(zip(*axis.get_legend_handles_labels()[::-1], strict=True))
    axis.legend(handles.values(), handles.keys(), fontsize=7)
    return figure


def draw_rounding(rounding: pd.DataFrame) -> Any:
    """Draws the relative error of a contact force against the overlap, for walls at several heights."""
    figure, axis = pyplot().subplots(figsize=(PAGE_IN, 3.0), layout="constrained")
    by_codes = rounding[rounding["method"].isin(codes())]
    overlaps_m, heights = (np.array(sorted(rounding[name].unique())) for name in ("overlap_m", "height_m"))
    colours = pyplot().get_cmap("viridis")(0.9 * np.arange(len(heights)) / max(len(heights) - 1, 1))
    for colour, height in zip(colours[::-1], heights[::-1], strict=True):
        axis.plot(overlaps_m, 1.5 * np.spacing(max(height, 0.01)) / overlaps_m, lw=0.8, color=colour)
        at_height = by_codes[by_codes["height_m"] == height]
        for methods, points in _coinciding(at_height, "overlap_m", "error", list(by_codes["method"].unique())):
            mark = COINCIDING if methods[1:] else marker_of(methods[0])
            some = "" if len(methods) == by_codes["method"].nunique() else f", {listed(methods)}"
            look = mark | {"color": colour, "ls": "", "label": f"wall at {height:g} m{some}"}
            axis.plot(points["overlap_m"], points["error"], **look)
    axis.set(xscale="log", yscale="log", xlabel="overlap, m", ylabel="relative error of the force")
    axis.set_title("circles: all codes; lines: 3/2 of a unit in the last place, divided by the overlap", fontsize=7)
    figure.legend(fontsize=7, loc="outside right upper")
    return figure


def section(tables: Tables) -> dict[str, Any]:
    """Rows of tables: limits with usual criteria, outcomes of extreme scenes, energies of long runs."""
    limits, edge = tables["stability"], tables["stability-extremes"]
    listed_groups = limits[limits["group"].isin([SHIPPED, BOUNCING])].groupby("scene", sort=False)
    return {
        "short": not LONG_PARTS.keys() <= tables.keys(),
        "criteria": list(CRITERIA),
        "limits": [_limit_row(str(scene), part.set_index("method")) for scene, part in listed_groups],
        "engines": list(edge["engine"].unique()),
        "extremes": [
            [scene, *(_cell(checks) for _, checks in part.groupby("engine", sort=False))]
            for scene, part in edge.groupby("scene", sort=False)
        ],
        "energy": [
            [f"{row.scene}, {row.method}", short(row.largest), f"{short(row.drift)} ± {short(row.drift_error)}"]
            for row in (rows_in(tables[ENERGY], rounding_effects.Energy) if ENERGY in tables else ())
        ],
    }


def _limit_row(scene: str, by_method: pd.DataFrame) -> list[str]:
    """Predicted and measured limits of a scene in µs, and usual criteria divided by Verlet's limit."""
    verlet: dict[Any, Any] = by_method.loc[VERLET].to_dict()
    ends = dict.fromkeys(_micro(step_s) for step_s in (by_method["measured_s"].min(), by_method["measured_s"].max()))
    shares = [verlet[key] / verlet["measured_s"] for key in CRITERION_KEYS]
    band = verlet["bad_s"] / verlet["measured_s"]
    return [
        scene,
        _micro(verlet["predicted_s"]),
        " to ".join(ends),
        _micro(verlet["bad_s"]),
        *(_judged(share, band) for share in shares),
    ]


def _judged(share: float, band: float) -> str:
    return f"{share:.2f}" + (" unstable" if share > 1 else " wrong by 10 %" if share > band else "")


def _micro(seconds: float) -> str:
    return f"{seconds * 1e6:.4g}" if pd.notna(seconds) else "–"


def _cell(checks: pd.DataFrame) -> dict[str, str]:
    """Outcome of a scene on an engine, its error of the force, and the reason for a missing run."""
    missing = checks[checks["quantity"] == RUN]["where"]
    forces = checks[checks["quantity"] == f"{ERROR}: {FORCE}"]["value"]
    return {
        "verdict": _outcome(checks),
        "number": short(forces.iloc[0]) if len(forces) else "",
        "reason": missing.iloc[0] if len(missing) else "",
    }


CHAPTER = Chapter(
    name="stability",
    title="limits of stability",
    tables={
        "stability": Limit,
        "stability-extremes": Check,
        ENERGY: rounding_effects.Energy,
        "stability-horizons": rounding_effects.Horizon,
        "stability-rounding": rounding_effects.Rounded,
    },
    measure=measure,
    sentences=sentences,
    figures=figures,
    section=section,
    judge=judge,
    optional=frozenset(LONG_PARTS),
)
