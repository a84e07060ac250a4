"""The study of elements: effects and costs, omitted elements, and the gap between elastic theory and experiment."""

from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import chain, product
from typing import Any

import numpy as np
import pandas as pd

from drivers.base.tolerances import tolerance
from drivers.chain.case import Case
from drivers.engines import VERLET, installed_codes
from drivers.limits.refusal import inability
from postproc.draw.style import GREY, line_of, pyplot
from postproc.paper.quoted import quoted
from postproc.paper.simulate import Simulation, case_of, run_codes
from postproc.read.sensors import sensor_signals
from validation.accuracy.costs import cost_on
from validation.chapters import Chapter, Options, Picture, Tables, rows_in
from validation.checks import Check, judged, summary
from validation.elements import gauge_steps, switches
from validation.elements.gauge_steps import STEPS
from validation.elements.switches import read_elements, runs_of

REPEATS = 3  # further runs for costs, except in the short study
ROUNDING = 1e-6  # of a mean: a smaller spread counts as none
ELASTIC, *ADDED = STEPS
MIN_CHANGE = 1e-6  # smaller changes are drawn here
SHAPES = "os^vDPX<>ph*d1234+x"
DRAWN_OBSERVABLES = {
    "sensor peak": ("bead_{upper}_peak_N", 1.0, "N"),
    "speed": ("speed_{upper}_to_{lower}_m_s", 1.0, "m/s"),
    "wall peak": ("wall_peak_N", 1.0, "N"),
    "wall envelope": ("wall_envelope_per_s", 1e-6, "per µs"),
}


@dataclass(frozen=True)
class Quote:
    """Number that the paper quotes from its experiment on a scene.

    Attributes:
        words: name of the quantity in sentences.
        scale: factor from the observable's unit to ``unit``.
        value: quoted value in ``unit``.
        about: text before the value in figures.
    """

    scene: str
    observable: str
    words: str
    unit: str
    scale: float
    value: float
    about: str = ""


def quotes() -> list[Quote]:
    """Numbers that the paper quotes of its experiments."""
    paper = quoted()
    envelope = paper.fig5_measured_envelope_per_us
    return [
        Quote("fig4", "bead_9_peak_N", "leading force", "N", 1.0, paper.fig4_leading_force_N, "about "),
        Quote("fig4", "speed_9_to_5_m_s", "speed", "m/s", 1.0, paper.fig4_speed_m_s),
        Quote("fig5", "wall_envelope_per_s", "wall envelope", "per µs", 1e-6, envelope),
    ]


def measure(options: Options) -> dict[str, Any]:
    """Runs and measures everything; the short study has fewer seeds and only the first scene."""
    asked, runs = read_elements(), options.runs
    seeds = asked.quick_seeds if options.quick else asked.seeds
    scenes = asked.scene[:1] if options.quick else asked.scene
    codes = installed_codes()
    engines = codes or [VERLET]
    tube = case_of(f"{scenes[0].name}-tube")
    in_tubes = [name for name in codes if inability(tube, name) is None]
    fastest = min(in_tubes or [VERLET], key=lambda name: cost_on(name).run_s(tube))
    pairs = [*switches.pairs_of(asked.model_copy(update={"scene": scenes}), seeds)]
    steps = {scene.name: [*gauge_steps.add_steps(scene, seeds)] for scene in scenes}
    varied = [each for scene in scenes[:2] for each in gauge_steps.vary(scene, seeds)]
    jobs: dict[str, list[Case]] = defaultdict(list)
    for engine in engines:
        jobs[engine] += [case for pair in switches.taken_by(engine, pairs) for case in pair.cases]
    for engine, scene in product(in_tubes or [VERLET], scenes):
        jobs[engine] += switches.straight(scene)
        jobs[engine] += [case for cases in switches.in_tube(scene, seeds).values() for case in cases]
    jobs[fastest] += [case for each in (*chain.from_iterable(steps.values()), *varied) for case in each.cases]
    done = run_codes({engine: [*dict.fromkeys(cases)] for engine, cases in jobs.items()}, runs)
    found = {(run.case, engine): run for engine, own in done.items() for run in own}
    shown = {name: {each.step: runs_of(each, fastest, found) for each in own} for name, own in steps.items()}
    return {
        "elements": [*switches.measure_effects(pairs, engines, 0 if options.quick else REPEATS, found)],
        "elements-checks": [
            *switches.omitted_effects(scenes, in_tubes or [VERLET], found),
            *switches.accuracies_kept(scenes[0].name, engines, runs),
        ],
        "elements-between": switches.compare_codes(scenes, seeds, in_tubes, found),
        "oscilloscope": gauge_steps.rows_of(chain.from_iterable(steps.values()), fastest, found),
        "oscilloscope-ranges": gauge_steps.rows_of(varied, fastest, found),
        **{f"oscilloscope-{name}": draw_oscilloscope(name, own) for name, own in shown.items()},
    }


