"""Limits of the time step and their prediction, scenes at the edge, energy over ten million steps."""

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import partial
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from pydantic import Field

from drivers.base import paths
from drivers.base.errors import InputError
from drivers.base.terminal import following
from drivers.base.tolerances import tolerance
from drivers.chain.case import Case
from drivers.chain.trace import FORCE, Trace, largest_kinetic_J
from drivers.engines import REFERENCE, VERLET, codes, installed, installed_codes
from drivers.limits import refuse
from drivers.run.compute import compute
from drivers.run.execute import execute
from drivers.run.run import run_many
from drivers.scene.model import Part
from drivers.scene.read_scene import read_entries
from postproc.draw.style import PAGE_IN, marker_of, pyplot
from postproc.read.motion import case_of
from validation.accuracy.budget import ERROR, assess, kept_budget
from validation.accuracy.plan import CRITERIA, planned_case
from validation.chapters import Options
from validation.chapters.measured_limits import (
    BOUNCING,
    CRITERION_KEYS,
    JUDGED_GROUPS,
    SHIPPED,
    SWEEPS,
    at_random,
    bouncing,
    measure_limits,
    shipped,
    sweeps,
)
from validation.checks import FAIL, NOT_ACCURATE, NOT_RUN, PASS, RUN, Check, judged, short, without_run
from validation.compare.comparison import listed
from validation.report.parts import Chapter, Shown

RANDOM_SCENES = 100
# five beads that bounce under gravity, and five that are pressed together so that no contact opens
FIVE_BEADS = (
    "chain.count=5",
    "chain.sensors=[]",
    "run.sample_interval=1 ms",
    "run.time_step=1 us",
    "run.duration=10 s",
)
LOADED = ("chain.precompression=30 N", "striker=", "chain.bead=[{from_wall=5, velocity='-2 cm/s'}]")
LONG_RUNS = {"beads that bounce": FIVE_BEADS, "contacts that stay closed": (*FIVE_BEADS, *LOADED)}
BLOCKS = 20  # of a long run, for standard errors
SIGNIFICANCE = 3.0  # standard errors of a drift
COLOURS = ("#cc79a7", "#e69f00", "#0072b2")
DASHES = ("-", (0, (5, 1.5)), (0, (1, 1)))


class Extreme(Part):
    """Extreme scene of ``inputs/extremes.toml``.

    Attributes:
        set: settings over the scene, in the form of ``--set``.
        quick: True if the scene is in the subset of the tests and of the short study.
    """

    name: str
    scene: str
    set: tuple[str, ...] = Field(default=(), strict=False)
    quick: bool = False


def extremes(*, quick: bool = False) -> list[Extreme]:
    """Scenes of ``inputs/extremes.toml``, or the quick subset."""
    entries = read_entries(paths.INPUTS / "extremes.toml", "extreme", Extreme)
    return [entry for entry in entries if entry.quick or not quick]


def run_all(chosen: list[Extreme], runs: Path) -> Iterator[Check]:
    """Checks of extreme scenes on every engine, one scene after the other; finished runs are reused.

    A refused scene counts as not run. At the edge many runs are right, but not accurate: an error above the general
    ceiling is no failure here, but ``NOT_ACCURATE``.
    """
    names = (REFERENCE, VERLET, *codes())
    cases = {extreme.name: planned_case(extreme.scene, *extreme.set) for extreme in chosen}
    absent: dict[tuple[str, str], str] = {}
    for extreme, engine in product(cases, names):
        try:
            refuse(cases[extreme], engine)
        except InputError as refusal:
            absent[extreme, engine] = f"refused: {refusal}"
        if engine not in installed(names):
            absent[extreme, engine] = "not installed"
    jobs = [job for job in product(cases, names) if job not in absent]
    ended = run_many([(cases[extreme], engine) for extreme, engine in jobs], runs, unsafe=True)
    by_job = dict(zip(jobs, ended, strict=True))
    for extreme, case in following(cases.items(), "extreme scenes, assessed", len(cases), "scene"):
        for engine in names:
            if why := absent.get((extreme, engine)):
                yield without_run(extreme, engine, why, NOT_RUN)
                continue
            run = assess(by_job[extreme, engine], case)
            if not run.done:
                yield without_run(extreme, engine, f"{run.record.status}: {run.record.reason}", FAIL)
                continue
            for check in kept_budget(case, run).checks:
                inaccurate = check.verdict == FAIL and check.quantity.startswith(ERROR)
                yield replace(check, scene=extreme, verdict=NOT_ACCURATE if inaccurate else check.verdict)


