"""Observables of a run: peaks, arrival times, speeds, widths, reflections, energies and momentum.

All observables of waves are read from the gauge signals. A ``peak`` is the force itself. An ``amplitude`` is the peak
above the signal at time 0, which is the static load; a gauge behind electronics shows no static load. The first pulse
at a gauge is the incident wave. The reflected wave is the first pulse after the wall's first peak that goes up: while
it rises, the contacts push the bead upwards. ``pulses`` counts the pulses before the reflected wave that do not go up.
``beads observables --definitions`` prints the definition of every observable.
"""

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from math import isnan

import numpy as np

from drivers.chain.case import Layout
from drivers.chain.chain import Array
from drivers.chain.trace import Trace, is_at_rest
from postproc.read.sensors import going_up, sensor_signals
from postproc.read.signals import (
    ENVELOPE_MAXIMA,
    ONSET,
    first_pulse,
    integral,
    peaks,
    pulses,
    rising_crossing,
    train_envelope,
)  # fmt: skip

LEVELS = (0.002, 0.04)  # shares of the peak at which the paper's Table 1 cuts the width
WALL_REST_SHARE = 1e-14  # of the largest force: smaller changes at the wall are rounding
LATER_PROMINENCE = 0.01  # of the signal's range, for maxima after the first: damping makes them small
ROUNDING_SHARE = 1e-9  # of the largest force: a signal that changes by less is at rest
# reasons why an observable is NaN, and the things without which a scene's runs do not have the observable
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


@dataclass(frozen=True)
class Observable:
    """A number of a run."""

    pattern: str  # name without the unit; placeholders such as {gauge} depend on the scene
    unit: str  # empty for a plain number
    kind: str  # observables of one kind share a tolerance
    words: str  # name in figures and tables
    of_wave: bool = True  # read from pulses; its relative error measures the accuracy of a run
    gaps: tuple[str, str] = ("", "such gauge")  # why it is NaN, empty if never; the thing that it needs in a scene

    @property
    def ending(self) -> str:
        """The unit as the ending of a name, such as ``_m_s``."""
        return "_" + re.sub("[/ ]", "_", self.unit.replace("1/", "per ")) if self.unit else ""

    def match(self, name: str) -> re.Match[str] | None:
        """Match of a name, with or without the unit, with the placeholders as groups; None for any other name."""
        fields = {field: f"(?P<{field}>{pattern})" for field, pattern in PLACEHOLDERS.items()}
        return re.fullmatch(f"{self.pattern.format(**fields)}(?:{self.ending})?", name)


