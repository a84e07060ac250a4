"""Observables of a run: peaks, arrival times, speeds, widths, reflections, energies and momentum.

f is the signal of a gauge, s(t) = f(t) - f(0), t_p the time of its first pulse, d the diameter of the bead, z its
height at time 0, E the total energy, p the momentum. N is the sum of the external forces: weight, precompression, wall,
friction of the tube. P is the largest of |p(t)| and the sum of |m v| at time 0; where nothing moves, also the load
times the duration.

A maximum is a sample of s above its two neighbours, not the first or the last sample; of equal samples between lower
ones it is the middle one, of an even number the earlier. Its height and time are those of the highest point, within one
sample, of a quintic polynomial through the samples around. Its prominence is its sample less the higher of two minima:
on each side the smallest sample as far as the next one that is larger than the maximum, or to the end of the record.
The range is the largest less the smallest sample.

A pulse is a maximum whose prominence is at least 1e-4 of the range and at least 0.01 of its own height, and whose
height is above 0 and above 0.05 of that of every pulse before it. If the range is at most 1e-9 of the largest force of
all contacts, there is no pulse. The first pulse is the incident wave.

A pulse at bead j goes up if the contacts push the bead upwards while it rises. With the changes d_j = F_j - F_j(0) and
d_(j+1) of the contact forces below and above the bead, without electronics, it rises from the sample with the smallest
d_j + d_(j+1) (the earliest of equal ones) since the maximum of the pulse before, or since time 0, to the sample of its
own maximum. It goes up if the sum of d_j - d_(j+1) over these samples, both ends included, is above 1e-6 of the sum of
|d_j| + |d_(j+1)|. At the top bead of a chain without a striker the contacts of the bead below are taken. At bead 1
above a wall, where a wave and its reflection coincide, no pulse goes up.
"""

import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache, cached_property
from itertools import groupby, islice, product
from math import isnan, nan
from typing import Any
from weakref import proxy

import numpy as np

from drivers.chain.case import Layout, SensorBead
from drivers.chain.chain import Array
from drivers.chain.trace import Trace, is_at_rest
from postproc.read.signals import NO_PEAK, ONSET, Peak, integral, peaks, pulses, rising_crossing, sensor_signals

LEVELS = (0.002, 0.04)  # shares of the peak at which the paper's Table 1 cuts the width
WALL_REST_SHARE = 1e-14  # of the largest force: smaller changes at the wall are rounding
LATER_PROMINENCE = 0.01  # of the signal's range, for maxima after the first: damping makes them small
ENVELOPE_MAXIMA = 3  # maxima of a train in its envelope, by default
MAX_INTERVAL_RATIO = 2.0  # of the longest to the shortest interval between the maxima of a train
BALANCED = 1e-6  # of the forces: a smaller difference of two contacts is rounding
ROUNDING_SHARE = 1e-9  # of the largest force: a signal that changes by less is at rest
# reasons why an observable is NaN, and the things without which a scene's runs do not have the observable
NEVER = ("", "such gauge")
PULSE = ("the gauge shows no pulse before the end of the run", "such gauge")
WIDTH = ("the wave speed from the gauge above is not seen", "such gauge with another one above")
ECHO = ("no pulse goes up after the wall's first one before the end of the run; at bead 1 never", "such gauge and wall")
MAXIMUM = ("the wall shows no such maximum before the end of the run", "wall")
SECOND = ("fewer than two pulses that do not go up come before the reflected wave", "such gauge")
LOSS = (
    "each contact between beads, or with the wall, that carries a load at time 0 keeps it",
    "contact that carries a load at time 0",
)
TRAIN = ("fewer than three maxima at the wall are above 0, or one interval is more than twice the other", "wall")
SPEED = ("a first pulse is missing or goes up, or that of the lower gauge is not later", "such neighbouring gauges")
RATIO = (f"{SPEED[0]}; or the lower gauge is at bead 1 above a wall", SPEED[1])

WALL = SensorBead(0, nan, nan)  # in the place of the bead of the wall's gauge
PLACEHOLDERS = {"gauge": r"bead_\d+|wall", "level": r"[\d.e+-]+pct", "number": r"\d+", "pair": r"\d+_to_\d+"}


