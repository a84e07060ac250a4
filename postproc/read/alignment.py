"""Measured traces on the clock of a computed run, as forces above rest with their noise.

The model of the reading y of a gauge at the time t of its file is

    gain (y(t) - b(t)) = F(t - t0) - F(0) + noise,

with the signal F of the computed gauge, the trigger t0, the baseline b (constant or a straight line) and white noise.
Baseline and noise come from quiet readings: before the impact, or while the computed gauge is below ``QUIET_SHARE`` of
its peak. Outliers are removed, since a measured pulse may come at another time than the computed one. All gauges of a
file have one trigger. If it is not given, it is the maximum of the cross-correlation with the computed signals on a
common grid, refined by least squares weighted by noise. Its standard error covers noise alone: if the shapes differ,
arrival times are only as good as the model.
"""

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import BSpline, make_interp_spline
from scipy.ndimage import maximum_filter1d, uniform_filter1d
from scipy.optimize import minimize_scalar
from scipy.signal import correlate
from scipy.stats import siegelslopes

from drivers.base import paths
from drivers.base.errors import InputError
from drivers.chain.case import Layout
from drivers.chain.chain import Array
from drivers.chain.trace import Trace
from postproc.read.measured import MIN_SAMPLES, NORMAL, MeasuredTrace
from postproc.read.sensors import sensor_signals

QUIET_SHARE = 0.01  # of the computed peak: below it a gauge is quiet
MIN_QUIET = 8  # readings for a baseline
CLIP = 4.0  # standard deviations from the baseline: readings and running means beyond are outliers
MAX_MEANS = 200  # block means of quiet readings for the first straight line
MAX_ROUNDS = 30  # of removing outliers
REACH = 2  # pulse widths around an outlier that are removed with it
PASSES = 3  # alternating fits of baseline and trigger
LENGTH_RANGE = 0.75, 1.5  # of a record after the impact, relative to the run
SEARCH_STEPS = 20  # grid steps around the best correlation, for the least squares

Mask = NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class AlignedGauge:
    """One gauge of a file on the clock of a run; forces are above rest.

    Readings closer together than half a sample interval of the run are averaged in blocks.

    Attributes:
        time_s: Times since the impact of the readings within the run. Shape (readings,).
        force_N: Readings as forces, baseline subtracted and gain applied. Shape (readings,).
        computed_N: Force of the run at these times. Shape (readings,).
        noise_N: Standard deviation of one of these readings.
        rest_error_N: Standard error of the baseline at each reading. Shape (readings,).
        gain_uncertainty: Relative standard error common to all forces.
        baseline: Reading at rest at time 0, in ``unit``; ``baseline_error``: its standard error.
        trigger_s: Time of the impact in the file; ``trigger_error_s``: its standard error, 0 if the trigger is given.
    """

    file: Path
    gauge: str
    time_s: Array
    force_N: Array
    computed_N: Array
    noise_N: float
    rest_error_N: Array
    gain_uncertainty: float
    unit: str
    baseline: float
    baseline_error: float
    trigger_s: float
    trigger_error_s: float


@dataclass(frozen=True, eq=False)
class _Channel:
    """A gauge of a file, averaged in blocks."""

    trace: MeasuredTrace
    gauge: str
    time_s: Array
    reading: Array
    noise: float | None  # standard deviation of a block
    resolution: float  # rounding error of a block
    width_s: float  # width of the computed pulse at half of its peak
    curve: BSpline  # computed change of the force


@dataclass(frozen=True, eq=False)
class _Rest:
    """Baseline, its standard error and the noise around it; arrays of shape (readings,)."""

    level: Array
    error: Array
    noise: float


def align(traces: Sequence[MeasuredTrace], layout: Layout, run: Trace) -> list[AlignedGauge]:
    """All gauges of all files on the clock of a run; the gauges of a file share one trigger.

    Args:
        traces: Measured traces of gauges of the run.
        layout: Layout of the run.
        run: Computed trace.

    Raises:
        InputError: A record has too few readings within the run, ends before the first pulse, states two triggers, or
            has too few quiet readings for a baseline that is not given.
    """
    signals = {name: signal - signal[0] for name, signal in sensor_signals(layout, run).items()}
    curves = {name: make_interp_spline(run.time_s, signal, k=5) for name, signal in signals.items()}
    step_s, end_s = float(run.time_s[1]), float(run.time_s[-1])
    files: dict[Path, list[_Channel]] = defaultdict(list)
    for trace in traces:
        for gauge in trace.reading:
            if not np.ptp(signals[gauge]):
                raise InputError(paths.shown(trace.file), gauge, "the gauge stays at rest in the run")
            width_s = _width(np.abs(signals[gauge])) * step_s
            files[trace.file.resolve()].append(_channel(trace, gauge, curves[gauge], width_s, step_s))
    return [aligned for channels in files.values() for aligned in _aligned(channels, step_s, end_s)]


