"""What the experiment would have shown: from the elastic line to tube, friction, restitution and gauge."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from drivers.chain.case import Case
from drivers.chain.chain import Array
from drivers.run.many import run_all_done
from postproc.read.observables import observe
from postproc.read.sensors import sensor_signals
from validation.elements.switches import Side, Subject, case_on

FRICTIONLESS = ("contact.friction=0", "tube.friction=0")
RESTITUTION = "contact.restitution=0.9"
GAUGE = "sensor.time_constant=1 ms"  # RC of about 1e3 us, as the paper has it
# each step has all that those before it have
STEPS = {
    "elastic line": Side(),
    "tube": Side(tube=True, set=FRICTIONLESS),
    "friction 0.05": Side(tube=True),
    "restitution 0.9": Side(tube=True, set=(RESTITUTION,)),
    "gauge of 1 ms": Side(tube=True, set=(RESTITUTION, GAUGE)),
}
# one parameter at a time, over the range in which it is known
RANGES = {
    "friction": ("friction 0.05", ("tube.friction={0}", "contact.friction={0}"), (0.0, 0.04, 0.1)),
    "restitution": ("restitution 0.9", ("contact.restitution={0}",), (1.0, 0.95, 0.9, 0.8, 0.7)),
}


@dataclass(frozen=True)
class Shown:
    """What gauges show after one step, over the seeds.

    Attributes:
        signals: by gauge, shape (seeds, samples).
        values: observables, shape (seeds,).
    """

    scene: str
    step: str
    time_s: Array
    signals: dict[str, Array]
    values: dict[str, Array]


def watch(subjects: Iterable[Subject], seeds: int, engine: str, runs: Path, say: Callable[[str], None]) -> list[Shown]:
    """All steps of all scenes on one code."""
    found = []
    for subject in subjects:
        say(f"{subject.name}: {len(STEPS)} steps of {seeds} seeds on {engine}")
        for step, side in STEPS.items():
            count = seeds if side.tube else 1
            cases = [case_on(subject, side, seed) for seed in range(1, count + 1)]
            found.append(_shown(subject.name, step, cases, engine, runs))
    return found


def vary(
    subjects: Iterable[Subject], seeds: int, engine: str, runs: Path, say: Callable[[str], None]
) -> list[tuple[str, float, Shown]]:
    """One parameter at a time over its range: its name, its value, and what gauges show."""
    found = []
    for subject in subjects:
        for name, (step, settings, values) in RANGES.items():
            say(f"{subject.name}: {name} from {values[0]:g} to {values[-1]:g}")
            for value in values:
                more = tuple(setting.format(value) for setting in settings)
                cases = [case_on(subject, STEPS[step], seed, *more) for seed in range(1, seeds + 1)]
                found.append((name, value, _shown(subject.name, name, cases, engine, runs)))
    return found


def _shown(scene: str, step: str, cases: list[Case], engine: str, runs: Path) -> Shown:
    traces, values = [], []
    for case, ended in zip(cases, run_all_done([(case, engine) for case in cases], runs), strict=True):
        traces.append(sensor_signals(case.layout, ended.trace))
        values.append(observe(case.layout, ended.trace))
    signals = {name: np.array([each[name] for each in traces]) for name in traces[0]}
    return Shown(
        scene,
        step,
        cases[0].sample_times_s,
        signals,
        {name: np.array([each[name] for each in values]) for name in values[0]},
    )
