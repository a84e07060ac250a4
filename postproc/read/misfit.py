"""Measured quantities with their standard errors, compared with the computed ones.

A measured pulse is read from a regression spline through its readings (``postproc.read.smooth``). Peaks and crossings
are found on the run's clock as for a computed trace (``postproc.read.signals``). Their standard errors are the spreads
over ``DRAWS`` draws of the spline with white noise and errors of the baseline added. Errors of the gain and of a fitted
trigger are independent and added in quadrature. Quantities are named as in ``postproc.read.observables``; all forces
are above rest.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from math import hypot, log10, nan
from pathlib import Path

import numpy as np
from scipy.interpolate import make_lsq_spline
from scipy.signal import correlate

from drivers.base import paths
from drivers.chain.case import Layout
from drivers.chain.chain import Array
from drivers.chain.trace import Trace
from drivers.scene.model import MeasuredEntry
from postproc.read.alignment import AlignedGauge, align, check_length
from postproc.read.measured import FORCE, read_measured, read_quoted
from postproc.read.observables import LEVELS, observe
from postproc.read.sensors import gauges_of
from postproc.read.signals import peaks, rising_crossing
from postproc.read.smooth import DEGREE, knots_of

LEVEL = LEVELS[1]  # share of the peak at which the duration is cut
LEVEL_NAME = f"{100 * LEVEL:g}pct"
PULSE = "amplitude_N", "arrival_s", f"duration_{LEVEL_NAME}_s"
DRAWS, SEED = 200, 1
NOISE_FACTOR = 8.0  # prominence of a pulse, over the noise of the spline
MIN_PROMINENCE = 0.005  # of a pulse, as a share of the signal's range
MIN_DRAWS_SHARE = 0.9  # share of the draws that must show a quantity
QUOTED = "quoted"
SMALLER = {3: "m", 6: "u"}  # prefixes of units that are mistaken for others, by powers of ten
WITHIN = 5.0  # factor between measured and computed forces apart from such a power
INVERTED = 1.5  # smallest ratio of the negative to the positive extremum of the cross-correlation


@dataclass(frozen=True)
class Misfit:
    """A measured quantity and the computed one, in SI units; NaN if a trace does not show the quantity.

    Attributes:
        name: Name as of an observable, with its unit.
        source: Name of the file, or ``quoted``.
        noise_error, gain_error: Parts of the standard error of ``measured``.
    """

    name: str
    source: str
    measured: float
    noise_error: float
    gain_error: float
    computed: float

    @property
    def error(self) -> float:
        """Standard error of the measured value."""
        return hypot(self.noise_error, self.gain_error)

    @property
    def difference(self) -> float:
        """Measured minus computed value."""
        return self.measured - self.computed

    @property
    def errors_off(self) -> float:
        """The difference in standard errors."""
        return self.difference / self.error if self.error else nan


@dataclass(frozen=True, eq=False)
class SmoothForce:
    """A gauge with its regression spline at the sample times of the run.

    Attributes:
        time_s: Sample times of the run within the readings. Shape (samples,).
        drawn_N: Smoothed forces, first of the readings, then with draws of noise and baseline. Shape (samples,
            1 + DRAWS).
    """

    gauge: AlignedGauge
    time_s: Array
    drawn_N: Array

    @property
    def force_N(self) -> Array:
        """Smoothed force. Shape (samples,)."""
        return self.drawn_N[:, 0]

    @property
    def error_N(self) -> Array:
        """Standard error by noise and baseline. Shape (samples,)."""
        return np.asarray(self.drawn_N[:, 1:].std(axis=1))


def smooth(gauge: AlignedGauge, run: Trace) -> SmoothForce:
    """Regression spline of a gauge on the run's clock, over the range of its readings."""
    time_s = run.time_s[(run.time_s >= gauge.time_s[0]) & (run.time_s <= gauge.time_s[-1])]
    random = np.random.default_rng([SEED, *gauge.gauge.encode()])
    force_N = np.tile(gauge.force_N[:, np.newaxis], 1 + DRAWS)
    force_N[:, 1:] += random.normal(0.0, gauge.noise_N, (len(gauge.time_s), DRAWS))
    drawn_N = make_lsq_spline(gauge.time_s, force_N, knots_of(gauge.time_s, gauge.force_N), DEGREE)(time_s)
    drawn_N[:, 1:] += np.outer(np.interp(time_s, gauge.time_s, gauge.rest_error_N), random.normal(0.0, 1.0, DRAWS))
    return SmoothForce(gauge, time_s, drawn_N)