def energies() -> pd.DataFrame:
    """Energy errors of all engines over ten million steps; a row for each scene and method.

    Errors are divided by the largest kinetic energy. ``largest`` is the largest of all samples; ``drift`` is that over
    the whole run, from the mean energies of its blocks, ``drift_error`` its standard error; ``walk`` is the standard
    deviation of the change between neighbouring blocks, which a random walk has without a drift.
    """
    rows, engines = [], [VERLET, REFERENCE, *installed_codes()]
    for name, settings in following(LONG_RUNS.items(), "long runs", len(LONG_RUNS)):
        case = case_of("fig4", *settings)
        traces = dict(execute(partial(_trace, case), engines))
        rows += [{"scene": name, "method": engine, **energy_of(case, traces[engine])} for engine in engines]
    return pd.DataFrame(rows)


def _trace(case: Case, engine: str) -> Trace:
    return compute(case, engine).done


def energy_of(case: Case, trace: Trace) -> dict[str, float]:
    """Largest energy error of a trace, and its drift from the means of its blocks."""
    signed = (trace.total_energy_J - trace.total_energy_J[0]) / largest_kinetic_J(case.chain, trace)
    levels = np.array([part.mean() for part in np.array_split(signed, BLOCKS)])
    steps = np.diff(levels)
    walk, count = float(steps.std(ddof=1)), len(steps)
    return {
        "steps": case.scene.steps,
        "largest": float(np.abs(signed).max()),
        "drift": float(levels[-1] - levels[0]) * BLOCKS / count,
        "drift_error": walk * count**0.5 * BLOCKS / count,
        "walk": walk,
    }


def measure(options: Options) -> Chapter:
    """Measure limits, extremes and long runs; the short study omits most scenes and all long runs."""
    more = () if options.quick else (*bouncing(), *at_random(RANDOM_SCENES))
    limits = measure_limits([*shipped(), *sweeps(), *more])
    edge = [*run_all(extremes(quick=options.quick), options.runs)]
    energy = None if options.quick else energies()
    return study(limits, edge, energy)


def study(limits: pd.DataFrame, edge: Sequence[Check], energy: pd.DataFrame | None) -> Chapter:
    """Chapter on limits, checks of extreme scenes, and energies of long runs if there are any."""
    extreme = pd.DataFrame(edge)
    title = "Predicted limit and usual criteria, divided by the measured limit"
    tables = {"stability": limits, "stability-extremes": extreme}
    findings = [on_criteria(limits), _on_limits(limits), _on_extremes(extreme)]
    shown = [show_limits(limits), show_extremes(extreme)]
    if energy is not None:
        tables["stability-energy"] = energy
        findings.append(_on_energy(energy))
        shown.append(show_energy(energy))
    figures, checks = {"stability-limits": (title, draw_limits(limits))}, [*judge(limits), *edge]
    return Chapter(tables, findings, figures, shown, checks, short=energy is None)


def judge(limits: pd.DataFrame) -> Iterator[Check]:
    """Are predicted limits of the time step safe, and for the judged groups close to the measured ones?"""
    safe, close = tolerance("stability", "predicted"), tolerance("stability", "measured")
    for row in limits.to_dict("records"):
        ratio, name = row["ratio"], (row["scene"], row["method"])
        where = f"unstable from {ratio:.3f} of the predicted limit on" if ratio > 0 else "never unstable"
        yield judged(*name, "limit: predicted / measured", 1 / ratio if ratio > 0 else 0.0, safe, where)
        if row["group"] in JUDGED_GROUPS:
            yield judged(*name, "limit: measured / predicted", ratio, close, where)


def on_criteria(limits: pd.DataFrame) -> str:
    """Finding on usual criteria, and on the share of the limit from which forces are wrong."""
    verlet = limits[limits["method"] == VERLET]
    shares = {label: verlet[key] / verlet["measured_s"] for key, label in zip(CRITERION_KEYS, CRITERIA, strict=True)}
    said = [f"{label} is {100 * share.min():.0f} to {100 * share.max():.0f} %" for label, share in shares.items()]
    by_speed = verlet[verlet["group"] == "striker speed, m/s"]
    slow = by_speed.loc[by_speed["hertz_s"] > by_speed["measured_s"], "value"]
    unstable = f" and is unstable at striker speeds up to {slow.max():.1g} m/s" if len(slow) else ""
    wrong = (verlet["wrong_s"] / verlet["measured_s"])[verlet["group"] == SHIPPED]
    return (
        f"Usual criteria are no limits: {', '.join(said)} of the measured limit of the time step; 0.1 of the Hertz time"
        f" grows with slower impacts{unstable}. Forces of the shipped scenes err by a tenth from {wrong.min():.2f} to"
        f" {wrong.max():.2f} of the limit on."
    )


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
    drifting = energy[energy["drift"].abs() > SIGNIFICANCE * energy["drift_error"]]
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


