"""Simulations of a case by the reference, computed here, and by the codes, run in parallel."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from math import nan
from pathlib import Path

from scipy.interpolate import BSpline, make_interp_spline

from drivers.base.errors import InputError
from drivers.chain.case import Case, build_case
from drivers.chain.chain import Array
from drivers.chain.schemes import exact_of
from drivers.chain.trace import Trace
from drivers.engines import REFERENCE, installed_codes
from drivers.run.run import run_all_done
from drivers.scene.read_scene import read_scene
from postproc.read.observables import first_pulses, observe
from postproc.read.sensors import sensor_signals, signals_csv

UNTIL_REFLECTED = "run.duration=0.9 ms"  # until the reflected wave has passed, in Figs. 4 and 6
TOLERANCE = 1e-11  # of the largest change: far below the truncation error of any code's run


class _Observables(dict[str, float]):
    """Observables by name; a missing one is an InputError that names the scene."""

    def __init__(self, values: dict[str, float], scene: str) -> None:
        super().__init__(values)
        self.scene = scene

    def __missing__(self, name: str) -> float:
        raise InputError(
            self.scene, "chain.sensors", f"sensors that do not give {name}", "the sensors of the paper's scene"
        )


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
    def curves(self) -> dict[str, BSpline]:
        """Splines of the changes of the gauge signals by name."""
        changes = {gauge: signal - signal[0] for gauge, signal in self.signals.items()}
        return {gauge: make_interp_spline(self.trace.time_s, change, k=5) for gauge, change in changes.items()}

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


def run_codes_on(cases: Sequence[Case], runs: Path) -> dict[str, list[Simulation]]:
    """The same cases on every installed code."""
    return run_codes(dict.fromkeys(installed_codes(), cases), runs)


def simulate(cases: Sequence[Case], runs: Path) -> list[dict[str, Simulation]]:
    """Each case on every installed code, and last on the reference: simulations by engine."""
    by_engine = run_codes_on(cases, runs) | {REFERENCE: [exact(case) for case in cases]}
    return [{engine: some[place] for engine, some in by_engine.items()} for place in range(len(cases))]
