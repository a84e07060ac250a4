"""Figures of the study of elements: effects with costs, and gauge signals step by step."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.ticker import LogLocator, NullFormatter, StrMethodFormatter

from postproc.draw.style import GREY, PAGE_IN, QUOTED, marker_of, pyplot, text_color
from postproc.paper.quoted import quoted
from postproc.paper.simulate import Simulation
from postproc.read.sensors import sensor_signals
from validation.elements.gauge_steps import ELASTIC
from validation.elements.switches import read_elements

MIN_CHANGE = 1e-6  # smaller changes are drawn here
SAME = 0.01  # of a change: codes that differ by less are one dot
DOT: dict[str, Any] = {"marker": "o", "ms": 4.5, "color": "black"}
# of the steps, different in grey print too
LINES: tuple[dict[str, Any], ...] = (
    {"color": "#9a9a9a", "ls": "-", "lw": 2.2},
    {"color": "#0072b2", "ls": (0, (1, 1)), "lw": 1.3},
    {"color": "#d55e00", "ls": (0, (5, 1.5)), "lw": 1.2},
    {"color": "#009e73", "ls": (0, (4, 1, 1, 1)), "lw": 1.2},
    {"color": "black", "ls": "-", "lw": 1.2},
)
OBSERVABLES = {
    "sensor peak": ("bead_{upper}_peak_N", 1.0, "N"),
    "speed": ("speed_{upper}_to_{lower}_m_s", 1.0, "m/s"),
    "wall peak": ("wall_peak_N", 1.0, "N"),
    "wall envelope": ("wall_envelope_per_s", 1e-6, "per µs"),
}


@dataclass(frozen=True)
class Quote:
    """Number that the paper quotes from its experiment on a scene.

    Attributes:
        words: name of the quantity.
        scale: factor from the observable's unit to ``unit``.
        value: quoted value in ``unit``.
        about: text before the value.
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


def largest_effects(effects: pd.DataFrame) -> pd.DataFrame:
    """Largest change of an observable over the scenes, and the ratio of costs, by element and engine.

    Elements from the largest to the smallest effect, each followed by its variants.
    """
    worst = effects.assign(size=effects["change"].abs()).groupby(["element", "engine"], sort=False)
    table = worst.agg(size=("size", "max"), cost=("cost_ratio", "median")).reset_index()
    parents = {item.name: item.of or item.name for item in read_elements().element}
    parent, sizes = table["element"].map(parents), table.groupby("element")["size"].max()
    keys = {"rank": -parent.map(sizes), "parent": parent, "own": parent != table["element"]}
    return table.assign(**keys).sort_values([*keys], kind="stable").drop(columns=["rank", "parent", "own"])


def draw_effects(effects: pd.DataFrame) -> Any:
    """Draws a row for each element: its largest change by code, codes that agree as one dot; to the right its cost."""
    table = largest_effects(effects)
    names, variants = list(table["element"].unique()), {item.name for item in read_elements().element if item.of}
    figure, (left, right) = pyplot().subplots(
        1, 2, figsize=(PAGE_IN, 0.8 + 0.19 * len(names)), sharey=True, width_ratios=(3, 2), layout="constrained"
    )
    for place, name in enumerate(names):
        rows = table[table["element"] == name]
        sizes = rows["size"].clip(lower=MIN_CHANGE)
        if sizes.max() <= (1 + SAME) * sizes.min():
            left.plot(sizes.mean(), place, ls="", **DOT)
        for size, (_, row) in zip(sizes, rows.iterrows(), strict=True):
            mark = marker_of(row["engine"])
            if sizes.max() > (1 + SAME) * sizes.min():
                left.plot(size, place, ls="", **mark)
            right.plot(row["cost"], place, ls="", **mark)
    for engine in table["engine"].unique():
        right.plot([], [], ls="", label=engine, **marker_of(engine))
    right.plot([], [], ls="", label="codes that agree", **DOT)
    right.axvline(1.0, color=GREY, lw=0.8)
    left.set(xscale="log", xlabel=f"largest relative change, all scenes ({MIN_CHANGE:.0e} or less: none)")
    right.set(xscale="log", xlabel="time with / without the element")
    right.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    right.xaxis.set_major_formatter(StrMethodFormatter("{x:g}"))
    right.xaxis.set_minor_formatter(NullFormatter())
    labels = [f"variant: {name}" if name in variants else name for name in names]
    left.set_yticks(range(len(names)), labels)
    left.invert_yaxis()
    figure.legend(*right.get_legend_handles_labels(), loc="outside upper right", ncols=5, fontsize=7)
    return figure


