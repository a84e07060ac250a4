"""Measured traces in a fit: residuals of each gauge, with base lines projected out."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from drivers.chain.chain import Array
from postproc.paper.simulate import Simulation
from postproc.read.alignment import align, averaged, check_length
from postproc.read.measured import MeasuredTrace
from postproc.read.sensors import sensor_signals

LEEWAY = 0.5  # range of a fitted trigger to either side, over the run's duration; runs are longer by it


@dataclass(frozen=True, eq=False)
class Record:
    """A measured trace as data to be fitted.

    Attributes:
        key: Key of its entry in the scene, such as ``measured.0``.
        trigger_s: Time of the impact in the file, given or found; ``leeway_s``: its largest error.
        noise: Standard deviation of a reading, by gauge.
        counts: True for each compared reading, up to the end of the run. Shape (samples,).
    """

    key: str
    measured: MeasuredTrace
    trigger_s: float
    leeway_s: float
    noise: dict[str, float]
    counts: NDArray[np.bool_]

    @property
    def lines(self) -> int:
        """Number of coefficients of the base line fitted to each gauge."""
        return (self.measured.baseline is None) + self.measured.drift

    @property
    def found(self) -> bool:
        """True if the noise was found from the trace."""
        return self.measured.noise is None

    @property
    def rows(self) -> int:
        """Number of compared readings of each gauge."""
        return int(self.counts.sum())


def record_of(key: str, measured: MeasuredTrace, simulation: Simulation) -> Record:
    """A trace as data to be fitted, aligned with a simulated run.

    Raises:
        InputError: the trace after the impact is much shorter or longer than the run, or cannot be aligned.
    """
    trace = simulation.trace
    duration_s, coarse = float(trace.time_s[-1]), averaged(measured, float(trace.time_s[1]))
    gauges = align([measured], simulation.case.layout, trace)
    trigger_s = gauges[0].trigger_s
    check_length(measured, trigger_s, duration_s)
    noise = {each.gauge: each.noise_N / abs(measured.gain) for each in gauges}
    return Record(key, coarse, trigger_s, LEEWAY * duration_s, noise, coarse.time_s <= trigger_s + duration_s)


def residual_of(record: Record, gauge: str, simulation: Simulation, gain: float, trigger_s: float) -> Array:
    """Computed minus measured readings of a gauge in standard errors, without the best base line. Shape (rows,).

    Forces exclude the static load, which is part of the base line; before the impact they are zero.
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
