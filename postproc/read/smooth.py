"""Quintic regression splines of measured readings, and the noise of a reading.

A regression spline is a low-pass that is linear in the readings. Knots are placed after equal numbers of readings.
Their number minimises the generalised cross-validation

    n RSS / (n - p)^2,

with n readings and p coefficients (Wahba, Spline Models for Observational Data, 4.3), and is then multiplied by
``KNOT_FACTOR``.
"""

import numpy as np
from scipy.interpolate import BSpline, make_lsq_spline

from drivers.chain.chain import Array

DEGREE = 5
KNOT_FACTOR = 1.5  # more knots than the minimum asks for, so that smoothing errors are small compared with the noise
KNOT_RATIO = 1.25  # of the numbers of knots of consecutive trials
MAX_KNOTS = 2_000
MAX_READINGS = 4_000  # for the noise; longer records are averaged in blocks


def block_means(values: Array, block: int) -> Array:
    """Means of consecutive blocks of readings, without an incomplete last one. Shape (readings // block,)."""
    return np.asarray(values[: len(values) // block * block].reshape(-1, block).mean(axis=1))


def rounding_of(reading: Array) -> float:
    """Standard deviation of the rounding of readings, with the smallest difference of two levels as the digit."""
    return float(np.diff(np.unique(reading)).min(initial=np.inf)) / 12**0.5 if np.ptp(reading) else 0.0


def noise_of(time_s: Array, reading: Array) -> float:
    """Standard deviation of the white noise of one reading, from the trace alone.

    It is the root of RSS / (n - p) of the regression spline, or the rounding of the readings if that is larger. For
    noise of 0.5 to 10 % of the peak its standard error is 15 % for 100 readings of waves through a chain, 6 % for 200,
    3 % for 1000 and 1 % from 4000; its bias is below 3 %. Pulses need about ten readings each.

    Args:
        time_s: Times of the readings, increasing. Shape (readings,).
        reading: Readings in any unit, which is that of the result. Shape (readings,).
    """
    block = -(-len(time_s) // MAX_READINGS)
    times_s, means = block_means(time_s, block), block_means(reading, block)
    knots = knots_of(times_s, means)
    squares = _squares(times_s, means, knots) * block / (len(times_s) - len(knots) + DEGREE + 1)
    return max(float(np.sqrt(squares)), rounding_of(reading))


def knots_of(time_s: Array, values: Array) -> Array:
    """Knots of the regression spline: ``KNOT_FACTOR`` times as many as minimise the generalised cross-validation."""
    readings = len(time_s)
    most = min(7 * readings // 10 - DEGREE - 1, MAX_KNOTS)
    counts = sorted({min(int(4 * KNOT_RATIO**power), most) for power in range(40)})
    scores = [
        _squares(time_s, values, _spread_knots(time_s, count)) / (readings - count - DEGREE - 1) ** 2
        for count in counts
    ]
    return _spread_knots(time_s, min(round(KNOT_FACTOR * counts[int(np.argmin(scores))]), most))


def _squares(time_s: Array, values: Array, knots: Array) -> float:
    """Sum of the squares of the residual of a regression spline."""
    curve: BSpline = make_lsq_spline(time_s, values, knots, DEGREE, method="norm-eq")
    return float(np.sum((values - curve(time_s)) ** 2))


def _spread_knots(time_s: Array, count: int) -> Array:
    """Knots at both ends and ``count`` inner knots, each after an equal number of readings."""
    inner = time_s[np.linspace(0, len(time_s) - 1, count + 2).round().astype(int)[1:-1]]
    return np.concatenate([[time_s[0]] * (DEGREE + 1), inner, [time_s[-1]] * (DEGREE + 1)])
