"""Scenes run on all engines and compared: what the comparison and the report need, and how a terminal shows it."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from drivers.base import paths
from drivers.chain.case import Case
from drivers.chain.trace import Trace
from drivers.engines import engine_names, in_order, load_engine
from drivers.limits.refusal import inability, refuse
from drivers.run.finished import EndedRun
from drivers.run.run import run_case
from validation.accuracy.assess import assess
from validation.accuracy.budget import PARTS, for_terminal
from validation.accuracy.plan import planned_case
from validation.compare.comparison import NOT_INSTALLED, REFUSED, compare_case
from validation.compare.departure import Departure, departure, departure_rows
from validation.compare.verdict import FAIL, Verdict


@dataclass(frozen=True)
class ComparedScene:
    """A scene with its runs and verdicts.

    Attributes:
        runs: finished runs by engine.
        absent: why an engine has none.
        departures: when each run first leaves the exact motion, and why; also those that failed.
        diagnoses: by engine, what a run with a failed verdict matches, in a sentence.
        refused: by engine, what there is of the trace of a run that failed; no verdict and no observable is of it.
    """

    case: Case
    runs: dict[str, EndedRun]
    absent: dict[str, str]
    verdicts: list[Verdict]
    departures: dict[str, Departure] = field(default_factory=dict)
    diagnoses: dict[str, str] = field(default_factory=dict)
    refused: dict[str, Trace] = field(default_factory=dict)


def run_and_compare(
    source: str | Path, settings: tuple[str, ...] = (), runs: Path = paths.RUNS, *, unsafe: bool = False
) -> ComparedScene:
    """Runs a scene on every installed engine, unless it is done, and compares the runs.

    Raises:
        InputError: the scene is wrong, or cannot end well and is not to be run all the same.
    """
    case = planned_case(source, *settings)
    finished: dict[str, EndedRun] = {}
    absent: dict[str, str] = {}
    refused: dict[str, Trace] = {}
    for engine in engine_names():
        if load_engine(engine).find() is None:
            absent[engine] = NOT_INSTALLED
        elif (cannot := inability(case, engine)) is not None:
            absent[engine] = f"{REFUSED}: {cannot}"
        else:
            if not unsafe:
                refuse(case, engine)
            result = assess(run_case(case, engine, runs), case)
            if result.done:
                finished[engine] = result
                continue
            absent[engine] = f"{result.record.status}: {result.record.reason}"
            if result.partial_trace is not None:
                refused[engine] = result.partial_trace
    verdicts = compare_case(case, finished, absent)
    traces = {engine: run.trace for engine, run in finished.items()} | refused
    departures = {engine: departure(case, engine, traces[engine]) for engine in in_order(traces)}
    diagnoses = {}
    if any(verdict.verdict == FAIL for verdict in verdicts):  # few are: only then are the variants loaded
        from validation.compare.diagnosis import diagnoses_of

        diagnoses = diagnoses_of(case, verdicts, traces)
    return ComparedScene(case, finished, absent, verdicts, departures, diagnoses, refused)


def compare_scenes(sources: Sequence[str], settings: tuple[str, ...], runs: Path, *, unsafe: bool) -> int:
    """Prints verdicts, departures, diagnoses and error budgets of scenes; 1 if a verdict is a failure.

    Raises:
        InputError: a scene is wrong, or cannot end well and is not to be run all the same.
    """
    failed = False
    for source in sources:
        compared = run_and_compare(source, settings, runs, unsafe=unsafe)
        print(*_lines(compared), sep="\n")
        failed |= any(verdict.verdict == FAIL for verdict in compared.verdicts)
    return 1 if failed else 0


def _lines(compared: ComparedScene) -> Iterator[str]:
    """Verdicts; when each run first leaves the exact motion and why, and what a failed one matches; error budgets."""
    yield f"{'scene':<12} {'engine':<10} {'quantity':<24} {'error':>9} {'allowed':>9}  verdict"
    for v in compared.verdicts:
        numbers = f"{v.value:9.2e} {v.limit:9.2e}" if v.quantity != "run" else " " * 19
        yield f"{v.scene:<12} {v.engine:<10} {v.quantity:<24} {numbers}  {v.verdict}: {v.where}"
    yield ""
    name = compared.case.scene.name
    for engine, each in departure_rows(compared.departures):
        yield f"{name:<12} {engine:<10} {each.words}"
    for engine, sentence in compared.diagnoses.items():
        yield f"{name:<12} {engine:<10} diagnosis: {sentence}"
    yield f"\n{'error budget':<23} {'quantity':<24} " + " ".join(f"{part:>10}" for part in PARTS)
    for engine, run in compared.runs.items():
        lines = [f"{quantity:<24} {numbers}" for quantity, numbers in for_terminal(run.record.error_budget or ())]
        lines += [f"warning: {warning}" for warning in run.record.warnings or ()]
        lines += [run.record.error_note] if run.record.error_note else []
        yield from (f"{name:<12} {engine:<10} {line}" for line in lines)
