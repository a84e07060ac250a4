"""Gauge forces of a chain in stacked panels, with the differences between engines below."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd

from drivers.chain.case import Layout
from drivers.chain.chain import Array
from drivers.chain.trace import Trace
from drivers.engines import REFERENCE
from postproc.draw.style import GREY, MICRO, drawing_order, grey_of, letter_panel, pyplot
from postproc.paper.simulate import Simulation
from postproc.read.residual import residual
from postproc.read.sensors import sensor_signals

GAUGE_IN = 1.126  # height of a panel
STRIP, RESIDUAL = "strip", "residual_to_reference_share"
STRIP_POINTS = 12  # markers of each code
STRIP_RANGE, STRIP_TICKS = (1e-7, 1e-2), (1e-6, 1e-3)
STRIP_ROOM = 3.0  # factor of room beyond the smallest and largest value of a strip
ROOM = 0.3  # steps of the grid below and above curves
LABEL_AT = 0.012  # position of a label, as a share of the time axis


@dataclass(frozen=True)
class ForcePanel:
    """A panel of forces in a figure of the paper.

    Attributes:
        letter, words: Title of the panel.
        look: Plot keywords of the curves.
        step_N: Force between two grid lines.
        gauges: Drawn gauges; empty for all.
        room: Free grid steps above the curves, for marks.
        strip: Height of the strip below, as a share of the height of the gauges.
    """

    letter: str
    words: str
    look: Mapping[str, Any]
    step_N: float
    gauges: tuple[str, ...] = ()
    room: float = ROOM
    strip: float = 0.3


def draw_panel(
    figure: Any, cell: Any, panel: ForcePanel, found: Mapping[str, Simulation]
) -> tuple[dict[str, Any], pd.DataFrame]:
    """Stacked gauge forces of the reference on one scale of force, and the codes' differences from it in a strip.

    Args:
        figure: A matplotlib figure.
        cell: Cell of the figure's grid.
        panel: Title and style of the panel.
        found: Simulations of a case by engine.

    Returns:
        Axes by gauge in the order in which a wave meets them, then the axes of the strip; table of all drawn numbers.
    """
    traces = {engine: one.trace for engine, one in found.items()}
    signals = {engine: sensor_signals(one.case.layout, one.trace) for engine, one in found.items()}
    names = panel.gauges or tuple(signals[REFERENCE])
    step_N, time_us = panel.step_N, traces[REFERENCE].time_s * MICRO
    limits = [(-ROOM * step_N, float(signals[REFERENCE][name].max()) + panel.room * step_N) for name in names]
    heights = [top - bottom for bottom, top in limits]
    rows = cell.subgridspec(len(names) + 1, 1, height_ratios=[*heights, panel.strip * sum(heights)], hspace=0)
    axes = [figure.add_subplot(rows[place]) for place in range(len(names))]
    for axis, name, limit in zip(axes, names, limits, strict=True):
        axis.plot(time_us, signals[REFERENCE][name], **panel.look)
        axis.set(xlim=(0, time_us[-1]), ylim=limit)
        axis.yaxis.set_major_locator(pyplot().MultipleLocator(step_N))
        axis.tick_params(axis="x", length=0, labelbottom=False)
        axis.spines["bottom"].set_visible(False)
        if len(names) > 1:
            axis.text(LABEL_AT * time_us[-1], 0.25 * step_N, name.replace("_", " "), va="bottom")
    letter_panel(axes[0], panel.letter, panel.words)
    axes[len(axes) // 2].set_ylabel("force (N)")
    strip = figure.add_subplot(rows[-1], sharex=axes[0])
    tables = [_draw_strip(strip, traces)]
    for engine, own in signals.items():
        columns = {"engine": engine, "time_s": traces[engine].time_s} | {f"{name}_N": own[name] for name in names}
        tables.append(pd.DataFrame(columns | {RESIDUAL: residual(traces[engine], traces[REFERENCE])}))
    return dict(zip((*names, STRIP), (*axes, strip), strict=True)), pd.concat(tables).assign(panel=panel.letter)


def _draw_strip(axis: Any, traces: Mapping[str, Trace]) -> pd.DataFrame:
    """Largest difference of each code from the reference in equal intervals of time, as a grey marker in the middle.

    The intervals of the codes are staggered, so that equal differences stay visible.
    """
    tables = [pd.DataFrame()]
    found = residuals(traces, REFERENCE)
    for place, (engine, share) in enumerate(found.items()):
        every = max(len(share) // STRIP_POINTS, 1)
        starts = np.arange(place * every // len(found), len(share) - every + 1, every)
        largest = np.array([share[start : start + every].max() for start in starts])
        middle_s = traces[engine].time_s[starts + every // 2]
        axis.plot(middle_s * MICRO, largest, label=engine, **grey_of(engine) | {"ms": 3, "mew": 0.8})
        tables.append(pd.DataFrame({"engine": engine, "quantity": STRIP, "time_s": middle_s, RESIDUAL: largest}))
    if not found:
        axis.text(0.5, 0.5, "no code", transform=axis.transAxes, ha="center", va="center", color=GREY)
    low, high = STRIP_RANGE
    if found:
        low, high = min(low, axis.dataLim.minposy / STRIP_ROOM), max(high, axis.dataLim.y1 * STRIP_ROOM)
    axis.set(yscale="log", ylim=(low, high), xlabel="time since impact (µs)", ylabel=r"$\delta F$")
    axis.set_yticks(STRIP_TICKS)
    axis.minorticks_off()
    return pd.concat(tables)


def draw_curve(
    axis: Any, engine: str, words: str, time_s: Array | Sequence[float], gauge: str, force_N: Any, **look: Any
) -> pd.DataFrame:
    """Draws a curve of forces against time; returns its numbers, with the forces in the column of a gauge."""
    axis.plot(np.asarray(time_s) * MICRO, force_N, **look)
    return pd.DataFrame({"engine": engine, "quantity": words, "time_s": time_s, f"{gauge}_N": force_N})


def name_codes(figure: Any, strip: Any) -> None:
    """Adds one legend for the markers of all strips, below the figure."""
    if strip.lines:
        figure.legend(*strip.get_legend_handles_labels(), loc="outside lower center", ncols=6, handletextpad=0.1)


def gauge_title(layout: Layout, gauge: str) -> str:
    """Title of a gauge, with the time constant of its electronics."""
    name = "wall" if gauge == "wall" else f"sensor bead {gauge.removeprefix('bead_')}: mean of its two contact forces"
    constant_s = layout.time_constant_s
    return name if constant_s is None else f"{name}, behind electronics of {constant_s * 1e3:g} ms"


def residuals(traces: Mapping[str, Trace], baseline: str) -> dict[str, Array]:
    """Deviation of each engine except the reference from a baseline engine at each sample, in the order of drawing."""
    others = [engine for engine in drawing_order(list(traces)) if engine not in (baseline, REFERENCE)]
    return {engine: residual(traces[engine], traces[baseline]) for engine in others}
