"""Gauge forces of chains in stacked panels, with the differences between engines below."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd

from drivers.chain.case import Layout
from drivers.chain.chain import Array
from drivers.chain.trace import Trace, residual
from drivers.engines import REFERENCE
from postproc.draw.product import Product
from postproc.draw.style import GREY, MICRO, draw_codes, drawing_order, letter_panel, pyplot
from postproc.read.motion import Simulation
from postproc.read.sensors import sensor_signals

GAUGE_IN = 1.126  # height of a panel
STRIP, RESIDUAL = "strip", "residual_to_reference_share"
STRIP_POINTS, STRIP_SIZE = 24, 2.5  # markers of a code, and their size
STRIP_RANGE, STRIP_TICKS = (3e-7, 3e-3), (1e-6, 1e-3)
STRIP_ROOM = 3.0  # factor of room beyond the smallest and largest value of a strip
STRIP_WORDS = "$\\delta F$: largest difference from the exact motion in any contact,\nas a share of the largest change"
ROOM = 0.3  # steps of the grid below and above curves
LABEL_AT = 0.012  # position of a label, as a share of the time axis


@dataclass(frozen=True)
class ForcePanel:
    """Title and plot keywords of a panel of forces in a figure of the paper."""

    letter: str
    words: str
    look: Mapping[str, Any]


def draw_pairs(
    figure: Any,
    cells: Iterable[Any],
    panels: Sequence[ForcePanel],
    simulations: Sequence[Mapping[str, Simulation]],
    numbers: Callable[[Simulation], Mapping[str, float]],
    step_N: float,
    gauges: tuple[str, ...] = (),
    strip: float = 0.22,
) -> tuple[list[dict[str, Any]], Product]:
    """Stacked gauge forces of the reference, on one scale in each pair of panels, and the codes' differences in strips.

    Args:
        figure: A matplotlib figure.
        cells: Cells of the figure's grid, one for each panel.
        panels: Titles and styles; the first two are a pair, and so on.
        simulations: Simulations by engine, for each panel.
        numbers: Function that computes further numbers of a simulation by name, for the table.
        step_N: Force between two grid lines.
        gauges: Drawn gauges; empty for all.
        strip: Height of a strip, as a share of the height of the gauges above it.

    Returns:
        For each panel its axes by gauge in the order in which a wave meets them, then the axes of the strip; the figure
        with all drawn numbers and those of ``numbers``.
    """
    axes, tables, tops = [], [], dict[str, float]()
    for place, (cell, panel, by_engine) in enumerate(zip(cells, panels, simulations, strict=True)):
        if place % 2 == 0:
            pair = [
                sensor_signals(half[REFERENCE].case.layout, half[REFERENCE].trace) for half in simulations[place:][:2]
            ]
            names = gauges or tuple(pair[0])
            tops = {name: max(float(signals[name].max()) for signals in pair) + ROOM * step_N for name in names}
        drawn, table = _draw_panel(figure, cell, panel, by_engine, tops, step_N, strip)
        rows = [(engine, *number) for engine, motion in by_engine.items() for number in numbers(motion).items()]
        further = pd.DataFrame(rows, columns=["engine", "quantity", "value"])
        axes.append(drawn)
        tables.append(pd.concat([table, further]).assign(panel=panel.letter))
    _name_codes(figure, [drawn[STRIP] for drawn in axes])
    chains = {
        f"({panel.letter}) {panel.words}": by_engine[REFERENCE].trace
        for panel, by_engine in zip(panels, simulations, strict=True)
    }
    return axes, Product(figure, pd.concat(tables, ignore_index=True), chains)


def _draw_panel(
    figure: Any,
    cell: Any,
    panel: ForcePanel,
    by_engine: Mapping[str, Simulation],
    tops: Mapping[str, float],
    step_N: float,
    strip: float,
) -> tuple[dict[str, Any], pd.DataFrame]:
    """Draws a panel of ``draw_pairs`` up to the force in ``tops`` by gauge."""
    traces = {engine: simulation.trace for engine, simulation in by_engine.items()}
    signals = {
        engine: sensor_signals(simulation.case.layout, simulation.trace) for engine, simulation in by_engine.items()
    }
    time_us, bottom = traces[REFERENCE].time_s * MICRO, -ROOM * step_N
    heights = [top - bottom for top in tops.values()]
    rows = cell.subgridspec(len(tops) + 1, 1, height_ratios=[*heights, strip * sum(heights)], hspace=0)
    axes = {name: figure.add_subplot(rows[place]) for place, name in enumerate(tops)}
    for name, axis in axes.items():
        axis.plot(time_us, signals[REFERENCE][name], **panel.look)
        axis.set(xlim=(0, time_us[-1]), ylim=(bottom, tops[name]))
        axis.yaxis.set_major_locator(pyplot().MultipleLocator(step_N))
        axis.tick_params(axis="x", length=0, labelbottom=False)
        axis.spines["bottom"].set_visible(False)
        if len(tops) > 1:
            axis.text(LABEL_AT, 0.97, name.replace("_", " "), va="top", transform=axis.transAxes)
    stacked = [*axes.values()]
    letter_panel(stacked[0], panel.letter, panel.words)
    stacked[len(stacked) // 2].set_ylabel("force (N)")
    axes[STRIP] = figure.add_subplot(rows[-1], sharex=stacked[0])
    tables = [_draw_strip(axes[STRIP], traces)]
    for engine, by_gauge in signals.items():
        columns = {"engine": engine, "time_s": traces[engine].time_s} | {f"{name}_N": by_gauge[name] for name in tops}
        tables.append(pd.DataFrame(columns | {RESIDUAL: residual(traces[engine], traces[REFERENCE])}))
    return axes, pd.concat(tables)


def _draw_strip(axis: Any, traces: Mapping[str, Trace]) -> pd.DataFrame:
    """Largest difference of each code from the reference in equal intervals of time, as a marker in the middle."""
    differences, time_s = residuals(traces, REFERENCE), traces[REFERENCE].time_s
    every = max(len(time_s) // STRIP_POINTS, 1)
    starts = np.arange(0, len(time_s) - every + 1, every)
    largest = {code: np.maximum.reduceat(share, starts) for code, share in differences.items()}
    everything = np.concatenate([*largest.values(), STRIP_RANGE])
    low, high = everything[everything > 0].min(), everything.max()
    axis.set(yscale="log", ylim=(low / STRIP_ROOM, high * STRIP_ROOM), xlabel="time since impact (µs)")
    axis.set_ylabel(r"$\delta F$")
    axis.set_yticks(STRIP_TICKS)
    axis.minorticks_off()
    if not differences:
        axis.text(0.5, 0.5, "no code", transform=axis.transAxes, ha="center", va="center", color=GREY)
    middle_s = time_s[starts + every // 2]
    draw_codes(axis, {code: (middle_s * MICRO, share) for code, share in largest.items()}, STRIP_SIZE)
    return pd.concat([pd.DataFrame()] + [
        pd.DataFrame({"engine": code, "quantity": STRIP, "time_s": middle_s, RESIDUAL: share})
        for code, share in largest.items()
    ])  # fmt: skip


def draw_curve(
    axis: Any, engine: str, words: str, time_s: Array | Sequence[float], gauge: str, force_N: Any, **look: Any
) -> pd.DataFrame:
    """Draws a curve of forces against time; returns its numbers, with the forces in the column of a gauge."""
    axis.plot(np.asarray(time_s) * MICRO, force_N, **look)
    return pd.DataFrame({"engine": engine, "quantity": words, "time_s": time_s, f"{gauge}_N": force_N})


def quoted_rows(panel: str, **values: float) -> pd.DataFrame:
    """Rows of a table with numbers that the paper states."""
    columns = {"panel": panel, "engine": "paper", "quantity": [*values], "value": [*values.values()]}
    return pd.DataFrame(columns)


def _name_codes(figure: Any, strips: Sequence[Any]) -> None:
    """Adds one legend for the markers of all strips, below the figure."""
    lines = {line.get_label(): line for axis in strips for line in axis.lines}
    if lines:
        look = {"ncols": 6, "handletextpad": 0.1, "title": STRIP_WORDS, "title_fontsize": 8}
        figure.legend(lines.values(), lines, loc="outside lower center", **look)


def gauge_title(layout: Layout, gauge: str) -> str:
    """Title of a gauge, with the time constant of its electronics."""
    name = "wall" if gauge == "wall" else f"sensor bead {gauge.removeprefix('bead_')}: mean of its two contact forces"
    constant_s = layout.time_constant_s
    return name if constant_s is None else f"{name}, behind electronics of {constant_s * 1e3:g} ms"


def residuals(traces: Mapping[str, Trace], baseline: str) -> dict[str, Array]:
    """Deviation of each engine except the reference from a baseline engine at each sample, in the order of drawing."""
    others = [engine for engine in drawing_order(list(traces)) if engine not in (baseline, REFERENCE)]
    return {engine: residual(traces[engine], traces[baseline]) for engine in others}
