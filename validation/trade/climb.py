"""The ladder: each scene from the stability limit down to 1e-4 of it, errors against time, within a budget of time."""

import tempfile
import time
from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import dataclass
from math import ceil, inf, nan
from pathlib import Path
from typing import Any

import numpy as np

from drivers.base.errors import RunError
from drivers.chain.case import Case
from drivers.chain.chain import arrays_of
from drivers.chain.trace import Trace
from drivers.engines import codes, installed_codes, load_engine
from drivers.limits.refusal import FORCE
from drivers.limits.stable_step import predicted_limit
from drivers.run.run import run_case
from postproc.paper.simulate import case_of
from postproc.read.observables import of_kind
from postproc.read.residual import REFERENCE
from validation.accuracy.plan import cost_on
from validation.accuracy.schemes import ENERGY, Truth, errors_of, momentum_error, quantities, trace_of, truth_of
from validation.reference.adaptive import LEAST_TOLERANCE, integrate_adaptive
from validation.reference.symplectic import integrate_symplectic
from validation.reference.velocity_verlet import integrate_verlet
from validation.served_runs import Served, serve, serving
from validation.studies import ADAPTIVE, DONE, NOT_RUN, ORDER_4, VERLET, progress

SCENES = ("fig4", "fig5", "fig6b", "fig6d", "low-amplitude", "steel-chain", "long-chain")
SHARES = tuple(10 ** (-k / 3) for k in range(13))  # of the predicted stability limit
TOLERANCES = (*(10.0**-k for k in range(2, 12)), LEAST_TOLERANCE)
FORCES_OF_ORDER_4 = 4  # a step
BUDGET_S = 300.0  # of engine time for the whole ladder
LONGEST = 0.04  # of the budget: no single run takes more
REPEATS, SHORT_S = 3, 0.1  # runs expected to be shorter are timed as the best of some
PROCESS = {ADAPTIVE: REFERENCE, ORDER_4: VERLET, VERLET: VERLET}  # the engine that runs a method by itself
FIXED_STEP = {VERLET: integrate_verlet, ORDER_4: integrate_symplectic}


@dataclass(frozen=True)
class Rung:
    """One run of the ladder.

    Attributes:
        method: an engine, or an integrator of this repository.
        case: at its time step and samples.
        share: of the predicted stability limit; of ``ADAPTIVE`` the tolerance.
        expected_s: of its loop.
    """

    scene: str
    method: str
    case: Case
    share: float
    expected_s: float


@dataclass(frozen=True)
class Row:
    """One measurement; errors as in ``accuracy.schemes``, NaN where the scene does not show a quantity.

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


def rungs_of(scene: str) -> Iterator[Rung]:
    """Every code and in-repo method at every step, and the adaptive integrator at every tolerance."""
    base = case_of(scene)
    stable_s = predicted_limit(base.chain, float(base.sample_times_s[-1]))
    for share in SHARES:
        case = at_step(base, share, stable_s)
        for method in (*installed_codes(), VERLET, ORDER_4):
            yield Rung(scene, method, case, share, expected_loop_s(method, case))
    for tolerance in TOLERANCES:
        yield Rung(scene, ADAPTIVE, base, tolerance, cost_on(REFERENCE).loop_s(base))


def expected_loop_s(method: str, case: Case) -> float:
    """Expected seconds of a fixed-step loop; a code that nobody has measured is taken for the slowest one."""
    if method == ORDER_4:
        return FORCES_OF_ORDER_4 * expected_loop_s(VERLET, case)
    costs = {name: cost_on(name).loop_s(case) for name in (method, VERLET, *codes())}
    return costs[method] if costs[method] < inf else max(cost for cost in costs.values() if cost < inf)


def at_step(case: Case, share: float, stable_s: float) -> Case:
    """The case at about a share of the stability limit; where that exceeds the sample interval, with fewer samples."""
    step, interval = share * stable_s, case.scene.run.sample_interval
    return case.at(ceil(interval / step * (1 - 1e-12))) if step <= interval else case.sampled_at_every(step)


def affordable(rungs: list[Rung], budget_s: float) -> tuple[list[Rung], list[Rung]]:
    """Rungs that fit the budget, cheapest first, and those that do not."""
    kept, left, spent = list[Rung](), list[Rung](), 0.0
    for rung in sorted(rungs, key=lambda rung: rung.expected_s):
        fits = rung.expected_s <= LONGEST * budget_s and spent + rung.expected_s <= budget_s
        (kept if fits else left).append(rung)
        spent += rung.expected_s if fits else 0.0
    return kept, left


def climb(budget_s: float, scenes: tuple[str, ...] = SCENES) -> list[Row]:
    """All rows of the ladder, within a budget of engine time."""
    kept, left = affordable([rung for scene in scenes for rung in rungs_of(scene)], budget_s)
    rows: list[Row] = []
    for scene in scenes:
        own = [rung for rung in kept if rung.scene == scene]
        truths: dict[tuple[float, int], Truth] = {}
        began = time.perf_counter()
        for method in dict.fromkeys(rung.method for rung in own):
            rows += _by_method(method, [rung for rung in own if rung.method == method], truths)
        progress(f"{scene}: {len(own)} runs in {time.perf_counter() - began:.0f} s")
    return rows + [_row(rung, status=NOT_RUN, reason=f"its loop would take {rung.expected_s:.0f} s") for rung in left]


def _by_method(method: str, rungs: list[Rung], truths: dict[tuple[float, int], Truth]) -> Iterator[Row]:
    """Rows of one scene by one method, all by one process; rungs that share their samples share their exact motion."""
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
                key = (rung.case.scene.run.sample_interval, rung.case.scene.samples)
                if key not in truths:
                    truths[key] = truth_of(rung.case)
                loop_s, case_s = min(each.loop_s for each in runs), min(each.case_s for each in runs)
                times = {"loop_s": loop_s, "wall_s": start_s + case_s, "in_session_s": case_s}
                yield _row(rung, **times, **errors_by_group(rung.case, runs[-1].trace, truths[key]))
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
