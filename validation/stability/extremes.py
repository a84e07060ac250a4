"""Extreme scenes on all engines: verdicts, errors, and the time at which a run leaves the exact motion."""

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
from postproc.read.residual import largest_residual
from validation.accuracy.assess import assess
from validation.accuracy.motions import HORIZON
from validation.accuracy.plan import planned_case
from validation.studies import DONE, NOT_RUN

DEPARTURE_SHARE = 1e-2  # of the largest change: a run with this error has left the exact motion


class Extreme(Part):
    """Extreme scene of ``inputs/extremes.toml``.

    Attributes:
        set: settings over the scene, in the form of ``--set``.
        quick: True if the scene is in the subset of the tests and of the short study.
    """

    name: str
    scene: str
    set: tuple[str, ...] = Field(default=(), strict=False)
    quick: bool = False


class ExtremesFile(Part):
    """The file ``inputs/extremes.toml``."""

    extreme: tuple[Extreme, ...] = Field(strict=False)


@dataclass(frozen=True)
class Outcome:
    """Result of an extreme scene on one engine; errors over the largest change, NaN if nothing was measured.

    Attributes:
        verdict: ``done``, ``warned``, ``failed``, ``timeout``, ``refused`` or ``not run``, with the ``reason``.
        share_of_limit: the time step over the predicted stability limit.
        error: largest force error.
        model: largest force difference from Verlet in overlaps at the same step: rounding, unless something is wrong.
        leaves_reference_s: time at which the force error first passes 1 %; NaN if it never does.
        leaves_verlet_s: time at which the difference from Verlet ends pointwise comparison; NaN if it never does.
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
    """Scenes of ``inputs/extremes.toml``, or the quick subset."""
    file = validate(ExtremesFile, read_toml(paths.EXTREMES), paths.shown(paths.EXTREMES))
    return [each for each in file.extreme if each.quick or not quick]


@dataclass(frozen=True)
class _Prepared:
    """An extreme with its case, and the verdict of each engine before any run; ``done`` means that it will run."""

    name: str
    case: Case
    verdicts: dict[str, tuple[str, str]]

    @property
    def running(self) -> list[str]:
        return [name for name, (verdict, _) in self.verdicts.items() if verdict == DONE]


def run_all(chosen: list[Extreme], runs: Path) -> Iterator[Outcome]:
    """Outcomes of extremes on every engine, against the exact motion and Verlet; finished runs are reused."""
    prepared = [_prepare(each) for each in chosen]
    ended = iter(run_many([(each.case, name) for each in prepared for name in each.running], runs))
    for each in following(prepared, "extreme scenes, assessed", len(prepared), "scene"):
        yield from _outcomes(each, {name: assess(next(ended), each.case) for name in each.running})


def _prepare(extreme: Extreme) -> _Prepared:
    case, names = planned_case(extreme.scene, *extreme.set), (REFERENCE, VERLET, *codes())
    found = installed(names)
    verdicts = {name: (DONE, "") if name in found else (NOT_RUN, "not installed") for name in names}
    for name in found:
        try:
            refuse(case, name)
        except InputError as refusal:
            verdicts[name] = ("refused", str(refusal))
    return _Prepared(extreme.name, case, verdicts)


def _outcomes(prepared: _Prepared, ended: dict[str, EndedRun]) -> Iterator[Outcome]:
    """Outcomes of one scene, one per engine."""
    case, verdicts = prepared.case, dict(prepared.verdicts)
    for name, record in ((name, run.record) for name, run in ended.items()):
        verdict = "warned" if record.status == DONE and record.warnings else record.status
        verdicts[name] = (verdict, record.reason or "; ".join(record.warnings or ()))
    traces = {name: run.trace for name, run in ended.items() if run.done}
    scene, share = case.scene, case.scene.time_step_s / predicted_limit(case.chain, float(case.sample_times_s[-1]))
    for name, (verdict, reason) in verdicts.items():
        error, leaves_reference_s = _apart(traces, name, REFERENCE, DEPARTURE_SHARE)
        model, leaves_verlet_s = _apart(traces, name, VERLET, HORIZON)
        yield Outcome(
            prepared.name, name, verdict, reason, case.chain.bodies, scene.steps, scene.time_step_s, share, error,
            model, leaves_reference_s, leaves_verlet_s, ended[name].record.wall_s if name in ended else nan,
        )  # fmt: skip


def _apart(traces: dict[str, Trace], engine: str, other: str, limit: float) -> tuple[float, float]:
    """Largest difference of two runs, and the time at which it first passes a limit."""
    if engine not in traces or other not in traces or engine in (other, REFERENCE):
        return nan, nan
    return largest_residual(traces[engine], traces[other], limit)
