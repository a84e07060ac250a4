"""The chains whose limits are measured: the paper's, sweeps over one parameter each, and random ones."""

from collections.abc import Iterator
from dataclasses import dataclass
from math import nan

import numpy as np

from drivers.chain.case import Case
from drivers.limits.energy_bounds import at_most
from drivers.limits.stable_step import reached, stable_step
from postproc.paper.simulate import case_of
from validation.stability.random_scenes import random_case

PAPER = ("fig4", "fig5", "fig6b", "fig6d", "table1")
SHIPPED, RANDOM, BOUNCING = "shipped scenes", "random scenes", "impacts"
BASE = "fig4"
# key of the scene, unit, values; by what the axis of a figure says
SWEEPS = {
    "striker speed, m/s": ("striker.speed", "m/s", np.geomspace(1e-6, 50, 12)),
    "Young's modulus, Pa": ("materials.ptfe.youngs_modulus", "Pa", np.geomspace(1e6, 1e12, 9)),
    "striker over bead mass": ("striker.mass", "kg", 0.1226e-3 * np.geomspace(1e-3, 1e3, 9)),
    "Young's modulus of the wall, Pa": ("materials.brass.youngs_modulus", "Pa", np.geomspace(1e6, 1e13, 8)),
}
BEAD_KG = 0.1226e-3
TRAVERSE = 45.0  # limits that a scene of a sweep lasts: the wave comes to the wall and back, as in the paper's scene


@dataclass(frozen=True)
class Subject:
    """A chain to measure.

    Attributes:
        value: of the parameter that a sweep varies.
        whole_scan: codes are scanned from small steps on, as Verlet is.
    """

    group: str
    name: str
    case: Case
    value: float = nan
    whole_scan: bool = False


def shipped() -> Iterator[Subject]:
    """The paper's scenes and two more."""
    for name in (*PAPER, "low-amplitude", "steel-chain"):
        yield Subject(SHIPPED, name, case_of(name), whole_scan=name in PAPER)


def sweeps() -> Iterator[Subject]:
    """One parameter at a time over decades."""
    for group, (key, unit, values) in SWEEPS.items():
        for value in values:
            setting = f"{key}={value:.6g} {unit}"
            rough = case_of(BASE, setting)
            duration = TRAVERSE * stable_step(rough.chain, at_most(rough.chain, float(rough.sample_times_s[-1])))
            interval = duration / 800
            timing = (f"run.duration={duration:.6g} s", f"run.sample_interval={interval:.6g} s")
            case = case_of(BASE, setting, *timing, f"run.time_step={interval:.6g} s")
            yield Subject(group, f"{BASE} {setting}", case, value / BEAD_KG if unit == "kg" else float(value))


def bouncing() -> Iterator[Subject]:
    """A bead that falls on the wall again and again: errors of impacts add up."""
    for duration_ms in (5, 50, 500):
        settings = ("chain.count=0", "chain.sensors=[]", "gravity=981 m/s^2", "striker.speed=0.5 m/s")
        case = case_of(BASE, *settings, f"run.duration={duration_ms} ms", "run.time_step=1 us")
        impacts = reached(case.chain, float(case.sample_times_s[-1])).impacts
        yield Subject(BOUNCING, f"a bead that bounces {impacts:.0f} times", case, impacts)


def at_random(count: int) -> Iterator[Subject]:
    """Random scenes, the first so many of an endless row."""
    for number in range(count):
        yield Subject(RANDOM, f"random {number}", random_case(number, accuracy=0.1))