def draw_oscilloscope(scene: str, shown: Mapping[str, Sequence[Simulation]]) -> Any:
    """Draws the gauges of a scene against time for all steps; to the right observables with the paper's values.

    Args:
        scene: name of the scene.
        shown: runs by step, one per seed.
    """
    signals = {
        step: [sensor_signals(run.case.layout, run.trace) for run in runs]  # by seed, then by gauge
        for step, runs in shown.items()
    }
    gauges = list(signals[ELASTIC][0])
    panels = [*_panels(shown, *(gauge.removeprefix("bead_") for gauge in gauges[:2]))]
    quoted_here = {quote.observable: quote for quote in quotes() if quote.scene == scene}
    figure = pyplot().figure(figsize=(PAGE_IN, 1.4 * len(gauges) + 0.8), layout="constrained")
    left, right = figure.subfigures(1, 2, width_ratios=(3, 2))
    axes = np.atleast_1d(left.subplots(len(gauges), 1, sharex=True))
    for axis, gauge in zip(axes, gauges, strict=True):
        for look, (step, seeds) in zip(LINES, signals.items(), strict=True):
            mean_N = np.mean([by_gauge[gauge] for by_gauge in seeds], axis=0)
            axis.plot(shown[step][0].case.sample_times_s * 1e6, mean_N, label=step, **look)
        _mark(axis, quoted_here.get(f"{gauge}_peak_N"))
        axis.set_ylabel(f"{gauge.replace('_', ' ')}, N")
    axes[-1].set_xlabel("time, µs")
    left.legend(*axes[0].get_legend_handles_labels(), loc="outside upper left", ncols=3, fontsize=7)
    numbers = np.atleast_1d(right.subplots(len(panels), 1, sharex=True))
    for axis, (name, label, values) in zip(numbers, panels, strict=True):
        for place, (look, by_seed) in enumerate(zip(LINES, values, strict=True)):
            axis.errorbar(place, by_seed.mean(), yerr=by_seed.std(), capsize=2, **DOT | {"color": look["color"]})
        _mark(axis, quoted_here.get(name))
        axis.set_ylabel(label)
        axis.margins(x=0.15, y=0.25)
    numbers[-1].set_xticks(range(len(shown)), list(shown), rotation=35, ha="right", fontsize=7)
    return figure


def _mark(axis: Any, quote: Quote | None) -> None:
    """Marks a value that the paper quotes."""
    if quote:
        axis.axhline(quote.value, **QUOTED)
        text, place = f"experiment: {quote.about}{quote.value:g} {quote.unit}", axis.get_yaxis_transform()
        axis.text(0.02, quote.value, text, transform=place, fontsize=7, color=text_color(QUOTED["color"]), va="top")


def _panels(shown: Mapping[str, Sequence[Simulation]], upper: str, lower: str) -> Iterator[tuple[str, str, list[Any]]]:
    """Names, labels and values by step, shape (seeds,), of the drawn observables that the scene shows."""
    for label, (pattern, scale, unit) in OBSERVABLES.items():
        name = pattern.format(upper=upper, lower=lower)
        values = [scale * np.array([run.values[name] for run in runs]) for runs in shown.values()]
        if any(np.isfinite(value.mean()) for value in values):
            yield name, f"{label}\n{unit}", values