@dataclass(frozen=True, eq=False)
class Observable:
    """A number of a run.

    Attributes:
        pattern: Name without the unit; placeholders such as ``{gauge}`` depend on the scene.
        unit: SI unit; empty for a plain number.
        kind: Observables of one kind share a tolerance.
        words: Name in figures and tables.
        gaps: Reason why it is NaN, empty if it never is; thing that it needs in a scene.
        of_wave: True if it is read from pulses; then its relative error measures the accuracy of a run.
        places: Attribute of ``Readings`` with the places at which it is read.
        read: Function of a place, and of a level or number in its name; None if the scene does not have the observable.
    """

    pattern: str
    unit: str
    kind: str
    words: str
    gaps: tuple[str, str] = NEVER
    of_wave: bool = True
    places: str = ""
    read: Callable[..., float | None] = lambda place: None

    @cached_property
    def ending(self) -> str:
        """The unit as the ending of a name, such as ``_m_s``."""
        return "_" + re.sub("[/ ]", "_", self.unit.replace("1/", "per ")) if self.unit else ""

    @cached_property
    def varies(self) -> str:
        """Placeholder of a number in its name, which the scene does not give; empty if there is none."""
        return "".join(field for field in ("level", "number") if f"{{{field}}}" in self.pattern)

    @property
    def definition(self) -> str:
        """Definition, with the symbols and terms of this module."""
        return " ".join((self.read.__doc__ or "").split())

    def match(self, name: str) -> re.Match[str] | None:
        """Match of a name, with or without the unit, with the placeholders as groups; None for any other name."""
        fields = {field: f"(?P<{field}>{pattern})" for field, pattern in PLACEHOLDERS.items()}
        return re.fullmatch(f"{self.pattern.format(**fields)}(?:{self.ending})?", name)


@dataclass(frozen=True, eq=False)
class Readings:
    """All that the observables of a run share, read when it is first used.

    Attributes:
        signals: Signals of all gauges by name.
        levels: Shares of the peak at which durations and widths are cut.
        most: Number of pulses to be found in each signal; None for all.
    """

    layout: Layout
    trace: Trace
    signals: Mapping[str, Array]
    levels: tuple[float, ...] = ()
    most: int | None = None
    name = pair = ""  # of a gauge

    @cached_property
    def places(self) -> dict[str, list[Any]]:
        """The run and its gauges, from the top of the chain to the wall."""
        gauges, run = list[GaugeReadings](), proxy(self)  # a circle would keep the traces of former runs in memory
        for bead, (name, reading) in zip((*self.layout.sensors, WALL), self.signals.items(), strict=False):
            above = gauges[-1] if gauges else None
            pair = f"{above.bead.from_wall}_to_{bead.from_wall}" if above else ""
            gauges.append(GaugeReadings(run, name, bead, reading, above, pair))
        beads = gauges[: len(self.layout.sensors)]
        return {"run": [run], "gauge": gauges, "bead": beads, "wall": gauges[len(beads) :], "pair": beads[1:]}

    @cached_property
    def rounding_N(self) -> float:
        """Force below which a change or a load does not count."""
        return ROUNDING_SHARE * float(np.abs(self.trace.force_N).max())

    @cached_property
    def net_N(self) -> Array:
        """Sum of the external forces, without a drive. Shape (samples,)."""
        wall_N = self.trace.force_N[:, 0] if self.layout.wall else np.zeros_like(self.trace.time_s)
        friction_N = self.trace.bore_friction_N
        return np.asarray(self.layout.load_N + wall_N + (0.0 if friction_N is None else friction_N))

    @cached_property
    def gained_N_s(self) -> Array:
        """Momentum gained since time 0, without the impulse of a drive. Shape (samples,)."""
        drive_N_s = self.trace.drive_impulse_N_s
        undriven_N_s = self.trace.momentum_N_s - (0.0 if drive_N_s is None else drive_N_s)
        return np.asarray(undriven_N_s - undriven_N_s[0])

    @cached_property
    def scale_N_s(self) -> float:
        """P, which errors of the momentum are relative to."""
        loads_N = abs(self.layout.load_N) * is_at_rest(self.trace.force_N)
        largest_N_s = float(np.abs(self.trace.momentum_N_s).max())
        return max(largest_N_s, self.layout.moving_N_s, loads_N * float(self.trace.time_s[-1])) or 1.0


