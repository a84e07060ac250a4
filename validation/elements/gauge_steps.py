"""Gauge signals, step by step from the elastic line to the experiment: tube, restitution, electronics; and the fit."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from functools import cache

import numpy as np

from postproc.paper.calibrated import calibrated
from validation.elements.switches import Found, Side, SwitchedScene, Variant, runs_of, seeded, spread_of

RESTITUTION = "contact.restitution=0.9"
GAUGE = "sensor.time_constant=1 ms"  # RC of about 1e3 us, as the paper has it
ELASTIC, TUBE, DAMPED, FITTED = "elastic line", "tube with friction 0.05", "restitution 0.9", "fit"
# by parameter: its step, its settings, values over the known range
RANGES = {
    "friction": (TUBE, ("tube.friction={0}", "contact.friction={0}"), (0.0, 0.04, 0.1)),
    "restitution": (DAMPED, ("contact.restitution={0}",), (1.0, 0.95, 0.9, 0.8, 0.7)),
}


@cache
def gauge_steps() -> dict[str, Side]:
    """Settings by step; each includes the steps before, except the fit, a straight chain with fitted parameters."""
    return {
        ELASTIC: Side(),
        TUBE: Side(tube=True),
        DAMPED: Side(tube=True, set=(RESTITUTION,)),
        "gauge of 1 ms": Side(tube=True, set=(RESTITUTION, GAUGE)),
        FITTED: Side(set=calibrated().settings),
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


def add_steps(subject: SwitchedScene, seeds: int) -> Iterator[Variant]:
    """Variants of a scene, one per step; straight chains do not depend on the seed."""
    for step, side in gauge_steps().items():
        yield Variant(subject.name, step, seeded(subject, side, seeds if side.tube else 1))


def vary(subject: SwitchedScene, seeds: int) -> Iterator[Variant]:
    """Variants of a scene, one per value of each parameter."""
    for name, (step, settings, values) in RANGES.items():
        for value in values:
            changed = (setting.format(value) for setting in settings)
            yield Variant(subject.name, name, seeded(subject, gauge_steps()[step], seeds, *changed), f"{value:g}")


def rows_of(variants: Iterable[Variant], engine: str, ran: Found) -> Iterator[StepRow]:
    """Observables of variants on one code."""
    for variant in variants:
        runs = runs_of(variant, engine, ran)
        for name in runs[0].values:
            values = np.array([run.values[name] for run in runs])
            yield StepRow(variant.scene, variant.step, variant.value, name, *spread_of(values), len(values))
