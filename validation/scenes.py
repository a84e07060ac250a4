"""Runs a scene on all engines and gathers what the comparison and the report need."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from drivers import paths
from drivers.case import Case, build_case
from drivers.engines import engine_names, load_engine
from drivers.finished import FinishedRun, open_run
from drivers.limits import inability
from drivers.read_scene import read_scene
from drivers.run import run_case
from validation.comparison import NOT_INSTALLED, REFUSED, compare_case
from validation.verdict import Verdict


@dataclass(frozen=True)
class ComparedScene:
    """A scene with its runs and verdicts.

    Attributes:
        runs: finished runs by engine.
        absent: why an engine has none.
        departures: when and why a run first leaves the exact motion, by engine.
        diagnoses: what a run that is off matches, in one sentence, by engine.
    """

    case: Case
    runs: dict[str, FinishedRun]
    absent: dict[str, str]
    verdicts: list[Verdict]
    departures: dict[str, Any] = field(default_factory=dict)
    diagnoses: dict[str, str] = field(default_factory=dict)


def run_and_compare(
    source: str | Path, settings: tuple[str, ...] = (), runs: Path = paths.RUNS, *, unsafe: bool = False
) -> ComparedScene:
    """Runs a scene on every installed engine, unless it is done, and compares the runs.

    Raises:
        InputError: the scene is wrong, or cannot end well and is not to be run all the same.
    """
    case = build_case(read_scene(source, settings))
    finished: dict[str, FinishedRun] = {}
    absent: dict[str, str] = {}
    for engine in engine_names():
        if load_engine(engine).find() is None:
            absent[engine] = NOT_INSTALLED
            continue
        cannot = inability(case, engine)
        if cannot is not None:
            absent[engine] = f"{REFUSED}: {cannot}"
            continue
        result = run_case(case, engine, runs, unsafe=unsafe)
        if result.done:
            finished[engine] = open_run(result.folder)
        else:
            absent[engine] = f"{result.record.status}: {result.record.reason}"
    return ComparedScene(case, finished, absent, compare_case(case, finished, absent))
