"""Signals of gauges; peaks, level crossings and integrals of a signal between its samples; shapes of pulses.

A gauge in a bead shows the mean of its two contact forces, the wall's gauge the force on the wall, both behind the
electronics of the scene.

Values between samples are taken from an interpolating quintic spline through the neighbouring samples: for a pulse of
width w sampled every h the error is of order (h/w)^6.
"""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from functools import lru_cache
from math import factorial, nan
from typing import TYPE_CHECKING

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from drivers.chain.case import Layout
from drivers.chain.chain import Array
from drivers.chain.trace import Trace

if TYPE_CHECKING:
    from scipy.interpolate import BSpline

PROMINENCE = 0.05  # of the signal's range: lower bumps are no peaks
NOISE = 1e-4  # of the signal's range: a hundred times the rounding error of forces at rest
OWN_PROMINENCE = 0.01  # of a pulse, relative to its height: pulses of a train overlap
WAKE = 0.05  # of the largest earlier pulse: lower maxima belong to its wake
ONSET = 0.02  # share of the peak at which a pulse begins
REFINEMENT = 100  # points per sample where the fit and the end of a pulse are searched
REACH = 8  # samples on either side of a local spline
POINTS = 6  # samples of the polynomial that is integrated over an interval
SHARE_TOLERANCE = 1e-14  # of the interval between two samples


@dataclass(frozen=True)
class Peak:
    """Maximum of a signal; ``sample`` is the index of the largest sample."""

    time_s: float
    value: float
    sample: int


NO_PEAK = Peak(nan, nan, 0)


def peaks(time_s: Array, values: Array, prominence: float = PROMINENCE) -> list[Peak]:
    """Maxima with at least this prominence, as a share of the signal's range, by time; samples are equally spaced."""
    return [_peak_at(time_s, values, place) for place, _ in _maxima(values, prominence)]


def pulses(time_s: Array, values: Array, rounding: float) -> Iterator[Peak]:
    """Maxima above 0 without noise, ripple and the wakes of earlier pulses, by time.

    There are none in a signal whose range is at most ``rounding``.
    """
    largest = 0.0
    for place, prominence in _maxima(values, NOISE, rounding):
        if prominence >= OWN_PROMINENCE * values[place]:  # a peak is at least as high as its sample
            peak = _peak_at(time_s, values, place)
            if peak.value > WAKE * largest and prominence >= OWN_PROMINENCE * peak.value:
                yield peak
                largest = max(largest, peak.value)


def first_peak(time_s: Array, values: Array, missing: str = "") -> Peak:
    """The first of ``peaks``; if there is none, a peak of NaN, or with a text ``missing`` a ValueError with it."""
    peak = next((_peak_at(time_s, values, place) for place, _ in _maxima(values, PROMINENCE)), NO_PEAK)
    if missing and peak is NO_PEAK:
        raise ValueError(missing)
    return peak


def _maxima(values: Array, prominence: float, rounding: float = 0.0) -> Iterator[tuple[int, float]]:
    """Indices of the largest samples of maxima, each with its prominence, at least this share of the signal's range."""
    span = float(np.ptp(values))
    if span > rounding and len(values) >= 3:
        from scipy.signal import find_peaks

        places, properties = find_peaks(values, prominence=prominence * span)
        yield from zip(map(int, places), map(float, properties["prominences"]), strict=True)


def _peak_at(time_s: Array, values: Array, place: int) -> Peak:
    """Maximum around the largest sample: that sample, or the place on either side where the slope falls through 0."""
    candidates = [(float(values[place]), float(time_s[place]))]
    for start in range(max(place - 1, 0), min(place + 1, len(values) - 1)):
        curve = _local_curve(values, place, start)
        slope = [(len(curve) - 1 - index) * coefficient for index, coefficient in enumerate(curve[:-1])]
        if _at(0.0, slope) > 0 > _at(1.0, slope):
            share = _root(slope)
            candidates.append((_at(share, curve), float(time_s[start]) + share * _spacing(time_s)))
    value, time = max(candidates)
    return Peak(time, value, place)


