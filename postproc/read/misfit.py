"""Measured quantities with their standard errors, compared with the computed ones.

A measured pulse is read from a quintic regression spline through its readings, a low-pass that is linear in the
readings. Knots are placed after equal numbers of readings. Their number minimises the generalised cross-validation

    n RSS / (n - p)^2,

with n readings and p coefficients (Wahba, Spline Models for Observational Data, 4.3), and is then multiplied by
``KNOT_FACTOR``. Peaks and crossings are found on the run's clock as for a computed trace (``postproc.read.signals``).
Their standard errors are the spreads over ``DRAWS`` draws of the spline with the white noise of the quiet readings and
errors of the baseline added. Errors of the gain and of a fitted trigger are independent and added in quadrature.
Quantities are named as in ``postproc.read.observables``; all forces are above rest.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import hypot, nan
from pathlib import Path

import numpy as np
from scipy.interpolate import BSpline, make_lsq_spline

from drivers.chain.case import Layout
from drivers.chain.chain import Array
from drivers.chain.trace import Trace
from drivers.scene.model import MeasuredEntry
from postproc.read.alignment import AlignedGauge, align, check_length
from postproc.read.measured import read_measured, read_quoted
from postproc.read.observables import LEVELS, observe
from postproc.read.sensors import gauges_of
from postproc.read.signals import Peak, peaks, rising_crossing

LEVEL = LEVELS[1]  # share of the peak at which the duration is cut
DRAWS, SEED = 200, 1
NOISE_FACTOR = 8.0  # prominence of a pulse, over the noise of the spline
MIN_PROMINENCE = 0.005  # of a pulse, as a share of the signal's range
DEGREE = 5
KNOT_FACTOR = 1.5  # more knots than the minimum asks for, so that smoothing errors are small compared with the noise
KNOT_RATIO = 1.25  # of the numbers of knots of consecutive trials
MIN_DRAWS_SHARE = 0.9  # share of the draws that must show a quantity
QUOTED = "quoted"
LEVEL_NAME = f"{100 * LEVEL:g}pct"


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
    """A gauge with its regression spline at the sample times of the run; arrays of shape (samples,)."""

    gauge: AlignedGauge
    time_s: Array
    force_N: Array
    error_N: Array  # standard error by noise and baseline
    draws_N: Array  # deviations in the draws of noise and baseline. Shape (samples, DRAWS)


@dataclass(frozen=True)
class _Pulse:
    """First pulse of a gauge, and the same in the draws of noise; arrays of shape (DRAWS,)."""

    amplitude_N: float
    arrival_s: float
    duration_s: float
    amplitudes_N: Array
    arrivals_s: Array
    durations_s: Array


def smooth(gauge: AlignedGauge, run: Trace) -> SmoothForce:
    """Regression spline of a gauge on the run's clock, over the range of its readings."""
    time_s = run.time_s[(run.time_s >= gauge.time_s[0]) & (run.time_s <= gauge.time_s[-1])]
    random = np.random.default_rng([SEED, *gauge.gauge.encode()])
    noise_N = random.normal(0.0, gauge.noise_N, (len(gauge.time_s), DRAWS))
    rest_N = np.interp(time_s, gauge.time_s, gauge.rest_error_N)[:, np.newaxis] * random.normal(0.0, 1.0, DRAWS)
    knots = _knots(gauge.time_s, gauge.force_N)
    force_N = make_lsq_spline(gauge.time_s, gauge.force_N, knots, DEGREE)(time_s)
    draws_N = make_lsq_spline(gauge.time_s, noise_N, knots, DEGREE)(time_s) + rest_N
    return SmoothForce(gauge, time_s, np.asarray(force_N), draws_N.std(axis=1), draws_N)


def _knots(time_s: Array, force_N: Array) -> Array:
    """Knots of the spline: ``KNOT_FACTOR`` times as many as minimise the generalised cross-validation."""
    readings = len(time_s)
    most = readings // 2 - DEGREE - 1
    counts = sorted({min(int(4 * KNOT_RATIO**power), most) for power in range(40)})
    scores = []
    for count in counts:
        knots = _spread_knots(time_s, count)
        curve: BSpline = make_lsq_spline(time_s, force_N, knots, DEGREE)
        squares = float(np.sum((force_N - curve(time_s)) ** 2))
        scores.append(squares / (readings - count - DEGREE - 1) ** 2)
    return _spread_knots(time_s, min(round(KNOT_FACTOR * counts[int(np.argmin(scores))]), most))


def _spread_knots(time_s: Array, count: int) -> Array:
    """Knots at both ends and ``count`` inner knots, each after an equal number of readings."""
    inner = time_s[np.linspace(0, len(time_s) - 1, count + 2).round().astype(int)[1:-1]]
    return np.concatenate([[time_s[0]] * (DEGREE + 1), inner, [time_s[-1]] * (DEGREE + 1)])


