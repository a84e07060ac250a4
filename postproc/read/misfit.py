"""Measured quantities with their standard errors, compared with the computed ones.

A measured pulse is read from a regression spline through its readings (``postproc.read.alignment``). Peaks and
crossings are found on the run's clock as for a computed trace (``postproc.read.signals``). Their standard errors are
to first order in the white noise of the readings and the error of the baseline. Errors of the gain and of a fitted
trigger are independent and added in quadrature. Quantities are named as in ``postproc.read.observables``; all forces
are above rest.
"""

from collections.abc import Mapping, Sequence
from itertools import pairwise
from math import hypot, log10, nan
from pathlib import Path

import numpy as np
import pandas as pd
from scipy.signal import correlate

from drivers.base import paths
from drivers.chain.case import Layout
from drivers.chain.trace import Trace
from drivers.scene.model import MeasuredEntry
from postproc.read.alignment import AlignedGauge, align, check_length
from postproc.read.measured import FORCE, read_measured, read_quoted
from postproc.read.observables import LEVELS, observe
from postproc.read.signals import gauges_of, peaks, rising_crossing

LEVEL = LEVELS[1]  # share of the peak at which the duration is cut
AMPLITUDE, ARRIVAL, DURATION = "amplitude_N", "arrival_s", f"duration_{100 * LEVEL:g}pct_s"
IMPULSE = "impulse_N_s"
NOISE_FACTOR = 8.0  # prominence of a pulse, divided by the noise of the spline
MIN_PROMINENCE = 0.005  # of a pulse, as a share of the signal's range
QUOTED = "quoted"
SMALLER = {3: "m", 6: "u"}  # prefixes of units that are mistaken for others, by powers of ten
MAX_FACTOR = 5.0  # factor between measured and computed forces apart from such a power
INVERTED = 1.5  # smallest ratio of the negative to the positive extremum of the cross-correlation

COLUMNS = ("quantity", "source", "measured", "error_by_noise", "error_by_gain", "computed")

_Pulse = Mapping[str, tuple[float, float]]  # amplitude, arrival and duration with their errors by noise
_Row = tuple[str, str, float, float, float, float]  # of ``COLUMNS``


def lay_over(
    entries: Mapping[str, MeasuredEntry], folder: Path, where: str, layout: Layout, run: Trace
) -> tuple[list[AlignedGauge], pd.DataFrame, list[str]]:
    """Measured gauges on a run's clock in the order of the scene, all misfits, and remarks on lengths and gains.

    Args:
        entries: Entries by their keys in the scene, such as ``measured.0``.
        folder: Folder to which the paths of the files are relative.
        where: Scene as messages name it.
        layout: Layout of the run.
        run: Computed trace.

    Raises:
        InputError: An entry or its file is wrong, or does not fit the run.
    """
    gauges, names = gauges_of(layout), list(observe(layout, run, LEVELS))
    traces = {key: read_measured(entry, folder, gauges, where, key) for key, entry in entries.items() if entry.file}
    quoted = dict(pair for key, entry in entries.items() for pair in read_quoted(entry, names, where, key).items())
    aligned = align(list(traces.values()), layout, run)
    remarks = []
    for key, trace in traces.items():
        of_trace = [gauge for gauge in aligned if gauge.trace is trace]
        onsets_s = {gauge.gauge: gauge.onset_s for gauge in of_trace}
        remarks.append(check_length(trace, of_trace[0].trigger_s, float(run.time_s[-1]), onsets_s))
        on_gain = {gauge.gauge: gain_remark(gauge, key) for gauge in of_trace}
        for remark in filter(None, dict.fromkeys(on_gain.values())):
            named = ", ".join(gauge for gauge in on_gain if on_gain[gauge] == remark)
            remarks.append(f"{paths.shown(trace.file)}: {named}: {remark}")
    return aligned, misfits(aligned, layout, run, quoted), [*dict.fromkeys(filter(None, remarks))]


def gain_remark(gauge: AlignedGauge, key: str) -> str:
    """Sentence on a gain with a wrong sign or a wrong power of ten, with a gain that fits; empty otherwise.

    Args:
        gauge: Gauge on the run's clock.
        key: Key of its entry in the scene, such as ``measured.0``.
    """
    trace, grid_s = gauge.trace, np.linspace(gauge.time_s[0], gauge.time_s[-1], len(gauge.time_s))
    both_N = [np.interp(grid_s, gauge.time_s, force_N) for force_N in (gauge.force_N, gauge.computed_N)]
    measured_N, computed_N = (force_N - np.median(force_N) for force_N in both_N)
    largest_N, expected_N = (float(np.abs(force_N).max()) for force_N in (measured_N, computed_N))
    if gauge.time_s[-1] <= gauge.onset_s or largest_N <= NOISE_FACTOR * gauge.noise_N:
        return ""  # no wave to judge by
    both = correlate(measured_N, computed_N, method="fft")
    sign, power = -1 if -both.min() > INVERTED * both.max() else 1, 3 * round(log10(largest_N / expected_N) / 3)
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
    return f"{' and '.join(problems)}: {key}.gain = {stated} fits"


