"""Runs the ladder: the error of every quantity against the time of the loop and of the whole run."""

import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
import pandas as pd

from drivers.base.errors import RunError
from drivers.base.files import whole_file
from drivers.chain.case import Case
from drivers.chain.integrator_arrays import arrays_of
from drivers.chain.trace import Trace
from drivers.engines import installed_codes, load_engine
from drivers.limits.stable_step import predicted_limit
from drivers.run.guard import checked_trace
from drivers.run.run import default_limit_s, run_case
from drivers.run.session import Session, served_by
from postproc.paper.simulate import case_of
from postproc.read.observables import of_kind
from validation.accuracy.costs import cost_on
from validation.accuracy.error_measures import (
    ENERGY,
    FORCE,
    Truth,
    errors_of,
    momentum_error,
    quantities,
    trace_of,
    truth_of,
    verlet_of,
)
from validation.reference.adaptive import integrate_adaptive
from validation.reference.symplectic import integrate_symplectic
from validation.trade.ladder import ADAPTIVE, ORDER_4, SCENES, SHARES, TOLERANCES, VERLET, Rung, affordable, at_step

REPEATS, SHORT_S = 3, 0.1  # runs expected to be shorter are timed as the best of some
IN_PROCESSES = {ADAPTIVE: "reference"}  # the engine by which an integrator runs by itself; of others verlet's counts
STEEPER = 4  # forces a step of order 4
NOT_RUN = "not run"
T = TypeVar("T")


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
    loop_s: float
    wall_s: float
    in_session_s: float
    force: float
    sensor_peak: float
    wall_peak: float
    arrival: float
    speed: float
    width: float
    energy: float
    momentum: float
    status: str
    reason: str


ERRORS = ("force", "sensor_peak", "wall_peak", "arrival", "speed", "width", "energy", "momentum")


def climb(budget_s: float, scenes: tuple[str, ...] = SCENES, say: Callable[[str], object] = print) -> list[Row]:
    """All rows of the ladder, within a budget of engine time."""
    climbers = [_Climber(scene) for scene in scenes]
    rungs = [rung for climber in climbers for rung in climber.rungs()]
    kept, left = affordable(rungs, budget_s)
    rows: list[Row] = []
    for climber in climbers:
        own = [rung for rung in kept if rung.scene == climber.scene]
        began = time.perf_counter()
        rows += climber.climb(own)
        say(f"{climber.scene}: {len(own)} runs in {time.perf_counter() - began:.0f} s")
    rows += [_empty(rung, NOT_RUN, f"its loop would take {rung.expected_s:.0f} s") for rung in left]
    return rows


class _Climber:
    """One scene's runs and what they are measured against."""

    def __init__(self, scene: str) -> None:
        self.scene = scene
        self.case = case_of(scene)
        self.stable_s = predicted_limit(self.case.chain, float(self.case.sample_times_s[-1]))
        self._truths: dict[tuple[float, int], Truth] = {}

    def rungs(self) -> Iterator[Rung]:
        for share in SHARES:
            case = at_step(self.case, share, self.stable_s)
            for method in (*installed_codes(), VERLET, ORDER_4):
                expected = cost_on(VERLET if method == ORDER_4 else method).loop_s(case)
                yield Rung(self.scene, method, case, share, expected * (STEEPER if method == ORDER_4 else 1))
        for tolerance in TOLERANCES:
            yield Rung(self.scene, ADAPTIVE, self.case, tolerance, cost_on("reference").loop_s(self.case))

    def truth(self, case: Case) -> Truth:
        """The exact motion at the case's samples, those of a scene's smallest steps being the same."""
        key = (case.scene.run.sample_interval, case.scene.samples)
        if key not in self._truths:
            self._truths[key] = truth_of(case)
        return self._truths[key]

    def climb(self, rungs: list[Rung]) -> list[Row]:
        rows: list[Row] = []
        for method in dict.fromkeys(rung.method for rung in rungs):
            own = [rung for rung in rungs if rung.method == method]
            if method in installed_codes():
                with tempfile.TemporaryDirectory() as folder:
                    rows += self._by_code(method, own, Path(folder))
            else:
                with tempfile.TemporaryDirectory() as folder:
                    start_s = start_up(IN_PROCESSES.get(method, VERLET), self.case, Path(folder))
                rows += [self._in_repo(rung, start_s) for rung in own]
        return rows

    def _by_code(self, name: str, rungs: list[Rung], folder: Path) -> Iterator[Row]:
        start_s = start_up(name, rungs[0].case, folder)
        with served_by(name, folder) as session:
            for rung in rungs:
                try:
                    trace, loop_s, session_s = timed_in_session(name, rung.case, session, rung.expected_s)
                except RunError as error:
                    yield _empty(rung, error.status, str(error))
                    continue
                yield self._row(rung, trace, loop_s, start_s + session_s, session_s)

    def _in_repo(self, rung: Rung, start_s: float) -> Row:
        case = rung.case
        if rung.method == VERLET:
            trace, loop_s = timed(lambda: verlet_of(case), rung.expected_s)
        elif rung.method == ORDER_4:
            chain, scene = arrays_of(case.chain), case.scene
            motion, loop_s = timed(
                lambda: integrate_symplectic(chain, scene.time_step_s, scene.steps_per_sample, scene.samples),
                rung.expected_s,
            )
            trace = trace_of(case, case.sample_times_s, motion)
        else:
            chain = arrays_of(case.chain)
            motion, loop_s = timed(lambda: integrate_adaptive(chain, case.sample_times_s, rung.share), rung.expected_s)
            trace = trace_of(case, case.sample_times_s, motion)
        if not np.isfinite(trace.force_N).all():
            return _empty(rung, "failed", "not finite: the step is too large")
        return self._row(rung, trace, loop_s, start_s + loop_s, loop_s)

    def _row(self, rung: Rung, trace: Trace, loop_s: float, wall_s: float, session_s: float) -> Row:
        truth = self.truth(rung.case)
        errors: dict[str, Any] = judged(rung.case, trace, truth)
        values: dict[str, Any] = {"loop_s": loop_s, "wall_s": wall_s, "in_session_s": session_s}
        return Row(**_head(rung), **values, **errors, status="done", reason="")


