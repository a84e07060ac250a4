"""What elements change, cost and would have shown, and whether the rule that leaves them out holds.

Both sides of every switch of ``inputs/elements.toml`` are run on the codes, then all steps from the elastic line to
tube, friction, restitution and gauge. What is always left out must change nothing: a straight chain is run once more
with beads free to move sideways, in a tube, with friction. What an accuracy allows to be left out must change nothing
that was asked for by more than that. In the tube codes are compared seed by seed until they part, and as distributions.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from itertools import combinations, product
from math import nan
from pathlib import Path

import numpy as np
from pydantic import Field
from scipy.stats import ks_2samp

from drivers.base import paths
from drivers.base.messages import validate
from drivers.base.progress import following
from drivers.chain.case import Case
from drivers.chain.chain import Array
from drivers.limits.refusal import inability
from drivers.run.run import run_all_done
from drivers.scene.model import Part
from drivers.scene.read_scene import read_toml
from postproc.paper.simulate import Simulation, case_of
from postproc.read.residual import apart, residual
from validation.accuracy.assess import assess
from validation.accuracy.plan import planned_case
from validation.served_runs import serve, serving

SCATTER = "scatter"  # in a setting: the scene's own
Found = Mapping[tuple[Case, str], Simulation]  # all runs of the study, by case and engine


class Side(Part):
    """A scene with or without an element; ``tube``: its twin in a tube, with ``set`` laid over it."""

    tube: bool = False
    set: tuple[str, ...] = Field(default=(), strict=False)


class Element(Part):
    """What is switched; ``random`` draws are repeated for every seed, ``only`` names the scenes that have it.

    One that is ``of`` another is the same as somebody else may have it: together they tell how sure the effect is.
    """

    name: str
    of: str = ""
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


FRICTIONLESS = ("contact.friction=0", "tube.friction=0")
STRAIGHT = Side(tube=True, set=("chain.lateral_offset=0 um",))
# what to ask for, so that something may be left out of a scene with all that can be
ASKED = (
    "{ wall_peak = 1e-1 }",
    "{ wall_peak = 3e-2 }",
    "{ wall_peak = 1e-2, speed_9_to_5 = 1e-2 }",
    "{ wall_peak = 1e-3 }",
    "1e-2",
)
ALL = ("chain.mass_scatter=0.0008 g", "contact.restitution=0.995", "chain.precompression=1 mN")

PARTED = 1e-2  # of the largest change
WITHOUT_FRICTION = "without friction"
TUBES = {
    WITHOUT_FRICTION: Side(tube=True, set=FRICTIONLESS),
    "with friction": Side(tube=True),
    "with friction of 0.3": Side(tube=True, set=("contact.friction=0.3", "tube.friction=0.3")),
}


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


def measure_effects(pairs: Sequence[Pair], engines: Iterable[str], repeats: int, found: Found) -> Iterator[Effect]:
    """Effects of all switches on all codes, but for those that a code cannot take."""
    for engine in engines:
        own = taken_by(engine, pairs)
        costs = _costs([pair for pair in own if pair.scene == pairs[0].scene], engine, repeats, found)
        for scene, element in dict.fromkeys((pair.scene, pair.element) for pair in own):
            group = [pair for pair in own if (pair.scene, pair.element) == (scene, element)]
            for word, name in observables_of(group[0].cases[0]).items():
                sides = np.array([[found[case, engine].values[name] for case in pair.cases] for pair in group])
                change, spread = spread_of(sides[:, 1] / sides[:, 0] - 1)
                without, with_ = (float(side.mean()) for side in sides.T)
                cost, ratio = costs[element][1], costs[element][1] / costs[element][0]
                yield Effect(
                    scene, element, engine, word, without, with_, change, spread, len(sides), cost, ratio
                )  # fmt: skip


def taken_by(engine: str, pairs: Iterable[Pair]) -> list[Pair]:
    """The switches of which an engine can take both sides."""
    return [pair for pair in pairs if not any(inability(case, engine) for case in pair.cases)]


def _costs(pairs: Sequence[Pair], engine: str, repeats: int, found: Found) -> dict[str, tuple[float, ...]]:
    """Nanoseconds per body and step without and with each element: the least of all seeds, and of some repetitions.

    The runs have been made side by side; the first seed's are repeated one after the other.
    """
    loops_s = {case: found[case, engine].loop_s for pair in pairs for case in pair.cases}
    repeated = {case for pair in {pair.element: pair for pair in reversed(pairs)}.values() for case in pair.cases}
    with serving(engine) as session:
        what = f"costs on {engine}, one run after the other"
        for case in following([*repeated] * repeats, what, len(repeated) * repeats):
            loops_s[case] = min(loops_s[case], serve(session, case).loop_s)
    least: dict[str, list[float]] = {}
    for pair in pairs:
        own = [loops_s[case] / (case.chain.bodies * case.scene.steps) * 1e9 for case in pair.cases]
        least[pair.element] = [*map(min, own, least.get(pair.element, own))]
    return {element: tuple(own) for element, own in least.items()}


@dataclass(frozen=True)
class Nothing:
    """What beads free to move sideways change of a straight chain, of the largest change of force."""

    scene: str
    engine: str
    change: float


@dataclass(frozen=True)
class Asked:
    """What an accuracy lets out, and what the run then missed of it.

    Attributes:
        left_out: names of elements.
        quantity: of those asked for, the one that errs by the largest share of its accuracy.
        error: its error against the exact motion of the whole scene.
    """

    accuracy: str
    engine: str
    left_out: str
    time_step_s: float
    quantity: str
    asked: float
    error: float


@dataclass(frozen=True)
class Between:
    """Two codes on a scene in its tube; a single row without seeds, which says why, where no two model tubes.

    Attributes:
        before_wall: largest force difference until the wave reaches the wall, over the largest change; the worst seed.
        parted_s: when the difference first passes a per cent: the earliest seed, and the median; NaN: never.
        means, spreads: of the observable, by code.
        same: probability of samples so different from one distribution (Kolmogorov and Smirnov).
    """

    scene: str
    friction: str
    codes: str
    seeds: int
    before_wall: float = nan
    earliest_parted_s: float = nan
    median_parted_s: float = nan
    observable: str = "not compared: fewer than two installed codes model tubes"
    first_mean: float = nan
    first_spread: float = nan
    second_mean: float = nan
    second_spread: float = nan
    same: float = nan


def straight(subject: Subject) -> list[Case]:
    """The scene as it is, and with what is always left out put in."""
    return [case_on(subject, side, 1) for side in (Side(), STRAIGHT)]


def nothing_changes(subjects: Iterable[Subject], engines: Iterable[str], found: Found) -> Iterator[Nothing]:
    """What is always left out, put in."""
    for engine, subject in product(engines, subjects):
        one, other = (found[case, engine].trace for case in straight(subject))
        yield Nothing(subject.name, engine, float(residual(other, one).max()))


def accuracies_kept(scene: str, engines: Iterable[str], runs: Path) -> Iterator[Asked]:
    """What several accuracies let out of a scene that has everything, and what runs then miss of them."""
    for accuracy in following(ASKED, "accuracies asked for", len(ASKED)):
        case = planned_case(scene, *ALL, "run.time_step=", f"run.accuracy={accuracy}")
        jobs = [(case, engine) for engine in engines]
        for (_, engine), ended in zip(jobs, run_all_done(jobs, runs), strict=True):
            kept = assess(ended, case).record.accuracy
            assert kept is not None
            worst = max(kept, key=lambda name: kept[name]["measured"] / kept[name]["asked"])
            lets_out = (each for each in case.elements if not each.modelled and each.reason.startswith("left out"))
            names = ", ".join(each.name for each in lets_out)
            step = case.scene.time_step_s
            yield Asked(accuracy, engine, names, step, worst, kept[worst]["asked"], kept[worst]["measured"])


def in_tube(subject: Subject, seeds: int) -> dict[str, list[Case]]:
    """The scene in its tube, by the friction there."""
    return {friction: seeded(subject, side, seeds) for friction, side in TUBES.items()}


def compare_codes(subjects: Iterable[Subject], seeds: int, codes: Sequence[str], found: Found) -> Iterator[Between]:
    """Every two of the codes, which model tubes, on all scenes in theirs."""
    if len(codes) < 2:
        yield Between("any", "any", " ".join(codes), 0)
        return
    for subject in subjects:
        for friction, cases in in_tube(subject, seeds).items():
            for pair in combinations(codes, 2):
                one, other = ([found[case, code] for case in cases] for code in pair)
                yield from _compared(subject.name, friction, one, other)


def _compared(scene: str, friction: str, first: list[Simulation], second: list[Simulation]) -> Iterator[Between]:
    pairs = [(one.trace, other.trace, one.values["wall_arrival_s"]) for one, other in zip(first, second, strict=True)]
    before = max(float(residual(other, one)[one.time_s < arrival_s].max()) for one, other, arrival_s in pairs)
    parted = np.nan_to_num([apart(other, one, PARTED)[1] for one, other, _ in pairs], nan=np.inf)
    earliest, median = (float(value) if np.isfinite(value) else nan for value in (parted.min(), np.median(parted)))
    for word, name in observables_of(first[0].case).items():
        one, other = (np.array([run.values[name] for run in runs]) for runs in (first, second))
        yield Between(
            scene, friction, f"{first[0].engine} {second[0].engine}", len(first), before, earliest, median, word,
            *spread_of(one), *spread_of(other), float(ks_2samp(one, other).pvalue),
        )  # fmt: skip