def draw_limits(limits: pd.DataFrame) -> Any:
    """Draws the predicted limit and usual criteria, divided by the measured limit, along each sweep."""
    figure, grid = pyplot().subplots(1, 4, figsize=(PAGE_IN, 2.6), sharey=True, layout="constrained")
    for axis, group in zip(grid, SWEEPS, strict=True):
        part = limits[limits["group"] == group].sort_values("value")
        verlet = part[part["method"] == VERLET]
        x, limit = verlet["value"], verlet["measured_s"]
        axis.fill_between(x, verlet["wrong_s"] / limit, 1.0, color="0.85", lw=0, label="stable, force wrong by 10 %")
        axis.axhline(1.0, color="black", lw=0.8)
        for key, label, colour, dashes in zip(CRITERION_KEYS, CRITERIA, COLOURS, DASHES, strict=True):
            axis.plot(x, verlet[key] / limit, color=colour, ls=dashes, lw=1.2, label=label)
        for method, points in part.groupby("method", sort=False):
            share = points["predicted_s"] / points["measured_s"]
            axis.plot(points["value"], share, ls="", label=f"predicted: {method}", **marker_of(str(method)))
        axis.set(xscale="log", yscale="log", xlabel=group)
    grid[0].set_ylabel("step / measured limit")
    handles = {label: handle for axis in grid for handle, label in zip(*axis.get_legend_handles_labels(), strict=True)}
    figure.legend(handles.values(), handles.keys(), loc="outside lower center", ncols=5, fontsize=7)
    return figure


def show_limits(limits: pd.DataFrame) -> Shown:
    """Limits of the shipped scenes, and of a bouncing bead."""
    chosen = limits[limits["group"].isin([SHIPPED, BOUNCING])]
    unstable = chosen.groupby("scene", sort=False)["measured_s"].agg(["min", "max"])
    rows = []
    for verlet in chosen[chosen["method"] == VERLET].to_dict("records"):
        shares = [verlet[key] / verlet["measured_s"] for key in CRITERION_KEYS]
        ends = dict.fromkeys(map(_micro, unstable.loc[verlet["scene"]]))
        steps = _micro(verlet["predicted_s"]), " to ".join(ends), _micro(verlet["wrong_s"])
        band = verlet["wrong_s"] / verlet["measured_s"]
        rows.append([verlet["scene"], *steps, *(_judged(share, band) for share in shares)])
    return Shown(
        "Limits of the time step on the shipped scenes",
        "Steps in µs. Predicted: by trials of this scheme. Unstable: smallest step at which the energy grows by all"
        " that was put in. Force: smallest step at which a force errs by a tenth of the largest change. Criteria:"
        " divided by the unstable step; unstable above 1, wrong by 10 % above the step of the force.",
        pd.DataFrame(rows, columns=["scene", "predicted", "unstable", "force wrong by 10 %", *CRITERIA]),
    )


def _judged(share: float, band: float) -> str:
    return f"{share:.2f}" + (" unstable" if share > 1 else " wrong by 10 %" if share > band else "")


def _micro(seconds: float) -> str:
    return f"{seconds * 1e6:.4g}" if pd.notna(seconds) else "–"


def show_extremes(edge: pd.DataFrame) -> Shown:
    """Outcomes of extreme scenes, by engine."""
    cells = {name: _cell(checks) for name, checks in edge.groupby(["scene", "engine"], sort=False)}
    table = pd.Series(cells).unstack(sort=False).rename_axis("scene").reset_index()
    text = "Largest error of the force against the exact motion; not accurate: above the general ceiling."
    return Shown("Scenes at the edge", text, table)


def _cell(checks: pd.DataFrame) -> str:
    """Outcome of a scene on an engine, its error of the force, and the reason for a missing run."""
    missing = checks[checks["quantity"] == RUN]["where"]
    forces = checks[checks["quantity"] == f"{ERROR}: {FORCE}"]["value"]
    return "\n".join([" ".join([_outcome(checks), *map(short, forces)]), *missing])


def show_energy(energy: pd.DataFrame) -> Shown:
    """Energy errors of long runs."""
    columns = ["scene", "method", "largest", "drift", "drift_error"]
    rows = [
        (f"{scene}, {method}", short(largest), f"{short(drift)} ± {short(error)}")
        for scene, method, largest, drift, error in energy[columns].itertuples(index=False)
    ]
    heading = "Energy over ten million steps, divided by the largest kinetic energy"
    return Shown(heading, "", pd.DataFrame(rows, columns=["scene, engine", "largest error", "drift"]))