PLACEHOLDERS = {"gauge": r"bead_\d+|wall", "level": r"[\d.e+-]+pct", "number": r"\d+", "pair": r"\d+_to_\d+"}
OBSERVABLES = (
    Observable("{gauge}_static", "N", "static force", "static force at {gauge}", of_wave=False),
    Observable("{gauge}_amplitude", "N", "amplitude", "force amplitude at {gauge}", gaps=PULSE),
    Observable("{gauge}_peak", "N", "peak", "peak force at {gauge}", gaps=PULSE),
    Observable("{gauge}_arrival", "s", "arrival", "arrival time at {gauge}", gaps=PULSE),
    Observable("{gauge}_duration_{level}", "s", "duration", "pulse duration at {gauge}, cut at {level}", gaps=PULSE),
    Observable("{gauge}_width_{level}", "diameters", "width", "pulse width at {gauge}, cut at {level}", gaps=WIDTH),
    Observable("{gauge}_front_arrival", "s", "front arrival", "arrival time of the front at {gauge}", gaps=PULSE),
    Observable("{gauge}_pulses", "", "count", "pulses at {gauge}", of_wave=False),
    Observable("{gauge}_second_amplitude", "N", "second amplitude", "second amplitude at {gauge}", gaps=SECOND),
    Observable("{gauge}_second_arrival", "s", "second arrival", "second arrival time at {gauge}", gaps=SECOND),
    Observable("{gauge}_valley", "N", "valley", "force between pulses 1 and 2 at {gauge}", of_wave=False, gaps=SECOND),
    Observable("{gauge}_reflected_amplitude", "N", "reflected amplitude", "reflected amplitude at {gauge}", gaps=ECHO),
    Observable("{gauge}_reflected_arrival", "s", "reflected arrival", "reflected arrival time at {gauge}", gaps=ECHO),
    Observable("wall_peak_{number}", "N", "later peak", "force maximum {number} at the wall", gaps=MAXIMUM),
    Observable("wall_envelope", "1/s", "rate", "rate of the envelope at the wall", gaps=TRAIN),
    Observable("speed_{pair}", "m/s", "speed", "wave speed from bead {pair}", gaps=SPEED),
    Observable(
        "transmission_{pair}", "", "transmission", "amplitude ratio per bead, bead {pair}", of_wave=False, gaps=RATIO
    ),
    Observable("contact_loss", "s", "contact loss", "first loss of contact", of_wave=False, gaps=LOSS),
    Observable("kinetic_energy_start", "J", "energy", "kinetic energy at the start", of_wave=False),
    Observable("energy_drift", "J", "energy", "largest energy drift", of_wave=False),
    Observable("energy_lost", "J", "energy", "energy lost", of_wave=False, gaps=("", "damping or friction")),
    Observable("energy_error_before_wall", "J", "energy", "energy error before the wall is reached", of_wave=False),
    Observable("momentum_start", "N s", "momentum", "momentum at the start", of_wave=False),
    Observable("momentum_end", "N s", "momentum", "momentum at the end", of_wave=False),
    Observable(
        "momentum_error_before_wall", "share", "balance", "momentum error before the wall is reached", of_wave=False
    ),
    Observable("impulse_imbalance", "share", "balance", "imbalance of momentum and impulse", of_wave=False),
    Observable("impulse_sampling", "share", "balance", "impulse error by sampling", of_wave=False),
)
# symbols and terms of the definitions
SYMBOLS = """\
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
above a wall, where a wave and its reflection coincide, no pulse goes up."""
DEFINITIONS = {
    "{gauge}_static_N": "f(0)",
    "{gauge}_amplitude_N": "A = s(t_p)",
    "{gauge}_peak_N": "A + f(0)",
    "{gauge}_arrival_s": "t_p",
    "{gauge}_duration_{level}_s": "2 (t_p - t_l); before t_p, s last rises through the level times A at t_l",
    "{gauge}_width_{level}_diameters": "duration times speed from the sensor above, divided by d",
    "{gauge}_front_arrival_s": "time at which s last rises through 0.02 A, before t_p",
    "{gauge}_pulses": "number of pulses at a sensor bead that do not go up, before the reflected one",
    "{gauge}_second_amplitude_N": "s at the second of these pulses",
    "{gauge}_second_arrival_s": "time of the second of these pulses",
    "{gauge}_valley_N": "smallest sample of s between the first of these pulses and the second",
    "{gauge}_reflected_amplitude_N": "s at the first pulse that goes up and is later than the wall's first pulse",
    "{gauge}_reflected_arrival_s": "time of that pulse",
    "wall_peak_{number}_N": "force at the wall's next maxima (2, 3) with a prominence of at least 0.01 of the range",
    "wall_envelope_per_s": "rate r of C exp(r t) through the wall's first three maxima, least squares of the logarithm",
    "speed_{pair}_m_s": "(z_i - z_j) / (t_p,j - t_p,i) between neighbouring sensors i above j",
    "transmission_{pair}": "(A_j / A_i)^(1 / (i - j)) of neighbouring sensors: share passed on from bead to bead",
    "contact_loss_s": "first sample with an open contact that carries more than 1e-9 of the largest force at time 0",
    "kinetic_energy_start_J": "kinetic energy at time 0",
    "energy_drift_J": "largest |E - E(0)|; with damping the largest gain over an earlier E, with friction over E(0)",
    "energy_lost_J": "E(0) - E(end), with damping or friction",
    "energy_error_before_wall_J": "energy drift until the force on the wall changes",
    "momentum_start_N_s": "p(0)",
    "momentum_end_N_s": "p at the end",
    "momentum_error_before_wall_share": "largest |p - p(0) - N(0) t| / P until the force on the wall changes",
    "impulse_imbalance_share": "largest |p - p(0) - I| / P, with I the integral of N from time 0",
    "impulse_sampling_share": "largest change of I / P if every other sample is left out",
}


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