def rising_crossing(time_s: Array, values: Array, level: float, before: Peak) -> float:
    """Last time before a peak at which the signal rises through ``level``; NaN if it never does."""
    below = np.flatnonzero(values[: before.sample + 1] < level)
    if not below.size or below[-1] >= before.sample:
        return float("nan")
    start = int(below[-1])
    *upper, constant = _local_curve(values, start, start)
    curve = [*upper, constant - level]
    share = (level - values[start]) / (values[start + 1] - values[start])
    if _at(0.0, curve) < 0 < _at(1.0, curve):
        share = _root(curve)
    return float(time_s[start] + share * _spacing(time_s))


def _spacing(time_s: Array) -> float:
    return float(time_s[-1] - time_s[0]) / max(len(time_s) - 1, 1)


def _local_curve(values: Array, place: int, start: int) -> list[float]:
    """Spline around a sample, in the interval from sample ``start`` to the next: coefficients, highest power first.

    Powers are those of the share of the interval. Samples are equally spaced, so coefficients are linear in the values.
    """
    first = max(place - REACH, 0)
    samples = values[first : place + REACH + 1]
    coefficients: list[float] = (_spline_of_units(len(samples))[:, start - first] @ samples).tolist()
    return coefficients


def _at(share: float, curve: Iterable[float]) -> float:
    """Value of a polynomial, by Horner's method: numpy's takes ten times as long for one number."""
    value = 0.0
    for coefficient in curve:
        value = value * share + coefficient
    return value


def _root(curve: list[float]) -> float:
    """Share of the interval at which a polynomial with values of both signs at its ends is zero."""
    from scipy.optimize import brentq

    return float(brentq(_at, 0.0, 1.0, args=(curve,), xtol=SHARE_TOLERANCE))


def spline(time_s: Array, values: Array, degree: int = 5) -> "BSpline":
    """Interpolating spline through the samples of one or more signals. Shape of values (samples, ...)."""
    from scipy.interpolate import make_interp_spline

    return make_interp_spline(time_s, values, k=degree)


@lru_cache(maxsize=64)
def _spline_of_units(count: int) -> Array:
    """Splines through 0 ... 1 ... 0 on samples at distance 1: Taylor coefficients at each sample, highest power first.

    Shape (powers, intervals, values).
    """
    degree = min(5, count - 1)
    degree -= 1 - degree % 2  # splines of odd degree
    times = np.arange(count, dtype=float)
    splines = spline(times, np.eye(count), degree)
    return np.stack([splines(times[:-1], nu=power) / factorial(power) for power in range(degree, -1, -1)])


def integral(time_s: Array, values: Array) -> Array:
    """Running integral from time 0, exact for quintics: the polynomial through six samples gives each interval."""
    steps = _over_intervals(values, 1 / np.arange(1.0, POINTS + 1))
    return np.asarray(np.concatenate([[0.0], np.cumsum(steps)]) * _spacing(time_s))


def _over_intervals(values: Array, integrals: Array) -> Array:
    """Integral over each interval, of the polynomial through the samples around it. Shape (samples - 1,).

    Args:
        values: Shape (samples,).
        integrals: Those of the powers of the share of an interval, from 0 to 1, by rising power. Shape (``POINTS``,).
    """
    points = min(POINTS, len(values))
    if points < 2:
        return np.zeros(0)
    powers, windows, middle = np.arange(float(points)), sliding_window_view(values, points), (points - 2) // 2
    inverses = (np.linalg.inv(np.vander(powers - interval, increasing=True)) for interval in range(points - 1))
    weights = np.stack([integrals[:points] @ inverse for inverse in inverses])  # a row for each interval of a window
    ends = weights[:middle] @ windows[0], weights[middle + 1 :] @ windows[-1]  # elsewhere the middle one is used
    return np.concatenate([ends[0], windows @ weights[middle], ends[1]])


