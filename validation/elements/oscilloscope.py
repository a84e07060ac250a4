"""What the experiment would have shown: from the elastic line to tube, friction, restitution and gauge."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from drivers.chain.case import Case
from drivers.chain.chain import Array
from postproc.paper.simulate import run_codes
from postproc.read.sensors import sensor_signals
from validation.elements.switches import Side, Subject, seeded, spread_of
from validation.studies import progress

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
class Number:
    """One observable after one step, or at one value of a parameter: mean and spread over the seeds."""

    scene: str
    step: str
    value: str
    observable: str
    mean: float
    spread: float
    seeds: int


@dataclass(frozen=True)
class Shown:
    """What gauges show after one step, or at one value of a parameter, over the seeds.

    Attributes:
        signals: by gauge, shape (seeds, samples).
        values: observables, shape (seeds,).
    """

    scene: str
    step: str
    value: str
    time_s: Array
    signals: dict[str, Array]
    values: dict[str, Array]

    @property
    def numbers(self) -> Iterator[Number]:
        """Its observables as rows."""
        for name, values in self.values.items():
            yield Number(self.scene, self.step, self.value, name, *spread_of(values), len(values))


def add_steps(subject: Subject, seeds: int, engine: str, runs: Path) -> Iterator[Shown]:
    """All steps of a scene on one code."""
    progress(f"{subject.name}: {len(STEPS)} steps of {seeds} seeds on {engine}")
    for step, side in STEPS.items():
        yield _shown(subject.name, step, "", seeded(subject, side, seeds if side.tube else 1), engine, runs)


def vary(subject: Subject, seeds: int, engine: str, runs: Path) -> Iterator[Shown]:
    """One parameter at a time over its range."""
    for name, (step, settings, values) in RANGES.items():
        progress(f"{subject.name}: {name} from {values[0]:g} to {values[-1]:g}")
        for value in values:
            cases = seeded(subject, STEPS[step], seeds, *(setting.format(value) for setting in settings))
            yield _shown(subject.name, name, f"{value:g}", cases, engine, runs)


def _shown(scene: str, step: str, value: str, cases: list[Case], engine: str, runs: Path) -> Shown:
    done = run_codes({engine: cases}, runs)[engine]
    shown = [sensor_signals(case.layout, run.trace) for case, run in zip(cases, done, strict=True)]
    signals = {name: np.array([each[name] for each in shown]) for name in shown[0]}
    values = {name: np.array([run.values[name] for run in done]) for name in done[0].values}
    return Shown(scene, step, value, cases[0].sample_times_s, signals, values)
