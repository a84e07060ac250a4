"""Figures of the report."""

from typing import Any

import numpy as np

from postproc.sensors import sensor_signals
from postproc.style import drawing_order, line_of, pyplot
from validation.comparison import share_of_largest
from validation.scenes import ComparedScene


def draw_scene(scene: ComparedScene) -> Any:
    """Gauge signals of all engines over each other, with the force residuals below. Returns a figure."""
    plt = pyplot()
    signals = {engine: sensor_signals(run.layout, run.trace) for engine, run in scene.runs.items()}
    gauges = list(next(iter(signals.values())))
    heights = [1.5] * len(gauges) + [1.9]
    figure, axes = plt.subplots(
        len(heights), 1, sharex=True, figsize=(6.4, 0.6 + sum(heights)), height_ratios=heights, squeeze=False
    )
    for axis, gauge in zip(axes[:, 0], gauges, strict=False):
        for engine in drawing_order(list(scene.runs)):
            line = line_of(engine)
            time_us = scene.runs[engine].trace.time_s * 1e6
            axis.plot(time_us, signals[engine][gauge], color=line.colour, lw=line.width, ls=line.dashes, label=engine)
        axis.set_ylabel("force (N)")
        axis.set_title(_gauge_name(gauge), loc="left", fontsize=9)
    if gauges:
        axes[0, 0].legend(loc="upper left", bbox_to_anchor=(0, 1.52), ncols=4, fontsize=8.5)
    _draw_residuals(axes[-1, 0], scene)
    axes[-1, 0].set_xlabel("time since impact (µs)")
    figure.subplots_adjust(hspace=0.32)
    return figure


def _gauge_name(gauge: str) -> str:
    if gauge == "wall":
        return "force on the wall"
    return f"sensor in bead {gauge.removeprefix('bead_')} from the wall: mean of its two contact forces"


def _draw_residuals(axis: Any, scene: ComparedScene) -> None:
    """Largest force difference over all contacts against time: to the reference, and to the same scheme."""
    for yardstick, width in (("reference", 1.5), ("verlet", 0.9)):
        if yardstick not in scene.runs:
            continue
        exact = scene.runs[yardstick].trace
        for engine in drawing_order(list(scene.runs)):
            if engine == yardstick or engine == "reference":
                continue
            trace, line = scene.runs[engine].trace, line_of(engine)
            residual = share_of_largest(np.abs(trace.force_N - exact.force_N).max(axis=1), exact)
            axis.plot(
                trace.time_s * 1e6,
                np.where(residual > 0, residual, np.nan),
                color=line.colour,
                lw=width,
                ls=line.dashes,
            )
            if engine == "liggghts" or len(scene.runs) < 3:
                above = f"minus {yardstick}"
                axis.annotate(above, (1, residual[-1]), xycoords=("axes fraction", "data"), xytext=(3, -3),
                              textcoords="offset points", fontsize=8, color="#555555")  # fmt: skip
    axis.set_yscale("log")
    axis.set_ylabel("|ΔF| / largest F")
    axis.set_title("largest difference over all contacts", loc="left", fontsize=9)