def observe(layout: Layout, trace: Trace, levels: tuple[float, ...] = LEVELS) -> dict[str, float]:
    """All observables of a run by name, with the unit at the end; NaN if the trace does not show an observable.

    Widths are ``2 (t_peak - t_level) V_s / 2R`` from the leading edge, in bead diameters, with the speed from the
    previous gauge. Speeds are peak to peak.
    """
    time = trace.time_s
    readings = sensor_signals(layout, trace)
    signals = {name: reading - reading[0] for name, reading in readings.items()}
    noise = ROUNDING_SHARE * float(np.abs(trace.force_N).max())
    pulses_of = {name: pulses(time, signal) if np.ptp(signal) > noise else [] for name, signal in signals.items()}
    values: dict[str, float] = {}
    for name, signal in signals.items():
        first = pulses_of[name][0] if pulses_of[name] else None
        static = values[f"{name}_static_N"] = float(readings[name][0])
        values[f"{name}_amplitude_N"] = first.value if first else np.nan
        values[f"{name}_peak_N"] = first.value + static if first else np.nan
        values[f"{name}_arrival_s"] = first.time_s if first else np.nan
        front_s = rising_crossing(time, signal, ONSET * first.value, first) if first else np.nan
        values[f"{name}_front_arrival_s"] = front_s
        for level in levels:
            edge_s = rising_crossing(time, signal, level * first.value, first) if first else np.nan
            values[f"{name}_duration_{_percent(level)}_s"] = 2 * (first.time_s - edge_s) if first else np.nan
    turned = (
        pulses_of["wall"][0].time_s if layout.wall and pulses_of["wall"] else np.inf
    )  # until then waves travel to the wall
    places = {f"bead_{sensor.from_wall}": sensor.from_wall for sensor in layout.sensors}
    rising = {  # at bead 1 a wave and its reflection coincide
        name: going_up(trace.force_N, place, pulses_of[name]) if place > 1 or not layout.wall else []
        for name, place in places.items()
    }
    for name, upwards in rising.items():
        back = next((peak for peak in upwards if peak.time_s > turned), None)
        before = pulses_of[name][: pulses_of[name].index(back)] if back else pulses_of[name]
        passing = [peak for peak in before if peak not in upwards] if layout.wall else before
        values[f"{name}_pulses"] = float(len(passing))
        one, two = passing[:2] if len(passing) > 1 else (None, None)
        values[f"{name}_second_amplitude_N"] = two.value if two else np.nan
        values[f"{name}_second_arrival_s"] = two.time_s if two else np.nan
        values[f"{name}_valley_N"] = float(signals[name][one.sample : two.sample].min()) if one and two else np.nan
        if layout.wall:
            values[f"{name}_reflected_amplitude_N"] = back.value if back else np.nan
            values[f"{name}_reflected_arrival_s"] = back.time_s if back else np.nan
    if layout.wall:
        later = [peak for peak in peaks(time, signals["wall"], LATER_PROMINENCE) if peak.time_s > turned]
        maxima = [*pulses_of["wall"][:1], *later][:ENVELOPE_MAXIMA]
        shown = [replace(peak, value=peak.value + values["wall_static_N"]) for peak in maxima]
        for number in range(2, ENVELOPE_MAXIMA + 1):
            values[f"wall_peak_{number}_N"] = shown[number - 1].value if number <= len(shown) else np.nan
        curve = train_envelope(shown)
        values["wall_envelope_per_s"] = curve.rate_per_s if curve else np.nan
    from_below = {name for name, upwards in rising.items() if pulses_of[name][:1] == upwards[:1] != []}
    values |= _speeds_and_widths(layout, values, levels, from_below)
    values |= _contact_loss(layout, trace, noise)
    values |= _balances(layout, trace)
    return values


def first_pulses(layout: Layout, trace: Trace, signals: Mapping[str, Array]) -> dict[str, float]:
    """Those of ``observe`` that fits read most: amplitudes and arrivals of first pulses, speeds and ratios of them."""
    values, from_below = dict[str, float](), set[str]()
    noise = ROUNDING_SHARE * float(np.abs(trace.force_N).max())
    for name, signal in signals.items():
        first = first_pulse(trace.time_s, signal - signal[0]) if np.ptp(signal) > noise else None
        values[f"{name}_amplitude_N"] = first.value if first else np.nan
        values[f"{name}_arrival_s"] = first.time_s if first else np.nan
        place = 0 if name == "wall" else int(name.removeprefix("bead_"))
        if first and place > layout.wall and going_up(trace.force_N, place, [first]):
            from_below.add(name)
    return values | _speeds_and_widths(layout, values, (), from_below)


def _contact_loss(layout: Layout, trace: Trace, noise_N: float) -> dict[str, float]:
    """Time of the first sample at which a contact that carries a load at time 0 is open; the striker's is left out."""
    between = trace.force_N[:, : trace.force_N.shape[1] - layout.striker]
    loaded = between[0] > noise_N
    if not loaded.any():
        return {}
    opened = ((between <= 0) & loaded).any(axis=1)
    return {"contact_loss_s": float(trace.time_s[int(np.argmax(opened))]) if opened.any() else np.nan}


