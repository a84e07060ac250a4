"""Peaks, level crossings and integrals of a sampled signal between its samples; envelopes and shapes of pulses.

Values between samples are taken from an interpolating quintic spline through the neighbouring samples: for a pulse of
width w sampled every h the error is of order (h/w)^6.
"""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from functools import lru_cache
from itertools import islice
from math import factorial, nan
from typing import TYPE_CHECKING

import numpy as np

from drivers.chain.chain import Array

if TYPE_CHECKING:
    from scipy.interpolate import BSpline

PROMINENCE = 0.05  # of the signal's range: lower bumps are no peaks
NOISE = 1e-4  # of the signal's range: a hundred times the rounding error of forces at rest
OWN_PROMINENCE = 0.01  # of a pulse, relative to its height: pulses of a train overlap
WAKE = 0.05  # of the largest earlier pulse: lower maxima belong to its wake
# integrals of Lagrange's polynomials through six samples, over their first two intervals and their middle one
FIRST_INTERVALS = np.array([[475, 1427, -798, 482, -173, 27], [-27, 637, 1022, -258, 77, -11]]) / 1440
MIDDLE_INTERVAL = np.array([11, -93, 802, 802, -93, 11]) / 1440
ONSET = 0.02  # share of the peak at which a pulse begins
MAX_INTERVAL_RATIO = 2.0  # of the longest to the shortest interval between the maxima of a train
ENVELOPE_MAXIMA = 3  # maxima of a train in its envelope, by default
REFINEMENT = 100  # points per sample where the fit and the end of a pulse are searched
REACH = 8  # samples on either side of a local spline
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


def pulses(time_s: Array, values: Array, most: int | None = None) -> list[Peak]:
    """Maxima above 0 without noise, ripple and the wakes of earlier pulses, or the first of them; by time."""
    return [*islice(_pulses(time_s, values), most)]


def _pulses(time_s: Array, values: Array) -> Iterator[Peak]:
    largest = 0.0
    for place, prominence in _maxima(values, NOISE):
        if prominence >= OWN_PROMINENCE * values[place]:  # a peak is at least as high as its sample
            peak = _peak_at(time_s, values, place)
            if peak.value > WAKE * largest and prominence >= OWN_PROMINENCE * peak.value:
                yield peak
                largest = max(largest, peak.value)


def first_peak(time_s: Array, values: Array) -> Peak | None:
    """The first of ``peaks``; None if there is none."""
    return next((_peak_at(time_s, values, place) for place, _ in _maxima(values, PROMINENCE)), None)


def peak_in(time_s: Array, values: Array, missing: str) -> Peak:
    """The first of ``peaks``; ValueError with the text ``missing`` if there is none."""
    peak = first_peak(time_s, values)
    if peak is None:
        raise ValueError(missing)
    return peak


def _maxima(values: Array, prominence: float) -> Iterator[tuple[int, float]]:
    """Indices of the largest samples of maxima, each with its prominence, at least this share of the signal's range."""
    span = float(np.ptp(values))
    if span > 0 and len(values) >= 3:
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
    return float(time_s[-1] - time_s[0]) / (len(time_s) - 1)


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
    if len(time_s) < 6:
        steps = np.diff(time_s) * (values[1:] + values[:-1]) / 2
        return np.concatenate([[0.0], np.cumsum(steps)])
    first, middle, last = FIRST_INTERVALS @ values[:6], MIDDLE_INTERVAL, FIRST_INTERVALS @ values[:-7:-1]
    steps = np.concatenate([first, np.convolve(values, middle, mode="valid"), last[::-1]])
    return np.asarray(np.concatenate([[0.0], np.cumsum(steps)]) * _spacing(time_s))


@dataclass(frozen=True)
class Envelope:
    """``amplitude_N exp(rate_per_s t)`` through maxima, by least squares of the logarithm."""

    amplitude_N: float
    rate_per_s: float


def envelope(maxima: list[Peak]) -> Envelope:
    """Exponential through at least two maxima."""
    rate, start = np.polyfit([peak.time_s for peak in maxima], np.log([peak.value for peak in maxima]), 1)
    return Envelope(float(np.exp(start)), float(rate))


def train_envelope(maxima: list[Peak], count: int = ENVELOPE_MAXIMA) -> Envelope | None:
    """Exponential through the first maxima of a train; None if there are fewer, or one is not above 0.

    Maxima of a train follow at similar intervals. If one interval is more than twice another, a maximum belongs to a
    reflection, and the result is None.
    """
    leading = maxima[:count]
    if len(leading) < count or min(peak.value for peak in leading) <= 0:
        return None
    intervals = np.diff([peak.time_s for peak in leading])
    return envelope(leading) if intervals.max() <= MAX_INTERVAL_RATIO * intervals.min() else None


@dataclass(frozen=True)
class PulseShape:
    """Shape of an incident pulse at one place."""

    rise_s: float  # from the onset to the first maximum
    decay_per_s: float  # rate of the exponential from the maximum to half of it; NaN if the pulse never falls to half
    duration_s: float  # until the pulse first falls below the onset level; NaN if the reflected wave comes first


def incident_pulse(time_s: Array, signal: Array, onset_share: float = ONSET) -> PulseShape | None:
    """Shape of the first pulse of a signal; None without a later maximum. The largest later one is the reflected wave.

    Args:
        time_s: Sample times. Shape (samples,).
        signal: Signal above its value at rest. Shape (samples,).
        onset_share: Share of the first maximum at which the pulse begins and ends.
    """
    maxima = peaks(time_s, signal)
    if len(maxima) < 2:
        return None
    first, reflected = maxima[0], max(maxima[1:], key=lambda peak: peak.value)
    onset = rising_crossing(time_s, signal, onset_share * first.value, first)
    after = np.linspace(first.time_s, reflected.time_s, REFINEMENT * (reflected.sample - first.sample))
    falling = np.asarray(spline(time_s, signal)(after))
    half = int(np.argmax(falling < first.value / 2))
    rate = np.polyfit(after[:half], np.log(falling[:half]), 1)[0] if half > 1 else np.nan
    quiet = falling < onset_share * first.value
    end = float(after[np.argmax(quiet)]) if quiet.any() else np.nan
    return PulseShape(first.time_s - onset, float(rate), end - onset)
