"""From a scene to a motion, computed here by the reference or run by the codes; from a run to its case.

Observables of ``postproc.read.observables`` follow the printed paper: a duration is twice the rise, an envelope passes
through a list of maxima. A duration of that kind cannot fail, and a list of maxima changes by jumps. The readings of
``READERS`` change continuously with the parameters of the motion, as least squares need them:

- the full width at a cut is the time for which the gauge is above this share of its peak before the wave reaches
  the wall. If the force has not fallen so low until then, the width is censored: this time is its lower bound;
- the decay at the wall is the rate of the lowest exponential above the force, from the first maximum at t1 until
  1.75 t1, which is the third maximum of the elastic chain of Fig. 5. It is the expectile of ``log F`` with the
  asymmetry ``ABOVE`` (Newey & Powell, Econometrica 55, 819): a least-squares line on which a point above it weighs
  ``ABOVE / (1 - ABOVE)`` times as much as one below. The elastic chain of 1.46 GPa gives -0.00590 per us, the paper
  -0.0059.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from math import nan
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from drivers.base.errors import InputError
from drivers.chain.case import Case, build_case
from drivers.chain.chain import Array
from drivers.chain.schemes import exact_of
from drivers.chain.trace import Trace
from drivers.engines import REFERENCE, installed_codes
from drivers.run.run import run_all_done
from drivers.run.run_folder import EndedRun
from drivers.scene.read_scene import read_scene, stored_scene
from postproc.read.observables import first_pulses, observe
from postproc.read.signals import first_peak, sensor_signals, signals_csv, spline

if TYPE_CHECKING:
    from scipy.interpolate import BSpline

UNTIL_REFLECTED = "run.duration=0.9 ms"  # until the reflected wave has passed, in Figs. 4 and 6
TOLERANCE = 1e-11  # of the largest change: far below the truncation error of any code's run
ABOVE = 0.999  # asymmetry of the expectile
WINDOW = 0.75  # of the arrival time at the wall, after the first maximum
POINTS = 301  # of the window
FLOOR = 1e-3  # of the first maximum: lower forces count as this
MAX_ROUNDS = 100  # of the expectile
CUBIC = np.linalg.inv(np.vander(np.arange(4.0), increasing=True))  # coefficients from values at 0, 1, 2, 3
NEWTON_STEPS = 3


class _Observables(dict[str, float]):
    """Observables by name; a missing one is an InputError that names the scene."""

    def __init__(self, values: dict[str, float], scene: str) -> None:
        super().__init__(values)
        self.scene = scene

    def __missing__(self, name: str) -> float:
        found = f"sensors that do not give {name}"
        raise InputError(self.scene, "chain.sensors", found, "the sensors of the paper's scene")


@dataclass(frozen=True)
class Simulation:
    """A case with the trace of one engine, and the seconds of the time loop if a code ran."""

    case: Case
    engine: str
    trace: Trace
    loop_s: float = nan

    @cached_property
    def values(self) -> dict[str, float]:
        """Observables of the trace; a missing one raises an InputError that names the scene."""
        return _Observables(observe(self.case.layout, self.trace), self.case.scene.file)

    @cached_property
    def signals(self) -> dict[str, Array]:
        """Gauge signals by name."""
        return sensor_signals(self.case.layout, self.trace)

    @cached_property
    def curves(self) -> dict[str, "BSpline"]:
        """Splines of the changes of the gauge signals by name."""
        changes = {gauge: signal - signal[0] for gauge, signal in self.signals.items()}
        return {gauge: spline(self.trace.time_s, change) for gauge, change in changes.items()}

    @cached_property
    def first(self) -> dict[str, float]:
        """Amplitudes, arrivals and speeds of the first pulses, without all other observables."""
        return first_pulses(self.case.layout, self.trace, self.signals)


def case_of(source: str | Path, *settings: str) -> Case:
    """The case of a scene with settings."""
    return build_case(read_scene(source, settings))


def exact(case: Case, tolerance: float = TOLERANCE) -> Simulation:
    """Exact motion with positions, computed in some milliseconds without a run folder."""
    return Simulation(case, REFERENCE, exact_of(case, tolerance))


def run_codes(cases: Mapping[str, Sequence[Case]], runs: Path) -> dict[str, list[Simulation]]:
    """Simulations by code, run in parallel; the gauge signals are written into each run folder.

    Raises:
        InputError: A case is refused on its code; nothing runs.
        RunError: A run failed; the others are finished first.
    """
    jobs = [(case, code) for code in cases for case in cases[code]]
    simulations: dict[str, list[Simulation]] = {code: [] for code in cases}
    for (case, code), ended in zip(jobs, run_all_done(jobs, runs), strict=True):
        if not ended.has_sensors:
            ended.with_sensors(signals_csv(ended.layout, ended.trace))
        simulations[code].append(Simulation(case, code, ended.trace, ended.record.loop_s or nan))
    return simulations


def simulate(cases: Sequence[Case], runs: Path) -> list[dict[str, Simulation]]:
    """Each case on every installed code, and last on the reference: simulations by engine."""
    by_engine = run_codes(dict.fromkeys(installed_codes(), cases), runs) | {REFERENCE: [exact(case) for case in cases]}
    return [{engine: some[place] for engine, some in by_engine.items()} for place in range(len(cases))]


def case_of_run(run: EndedRun) -> Case:
    """The case of a run, from the scene in its record."""
    return replace(build_case(stored_scene(run.record.scene)), digits=run.record.digits)


def trace_with_state(run: EndedRun) -> Trace:
    """Trace of a run with positions and velocities, if the run recorded them.

    Raises:
        InputError: a file is missing or damaged.
    """
    return run.state if run.has_state else run.trace


def spread(samples: int, frames: int) -> list[int]:
    """Indices of ``frames`` samples spread evenly over a run, with both ends; all samples if there are fewer."""
    return [int(place) for place in np.unique(np.linspace(0, samples - 1, min(frames, samples)).round())]


def full_width_s(simulation: Simulation, gauge: str, cut: float) -> float:
    """Full width of the first pulse in s, or its lower bound; NaN if a pulse is missing."""
    values, signal = simulation.first, simulation.signals[gauge]
    level, end_s = cut * values[f"{gauge}_amplitude_N"], values["wall_arrival_s"]
    return time_above(simulation.trace.time_s, signal - signal[0], level, end_s)


def is_censored(simulation: Simulation, gauge: str, cut: float) -> bool:
    """True if the force is still above the cut when the wave reaches the wall."""
    values, signal = simulation.first, simulation.signals[gauge]
    last = np.interp(values["wall_arrival_s"], simulation.trace.time_s, signal - signal[0])
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
    ends = np.concatenate([[0.0], crossings[crossings < end_s], [end_s]])
    return float(np.diff(ends)[int(above[0] <= 0) :: 2].sum())


def _root(values: Array, place: int) -> float:
    """Share of the interval after a sample at which the cubic through four samples is zero, by Newton's method."""
    first = min(max(place - 1, 0), len(values) - 4)
    a, b, c, d = (CUBIC @ values[first : first + 4]).tolist()
    share = place - first + float(values[place] / (values[place] - values[place + 1]))
    for _ in range(NEWTON_STEPS):
        share -= (a + share * (b + share * (c + share * d))) / (b + share * (2 * c + share * 3 * d))
    return min(max(share - (place - first), 0.0), 1.0)


