"""Measured traces in a fit: residuals of each gauge, base lines projected out, and where a trace begins."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from drivers.chain.chain import Array
from postproc.paper.simulate import Simulation
from postproc.read.measured import MeasuredTrace
from postproc.read.sensors import sensor_signals

LEEWAY = 0.2  # of the run's length, by which a trigger that is found may move either way
SPREAD = 5.0  # standard errors of a gain, to either side of which it is looked for
DIGITS = 12 ** -0.5  # standard deviation of rounding over the last digit's step


@dataclass(frozen=True, eq=False)
class Record:
    """A measured trace as data to be fitted.

    Attributes:
        key: of its entry in the scene, such as ``measured.0``.
        noise: standard deviation of a reading, by gauge.
        counts: whether a reading is compared: all that lie within the run wherever the trigger is. Shape (samples,).
    """

    key: str
    measured: MeasuredTrace
    noise: dict[str, float]
    counts: Array

    @property
    def lines(self) -> int:
        """Coefficients of base lines that are fitted to each gauge."""
        return (self.measured.baseline is None) + self.measured.drift

    @property
    def rows(self) -> int:
        """Readings of each gauge that are compared."""
        return int(self.counts.sum())


def noise_of(reading: Array) -> float:
    """Standard deviation of a reading's noise, from second differences, which a slow signal leaves out.

    Their median serves where noise is finer than the last digit's step, that of rounding where it is not.
    """
    differences = np.abs(np.diff(reading, 2))
    steps = np.abs(np.diff(reading))
    digit = float(steps[steps > 0].min(initial=np.inf))
    return max(1.4826 * float(np.median(differences)) / 6**0.5, DIGITS * digit)


def residual_of(record: Record, gauge: str, simulation: Simulation, gain: float, trigger_s: float) -> Array:
    """Computed less measured readings of a gauge in standard errors, less the base line that fits best. Shape (rows,).

    Forces are counted above the static load, which is part of the base line; before the impact there is none.
    """
    from scipy.interpolate import make_interp_spline

    trace, measured = simulation.trace, record.measured
    signal = sensor_signals(simulation.case.layout, trace)[gauge]
    time = measured.time_s[record.counts.astype(bool)] - trigger_s
    curve = make_interp_spline(trace.time_s, signal - signal[0], k=5)
    force = np.where(time > 0, curve(np.clip(time, 0.0, trace.time_s[-1])), 0.0)
    reading = measured.reading[gauge][record.counts.astype(bool)] - (measured.baseline or 0.0)
    off = (force / gain - reading) / record.noise[gauge]
    powers = [0] * (measured.baseline is None) + [1] * measured.drift
    if not powers:
        return np.asarray(off)
    span = np.linspace(-1.0, 1.0, len(off))
    basis, _ = np.linalg.qr(np.column_stack([span**power for power in powers]))
    return np.asarray(off - basis @ (basis.T @ off))


def trigger_of(record: Record, simulation: Simulation) -> float:
    """Time in the file at which the impact is, by the largest correlation of all gauges with the computed ones, in s."""
    from scipy.signal import correlate

    trace, measured = simulation.trace, record.measured
    spacing = float(trace.time_s[1] - trace.time_s[0])
    grid = np.arange(measured.time_s[0], measured.time_s[-1], spacing)
    signals, total = sensor_signals(simulation.case.layout, trace), np.zeros(0)
    for gauge, values in measured.reading.items():
        reading = np.interp(grid, measured.time_s, values) * np.sign(measured.gain)
        computed = signals[gauge] - signals[gauge][0]
        scale = float(np.std(reading) * np.std(computed)) or 1.0
        likeness = correlate(reading - np.median(reading), computed, mode="full", method="fft") / scale
        total = likeness if not total.size else total + likeness
    return float(grid[0] + spacing * (int(np.argmax(total)) - (len(trace.time_s) - 1)))


def wakes(record: Record, residuals: dict[str, Array]) -> Iterator[str]:
    """Gauges whose residuals are no noise: neighbours alike, so that errors by noise alone are too small."""
    for gauge, off in residuals.items():
        alike = float(np.corrcoef(off[:-1], off[1:])[0, 1])
        if alike > 0.5:
            yield f"{gauge}: neighbouring residuals have a correlation of {alike:.2f}: the model leaves more than noise"
