"""Scenes at the edge, through scene files and all engines: verdicts, errors, and when a run leaves the reference."""

from collections.abc import Iterator
from dataclasses import dataclass
from math import nan
from pathlib import Path

from pydantic import Field

from drivers.base import paths
from drivers.base.errors import InputError
from drivers.base.messages import validate
from drivers.chain.trace import Trace
from drivers.engines import REFERENCE, VERLET, codes, installed
from drivers.limits.refusal import refuse
from drivers.limits.stable_step import predicted_limit
from drivers.run.run import run_many
from drivers.scene.model import Part
from drivers.scene.read_scene import read_toml
from postproc.read.residual import apart
from validation.accuracy.assess import assess
from validation.accuracy.baseline import HORIZON
from validation.accuracy.plan import planned_case
from validation.studies import DONE, NOT_RUN, progress

LEFT = 1e-2  # of the largest change: a run that is further from the reference has left it


class Extreme(Part):
    """A scene at the edge, as ``inputs/extremes.toml`` has it.

    Attributes:
        set: settings laid over the scene, as ``--set`` takes them.
        quick: whether it belongs to the subset that the tests run.
    """

    name: str
    scene: str
    set: tuple[str, ...] = Field(default=(), strict=False)
    quick: bool = False


class ExtremesFile(Part):
    """All of them."""

    extreme: tuple[Extreme, ...] = Field(strict=False)


@dataclass(frozen=True)
class Outcome:
    """What came of an extreme on one engine; shares are of the largest change, NaN where nothing was measured.

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
    file = validate(ExtremesFile, read_toml(paths.EXTREMES), paths.shown(paths.EXTREMES))
    return [each for each in file.extreme if each.quick or not quick]


def run_all(some: list[Extreme], runs: Path) -> Iterator[Outcome]:
    """Outcomes of extremes on every engine; what is done is not run again."""
    for extreme in some:
        outcomes = run_extreme(extreme, runs)
        progress(f"{extreme.name}: {', '.join(f'{each.engine} {each.verdict}' for each in outcomes)}")
        yield from outcomes


def run_extreme(extreme: Extreme, runs: Path) -> list[Outcome]:
    """One scene on every engine, side by side, against the reference and Verlet."""
    case = planned_case(extreme.scene, *extreme.set)
    names = (REFERENCE, VERLET, *codes())
    there = installed(names)
    verdicts = {name: (DONE, "") if name in there else (NOT_RUN, "not installed") for name in names}
    for name in there:
        try:
            refuse(case, name)
        except InputError as refusal:
            verdicts[name] = ("refused", str(refusal))
    running = [name for name in names if verdicts[name][0] == DONE]
    found = run_many([(case, name) for name in running], runs)
    ended = {name: assess(run, case) for name, run in zip(running, found, strict=True)}
    for name, record in ((name, run.record) for name, run in ended.items()):
        verdict = "warned" if record.status == DONE and record.warnings else record.status
        verdicts[name] = (verdict, record.reason or "; ".join(record.warnings or ()))
    traces = {name: run.trace for name, run in ended.items() if run.done}
    scene, share = case.scene, case.scene.time_step_s / predicted_limit(case.chain, float(case.sample_times_s[-1]))
    outcomes = []
    for name in names:
        error, leaves_reference_s = _apart(traces, name, REFERENCE, LEFT)
        model, leaves_verlet_s = _apart(traces, name, VERLET, HORIZON)
        outcomes.append(
            Outcome(
                extreme.name, name, *verdicts[name], case.chain.bodies, scene.steps, scene.time_step_s, share, error,
                model, leaves_reference_s, leaves_verlet_s, ended[name].record.wall_s if name in ended else nan,
            )
        )  # fmt: skip
    return outcomes


def _apart(traces: dict[str, Trace], engine: str, other: str, limit: float) -> tuple[float, float]:
    """The largest difference of two runs and the time at which it first passes a limit."""
    if engine not in traces or other not in traces or engine in (other, REFERENCE):
        return nan, nan
    return apart(traces[engine], traces[other], limit)
