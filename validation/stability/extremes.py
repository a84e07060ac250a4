"""Scenes at the edge, through scene files and all engines: verdicts, errors, and when a run leaves the reference."""

from collections.abc import Iterator
from dataclasses import dataclass
from math import nan
from pathlib import Path

from pydantic import Field

from drivers.base import paths
from drivers.base.errors import InputError
from drivers.base.messages import validate
from drivers.base.progress import following
from drivers.chain.case import Case
from drivers.chain.trace import Trace
from drivers.engines import REFERENCE, VERLET, codes, installed
from drivers.limits.refusal import refuse
from drivers.limits.stable_step import predicted_limit
from drivers.run.finished import EndedRun
from drivers.run.run import run_many
from drivers.scene.model import Part
from drivers.scene.read_scene import read_toml
from postproc.read.residual import apart
from validation.accuracy.assess import assess
from validation.accuracy.baseline import HORIZON
from validation.accuracy.plan import planned_case
from validation.studies import DONE, NOT_RUN

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


@dataclass(frozen=True)
class _Posed:
    """An extreme with its case, and by engine the verdict before any run, with its reason: ``done`` is to be run."""

    name: str
    case: Case
    verdicts: dict[str, tuple[str, str]]

    @property
    def running(self) -> list[str]:
        return [name for name, (verdict, _) in self.verdicts.items() if verdict == DONE]


def run_all(some: list[Extreme], runs: Path) -> Iterator[Outcome]:
    """Outcomes of extremes on every engine, against the reference and Verlet; what is done is not run again."""
    posed = [_pose(each) for each in some]
    ended = iter(run_many([(each.case, name) for each in posed for name in each.running], runs))
    for each in following(posed, "scenes at the edge, assessed", len(posed), "scene"):
        yield from _outcomes(each, {name: assess(next(ended), each.case) for name in each.running})


def _pose(extreme: Extreme) -> _Posed:
    case, names = planned_case(extreme.scene, *extreme.set), (REFERENCE, VERLET, *codes())
    there = installed(names)
    verdicts = {name: (DONE, "") if name in there else (NOT_RUN, "not installed") for name in names}
    for name in there:
        try:
            refuse(case, name)
        except InputError as refusal:
            verdicts[name] = ("refused", str(refusal))
    return _Posed(extreme.name, case, verdicts)


def _outcomes(posed: _Posed, ended: dict[str, EndedRun]) -> Iterator[Outcome]:
    """Outcomes of one scene, engine by engine."""
    case, verdicts = posed.case, dict(posed.verdicts)
    for name, record in ((name, run.record) for name, run in ended.items()):
        verdict = "warned" if record.status == DONE and record.warnings else record.status
        verdicts[name] = (verdict, record.reason or "; ".join(record.warnings or ()))
    traces = {name: run.trace for name, run in ended.items() if run.done}
    scene, share = case.scene, case.scene.time_step_s / predicted_limit(case.chain, float(case.sample_times_s[-1]))
    for name, (verdict, reason) in verdicts.items():
        error, leaves_reference_s = _apart(traces, name, REFERENCE, LEFT)
        model, leaves_verlet_s = _apart(traces, name, VERLET, HORIZON)
        yield Outcome(
            posed.name, name, verdict, reason, case.chain.bodies, scene.steps, scene.time_step_s, share, error,
            model, leaves_reference_s, leaves_verlet_s, ended[name].record.wall_s if name in ended else nan,
        )  # fmt: skip


def _apart(traces: dict[str, Trace], engine: str, other: str, limit: float) -> tuple[float, float]:
    """The largest difference of two runs and the time at which it first passes a limit."""
    if engine not in traces or other not in traces or engine in (other, REFERENCE):
        return nan, nan
    return apart(traces[engine], traces[other], limit)