def averaged(trace: MeasuredTrace, step_s: float) -> MeasuredTrace:
    """The trace averaged in blocks if it has more than two readings in a time ``step_s``; noise is scaled to match."""
    block = max(1, int(step_s / 2 / float(np.median(np.diff(trace.time_s)))))
    whole = len(trace.time_s) // block * block

    def means(values: Array) -> Array:
        return np.asarray(values[:whole].reshape(-1, block).mean(axis=1))

    reading = {gauge: means(values) for gauge, values in trace.reading.items()}
    noise = None if trace.noise is None else trace.noise / block**0.5
    return replace(trace, time_s=means(trace.time_s), reading=reading, noise=noise)


def check_length(trace: MeasuredTrace, trigger_s: float, end_s: float) -> None:
    """Refuses a record that lasts much shorter or longer after the impact than the run.

    Raises:
        InputError: The length is out of range; the usual cause is a wrong unit of time.
    """
    length_s, (lowest, highest) = float(trace.time_s[-1]) - trigger_s, LENGTH_RANGE
    if not lowest * end_s <= length_s <= highest * end_s:
        how = "found" if trace.trigger_s is None else "given"
        found = f"{max(length_s, 0.0) * 1e6:.4g} us after an impact {how} at {trigger_s * 1e6:.4g} us"
        allowed = f"{lowest:g} to {highest:g} times the run's {end_s * 1e6:.4g} us (run.duration)"
        raise InputError(paths.shown(trace.file), "time", found, allowed)


def _width(signal: Array) -> int:
    """Number of samples around the maximum of a signal at which it is above half of the maximum."""
    place, below = int(np.argmax(signal)), signal <= signal.max() / 2
    before, after = np.flatnonzero(below[:place]), np.flatnonzero(below[place:])
    return (place + int(after[0]) if after.size else len(signal)) - (int(before[-1]) if before.size else 0)


def _channel(trace: MeasuredTrace, gauge: str, curve: BSpline, width_s: float, step_s: float) -> _Channel:
    """Readings of a gauge, averaged in blocks if there are more than two in a sample interval of the run."""
    coarse, levels = averaged(trace, step_s), np.diff(np.unique(trace.reading[gauge]))
    block = len(trace.time_s) // len(coarse.time_s)
    resolution = float(levels.min()) / float(np.sqrt(12 * block))
    return _Channel(trace, gauge, coarse.time_s, coarse.reading[gauge], coarse.noise, resolution, width_s, curve)


def _aligned(channels: list[_Channel], step_s: float, end_s: float) -> list[AlignedGauge]:
    """The gauges of one file."""
    first, shown = channels[0], paths.shown(channels[0].trace.file)
    interval_s = float(np.median(np.diff(first.time_s)))
    if end_s < MIN_SAMPLES * interval_s:
        found, allowed = f"readings every {interval_s:.3g} s", f"at least {MIN_SAMPLES} in the run's {end_s:.3g} s"
        raise InputError(shown, "", found, allowed)
    given = {channel.trace.trigger_s for channel in channels} - {None}
    if len(given) > 1:
        raise InputError(shown, "", f"triggers {' and '.join(f'{each:g} s' for each in given)}", "one trigger per file")
    trigger_s, error_s = given.pop() if given else None, 0.0
    if trigger_s is None:
        rests = [_rest(c, np.ones(len(c.time_s), dtype=bool), np.zeros(len(c.time_s))) for c in channels]
        trigger_s = _correlated(channels, rests, step_s, end_s)
        for _ in range(PASSES):
            rests = [_rest(channel, *_quiet(channel, trigger_s, end_s)) for channel in channels]
            trigger_s, error_s = _refined(channels, rests, trigger_s, step_s, end_s)
    _must_overlap(channels, trigger_s, end_s)
    rests = [_rest(channel, *_quiet(channel, trigger_s, end_s)) for channel in channels]
    return [_gauge(channel, rest, trigger_s, error_s, end_s) for channel, rest in zip(channels, rests, strict=True)]


