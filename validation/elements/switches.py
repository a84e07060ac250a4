"""Switches of elements: effects and costs, omitted elements, and the codes in the tube.

Every scene runs with and without each element of ``inputs/elements.toml`` on the codes. Elements that straight chains
always omit must change nothing: such a chain runs again with lateral freedom, tube and friction. In the tube the codes
are compared seed by seed.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from itertools import chain, combinations, product
from math import inf, isfinite, nan

import numpy as np
from pydantic import Field

from drivers.base import paths
from drivers.base.messages import validate
from drivers.base.terminal import following
from drivers.base.tolerances import tolerance
from drivers.chain.case import Case
from drivers.chain.chain import Array
from drivers.chain.trace import parted_s, residual
from drivers.limits import inability
from drivers.run.compute import compute
from drivers.scene.model import Part
from drivers.scene.read_scene import read_toml
from postproc.paper.simulate import Simulation, case_of
from validation.checks import Check, judged

SCATTER = "scatter"  # in a setting: replaced by the scene's value
Found = Mapping[tuple[Case, str], Simulation]  # all runs of the study, by case and engine


class Side(Part):
    """Settings of a scene with or without an element; ``tube``: the scene in a tube, with the settings ``set``."""

    tube: bool = False
    set: tuple[str, ...] = Field(default=(), strict=False)


class Element(Part):
    """A switched element; ``random``: repeated for every seed; ``only``: names of the scenes that have it.

    ``of`` names the element of which this is a variant: variants show how uncertain its effect is.
    """

    name: str
    of: str = ""
    without: Side
    with_: Side = Field(alias="with")
    random: bool = False
    only: tuple[str, ...] = Field(default=(), strict=False)


class SwitchedScene(Part):
    """A scene with its sensors and the scatter of its masses; in a tube the scene is ``NAME-tube``."""

    name: str
    scatter: str
    gauges: str


class Elements(Part):
    """The file ``inputs/elements.toml``."""

    seeds: int
    quick_seeds: int
    scene: tuple[SwitchedScene, ...] = Field(strict=False)
    element: tuple[Element, ...] = Field(strict=False)


FRICTIONLESS = ("contact.friction=0", "tube.friction=0")
STRAIGHT = Side(tube=True, set=("chain.lateral_offset=0 um",))
OMITTED = "elements that straight chains omit"
DIFFERENCE_LEVEL = 1e-2  # of the largest change
WITHOUT_FRICTION = "without friction"
TUBES = {
    WITHOUT_FRICTION: Side(tube=True, set=FRICTIONLESS),
    "with friction": Side(tube=True),
    "with friction of 0.3": Side(tube=True, set=("contact.friction=0.3", "tube.friction=0.3")),
}


@dataclass(frozen=True, eq=False)
class Variant:
    """Cases of a scene that are looked at together.

    Attributes:
        step: switched element, with the cases of all seeds without it, then with it; or step to the experiment, with a
            case per seed.
        value: value of a varied parameter; empty without one.
    """

    scene: str
    step: str
    cases: Sequence[Case]
    value: str = ""


@dataclass(frozen=True)
class Effect:
    """Effect of an element on one observable, on one code.

    Attributes:
        without, with_: means over the seeds without and with the element.
        change, spread: mean and standard deviation of the relative changes of the seeds; NaN spread for a single run.
        cost_ns: loop time with the element per body and step, on the first scene.
        cost_ratio: loop time with the element divided by loop time without.
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
    """Reads ``inputs/elements.toml``."""
    return validate(Elements, read_toml(paths.ELEMENTS), paths.shown(paths.ELEMENTS))


def pairs_of(elements: Elements, seeds: int) -> Iterator[Variant]:
    """Cases without and with each element, for all scenes and seeds."""
    for subject, switch in product(elements.scene, elements.element):
        if not switch.only or subject.name in switch.only:
            count = seeds if switch.random else 1
            cases = seeded(subject, switch.without, count) + seeded(subject, switch.with_, count)
            yield Variant(subject.name, switch.name, cases)


@cache
def case_on(subject: SwitchedScene, side: Side, seed: int, *more: str) -> Case:
    """Case of a scene with the settings of one side."""
    settings = [setting.replace(f"={SCATTER}", f"={subject.scatter}") for setting in side.set]
    source = f"{subject.name}-tube" if side.tube else subject.name
    return case_of(source, f"chain.sensors={subject.gauges}", f"seed={seed}", *settings, *more)


def seeded(subject: SwitchedScene, side: Side, seeds: int, *more: str) -> list[Case]:
    """Cases of one side, for the seeds from 1 to ``seeds``."""
    return [case_on(subject, side, seed, *more) for seed in range(1, seeds + 1)]


def observables_of(case: Case) -> dict[str, str]:
    """Compared observables by label: speed, peak and width at the gauges, peak and arrival at the wall."""
    upper, lower = (sensor.from_wall for sensor in case.layout.sensors)
    return {
        "speed": f"speed_{upper}_to_{lower}_m_s",
        "sensor peak": f"bead_{upper}_peak_N",
        "wall peak": "wall_peak_N",
        "width": f"bead_{lower}_width_4pct_diameters",
        "arrival": "wall_arrival_s",
    }


def runs_of(variant: Variant, engine: str, ran: Found) -> list[Simulation]:
    """Runs of a variant on one code, in the order of its cases."""
    return [ran[case, engine] for case in variant.cases]