def incident_pulse(time_s: Array, signal: Array, onset_share: float = ONSET) -> dict[str, float]:
    """Shape of the first pulse of a signal; empty without a later maximum. The largest later one is the reflected wave.

    ``rise_s`` is the time from the onset to the first maximum. ``decay_per_s`` is the rate of the exponential from
    there to half of it; NaN if the pulse never falls to half. ``duration_s`` is the time until the pulse first falls
    below the onset level; NaN if the reflected wave comes first.

    Args:
        time_s: Sample times. Shape (samples,).
        signal: Signal above its value at rest. Shape (samples,).
        onset_share: Share of the first maximum at which the pulse begins and ends.
    """
    maxima = peaks(time_s, signal)
    if len(maxima) < 2:
        return {}
    first, reflected = maxima[0], max(maxima[1:], key=lambda peak: peak.value)
    onset = rising_crossing(time_s, signal, onset_share * first.value, first)
    after = np.linspace(first.time_s, reflected.time_s, REFINEMENT * (reflected.sample - first.sample))
    falling = np.asarray(spline(time_s, signal)(after))
    half = int(np.argmax(falling < first.value / 2))
    rate = np.polyfit(after[:half], np.log(falling[:half]), 1)[0] if half > 1 else np.nan
    quiet = falling < onset_share * first.value
    end = float(after[np.argmax(quiet)]) if quiet.any() else np.nan
    return {"rise_s": first.time_s - onset, "decay_per_s": float(rate), "duration_s": end - onset}


def mean_forces(force_N: Array) -> Array:
    """Mean contact force ``(F_j + F_{j+1}) / 2`` of every body, as a sensor bead shows it (the paper's Eq. 5).

    Shape (..., bodies), as ``force_N``; contact j is under body j, and there is none above the last body.
    """
    mean = force_N / 2
    mean[..., :-1] += force_N[..., 1:] / 2
    return mean


def sensor_average(force_N: Array, from_wall: int) -> Array:
    """Signal of a sensor bead, counted from the wall, from forces of shape (samples, contacts). Shape (samples,)."""
    return mean_forces(force_N[:, from_wall - 1 : from_wall + 1])[:, 0]


def gauges_of(layout: Layout) -> list[str]:
    """Names of all gauges in the order in which a wave meets them: ``bead_9``, ``bead_5``, ..., and ``wall``."""
    return [f"bead_{sensor.from_wall}" for sensor in layout.sensors] + ["wall"] * layout.wall


def sensor_signals(layout: Layout, trace: Trace) -> dict[str, Array]:
    """Signals of all gauges by name: ``bead_9``, ``bead_5``, ..., and ``wall``. Each of shape (samples,)."""
    shown = [*(sensor_average(trace.force_N, bead.from_wall) for bead in layout.sensors), trace.force_N[:, 0]]
    signals = dict(zip(gauges_of(layout), shown, strict=False))
    if layout.time_constant_s is None:
        return signals
    return {name: high_passed(trace.time_s, signal, layout.time_constant_s) for name, signal in signals.items()}


def signals_csv(layout: Layout, trace: Trace) -> bytes:
    """Gauge signals as CSV, in full precision; written here, since pandas takes a third of a run to import."""
    signals = {"time": trace.time_s} | sensor_signals(layout, trace)
    rows = np.column_stack([*signals.values()]).tolist()
    names = ["time_s", *(f"{name}_N" for name in [*signals][1:])]
    return "".join(f"{','.join(row)}\n" for row in (names, *(map(repr, row) for row in rows))).encode()


def high_passed(time_s: Array, signal: Array, time_constant_s: float) -> Array:
    """Signal behind a high-pass with this time constant, for an input constant before time 0. Shape (samples,).

    The charge of a piezo gauge leaks away through its amplifier, ``y' + y/tau = x'``, with the force x, the signal y
    and tau the product of resistance and capacitance (Horowitz & Hill, The Art of Electronics, 1.7.8). The static load
    has acted for long before time 0, so y(0) = 0 and y follows from the change u = x - x(0):

        y = u - z,   z' = (u - z) / tau,   z(0) = 0.

    For a polynomial u, z is known exactly over one sample interval h. With r = h/tau and the time s in units of h,

        z(t + h) = exp(-r) z(t) + r int_0^1 exp(-r (1 - s)) u(t + s h) ds.

    Here u is the polynomial through six samples around the interval, as for peaks and impulses. For a pulse of width w
    the error is of order (h/w)^6.

    A time constant far above the duration leaves the change since time 0; one far below the sample interval leaves
    ``tau x'``, which is almost zero.
    """
    from scipy.signal import lfilter
    from scipy.special import hyp1f1

    change = signal - signal[0]
    ratio, powers = _spacing(time_s) / time_constant_s, np.arange(POINTS)
    fed = _over_intervals(change, ratio * hyp1f1(1.0, powers + 2, -ratio) / (powers + 1))  # DLMF 13.4.1
    return np.asarray(change - lfilter([1.0], [1.0, -np.exp(-ratio)], np.append(0.0, fed)))