def _gauge(channel: _Channel, rest: _Rest, trigger_s: float, error_s: float, end_s: float) -> AlignedGauge:
    trace, clock_s = channel.trace, channel.time_s - trigger_s
    inside = (clock_s >= 0) & (clock_s <= end_s)
    return AlignedGauge(
        file=trace.file,
        gauge=channel.gauge,
        time_s=clock_s[inside],
        force_N=trace.gain * (channel.reading - rest.level)[inside],
        computed_N=channel.curve(clock_s[inside]),
        noise_N=abs(trace.gain) * rest.noise,
        rest_error_N=abs(trace.gain) * rest.error[inside],
        gain_uncertainty=trace.gain_uncertainty,
        unit=trace.unit,
        baseline=float(np.interp(trigger_s, channel.time_s, rest.level)),
        baseline_error=float(np.interp(trigger_s, channel.time_s, rest.error)),
        trigger_s=trigger_s,
        trigger_error_s=error_s,
    )


def _change(channel: _Channel, clock_s: Array, end_s: float, derivative: int = 0) -> Array:
    """Computed change of force, 0 before the impact and constant after the end of the run. Shape (readings,)."""
    value = channel.curve(np.clip(clock_s, 0, end_s), derivative)
    return np.where((clock_s < 0) | ((clock_s > end_s) & (derivative > 0)), 0.0, value)


def _quiet(channel: _Channel, trigger_s: float, end_s: float) -> tuple[Mask, Array]:
    """Mask of the quiet readings, and the computed reading above rest. Both of shape (readings,)."""
    clock_s = channel.time_s - trigger_s
    change = _change(channel, clock_s, end_s)
    return (np.abs(change) < QUIET_SHARE * _peak(channel, end_s)) & (clock_s <= end_s), change / channel.trace.gain


def _peak(channel: _Channel, end_s: float) -> float:
    """Largest change of the computed gauge."""
    knots = channel.curve.t
    return float(np.abs(channel.curve(knots[(knots >= 0) & (knots <= end_s)])).max())


