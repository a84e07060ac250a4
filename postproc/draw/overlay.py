"""Measured quantities with their standard errors, compared with the computed ones, as a table and a figure.

A measured pulse is read from a regression spline through its readings (``postproc.read.alignment``). Peaks and
crossings are found on the run's clock as for a computed trace (``postproc.read.signals``). Their standard errors are
to first order in the white noise of the readings and the error of the baseline. Errors of the gain and of a fitted
trigger are independent and added in quadrature. Quantities are named as in ``postproc.read.observables``; all forces
are above rest.
"""

from collections import defaultdict
from collections.abc import Mapping, Sequence
from itertools import pairwise
from math import hypot, isnan, log10, nan
from pathlib import Path
from textwrap import fill
from typing import Any

import numpy as np
import pandas as pd

from drivers.base import paths
from drivers.chain.case import Layout
from drivers.scene.model import MeasuredEntry
from postproc.draw.plot import COLUMN_IN, MICRO, Product, line_of, pyplot
from postproc.draw.stack import GAUGE_IN, gauge_title
from postproc.read.alignment import AlignedGauge, align
from postproc.read.measured import FORCE, read_measured, read_quoted
from postproc.read.motion import Simulation
from postproc.read.observables import LEVELS
from postproc.read.signals import peaks, rising_crossing

LEVEL = LEVELS[1]  # share of the peak at which the duration is cut
AMPLITUDE, ARRIVAL, DURATION = "amplitude_N", "arrival_s", f"duration_{100 * LEVEL:g}pct_s"
IMPULSE = "impulse_N_s"
NOISE_FACTOR = 8.0  # prominence of a pulse, divided by the noise of the spline
MIN_PROMINENCE = 0.005  # of a pulse, as a share of the signal's range
QUOTED = "quoted"
SMALLER = {3: "m", 6: "u"}  # prefixes of units that are mistaken for others, by powers of ten
MAX_FACTOR = 5.0  # factor between measured and computed forces apart from such a power
INVERTED = -0.3  # correlation of inverted readings
SLACK = 0.25  # share of the run by which a record may be longer or shorter without a remark
COLUMNS = ("quantity", "source", "measured", "error_by_noise", "error_by_gain", "computed")
STRIP_IN = 0.62  # height of a panel of residuals
ENDS_IN = 1.15  # height of legend and axis label
LINE = 46  # characters in a line of a title or label
BAND = 2.0  # standard errors on either side
MAX_READINGS = 4000  # drawn readings of a gauge
COLOURS = ("#333333", "#88572c", "#5b3a8c", "#2c6e49")  # of the files, in their order
HEADINGS = ("quantity", "source", "measured", "± error", "computed", "difference", "in standard errors")
DIGITS = {"measured": 5, "standard_error": 2, "computed": 5, "difference": 3, "difference_in_errors": 2}

_Pulse = Mapping[str, tuple[float, float]]  # amplitude, arrival and duration with their errors by noise
_Row = tuple[str, str, float, float, float, float]  # of ``COLUMNS``


def lay_over(
    entries: Mapping[str, MeasuredEntry], folder: Path, where: str, motion: Simulation
) -> tuple[list[AlignedGauge], pd.DataFrame, list[str]]:
    """Measured gauges on a motion's clock in the order of the scene, all misfits, and remarks on lengths and gains.

    Args:
        entries: Entries by their keys in the scene, such as ``measured.0``.
        folder: Folder to which the paths of the files are relative.
        where: Scene as messages name it.
        motion: Computed motion.

    Raises:
        InputError: An entry or its file is wrong, or does not fit the run.
    """
    signals, names = motion.signals, [*motion.values]
    traces = [read_measured(entry, folder, signals, where, key) for key, entry in entries.items() if entry.file]
    quoted = dict(pair for key, entry in entries.items() for pair in read_quoted(entry, names, where, key).items())
    aligned, said, end_s = align(traces, motion), defaultdict[tuple[str, str], list[str]](list), motion.trace.time_s[-1]
    for gauge in aligned:
        for remark in filter(None, (length_remark(gauge, end_s), gain_remark(gauge))):
            said[paths.shown(gauge.channel.trace.file), remark].append(gauge.channel.gauge)
    remarks = [f"{file}: {', '.join(gauges)}: {remark}" for (file, remark), gauges in said.items()]
    return aligned, misfits(aligned, motion, quoted), remarks


def length_remark(gauge: AlignedGauge, end_s: float) -> str:
    """Sentence on a record and a run that do not end at about the same time; empty otherwise."""
    start, stop = (1e3 * (float(time_s) - gauge.channel.trigger_s) for time_s in gauge.channel.trace.time_s[[0, -1]])
    end = 1e3 * end_s
    if start <= SLACK * end and abs(stop - end) <= SLACK * end:
        return ""
    unreached = ", so the wave does not reach it" * (stop <= 1e3 * gauge.onset_s)
    readings = f"readings from {start:.3g} to {stop:.3g} ms after the impact, the run until {end:.3g} ms{unreached}"
    return f"{readings}; the rest is not compared (run.duration)"


