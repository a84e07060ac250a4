"""Figures of elements: effect against cost, and what gauges show step by step."""

from collections.abc import Sequence
from functools import partial
from typing import Any

import numpy as np
import pandas as pd

from postproc.draw.style import FAINT, line_of, pyplot
from validation.elements.elements_sentences import Quote
from validation.elements.oscilloscope import STEPS, Shown
from validation.studies import Picture, Tables

LEAST = 1e-6  # of a change: what is smaller is drawn there
SHAPES = "os^vDPX<>ph*d"
WATCHED = {
    "sensor peak": ("bead_{upper}_peak_N", 1.0, "N"),
    "speed": ("speed_{upper}_to_{lower}_m_s", 1.0, "m/s"),
    "wall peak": ("wall_peak_N", 1.0, "N"),
    "wall envelope": ("wall_envelope_per_s", 1e-6, "per µs"),
}


def figures(tables: Tables) -> dict[str, Picture]:
    """Effects against cost, and for each scene what its gauges show, which is drawn when it is measured."""
    effects, numbers = tables["elements"], tables["oscilloscope"]
    words = "what the gauges show, from the elastic line to the gauge's electronics"
    return {"elements": Picture("Effect of each element against its cost", partial(draw_effects, effects))} | {
        f"oscilloscope-{scene}": Picture(f"{scene}: {words}", None, numbers[numbers["scene"] == scene])
        for scene in effects["scene"].unique()
    }


def draw_effects(effects: pd.DataFrame) -> Any:
    """Largest change of an observable over the scenes against what the element costs, a point for each code."""
    figure, axis = pyplot().subplots(figsize=(7.0, 4.2))
    worst = effects.assign(size=effects["change"].abs()).groupby(["element", "engine"], sort=False)
    table = worst.agg(size=("size", "max"), cost=("cost_ratio", "median")).reset_index()
    for shape, (element, rows) in zip(SHAPES * 2, table.groupby("element", sort=False), strict=False):
        for _, row in rows.iterrows():
            colour = line_of(row["engine"]).colour
            axis.plot(max(row["size"], LEAST), row["cost"], shape, ms=6, mfc="none", mec=colour, mew=1.2)
        axis.plot([], [], shape, ms=6, mfc="none", mec=FAINT, label=element)
    for engine in table["engine"].unique():
        axis.plot([], [], "-", color=line_of(engine).colour, lw=2, label=engine)
    axis.set_xscale("log")
    axis.set_yscale("log")
    axis.axhline(1.0, color=FAINT, lw=0.6)
    axis.set_xlabel("largest relative change of speed, peaks, width or arrival, over all scenes")
    axis.set_ylabel("time per body and step, with it over without")
    axis.legend(loc="center left", bbox_to_anchor=(1.0, 0.5), fontsize=7)
    return figure


def draw_oscilloscope(shown: Sequence[Shown], quotes: Sequence[Quote]) -> Any:
    """One scene: its gauges against time for all steps, and beside them their numbers with what the paper quotes."""
    plt = pyplot()
    colours = plt.get_cmap("viridis")(np.linspace(0.0, 0.8, len(STEPS)))
    gauges = list(shown[0].signals)
    numbers = _numbers(shown, *(gauge.removeprefix("bead_") for gauge in gauges[:2]))
    figure = plt.figure(figsize=(7.2, 1.55 * len(gauges) + 0.6), layout="constrained")
    left, right = figure.subfigures(1, 2, width_ratios=(3, 2))
    axes = np.atleast_1d(left.subplots(len(gauges), 1, sharex=True))
    for axis, gauge in zip(axes, gauges, strict=True):
        for colour, each in zip(colours, shown, strict=True):
            mean, spread = each.signals[gauge].mean(axis=0), each.signals[gauge].std(axis=0)
            time = each.time_s * 1e6
            axis.fill_between(time, mean - spread, mean + spread, color=colour, alpha=0.25, lw=0)
            axis.plot(time, mean, color=colour, lw=1.0, label=each.step)
        axis.set_ylabel(f"{gauge.replace('_', ' ')}, N")
    axes[-1].set_xlabel("time, µs")
    panels = np.atleast_1d(right.subplots(len(numbers), 1, sharex=True))
    for axis, (name, (label, values)) in zip(panels, numbers.items(), strict=True):
        for place, (colour, each) in enumerate(zip(colours, values, strict=True)):
            axis.errorbar(place, each.mean(), yerr=each.std(), fmt="o", ms=4, color=colour, capsize=2)
        for quote in (quote for quote in quotes if (quote.scene, quote.observable) == (shown[0].scene, name)):
            axis.axhline(quote.value, color=FAINT, lw=0.8, ls="--")
            axis.text(
                0.02,
                quote.value,
                quote.label,
                transform=axis.get_yaxis_transform(),
                fontsize=6,
                color=FAINT,
                va="bottom",
            )
        axis.set_ylabel(label)
        axis.margins(x=0.15, y=0.25)
    panels[-1].set_xticks(range(len(shown)), [each.step for each in shown], rotation=35, ha="right", fontsize=7)
    for colour, tick in zip(colours, panels[-1].get_xticklabels(), strict=True):
        tick.set_color(0.55 * colour[:3])  # words need more contrast than lines
        tick.set_fontweight("bold")
    return figure


def _numbers(shown: Sequence[Shown], upper: str, lower: str) -> dict[str, tuple[str, list[Any]]]:
    """Label and values over the seeds, step by step, of the observables that are watched and seen."""
    found = {}
    for words, (pattern, scale, unit) in WATCHED.items():
        name = pattern.format(upper=upper, lower=lower)
        values = [scale * each.values[name] for each in shown]
        if any(np.isfinite(each.mean()) for each in values):
            found[name] = (f"{words}\n{unit}", values)
    return found
