"""Runs the ladder: the error of every quantity against the time of the loop and of the whole run."""

import tempfile
import time
from collections.abc import Iterator
from contextlib import ExitStack
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
from postproc.paper.simulate import case_of
from postproc.read.observables import of_kind
from postproc.read.residual import REFERENCE
from validation.accuracy.error_measures import ENERGY, Truth, errors_of, momentum_error, quantities, truth_of
from validation.accuracy.schemes import trace_of
from validation.reference.adaptive import integrate_adaptive
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
    """Rows of one scene by one method, all by one process."""
    with ExitStack() as stack:
        if method in PROCESS:
            start_s, run = start_up(PROCESS[method], case_of(rungs[0].scene)), _in_repo
        else:
            start_s, session = start_up(method, rungs[0].case), stack.enter_context(serving(method))
            run = lambda rung: serve(session, rung.case)  # noqa: E731 - the other way to run a rung
        for rung in rungs:
            try:
                if method in PROCESS:
                    run(rung)  # a first call may compile
                runs = [run(rung) for _ in range(REPEATS if rung.expected_s < SHORT_S else 1)]
                best = Served(runs[-1].trace, min(each.loop_s for each in runs), min(each.case_s for each in runs))
                yield _measured(rung, best, start_s, truths)
            except RunError as error:
                yield _row(rung, status=error.status, reason=str(error))


def _in_repo(rung: Rung) -> Served:
    """A run by an integrator of this repository.

    Raises:
        RunError: it blew up.
    """
    case, chain, scene = rung.case, arrays_of(rung.case.chain), rung.case.scene
    began = time.perf_counter()
    if rung.method == ADAPTIVE:
        motion = integrate_adaptive(chain, case.sample_times_s, rung.share)
    else:
        motion = FIXED_STEP[rung.method](chain, scene.time_step_s, scene.steps_per_sample, scene.samples)
    loop_s = time.perf_counter() - began
    if not np.isfinite(motion.force_N).all():
        raise RunError("not finite: the step is too large")
    return Served(trace_of(case, case.sample_times_s, motion), loop_s, loop_s)


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


def start_up(name: str, case: Case) -> float:
    """Seconds of a process by itself that are not its loop; in-repo the better of two: the first may have to compile.

    Raises:
        RunError: it failed.
    """
    times = 2 if load_engine(name).in_repository else 1
    with tempfile.TemporaryDirectory() as folder:
        records = [run_case(case, name, Path(folder), rerun=True).record for _ in range(times)]
    return min(record.wall_s - (record.loop_s or 0.0) for record in records)
