"""Measured traces on the clock of a computed run, as forces above rest with their noise.

The model of the reading y of a gauge at the time t of its file is

    gain (y(t) - b(t)) = F(t - t0) - F(0) + noise,

with the signal F of the computed gauge, the trigger t0, the baseline b (constant or a straight line) and white noise.
The noise depends on the readings alone (``noise_of``). The baseline comes from quiet readings: before the
impact, or while the computed gauge is below ``QUIET_SHARE`` of its peak. Outliers are removed, since a measured pulse
may come at another time than the computed one. All gauges of a file have one trigger. If it is not given, it is the
extremum of the cross-correlation with the computed signals on a common grid, refined by least squares weighted by
noise. Its standard error covers noise alone: if the shapes differ, arrival times are only as good as the model.

A fit (``validation.calibration``) has the same trigger, gains and baselines: its trigger starts at the same correlation
and is then a parameter, and its baselines are projected out of the residual of all readings that count.

Readings are smoothed by quintic regression splines with knots after equal numbers of readings. Their number minimises
the generalised cross-validation ``n RSS / (n - p)^2``, with n readings and p coefficients (Wahba, Spline Models for
Observational Data, 4.3), and is then multiplied by ``KNOT_FACTOR``.
"""

from collections import defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from math import inf, nan, sqrt

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import BSpline, make_lsq_spline
from scipy.ndimage import maximum_filter1d, uniform_filter1d
from scipy.optimize import least_squares
from scipy.signal import correlate, peak_widths

from drivers.base import paths
from drivers.base.errors import InputError
from drivers.base.files import sha256_of
from drivers.chain.chain import Array
from postproc.read.measured import MIN_SAMPLES, NORMAL, MeasuredTrace
from postproc.read.motion import Simulation

QUIET_SHARE = 0.01  # of the computed peak: below it a gauge is quiet
MIN_QUIET = 8  # readings for a baseline
CLIP = 4.0  # standard deviations from the baseline: readings and running means beyond are outliers
ROUNDS = 5  # of removing outliers
REACH = 2  # pulse widths around an outlier that are removed with it
MAX_RATIO = 100.0  # of the lengths of record and run: beyond, the unit of time is wrong
DEGREE = 5
KNOT_FACTOR = 1.5  # more knots than the minimum asks for, so that smoothing errors are small compared with the noise
KNOT_RATIO = 1.25  # of the numbers of knots of consecutive trials
MAX_KNOTS = 2_000
MAX_READINGS = 4_000  # for the noise; longer records are averaged in blocks
SEARCH_STEPS = 20  # grid steps around the best correlation, for the least squares


@dataclass(frozen=True, eq=False)
class Channel:
    """A gauge of a file, with readings averaged in blocks if there are more than two in a sample interval of the run.

    Attributes:
        file_key: Key of the first entry of its file, whose trigger it has.
        trace: Trace as read.
        time_s, reading: Times and readings of the blocks. Shape (readings,).
        noise: Standard deviation of one of these readings.
        coefficients: Of the spline whose residual is the noise; 0 if the noise is stated, or that of rounding.
        window_s: Range of a trigger to be found.
        counts: True until the run's duration after the trigger or, if it has to be found, after the first rise in the
            file, whatever the model. Shape (readings,).
        trigger_s: Time of the impact in the file, given or at the largest correlation; ``found``: True for the latter.
    """

    file_key: str
    trace: MeasuredTrace
    gauge: str
    time_s: Array
    reading: Array
    noise: float
    coefficients: int
    window_s: tuple[float, float]
    counts: NDArray[np.bool_]
    trigger_s: float = nan
    found: bool = False

    @property
    def noise_N(self) -> float:
        """Standard deviation of a reading as a force."""
        return abs(self.trace.gain) * self.noise

    @cached_property
    def base_lines(self) -> Array:
        """Columns of the base line: none if it is given, a constant, or a constant and a slope. Shape (readings, n)."""
        share = (self.time_s - self.time_s.mean()) / float(np.ptp(self.time_s))
        return np.vander(share, (1 + self.trace.drift) * (self.trace.baseline is None), increasing=True)

    @cached_property
    def spread_s(self) -> float:
        """Standard deviation of the times of the readings in a block."""
        interval_s, block_s = (float(np.median(np.diff(time_s))) for time_s in (self.trace.time_s, self.time_s))
        return sqrt(max(block_s**2 - interval_s**2, 0.0) / 12)

    def computed(self, curve: BSpline, trigger_s: float) -> Array:
        """Mean of a computed change of force over each block: that of two points, exact for cubics. Shape (readings,).

        Without blocks it is one point.
        """
        sides = {-self.spread_s, self.spread_s}
        return np.asarray(sum(change_at(curve, self.time_s - trigger_s + side_s) for side_s in sides) / len(sides))

    @cached_property
    def basis(self) -> Array:
        """Orthonormal columns of the base line at the readings that count. Shape (readings, n)."""
        return np.asarray(np.linalg.qr(self.base_lines[self.counts])[0])


