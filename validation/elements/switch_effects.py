"""What elements change and cost: runs of both sides of every switch on the codes."""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from math import inf
from pathlib import Path

import numpy as np

from drivers.base.errors import RunError
from drivers.chain.case import Case
from drivers.chain.chain import Array
from drivers.engines import load_engine
from drivers.limits.refusal import inability
from drivers.run.run import run_case
from postproc.paper.simulate import run_codes
from validation.elements.switches import Pair, observables_of, spread_of
from validation.studies import progress


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
                yield _effect(group[0], engine, word, sides, *costs[element])


def _effect(pair: Pair, engine: str, word: str, sides: Array, cost_without: float, cost_with: float) -> Effect:
    """Effect on one observable by its values, of shape (seeds, 2)."""
    change, spread = spread_of(sides[:, 1] / sides[:, 0] - 1)
    without, with_ = (float(values.mean()) for values in sides.T)
    return Effect(
        pair.scene, pair.element, engine, word, without, with_, change, spread, len(sides), cost_with,
        cost_with / cost_without,
    )  # fmt: skip


def _costs(pairs: Sequence[Pair], engine: str, repeats: int, runs: Path) -> dict[str, tuple[float, ...]]:
    """Nanoseconds per body and step without and with each element: the least of several runs, one after the other."""
    first = {pair.element: pair for pair in reversed(pairs)}  # of random ones the first seed
    cases = {_deck(case, engine): case for pair in first.values() for case in pair.cases}
    least = dict.fromkeys(cases, inf)
    for _ in range(repeats):
        for deck, case in cases.items():
            record = run_case(case, engine, runs, rerun=True).record
            if record.status != "done" or record.loop_s is None:
                raise RunError(f"{case.scene.file}: {engine} {record.status}: {record.reason}")
            least[deck] = min(least[deck], record.loop_s / (case.chain.bodies * case.scene.steps) * 1e9)
    return {element: tuple(least[_deck(case, engine)] for case in pair.cases) for element, pair in first.items()}


def _deck(case: Case, engine: str) -> str:
    return load_engine(engine).render(case).sha256
