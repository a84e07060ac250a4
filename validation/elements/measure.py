"""What elements change and cost: runs of both sides of every switch on the codes."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from drivers.case import Case
from drivers.errors import RunError
from drivers.finished import open_run
from drivers.run import EndedRun
from drivers.run_many import run_many
from postproc.observables import observe
from validation.elements.switches import Pair

LEVEL = "4pct"  # of the peak, at which the width is cut


@dataclass(frozen=True)
class Effect:
    """What an element changes of one observable on one code.

    Attributes:
        without, with_: means over the seeds.
        change: mean of the relative changes, seed by seed; ``spread`` their standard deviation, NaN for a single run.
        cost_ns: of the engine's loop with it, per body and time step; ``cost_ratio`` over that without.
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


def measure(pairs: list[Pair], engines: Iterable[str], runs: Path, say: Callable[[str], None]) -> list[Effect]:
    """Effects of all switches on all codes.

    Raises:
        RunError: a run failed.
    """
    effects = []
    for engine in engines:
        say(f"{engine}: {len(pairs)} switches")
        jobs = [(case, engine) for pair in pairs for case in (pair.without, pair.with_)]
        ended = run_many(jobs, runs)
        for (case, _), run in zip(jobs, ended, strict=True):
            if not run.done:
                raise RunError(f"{case.scene.file}: {engine} {run.record.status}: {run.record.reason}")
        sides = {id(case): run for (case, _), run in zip(jobs, ended, strict=True)}
        for key in dict.fromkeys((pair.scene, pair.element) for pair in pairs):
            group = [pair for pair in pairs if (pair.scene, pair.element) == key]
            effects += _effects(engine, group, sides)
    return effects


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


def _effects(engine: str, group: list[Pair], sides: dict[int, EndedRun]) -> list[Effect]:
    found = [(observed(sides[id(pair.without)]), observed(sides[id(pair.with_)])) for pair in group]
    costs = [
        (_cost_ns(pair.without, sides[id(pair.without)]), _cost_ns(pair.with_, sides[id(pair.with_)])) for pair in group
    ]
    cheap, dear = np.median(np.array(costs), axis=0)
    effects = []
    for word, name in observables_of(group[0].without).items():
        values = np.array([(without[name], with_[name]) for without, with_ in found])
        changes = values[:, 1] / values[:, 0] - 1
        spread = float(changes.std(ddof=1)) if len(changes) > 1 else float("nan")
        effects.append(
            Effect(
                scene=group[0].scene,
                element=group[0].element,
                engine=engine,
                observable=word,
                without=float(values[:, 0].mean()),
                with_=float(values[:, 1].mean()),
                change=float(changes.mean()),
                spread=spread,
                seeds=len(group),
                cost_ns=float(dear),
                cost_ratio=float(dear / cheap),
            )
        )
    return effects


def observed(run: EndedRun) -> dict[str, float]:
    """The observables of a run."""
    finished = open_run(run.folder)
    return observe(finished.layout, finished.trace)


def _cost_ns(case: Case, run: EndedRun) -> float:
    assert run.record.loop_s is not None  # it is done
    return run.record.loop_s / (case.chain.bodies * case.scene.steps) * 1e9
