"""From a scene to a motion, computed here by the reference or run by the codes; from a run to its chain."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from math import nan
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from drivers.base import paths
from drivers.base.errors import InputError
from drivers.chain.case import Case, build_case
from drivers.chain.chain import Array, Chain, build_chain
from drivers.chain.schemes import exact_of
from drivers.chain.trace import Trace
from drivers.engines import REFERENCE, installed_codes
from drivers.run.run import run_all_done
from drivers.run.run_folder import EndedRun
from drivers.scene.model import Scene
from drivers.scene.read_scene import read_scene, stored_scene
from postproc.read.observables import first_pulses, observe
from postproc.read.sensors import sensor_signals, signals_csv
from postproc.read.signals import spline

if TYPE_CHECKING:
    from scipy.interpolate import BSpline

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


def run_codes_on(cases: Sequence[Case], runs: Path) -> dict[str, list[Simulation]]:
    """The same cases on every installed code."""
    return run_codes(dict.fromkeys(installed_codes(), cases), runs)


def simulate(cases: Sequence[Case], runs: Path) -> list[dict[str, Simulation]]:
    """Each case on every installed code, and last on the reference: simulations by engine."""
    by_engine = run_codes_on(cases, runs) | {REFERENCE: [exact(case) for case in cases]}
    return [{engine: some[place] for engine, some in by_engine.items()} for place in range(len(cases))]


def chain_of(run: EndedRun) -> tuple[Scene, Chain]:
    """The scene of a run and its chain at time 0.

    Raises:
        InputError: The scene of the record is that of another version.
    """
    try:
        scene = stored_scene(run.record.scene)
        chain = build_chain(scene)
        if scene.three_dimensional:
            from drivers.chain.lateral import with_lateral  # imports scipy

            chain = with_lateral(scene, chain)
        if not np.isfinite([*chain.mass_kg, *chain.stiffness, *chain.velocity_m_s, *chain.load_N]).all():
            raise ValueError("masses, stiffnesses, velocities or loads that are no numbers")
    except (TypeError, LookupError, AttributeError, ValueError, ArithmeticError) as error:
        raise InputError(
            paths.shown(run.folder), "scene", "a record of another version", "the record of a run"
        ) from error
    return scene, chain


def trace_with_state(run: EndedRun) -> Trace:
    """Trace of a run with positions and velocities, if the run recorded them.

    Raises:
        InputError: a file is missing or damaged.
    """
    return run.state if run.has_state else run.trace


def spread(samples: int, frames: int) -> list[int]:
    """Indices of ``frames`` samples spread evenly over a run, with both ends; all samples if there are fewer."""
    return [int(place) for place in np.unique(np.linspace(0, samples - 1, min(frames, samples)).round())]
