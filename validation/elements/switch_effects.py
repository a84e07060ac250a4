"""What elements change and cost: runs of both sides of every switch on the codes."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from drivers.base.errors import RunError
from drivers.chain.case import Case
from drivers.engines import load_engine
from drivers.run.finished import EndedRun, open_run
from drivers.run.many import run_all_done
from drivers.run.run import run_case
from postproc.read.observables import observe
from validation.elements.switches import Pair

LEVEL = "4pct"  # of the peak, at which the width is cut


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


def measure(
    pairs: list[Pair], engines: Iterable[str], repeats: int, runs: Path, say: Callable[[str], None]
) -> list[Effect]:
    """Effects of all switches on all codes.

    Raises:
        RunError: a run failed.
    """
    effects = []
    for engine in engines:
        say(f"{engine}: {len(pairs)} switches")
        jobs = [(case, engine) for pair in pairs for case in (pair.without, pair.with_)]
        ended = run_all_done(jobs, runs)
        seen = {id(case): observed(run) for (case, _), run in zip(jobs, ended, strict=True)}
        say(f"{engine}: costs, {repeats} times one after the other")
        costs = _costs([pair for pair in pairs if pair.scene == pairs[0].scene], engine, repeats, runs)
        for scene, element in dict.fromkeys((pair.scene, pair.element) for pair in pairs):
            group = [pair for pair in pairs if (pair.scene, pair.element) == (scene, element)]
            effects += _effects(engine, group, seen, costs[element])
    return effects


def _costs(pairs: list[Pair], engine: str, repeats: int, runs: Path) -> dict[str, tuple[float, float]]:
    """Nanoseconds per body and step without and with each element: the least of several runs, one after the other."""
    first = {pair.element: pair for pair in reversed(pairs)}  # of random ones the first seed
    decks = {name: tuple(_deck(case, engine) for case in (pair.without, pair.with_)) for name, pair in first.items()}
    cases = {_deck(case, engine): case for pair in first.values() for case in (pair.without, pair.with_)}
    least = dict.fromkeys(cases, float("inf"))
    for _ in range(repeats):
        for deck, case in cases.items():
            ended = run_case(case, engine, runs, rerun=True)
            if not ended.done or ended.record.loop_s is None:
                raise RunError(f"{case.scene.file}: {engine} {ended.record.status}: {ended.record.reason}")
            cost = ended.record.loop_s / (case.chain.bodies * case.scene.steps) * 1e9
            least[deck] = min(least[deck], cost)
    return {name: (least[without], least[with_]) for name, (without, with_) in decks.items()}


def _deck(case: Case, engine: str) -> str:
    return load_engine(engine).render(case).sha256


def observables_of(case: Case) -> dict[str, str]:
    """What is looked at, by a word for it: speed, peak and width at the gauges, peak and arrival at the wall."""
    upper, lower = (sensor.from_wall for sensor in case.layout.sensors)
    return {
        "speed": f"speed_{upper}_to_{lower}_m_s",
        "sensor peak": f"bead_{upper}_peak_N",
        "wall peak": "wall_peak_N",
        "width": f"bead_{lower}_width_{LEVEL}_diameters",
        "arrival": "wall_arrival_s",
    }


def _effects(
    engine: str, group: list[Pair], seen: dict[int, dict[str, float]], costs: tuple[float, float]
) -> list[Effect]:
    effects = []
    for word, name in observables_of(group[0].without).items():
        values = np.array([(seen[id(pair.without)][name], seen[id(pair.with_)][name]) for pair in group])
        changes = values[:, 1] / values[:, 0] - 1
        effects.append(
            Effect(
                scene=group[0].scene,
                element=group[0].element,
                engine=engine,
                observable=word,
                without=float(values[:, 0].mean()),
                with_=float(values[:, 1].mean()),
                change=float(changes.mean()),
                spread=float(changes.std(ddof=1)) if len(changes) > 1 else float("nan"),
                seeds=len(group),
                cost_ns=costs[1],
                cost_ratio=costs[1] / costs[0],
            )
        )
    return effects


def observed(run: EndedRun) -> dict[str, float]:
    """The observables of a run."""
    finished = open_run(run.folder)
    return observe(finished.layout, finished.trace)
