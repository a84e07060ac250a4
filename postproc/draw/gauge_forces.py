"""Forces on the gauges of a chain by all engines, and their differences below."""

from collections.abc import Mapping
from typing import Any

from drivers.chain.case import Layout
from drivers.chain.chain import Array
from drivers.chain.trace import Trace
from drivers.engines import REFERENCE, VERLET
from postproc.draw.stack import gauge_title, residuals
from postproc.draw.style import GREY, MICRO, drawing_order, line_of, pyplot
from postproc.read.signals import sensor_signals

WIDTH_IN = 4.2  # legible on a phone
PANEL_IN = 0.92  # two panels, text and verdicts fit on the first screen of the report
MAX_GAUGES = 4  # panels of forces; the table of observables has all gauges
LEGEND_COLUMNS = 3


def draw_gauge_forces(layout: Layout, traces: Mapping[str, Trace], failed: Mapping[str, Trace]) -> Any:
    """Draws a panel for each gauge, and a panel of the largest difference over all contacts.

    Of many gauges those closest to the wall are drawn. Differences are from the exact motion and from velocity Verlet;
    without both, from the first engine.

    Args:
        layout: Layout of the chain.
        traces: Traces by engine, of equal sample times; at least one, here or in ``failed``.
        failed: Partial traces of failed runs by engine, at the same times.

    Returns:
        The figure; None without a gauge and without a difference.
    """
    everything = {**traces, **failed}
    labels = {engine: f"{engine}{' (failed)' * (engine in failed)}" for engine in drawing_order([*everything])}
    signals = {engine: sensor_signals(layout, trace) for engine, trace in everything.items()}
    names = [*next(iter(signals.values()))][-MAX_GAUGES:]
    baselines = [name for name in (REFERENCE, VERLET) if name in traces] or [*traces][:1]
    differences = {baseline: residuals(everything, baseline) for baseline in baselines}
    differences = {baseline: shares for baseline, shares in differences.items() if shares}
    count = len(names) + bool(differences)
    if not count:
        return None
    size = (WIDTH_IN, PANEL_IN * count + 0.7)
    figure, grid = pyplot().subplots(count, 1, sharex=True, figsize=size, squeeze=False, layout="constrained")
    time_us = next(iter(everything.values())).time_s * MICRO
    for axis, name in zip(grid[:, 0], names, strict=False):
        for engine, label in labels.items():
            axis.plot(time_us, signals[engine][name], label=label, **line_of(engine))
        axis.set_title(f"{gauge_title(layout, name)} (N)", loc="left")
        axis.set_ylim(bottom=min(0.0, axis.dataLim.y0))
    if differences:
        _draw_differences(grid[-1, 0], time_us, differences, labels)
    grid[-1, 0].set(xlim=(time_us[0], time_us[-1] if len(time_us) > 1 else None), xlabel="time since impact (µs)")
    handles = [pyplot().Line2D([], [], label=label, **line_of(engine)) for engine, label in labels.items()]
    figure.legend(handles=handles, loc="outside upper left", ncols=LEGEND_COLUMNS)
    return figure


def _draw_differences(
    axis: Any, time_us: Array, differences: Mapping[str, Mapping[str, Array]], labels: Mapping[str, str]
) -> None:
    """Draws the largest force difference over all contacts from each baseline, divided by the largest change."""
    for baseline, shares in differences.items():
        for engine, share in shares.items():
            axis.plot(time_us, share, label=f"{labels[engine]} − {baseline}", **line_of(engine))
        lowest = min(shares.values(), key=lambda share: share[share > 0].min(initial=1.0))
        last = (lowest > 0).nonzero()[0][-1:]
        for sample in last:  # none, if all differences are zero
            axis.annotate(
                f"from {baseline}", (time_us[sample], lowest[sample]), (0, 2), textcoords="offset points", ha="right",
                color=GREY,
            )  # fmt: skip
    axis.set_yscale("log", nonpositive="mask")
    axis.margins(y=0.25)  # space for words above the highest line
    axis.set_title("largest force difference of any contact / largest change", loc="left")