def lay_over(
    entries: Mapping[str, MeasuredEntry], folder: Path, where: str, layout: Layout, run: Trace
) -> tuple[list[SmoothForce], list[Misfit]]:
    """Measured gauges on a run's clock in the order of the scene, and all misfits.

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
    traces = [read_measured(entry, folder, gauges, where, key) for key, entry in entries.items() if entry.file]
    quoted = {
        name: value
        for key, entry in entries.items()
        if entry.values
        for name, value in read_quoted(entry, names, where, key).items()
    }
    aligned = align(traces, layout, run)
    triggers = {each.file: each.trigger_s for each in aligned}
    for trace in traces:
        check_length(trace, triggers[trace.file], float(run.time_s[-1]))
    curves = [smooth(gauge, run) for gauge in aligned]
    return curves, misfits(curves, layout, run, quoted)


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
    for file in dict.fromkeys(curve.gauge.file for curve in curves):
        own = {curve.gauge.gauge: curve for curve in curves if curve.gauge.file == file}
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


def _of_pulse(gauge: AlignedGauge, pulse: _Pulse, computed: Mapping[str, float]) -> list[Misfit]:
    amplitude, arrival, duration = (
        f"{gauge.gauge}_{ending}" for ending in ("amplitude_N", "arrival_s", f"duration_{LEVEL_NAME}_s")
    )
    gain = gauge.gain_uncertainty * abs(pulse.amplitude_N)
    late = hypot(_spread(pulse.arrivals_s), gauge.trigger_error_s)
    source = gauge.file.name
    return [
        Misfit(amplitude, source, pulse.amplitude_N, _spread(pulse.amplitudes_N), gain, computed[amplitude]),
        Misfit(arrival, source, pulse.arrival_s, late, 0.0, computed[arrival]),
        Misfit(duration, source, pulse.duration_s, _spread(pulse.durations_s), 0.0, computed[duration]),
    ]


def _of_all_readings(gauge: AlignedGauge, values: Mapping[str, float]) -> list[Misfit]:
    """Impulse by the trapezoidal rule, correlation, root mean square of the residual, and baseline."""
    weights = np.zeros(len(gauge.time_s))
    weights[1:] += np.diff(gauge.time_s) / 2
    weights[:-1] += np.diff(gauge.time_s) / 2
    measured, computed = float(weights @ gauge.force_N), float(weights @ gauge.computed_N)
    noise = hypot(gauge.noise_N * float(np.linalg.norm(weights)), float(weights @ gauge.rest_error_N))
    name, source = gauge.gauge, gauge.file.name
    peak_N = values[f"{name}_amplitude_N"]
    rms_N = float(np.sqrt(np.mean((gauge.force_N - gauge.computed_N) ** 2)))
    correlation = float(np.corrcoef(gauge.force_N, gauge.computed_N)[0, 1])
    return [
        Misfit(f"{name}_impulse_N_s", source, measured, noise, gauge.gain_uncertainty * abs(measured), computed),
        Misfit(f"{name}_correlation", source, correlation, nan, 0.0, nan),
        Misfit(f"{name}_residual_rms_N", source, rms_N, gauge.noise_N, 0.0, nan),
        Misfit(f"{name}_residual_rms_share", source, rms_N / peak_N, gauge.noise_N / peak_N, 0.0, nan),
        Misfit(f"{name}_baseline_{gauge.unit}", source, gauge.baseline, gauge.baseline_error, 0.0, nan),
    ]


def _pulse(curve: SmoothForce, duration_s: float) -> _Pulse:
    """First pulse of a smoothed gauge; NaN for quantities that it does not show.

    Args:
        curve: Smoothed gauge.
        duration_s: Duration of the computed pulse, the window in which draws are evaluated.
    """
    time_s, force_N = curve.time_s, curve.force_N
    span_N = float(np.ptp(force_N))
    prominence = max(NOISE_FACTOR * float(np.median(curve.error_N)) / span_N, MIN_PROMINENCE) if span_N else 1.0
    first = next((peak for peak in peaks(time_s, force_N, min(prominence, 1.0)) if peak.value > 0), None)
    if first is None:
        nothing = np.full(DRAWS, nan)
        return _Pulse(nan, nan, nan, nothing, nothing, nothing)
    if not duration_s > 0:
        duration_s = first.time_s - float(time_s[0])
    around = (time_s > first.time_s - 1.5 * duration_s) & (time_s < first.time_s + duration_s / 4)
    read = [_read(time_s[around], (force_N + draw)[around]) for draw in curve.draws_N.T]
    amplitudes, arrivals, durations = np.array(read).T
    edge_s = rising_crossing(time_s, force_N, LEVEL * first.value, first)
    return _Pulse(first.value, first.time_s, 2 * (first.time_s - edge_s), amplitudes, arrivals, durations)


def _read(time_s: Array, force_N: Array) -> tuple[float, float, float]:
    """Amplitude, arrival and duration of the largest maximum."""
    found: Peak | None = max(peaks(time_s, force_N), key=lambda peak: peak.value, default=None)
    if found is None:
        return nan, nan, nan
    edge_s = rising_crossing(time_s, force_N, LEVEL * found.value, found)
    return found.value, found.time_s, 2 * (found.time_s - edge_s)


def _spread(draws: Array) -> float:
    """Standard deviation of draws; NaN if too few show the quantity."""
    shown = draws[np.isfinite(draws)]
    return float(shown.std()) if len(shown) > MIN_DRAWS_SHARE * DRAWS else nan


def _speeds(layout: Layout, pulses: Mapping[str, _Pulse], source: str, computed: Mapping[str, float]) -> list[Misfit]:
    """Peak-to-peak speeds between neighbouring sensors that are both in the file."""
    found = []
    for upper, lower in zip(layout.sensors[:-1], layout.sensors[1:], strict=True):
        first, second = (pulses.get(f"bead_{sensor.from_wall}") for sensor in (upper, lower))
        if first is None or second is None:
            continue
        path_m = upper.height_m - lower.height_m
        travel_s = second.arrival_s - first.arrival_s
        name = f"speed_{upper.from_wall}_to_{lower.from_wall}_m_s"
        speed = path_m / travel_s if travel_s > 0 else nan
        found.append(
            Misfit(name, source, speed, _spread(path_m / (second.arrivals_s - first.arrivals_s)), 0.0, computed[name])
        )
    return found
