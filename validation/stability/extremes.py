"""Scenes at the edge, through scene files and all engines: verdicts, errors, and when a run leaves the reference."""

import time
import tomllib
from collections.abc import Callable
from dataclasses import dataclass
from math import nan
from pathlib import Path

import numpy as np

from drivers import paths
from drivers.case import Case
from drivers.engines import codes, load_engine
from drivers.errors import InputError
from drivers.finished import open_run
from drivers.limits import refuse
from drivers.run import run_case
from drivers.trace import Trace
from postproc.residual import residual
from validation.rounding import HORIZON
from validation.simulate import REFERENCE, case_of
from validation.stable_step import predicted_limit

VERLET = "verlet"
LEFT = 1e-2  # of the largest force: a run that is further from the reference has left it
REFUSED, NOT_RUN = "refused", "not run"


@dataclass(frozen=True)
class Extreme:
    """A scene at the edge, as ``inputs/extremes.toml`` has it.

    Attributes:
        quick: whether it belongs to the subset that the tests run.
    """

    name: str
    scene: str
    settings: tuple[str, ...]
    quick: bool


@dataclass(frozen=True)
class Outcome:
    """What came of an extreme on one engine; shares are of the largest force, NaN where nothing was measured.

    Attributes:
        verdict: ``done``, ``warned``, ``failed``, ``timeout``, ``refused`` or ``not run``, with the ``reason``.
        share_of_limit: the time step over the predicted stability limit.
        error: largest force difference from the reference.
        model: largest force difference from Verlet in overlaps at the same step, which is rounding unless all is wrong.
        leaves_reference_s: when the difference from the reference first passes a per cent; NaN: never.
        leaves_verlet_s: when that from Verlet passes what pointwise comparison allows; NaN: never.
    """

    name: str
    engine: str
    verdict: str
    reason: str
    bodies: int
    steps: int
    time_step_s: float
    share_of_limit: float
    error: float
    model: float
    leaves_reference_s: float
    leaves_verlet_s: float
    wall_s: float


def extremes(*, quick: bool = False) -> list[Extreme]:
    """All of ``inputs/extremes.toml``, or its quick subset."""
    tables = tomllib.loads(paths.EXTREMES.read_text())["extreme"]
    found = [Extreme(t["name"], t["scene"], tuple(t["set"]), t.get("quick", False)) for t in tables]
    return [each for each in found if each.quick or not quick]


def run_all(some: list[Extreme], runs: Path, say: Callable[[str], object] = print) -> list[Outcome]:
    """Outcomes of extremes on every engine; what is done is not run again."""
    outcomes = []
    for extreme in some:
        began = time.perf_counter()
        outcomes += run_extreme(extreme, runs)
        verdicts = ", ".join(f"{each.engine} {each.verdict}" for each in outcomes if each.name == extreme.name)
        say(f"{extreme.name}: {verdicts} ({time.perf_counter() - began:.1f} s)")
    return outcomes


def run_extreme(extreme: Extreme, runs: Path) -> list[Outcome]:
    """One scene on every engine: first the yardsticks, then the codes against them."""
    case = case_of(extreme.scene, *extreme.settings)
    limit = predicted_limit(case.chain, float(case.sample_times_s[-1]))
    traces: dict[str, Trace] = {}
    return [_outcome(extreme, case, limit, engine, runs, traces) for engine in (REFERENCE, VERLET, *codes())]


def _outcome(
    extreme: Extreme, case: Case, limit_s: float, engine: str, runs: Path, traces: dict[str, Trace]
) -> Outcome:
    verdict, reason, wall_s = NOT_RUN, "not installed", nan
    if load_engine(engine).find() is not None:
        try:
            refuse(case, engine)
            ended = run_case(case, engine, runs)
        except InputError as refusal:
            verdict, reason = REFUSED, str(refusal)
        else:
            verdict, reason, wall_s = ended.record.status, ended.record.reason, ended.record.wall_s
            if ended.done:
                traces[engine] = open_run(ended.folder).trace
                verdict = "warned" if ended.record.warnings else verdict
                reason = "; ".join(ended.record.warnings)
    error, leaves_reference = _apart(traces, engine, REFERENCE, LEFT)
    model, leaves_verlet = _apart(traces, engine, VERLET, HORIZON)
    return Outcome(
        extreme.name, engine, verdict, reason, case.chain.bodies, case.scene.steps, case.scene.time_step_s,
        case.scene.time_step_s / limit_s, error, model, leaves_reference, leaves_verlet, wall_s,
    )  # fmt: skip


def _apart(traces: dict[str, Trace], engine: str, other: str, limit: float) -> tuple[float, float]:
    """The largest difference of two runs and the time at which it first passes a limit."""
    if engine not in traces or other not in traces or engine in (other, REFERENCE):
        return nan, nan
    apart = residual(traces[engine], traces[other])
    beyond = apart > limit
    return float(apart.max()), float(traces[engine].time_s[np.argmax(beyond)]) if beyond.any() else nan
