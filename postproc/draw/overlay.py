"""Measured and computed forces of each gauge with their residuals, and the table of misfits."""

from collections.abc import Sequence
from math import isnan
from textwrap import fill
from typing import Any

import pandas as pd

from postproc.draw.product import Product
from postproc.draw.stack import GAUGE_IN, gauge_title
from postproc.draw.style import COLUMN_IN, MICRO, line_of, pyplot
from postproc.read.alignment import AlignedGauge
from postproc.read.motion import Simulation

STRIP_IN = 0.62  # height of a panel of residuals
HEAD_IN, FOOT_IN = 0.75, 0.4
LINE = 46  # characters in a line of a title or label
BAND = 2.0  # standard errors on either side
MAX_READINGS = 4000  # drawn readings of a gauge
COLOURS = ("#333333", "#88572c", "#5b3a8c", "#2c6e49")  # of the files, in their order


def draw_overlay(motion: Simulation, aligned: Sequence[AlignedGauge], misfits: pd.DataFrame) -> Product:
    """Readings as forces above rest with the computed forces; below each, smoothed readings minus computed forces.

    Args:
        motion: Computed motion.
        aligned: Measured gauges on its clock.
        misfits: Misfits, for the table.
    """
    run_s, measured = motion.trace.time_s, {each.channel.gauge for each in aligned}
    gauges = [gauge for gauge in motion.signals if gauge in measured]
    heights = [GAUGE_IN, STRIP_IN] * len(gauges)
    figure, grid = pyplot().subplots(
        len(heights), 1, sharex=True, figsize=(COLUMN_IN, HEAD_IN + FOOT_IN + sum(heights)), height_ratios=heights,
        squeeze=False, layout="constrained",
    )  # fmt: skip
    files = list(dict.fromkeys(each.channel.trace.file for each in aligned))
    colour_of_run = line_of(motion.engine)["color"]
    for place, gauge in enumerate(gauges):
        force, strip = grid[2 * place, 0], grid[2 * place + 1, 0]
        curve = motion.curves[gauge]
        for each in (each for each in aligned if each.channel.gauge == gauge):
            colour = COLOURS[files.index(each.channel.trace.file) % len(COLOURS)]
            _draw_gauge(force, strip, each, curve(each.run_s), colour)
        force.plot(run_s * MICRO, curve(run_s), color=colour_of_run, lw=1.3, label=f"computed ({motion.engine})")
        force.set_title(fill(gauge_title(motion.case.layout, gauge), LINE), loc="left")
        force.set(ylabel="force above\nrest (N)", xlim=(0, float(run_s[-1]) * MICRO))
        strip.axhline(0, color=colour_of_run, lw=0.8)
        strip.set_ylabel("residual\n(N)")
        strip.margins(y=0.15)
    grid[-1, 0].set_xlabel("time since impact (µs)")
    shown = [pair for axis in grid[:, 0] for pair in zip(*axis.get_legend_handles_labels(), strict=True)]
    handles = {label: handle for handle, label in shown}
    figure.legend(handles.values(), handles.keys(), loc="outside upper left", markerscale=4, ncols=1)
    figure.align_ylabels()
    return Product(figure, misfits)


def _draw_gauge(force: Any, strip: Any, gauge: AlignedGauge, computed_N: Any, colour: str) -> None:
    """Draws readings and residual of a gauge, with a band of ``BAND`` standard errors by noise and baseline."""
    every = -(-len(gauge.time_s) // MAX_READINGS)
    force.plot(
        gauge.time_s[::every] * MICRO, gauge.force_N[::every], ls="none", marker=".", ms=2.0, mew=0, alpha=0.75,
        color=colour, label=fill(f"measured ({gauge.channel.trace.file.name})", LINE),
    )  # fmt: skip
    left_N, time_us = gauge.smooth_N - computed_N, gauge.run_s * MICRO
    band_N = BAND * gauge.error_N
    strip.plot(time_us, left_N, color=colour, lw=0.8, label="residual: smoothed readings minus computed")
    band = f"{BAND:g} standard errors by noise and baseline"
    strip.fill_between(time_us, left_N - band_N, left_N + band_N, color=colour, alpha=0.25, lw=0, label=band)


HEADINGS = ("quantity", "source", "measured", "± error", "computed", "difference", "in standard errors")
DIGITS = {"measured": 5, "standard_error": 2, "computed": 5, "difference": 3, "difference_in_errors": 2}


def misfit_rows(misfits: pd.DataFrame) -> list[list[str]]:
    """Rows of the printed table, with a dash for missing values."""
    rounded = {column: [number(value, digits) for value in misfits[column]] for column, digits in DIGITS.items()}
    return misfits.assign(**rounded)[["quantity", "source", *DIGITS]].to_numpy().tolist()


def number(value: float, digits: int) -> str:
    """Rounded number as text; a dash for NaN."""
    return "–" if isnan(value) else f"{value:.{digits}g}"
