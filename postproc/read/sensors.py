"""Gauge signals: the mean of the two contact forces of a sensor bead, and the force on the wall.

If the scene gives a time constant of the electronics, the signal is filtered by a first-order high-pass. The charge of
a piezo gauge leaks away through its amplifier, ``y' + y/tau = x'``, with the force x, the signal y and tau the product
of resistance and capacitance (Horowitz & Hill, The Art of Electronics, 1.7.8). The static load has acted for long
before time 0, so y(0) = 0 and y follows from the change u = x - x(0):

    y = u - z,   z' = (u - z) / tau,   z(0) = 0.

For a polynomial u, z is known exactly over one sample interval h. With r = h/tau and the time s in units of h,

    z(t + h) = exp(-r) z(t) + r int_0^1 exp(-r (1 - s)) u(t + s h) ds.

Here u is the polynomial through six samples around the interval, as for peaks and impulses. For a pulse of width w the
error is of order (h/w)^6.
"""

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from drivers.chain.case import Layout
from drivers.chain.chain import Array
from drivers.chain.trace import Trace
from postproc.read.signals import Peak

POINTS = 6  # samples of the polynomial of an interval
BALANCED = 1e-6  # of the forces: a smaller difference of two contacts is rounding


def mean_forces(force_N: Array) -> Array:
    """Mean contact force ``(F_j + F_{j+1}) / 2`` of every body, as a sensor bead shows it (the paper's Eq. 5).

    Shape (..., bodies), as ``force_N``; contact j is under body j, and there is none above the last body.
    """
    above = np.zeros_like(force_N)
    above[..., :-1] = force_N[..., 1:]
    return np.asarray((force_N + above) / 2)


def sensor_average(force_N: Array, from_wall: int) -> Array:
    """Signal of a sensor bead, counted from the wall, from forces of shape (samples, contacts). Shape (samples,)."""
    return mean_forces(force_N[:, from_wall - 1 : from_wall + 1])[:, 0]


def going_up(force_N: Array, from_wall: int, pulses: list[Peak]) -> list[Peak]:
    """Pulses at a bead that go up: while they rise, the two contacts push the bead upwards.

    With the changes d_j of the contact force below and d_{j+1} of that above since time 0, a pulse rises from the
    smallest ``d_j + d_{j+1}`` since the previous pulse (or time 0) to its own largest sample. It goes up if the sum of
    ``d_j - d_{j+1}`` over these samples, which is proportional to the momentum that the bead gains, is above
    ``BALANCED`` times the sum of ``|d_j| + |d_{j+1}|``; a smaller sum, as in a symmetric collision, is a tie.

    The top bead of a chain without a striker has no contact above; the contacts of the bead below are taken.

    Args:
        force_N: Contact forces. Shape (samples, contacts).
        from_wall: Number of the bead, from 1.
        pulses: Pulses in the bead's signal, by time.
    """
    contacts = force_N.shape[1]
    bead = max(min(from_wall, contacts - 1), 1)
    both_N = force_N[:, [bead - 1, bead % contacts]]
    lower_N, upper_N = (both_N - both_N[0]).T
    upwards, before = [], 0
    for pulse in pulses:
        valley = before + int(np.argmin((lower_N + upper_N)[before : pulse.sample + 1]))
        below_N, above_N = (side[valley : pulse.sample + 1] for side in (lower_N, upper_N))
        if (below_N - above_N).sum() > BALANCED * (np.abs(below_N) + np.abs(above_N)).sum():
            upwards.append(pulse)
        before = pulse.sample
    return upwards


def gauges_of(layout: Layout) -> list[str]:
    """Names of all gauges in the order in which a wave meets them: ``bead_9``, ``bead_5``, ..., and ``wall``."""
    return [f"bead_{sensor.from_wall}" for sensor in layout.sensors] + ["wall"] * layout.wall


def sensor_signals(layout: Layout, trace: Trace) -> dict[str, Array]:
    """Signals of all gauges by name: ``bead_9``, ``bead_5``, ..., and ``wall``. Each of shape (samples,)."""
    signals = {f"bead_{s.from_wall}": sensor_average(trace.force_N, s.from_wall) for s in layout.sensors}
    if layout.wall:
        signals["wall"] = trace.force_N[:, 0]
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

    A time constant far above the duration leaves the change since time 0; one far below the sample interval leaves
    ``tau x'``, which is almost zero.
    """
    from scipy.signal import lfilter
    from scipy.special import hyp1f1

    count = len(signal)
    change = signal - signal[0]
    if count < 2:
        return np.asarray(change)
    ratio = (time_s[-1] - time_s[0]) / (count - 1) / time_constant_s
    points = min(POINTS, count)
    # contribution of each sample of a window to z over each of its intervals, shape (intervals, points): the integrals
    # int_0^1 exp(-r (1 - s)) s^k ds are 1F1(1; k + 2; -r) / (k + 1) (DLMF 13.4.1)
    powers = np.arange(float(points))
    integrals = ratio * hyp1f1(1.0, powers + 2, -ratio) / (powers + 1)
    weights = np.stack([
        integrals @ np.linalg.inv(np.vander(powers - interval, increasing=True)) for interval in range(points - 1)
    ])  # fmt: skip
    windows = sliding_window_view(change, points)
    middle = (points - 2) // 2  # interval of a window used except at both ends of the record
    fed = np.concatenate([
        [0.0],
        weights[:middle] @ windows[0],
        windows @ weights[middle],
        weights[middle + 1 :] @ windows[-1],
    ])  # fmt: skip
    leaked = lfilter([1.0], [1.0, -np.exp(-ratio)], fed)
    return np.asarray(change - leaked)
