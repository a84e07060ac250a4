"""Ladder of time steps within a budget of engine time, from the stability limit down to 1e-4 of it."""

import time
from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import chain
from math import ceil, nan
from typing import Any

import numpy as np

from drivers.base.errors import RunError
from drivers.base.terminal import counted
from drivers.chain.case import Case
from drivers.chain.chain import arrays_of
from drivers.chain.schemes import trace_of
from drivers.chain.trace import Trace
from drivers.engines import REFERENCE, VERLET, installed_codes
from drivers.limits import step_limit
from drivers.run.compute import compute
from drivers.run.execute import execute
from drivers.run.scheme import COMPARED
from postproc.paper.simulate import case_of
from postproc.read.observables import of_kind
from validation.accuracy.costs import cost_on
from validation.accuracy.motions import ExactMotion, errors_of, exact_motion_of
from validation.reference.adaptive import MIN_TOLERANCE, integrate_adaptive
from validation.reference.velocity_verlet import integrate_verlet

SCENES = ("fig4", "fig5", "fig6b", "fig6d", "low-amplitude", "steel-chain", "long-chain")
SHORT_SCENES = SCENES[:-1]  # without the thousand beads, which take half of the time
SHARES = tuple(10 ** (-k / 3) for k in range(13))  # of the predicted stability limit
TOLERANCES = (*(10.0**-k for k in range(2, 12)), MIN_TOLERANCE)
IN_REPO = (VERLET, REFERENCE)
BUDGET_S, SHORT_BUDGET_S = 300.0, 30.0  # of engine time for the whole ladder
MAX_RUN_SHARE = 0.04  # of the budget, for a single run
REPEATS, SHORT_RUN_S = 3, 0.03  # shorter runs are timed as the best of several
CODE_STRIDE = 3  # codes take every third step of the short ladder
DONE, NOT_RUN = "done", "not run"
Samples = tuple[str, float, int]  # scene, sample interval in s, number of samples


@dataclass(frozen=True)
class Rung:
    """One run of the ladder.

    Attributes:
        method: name of the engine.
        case: case with the time step and the samples of this run.
        share: time step divided by the predicted stability limit; for ``reference`` the tolerance.
        expected_s: expected time of the loop.
    """

    scene: str
    method: str
    case: Case
    share: float
    expected_s: float


@dataclass(frozen=True)
class LadderRun:
    """One measurement; errors as in ``accuracy.exact_motion``, NaN if the scene does not show a quantity.

    Attributes:
        time_step_s: time step; NaN for ``reference``.
        share_of_limit: time step divided by the predicted stability limit; for ``reference`` its tolerance.
        loop_s: CPU time of the time loop, on one core.
        start_s: time of a process of the engine outside its loop.
        status: ``done``, ``failed``, or ``not run`` with the reason.
    """

    scene: str
    method: str
    time_step_s: float
    share_of_limit: float
    loop_s: float = nan
    start_s: float = nan
    force: float = nan
    sensor_peak: float = nan
    wall_peak: float = nan
    arrival: float = nan
    speed: float = nan
    width: float = nan
    energy: float = nan
    momentum: float = nan
    status: str = DONE
    reason: str = ""


def rungs_of(scene: str, code_shares: Sequence[float]) -> Iterator[Rung]:
    """Runs of a scene: in-repo schemes at all steps, codes at some, ``reference`` at all tolerances."""
    base = case_of(scene)
    stable_s, *_ = step_limit(base)
    for share in SHARES:
        case = at_step(base, share, stable_s)
        for method in (*(installed_codes() if share in code_shares else ()), VERLET):
            yield Rung(scene, method, case, share, cost_on(method).loop_s(case))
    for tolerance in TOLERANCES:
        yield Rung(scene, REFERENCE, base, tolerance, cost_on(REFERENCE).loop_s(base))


def at_step(case: Case, share: float, stable_s: float) -> Case:
    """Case at about this share of the stability limit; with fewer samples if the step exceeds the interval."""
    step, interval = share * stable_s, case.scene.run.sample_interval
    return case.at(ceil(interval / step * (1 - 1e-12))) if step <= interval else case.sampled_at_every(step)


def affordable(rungs: list[Rung], budget_s: float) -> tuple[list[Rung], list[Rung]]:
    """Rungs within the budget, cheapest first, and the rest."""
    kept, left, spent = list[Rung](), list[Rung](), 0.0
    for rung in sorted(rungs, key=lambda rung: rung.expected_s):
        fits = rung.expected_s <= MAX_RUN_SHARE * budget_s and spent + rung.expected_s <= budget_s
        (kept if fits else left).append(rung)
        spent += rung.expected_s if fits else 0.0
    return kept, left


