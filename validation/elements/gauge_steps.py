"""Gauge signals, step by step from the elastic line to the experiment: tube, friction, restitution, electronics."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from drivers.chain.chain import Array
from postproc.read.sensors import sensor_signals
from validation.elements.switches import FRICTIONLESS, Found, Side, SwitchedScene, Variant, seeded, spread_of

RESTITUTION = "contact.restitution=0.9"
GAUGE = "sensor.time_constant=1 ms"  # RC of about 1e3 us, as the paper has it
# each step includes the steps before
STEPS = {
    "elastic line": Side(),
    "tube": Side(tube=True, set=FRICTIONLESS),
    "friction 0.05": Side(tube=True),
    "restitution 0.9": Side(tube=True, set=(RESTITUTION,)),
    "gauge of 1 ms": Side(tube=True, set=(RESTITUTION, GAUGE)),
}
# by parameter: its step, its settings, values over the known range
RANGES = {
    "friction": ("friction 0.05", ("tube.friction={0}", "contact.friction={0}"), (0.0, 0.04, 0.1)),
    "restitution": ("restitution 0.9", ("contact.restitution={0}",), (1.0, 0.95, 0.9, 0.8, 0.7)),
}


@dataclass(frozen=True)
class StepRow:
    """One observable after one step, or at one value of a parameter; mean and standard deviation over the seeds."""

    scene: str
    step: str
    value: str
    observable: str
    mean: float
    spread: float
    seeds: int


@dataclass(frozen=True)
class GaugeSignals:
    """Signals and observables after one step, or at one value of a parameter.

    Attributes:
        signals: forces by gauge in N, shape (seeds, samples).
        values: observables by name, shape (seeds,).
    """

    scene: str
    step: str
    value: str
    time_s: Array
    signals: dict[str, Array]
    values: dict[str, Array]

    @property
    def numbers(self) -> Iterator[StepRow]:
        """The observables as rows."""
        for name, values in self.values.items():
            yield StepRow(self.scene, self.step, self.value, name, *spread_of(values), len(values))


def add_steps(subject: SwitchedScene, seeds: int) -> Iterator[Variant]:
    """Variants of a scene, one per step; the elastic line does not depend on the seed."""
    for step, side in STEPS.items():
        yield Variant(subject.name, step, seeded(subject, side, seeds if side.tube else 1))


def vary(subject: SwitchedScene, seeds: int) -> Iterator[Variant]:
    """Variants of a scene, one per value of each parameter."""
    for name, (step, settings, values) in RANGES.items():
        for value in values:
            cases = seeded(subject, STEPS[step], seeds, *(setting.format(value) for setting in settings))
            yield Variant(subject.name, name, cases, f"{value:g}")


def read_gauges(variant: Variant, engine: str, found: Found) -> GaugeSignals:
    """Signals and observables of a variant on one code."""
    done = [found[case, engine] for case in variant.cases]
    shown = [sensor_signals(run.case.layout, run.trace) for run in done]
    signals = {name: np.array([each[name] for each in shown]) for name in shown[0]}
    values = {name: np.array([run.values[name] for run in done]) for name in done[0].values}
    return GaugeSignals(variant.scene, variant.step, variant.value, done[0].case.sample_times_s, signals, values)