def sentences(tables: Tables) -> list[str]:
    """Findings; the effects themselves are in the table."""
    checks = rows_in(tables["elements-checks"], Check)
    gaps = (_on_gap(quote, tables["oscilloscope"], tables["oscilloscope-ranges"]) for quote in quotes())
    return [
        f"Elements that straight chains omit, and those that an accuracy omits: {summary(checks)}.",
        *_on_variants(tables["elements"]),
        *_on_codes(tables["elements-between"]),
        *chain.from_iterable(gaps),
    ]


def judge(tables: Tables) -> Iterator[Check]:
    """Do the codes agree in the tube without friction, until the wave reaches the wall?"""
    between = tables["elements-between"]
    without_friction = between[between["friction"] == switches.WITHOUT_FRICTION].drop_duplicates(["scene", "codes"])
    for row in without_friction.to_dict("records"):
        codes, limit = str(row["codes"]).replace(" ", " and "), tolerance("elements", "codes")
        yield judged(row["scene"], codes, "forces in the tube", row["before_wall"], limit, "before the wall")


def _on_variants(effects: pd.DataFrame) -> Iterator[str]:
    """Uncertainty of an effect: its spread over seeds and over the variants of the element."""
    variants = {each.name: each.of for each in read_elements().element if each.of}
    peaks = effects[effects["observable"] == "wall peak"].groupby(["scene", "element"], sort=False)
    means = 100 * peaks[["change", "spread"]].mean()  # over the codes
    for element in dict.fromkeys(variants.values()):
        for scene in dict.fromkeys(scene for scene, name in means.index if name == element):
            own = means.loc[scene]
            others = [f"{row['change']:+.2g} ({name})" for name, row in own.iterrows() if variants.get(name) == element]
            change, spread = own.loc[element]
            yield (
                f"{scene}, {element}: changes the wall peak by {change:+.2g} %, with a spread over seeds of"
                f" {spread:.1g} %; variants by {', '.join(others)}."
            )


def _on_codes(between: pd.DataFrame) -> Iterator[str]:
    for (scene, friction, codes), rows in between.groupby(["scene", "friction", "codes"], sort=False):
        row = rows.iloc[0]
        if not row["seeds"]:
            yield f"Codes in the tube: {row['observable']}."
            continue
        differ = "never by 1 %"
        if pd.notna(row["earliest_parted_s"]):
            median = f"{row['median_parted_s'] * 1e6:.0f} µs" if pd.notna(row["median_parted_s"]) else "never"
            differ = f"by 1 % from {row['earliest_parted_s'] * 1e6:.0f} µs on (median {median})"
        wall = rows[rows["observable"] == "wall peak"].iloc[0]
        first, second = (_pm(wall[f"{each}_mean"], wall[f"{each}_spread"]) for each in ("first", "second"))
        difference = f"difference {wall['second_mean'] / wall['first_mean'] - 1:+.1e}"
        remark = f"{difference}; equal distributions: p = {wall['same']:.2g}"
        if max(wall["first_spread"], wall["second_spread"]) < ROUNDING * wall["first_mean"]:  # seeds change nothing
            remark = f"{difference}, the same for every seed"
        yield (
            f"{scene} {friction}, {str(codes).replace(' ', ' and ')}, {row['seeds']} seeds: the codes differ by at most"
            f" {row['before_wall']:.1e} until the wave reaches the wall, {differ}. Wall peak {first} and {second} N"
            f" ({remark})."
        )


