"""What elements change and cost: runs of both sides of every switch of ``inputs/elements.toml`` on the codes."""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import cache
from math import inf, nan
from pathlib import Path

import numpy as np
from pydantic import Field

from drivers.base import paths
from drivers.base.errors import RunError
from drivers.base.messages import validate
from drivers.chain.case import Case
from drivers.chain.chain import Array
from drivers.engines import load_engine
from drivers.limits.refusal import inability
from drivers.run.run import run_case
from drivers.scene.model import Part
from drivers.scene.read_scene import read_toml
from postproc.paper.simulate import case_of, run_codes
from validation.studies import progress

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


@dataclass(frozen=True)
class Effect:
    """What an element changes of one observable on one code.

    Attributes:
        without, with_: means over the seeds.
        change: mean of the relative changes, seed by seed; ``spread`` their standard deviation, NaN for a single run.
        cost_ns: of the engine's loop with it on the first scene, per body and step; ``cost_ratio`` over that without.
    """

    scene: str
    element: str
    engine: str
    observable: str
    without: float
    with_: float
    change: float
    spread: float
    seeds: int
    cost_ns: float
    cost_ratio: float


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


def measure_effects(pairs: Sequence[Pair], engines: Iterable[str], repeats: int, runs: Path) -> Iterator[Effect]:
    """Effects of all switches on all codes, but for those that a code cannot take.

    Raises:
        RunError: a run failed.
    """
    for engine in engines:
        own = [pair for pair in pairs if not any(inability(case, engine) for case in pair.cases)]
        progress(f"{engine}: {len(own)} switches of {len(pairs)}")
        done = iter(run_codes({engine: [case for pair in own for case in pair.cases]}, runs)[engine])
        values = {pair: (next(done).values, next(done).values) for pair in own}
        progress(f"{engine}: costs, {repeats} times one after the other")
        costs = _costs([pair for pair in own if pair.scene == pairs[0].scene], engine, repeats, runs)
        for scene, element in dict.fromkeys((pair.scene, pair.element) for pair in own):
            group = [pair for pair in own if (pair.scene, pair.element) == (scene, element)]
            for word, name in observables_of(group[0].cases[0]).items():
                sides = np.array([[side[name] for side in values[pair]] for pair in group])
                change, spread = spread_of(sides[:, 1] / sides[:, 0] - 1)
                without, with_ = (float(side.mean()) for side in sides.T)
                cost, ratio = costs[element][1], costs[element][1] / costs[element][0]
                yield Effect(
                    scene, element, engine, word, without, with_, change, spread, len(sides), cost, ratio
                )  # fmt: skip


def _costs(pairs: Sequence[Pair], engine: str, repeats: int, runs: Path) -> dict[str, tuple[float, ...]]:
    """Nanoseconds per body and step without and with each element: the least of several runs, one after the other."""
    first = {pair.element: pair for pair in reversed(pairs)}  # of random ones the first seed
    render = load_engine(engine).render
    decks = {element: [render(case).sha256 for case in pair.cases] for element, pair in first.items()}
    cases = {
        deck: case for element, pair in first.items() for deck, case in zip(decks[element], pair.cases, strict=True)
    }
    least = dict.fromkeys(cases, inf)
    for deck, case in [*cases.items()] * repeats:
        record = run_case(case, engine, runs, rerun=True).record
        if record.status != "done" or record.loop_s is None:
            raise RunError(f"{case.scene.file}: {engine} {record.status}: {record.reason}")
        least[deck] = min(least[deck], record.loop_s / (case.chain.bodies * case.scene.steps) * 1e9)
    return {element: tuple(least[deck] for deck in own) for element, own in decks.items()}