def gain_remark(gauge: AlignedGauge) -> str:
    """Sentence on a gain with a wrong sign or a wrong power of ten, with a gain that fits; empty otherwise."""
    trace, both_N = gauge.channel.trace, (gauge.force_N, gauge.computed_N)
    largest_N, expected_N = (float(np.abs(force_N - np.median(force_N)).max()) for force_N in both_N)
    if gauge.time_s[-1] <= gauge.onset_s or largest_N <= NOISE_FACTOR * gauge.channel.noise_N:
        return ""  # no wave to judge by
    sign, power = -1 if np.corrcoef(*both_N)[0, 1] < INVERTED else 1, 3 * round(log10(largest_N / expected_N) / 3)
    if abs(power) not in SMALLER or not 1 / MAX_FACTOR < largest_N / expected_N / 10.0**power < MAX_FACTOR:
        power = 0
    problems = ["readings are inverted"] * (sign < 0)
    if power:
        units = (SMALLER[abs(power)] + trace.unit, trace.unit)[:: 1 if power > 0 else -1]
        problems.append(f"readings are about {10.0**power:g} times the computed force ({' read as '.join(units)}?)")
    if not problems:
        return ""
    fit = f"{sign * trace.gain / 10.0**power:g}"
    stated = fit if trace.unit == FORCE else f'"{fit} N/{trace.unit}"'
    return f"{' and '.join(problems)}: {trace.key}.gain = {stated} fits"


def misfits(
    aligned: Sequence[AlignedGauge], motion: Simulation, quoted: Mapping[str, tuple[float, float]]
) -> pd.DataFrame:
    """All measured quantities with those of a motion, then the quoted ones, with names as of observables, in SI units.

    For each gauge: amplitude, arrival and duration of the first pulse; impulse of all readings within the run, their
    correlation with the computed force, the root mean square of the residual in N and relative to the computed
    amplitude, with the noise of a reading as its error; baseline. For each file: speeds between neighbouring gauges and
    the trigger. The ``source`` of a quantity is the name of the file, or ``quoted``. Numbers are NaN where a trace does
    not show the quantity.

    Args:
        aligned: Measured gauges on the motion's clock.
        motion: Computed motion.
        quoted: Quoted values with their relative standard errors by observable.
    """
    computed, rows = motion.values, list[_Row]()
    for file in dict.fromkeys(gauge.channel.trace.file for gauge in aligned):
        of_file = [gauge for gauge in aligned if gauge.channel.trace.file == file]
        pulses = {gauge.channel.gauge: _pulse(gauge) for gauge in of_file}
        for gauge in of_file:
            rows += _of_gauge(gauge, pulses[gauge.channel.gauge], computed)
        rows += _speeds(motion.case.layout, pulses, file.name, computed)
        rows.append(("trigger_s", file.name, of_file[0].channel.trigger_s, of_file[0].trigger_error_s, 0.0, nan))
    for name, (value, error_share) in quoted.items():
        rows.append((name, QUOTED, value, abs(value) * error_share, 0.0, computed[name]))
    table = pd.DataFrame(rows, columns=COLUMNS)
    table.insert(3, "standard_error", [hypot(noise, gain) for *_, noise, gain, _ in rows])
    table["difference"] = table["measured"] - table["computed"]
    return table.assign(difference_in_errors=table["difference"] / table["standard_error"].replace(0.0, nan))


def _of_gauge(gauge: AlignedGauge, pulse: _Pulse, values: Mapping[str, float]) -> list[_Row]:
    """First pulse; impulse by the trapezoidal rule, correlation, root mean square of the residual, and baseline."""
    weights, channel = np.convolve(np.diff(gauge.time_s), [0.5, 0.5]), gauge.channel
    measured, computed = float(weights @ gauge.force_N), float(weights @ gauge.computed_N)
    noise = hypot(channel.noise_N * float(np.linalg.norm(weights)), float(weights @ gauge.rest_error_N))
    name, (arrival_s, error_s), by_gain = channel.gauge, pulse[ARRIVAL], channel.trace.gain_uncertainty
    peak_N, known_s, width_s = (values[f"{name}_{part}"] for part in (AMPLITUDE, ARRIVAL, DURATION))
    rms_N = float(np.sqrt(np.mean((gauge.force_N - gauge.computed_N) ** 2)))
    rows = [
        (AMPLITUDE, *pulse[AMPLITUDE], by_gain, peak_N),
        (ARRIVAL, arrival_s, hypot(error_s, gauge.trigger_error_s), 0.0, known_s),
        (DURATION, *pulse[DURATION], 0.0, width_s),
        (IMPULSE, measured, noise, by_gain, computed),
        ("correlation", float(np.corrcoef(gauge.force_N, gauge.computed_N)[0, 1]), nan, 0.0, nan),
        ("residual_rms_N", rms_N, channel.noise_N, 0.0, nan),
        ("residual_rms_share", rms_N / peak_N, channel.noise_N / peak_N, 0.0, nan),
        (f"baseline_{channel.trace.unit}", gauge.baseline, gauge.baseline_error, 0.0, nan),
    ]
    source = channel.trace.file.name
    return [
        (f"{name}_{part}", source, value, error, gain * abs(value), known) for part, value, error, gain, known in rows
    ]


