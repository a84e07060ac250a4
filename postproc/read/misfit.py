"""Numbers of measured pulses with their standard errors, and how far off the computed ones are.

A measured pulse is read off a quintic regression spline through its readings, a low-pass that is linear in them: the
spacing of its knots, each after so many readings, is that of the least generalised cross-validation

    n RSS / (n - p)^2,

with n readings and p coefficients (Wahba, Spline Models for Observational Data, 4.3), made finer by ``FINER``. Peaks
and crossings are then those of ``postproc.read.signals`` on the run's clock, as of a computed trace. Their standard
errors are the spreads over ``DRAWS`` of the same spline with other noise: white, and as large as that of quiet
readings. Errors of the baseline are drawn with it; those of the gain and of a trigger that was found are added, as
independent of it. Quantities are called as those of ``postproc.read.observables``; all forces are those above rest.
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
from drivers.scene.model import Measured
from postproc.read.alignment import AlignedGauge, align, must_last
from postproc.read.measured import Quoted, read_measured, read_quoted
from postproc.read.observables import LEVELS, observe
from postproc.read.sensors import gauges_of
from postproc.read.signals import Peak, peaks, rising_crossing

LEVEL = LEVELS[1]  # of the peak, at which the duration is cut
DRAWS, SEED = 200, 1
STANDS_OUT = 8.0  # times the spline's own noise, from which on a maximum is a pulse
LEAST = 0.005  # likewise, of the range
DEGREE = 5
FINER = 1.5  # times the knots of the least score: what is smoothed away is then small beside the noise
CLOSER = 1.25  # times as many knots from one trial to the next
SHOWN = 0.9  # of the draws, in which a quantity has to be seen
QUOTED = "quoted"
LEVEL_NAME = f"{100 * LEVEL:g}pct"


@dataclass(frozen=True)
class Misfit:
    """A measured quantity beside the computed one, in SI units; NaN where one of them does not show it.

    Attributes:
        name: as of an observable, with its unit.
        source: name of the file, or ``quoted``.
        noise_error, gain_error: parts of the standard error of ``measured``.
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
        """Measured less computed."""
        return self.measured - self.computed

    @property
    def errors_off(self) -> float:
        """The difference in standard errors."""
        return self.difference / self.error if self.error else nan


@dataclass(frozen=True, eq=False)
class SmoothForce:
    """A gauge with its regression spline at the run's sample times; all of shape (samples,)."""

    gauge: AlignedGauge
    time_s: Array
    force_N: Array
    error_N: Array  # by noise and baseline
    draws_N: Array  # deviations by other noise and baseline. Shape (samples, DRAWS)


@dataclass(frozen=True)
class _Pulse:
    """The first pulse of a gauge, and what other noise makes of it; those of shape (DRAWS,)."""

    amplitude_N: float
    arrival_s: float
    duration_s: float
    amplitudes_N: Array
    arrivals_s: Array
    durations_s: Array


def smooth(gauge: AlignedGauge, run: Trace) -> SmoothForce:
    """The regression spline of a gauge on the run's clock, as far as there are readings."""
    time_s = run.time_s[(run.time_s >= gauge.time_s[0]) & (run.time_s <= gauge.time_s[-1])]
    random = np.random.default_rng([SEED, *gauge.gauge.encode()])
    noise_N = random.normal(0.0, gauge.noise_N, (len(gauge.time_s), DRAWS))
    rest_N = np.interp(time_s, gauge.time_s, gauge.rest_error_N)[:, np.newaxis] * random.normal(0.0, 1.0, DRAWS)
    knots = _knots(gauge.time_s, gauge.force_N)
    force_N = make_lsq_spline(gauge.time_s, gauge.force_N, knots, DEGREE)(time_s)
    draws_N = make_lsq_spline(gauge.time_s, noise_N, knots, DEGREE)(time_s) + rest_N
    return SmoothForce(gauge, time_s, np.asarray(force_N), draws_N.std(axis=1), draws_N)


def _knots(time_s: Array, force_N: Array) -> Array:
    """Knots of the spline with ``FINER`` times those of the least generalised cross-validation."""
    readings = len(time_s)
    most = readings // 2 - DEGREE - 1
    counts = sorted({min(int(4 * CLOSER**power), most) for power in range(40)})
    scores = []
    for count in counts:
        knots = _spread_knots(time_s, count)
        curve: BSpline = make_lsq_spline(time_s, force_N, knots, DEGREE)
        squares = float(np.sum((force_N - curve(time_s)) ** 2))
        scores.append(squares / (readings - count - DEGREE - 1) ** 2)
    return _spread_knots(time_s, min(round(FINER * counts[int(np.argmin(scores))]), most))


def _spread_knots(time_s: Array, count: int) -> Array:
    """So many inner knots, each after as many readings, between those of the ends."""
    inner = time_s[np.linspace(0, len(time_s) - 1, count + 2).round().astype(int)[1:-1]]
    return np.concatenate([[time_s[0]] * (DEGREE + 1), inner, [time_s[-1]] * (DEGREE + 1)])


def lay_over(
    entries: Mapping[str, Measured], folder: Path, where: str, layout: Layout, run: Trace
) -> tuple[list[SmoothForce], list[Misfit]]:
    """Measured gauges on a run's clock in the order of the scene, and all misfits.

    Args:
        entries: by their keys in the scene, such as ``measured.0``.
        folder: from which their paths are seen.
        where: the scene as messages name it.
        layout: of the run.
        run: computed.

    Raises:
        InputError: an entry, its file or both with the run are wrong.
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
        must_last(trace, triggers[trace.file], float(run.time_s[-1]))
    curves = [smooth(gauge, run) for gauge in aligned]
    return curves, misfits(curves, layout, run, quoted)


def misfits(
    curves: Sequence[SmoothForce], layout: Layout, run: Trace, quoted: Mapping[str, Quoted] | None = None
) -> list[Misfit]:
    """All quantities of measured gauges beside those of a run, then quoted ones.

    Of each gauge: amplitude, arrival and duration of the first pulse; of all readings within the run the impulse, the
    correlation with the computed force, and the root mean square of the residual, in N and over the computed
    amplitude, with the noise of a reading as its error; the baseline. Of each file: speeds between neighbouring
    gauges, the trigger.

    Args:
        curves: measured gauges, aligned with the run.
        layout: of the run.
        run: computed.
        quoted: values by observable.
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
        Misfit(name, QUOTED, each.value, abs(each.value) * each.error_share, 0.0, computed[name])
        for name, each in (quoted or {}).items()
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
    """Impulse by the trapezoidal rule, correlation, root mean square of the residual; the baseline."""
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
    """The first pulse of a smoothed gauge; NaN of what it does not show.

    Args:
        curve: of the gauge.
        duration_s: of the computed pulse, around which draws are looked at.
    """
    time_s, force_N = curve.time_s, curve.force_N
    span_N = float(np.ptp(force_N))
    prominence = max(STANDS_OUT * float(np.median(curve.error_N)) / span_N, LEAST) if span_N else 1.0
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
    """Standard deviation of draws; NaN where too few show the quantity."""
    shown = draws[np.isfinite(draws)]
    return float(shown.std()) if len(shown) > SHOWN * DRAWS else nan


def _speeds(layout: Layout, pulses: Mapping[str, _Pulse], source: str, computed: Mapping[str, float]) -> list[Misfit]:
    """Speeds between neighbouring sensors that a file has both of, peak to peak."""
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