def run_ladder(budget_s: float, scenes: Sequence[str], *, short: bool = False) -> list[LadderRun]:
    """Runs the ladder within a budget of engine time; in the short study the codes run at every third step.

    Methods run in parallel: one engine runs while the errors of another run are measured.
    """
    shares = SHARES[::CODE_STRIDE] if short else SHARES
    kept, left = affordable([rung for scene in scenes for rung in rungs_of(scene, shares)], budget_s)
    groups: dict[tuple[str, str], list[Rung]] = defaultdict(list)
    for rung in kept:
        groups[rung.scene, rung.method].append(rung)
    longest_first = sorted(groups, key=lambda key: -sum(rung.expected_s for rung in groups[key]))
    engines = dict.fromkeys(rung.method for rung in kept)
    with counted("runs at all steps", len(kept)) as count:
        start_s = dict(execute(partial(start_up, case_of(scenes[0])), engines))
        sampled = {_samples_of(rung): rung.case for rung in kept}
        exact = dict(execute(lambda samples: exact_motion_of(sampled[samples]), sampled))
        under_way = execute(lambda key: [*_rows_of(groups[key], start_s, exact, count)], longest_first)
        rows = [row for _, part in under_way for row in part]
    methods = [*installed_codes(), *IN_REPO]
    rows.sort(key=lambda row: (scenes.index(row.scene), methods.index(row.method)))
    return rows + [_row(rung, status=NOT_RUN, reason=f"its loop would take {rung.expected_s:.0f} s") for rung in left]


def _samples_of(rung: Rung) -> Samples:
    """Scene and sampling of a rung: rungs with the same have the same exact motion."""
    return rung.scene, rung.case.scene.run.sample_interval, rung.case.scene.samples


def _rows_of(
    rungs: Sequence[Rung],
    start_s: Mapping[str, float],
    exact: Mapping[Samples, ExactMotion],
    count: Callable[[], None],
) -> Iterator[LadderRun]:
    """Rows of one scene by one method, one run after the other."""
    for rung in rungs:
        try:
            runs = [_timed(rung) for _ in range(REPEATS if rung.expected_s < SHORT_RUN_S else 1)]
            times = {"loop_s": min(loop_s for _, loop_s in runs), "start_s": start_s[rung.method]}
            yield _row(rung, **times, **errors_by_group(rung.case, runs[-1][0], exact[_samples_of(rung)]))
        except RunError as error:
            yield _row(rung, status=error.status, reason=str(error))
        count()


def _timed(rung: Rung) -> tuple[Trace, float]:
    """Trace of a rung and the time of its loop in s; in-repo schemes run without the guard.

    Raises:
        RunError: the run failed.
    """
    case, scene = rung.case, rung.case.scene
    if rung.method not in IN_REPO:
        ended = compute(case, rung.method)
        return ended.done, ended.loop_s or 0.0
    chain, began = arrays_of(case.chain), time.perf_counter()
    if rung.method == REFERENCE:
        motion = integrate_adaptive(chain, case.sample_times_s, rung.share)
    else:
        motion = integrate_verlet(chain, scene.time_step_s, scene.steps_per_sample, scene.samples)
    loop_s = time.perf_counter() - began
    if not np.isfinite(motion.force_N).all():
        raise RunError("the motion is not finite: the time step is too large")
    return trace_of(case, case.sample_times_s, motion), loop_s


def _row(rung: Rung, **measured: Any) -> LadderRun:
    step_s = nan if rung.method == REFERENCE else rung.case.scene.time_step_s
    return LadderRun(rung.scene, rung.method, step_s, rung.share, **measured)


def errors_by_group(case: Case, trace: Trace, exact_motion: ExactMotion) -> dict[str, float]:
    """Errors of a row; of several gauges the largest."""
    groups = {
        "sensor_peak": [name for name in of_kind(exact_motion.true, "peak") if name != "wall_peak"],
        "wall_peak": [name for name in exact_motion.true if name == "wall_peak"],
        "arrival": of_kind(exact_motion.true, "arrival"),
        "speed": of_kind(exact_motion.true, "speed"),
        "width": [name for name in of_kind(exact_motion.true, "width") if name.endswith("_4pct")],
    }
    measured = errors_of(case, trace, exact_motion, (*COMPARED, *chain(*groups.values())))
    errors = {name: measured[name] for name in COMPARED}
    return errors | {group: max((measured[name] for name in names), default=nan) for group, names in groups.items()}


def start_up(case: Case, name: str) -> float:
    """Time of a process outside its loop, in s: the shorter of two, as the first may compile or load."""
    runs = [compute(case, name, own_process=True) for _ in range(2)]
    return min(run.wall_s - (run.loop_s or 0.0) for run in runs)