def _rest(channel: _Channel, quiet: Mask, computed: Array) -> _Rest:
    """Baseline and noise of quiet readings by least squares, repeated without outliers until none is left.

    The small computed reading is subtracted first; its mean size counts as an error of the baseline.

    Raises:
        InputError: There are too few quiet readings.
    """
    trace, time_s, reading = channel.trace, channel.time_s, channel.reading - computed
    if quiet.sum() < MIN_QUIET and (trace.baseline is None or channel.noise is None):
        few = f"{int(quiet.sum())} quiet readings of {channel.gauge}"
        allowed = f"at least {MIN_QUIET} before the pulse, or baseline and noise in the scene"
        raise InputError(paths.shown(trace.file), "", few, allowed)
    powers = 1 + (trace.drift and trace.baseline is None)
    design = np.vander((time_s - time_s.mean()) / float(np.ptp(time_s)), powers, increasing=True)
    width = max(2, round(channel.width_s / float(np.median(np.diff(time_s)))))
    level, kept = _first_level(trace, time_s, reading, quiet), quiet
    for _ in range(MAX_ROUNDS):
        off = reading - level
        running, deviation = uniform_filter1d(off, width // 2), _deviation(off, kept, channel.resolution)
        pulse = np.abs(running) > CLIP * _deviation(running, kept, deviation / float(np.sqrt(width // 2)))
        now = quiet & (np.abs(off) <= CLIP * deviation) & ~maximum_filter1d(pulse, 2 * REACH * width + 1)
        if now.sum() < max(MIN_QUIET, kept.sum() / 3):  # too few remain for a baseline
            break
        settled, kept = np.array_equal(now, kept), now
        if trace.baseline is None:
            level = design @ np.linalg.lstsq(design[kept], reading[kept], rcond=None)[0]
        if settled:
            break
    samples = int(kept.sum())
    found = float(np.sqrt(np.sum((reading - level)[kept] ** 2) / max(samples - powers, 1)))
    noise = channel.noise if channel.noise is not None else max(found, channel.resolution)
    error = np.zeros(len(time_s))
    if trace.baseline is None and samples > powers:
        inverse = np.linalg.inv(design[kept].T @ design[kept])
        error = noise * np.sqrt(np.einsum("ij,jk,ik->i", design, inverse, design))
        error = np.hypot(error, float(np.abs(computed[kept]).mean()))
    return _Rest(level, error, noise)


def _first_level(trace: MeasuredTrace, time_s: Array, reading: Array, quiet: Mask) -> Array:
    """First baseline, robust against pulses in less than half of the quiet readings. Shape (readings,)."""
    if trace.baseline is not None or not quiet.any():
        return np.full(len(time_s), trace.baseline or 0.0)
    if not trace.drift:
        return np.full(len(time_s), np.median(reading[quiet]))
    places = np.array_split(np.flatnonzero(quiet), min(MAX_MEANS, int(quiet.sum())))
    means = np.array([(time_s[place].mean(), reading[place].mean()) for place in places])
    slope, start = siegelslopes(means[:, 1], means[:, 0])
    return np.asarray(start + slope * time_s)


def _deviation(values: Array, kept: Mask, least: float) -> float:
    """Standard deviation about zero of the readings kept, from their median, which outliers do not affect."""
    return max(NORMAL * float(np.median(np.abs(values[kept]))) if kept.any() else 0.0, least)


def _correlated(channels: list[_Channel], rests: list[_Rest], step_s: float, end_s: float) -> float:
    """Trigger with the largest cross-correlation, on a grid of the run's sample interval."""
    start_s = min(float(channel.time_s[0]) for channel in channels)
    stop_s = max(float(channel.time_s[-1]) for channel in channels)
    grid_s, run_s = np.arange(start_s, stop_s + step_s / 2, step_s), np.arange(0, end_s + step_s / 2, step_s)
    total: Array | None = None
    for channel, rest in zip(channels, rests, strict=True):
        measured = np.interp(grid_s, channel.time_s, channel.trace.gain * (channel.reading - rest.level))
        weighted = _change(channel, run_s, end_s) / (channel.trace.gain * rest.noise) ** 2
        found = correlate(measured, weighted, mode="full", method="fft")
        total = found if total is None else total + found
    assert total is not None
    return start_s + (int(np.argmax(total)) - (len(run_s) - 1)) * step_s


def _refined(
    channels: list[_Channel], rests: list[_Rest], near_s: float, step_s: float, end_s: float
) -> tuple[float, float]:
    """Trigger by least squares near a first guess, with its standard error by noise.

    With the weighted sum of squares S, it is the standard error of ``S'``, ``2 sqrt(sum (F'/noise)^2)``, over ``S''``.
    """
    both = [*zip(channels, rests, strict=True)]
    forces = [(c.trace.gain * (c.reading - rest.level), abs(c.trace.gain) * rest.noise) for c, rest in both]
    compared = [c.time_s - near_s <= end_s - SEARCH_STEPS * step_s for c in channels]

    def squares(trigger_s: float) -> float:
        return sum(
            float(np.sum(((force - _change(c, c.time_s - trigger_s, end_s)) / noise)[inside] ** 2))
            for c, (force, noise), inside in zip(channels, forces, compared, strict=True)
        )

    tried = near_s + np.arange(-SEARCH_STEPS, SEARCH_STEPS + 1) * step_s
    best = float(tried[int(np.argmin([squares(float(each)) for each in tried]))])
    bounds = (best - step_s, best + step_s)
    trigger_s = float(minimize_scalar(squares, bounds=bounds, method="bounded", options={"xatol": 1e-7 * step_s}).x)
    variance, curvature = 0.0, 0.0
    for c, (force, noise), inside in zip(channels, forces, compared, strict=True):
        change, slope, bend = (_change(c, c.time_s - trigger_s, end_s, order)[inside] / noise for order in (0, 1, 2))
        variance += float(np.sum(slope**2))
        curvature += float(np.sum(slope**2 - (force[inside] / noise - change) * bend))
    return trigger_s, float(np.sqrt(variance)) / curvature if curvature > 0 else float("nan")


def _must_overlap(channels: list[_Channel], trigger_s: float, end_s: float) -> None:
    """Refuses a record with too few readings within the run, or without readings after the first computed onset."""
    for channel in channels:
        clock_s, shown = channel.time_s - trigger_s, paths.shown(channel.trace.file)
        inside = int(np.sum((clock_s >= 0) & (clock_s <= end_s)))
        spanned = f"from {clock_s[0] * 1e6:.6g} to {clock_s[-1] * 1e6:.6g} us after the trigger"
        if inside < MIN_SAMPLES:
            allowed = f"at least {MIN_SAMPLES} readings within the run, 0 to {end_s * 1e6:.6g} us"
            raise InputError(shown, "", f"{inside} readings {spanned}", allowed)
        times = np.linspace(0, end_s, 4 * len(channel.curve.t))
        risen = np.abs(channel.curve(times)) > QUIET_SHARE * _peak(channel, end_s)
        onset_s = float(times[int(np.argmax(risen))])
        if clock_s[-1] <= onset_s:
            allowed = f"readings after {onset_s * 1e6:.6g} us, when the wave reaches {channel.gauge}"
            raise InputError(shown, "", f"readings {spanned}", allowed)
