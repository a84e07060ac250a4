"""Limits of the time step and their prediction, scenes at the edge, energy over ten million steps.

The limits are those of the paper's chains and of sweeps of one parameter. Stable steps lie between unstable ones, so a
scan tries each step, 1 % larger than the one before, until the energy blows up. It uses the in-repo Verlet, which takes
milliseconds; the codes confirm the limit.
"""

from bisect import bisect_left
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import product
from math import inf, nan
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from pydantic import Field

from drivers.base import paths
from drivers.base.errors import InputError
from drivers.base.messages import validate
from drivers.base.terminal import following
from drivers.base.tolerances import tolerance
from drivers.chain.case import Case
from drivers.chain.schemes import exact_of, verlet_of
from drivers.chain.trace import Trace, largest_kinetic_J, residual
from drivers.engines import REFERENCE, VERLET, expected_engines, installed_codes, load_engine
from drivers.limits import refuse, resolved_trial, step_limit
from drivers.run.compute import compute
from drivers.run.execute import execute
from drivers.scene.model import Part
from drivers.scene.read_scene import read_toml
from postproc.draw.plot import PAGE_IN, marker_of, pyplot
from postproc.read.motion import case_of
from validation.accuracy.budget import ERROR, text_of
from validation.accuracy.plan import CRITERIA, planned_case, usual_steps
from validation.chapters import Options
from validation.checks import FAIL, NOT_ACCURATE, Check, judged, short
from validation.compare.comparison import compare_cases
from validation.report.parts import Chapter, Shown

PAPER = ("fig4", "fig5", "fig6b", "fig6d", "table1")
SHIPPED, BOUNCING = "shipped scenes", "impacts"
BASE, BEAD_KG = "fig4", 0.1226e-3
# by axis label: key of the scene, unit, values
SWEEPS = {
    "striker speed, m/s": ("striker.speed", "m/s", np.geomspace(1e-6, 50, 12)),
    "modulus of beads, Pa": ("materials.ptfe.youngs_modulus", "Pa", np.geomspace(1e6, 1e12, 9)),
    "striker mass / bead mass": ("striker.mass", "kg", BEAD_KG * np.geomspace(1e-3, 1e3, 9)),
    "modulus of the wall, Pa": ("materials.brass.youngs_modulus", "Pa", np.geomspace(1e6, 1e13, 8)),
}
TRAVERSE = 45.0  # duration of a sweep's scene in 2 / omega: the wave reaches the wall and returns
UNSTABLE_GAIN = 1.0  # energy gained / largest kinetic energy
WRONG, EXACT = 0.1, 1e-4  # largest error of the force / largest change, and that of the exact motion
FINENESS = 0.01  # relative step of the scan
LOWEST, HIGHEST = 0.15, 2.5  # scanned range, in limits of `beads plan`
CODE_LOWEST = 0.9  # start of the scan of a code that does not blow up where Verlet does
SHARES = np.exp(np.arange(np.log(LOWEST), np.log(HIGHEST), np.log1p(FINENESS)))
WRONG_SHARES = np.geomspace(0.01, 1.0, 95).tolist()  # of the predicted limit
CRITERION_KEYS = ("rayleigh_s", "hertz_s", "p_wave_s")
# five beads that bounce under gravity, and five that are pressed together so that no contact opens
TIMES = ("run.sample_interval=1 ms", "run.time_step=1 us", "run.duration=10 s")
FIVE_BEADS = ("chain.count=5", "chain.sensors=[]", *TIMES)
LOADED = ("chain.precompression=30 N", "striker=", "chain.bead=[{from_wall=5, velocity='-2 cm/s'}]")
LONG_RUNS = {"beads that bounce": FIVE_BEADS, "contacts that stay closed": (*FIVE_BEADS, *LOADED)}
BLOCKS = 20  # of a long run, for standard errors
COLOURS = ("#cc79a7", "#e69f00", "#0072b2")
DASHES = ("-", (0, (5, 1.5)), (0, (1, 1)))