def _pulse(gauge: AlignedGauge) -> _Pulse:
    """First pulse of a smoothed gauge with errors to first order in the noise; NaN for quantities not shown.

    The arrival t and the edge e are zeros of F'(t) and F(e) - ``LEVEL`` F(t), so an error f of F moves them by
    -f'(t)/F''(t) and -(f(e) - ``LEVEL`` f(t))/F'(e).
    """
    time_s, smooth_N = gauge.run_s, gauge.curve(gauge.run_s)
    span_N = float(np.ptp(smooth_N))
    prominence = max(NOISE_FACTOR * float(np.median(gauge.error_N)) / span_N, MIN_PROMINENCE) if span_N else 1.0
    first = next((peak for peak in peaks(time_s, smooth_N, min(prominence, 1.0)) if peak.value > 0), None)
    if first is None:
        return dict.fromkeys((AMPLITUDE, ARRIVAL, DURATION), (nan, nan))
    edge_s = rising_crossing(time_s, smooth_N, LEVEL * first.value, first)
    peak, error, norm = first.time_s, gauge.errors, np.linalg.norm
    late = error(peak, 1) / gauge.curve(peak, 2)
    early = (error(edge_s) - LEVEL * error(peak)) / gauge.curve(edge_s, 1)
    return {
        AMPLITUDE: (first.value, float(norm(error(peak)))),
        ARRIVAL: (peak, float(norm(late))),
        DURATION: (2 * (peak - edge_s), 2 * float(norm(late - early))),
    }


def _speeds(layout: Layout, pulses: Mapping[str, _Pulse], source: str, computed: Mapping[str, float]) -> list[_Row]:
    """Peak-to-peak speeds between neighbouring sensors that are both in the file."""
    speeds = []
    for upper, lower in pairwise(layout.sensors):
        names = [f"bead_{sensor.from_wall}" for sensor in (upper, lower)]
        if pulses.keys() >= {*names}:
            (first_s, first_error_s), (second_s, second_error_s) = (pulses[name][ARRIVAL] for name in names)
            travel_s = second_s - first_s if second_s > first_s else nan
            speed = (upper.height_m - lower.height_m) / travel_s
            error = speed * hypot(first_error_s, second_error_s) / travel_s
            name = f"speed_{upper.from_wall}_to_{lower.from_wall}_m_s"
            speeds.append((name, source, speed, error, 0.0, computed[name]))
    return speeds


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
    size, look = (COLUMN_IN, ENDS_IN + sum(heights)), {"sharex": True, "squeeze": False, "layout": "constrained"}
    figure, grid = pyplot().subplots(len(heights), figsize=size, height_ratios=heights, **look)
    files = list(dict.fromkeys(each.channel.trace.file for each in aligned))
    colour_of_run = line_of(motion.engine)["color"]
    for gauge, (force, strip) in zip(gauges, grid.reshape(-1, 2), strict=True):
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
    handles = {line.get_label(): line for axis in grid[:, 0] for line in axis.get_legend_handles_labels()[0]}
    figure.legend(handles.values(), handles, loc="outside upper left", markerscale=4, ncols=1)
    figure.align_ylabels()
    return Product(figure, misfits)


def _draw_gauge(force: Any, strip: Any, gauge: AlignedGauge, computed_N: Any, colour: str) -> None:
    """Draws readings and residual of a gauge, with a band of ``BAND`` standard errors by noise and baseline."""
    every, label = -(-len(gauge.time_s) // MAX_READINGS), fill(f"measured ({gauge.channel.trace.file.name})", LINE)
    look = {"ls": "none", "marker": ".", "ms": 2.0, "mew": 0, "alpha": 0.75, "color": colour, "label": label}
    force.plot(gauge.time_s[::every] * MICRO, gauge.force_N[::every], **look)
    left_N, time_us, band_N = gauge.curve(gauge.run_s) - computed_N, gauge.run_s * MICRO, BAND * gauge.error_N
    strip.plot(time_us, left_N, color=colour, lw=0.8, label="residual: smoothed readings minus computed")
    band = f"{BAND:g} standard errors by noise and baseline"
    strip.fill_between(time_us, left_N - band_N, left_N + band_N, color=colour, alpha=0.25, lw=0, label=band)


def misfit_rows(misfits: pd.DataFrame) -> list[list[str]]:
    """Rows of the printed table, with a dash for missing values."""
    rounded = {column: [number(value, digits) for value in misfits[column]] for column, digits in DIGITS.items()}
    return misfits.assign(**rounded)[["quantity", "source", *DIGITS]].to_numpy().tolist()


def number(value: float, digits: int) -> str:
    """Rounded number as text; a dash for NaN."""
    return "–" if isnan(value) else f"{value:.{digits}g}"