@dataclass(frozen=True, eq=False)
class AlignedGauge:
    """One gauge of a file on the clock of a run; forces are above rest.

    Readings closer together than half a sample interval of the run are averaged in blocks.

    Attributes:
        channel: The gauge with its readings, at the trigger of the comparison.
        onset_s: Time since the impact at which the computed wave reaches the gauge.
        time_s: Times since the impact of the readings within the run. Shape (readings,).
        force_N: Readings as forces, baseline subtracted and gain applied. Shape (readings,).
        computed_N: Force of the run at these times, with its mean over each block. Shape (readings,).
        rest_error_N: Standard error of the baseline at each reading. Shape (readings,).
        baseline: Reading at rest at time 0, in the unit of the trace; ``baseline_error``: its standard error.
        trigger_error_s: Standard error of the trigger, 0 if it is given.
        curve: Regression spline of the force.
        errors: Independent parts of its standard error by noise and baseline, as a spline with a value for each part.
        run_s: Sample times of the run within the readings. Shape (samples,).
        error_N: Standard error of the regression spline at these times. Shape (samples,).
    """

    channel: Channel
    onset_s: float
    time_s: Array
    force_N: Array
    computed_N: Array
    rest_error_N: Array
    baseline: float
    baseline_error: float
    trigger_error_s: float
    curve: BSpline
    errors: BSpline
    run_s: Array
    error_N: Array


def channels_of(traces: Sequence[MeasuredTrace], motion: Simulation) -> list[list[Channel]]:
    """Gauges of each file; entries of the same file, or of equal copies of it, share their trigger.

    Raises:
        InputError: A record is ``MAX_RATIO`` times longer or shorter than the run or has too few readings, or entries
            of one file state different triggers.
    """
    files, duration_s = defaultdict[str, list[MeasuredTrace]](list), float(motion.trace.time_s[-1])
    for trace in traces:
        length_s = float(trace.time_s[-1] - trace.time_s[0])
        power = 3 * round(np.log10(length_s / duration_s) / 3)
        if not 1 / MAX_RATIO <= length_s / duration_s <= MAX_RATIO:
            units = " rather than ".join(("us", "ms" if abs(power) == 3 else "s")[:: 1 if power > 0 else -1])
            allowed = f"about the run's {duration_s:.3g} s (run.duration); is the unit of time {units}?"
            raise InputError(paths.shown(trace.file), "time", f"a record of {length_s:.3g} s", allowed)
        files[sha256_of(trace.file) if trace.file.is_file() else str(trace.file)].append(trace)
    return [_of_file(of_file, motion) for of_file in files.values()]


