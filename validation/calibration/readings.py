"""Readings of a motion that change continuously with its parameters, as an objective of least squares needs.

Observables of ``postproc.read.observables`` follow the printed paper: a duration is twice the rise, an envelope passes
through a list of maxima. A duration of that kind cannot fail, and a list of maxima changes by jumps. Here

- the full width at a cut is the time for which the gauge is above this share of its peak before the wave reaches
  the wall. If the force has not fallen so low until then, the width is censored: this time is its lower bound;
- the decay at the wall is the rate of the lowest exponential above the force, from the first maximum at t1 until
  1.75 t1, which is the third maximum of the elastic chain of Fig. 5. It is the expectile of ``log F`` with the
  asymmetry ``ABOVE`` (Newey & Powell, Econometrica 55, 819): a least-squares line on which a point above it weighs
  ``ABOVE / (1 - ABOVE)`` times as much as one below. The elastic chain of 1.46 GPa gives -0.00590 per us, the paper
  -0.0059.

Traces are compared reading by reading, with base lines projected out. The compared readings, their noise and the range
of the trigger depend on the file and on the duration of the run alone, so that all models have the same data.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from math import nan
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import BSpline, make_interp_spline

from drivers.base import paths
from drivers.base.errors import InputError
from drivers.chain.case import Layout
from drivers.chain.chain import Array
from postproc.paper.simulate import Simulation
from postproc.read.alignment import averaged, must_have_unit, noise_of
from postproc.read.measured import MIN_SAMPLES, MeasuredTrace
from postproc.read.observables import first_pulses
from postproc.read.sensors import sensor_signals
from postproc.read.signals import first_peak

ABOVE = 0.999  # asymmetry of the expectile
WINDOW = 0.75  # of the arrival time at the wall, after the first maximum
POINTS = 301  # of the window
FLOOR = 1e-3  # of the first maximum: lower forces count as this
MAX_ROUNDS = 100  # of the expectile
CUBIC = np.linalg.inv(np.vander(np.arange(4.0), increasing=True))  # coefficients from values at 0, 1, 2, 3
NEWTON_STEPS = 3
DEFAULT_CUT = 0.04  # share of the peak at which the paper cuts widths


class Waves(Simulation):
    """A simulation of which the numbers of first pulses are read without all other observables."""

    @cached_property
    def layout(self) -> Layout:
        """Properties of the chain."""
        return self.case.layout

    @cached_property
    def signals(self) -> dict[str, Array]:
        """Gauge signals by name."""
        return sensor_signals(self.layout, self.trace)

    @cached_property
    def first(self) -> dict[str, float]:
        """Amplitudes, arrivals and speeds of the first pulses."""
        return first_pulses(self.layout, self.trace, self.signals)


Reader = Callable[[Waves, str, float], float]


def full_width_s(simulation: Waves, gauge: str, cut: float) -> float:
    """Full width of the first pulse in s, or its lower bound; NaN if a pulse is missing."""
    values, trace = simulation.first, simulation.trace
    signal, end_s = simulation.signals[gauge], values["wall_arrival_s"]
    return time_above(trace.time_s, signal - signal[0], cut * values[f"{gauge}_amplitude_N"], end_s)


def is_censored(simulation: Waves, gauge: str, cut: float) -> bool:
    """True if the force is still above the cut when the wave reaches the wall."""
    values, trace, signal = simulation.first, simulation.trace, simulation.signals[gauge]
    last = np.interp(values["wall_arrival_s"], trace.time_s, signal - signal[0])
    return bool(last > cut * values[f"{gauge}_amplitude_N"])


def time_above(time_s: Array, signal: Array, level: float, end_s: float) -> float:
    """Time before ``end_s`` for which a signal, sampled at equal intervals, is above a level.

    Crossings are those of the cubic through four samples: that of a straight line would have kinks.
    """
    if not np.isfinite(level + end_s):
        return nan
    above, step_s = signal - level, float(time_s[1])
    places = np.flatnonzero((above[:-1] > 0) != (above[1:] > 0))
    crossings = np.array([step_s * (place + _root(above, int(place))) for place in places])
    inside = crossings[crossings < end_s]
    ends = np.concatenate([[0.0], inside, [end_s]])
    return float(np.diff(ends)[int(above[0] <= 0) :: 2].sum())


def _root(values: Array, place: int) -> float:
    """Share of the interval after a sample at which the cubic through four samples is zero, by Newton's method."""
    first = min(max(place - 1, 0), len(values) - 4)
    a, b, c, d = (CUBIC @ values[first : first + 4]).tolist()
    share = place - first + float(values[place] / (values[place] - values[place + 1]))
    for _ in range(NEWTON_STEPS):
        share -= (a + share * (b + share * (c + share * d))) / (b + share * (2 * c + share * 3 * d))
    return min(max(share - (place - first), 0.0), 1.0)


def contact_force_N(simulation: Waves, gauge: str, cut: float) -> float:
    """The paper's F_m of Eq. (6): beta times the gauge's amplitude plus the static load of the contact above the bead.

    The factor beta, amplitude at that contact divided by that of the mean of both contacts, is of the same motion.
    """
    layout, trace = simulation.layout, simulation.trace
    force_N = trace.force_N[:, int(gauge.removeprefix("bead_"))]
    plain = sensor_signals(replace(layout, time_constant_s=None), trace)[gauge]
    contact, mean = (first_peak(trace.time_s, signal - signal[0]) for signal in (force_N, plain))
    if contact is None or mean is None:
        return nan
    return float(contact.value / mean.value * simulation.first[f"{gauge}_amplitude_N"] + force_N[0])


