"""What gauges show: the mean of the two contact forces of a sensor bead, and the force on the wall.

Where the scene gives the time constant of their electronics, what these leave of it, a first-order high-pass:
A piezo gauge with its amplifier is a charge that leaks away, ``y' + y/tau = x'``, with x the force, y what is shown and
tau the time constant, resistance times capacitance (Horowitz & Hill, The Art of Electronics, 1.7.8). Before time 0 the
gauge has stood under the static load for long: y(0) = 0. So y is what is left of the change u = x - x(0):

    y = u - z,   z' = (u - z) / tau,   z(0) = 0.

Over one sample interval h, z is known exactly for any polynomial that u is: with r = h/tau and s counted in h,

    z(t + h) = exp(-r) z(t) + r int_0^1 exp(-r (1 - s)) u(t + s h) ds.

Here u is read off the polynomial through six samples around the interval, as peaks and impulses are. The error for a
pulse of width w goes with (h/w)^6.
"""

from pathlib import Path

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from drivers.chain.case import Layout
from drivers.chain.chain import Array
from drivers.chain.trace import Trace
from postproc.read.signals import Peak

POINTS = 6  # samples that each interval's polynomial goes through


def mean_forces(force_N: Array) -> Array:
    """``(F_j + F_{j+1}) / 2`` of every body, as a sensor bead reads (the paper's Eq. 5); above the last there is none.

    Of the same shape, (..., bodies), contact j under body j.
    """
    above = np.zeros_like(force_N)
    above[..., :-1] = force_N[..., 1:]
    return np.asarray((force_N + above) / 2)


def sensor_average(force_N: Array, from_wall: int) -> Array:
    """What a sensor bead reads, counted from the wall, of forces of shape (samples, contacts). Shape (samples,)."""
    return mean_forces(force_N[:, from_wall - 1 : from_wall + 1])[:, 0]


def going_up(force_N: Array, from_wall: int, pulses: list[Peak]) -> list[Peak]:
    """The pulses at a bead that go up: before their peaks the contact below pushes more than the one above."""
    upper = max(min(from_wall, force_N.shape[1] - 1), 1)  # the top bead of a chain without a striker has none above
    both_N = force_N[:, [upper - 1, upper % force_N.shape[1]]]
    lower_N, upper_N = (both_N - both_N[0]).T
    found, before = [], 0
    for pulse in pulses:
        valley = before + int(np.argmin((lower_N + upper_N)[before : pulse.sample + 1]))
        if (lower_N - upper_N)[valley : pulse.sample + 1].sum() > 0:
            found.append(pulse)
        before = pulse.sample
    return found


def gauges_of(layout: Layout) -> list[str]:
    """Names of all gauges in the order in which a wave meets them: ``bead_9``, ``bead_5``, ..., and ``wall``."""
    return [f"bead_{sensor.from_wall}" for sensor in layout.sensors] + ["wall"] * layout.wall


def sensor_signals(layout: Layout, trace: Trace) -> dict[str, Array]:
    """What all gauges show, by name: ``bead_9``, ``bead_5``, ..., and ``wall``. Each of shape (samples,)."""
    signals = {f"bead_{s.from_wall}": sensor_average(trace.force_N, s.from_wall) for s in layout.sensors}
    if layout.wall:
        signals["wall"] = trace.force_N[:, 0]
    if layout.time_constant_s is None:
        return signals
    return {name: high_passed(trace.time_s, signal, layout.time_constant_s) for name, signal in signals.items()}


def write_sensors(layout: Layout, trace: Trace, path: Path) -> None:
    """Writes ``sensors.csv`` in full precision."""
    import pandas as pd

    columns = {f"{name}_N": signal for name, signal in sensor_signals(layout, trace).items()}
    pd.DataFrame({"time_s": trace.time_s} | columns).to_csv(path, index=False)


def high_passed(time_s: Array, signal: Array, time_constant_s: float) -> Array:
    """What a gauge of that time constant shows of a signal that has been at its first value for ever. Shape (samples,).

    A time constant far beyond the record leaves the change since time 0; one far below the sample interval leaves
    ``tau x'``, next to nothing.
    """
    from scipy.signal import lfilter
    from scipy.special import hyp1f1

    count = len(signal)
    change = signal - signal[0]
    if count < 2:
        return np.asarray(change)
    ratio = (time_s[-1] - time_s[0]) / (count - 1) / time_constant_s
    points = min(POINTS, count)
    # what each sample of a window feeds into z over each of the window's intervals, shape (intervals, points): the
    # integrals int_0^1 exp(-r (1 - s)) s^k ds are 1F1(1; k + 2; -r) / (k + 1) (DLMF 13.4.1)
    powers = np.arange(float(points))
    integrals = ratio * hyp1f1(1.0, powers + 2, -ratio) / (powers + 1)
    weights = np.stack([
        integrals @ np.linalg.inv(np.vander(powers - interval, increasing=True)) for interval in range(points - 1)
    ])  # fmt: skip
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