def _percent(level: float) -> str:
    return f"{100 * level:g}pct"


def _speeds_and_widths(
    layout: Layout, values: dict[str, float], levels: tuple[float, ...], from_below: set[str]
) -> dict[str, float]:
    """Peak-to-peak speed and amplitude ratio per bead between neighbouring sensors, width at the lower sensor.

    ``transmission_9_to_5`` is ``(A_5 / A_9)^(1/4)``, the share of its amplitude that a wave passes on from bead to
    bead; NaN to bead 1 above a wall, where a wave and its reflection coincide. Both are NaN if the first pulse of
    either sensor goes up, or that of the lower sensor is not the later one: the pulses belong to different waves.
    """
    result: dict[str, float] = {}
    for upper, lower in zip(layout.sensors[:-1], layout.sensors[1:], strict=True):
        first, second = f"bead_{upper.from_wall}", f"bead_{lower.from_wall}"
        pair = f"{upper.from_wall}_to_{lower.from_wall}"
        travel = values[f"{second}_arrival_s"] - values[f"{first}_arrival_s"]
        same = travel > 0 and not {first, second} & from_below
        speed = result[f"speed_{pair}_m_s"] = (upper.height_m - lower.height_m) / travel if same else np.nan
        share = values[f"{second}_amplitude_N"] / values[f"{first}_amplitude_N"]
        steps = upper.from_wall - lower.from_wall
        passing = same and share > 0 and (lower.from_wall > 1 or not layout.wall)
        result[f"transmission_{pair}"] = share ** (1 / steps) if passing else np.nan
        for level in levels:
            duration = values[f"{second}_duration_{_percent(level)}_s"]
            result[f"{second}_width_{_percent(level)}_diameters"] = duration * speed / lower.diameter_m
    return result


def energy_error_J(energy_J: Array, *, damped: bool, slips: bool) -> Array:
    """Error of the total energy at each sample, in J.

    For elastic contacts the change since time 0; for damped contacts the gain above the smallest value so far. With
    friction the gain above the value at time 0, since shear energy is not included.
    """
    if slips:
        return np.asarray(np.maximum(energy_J - energy_J[0], 0.0))
    return np.asarray(energy_J - np.fmin.accumulate(energy_J) if damped else np.abs(energy_J - energy_J[0]))


def _balances(layout: Layout, trace: Trace) -> dict[str, float]:
    """Energy and momentum, and their deviation from conservation; with damping the largest gain of energy.

    Before the wave reaches the wall the force on the wall is static, so the exact momentum needs no integral. The
    imbalance over all times is |p - p(0) - impulse of wall, loads and drive|. Its sampling share is the change of the
    impulse if only every other sample is integrated.
    """
    time, energy, momentum = trace.time_s, trace.total_energy_J, trace.momentum_N_s
    net = layout.load_N + (trace.force_N[:, 0] if layout.wall else np.zeros_like(time))
    if trace.bore_friction_N is not None:
        net = net + trace.bore_friction_N
    impulse, coarse = integral(time, net), integral(time[::2], net[::2])
    undriven = momentum if trace.drive_impulse_N_s is None else momentum - trace.drive_impulse_N_s
    wall_N, largest_N = trace.force_N[:, 0], float(np.abs(trace.force_N).max())
    changed = np.abs(wall_N - wall_N[0]) > WALL_REST_SHARE * largest_N
    quiet = slice(0, int(np.argmax(changed)) if changed.any() else len(wall_N))
    steady = np.abs(undriven - undriven[0] - net[0] * time)[quiet]
    loads = abs(layout.load_N) * float(time[-1]) if is_at_rest(trace.force_N) else 0.0
    scale = max(float(np.abs(momentum).max()), layout.moving_N_s, loads) or 1.0
    drift = energy_error_J(energy, damped=layout.damped, slips=layout.slips)
    return {
        "kinetic_energy_start_J": float(trace.kinetic_energy_J[0]),
        "energy_drift_J": float(drift.max()),
        **({"energy_lost_J": float(energy[0] - energy[-1])} if layout.damped or layout.slips else {}),
        "momentum_start_N_s": float(momentum[0]),
        "momentum_end_N_s": float(momentum[-1]),
        "impulse_imbalance_share": float(np.abs(undriven - undriven[0] - impulse).max()) / scale,
        "momentum_error_before_wall_share": float(steady.max()) / scale,
        "energy_error_before_wall_J": float(drift[quiet].max()),
        "impulse_sampling_share": float(np.abs(impulse[::2] - coarse).max()) / scale,
    }
