"""Measured traces in a fit: residuals of each gauge, with base lines projected out.

The compared readings, their noise and the range of the trigger depend on the file and on the duration of the run alone,
so that all models are compared by the same readings.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import BSpline, make_interp_spline

from drivers.base import paths
from drivers.base.errors import InputError
from drivers.chain.chain import Array
from postproc.paper.simulate import Simulation
from postproc.read.alignment import averaged, must_have_unit
from postproc.read.measured import MIN_SAMPLES, MeasuredTrace
from postproc.read.sensors import sensor_signals
from postproc.read.smooth import noise_of


@dataclass(frozen=True, eq=False)
class Record:
    """A measured trace as data to be fitted.

    Attributes:
        key: Key of its entry in the scene, such as ``measured.0``.
        trigger_key: Key of the entry whose trigger it shares.
        trigger_s: Time of the impact in the file; None if it has to be found.
        window_s: Range of a trigger to be found.
        noise: Standard deviation of a reading, by gauge.
        counts: True for each compared reading. Shape (samples,).
    """

    key: str
    trigger_key: str
    measured: MeasuredTrace
    trigger_s: float | None
    window_s: tuple[float, float]
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


def records_of(traces: Mapping[str, MeasuredTrace], duration_s: float, step_s: float) -> list[Record]:
    """Traces as data to be fitted; entries of the same file share their trigger.

    Readings count until the run's duration after the trigger; if it has to be found, after the first rise in the file.

    Args:
        traces: Traces by key of their entry.
        duration_s: Duration of the run.
        step_s: Sample interval of the run; closer readings are averaged.

    Raises:
        InputError: Entries of one file state different triggers, a record is some hundred times longer or shorter than
            the run, or too few readings count.
    """
    groups: dict[Path, list[str]] = {}
    for key, trace in traces.items():
        must_have_unit(trace, duration_s)
        groups.setdefault(trace.file.resolve(), []).append(key)
    found = []
    for keys in groups.values():
        own = {key: averaged(traces[key], step_s) for key in keys}
        shown = paths.shown(traces[keys[0]].file)
        given = sorted({trace.trigger_s for trace in own.values() if trace.trigger_s is not None})
        if len(given) > 1:
            raise InputError(
                shown, "", f"triggers {' and '.join(f'{each:g} s' for each in given)}", "one trigger per file"
            )
        rise_s = min(_first_rise_s(trace, gauge) for trace in own.values() for gauge in trace.reading)
        trigger_s = given[0] if given else None
        end_s = (rise_s if trigger_s is None else trigger_s) + duration_s
        for key, trace in own.items():
            noise = {gauge: trace.noise or noise_of(trace.time_s, reading) for gauge, reading in trace.reading.items()}
            counts = trace.time_s <= end_s
            if counts.sum() < MIN_SAMPLES:
                raise InputError(shown, "", f"{counts.sum()} readings within the run", f"at least {MIN_SAMPLES}")
            found.append(Record(key, keys[0], trace, trigger_s, (rise_s - duration_s, rise_s), noise, counts))
    return sorted(found, key=lambda record: [*traces].index(record.key))


def _first_rise_s(trace: MeasuredTrace, gauge: str) -> float:
    """First time at which a gauge has reached half of its largest force."""
    force = np.sign(trace.gain) * (trace.reading[gauge] - np.median(trace.reading[gauge]))
    return float(trace.time_s[int(np.argmax(force >= force.max() / 2))])


def curves_of(simulation: Simulation) -> dict[str, BSpline]:
    """Splines of the changes of all gauge signals."""
    trace = simulation.trace
    signals = sensor_signals(simulation.case.layout, trace)
    return {gauge: make_interp_spline(trace.time_s, signal - signal[0], k=5) for gauge, signal in signals.items()}


def _force(curve: BSpline, time_s: Array) -> Array:
    """Computed force above rest; 0 before the impact. Shape (times,)."""
    return np.where(time_s > 0, curve(np.clip(time_s, 0.0, curve.t[-1])), 0.0)


def residual_of(record: Record, gauge: str, curve: BSpline, gain: float, trigger_s: float) -> Array:
    """Computed minus measured readings of a gauge in standard errors, without the best base line. Shape (rows,)."""
    measured = record.measured
    force = _force(curve, measured.time_s[record.counts] - trigger_s)
    reading = measured.reading[gauge][record.counts] - (measured.baseline or 0.0)
    return _without_line(record, (force / gain - reading) / record.noise[gauge])


def _without_line(record: Record, off: Array) -> Array:
    """Residual without the best base line of the record."""
    powers = [0] * (record.measured.baseline is None) + [1] * record.measured.drift
    if not powers:
        return off
    span = np.linspace(-1.0, 1.0, len(off))
    basis, _ = np.linalg.qr(np.column_stack([span**power for power in powers]))
    return np.asarray(off - basis @ (basis.T @ off))


def best_trigger_s(records: Sequence[Record], curves: Mapping[str, BSpline], gains: Mapping[str, float]) -> float:
    """Trigger of the records of one file with the smallest residuals, to a thousandth of its range.

    Args:
        records: Records that share their trigger.
        curves: Computed signals by gauge.
        gains: Gain of each record, by key.
    """
    low, high = records[0].window_s

    def chi_square(trigger_s: float) -> float:
        return sum(
            float(np.sum(residual_of(record, gauge, curves[gauge], gains[record.key], trigger_s) ** 2))
            for record in records
            for gauge in record.measured.reading
        )

    places = np.linspace(low, high, 65)
    while (
        places[1] - places[0] > (high - low) / 1000
    ):  # the residual has one broad minimum around each alignment of pulses
        best = float(places[int(np.argmin([chi_square(float(each)) for each in places]))])
        reach = 2 * (places[1] - places[0])
        places = np.linspace(max(best - reach, low), min(best + reach, high), 17)
    return float(places[int(np.argmin([chi_square(float(each)) for each in places]))])
