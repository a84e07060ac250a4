"""What the electronics behind a gauge make of its force: a first-order high-pass.

A piezo gauge with its amplifier is a charge that leaks away, ``y' + y/tau = x'``, with x the force, y what is shown and
tau the time constant, resistance times capacitance (Horowitz & Hill, The Art of Electronics, 1.7.8). Before time 0 the
gauge has stood under the static load for long: y(0) = 0. So y is what is left of the change u = x - x(0):

    y = u - z,   z' = (u - z) / tau,   z(0) = 0.

Over one sample interval h, z is known exactly for any polynomial that u is: with r = h/tau and s counted in h,

    z(t + h) = exp(-r) z(t) + r int_0^1 exp(-r (1 - s)) u(t + s h) ds.

Here u is read off the polynomial through six samples around the interval, as peaks and impulses are. The error for a
pulse of width w goes with (h/w)^6.
"""

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from scipy.signal import lfilter
from scipy.special import hyp1f1

from drivers.chain.chain import Array

POINTS = 6  # samples that each interval's polynomial goes through


def high_passed(time_s: Array, signal: Array, time_constant_s: float) -> Array:
    """What a gauge of that time constant shows of a signal that has been at its first value for ever.

    A time constant far beyond the record leaves the change since time 0; one far below the sample interval leaves
    ``tau x'``, next to nothing.

    Args:
        time_s: shape (samples,), equally spaced.
        signal: shape (samples,).
        time_constant_s: above zero.

    Returns:
        Shape (samples,).
    """
    count = len(signal)
    change = signal - signal[0]
    if count < 2:
        return np.asarray(change)
    ratio = (time_s[-1] - time_s[0]) / (count - 1) / time_constant_s
    points = min(POINTS, count)
    weights = _weights(ratio, points)
    windows = sliding_window_view(change, points)
    middle = (points - 2) // 2  # the interval of a window that all but the first and last intervals take
    fed = np.concatenate([
        [0.0],
        weights[:middle] @ windows[0],
        windows @ weights[middle],
        weights[middle + 1 :] @ windows[-1],
    ])  # fmt: skip
    leaked = lfilter([1.0], [1.0, -np.exp(-ratio)], fed)
    return np.asarray(change - leaked)


def _weights(ratio: float, points: int) -> Array:
    """What each sample of a window feeds into z over each of the window's intervals. Shape (intervals, points).

    The integrals ``int_0^1 exp(-r (1 - s)) s^k ds`` are ``1F1(1; k + 2; -r) / (k + 1)`` (DLMF 13.4.1).
    """
    powers = np.arange(float(points))
    integrals = ratio * hyp1f1(1.0, powers + 2, -ratio) / (powers + 1)
    polynomials = [np.linalg.inv(np.vander(powers - interval, increasing=True)) for interval in range(points - 1)]
    return np.stack([integrals @ coefficients for coefficients in polynomials])
