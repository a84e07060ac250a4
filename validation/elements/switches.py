"""Which elements are switched, on which scenes: ``inputs/elements.toml``."""

from dataclasses import dataclass
from functools import cache
from math import nan

from pydantic import Field

from drivers.base import paths
from drivers.base.messages import validate
from drivers.chain.case import Case
from drivers.chain.chain import Array
from drivers.scene.model import Part
from drivers.scene.read_scene import read_toml
from postproc.paper.simulate import case_of

SCATTER = "scatter"  # in a setting: the scene's own


class Side(Part):
    """A scene with or without an element; ``tube``: its twin in a tube, with ``set`` laid over it."""

    tube: bool = False
    set: tuple[str, ...] = Field(default=(), strict=False)


class Element(Part):
    """What is switched; ``random`` draws are repeated for every seed, ``only`` names the scenes that have it."""

    name: str
    without: Side
    with_: Side = Field(alias="with")
    random: bool = False
    only: tuple[str, ...] = Field(default=(), strict=False)


class Subject(Part):
    """A scene, its twin in a tube being named after it; ``gauges`` are its sensors, ``scatter`` that of its masses."""

    name: str
    scatter: str
    gauges: str


class Elements(Part):
    """The whole file."""

    seeds: int
    quick_seeds: int
    scene: tuple[Subject, ...] = Field(strict=False)
    element: tuple[Element, ...] = Field(strict=False)


@dataclass(frozen=True, eq=False)
class Pair:
    """The two sides of a switch, without the element and with it, for one seed."""

    scene: str
    element: str
    cases: tuple[Case, ...]


def read_elements() -> Elements:
    """The elements to switch."""
    return validate(Elements, read_toml(paths.ELEMENTS), paths.shown(paths.ELEMENTS))


def pairs_of(elements: Elements, seeds: int) -> list[Pair]:
    """All switches of all scenes, random ones for the seeds from 1 on."""
    return [
        Pair(subject.name, switch.name, tuple(case_on(subject, side, seed) for side in (switch.without, switch.with_)))
        for subject in elements.scene
        for switch in elements.element
        if not switch.only or subject.name in switch.only
        for seed in range(1, (seeds if switch.random else 1) + 1)
    ]


@cache
def case_on(subject: Subject, side: Side, seed: int, *more: str) -> Case:
    """One side of a switch."""
    settings = [setting.replace(f"={SCATTER}", f"={subject.scatter}") for setting in side.set]
    source = f"{subject.name}-tube" if side.tube else subject.name
    return case_of(source, f"chain.sensors={subject.gauges}", f"seed={seed}", *settings, *more)


def seeded(subject: Subject, side: Side, seeds: int, *more: str) -> list[Case]:
    """One side of a switch for the seeds from 1 on."""
    return [case_on(subject, side, seed, *more) for seed in range(1, seeds + 1)]


def observables_of(case: Case) -> dict[str, str]:
    """What is looked at, by a word for it: speed, peak and width at the gauges, peak and arrival at the wall."""
    upper, lower = (sensor.from_wall for sensor in case.layout.sensors)
    return {
        "speed": f"speed_{upper}_to_{lower}_m_s",
        "sensor peak": f"bead_{upper}_peak_N",
        "wall peak": "wall_peak_N",
        "width": f"bead_{lower}_width_4pct_diameters",
        "arrival": "wall_arrival_s",
    }


def spread_of(values: Array) -> tuple[float, float]:
    """Mean and standard deviation over the seeds; that of a single one is NaN."""
    return float(values.mean()), float(values.std(ddof=1)) if len(values) > 1 else nan