@dataclass(frozen=True)
class MeasuredChain:
    """A chain to measure.

    Attributes:
        value: value of the parameter that a sweep varies.
    """

    group: str
    scene: str
    case: Case
    value: float = nan


def sweeps() -> Iterator[MeasuredChain]:
    """Sweeps of one parameter each, over decades."""
    for group, (key, unit, values) in SWEEPS.items():
        for value in values:
            setting = f"{key}={value:.6g} {unit}"
            rough = case_of(BASE, setting)
            duration = TRAVERSE * resolved_trial(rough).two_over_omega_s
            interval = duration / 800
            timing = (f"run.duration={duration:.6g} s", f"run.sample_interval={interval:.6g} s")
            case = case_of(BASE, setting, *timing, f"run.time_step={interval:.6g} s")
            yield MeasuredChain(group, f"{BASE} {setting}", case, value / BEAD_KG if unit == "kg" else float(value))


def bouncing() -> Iterator[MeasuredChain]:
    """A bead that bounces on the wall: errors of impacts add up."""
    for duration_ms in (5, 50, 500):
        settings = ("chain.count=0", "chain.sensors=[]", "gravity=981 m/s^2", "striker.speed=0.5 m/s")
        case = case_of(BASE, *settings, f"run.duration={duration_ms} ms", "run.time_step=1 us")
        impacts = float(np.count_nonzero(np.diff(verlet_of(case).force_N[:, 0] > 0)) // 2)
        yield MeasuredChain(BOUNCING, f"a bead that bounces {impacts:.0f} times", case, impacts)


def measure_limits(subjects: Sequence[MeasuredChain], names: Sequence[str] | None = None) -> pd.DataFrame:
    """Limits of all subjects by Verlet and by codes, all installed ones by default; the codes run in parallel.

    Verlet is scanned. A code runs at the step where Verlet blows up and at the step before; it is scanned itself only
    if it behaves differently there.

    Returns:
        A row for each subject and method. ``group`` is the group of scenes, ``value`` the parameter of a sweep;
        ``predicted_s`` the predicted limit, a lower bound; ``measured_s`` the smallest scanned step at which the energy
        blows up, NaN if none does, ``ratio`` the measured limit divided by the predicted one; ``wrong_s`` the
        step at which a force of Verlet errs by a tenth of the largest change;
        ``rayleigh_s``, ``hertz_s``, ``p_wave_s`` the steps of the usual criteria (``accuracy.plan.usual_steps``);
        ``steps`` the number of steps of the run at the limit.
    """
    names = installed_codes() if names is None else names
    by_verlet = [*map(_by_verlet, following(subjects, "limits by verlet", len(subjects), "scene"))]
    pairs = [*product(names, range(len(subjects)))]
    ended = execute(lambda pair: _by_code(pair[0], by_verlet[pair[1]]), pairs)
    by_code = dict(following(ended, "limits by codes", len(pairs), "scene"))
    return pd.DataFrame([*by_verlet, *(by_code[pair] for pair in pairs)]).drop(columns="case")


def _by_verlet(subject: MeasuredChain) -> dict[str, Any]:
    case, predicted_s = subject.case, step_limit(subject.case)[0]
    measured_s = _scan(case, VERLET, predicted_s)
    return {
        **vars(subject),
        "method": VERLET,
        "bodies": case.chain.bodies,
        "predicted_s": predicted_s,
        "measured_s": measured_s,
        "wrong_s": wrong_step_s(case, predicted_s),
        "ratio": measured_s / predicted_s,
        **dict(zip(CRITERION_KEYS, usual_steps(case).values(), strict=True)),
        "steps": float(case.sample_times_s[-1]) / measured_s,
    }


def _by_code(name: str, verlet: dict[str, Any]) -> dict[str, Any]:
    """Row of a code: Verlet's limit if the code blows up there and not at the step before, else its own."""
    case, measured_s = verlet["case"], verlet["measured_s"]
    gains = (_gain_on(name, case, step_s) for step_s in (measured_s, measured_s / (1 + FINENESS)))
    if not (measured_s > 0 and next(gains) > UNSTABLE_GAIN >= next(gains)):
        measured_s = _scan(case, name, verlet["predicted_s"], lowest=CODE_LOWEST)
    return verlet | {"method": name, "measured_s": measured_s, "ratio": measured_s / verlet["predicted_s"]}


def wrong_step_s(case: Case, predicted_s: float) -> float:
    """Step at which a force of Verlet errs by a tenth of the largest change, by bisection; NaN if it never does."""

    def is_wrong(share: float) -> bool:
        sampled = case.sampled_at_every(share * predicted_s)
        return bool(residual(verlet_of(sampled), exact_of(sampled, EXACT)).max() > WRONG)

    place = bisect_left(WRONG_SHARES, True, key=is_wrong)
    return predicted_s * WRONG_SHARES[place] if place < len(WRONG_SHARES) else nan


def _gain_on(method: str, case: Case, step_s: float) -> float:
    """Largest energy gain at a step divided by the largest kinetic energy, also of a run that the guard fails.

    It is inf if values are not finite, or a code lost a body.
    """
    sampled = case.sampled_at_every(step_s)
    if method == VERLET:
        trace = verlet_of(sampled)
    else:
        ended = compute(sampled, method)
        trace = ended.fault.partial if ended.fault else ended.done
    if trace is None or len(trace.time_s) < sampled.scene.samples:
        return inf
    change = np.nan_to_num(trace.total_energy_J - trace.total_energy_J[0], nan=inf)
    return float(change.max() / resolved_trial(case).extremes.kinetic_J)


def _scan(case: Case, method: str, predicted_s: float, lowest: float = LOWEST) -> float:
    """Smallest scanned step at which the energy blows up; NaN if none does."""
    for step_s in predicted_s * SHARES[lowest <= SHARES]:
        with np.errstate(all="ignore"):
            if _gain_on(method, case, step_s) > UNSTABLE_GAIN:
                return float(step_s)
    return nan


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


class ExtremesFile(Part):
    """Contents of ``inputs/extremes.toml``."""

    extreme: tuple[Extreme, ...] = Field(strict=False, min_length=1)


def extremes(*, quick: bool = False) -> list[Extreme]:
    """Scenes of ``inputs/extremes.toml``, or the quick subset."""
    path = paths.INPUTS / "extremes.toml"
    return [entry for entry in validate(ExtremesFile, read_toml(path), path).extreme if entry.quick or not quick]


def run_all(chosen: list[Extreme], runs: Path) -> Iterator[Check]:
    """Checks of extreme scenes on every engine, one scene after the other; finished runs are reused.

    A refused scene counts as not run. At the edge many runs are right, but not accurate: an error above the general
    ceiling is no failure here, but ``NOT_ACCURATE``.
    """
    names = sorted(expected_engines(), key=lambda name: not load_engine(name).in_repository)
    cases = [planned_case(extreme.scene, *extreme.set) for extreme in chosen]
    compared = compare_cases(cases, names, runs, _refusal, unsafe=True)
    assessed = following(compared, "extreme scenes, assessed", len(cases), "scene")
    for extreme, scene in zip(chosen, assessed, strict=True):
        for check in sorted(scene.checks, key=lambda check: names.index(check.engine)):
            inaccurate = check.verdict == FAIL and check.quantity.startswith(ERROR)
            yield replace(check, scene=extreme.name, verdict=NOT_ACCURATE if inaccurate else check.verdict)


def _refusal(case: Case, engine: str) -> InputError | None:
    try:
        refuse(case, engine)
    except InputError as refusal:
        return refusal
    return None


def energies() -> pd.DataFrame:
    """Energy errors of all engines over ten million steps; a row for each scene and method.

    Errors are divided by the largest kinetic energy. ``largest`` is the largest of all samples; ``drift`` is that over
    the whole run, from the mean energies of its blocks, ``drift_error`` its standard error; ``walk`` is the standard
    deviation of the change between neighbouring blocks, which a random walk has without a drift.
    """
    rows, engines = [], [VERLET, REFERENCE, *installed_codes()]
    for name, settings in following(LONG_RUNS.items(), "long runs", len(LONG_RUNS)):
        case = case_of("fig4", *settings)
        ended = dict(execute(partial(compute, case), engines))
        rows += [{"scene": name, "method": engine, **energy_of(case, ended[engine].done)} for engine in engines]
    return pd.DataFrame(rows)


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
    shipped = [MeasuredChain(SHIPPED, name, case_of(name)) for name in (*PAPER, "low-amplitude", "steel-chain")]
    limits = measure_limits([*shipped, *sweeps(), *(() if options.quick else bouncing())])
    edge = [*run_all(extremes(quick=options.quick), options.runs)]
    energy = None if options.quick else energies()
    return study(limits, edge, energy)


def study(limits: pd.DataFrame, edge: Sequence[Check], energy: pd.DataFrame | None) -> Chapter:
    """Chapter on limits, checks of extreme scenes, and energies of long runs if there are any."""
    title = "Predicted limit and usual criteria, divided by the measured limit"
    tables = {"stability": limits, "stability-extremes": pd.DataFrame(edge)}
    findings = [on_criteria(limits), _on_limits(limits)]
    shown = [show_limits(limits), show_extremes(edge)]
    if energy is not None:
        tables["stability-energy"] = energy
        shown.append(show_energy(energy))
    figures, checks = {"stability-limits": (title, draw_limits(limits))}, [*judge(limits), *edge]
    return Chapter(tables, findings, figures, shown, checks, short=energy is None)


def judge(limits: pd.DataFrame) -> Iterator[Check]:
    """Are predicted limits of the time step safe, and on shipped scenes close to the measured ones?"""
    safe, close = tolerance("stability", "predicted"), tolerance("stability", "measured")
    for row in limits.to_dict("records"):
        ratio, name = row["ratio"], (row["scene"], row["method"])
        where = f"unstable from {ratio:.3f} of the predicted limit on" if ratio > 0 else "never unstable"
        yield judged(*name, "limit: predicted / measured", 1 / ratio if ratio > 0 else 0.0, safe, where)
        if row["group"] == SHIPPED:
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
    ratio = limits["ratio"]
    above = int((ratio < 1).sum())
    exceeded = f"exceeds it {above} times" if above else "never exceeds it"
    return (
        f"The measured limit of the time step is {ratio.min():.2f} to {ratio.max():.2f} times the predicted one, which"
        f" {exceeded} in {len(ratio)} measurements."
    )


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
    figure.legend(*grid[0].get_legend_handles_labels(), loc="outside lower center", ncols=5, fontsize=7)
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


def show_extremes(edge: Sequence[Check]) -> Shown:
    """Outcomes of extreme scenes, by engine."""
    places = pd.MultiIndex.from_tuples([(check.scene, check.engine) for check in edge])
    texts = pd.Series([*edge], places).groupby(level=[0, 1], sort=False).agg(text_of)
    text = "Largest error of the force against the exact motion; not accurate: above the general ceiling."
    return Shown("Scenes at the edge", text, texts.unstack(sort=False).rename_axis("scene").reset_index())


def show_energy(energy: pd.DataFrame) -> Shown:
    """Energy errors of long runs."""
    columns = ["scene", "method", "largest", "drift", "drift_error"]
    rows = [
        (f"{scene}, {method}", short(largest), f"{short(drift)} ± {short(error)}")
        for scene, method, largest, drift, error in energy[columns].itertuples(index=False)
    ]
    heading = "Energy over ten million steps, divided by the largest kinetic energy"
    return Shown(heading, "", pd.DataFrame(rows, columns=["scene, engine", "largest error", "drift"]))