def _on_gap(quote: Quote, numbers: pd.DataFrame, ranges: pd.DataFrame) -> Iterator[str]:
    """Share of the gap between the elastic line and the experiment that each step explains."""
    own, varied = (
        table[(table["scene"] == quote.scene) & (table["observable"] == quote.observable)]
        for table in (numbers, ranges)
    )
    steps = own.set_index("step")
    if ELASTIC not in steps.index:
        return
    mean, spread = quote.scale * steps["mean"], quote.scale * steps["spread"]
    elastic = mean[ELASTIC]
    shares = (mean - elastic) / (quote.value - elastic)
    parts = [f"{step} {_pm(mean[step], spread[step])} ({_percent(shares[step])})" for step in ADDED]
    yield (
        f"{quote.scene}, {quote.words}: elastic line {elastic:.4g} {quote.unit}, experiment {quote.value:g}; with each"
        f" step added to those before (share of the gap): {', '.join(parts)}."
    )
    for name, rows in varied.groupby("step", sort=False):
        shares = (quote.scale * rows["mean"] - elastic) / (quote.value - elastic)
        values = ", ".join(f"{value}: {_percent(share)}" for value, share in zip(rows["value"], shares, strict=True))
        yield f"{quote.scene}, {quote.words}: share of the gap, {name} {values}."


def _pm(mean: float, spread: float) -> str:
    return f"{mean:.4g} ± {spread:.1g}" if spread > ROUNDING * abs(mean) else f"{mean:.4g}"


def _percent(share: float) -> str:
    return f"{100 * share:.0f} %" if np.isfinite(share) else "not visible"


def figures(tables: Tables) -> dict[str, Picture]:
    """Effects against cost, and for each scene the gauges, drawn while measuring."""
    effects, numbers = tables["elements"], tables["oscilloscope"]
    words = "gauge signals, step by step from the elastic line to the electronics"
    return {"elements": Picture("Effect of each element against its cost", partial(draw_effects, effects))} | {
        f"oscilloscope-{scene}": Picture(f"{scene}: {words}", None, numbers[numbers["scene"] == scene])
        for scene in effects["scene"].unique()
    }


def draw_effects(effects: pd.DataFrame) -> Any:
    """Draws the largest change of an observable over the scenes against the cost of the element, a point per code."""
    figure, axis = pyplot().subplots(figsize=(7.0, 4.2))
    worst = effects.assign(size=effects["change"].abs()).groupby(["element", "engine"], sort=False)
    table = worst.agg(size=("size", "max"), cost=("cost_ratio", "median")).reset_index()
    for shape, (element, rows) in zip(SHAPES * 2, table.groupby("element", sort=False), strict=False):
        for _, row in rows.iterrows():
            colour = line_of(row["engine"]).colour
            axis.plot(max(row["size"], MIN_CHANGE), row["cost"], shape, ms=6, mfc="none", mec=colour, mew=1.2)
        axis.plot([], [], shape, ms=6, mfc="none", mec=GREY, label=element)
    for engine in table["engine"].unique():
        axis.plot([], [], "-", color=line_of(engine).colour, lw=2, label=engine)
    axis.set(xscale="log", yscale="log", ylabel="time per body and step, with over without the element")
    axis.set_xlabel("largest relative change of speed, peaks, width or arrival, over all scenes")
    axis.axhline(1.0, color=GREY, lw=0.6)
    axis.legend(loc="center left", bbox_to_anchor=(1.0, 0.5), fontsize=7)
    return figure


