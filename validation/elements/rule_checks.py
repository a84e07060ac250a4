"""Checks of the rule that decides what a scene requires, and of the codes in the tube against each other.

What is always left out must change nothing: a straight chain is run once more with beads free to move sideways, in a
tube, with friction. What an accuracy allows to be left out must change nothing that was asked for by more than that.
In the tube codes are compared seed by seed until they part, and as distributions over the seeds.
"""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations
from math import nan
from pathlib import Path

import numpy as np
from scipy.stats import ks_2samp

from drivers.run.run import run_all_done
from postproc.paper.simulate import Simulation, run_codes
from postproc.read.residual import apart, residual
from validation.accuracy.assess import assess
from validation.accuracy.plan import planned_case
from validation.elements.switches import Side, Subject, case_on, observables_of, seeded, spread_of
from validation.studies import progress

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

PARTED = 1e-2  # of the largest force
WITHOUT_FRICTION = "without friction"
TUBES = {
    WITHOUT_FRICTION: Side(tube=True, set=("contact.friction=0", "tube.friction=0")),
    "with friction": Side(tube=True),
}


@dataclass(frozen=True)
class Nothing:
    """What beads free to move sideways change of a straight chain: the largest force difference over the largest."""

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


def nothing_changes(subjects: Iterable[Subject], engines: Iterable[str], runs: Path) -> Iterator[Nothing]:
    """What is always left out, put in."""
    for engine in engines:
        for subject in subjects:
            cases = [case_on(subject, side, 1) for side in (Side(), STRAIGHT)]
            one, other = (run.trace.force_N for run in run_all_done([(case, engine) for case in cases], runs))
            yield Nothing(subject.name, engine, float(np.abs(other - one).max() / one.max()))


def accuracies_kept(scene: str, engines: Iterable[str], runs: Path) -> Iterator[Asked]:
    """What several accuracies let out of a scene that has everything, and what runs then miss of them.

    Raises:
        RunError: a run failed.
    """
    for accuracy in ASKED:
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
