"""Pictures of elements: effect against cost, and what gauges show step by step."""

from typing import Any

import numpy as np
import pandas as pd

from postproc.draw.style import FAINT, line_of, pyplot
from validation.elements.oscilloscope import STEPS, Shown

LEAST = 1e-6  # of a change: what is smaller is drawn there
NUMBERS = {
    "sensor peak": ("bead_{upper}_peak_N", 1.0, "N"),
    "speed": ("speed_{upper}_to_{lower}_m_s", 1.0, "m/s"),
    "wall peak": ("wall_peak_N", 1.0, "N"),
    "wall envelope": ("wall_envelope_per_s", 1e-6, "per µs"),
}


def draw_effects(effects: pd.DataFrame) -> Any:
    """Largest change of an observable over the scenes against what the element costs, a point for each code."""
    plt = pyplot()
    figure, axis = plt.subplots(figsize=(7.0, 4.2))
    worst = effects.assign(size=effects["change"].abs()).groupby(["element", "engine"], sort=False)
    table = worst.agg(size=("size", "max"), cost=("cost_ratio", "median")).reset_index()
    shapes = ["o", "s", "^", "v", "D", "P", "X", "<", ">", "p", "h", "*", "d"]
    for shape, (element, rows) in zip(shapes * 2, table.groupby("element", sort=False), strict=False):
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


def draw_oscilloscope(shown: list[Shown], quoted: dict[str, tuple[float, str]]) -> Any:
    """One scene: its gauges against time for all steps, and beside them their numbers with what the paper quotes."""
    plt = pyplot()
    colours = plt.get_cmap("viridis")(np.linspace(0.0, 0.8, len(STEPS)))
    gauges = list(shown[0].signals)
    numbers = [(word, *_values(shown, word, gauges)) for word in NUMBERS]
    numbers = [each for each in numbers if np.isfinite(each[1]).any()]
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
    for axis, (word, mean, spread, unit) in zip(panels, numbers, strict=True):
        place = np.arange(len(shown))
        for colour, x, y, dy in zip(colours, place, mean, spread, strict=True):
            axis.errorbar(x, y, yerr=dy, fmt="o", ms=4, color=colour, capsize=2)
        if word in quoted:
            value, words = quoted[word]
            axis.axhline(value, color=FAINT, lw=0.8, ls="--")
            axis.annotate(
                words, (0.02, value), xycoords=("axes fraction", "data"), fontsize=6, va="bottom", color=FAINT
            )
        axis.set_ylabel(f"{word}\n{unit}")
        axis.margins(x=0.15, y=0.25)
    panels[-1].set_xticks(range(len(shown)), [each.step for each in shown], rotation=35, ha="right", fontsize=7)
    for colour, label in zip(colours, panels[-1].get_xticklabels(), strict=True):
        label.set_color(0.55 * colour[:3])  # words need more contrast than lines
        label.set_fontweight("bold")
    return figure


def _values(shown: list[Shown], word: str, gauges: list[str]) -> tuple[Any, Any, str]:
    """Means and standard deviations of a number, step by step, and its unit."""
    pattern, scale, unit = NUMBERS[word]
    upper, lower = (gauge.removeprefix("bead_") for gauge in gauges[:2])
    name = pattern.format(upper=upper, lower=lower)
    values = [scale * each.values[name] for each in shown]
    return np.array([each.mean() for each in values]), np.array([each.std() for each in values]), unit
