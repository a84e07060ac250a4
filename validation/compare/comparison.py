"""Runs of scenes on all engines, judged by their error budgets."""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from drivers.base import paths
from drivers.base.terminal import following
from drivers.chain.case import Case
from drivers.chain.trace import Trace
from drivers.engines import (
    REFERENCE,
    VERLET,
    codes,
    engine_names,
    in_order,
    installed_codes,
    load_engine,
    missing_codes,
)
from drivers.limits import inability
from drivers.run.run import run_many
from drivers.run.run_folder import FORCES, EndedRun
from postproc.read.motion import trace_with_state
from validation.accuracy.budget import assess, kept_budget
from validation.accuracy.plan import planned_case
from validation.checks import FAIL, NOT_RUN, Check, without_run
from validation.compare.diagnosis import diagnosis

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


@dataclass(frozen=True)
class EngineSelection:
    """Engines selected for a comparison.

    Attributes:
        engines: engines to compare, in addition to the baseline and the reference; empty for all. Each has to run.
        require: further engines that have to run.
        allow_missing: True if only the engines of ``require`` have to run.

    Raises:
        InputError: an engine is unknown.
    """

    engines: tuple[str, ...] = ()
    require: tuple[str, ...] = ()
    allow_missing: bool = False

    def __post_init__(self) -> None:
        for option, names in (("--engine", self.engines), ("--require", self.require)):
            for name in names:
                load_engine(name, option)

    @property
    def names(self) -> list[str]:
        """Names of all engines to compare."""
        some = {*self.engines, *self.require, VERLET, REFERENCE}
        return [name for name in engine_names() if not self.engines or name in some]

    @property
    def needed(self) -> list[str]:
        """Names of the engines that have to run."""
        return list(dict.fromkeys([*self.require, *(() if self.allow_missing else self.engines)]))

    def unmet(self, scenes: Sequence[ComparedScene]) -> dict[str, str]:
        """Messages on unmet requirements, by engine; a failed run counts as a run."""
        present = {engine for scene in scenes for engine in scene.ran}
        absent = {engine: why for scene in reversed(scenes) for engine, why in scene.absent.items()}
        messages = {
            name: f"{name} is required and did not run: {load_engine(name).absence if why == NOT_INSTALLED else why}"
            for name, why in absent.items()
            if name in self.needed and name not in present
        }
        if not (messages or self.allow_missing or present & {*codes()}):
            missing = ", ".join(f"{name} ({load_engine(name).how_to_get})" for name in missing_codes())
            how = "" if installed_codes() else f": install one of {missing}"
            messages["codes"] = f"no established code ran{how}; use --allow-missing to accept this"
        return messages


def run_and_compare_all(
    sources: Sequence[str | Path],
    settings: tuple[str, ...] = (),
    runs: Path = paths.RUNS,
    asked: EngineSelection | None = None,
    *,
    unsafe: bool = False,
) -> Iterator[ComparedScene]:
    """Run scenes on every selected and installed engine in parallel, reusing finished runs, and compare them.

    Raises:
        InputError: a scene is wrong, or a run would be refused and ``unsafe`` is False.
    """
    asked = asked or EngineSelection()
    cases = [planned_case(source, *settings) for source in sources]
    pairs = [(case, absences(case, asked.names)) for case in cases]
    jobs = [(case, engine) for case, absent in pairs for engine in asked.names if engine not in absent]
    ended = iter(run_many(jobs, runs, unsafe=unsafe))
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
    refused = {engine: trace_with_state(run) for engine, run in failed.items() if FORCES in run.record.files}
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