def _of_file(traces: list[MeasuredTrace], motion: Simulation) -> list[Channel]:
    """Gauges of one file."""
    duration_s, step_s = float(motion.trace.time_s[-1]), float(motion.trace.time_s[1])
    coarse, shown = [averaged(trace, step_s) for trace in traces], paths.shown(traces[0].file)
    given = sorted({trace.trigger_s for trace in traces if trace.trigger_s is not None})
    if len(given) > 1:
        found = f"triggers {' and '.join(f'{stated_s:g} s' for stated_s in given)}"
        raise InputError(shown, "", found, "one trigger per file")
    rise_s = min(_first_rise_s(trace, gauge) for trace in coarse for gauge in trace.reading)
    end_s = (given[0] if given else rise_s) + duration_s
    channels = []
    for whole, trace in zip(traces, coarse, strict=True):
        if len(trace.time_s) < MIN_SAMPLES:
            found = f"{len(trace.time_s)} readings after averaging over half a sample interval of the run"
            raise InputError(shown, "", found, f"at least {MIN_SAMPLES}")
        for gauge, reading in trace.reading.items():
            rounding = rounding_of(whole.reading[gauge]) * (len(reading) / len(whole.time_s)) ** 0.5
            noise, coefficients = (trace.noise, 0) if trace.noise else noise_of(trace.time_s, reading, rounding)
            channel = Channel(
                file_key=traces[0].key,
                trace=whole,
                gauge=gauge,
                time_s=trace.time_s,
                reading=reading,
                noise=noise,
                coefficients=coefficients,
                window_s=(rise_s - duration_s, rise_s),
                counts=trace.time_s <= end_s,
            )
            channels.append(channel)
    if given:
        must_overlap(channels[0], given[0], duration_s)
    trigger_s = given[0] if given else correlated(channels, motion)
    return [replace(channel, trigger_s=trigger_s, found=not given) for channel in channels]


def _first_rise_s(trace: MeasuredTrace, gauge: str) -> float:
    """First time at which a gauge has reached half of its largest force."""
    force = np.sign(trace.gain) * (trace.reading[gauge] - np.median(trace.reading[gauge]))
    return float(trace.time_s[int(np.argmax(force >= force.max() / 2))])


def change_at(curve: BSpline, clock_s: Array) -> Array:
    """Computed change of force at times since the impact: 0 before it, constant after the end of the run."""
    return np.where(clock_s < 0, 0.0, curve(np.clip(clock_s, 0.0, curve.t[-1])))


def residual_of(channel: Channel, curve: BSpline, gain: float, trigger_s: float) -> Array:
    """Computed minus measured readings that count, in standard errors and without the best base line."""
    computed = channel.computed(curve, trigger_s)[channel.counts] / gain
    off = (computed - channel.reading[channel.counts] + (channel.trace.baseline or 0.0)) / channel.noise
    return np.asarray(off - channel.basis @ (channel.basis.T @ off))


def correlated(channels: Sequence[Channel], motion: Simulation) -> float:
    """Trigger with the largest cross-correlation of either sign with the computed changes of force by gauge.

    Its grid has the sample interval of the run, and the readings are without a robust base line.
    """
    start_s = min(float(channel.time_s[0]) for channel in channels)
    stop_s = max(float(channel.time_s[-1]) for channel in channels)
    run_s, step_s = motion.trace.time_s, float(motion.trace.time_s[1])
    grid_s = np.arange(start_s, stop_s + step_s / 2, step_s)
    total = np.zeros(len(grid_s) + len(run_s) - 1)
    for channel in channels:
        weighted = motion.curves[channel.gauge](run_s) / (channel.trace.gain * channel.noise**2)
        above = channel.reading - _level(channel, channel.reading, np.ones(len(channel.time_s), dtype=bool))
        total += correlate(np.interp(grid_s, channel.time_s, above), weighted, mode="full", method="fft")
    return start_s + (int(np.argmax(np.abs(total))) - (len(run_s) - 1)) * step_s