@dataclass(frozen=True, eq=False)
class GaugeReadings:
    """A gauge of a run, in a bead or at the wall, which has the number 0.

    Attributes:
        reading: Signal with the static load. Shape (samples,).
        above: Next gauge above; None for the first one.
        pair: Numbers of both in names, such as ``9_to_5``; empty for the first one.
    """

    run: Readings
    name: str
    bead: SensorBead
    reading: Array
    above: Any
    pair: str

    @cached_property
    def signal(self) -> Array:
        """Change of the reading since time 0. Shape (samples,)."""
        return np.asarray(self.reading - self.reading[0])

    @cached_property
    def pulses(self) -> list[Peak]:
        """Pulses by time, all or as many as are asked for."""
        return [*islice(pulses(self.run.trace.time_s, self.signal, self.run.rounding_N), self.run.most)]

    @cached_property
    def first(self) -> Peak:
        """First pulse, of NaN if there is none."""
        return next(iter(self.pulses), NO_PEAK)

    @cached_property
    def upwards(self) -> list[Peak]:
        """Pulses that go up; at bead 1 a wave and its reflection coincide."""
        alone = self.bead.from_wall > self.run.layout.wall
        return going_up(self.run.trace.force_N, self.bead.from_wall, self.pulses) if alone else []

    @cached_property
    def reflected(self) -> Peak:
        """Reflected pulse, of NaN if there is none."""
        turned_s = self.run.places["wall"][0].first.time_s if self.run.layout.wall else nan
        return next((peak for peak in self.upwards if peak.time_s > turned_s), NO_PEAK)

    @cached_property
    def passing(self) -> list[Peak]:
        """Pulses before the reflected one, or all; above a wall those that do not go up."""
        before = [peak for peak in self.pulses if not peak.time_s >= self.reflected.time_s]
        return [peak for peak in before if not self.run.layout.wall or peak not in self.upwards]

    @cached_property
    def second(self) -> Peak:
        """Second of these pulses, of NaN if there is none."""
        return self.passing[1] if len(self.passing) > 1 else NO_PEAK

    @cached_property
    def maxima(self) -> list[Peak]:
        """First pulse and later maxima of the force itself."""
        later = peaks(self.run.trace.time_s, self.signal, LATER_PROMINENCE)
        shown = [*self.pulses[:1], *(peak for peak in later if peak.time_s > self.first.time_s)]
        return [replace(peak, value=peak.value + float(self.reading[0])) for peak in shown[:ENVELOPE_MAXIMA]]

    def rise_s(self, level: float) -> float:
        """Time before the first pulse at which the signal last rises through this share of it."""
        return rising_crossing(self.run.trace.time_s, self.signal, level * self.first.value, self.first)

    @cached_property
    def duration_s(self) -> dict[float, float]:
        """Durations of the first pulse by level."""
        return {level: 2 * (self.first.time_s - self.rise_s(level)) for level in self.run.levels}

    @cached_property
    def speed_m_s(self) -> float:
        """Speed from the gauge above, peak to peak; NaN if the first pulses belong to different waves.

        Then the first pulse of either gauge goes up, or that of the lower one is not the later one.
        """
        travel_s = self.first.time_s - self.above.first.time_s
        from_below = any(gauge.pulses[:1] == gauge.upwards[:1] != [] for gauge in (self.above, self))
        return (self.above.bead.height_m - self.bead.height_m) / travel_s if travel_s > 0 and not from_below else nan


OBSERVABLES: list[Observable] = []  # in the order of tables


def _of(
    places: str, pattern: str, unit: str, kind: str, words: str, gaps: tuple[str, str] = NEVER, *, of_wave: bool = True
) -> Callable[[Callable[..., float | None]], None]:
    """Declare the observable that the decorated function reads; its docstring is the definition."""
    return lambda read: OBSERVABLES.append(Observable(pattern, unit, kind, words, gaps, of_wave, places, read))


@_of("gauge", "{gauge}_static", "N", "static force", "static force at {gauge}", of_wave=False)
def _(gauge: GaugeReadings) -> float:
    """f(0)."""
    return float(gauge.reading[0])


@_of("gauge", "{gauge}_amplitude", "N", "amplitude", "force amplitude at {gauge}", PULSE)
def _(gauge: GaugeReadings) -> float:
    """A = s(t_p)."""
    return gauge.first.value