def misfits(
    aligned: Sequence[AlignedGauge], layout: Layout, run: Trace, quoted: Mapping[str, tuple[float, float]]
) -> pd.DataFrame:
    """All measured quantities with those of a run, then the quoted ones, with names as of observables, in SI units.

    For each gauge: amplitude, arrival and duration of the first pulse; impulse of all readings within the run, their
    correlation with the computed force, the root mean square of the residual in N and relative to the computed
    amplitude, with the noise of a reading as its error; baseline. For each file: speeds between neighbouring gauges and
    the trigger. The ``source`` of a quantity is the name of the file, or ``quoted``. Numbers are NaN where a trace does
    not show the quantity.

    Args:
        aligned: Measured gauges on the run's clock.
        layout: Layout of the run.
        run: Computed trace.
        quoted: Quoted values with their relative standard errors by observable.
    """
    computed, rows = observe(layout, run, LEVELS), list[_Row]()
    for file in dict.fromkeys(gauge.trace.file for gauge in aligned):
        of_file = [gauge for gauge in aligned if gauge.trace.file == file]
        pulses = {gauge.gauge: _pulse(gauge) for gauge in of_file}
        for gauge in of_file:
            rows += _of_gauge(gauge, pulses[gauge.gauge], computed)
        rows += _speeds(layout, pulses, file.name, computed)
        rows.append(("trigger_s", file.name, of_file[0].trigger_s, of_file[0].trigger_error_s, 0.0, nan))
    for name, (value, error_share) in quoted.items():
        rows.append((name, QUOTED, value, abs(value) * error_share, 0.0, computed[name]))
    table = pd.DataFrame(rows, columns=COLUMNS)
    table.insert(3, "standard_error", [hypot(noise, gain) for *_, noise, gain, _ in rows])
    table["difference"] = table["measured"] - table["computed"]
    return table.assign(difference_in_errors=table["difference"] / table["standard_error"].replace(0.0, nan))


def _of_gauge(gauge: AlignedGauge, pulse: _Pulse, values: Mapping[str, float]) -> list[_Row]:
    """First pulse; impulse by the trapezoidal rule, correlation, root mean square of the residual, and baseline."""
    weights = np.convolve(np.diff(gauge.time_s), [0.5, 0.5])
    measured, computed = float(weights @ gauge.force_N), float(weights @ gauge.computed_N)
    noise = hypot(gauge.noise_N * float(np.linalg.norm(weights)), float(weights @ gauge.rest_error_N))
    name, (arrival_s, error_s) = gauge.gauge, pulse[ARRIVAL]
    peak_N = values[f"{name}_{AMPLITUDE}"]
    rms_N = float(np.sqrt(np.mean((gauge.force_N - gauge.computed_N) ** 2)))
    correlation = float(np.corrcoef(gauge.force_N, gauge.computed_N)[0, 1])
    rows = {
        AMPLITUDE: pulse[AMPLITUDE],
        ARRIVAL: (arrival_s, hypot(error_s, gauge.trigger_error_s)),
        DURATION: pulse[DURATION],
        IMPULSE: (measured, noise),
        "correlation": (correlation, nan),
        "residual_rms_N": (rms_N, gauge.noise_N),
        "residual_rms_share": (rms_N / peak_N, gauge.noise_N / peak_N),
        f"baseline_{gauge.trace.unit}": (gauge.baseline, gauge.baseline_error),
    }
    known = {part: values[f"{name}_{part}"] for part in pulse} | {IMPULSE: computed}
    gain, source = dict.fromkeys((AMPLITUDE, IMPULSE), gauge.trace.gain_uncertainty), gauge.trace.file.name
    return [
        (f"{name}_{part}", source, value, error, gain.get(part, 0.0) * abs(value), known.get(part, nan))
        for part, (value, error) in rows.items()
    ]


def _pulse(gauge: AlignedGauge) -> _Pulse:
    """First pulse of a smoothed gauge with errors to first order in the noise; NaN for quantities not shown.

    The arrival t and the edge e are zeros of F'(t) and F(e) - ``LEVEL`` F(t), so an error f of F moves them by
    -f'(t)/F''(t) and -(f(e) - ``LEVEL`` f(t))/F'(e).
    """
    time_s, span_N = gauge.run_s, float(np.ptp(gauge.smooth_N))
    prominence = max(NOISE_FACTOR * float(np.median(gauge.error_N)) / span_N, MIN_PROMINENCE) if span_N else 1.0
    first = next((peak for peak in peaks(time_s, gauge.smooth_N, min(prominence, 1.0)) if peak.value > 0), None)
    if first is None:
        return dict.fromkeys((AMPLITUDE, ARRIVAL, DURATION), (nan, nan))
    edge_s = rising_crossing(time_s, gauge.smooth_N, LEVEL * first.value, first)
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
