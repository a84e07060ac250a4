"""Runs of scenes on all engines, judged by their error budgets."""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from drivers.base import paths
from drivers.base.progress import following
from drivers.chain.case import Case
from drivers.chain.trace import Trace
from drivers.engines import in_order, load_engine
from drivers.limits.refusal import inability
from drivers.run.run import refuse_all, run_many
from drivers.run.run_folder import EndedRun
from postproc.read.motion import trace_with_state
from validation.accuracy.assess import assess
from validation.accuracy.budget import kept_budget
from validation.accuracy.plan import planned_case
from validation.checks import FAIL, NOT_RUN, Check, without_run
from validation.compare.diagnosis import diagnosis
from validation.compare.selection import ALL_ENGINES, EngineSelection

NOT_INSTALLED, REFUSED = "not installed", "refused"  # accepted reasons for a missing run


@dataclass(frozen=True, eq=False)
class ComparedScene:
    """A scene with its runs and checks.

    Attributes:
        runs: finished runs by engine.
        absent: reason for a missing run, by engine.
        checks: checks of all engines.
        diagnoses: cause of the departure of a failed run from its scheme, by engine.
        refused: partial trace of a failed run, by engine; used for no check and no observable.
    """

    case: Case
    runs: dict[str, EndedRun]
    absent: dict[str, str]
    checks: list[Check]
    diagnoses: dict[str, str] = field(default_factory=dict)
    refused: dict[str, Trace] = field(default_factory=dict)

    @property
    def ran(self) -> set[str]:
        """Engines with a finished or failed run."""
        return {check.engine for check in self.checks if check.verdict != NOT_RUN}

    def of_engine(self, engine: str) -> list[Check]:
        """Checks of an engine."""
        return [check for check in self.checks if check.engine == engine]


def run_and_compare_all(
    sources: Sequence[str | Path],
    settings: tuple[str, ...] = (),
    runs: Path = paths.RUNS,
    asked: EngineSelection = ALL_ENGINES,
    *,
    unsafe: bool = False,
) -> Iterator[ComparedScene]:
    """Run scenes on every selected and installed engine in parallel, reusing finished runs, and compare them.

    Raises:
        InputError: a scene is wrong, or a run would be refused and ``unsafe`` is False.
    """
    cases = [planned_case(source, *settings) for source in sources]
    pairs = [(case, absences(case, asked.names)) for case in cases]
    jobs = [(case, engine) for case, absent in pairs for engine in asked.names if engine not in absent]
    refuse_all([] if unsafe else jobs, runs)
    ended = iter(run_many(jobs, runs, by_hand=True))
    for case, absent in following(pairs, "scenes compared", len(pairs), "scene"):
        yield _compared(case, {name: next(ended) for name in asked.names if name not in absent}, absent)


def absences(case: Case, engines: Iterable[str]) -> dict[str, str]:
    """Reasons why some of these engines do not run a case, by engine."""
    absent = {}
    for engine in engines:
        if load_engine(engine).find() is None:
            absent[engine] = NOT_INSTALLED
        elif (cannot := inability(case, engine)) is not None:
            absent[engine] = f"{REFUSED}: {cannot}"
    return absent


def _compared(case: Case, ended: dict[str, EndedRun], absent: dict[str, str]) -> ComparedScene:
    """Assess and judge the finished and failed runs of a case."""
    assessed = {engine: assess(run, case) for engine, run in ended.items()}
    finished = {engine: run for engine, run in assessed.items() if run.done}
    failed = {engine: run for engine, run in assessed.items() if not run.done}
    absent = absent | {engine: f"{run.record.status}: {run.record.reason}" for engine, run in failed.items()}
    refused = {engine: trace_with_state(run) for engine, run in failed.items() if run.has_forces}
    checks = [*missing(case, absent), *(check for run in finished.values() for check in kept_budget(case, run).checks)]
    causes = {engine: diagnosis(case, engine, refused[engine])[1] for engine in in_order(refused)}
    diagnoses = {engine: cause for engine, cause in causes.items() if cause}
    return ComparedScene(case, finished, absent, checks, diagnoses, refused)


def missing(case: Case, absent: dict[str, str]) -> list[Check]:
    """Checks of engines without a finished run, with the reason by engine.

    An engine that is not installed or refused the case counts as not run; any other absence is a failure.
    """
    return [
        without_run(case.scene.name, engine, why, NOT_RUN if why.startswith((NOT_INSTALLED, REFUSED)) else FAIL)
        for engine, why in absent.items()
    ]