@_of("gauge", "{gauge}_peak", "N", "peak", "peak force at {gauge}", PULSE)
def _(gauge: GaugeReadings) -> float:
    """A + f(0)."""
    return gauge.first.value + float(gauge.reading[0])


@_of("gauge", "{gauge}_arrival", "s", "arrival", "arrival time at {gauge}", PULSE)
def _(gauge: GaugeReadings) -> float:
    """t_p."""
    return gauge.first.time_s


@_of("gauge", "{gauge}_front_arrival", "s", "front arrival", "arrival time of the front at {gauge}", PULSE)
def _(gauge: GaugeReadings) -> float:
    """Time at which s last rises through 0.02 A, before t_p."""
    return gauge.rise_s(ONSET)


@_of("gauge", "{gauge}_duration_{level}", "s", "duration", "pulse duration at {gauge}, cut at {level}", PULSE)
def _(gauge: GaugeReadings, level: float) -> float:
    """2 (t_p - t_l); before t_p, s last rises through the level times A at t_l."""
    return gauge.duration_s[level]


@_of("bead", "{gauge}_pulses", "", "count", "pulses at {gauge}", of_wave=False)
def _(gauge: GaugeReadings) -> float:
    """Number of pulses at a sensor bead that do not go up, before the reflected one."""
    return float(len(gauge.passing))


@_of("bead", "{gauge}_second_amplitude", "N", "second amplitude", "second amplitude at {gauge}", SECOND)
def _(gauge: GaugeReadings) -> float:
    """Signal s at the second of these pulses."""
    return gauge.second.value


@_of("bead", "{gauge}_second_arrival", "s", "second arrival", "second arrival time at {gauge}", SECOND)
def _(gauge: GaugeReadings) -> float:
    """Time of the second of these pulses."""
    return gauge.second.time_s


@_of("bead", "{gauge}_valley", "N", "valley", "force between pulses 1 and 2 at {gauge}", SECOND, of_wave=False)
def _(gauge: GaugeReadings) -> float:
    """Smallest sample of s between the first of these pulses and the second."""
    between = [peak.sample for peak in gauge.passing[:2]]
    return float(gauge.signal[slice(*between)].min()) if len(between) == 2 else nan


@_of("bead", "{gauge}_reflected_amplitude", "N", "reflected amplitude", "reflected amplitude at {gauge}", ECHO)
def _(gauge: GaugeReadings) -> float | None:
    """Signal s at the first pulse that goes up and is later than the wall's first pulse."""
    return gauge.reflected.value if gauge.run.layout.wall else None


@_of("bead", "{gauge}_reflected_arrival", "s", "reflected arrival", "reflected arrival time at {gauge}", ECHO)
def _(gauge: GaugeReadings) -> float | None:
    """Time of that pulse."""
    return gauge.reflected.time_s if gauge.run.layout.wall else None


@_of("wall", "wall_peak_{number}", "N", "later peak", "force maximum {number} at the wall", MAXIMUM)
def _(wall: GaugeReadings, number: int) -> float:
    """Force at the wall's next maxima (2, 3) with a prominence of at least 0.01 of the range."""
    return wall.maxima[number - 1].value if number <= len(wall.maxima) else nan


@_of("wall", "wall_envelope", "1/s", "rate", "rate of the envelope at the wall", TRAIN)
def _(wall: GaugeReadings) -> float:
    """Rate r of C exp(r t) through the wall's first three maxima, least squares of the logarithm."""
    return (train_envelope(wall.maxima) or (nan, nan))[0]


@_of("pair", "speed_{pair}", "m/s", "speed", "wave speed from bead {pair}", SPEED)
def _(lower: GaugeReadings) -> float:
    """(z_i - z_j) / (t_p,j - t_p,i) between neighbouring sensors i above j."""
    return lower.speed_m_s


@_of("pair", "transmission_{pair}", "", "transmission", "amplitude ratio per bead, bead {pair}", RATIO, of_wave=False)
def _(lower: GaugeReadings) -> float:
    """(A_j / A_i)^(1 / (i - j)) of neighbouring sensors: share passed on from bead to bead."""
    beads = lower.above.bead.from_wall - lower.bead.from_wall
    alone = isnan(lower.speed_m_s) or lower.bead.from_wall <= lower.run.layout.wall
    return nan if alone else (lower.first.value / lower.above.first.value) ** (1 / beads)


