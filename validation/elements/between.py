"""The codes against each other in the tube: seed by seed until they part, and as distributions over the seeds."""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations
from math import nan
from pathlib import Path

import numpy as np
from scipy.stats import ks_2samp

from postproc.paper.simulate import Simulation, run_codes
from postproc.read.residual import residual
from validation.elements.switches import Side, Subject, observables_of, seeded, spread_of
from validation.studies import progress

PARTED = 1e-2  # of the largest force
WITHOUT_FRICTION = "without friction"
TUBES = {
    WITHOUT_FRICTION: Side(tube=True, set=("contact.friction=0", "tube.friction=0")),
    "with friction": Side(tube=True),
}


@dataclass(frozen=True)
class Between:
    """Two codes on a scene in its tube; a single row without seeds, which says why, where there are no two.

    Attributes:
        before_wall: largest force difference until the wave reaches the wall, over the largest force; the worst seed.
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
    observable: str = "not compared: fewer than two codes are installed"
    first_mean: float = nan
    first_spread: float = nan
    second_mean: float = nan
    second_spread: float = nan
    same: float = nan


def compare_codes(subjects: Iterable[Subject], seeds: int, codes: Sequence[str], runs: Path) -> Iterator[Between]:
    """Every two codes on all scenes in their tubes.

    Raises:
        RunError: a run failed.
    """
    if len(codes) < 2:
        yield Between("any", "any", " ".join(codes), 0)
        return
    for subject in subjects:
        for friction, side in TUBES.items():
            progress(f"{subject.name} {friction}: {seeds} seeds on {' and '.join(codes)}")
            cases = seeded(subject, side, seeds)
            done = run_codes(dict.fromkeys(codes, cases), runs)
            for one, other in combinations(codes, 2):
                yield from _compared(subject.name, friction, done[one], done[other])


def _compared(scene: str, friction: str, first: list[Simulation], second: list[Simulation]) -> Iterator[Between]:
    time = first[0].trace.time_s
    apart = [residual(other.trace, one.trace) for one, other in zip(first, second, strict=True)]
    before = max(
        float(share[time < one.values["wall_arrival_s"]].max()) for share, one in zip(apart, first, strict=True)
    )
    parted = np.array([time[int(np.argmax(share > PARTED))] if (share > PARTED).any() else np.inf for share in apart])
    earliest, median = (float(value) if np.isfinite(value) else nan for value in (parted.min(), np.median(parted)))
    for word, name in observables_of(first[0].case).items():
        one, other = (np.array([run.values[name] for run in runs]) for runs in (first, second))
        yield Between(
            scene, friction, f"{first[0].engine} {second[0].engine}", len(first), before, earliest, median, word,
            *spread_of(one), *spread_of(other), float(ks_2samp(one, other).pvalue),
        )  # fmt: skip