def spread_of(values: Array) -> tuple[float, float]:
    """Mean and standard deviation over the seeds; NaN for the deviation of a single seed."""
    return float(values.mean()), float(values.std(ddof=1)) if len(values) > 1 else nan


def measure_effects(pairs: Sequence[Variant], engines: Iterable[str], repeats: int, ran: Found) -> Iterator[Effect]:
    """Effects of all elements on all codes that can model them."""
    for engine in engines:
        possible = taken_by(engine, pairs)
        costs = _costs([pair for pair in possible if pair.scene == pairs[0].scene], engine, repeats, ran)
        for pair in possible:
            runs, (cost_without, cost) = runs_of(pair, engine, ran), costs[pair.step]
            for word, name in observables_of(pair.cases[0]).items():
                without, with_ = np.split(np.array([run.values[name] for run in runs]), 2)
                change, spread = spread_of(with_ / without - 1)
                yield Effect(
                    pair.scene, pair.step, engine, word, float(without.mean()), float(with_.mean()), change, spread,
                    len(with_), cost, cost / cost_without,
                )  # fmt: skip


def taken_by(engine: str, pairs: Iterable[Variant]) -> list[Variant]:
    """Pairs that an engine can run on both sides."""
    return [pair for pair in pairs if not any(inability(case, engine) for case in pair.cases)]


def _costs(pairs: Sequence[Variant], engine: str, repeats: int, ran: Found) -> dict[str, tuple[float, float]]:
    """Loop time in ns per body and step without and with each element: the least of all seeds and repetitions.

    The runs of the study are parallel; the repetitions, of the first seed, run one after the other.
    """
    loops_s = {case: ran[case, engine].loop_s for pair in pairs for case in pair.cases}
    repeated = {case for pair in pairs for case in (pair.cases[0], pair.cases[len(pair.cases) // 2])}
    what = f"costs on {engine}, one run after the other"
    for case in following([*repeated] * repeats, what, len(repeated) * repeats):
        ended = compute(case, engine)
        loops_s[case] = min(loops_s[case], ended.loop_s if ended.done and ended.loop_s else inf)
    costs = {}
    for pair in pairs:
        cases_ns = [loops_s[case] / (case.chain.bodies * case.scene.steps) * 1e9 for case in pair.cases]
        without_ns, with_ns = np.split(np.array(cases_ns), 2)
        costs[pair.step] = float(without_ns.min()), float(with_ns.min())
    return costs


@dataclass(frozen=True)
class Between:
    """Two codes on a scene in the tube.

    Attributes:
        before_wall: largest force difference until the wave reaches the wall, divided by the largest change, of all
            seeds.
        parted_s: earliest time of all seeds at which the difference passes 1 %; NaN if it never does.
        first_peak_N, first_spread_N, second_peak_N, second_spread_N: mean and standard deviation over the seeds of the
            peak at the wall, by code.
    """

    scene: str
    friction: str
    codes: str
    seeds: int
    before_wall: float
    parted_s: float
    first_peak_N: float
    first_spread_N: float
    second_peak_N: float
    second_spread_N: float


def straight(subject: SwitchedScene) -> list[Case]:
    """The scene as it is, and with the elements that straight chains always omit."""
    return [case_on(subject, side, 1) for side in (Side(), STRAIGHT)]


def omitted_effects(subjects: Iterable[SwitchedScene], engines: Iterable[str], ran: Found) -> Iterator[Check]:
    """Do straight chains omit only what has no effect? Differences divided by the largest change of force."""
    for engine, subject in product(engines, subjects):
        one, other = (ran[case, engine].trace for case in straight(subject))
        change, place = float(residual(other, one).max()), "straight chain against one with lateral freedom in its tube"
        yield judged(subject.name, engine, OMITTED, change, tolerance("elements", "nothing"), place)


def in_tube(subject: SwitchedScene, seeds: int) -> dict[str, list[Case]]:
    """Cases of the scene in the tube, by friction."""
    return {friction: seeded(subject, side, seeds) for friction, side in TUBES.items()}


def compare_codes(subjects: Iterable[SwitchedScene], seeds: int, codes: Sequence[str], ran: Found) -> Iterator[Between]:
    """Comparison of every two codes on all scenes in the tube."""
    for subject in subjects:
        for friction, cases in in_tube(subject, seeds).items():
            for pair in combinations(codes, 2):
                one, other = ([ran[case, code] for case in cases] for code in pair)
                yield _compared(subject.name, friction, one, other)


def _compared(scene: str, friction: str, first: list[Simulation], second: list[Simulation]) -> Between:
    pairs = [(one.trace, other.trace, one.values["wall_arrival_s"]) for one, other in zip(first, second, strict=True)]
    before = max(float(residual(other, one)[one.time_s < arrival_s].max()) for one, other, arrival_s in pairs)
    earliest_s = min(float(np.nan_to_num(parted_s(other, one, DIFFERENCE_LEVEL), nan=inf)) for one, other, _ in pairs)
    peaks_N = (spread_of(np.array([run.values["wall_peak_N"] for run in runs])) for runs in (first, second))
    codes = f"{first[0].engine} {second[0].engine}"
    return Between(
        scene, friction, codes, len(first), before, earliest_s if isfinite(earliest_s) else nan, *chain(*peaks_N)
    )