@_of("pair", "{gauge}_width_{level}", "diameters", "width", "pulse width at {gauge}, cut at {level}", WIDTH)
def _(lower: GaugeReadings, level: float) -> float:
    """Duration times speed from the sensor above, divided by d."""
    return lower.duration_s[level] * lower.speed_m_s / lower.bead.diameter_m


@_of("run", "contact_loss", "s", "contact loss", "first loss of contact", LOSS, of_wave=False)
def _(run: Readings) -> float | None:
    """First sample with an open contact that carries more than 1e-9 of the largest force at time 0."""
    force_N = run.trace.force_N[:, : run.trace.force_N.shape[1] - run.layout.striker]
    loaded = force_N[0] > run.rounding_N
    if not loaded.any():
        return None
    opened = ((force_N <= 0) & loaded).any(axis=1)
    return float(run.trace.time_s[int(np.argmax(opened))]) if opened.any() else nan


@_of("run", "kinetic_energy_start", "J", "energy", "kinetic energy at the start", of_wave=False)
def _(run: Readings) -> float:
    """Kinetic energy at time 0."""
    return float(run.trace.kinetic_energy_J[0])


@_of("run", "energy_drift", "J", "energy", "largest energy drift", of_wave=False)
def _(run: Readings) -> float:
    """Largest |E - E(0)|; with damping the largest gain over an earlier E, with friction over E(0)."""
    drift_J = energy_error_J(run.trace.total_energy_J, damped=run.layout.damped, slips=run.layout.slips)
    return float(drift_J.max())


@_of("run", "energy_lost", "J", "energy", "energy lost", ("", "damping or friction"), of_wave=False)
def _(run: Readings) -> float | None:
    """E(0) - E(end), with damping or friction."""
    energy_J, loses = run.trace.total_energy_J, run.layout.damped or run.layout.slips
    return float(energy_J[0] - energy_J[-1]) if loses else None


@_of("run", "momentum_start", "N s", "momentum", "momentum at the start", of_wave=False)
def _(run: Readings) -> float:
    """p(0)."""
    return float(run.trace.momentum_N_s[0])


@_of("run", "momentum_end", "N s", "momentum", "momentum at the end", of_wave=False)
def _(run: Readings) -> float:
    """Momentum p at the end."""
    return float(run.trace.momentum_N_s[-1])


@_of("run", "impulse_imbalance", "share", "balance", "imbalance of momentum and impulse", of_wave=False)
def _(run: Readings) -> float:
    """Largest |p - p(0) - I| / P, with I the integral of N from time 0."""
    return float(np.abs(run.gained_N_s - integral(run.trace.time_s, run.net_N)).max()) / run.scale_N_s


@_of(
    "run", "momentum_error_before_wall", "share", "balance", "momentum error before the wall is reached", of_wave=False
)
def _(run: Readings) -> float:
    """Largest |p - p(0) - N(0) t| / P until the force on the wall changes."""
    force_N = run.trace.force_N
    changed = np.abs(force_N[:, 0] - force_N[0, 0]) > WALL_REST_SHARE * float(np.abs(force_N).max())
    quiet = slice(int(np.argmax(changed)) if changed.any() else len(changed))  # N is static: no integral is needed
    return float(np.abs(run.gained_N_s - run.net_N[0] * run.trace.time_s)[quiet].max()) / run.scale_N_s


FIRST = [each for each in OBSERVABLES if each.kind in ("amplitude", "arrival", "speed", "transmission")]


def envelope(maxima: list[Peak]) -> tuple[float, float]:
    """Rate in 1/s and amplitude of an exponential through at least two maxima, by least squares of the logarithm."""
    rate, start = np.polyfit([peak.time_s for peak in maxima], np.log([peak.value for peak in maxima]), 1)
    return float(rate), float(np.exp(start))


def train_envelope(maxima: list[Peak], count: int = ENVELOPE_MAXIMA) -> tuple[float, float] | None:
    """The ``envelope`` of the first maxima of a train; None if there are fewer, or one is not above 0.

    Maxima of a train follow at similar intervals. If one interval is more than twice another, a maximum belongs to a
    reflection, and the result is None.
    """
    leading = maxima[:count]
    if len(leading) < count or min(peak.value for peak in leading) <= 0:
        return None
    intervals = np.diff([peak.time_s for peak in leading])
    return envelope(leading) if intervals.max() <= MAX_INTERVAL_RATIO * intervals.min() else None


