"""Checks of the rule that decides what a scene requires.

What is always left out must change nothing: a straight chain is run once more with beads free to move sideways, in a
tube, with friction. What an accuracy allows to be left out must change nothing that was asked for by more than that.
"""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from drivers.chain.elements import Element
from drivers.run.many import run_all_done
from validation.accuracy.assess import assess
from validation.accuracy.plan import planned_case
from validation.elements.switches import Side, Subject, case_on

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


def nothing_changes(subjects: Iterable[Subject], engines: Iterable[str], runs: Path) -> Iterator[Nothing]:
    """What is always left out, put in."""
    for engine in engines:
        for subject in subjects:
            cases = [case_on(subject, side, 1) for side in (Side(), STRAIGHT)]
            one, other = (run.trace.force_N for run in run_all_done([(case, engine) for case in cases], runs))
            yield Nothing(subject.name, engine, float(np.abs(other - one).max() / one.max()))


def left_out(element: Element) -> bool:
    """Whether an accuracy has let it out."""
    return not element.modelled and element.reason.startswith("left out")


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
            names = ", ".join(each.name for each in case.elements if left_out(each))
            step = case.scene.time_step_s
            yield Asked(accuracy, engine, names, step, worst, kept[worst]["asked"], kept[worst]["measured"])