def draw_oscilloscope(scene: str, shown: Mapping[str, Sequence[Simulation]]) -> Any:
    """Draws the gauges of a scene against time for all steps; to the right observables with the paper's values.

    Args:
        scene: name of the scene.
        shown: runs by step, one per seed.
    """
    plt = pyplot()
    colours = plt.get_cmap("viridis")(np.linspace(0.0, 0.8, len(STEPS)))
    signals = {
        step: [sensor_signals(run.case.layout, run.trace) for run in runs]  # by seed, then by gauge
        for step, runs in shown.items()
    }
    gauges = list(signals[ELASTIC][0])
    numbers = _numbers(shown, *(gauge.removeprefix("bead_") for gauge in gauges[:2]))
    figure = plt.figure(figsize=(7.2, 1.55 * len(gauges) + 0.6), layout="constrained")
    left, right = figure.subfigures(1, 2, width_ratios=(3, 2))
    axes = np.atleast_1d(left.subplots(len(gauges), 1, sharex=True))
    for axis, gauge in zip(axes, gauges, strict=True):
        for colour, (step, seeds) in zip(colours, signals.items(), strict=True):
            force_N = np.array([by_gauge[gauge] for by_gauge in seeds])
            mean, spread = force_N.mean(axis=0), force_N.std(axis=0)
            time = shown[step][0].case.sample_times_s * 1e6
            axis.fill_between(time, mean - spread, mean + spread, color=colour, alpha=0.25, lw=0)
            axis.plot(time, mean, color=colour, lw=1.0, label=step)
        axis.set_ylabel(f"{gauge.replace('_', ' ')}, N")
    axes[-1].set_xlabel("time, µs")
    panels = np.atleast_1d(right.subplots(len(numbers), 1, sharex=True))
    for axis, (name, (label, values)) in zip(panels, numbers.items(), strict=True):
        for place, (colour, each) in enumerate(zip(colours, values, strict=True)):
            axis.errorbar(place, each.mean(), yerr=each.std(), fmt="o", ms=4, color=colour, capsize=2)
        for quote in (quote for quote in quotes() if (quote.scene, quote.observable) == (scene, name)):
            axis.axhline(quote.value, color=GREY, lw=0.8, ls="--")
            words, place = f"experiment: {quote.about}{quote.value:g} {quote.unit}", axis.get_yaxis_transform()
            axis.text(0.02, quote.value, words, transform=place, fontsize=6, color=GREY, va="bottom")
        axis.set_ylabel(label)
        axis.margins(x=0.15, y=0.25)
    panels[-1].set_xticks(range(len(shown)), list(shown), rotation=35, ha="right", fontsize=7)
    for colour, tick in zip(colours, panels[-1].get_xticklabels(), strict=True):
        tick.set_color(0.55 * colour[:3])  # text needs more contrast than lines
        tick.set_fontweight("bold")
    return figure


def _numbers(shown: Mapping[str, Sequence[Simulation]], upper: str, lower: str) -> dict[str, tuple[str, list[Any]]]:
    """Labels and values by step, shape (seeds,), of the drawn observables that the scene shows."""
    found = {}
    for words, (pattern, scale, unit) in DRAWN_OBSERVABLES.items():
        name = pattern.format(upper=upper, lower=lower)
        values = [scale * np.array([run.values[name] for run in runs]) for runs in shown.values()]
        if any(np.isfinite(each.mean()) for each in values):
            found[name] = (f"{words}\n{unit}", values)
    return found


def section(tables: Tables) -> dict[str, Any]:
    """Effects by scene; True for the short study."""
    effects = tables["elements"]
    names = list(effects["observable"].unique())
    return {
        "short": not {scene.name for scene in read_elements().scene} <= set(effects["scene"]),
        "observables": names,
        "effects": {scene: [*_rows(own, names)] for scene, own in effects.groupby("scene", sort=False)},
    }


def _rows(effects: pd.DataFrame, names: list[str]) -> Iterator[dict[str, Any]]:
    for (element, engine), own in effects.groupby(["element", "engine"], sort=False):
        by_name = own.set_index("observable").reindex(names)
        cells = [_cell(change, spread) for change, spread in zip(by_name["change"], by_name["spread"], strict=True)]
        cost, ratio = f"{own['cost_ns'].iloc[0]:.3g}", f"{own['cost_ratio'].iloc[0]:.2f}"
        yield {"element": element, "engine": engine, "cells": cells, "cost": cost, "ratio": ratio}


def _cell(change: float, spread: float) -> str:
    if pd.isna(change):
        return "–"
    return f"{100 * change:+.3g}" + (f" ± {100 * spread:.1g}" if pd.notna(spread) else "")


CHAPTER = Chapter(
    name="elements",
    title="effects of elements",
    tables={
        "elements": switches.Effect,
        "elements-checks": Check,
        "elements-between": switches.Between,
        "oscilloscope": gauge_steps.StepRow,
        "oscilloscope-ranges": gauge_steps.StepRow,
    },
    measure=measure,
    sentences=sentences,
    figures=figures,
    section=section,
    judge=judge,
)
