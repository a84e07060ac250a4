"""Gauge forces of several engines stacked over each other, with their differences below."""

from collections.abc import Mapping
from typing import Any

import numpy as np
import pandas as pd

from drivers.chain.case import Layout
from drivers.chain.chain import Array
from drivers.chain.trace import Trace
from drivers.engines import REFERENCE
from postproc.draw.style import COLUMN_IN, FAINT, MICRO, drawing_order, line_of, pyplot
from postproc.read.residual import residual
from postproc.read.sensors import sensor_signals

GAUGE_IN, RESIDUAL_IN = 1.126, 1.426  # heights of panels


def draw_stack(layout: Layout, traces: Mapping[str, Trace]) -> tuple[Any, dict[str, Any]]:
    """One panel a gauge in the order in which a wave meets them, and one with the residuals.

    The traces are of equal sample times; the axes come by gauge name, that of the residuals as ``residual``.
    """
    signals = {engine: sensor_signals(layout, trace) for engine, trace in traces.items()}
    gauges, time_s = list(next(iter(signals.values()))), next(iter(traces.values())).time_s
    heights = [GAUGE_IN] * len(gauges) + [RESIDUAL_IN]
    figure, grid = pyplot().subplots(
        len(heights), 1, sharex=True, figsize=(COLUMN_IN, 0.6 + sum(heights)), height_ratios=heights, squeeze=False
    )
    axes = dict(zip([*gauges, "residual"], grid[:, 0], strict=True))
    for gauge in gauges:
        draw_lines(axes[gauge], time_s, {engine: own[gauge] for engine, own in signals.items()})
        axes[gauge].set(ylabel="force (N)", xlim=(0, float(time_s[-1]) * MICRO))
        axes[gauge].set_title(gauge_title(layout, gauge), loc="left")
    if gauges:
        figure.legend(*grid[0, 0].get_legend_handles_labels(), loc="lower left", ncols=4, columnspacing=1.2,
                      borderaxespad=0, bbox_to_anchor=(0.02, 1.3), bbox_transform=grid[0, 0].transAxes)  # fmt: skip
    draw_residuals(axes["residual"], traces)
    axes["residual"].set_xlabel("time since impact (µs)")
    figure.align_ylabels()
    figure.subplots_adjust(hspace=0.38)
    return figure, axes


def chain_of_reference(traces: Mapping[str, Trace]) -> dict[str, Trace]:
    """The reference's forces by their title, for a space-time figure beside a stack."""
    return {f"every contact of the chain ({REFERENCE})": traces[REFERENCE]}


def draw_lines(axis: Any, time_s: Array, forces: Mapping[str, Array]) -> None:
    """Each engine's forces against time in its own line, the widest first. Shape (samples,) or (samples, curves)."""
    for engine in drawing_order(list(forces)):
        line = line_of(engine)
        drawn = axis.plot(time_s * MICRO, forces[engine], color=line.colour, lw=line.width, ls=line.dashes)
        drawn[0].set_label(engine)


def gauge_title(layout: Layout, gauge: str) -> str:
    """The gauge in words, with the electronics behind it."""
    name = "wall" if gauge == "wall" else f"sensor bead {gauge.removeprefix('bead_')}: mean of its two contact forces"
    constant_s = layout.time_constant_s
    return name if constant_s is None else f"{name}, behind electronics of {constant_s * 1e3:g} ms"


def residuals(traces: Mapping[str, Trace], baseline: str) -> dict[str, Array]:
    """Deviation of each engine but the exact one from a baseline engine at each sample, in the order of drawing."""
    others = [engine for engine in drawing_order(list(traces)) if engine not in (baseline, REFERENCE)]
    return {engine: residual(traces[engine], traces[baseline]) for engine in others}


def draw_residuals(axis: Any, traces: Mapping[str, Trace]) -> None:
    """Largest force difference from the reference over all contacts, against time."""
    if REFERENCE in traces:
        for engine, difference in residuals(traces, REFERENCE).items():
            line, shown = line_of(engine), np.where(difference > 0, difference, np.nan)
            axis.plot(traces[engine].time_s * MICRO, shown, color=line.colour, lw=1.5, ls=line.dashes)
    axis.set_yscale("log")
    if axis.lines:
        axis.set_ylim(bottom=1e-3 * axis.dataLim.y1)
    else:
        axis.text(0.5, 0.5, "no other engine", transform=axis.transAxes, ha="center", color=FAINT)
    axis.set_ylabel("|ΔF| / largest change")
    axis.set_title("largest difference from the reference over all contacts", loc="left")


def stack_table(layout: Layout, traces: Mapping[str, Trace]) -> pd.DataFrame:
    """The plotted numbers, a row per engine and sample: time, gauges, residual against the reference."""
    tables = []
    for engine, trace in traces.items():
        columns: dict[str, Any] = {"engine": engine, "time_s": trace.time_s}
        columns |= {f"{name}_N": signal for name, signal in sensor_signals(layout, trace).items()}
        if REFERENCE in traces:
            columns["residual_to_reference_share"] = residual(trace, traces[REFERENCE])
        tables.append(pd.DataFrame(columns))
    return pd.concat(tables, ignore_index=True)