def going_up(force_N: Array, from_wall: int, pulses: list[Peak]) -> list[Peak]:
    """Pulses at a bead that go up; the sum over the samples is proportional to the momentum that the bead gains.

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


def energy_error_J(energy_J: Array, *, damped: bool, slips: bool) -> Array:
    """Error of the total energy at each sample, in J.

    For elastic contacts the change since time 0; for damped contacts the gain above the smallest value so far. With
    friction the gain above the value at time 0, since shear energy is not included.
    """
    if slips:
        return np.asarray(np.maximum(energy_J - energy_J[0], 0.0))
    return np.asarray(energy_J - np.fmin.accumulate(energy_J) if damped else np.abs(energy_J - energy_J[0]))


def observe(layout: Layout, trace: Trace, levels: tuple[float, ...] = LEVELS) -> dict[str, float]:
    """All observables of a run by name, with the unit at the end; NaN if the trace does not show an observable."""
    return _values(Readings(layout, trace, sensor_signals(layout, trace), levels), OBSERVABLES)


def first_pulses(layout: Layout, trace: Trace, signals: Mapping[str, Array]) -> dict[str, float]:
    """Those of ``observe`` that fits read most: amplitudes and arrivals of first pulses, speeds and ratios of them."""
    return _values(Readings(layout, trace, signals, most=1), FIRST)


def _values(readings: Readings, chosen: Iterable[Observable]) -> dict[str, float]:
    """Values of some observables by name; those of equal places in a row go place by place."""
    levels = [(f"{100 * level:g}pct", (level,)) for level in readings.levels]
    maxima = [(str(number), (number,)) for number in range(2, ENVELOPE_MAXIMA + 1)]
    numbers: dict[str, list[tuple[str, Any]]] = {"": [("", ())], "level": levels, "number": maxima}
    values: dict[str, float] = {}
    for places, alike in groupby(chosen, lambda observable: observable.places):
        for place, observable in product(readings.places[places], [*alike]):
            for text, number in numbers[observable.varies]:
                if (value := observable.read(place, *number)) is not None:
                    values[_name(observable, place.name, place.pair, text)] = value
    return values


@cache
def _name(observable: Observable, gauge: str, pair: str, number: str) -> str:
    """Name of a value; to make all of them takes a tenth of ``observe``."""
    return observable.pattern.format(gauge=gauge, pair=pair, level=number, number=number) + observable.ending


@cache
def describe(name: str) -> Observable:
    """The observable with this name, with or without its unit; for any other name a plain number without a kind."""
    matching = (observable for observable in OBSERVABLES if observable.match(name))
    return next(matching, Observable(name, "", "", name.replace("_", " "), of_wave=False))


def without_unit(name: str) -> str:
    """Name of an observable without its unit; any other name unchanged."""
    return name.removesuffix(describe(name).ending)


def not_shown(names: Iterable[str], rows: Sequence[Mapping[str, float]]) -> list[str]:
    """Lines that count the rows in which an observable is NaN or which do not have it, with the reason.

    Args:
        names: Names of observables.
        rows: Observables of each run by name.
    """
    lines = []
    for name in names:
        why, needed = describe(name).gaps
        unseen, absent = sum(isnan(row.get(name, 0.0)) for row in rows), sum(name not in row for row in rows)
        if unseen:
            lines.append(f"{name}: not seen in {unseen} of {len(rows)} rows: {why}")
        if absent:
            lines.append(f"{name}: not in {absent} of {len(rows)} rows: their scenes have no {needed}")
    return lines


def of_kind(names: Iterable[str], *kinds: str) -> list[str]:
    """Names of the observables of some kinds, in the order given."""
    return [name for name in names if describe(name).kind in kinds]


def scale_of(name: str, values: Mapping[str, float]) -> float:
    """Value that the error of an observable is relative to: its own, of a peak without the static load at the gauge.

    Args:
        name: Name of the observable, with or without its unit, as in ``values``.
        values: All observables of the run.
    """
    if describe(name).kind not in ("peak", "later peak"):
        return abs(values[name])
    gauge, _, rest = name.partition("_peak")
    unit = "_N" if rest.endswith("_N") else ""
    static_N = values[f"{gauge}_peak{unit}"] - values[f"{gauge}_amplitude{unit}"]
    return abs(values[name] - static_N)
