"""Runs the ladder: the error of every quantity against the time of the loop and of the whole run."""

import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from math import inf, nan
from pathlib import Path
from typing import Any

import numpy as np

from drivers.base.errors import RunError
from drivers.chain.case import Case
from drivers.chain.integrator_arrays import arrays_of
from drivers.chain.trace import Trace
from drivers.engines import load_engine
from drivers.limits.attainable import FORCE
from drivers.run.run import run_case
from drivers.run.session import Session
from postproc.paper.simulate import case_of
from postproc.read.observables import of_kind
from postproc.read.residual import REFERENCE
from validation.accuracy.error_measures import ENERGY, Truth, errors_of, momentum_error, quantities, truth_of
from validation.accuracy.schemes import trace_of
from validation.reference.adaptive import integrate_adaptive
from validation.reference.hertz_chain import Motion
from validation.reference.symplectic import integrate_symplectic
from validation.reference.velocity_verlet import integrate_verlet
from validation.served_runs import Served, serve, serving
from validation.studies import progress
from validation.trade.ladder import ADAPTIVE, ORDER_4, SCENES, VERLET, Rung, affordable, rungs_of

REPEATS, SHORT_S = 3, 0.1  # runs expected to be shorter are timed as the best of some
PROCESS = {ADAPTIVE: REFERENCE, ORDER_4: VERLET, VERLET: VERLET}  # the engine that runs a method by itself
FIXED_STEP = {VERLET: integrate_verlet, ORDER_4: integrate_symplectic}
DONE, FAILED, NOT_RUN = "done", "failed", "not run"
Truths = dict[tuple[float, int], Truth]


@dataclass(frozen=True)
class Row:
    """One measurement; errors as in ``accuracy.error_measures``, NaN where the scene does not show a quantity.

    Attributes:
        share_of_limit: the step over the predicted stability limit; of the adaptive integrator its tolerance.
        loop_s: CPU time of the time loop, on one core.
        wall_s: of a run by itself, start-up included.
        in_session_s: of the case in a process that serves many.
        status: ``done``, ``failed``, or ``not run`` with the reason.
    """

    scene: str
    method: str
    time_step_s: float
    share_of_limit: float
    steps: int
    bodies: int
    loop_s: float = nan
    wall_s: float = nan
    in_session_s: float = nan
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


def climb(budget_s: float, scenes: tuple[str, ...] = SCENES) -> list[Row]:
    """All rows of the ladder, within a budget of engine time."""
    kept, left = affordable([rung for scene in scenes for rung in rungs_of(scene)], budget_s)
    rows: list[Row] = []
    for scene in scenes:
        own = [rung for rung in kept if rung.scene == scene]
        truths: Truths = {}
        began = time.perf_counter()
        for method in dict.fromkeys(rung.method for rung in own):
            rows += _by_method(method, [rung for rung in own if rung.method == method], truths)
        progress(f"{scene}: {len(own)} runs in {time.perf_counter() - began:.0f} s")
    return rows + [_row(rung, status=NOT_RUN, reason=f"its loop would take {rung.expected_s:.0f} s") for rung in left]


def _by_method(method: str, rungs: list[Rung], truths: Truths) -> Iterator[Row]:
    """Rows of one scene by one method, coarse steps and fine ones in one process."""
    if method in PROCESS:
        start_s = start_up(PROCESS[method], case_of(rungs[0].scene))
        for rung in rungs:
            motion, loop_s = timed(_integrator(rung), rung.expected_s)
            if np.isfinite(motion.force_N).all():
                trace = trace_of(rung.case, rung.case.sample_times_s, motion)
                yield _measured(rung, Served(trace, loop_s, loop_s), start_s, truths)
            else:
                yield _row(rung, status=FAILED, reason="not finite: the step is too large")
        return
    start_s = start_up(method, rungs[0].case)
    with serving(method) as session:
        for rung in rungs:
            try:
                yield _measured(rung, timed_in(session, rung.case, rung.expected_s), start_s, truths)
            except RunError as error:
                yield _row(rung, status=error.status, reason=str(error))


def _integrator(rung: Rung) -> Callable[[], Motion]:
    chain, scene = arrays_of(rung.case.chain), rung.case.scene
    if rung.method == ADAPTIVE:
        return lambda: integrate_adaptive(chain, rung.case.sample_times_s, rung.share)
    integrate = FIXED_STEP[rung.method]
    return lambda: integrate(chain, scene.time_step_s, scene.steps_per_sample, scene.samples)


def _row(rung: Rung, **measured: Any) -> Row:
    fixed = rung.method != ADAPTIVE
    step_s, steps = (rung.case.scene.time_step_s, rung.case.scene.steps) if fixed else (nan, 0)
    return Row(rung.scene, rung.method, step_s, rung.share, steps, rung.case.chain.bodies, **measured)


def _measured(rung: Rung, run: Served, start_s: float, truths: Truths) -> Row:
    """Row of a run that ended well; the smallest steps of a scene share their samples, so their exact motion too."""
    case = rung.case
    key = (case.scene.run.sample_interval, case.scene.samples)
    if key not in truths:
        truths[key] = truth_of(case)
    times = {"loop_s": run.loop_s, "wall_s": start_s + run.case_s, "in_session_s": run.case_s}
    return _row(rung, **times, **errors_by_group(case, run.trace, truths[key]))


def errors_by_group(case: Case, trace: Trace, truth: Truth) -> dict[str, float]:
    """The errors of a row; of several gauges the largest."""
    groups = {
        "sensor_peak": [name for name in of_kind(truth.true, "peak") if name != "wall_peak"],
        "wall_peak": [name for name in truth.true if name == "wall_peak"],
        "arrival": of_kind(truth.true, "arrival"),
        "speed": of_kind(truth.true, "speed"),
        "width": [name for name in of_kind(truth.true, "width") if name.endswith("_4pct")],
    }
    found = quantities(case, trace)
    errors = errors_of(case, trace, truth, (FORCE, ENERGY)) | {"momentum": momentum_error(case, trace, truth)}
    for group, names in groups.items():
        errors[group] = max((abs(found.get(name, inf) / truth.true[name] - 1) for name in names), default=nan)
    return errors


def timed(action: Callable[[], Motion], expected_s: float) -> tuple[Motion, float]:
    """What an action gives, and its shortest time; a first call may compile and does not count."""
    best, result = inf, action()
    for _ in range(REPEATS if expected_s < SHORT_S else 1):
        began = time.perf_counter()
        result = action()
        best = min(best, time.perf_counter() - began)
    return result, best


def timed_in(session: Session, case: Case, expected_s: float) -> Served:
    """A case in a session, with the shortest times of its repeats.

    Raises:
        RunError: it failed.
    """
    runs = [serve(session, case) for _ in range(REPEATS if expected_s < SHORT_S else 1)]
    return Served(runs[-1].trace, min(run.loop_s for run in runs), min(run.case_s for run in runs))


def start_up(name: str, case: Case) -> float:
    """Seconds of a process by itself that are not its loop; in-repo the better of two: the first may have to compile.

    Raises:
        RunError: it failed.
    """
    times = 2 if load_engine(name).in_repository else 1
    with tempfile.TemporaryDirectory() as folder:
        records = [run_case(case, name, Path(folder), rerun=True).record for _ in range(times)]
    return min(record.wall_s - (record.loop_s or 0.0) for record in records)