def decay_per_s(simulation: Waves, gauge: str, cut: float) -> float:
    """Rate of the lowest exponential above the force at a gauge in 1/s; NaN if the motion ends before."""
    trace, first_s = simulation.trace, simulation.first[f"{gauge}_arrival_s"]
    times = first_s * np.linspace(1.0, 1.0 + WINDOW, POINTS)
    if not times[-1] <= trace.time_s[-1]:
        return nan
    force = make_interp_spline(trace.time_s, simulation.signals[gauge], k=3)(times)
    level = np.log(np.maximum(force / force[0], FLOOR))
    late, weight, slope = times - first_s, np.ones(POINTS), nan
    for _ in range(MAX_ROUNDS):
        middle, height = weight @ late / weight.sum(), weight @ level / weight.sum()
        slope = float((weight * (late - middle)) @ level / ((weight * (late - middle)) @ late))
        changed = np.where(level > height + slope * (late - middle), ABOVE, 1 - ABOVE)
        if np.array_equal(changed, weight):
            break
        weight = changed
    return slope


READERS: dict[str, Reader] = {
    "_full_width_s": full_width_s,
    "_contact_force_N": contact_force_N,
    "_decay_per_s": decay_per_s,
}


def read(simulation: Waves, name: str, cut: float) -> float:
    """A reading, or an observable, of a motion by its name with the unit; NaN if the motion does not show it.

    Raises:
        InputError: The scene's runs have neither.
    """
    ending = next((ending for ending in READERS if name.endswith(ending)), None)
    if ending:
        return READERS[ending](simulation, name.removesuffix(ending), cut)
    return simulation.first[name] if name in simulation.first else simulation.values[name]


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
    records = []
    for keys in groups.values():
        averages = {key: averaged(traces[key], step_s) for key in keys}
        shown = paths.shown(traces[keys[0]].file)
        given = sorted({trace.trigger_s for trace in averages.values() if trace.trigger_s is not None})
        if len(given) > 1:
            raise InputError(
                shown, "", f"triggers {' and '.join(f'{stated_s:g} s' for stated_s in given)}", "one trigger per file"
            )
        rise_s = min(_first_rise_s(trace, gauge) for trace in averages.values() for gauge in trace.reading)
        trigger_s = given[0] if given else None
        if trigger_s is not None and trigger_s >= averages[keys[0]].time_s[-1]:
            found_s = f"{trigger_s:g} s, after the last reading at {averages[keys[0]].time_s[-1]:g} s"
            raise InputError(shown, "trigger", found_s, "a time before the pulses")
        end_s = (rise_s if trigger_s is None else trigger_s) + duration_s
        for key, trace in averages.items():
            noise = {gauge: trace.noise or noise_of(trace.time_s, reading) for gauge, reading in trace.reading.items()}
            counts = trace.time_s <= end_s
            if counts.sum() < MIN_SAMPLES:
                raise InputError(shown, "", f"{counts.sum()} readings within the run", f"at least {MIN_SAMPLES}")
            records.append(Record(key, keys[0], trace, trigger_s, (rise_s - duration_s, rise_s), noise, counts))
    return sorted(records, key=lambda record: [*traces].index(record.key))


def _first_rise_s(trace: MeasuredTrace, gauge: str) -> float:
    """First time at which a gauge has reached half of its largest force."""
    force = np.sign(trace.gain) * (trace.reading[gauge] - np.median(trace.reading[gauge]))
    return float(trace.time_s[int(np.argmax(force >= force.max() / 2))])


def curves_of(simulation: Waves) -> dict[str, BSpline]:
    """Splines of the changes of all gauge signals."""
    time_s, signals = simulation.trace.time_s, simulation.signals
    return {gauge: make_interp_spline(time_s, signal - signal[0], k=5) for gauge, signal in signals.items()}


def residual_of(record: Record, gauge: str, curve: BSpline, gain: float, trigger_s: float) -> Array:
    """Computed minus measured readings of a gauge in standard errors, without the best base line. Shape (rows,)."""
    measured = record.measured
    clock_s = measured.time_s[record.counts] - trigger_s
    force = np.where(clock_s > 0, curve(np.clip(clock_s, 0.0, curve.t[-1])), 0.0)  # above rest, 0 before the impact
    reading = measured.reading[gauge][record.counts] - (measured.baseline or 0.0)
    off = (force / gain - reading) / record.noise[gauge]
    powers = [0] * (measured.baseline is None) + [1] * measured.drift
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
    # the residual has one broad minimum around each alignment of pulses
    while places[1] - places[0] > (high - low) / 1000:
        best = float(places[int(np.argmin([chi_square(float(place)) for place in places]))])
        reach = 2 * (places[1] - places[0])
        places = np.linspace(max(best - reach, low), min(best + reach, high), 17)
    return float(places[int(np.argmin([chi_square(float(place)) for place in places]))])