def align(traces: Sequence[MeasuredTrace], motion: Simulation) -> list[AlignedGauge]:
    """All gauges of all files on the clock of a motion; the gauges of a file share one trigger.

    Raises:
        InputError: A record is ``MAX_RATIO`` times longer or shorter than the run, has too few readings within it, ends
            before the first pulse, states two triggers, or has too few quiet readings for a baseline that is not given.
    """
    for trace in traces:
        if still := next((gauge for gauge in trace.reading if not np.ptp(motion.signals[gauge])), ""):
            raise InputError(paths.shown(trace.file), still, "the gauge stays at rest in the run")
    return [gauge for channels in channels_of(traces, motion) for gauge in _aligned(channels, motion)]


def averaged(trace: MeasuredTrace, step_s: float) -> MeasuredTrace:
    """The trace averaged in blocks if it has more than two readings in a time ``step_s``; noise is scaled to match."""
    block = max(1, int(step_s / 2 / float(np.median(np.diff(trace.time_s)))))
    reading = {gauge: block_means(values, block) for gauge, values in trace.reading.items()}
    noise = None if trace.noise is None else trace.noise / block**0.5
    return replace(trace, time_s=block_means(trace.time_s, block), reading=reading, noise=noise)


def _aligned(channels: list[Channel], motion: Simulation) -> Iterator[AlignedGauge]:
    """The gauges of one file."""
    run_s, end_s = motion.trace.time_s, float(motion.trace.time_s[-1])
    sizes_N = {channel.gauge: np.abs(motion.curves[channel.gauge](run_s)) for channel in channels}
    onsets_s = {
        gauge: float(run_s[np.argmax(size_N > QUIET_SHARE * size_N.max())]) for gauge, size_N in sizes_N.items()
    }
    trigger_s, error_s = _refined(channels, motion) if channels[0].found else (channels[0].trigger_s, 0.0)
    first = min(channels, key=lambda channel: onsets_s[channel.gauge])
    must_overlap(first, trigger_s, end_s, onsets_s[first.gauge])
    for channel in channels:
        clock_s, gain, computed = channel.time_s - trigger_s, channel.trace.gain, motion.curves[channel.gauge]
        level, error = _rest(channel, computed, sizes_N[channel.gauge], trigger_s)
        inside = (clock_s >= 0) & (clock_s <= end_s)
        time_s, force_N = clock_s[inside], gain * (channel.reading - level)[inside]
        rest_error_N = abs(gain) * error[inside]
        curve, errors = _smooth(time_s, force_N, channel.noise_N, rest_error_N)
        within_s, nodes_s = run_s[(run_s >= time_s[0]) & (run_s <= time_s[-1])], np.unique(curve.t)
        yield AlignedGauge(
            channel=replace(channel, trigger_s=trigger_s),
            onset_s=onsets_s[channel.gauge],
            time_s=time_s,
            force_N=force_N,
            computed_N=channel.computed(computed, trigger_s)[inside],
            rest_error_N=rest_error_N,
            baseline=float(np.interp(0, clock_s, level)),
            baseline_error=float(np.interp(0, clock_s, error)),
            trigger_error_s=error_s,
            curve=curve,
            errors=errors,
            run_s=within_s,
            error_N=np.interp(within_s, nodes_s, np.linalg.norm(errors(nodes_s), axis=1)),
        )


def _smooth(time_s: Array, force_N: Array, noise_N: float, rest_error_N: Array) -> tuple[BSpline, BSpline]:
    """Regression spline of a gauge, and the independent parts of its standard error."""
    knots = knots_of(time_s, force_N)
    both = np.column_stack([force_N, rest_error_N])
    force, rest = np.asarray(make_lsq_spline(time_s, both, knots, DEGREE, method="norm-eq").c.T)
    design = BSpline.design_matrix(time_s, knots, DEGREE)
    root = np.linalg.cholesky((design.T @ design).toarray())  # covariance of coefficients: noise^2 (root root^T)^-1
    errors = BSpline(knots, np.column_stack([noise_N * np.linalg.inv(root).T, rest]), DEGREE)
    return BSpline(knots, force, DEGREE), errors