def judged(case: Case, trace: Trace, truth: Truth) -> dict[str, float]:
    """The errors of a row; of several gauges the largest."""
    groups = {
        "sensor_peak": [name for name in of_kind(truth.true, "peak") if name != "wall_peak"],
        "wall_peak": [name for name in truth.true if name == "wall_peak"],
        "arrival": of_kind(truth.true, "arrival"),
        "speed": of_kind(truth.true, "speed"),
        "width": [name for name in of_kind(truth.true, "width") if name.endswith("_4pct")],
    }
    seen = quantities(case, trace)
    errors = errors_of(case, trace, truth, (FORCE, ENERGY)) | {"momentum": momentum_error(case, trace, truth)}
    for group, names in groups.items():
        each = [abs(seen.get(name, np.inf) / truth.true[name] - 1) for name in names]
        errors[group] = max(each, default=float("nan"))
    return errors


def timed(action: Callable[[], T], expected_s: float) -> tuple[T, float]:
    """What an action gives, and its shortest time; a first call may compile and does not count."""
    best, result = float("inf"), action()
    for _ in range(REPEATS if expected_s < SHORT_S else 1):
        began = time.perf_counter()
        result = action()
        best = min(best, time.perf_counter() - began)
    return result, best


def start_up(name: str, case: Case, folder: Path) -> float:
    """Seconds of a process by itself that are not its loop; in-repo the better of two: the first may have to compile.

    Raises:
        RunError: it failed.
    """
    times = 2 if load_engine(name).in_repository else 1
    records = [run_case(case, name, folder / "single", rerun=True).record for _ in range(times)]
    return min(record.wall_s - (record.loop_s or 0.0) for record in records)


def timed_in_session(name: str, case: Case, session: Session, expected_s: float) -> tuple[Trace, float, float]:
    """The trace of a case in a session, seconds of its loop, and of the case.

    Raises:
        RunError: it failed.
    """
    engine = load_engine(name)
    deck = engine.render(case)
    loop_s = session_s = float("inf")
    for _ in range(REPEATS if expected_s < SHORT_S else 1):
        outcome = session.run(deck, default_limit_s(case))
        trace = checked_trace(case, engine, outcome, session.case)
        loop = engine.loop_seconds((session.case / "stdout.txt").read_text(errors="replace"))
        loop_s, session_s = min(loop_s, loop or 0.0), min(session_s, outcome.wall_s)
    return trace, loop_s, session_s


def _head(rung: Rung) -> dict[str, Any]:
    adaptive = rung.method == ADAPTIVE
    return {
        "scene": rung.scene,
        "method": rung.method,
        "time_step_s": float("nan") if adaptive else rung.case.scene.time_step_s,
        "share_of_limit": rung.share,
        "steps": 0 if adaptive else rung.case.scene.steps,
        "bodies": rung.case.chain.bodies,
    }


def _empty(rung: Rung, status: str, reason: str) -> Row:
    nothing: dict[str, Any] = dict.fromkeys(("loop_s", "wall_s", "in_session_s", *ERRORS), float("nan"))
    return Row(**_head(rung), **nothing, status=status, reason=reason)


def write_table(rows: list[Row], path: Path) -> None:
    """Writes ``trade.csv``."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with whole_file(path) as draft:
        pd.DataFrame(rows, columns=[field.name for field in fields(Row)]).to_csv(draft, index=False)
