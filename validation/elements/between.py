"""The codes against each other in the tube: seed by seed until they part, and as distributions over the seeds."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from math import nan
from pathlib import Path

import numpy as np
from scipy.stats import ks_2samp

from drivers.run.finished import EndedRun
from drivers.run.many import run_all_done
from postproc.read.observables import observe
from postproc.read.residual import residual
from validation.elements.switch_effects import observables_of
from validation.elements.switches import Side, Subject, case_on

PARTED = 1e-2  # of the largest force
FRICTIONLESS = Side(tube=True, set=("contact.friction=0", "tube.friction=0"))
TUBES = {"without friction": FRICTIONLESS, "with friction": Side(tube=True)}


@dataclass(frozen=True)
class Between:
    """Two codes on a scene in its tube.

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
    before_wall: float
    earliest_parted_s: float
    median_parted_s: float
    observable: str
    first_mean: float
    first_spread: float
    second_mean: float
    second_spread: float
    same: float


def compare_codes(
    subjects: Iterable[Subject], seeds: int, codes: Sequence[str], runs: Path, say: Callable[[str], None]
) -> list[Between]:
    """Both codes on all scenes in their tubes; nothing where there are not two.

    Raises:
        RunError: a run failed.
    """
    found: list[Between] = []
    if len(codes) != 2:
        return found
    for subject in subjects:
        for friction, side in TUBES.items():
            say(f"{subject.name} {friction}: {seeds} seeds on {' and '.join(codes)}")
            cases = [case_on(subject, side, seed) for seed in range(1, seeds + 1)]
            jobs = [(case, code) for code in codes for case in cases]
            ended = run_all_done(jobs, runs)
            first, second = ended[:seeds], ended[seeds:]
            found += _compared(subject.name, friction, " ".join(codes), observables_of(cases[0]), first, second)
    return found


def _compared(
    scene: str, friction: str, codes: str, names: dict[str, str], first: list[EndedRun], second: list[EndedRun]
) -> list[Between]:
    apart = [residual(other.trace, one.trace) for one, other in zip(first, second, strict=True)]
    values = [[observe(run.layout, run.trace) for run in side] for side in (first, second)]
    time = first[0].trace.time_s
    quiet = [time < each["wall_arrival_s"] for each in values[0]]
    before = max(float(share[before].max()) for share, before in zip(apart, quiet, strict=True))
    parted = np.array([time[int(np.argmax(share > PARTED))] if (share > PARTED).any() else np.inf for share in apart])
    earliest, median = (value if np.isfinite(value) else nan for value in (parted.min(), np.median(parted)))
    rows = []
    for word, name in names.items():
        one, other = (np.array([each[name] for each in side]) for side in values)
        rows.append(
            Between(
                scene, friction, codes, len(first), before, float(earliest), float(median), word, *_spread(one),
                *_spread(other), float(ks_2samp(one, other).pvalue),
            )
        )  # fmt: skip
    return rows


def _spread(values: "np.ndarray[tuple[int], np.dtype[np.float64]]") -> tuple[float, float]:
    return float(values.mean()), float(values.std(ddof=1)) if len(values) > 1 else nan
