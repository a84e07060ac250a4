"""Measured traces in a fit: residuals of each gauge, base lines projected out."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from drivers.chain.chain import Array
from postproc.paper.simulate import Simulation
from postproc.read.alignment import align, must_last
from postproc.read.measured import MeasuredTrace, averaged
from postproc.read.sensors import sensor_signals

LEEWAY = 0.5  # of the run's length, by which a trigger that is found may move either way; motions are that much longer


@dataclass(frozen=True, eq=False)
class Record:
    """A measured trace as data to be fitted.

    Attributes:
        key: of its entry in the scene, such as ``measured.0``.
        trigger_s: time in the file at which the impact is, given or found; ``leeway_s``: how far off it may be.
        noise: standard deviation of a reading, by gauge.
        counts: whether a reading is compared: those up to the end of the run. Shape (samples,).
    """

    key: str
    measured: MeasuredTrace
    trigger_s: float
    leeway_s: float
    noise: dict[str, float]
    counts: NDArray[np.bool_]

    @property
    def lines(self) -> int:
        """Coefficients of base lines that are fitted to each gauge."""
        return (self.measured.baseline is None) + self.measured.drift

    @property
    def found(self) -> bool:
        """Whether its noise was found, not given."""
        return self.measured.noise is None

    @property
    def rows(self) -> int:
        """Readings of each gauge that are compared."""
        return int(self.counts.sum())


def record_of(key: str, measured: MeasuredTrace, simulation: Simulation) -> Record:
    """A trace as data of the run that ``simulation`` is, aligned with it.

    Raises:
        InputError: after the impact it is much shorter or longer than the run, or it cannot be aligned.
    """
    trace = simulation.trace
    duration_s, coarse = float(trace.time_s[-1]), averaged(measured, float(trace.time_s[1]))
    gauges = align([measured], simulation.case.layout, trace)
    trigger_s = gauges[0].trigger_s
    must_last(measured, trigger_s, duration_s)
    noise = {each.gauge: each.noise_N / abs(measured.gain) for each in gauges}
    return Record(key, coarse, trigger_s, LEEWAY * duration_s, noise, coarse.time_s <= trigger_s + duration_s)


def residual_of(record: Record, gauge: str, simulation: Simulation, gain: float, trigger_s: float) -> Array:
    """Computed less measured readings of a gauge in standard errors, less the base line that fits best. Shape (rows,).

    Forces are counted above the static load, which is part of the base line; before the impact there is none.
    """
    from scipy.interpolate import make_interp_spline

    trace, measured = simulation.trace, record.measured
    signal = sensor_signals(simulation.case.layout, trace)[gauge]
    time = measured.time_s[record.counts] - trigger_s
    curve = make_interp_spline(trace.time_s, signal - signal[0], k=5)
    force = np.where(time > 0, curve(np.clip(time, 0.0, trace.time_s[-1])), 0.0)
    reading = measured.reading[gauge][record.counts] - (measured.baseline or 0.0)
    off = (force / gain - reading) / record.noise[gauge]
    powers = [0] * (measured.baseline is None) + [1] * measured.drift
    if not powers:
        return np.asarray(off)
    span = np.linspace(-1.0, 1.0, len(off))
    basis, _ = np.linalg.qr(np.column_stack([span**power for power in powers]))
    return np.asarray(off - basis @ (basis.T @ off))