def _level(channel: Channel, reading: Array, quiet: NDArray[np.bool_]) -> Array:
    """Base line of quiet readings with Cauchy's loss, which pulses change little. Shape (readings,)."""
    design = channel.base_lines
    if not design.shape[1]:
        return np.full(len(reading), channel.trace.baseline)
    scaled, target = design[quiet] / channel.noise, reading[quiet] / channel.noise

    def off(coefficients: Array) -> Array:
        return np.asarray(scaled @ coefficients - target)

    return np.asarray(design @ least_squares(off, np.linalg.lstsq(scaled, target, rcond=None)[0], loss="cauchy").x)


def _rest(channel: Channel, curve: BSpline, size_N: Array, trigger_s: float) -> tuple[Array, Array]:
    """Baseline and its standard error, by least squares of quiet readings without outliers. Both of shape (readings,).

    The small computed reading is subtracted first; its mean size counts as an error.

    Raises:
        InputError: There are too few quiet readings.
    """
    trace, time_s, design = channel.trace, channel.time_s, channel.base_lines
    if trace.baseline is not None:
        return np.full(len(time_s), trace.baseline), np.zeros(len(time_s))
    change = channel.computed(curve, trigger_s)
    computed = change / trace.gain
    quiet = (np.abs(change) < QUIET_SHARE * size_N.max()) & (time_s <= trigger_s + curve.t[-1])
    if quiet.sum() < MIN_QUIET:
        few = f"{int(quiet.sum())} quiet readings of {channel.gauge}"
        allowed = f"at least {MIN_QUIET} before the pulse, or a baseline in the scene"
        raise InputError(paths.shown(trace.file), "", few, allowed)
    reading = channel.reading - computed
    level, kept = _level(channel, reading, quiet), quiet
    samples = peak_widths(np.pad(size_N, 1), [np.argmax(size_N) + 1])[0][0]  # at half of the computed peak
    width_s = float(samples * curve.t[-1] / (len(size_N) - 1))
    width = max(2, round(width_s / float(np.median(np.diff(time_s)))))
    for _ in range(ROUNDS):
        running = np.abs(uniform_filter1d(reading - level, width // 2))
        spread = max(NORMAL * float(np.median(running[kept])), channel.noise / (width // 2) ** 0.5)
        pulse = maximum_filter1d(running > CLIP * spread, 2 * REACH * width + 1)
        now = quiet & (np.abs(reading - level) <= CLIP * channel.noise) & ~pulse
        if now.sum() < max(MIN_QUIET, kept.sum() / 3):  # too few remain for a baseline
            break
        level, kept = design @ np.linalg.lstsq(design[now], reading[now], rcond=None)[0], now
    inverse = np.linalg.inv(design[kept].T @ design[kept])
    error = channel.noise * np.sqrt(np.einsum("ij,jk,ik->i", design, inverse, design))
    return level, np.hypot(error, float(np.abs(computed[kept]).mean()))


def _refined(channels: list[Channel], motion: Simulation) -> tuple[float, float]:
    """Trigger by least squares near the largest correlation, with its standard error by noise, whatever the gains.

    The residual is that of a fit, of the readings within the run at all of these triggers.
    """
    near_s, step_s = channels[0].trigger_s, float(motion.trace.time_s[1])
    last_s = near_s + float(motion.trace.time_s[-1]) - SEARCH_STEPS * step_s
    within = [replace(channel, counts=channel.time_s <= last_s) for channel in channels]

    def off(place: Array) -> Array:
        trigger_s, parts = near_s + float(place[0]) * step_s, list[Array]()
        for each in within:
            bare, whole = (residual_of(each, motion.curves[each.gauge], gain, trigger_s) for gain in (inf, 1.0))
            shape = whole - bare
            parts.append(bare - shape * (shape @ bare) / (shape @ shape or 1.0))
        return np.concatenate(parts)

    best = least_squares(off, [0.0], "3-point", (-SEARCH_STEPS, SEARCH_STEPS), xtol=1e-9)
    slope = float(np.linalg.norm(np.asarray(best.jac)))
    return near_s + float(best.x[0]) * step_s, step_s / slope if slope else inf


def must_overlap(channel: Channel, trigger_s: float, end_s: float, onset_s: float = 0.0) -> None:
    """Refuses a record with too few readings within the run, or without readings after the first computed onset."""
    clock_s = channel.time_s - trigger_s
    inside = int(np.sum((clock_s >= 0) & (clock_s <= end_s)))
    if inside < MIN_SAMPLES or clock_s[-1] <= onset_s:
        found = f"{inside} readings from {clock_s[0] * 1e6:.6g} to {clock_s[-1] * 1e6:.6g} us after the trigger"
        wave = f"also after {onset_s * 1e6:.6g} us, when the wave reaches {channel.gauge}"
        allowed = f"at least {MIN_SAMPLES} readings within the run, 0 to {end_s * 1e6:.6g} us, {wave}"
        raise InputError(paths.shown(channel.trace.file), "", found, allowed)


def block_means(values: Array, block: int) -> Array:
    """Means of consecutive blocks of readings, without an incomplete last one. Shape (readings // block,)."""
    return np.asarray(values[: len(values) // block * block].reshape(-1, block).mean(axis=1))


def rounding_of(reading: Array) -> float:
    """Standard deviation of the rounding of readings, with the smallest difference of two levels as the digit."""
    return float(np.diff(np.unique(reading)).min(initial=np.inf)) / 12**0.5 if np.ptp(reading) else 0.0


def noise_of(time_s: Array, reading: Array, rounding: float) -> tuple[float, int]:
    """Standard deviation of the white noise of one reading, from the trace alone, and the coefficients that it takes.

    It is the root of RSS / (n - p) of the regression spline with p coefficients, or the rounding of the readings if it
    is larger, with p = 0. For noise of 0.5 to 10 % of the peak its standard error is 15 % for 100 readings of waves
    through a chain, 6 % for 200, 3 % for 1000 and 1 % from 4000; its bias is below 3 %. Pulses need about ten readings
    each.

    Args:
        time_s: Times of the readings, increasing. Shape (readings,).
        reading: Readings in any unit, which is that of the result. Shape (readings,).
        rounding: Standard deviation of the rounding of a reading.
    """
    block = -(-len(time_s) // MAX_READINGS)
    knots = knots_of(block_means(time_s, block), block_means(reading, block))
    knots[: DEGREE + 1], knots[-DEGREE - 1 :] = time_s[0], time_s[-1]
    coefficients = len(knots) - DEGREE - 1
    noise = float(np.sqrt(_squares(time_s, reading, knots) / (len(time_s) - coefficients)))
    return (noise, coefficients) if noise > rounding else (rounding, 0)


def knots_of(time_s: Array, values: Array) -> Array:
    """Knots of the regression spline: ``KNOT_FACTOR`` times as many as minimise the generalised cross-validation."""
    readings = len(time_s)
    most = min(7 * readings // 10 - DEGREE - 1, MAX_KNOTS)
    counts = sorted({min(int(4 * KNOT_RATIO**power), most) for power in range(40)})

    def score(count: int) -> float:
        return _squares(time_s, values, _spread_knots(time_s, count)) / (readings - count - DEGREE - 1) ** 2

    return _spread_knots(time_s, min(round(KNOT_FACTOR * min(counts, key=score)), most))


def _squares(time_s: Array, values: Array, knots: Array) -> float:
    """Sum of the squares of the residual of a regression spline."""
    curve: BSpline = make_lsq_spline(time_s, values, knots, DEGREE, method="norm-eq")
    return float(np.sum((values - curve(time_s)) ** 2))


def _spread_knots(time_s: Array, count: int) -> Array:
    """Knots at both ends and ``count`` inner knots, each after an equal number of readings."""
    inner = time_s[np.linspace(0, len(time_s) - 1, count + 2).round().astype(int)[1:-1]]
    return np.concatenate([[time_s[0]] * (DEGREE + 1), inner, [time_s[-1]] * (DEGREE + 1)])