def lay_over(
    entries: Mapping[str, MeasuredEntry], folder: Path, where: str, layout: Layout, run: Trace
) -> tuple[list[SmoothForce], list[Misfit], list[str]]:
    """Measured gauges on a run's clock in the order of the scene, all misfits, and remarks on data that hardly fit.

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
    traces = {key: read_measured(each, folder, gauges, where, key) for key, each in entries.items() if each.file}
    quoted = dict(pair for key, each in entries.items() for pair in read_quoted(each, names, where, key).items())
    curves = [smooth(gauge, run) for gauge in align(list(traces.values()), layout, run)]
    remarks = []
    for key, trace in traces.items():
        own = [curve for curve in curves if curve.gauge.trace is trace]
        onsets_s = {curve.gauge.gauge: curve.gauge.onset_s for curve in own}
        remarks.append(check_length(trace, own[0].gauge.trigger_s, float(run.time_s[-1]), onsets_s))
        on_gain = {curve.gauge.gauge: gain_remark(curve, key) for curve in own}
        for words in filter(None, dict.fromkeys(on_gain.values())):
            named = ", ".join(gauge for gauge in on_gain if on_gain[gauge] == words)
            remarks.append(f"{paths.shown(trace.file)}: {named}: {words}")
    return curves, misfits(curves, layout, run, quoted), [*dict.fromkeys(filter(None, remarks))]


def gain_remark(curve: SmoothForce, key: str) -> str:
    """Sentence on a gain with a wrong sign or a wrong power of ten, with a gain that fits; empty otherwise.

    Args:
        curve: Smoothed gauge.
        key: Key of its entry in the scene, such as ``measured.0``.
    """
    gauge, trace = curve.gauge, curve.gauge.trace
    pair = curve.force_N, np.interp(curve.time_s, gauge.time_s, gauge.computed_N)
    measured_N, computed_N = (force_N - np.median(force_N) for force_N in pair)
    largest_N, expected_N = (float(np.abs(force_N).max()) for force_N in (measured_N, computed_N))
    if gauge.time_s[-1] <= gauge.onset_s or largest_N <= NOISE_FACTOR * np.median(curve.error_N):
        return ""  # no wave to judge by
    both = correlate(measured_N, computed_N, method="fft")
    sign, power = -1 if -both.min() > INVERTED * both.max() else 1, 3 * round(log10(largest_N / expected_N) / 3)
    if abs(power) not in SMALLER or not 1 / WITHIN < largest_N / expected_N / 10.0**power < WITHIN:
        power = 0
    found = ["readings are inverted"] * (sign < 0)
    if power:
        units = (SMALLER[abs(power)] + trace.unit, trace.unit)[:: 1 if power > 0 else -1]
        found.append(f"readings are about {10.0**power:g} times the computed force ({' read as '.join(units)}?)")
    if not found:
        return ""
    fit = f"{sign * trace.gain / 10.0**power:g}"
    stated = fit if trace.unit == FORCE else f'"{fit} N/{trace.unit}"'
    return f"{' and '.join(found)}: {key}.gain = {stated} fits"


def misfits(
    curves: Sequence[SmoothForce], layout: Layout, run: Trace, quoted: Mapping[str, tuple[float, float]] | None = None
) -> list[Misfit]:
    """All measured quantities with those of a run, then the quoted ones.

    For each gauge: amplitude, arrival and duration of the first pulse; impulse of all readings within the run, their
    correlation with the computed force, the root mean square of the residual in N and relative to the computed
    amplitude, with the noise of a reading as its error; baseline. For each file: speeds between neighbouring gauges and
    the trigger.

    Args:
        curves: Measured gauges, aligned with the run.
        layout: Layout of the run.
        run: Computed trace.
        quoted: Quoted values with their relative standard errors by observable.
    """
    computed, found = observe(layout, run, LEVELS), list[Misfit]()
    for file in dict.fromkeys(curve.gauge.trace.file for curve in curves):
        own = {curve.gauge.gauge: curve for curve in curves if curve.gauge.trace.file == file}
        durations = {name: computed[f"{name}_duration_{LEVEL_NAME}_s"] for name in own}
        pulses = {name: _pulse(curve, durations[name]) for name, curve in own.items()}
        for name, curve in own.items():
            found += [*_of_pulse(curve.gauge, pulses[name], computed), *_of_all_readings(curve.gauge, computed)]
        found += _speeds(layout, pulses, file.name, computed)
        gauge = next(iter(own.values())).gauge
        found.append(Misfit("trigger_s", file.name, gauge.trigger_s, gauge.trigger_error_s, 0.0, nan))
    found += [
        Misfit(name, QUOTED, value, abs(value) * error_share, 0.0, computed[name])
        for name, (value, error_share) in (quoted or {}).items()
    ]
    return found


def _of_pulse(gauge: AlignedGauge, pulse: Array, computed: Mapping[str, float]) -> list[Misfit]:
    """Amplitude, arrival and duration of the first pulse."""
    gain, trigger_s = gauge.trace.gain_uncertainty * abs(pulse[0, 0]), gauge.trigger_error_s
    names, source = [f"{gauge.gauge}_{ending}" for ending in PULSE], gauge.trace.file.name
    return [
        Misfit(name, source, float(values[0]), hypot(_spread(values[1:]), shift), by_gain, computed[name])
        for name, values, shift, by_gain in zip(names, pulse.T, (0, trigger_s, 0), (gain, 0, 0), strict=True)
    ]


def _of_all_readings(gauge: AlignedGauge, values: Mapping[str, float]) -> list[Misfit]:
    """Impulse by the trapezoidal rule, correlation, root mean square of the residual, and baseline."""
    weights = np.convolve(np.diff(gauge.time_s), [0.5, 0.5])
    measured, computed = float(weights @ gauge.force_N), float(weights @ gauge.computed_N)
    noise = hypot(gauge.noise_N * float(np.linalg.norm(weights)), float(weights @ gauge.rest_error_N))
    name, source = gauge.gauge, gauge.trace.file.name
    peak_N = values[f"{name}_amplitude_N"]
    rms_N = float(np.sqrt(np.mean((gauge.force_N - gauge.computed_N) ** 2)))
    correlation = float(np.corrcoef(gauge.force_N, gauge.computed_N)[0, 1])
    return [
        Misfit(f"{name}_impulse_N_s", source, measured, noise, gauge.trace.gain_uncertainty * abs(measured), computed),
        Misfit(f"{name}_correlation", source, correlation, nan, 0.0, nan),
        Misfit(f"{name}_residual_rms_N", source, rms_N, gauge.noise_N, 0.0, nan),
        Misfit(f"{name}_residual_rms_share", source, rms_N / peak_N, gauge.noise_N / peak_N, 0.0, nan),
        Misfit(f"{name}_baseline_{gauge.trace.unit}", source, gauge.baseline, gauge.baseline_error, 0.0, nan),
    ]


def _pulse(curve: SmoothForce, duration_s: float) -> Array:
    """Amplitude, arrival and duration of the first pulse in the readings and in each draw; NaN if not shown.

    Args:
        curve: Smoothed gauge.
        duration_s: Duration of the computed pulse, the window in which draws are evaluated.

    Returns:
        Values of shape (1 + DRAWS, 3).
    """
    time_s, span_N = curve.time_s, float(np.ptp(curve.force_N))
    prominence = max(NOISE_FACTOR * float(np.median(curve.error_N)) / span_N, MIN_PROMINENCE) if span_N else 1.0
    first = next((peak for peak in peaks(time_s, curve.force_N, min(prominence, 1.0)) if peak.value > 0), None)
    if first is None:
        return np.full((1 + DRAWS, 3), nan)
    if not duration_s > 0:
        duration_s = first.time_s - float(time_s[0])
    around = (time_s > first.time_s - 1.5 * duration_s) & (time_s < first.time_s + duration_s / 4)
    return np.array([_read(time_s[around], force_N) for force_N in curve.drawn_N[around].T])


def _read(time_s: Array, force_N: Array) -> tuple[float, float, float]:
    """Amplitude, arrival and duration of the largest maximum."""
    found = max(peaks(time_s, force_N), key=lambda peak: peak.value, default=None)
    if found is None:
        return nan, nan, nan
    edge_s = rising_crossing(time_s, force_N, LEVEL * found.value, found)
    return found.value, found.time_s, 2 * (found.time_s - edge_s)


def _spread(draws: Array) -> float:
    """Standard deviation of draws; NaN if too few show the quantity."""
    shown = draws[np.isfinite(draws)]
    return float(shown.std()) if len(shown) > MIN_DRAWS_SHARE * DRAWS else nan


def _speeds(layout: Layout, pulses: Mapping[str, Array], source: str, computed: Mapping[str, float]) -> list[Misfit]:
    """Peak-to-peak speeds between neighbouring sensors that are both in the file."""
    found = []
    for upper, lower in pairwise(layout.sensors):
        if {f"bead_{upper.from_wall}", f"bead_{lower.from_wall}"} <= pulses.keys():
            travel_s = pulses[f"bead_{lower.from_wall}"][:, 1] - pulses[f"bead_{upper.from_wall}"][:, 1]
            speeds = (upper.height_m - lower.height_m) / np.where(travel_s > 0, travel_s, nan)
            name = f"speed_{upper.from_wall}_to_{lower.from_wall}_m_s"
            found.append(Misfit(name, source, float(speeds[0]), _spread(speeds[1:]), 0.0, computed[name]))
    return found