def contact_force_N(simulation: Simulation, gauge: str, cut: float) -> float:
    """The paper's F_m of Eq. (6): beta times the gauge's amplitude plus the static load of the contact above the bead.

    The factor beta, amplitude at that contact divided by that of the mean of both contacts, is of the same motion.
    """
    layout, trace = simulation.case.layout, simulation.trace
    force_N = trace.force_N[:, int(gauge.removeprefix("bead_"))]
    plain = sensor_signals(replace(layout, time_constant_s=None), trace)[gauge]
    contact, mean = (first_peak(trace.time_s, signal - signal[0]) for signal in (force_N, plain))
    return float(contact.value / mean.value * simulation.first[f"{gauge}_amplitude_N"] + force_N[0])


def decay_per_s(simulation: Simulation, gauge: str, cut: float) -> float:
    """Rate of the lowest exponential above the force at a gauge in 1/s; NaN if the motion ends before."""
    trace, first_s = simulation.trace, simulation.first[f"{gauge}_arrival_s"]
    times = first_s * np.linspace(1.0, 1.0 + WINDOW, POINTS)
    if not times[-1] <= trace.time_s[-1]:
        return nan
    force = spline(trace.time_s, simulation.signals[gauge], 3)(times)
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


READERS: dict[str, Callable[[Simulation, str, float], float]] = {
    "_full_width_s": full_width_s,
    "_contact_force_N": contact_force_N,
    "_decay_per_s": decay_per_s,
}


def read(simulation: Simulation, name: str, cut: float) -> float:
    """A reading, or an observable, of a motion by its name with the unit; NaN if the motion does not show it.

    Raises:
        InputError: The scene's runs have neither.
    """
    for ending, reader in READERS.items():
        if name.endswith(ending):
            return reader(simulation, name.removesuffix(ending), cut)
    return simulation.first[name] if name in simulation.first else simulation.values[name]
