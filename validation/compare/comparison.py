"""``beads compare``: runs of a scene on all engines, judged by their error budgets; differences of two runs.

Each of two runs is judged by its own scheme, as everywhere; the differences of two right runs are those of their
scenes, steps and schemes, and are shown without a verdict.
"""

from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import chain
from math import nan
from pathlib import Path

import numpy as np

from drivers.base import paths
from drivers.base.errors import InputError, digits_apart
from drivers.base.terminal import counted, in_words, say, text_table
from drivers.chain.case import Case
from drivers.chain.trace import FORCE, Trace, largest_change_N, part_of
from drivers.engines import REFERENCE, VERLET, codes, expected_engines, in_order, installed_codes, load_engine
from drivers.limits import inability
from drivers.run.run import run_many
from drivers.run.run_folder import FORCES, EndedRun, open_run
from drivers.run.scheme import UNITS, difference, field_of, known_of, largest_difference, place_of, scale_of_motion
from drivers.scene.settings import differences, setting_text
from postproc.read.motion import case_of_run, trace_with_state
from postproc.read.observables import describe, observe, of_kind, scale_of, without_unit
from validation.accuracy.budget import ERROR, MODEL, assess, budget_lines, kept_budget
from validation.accuracy.plan import planned_case
from validation.checks import FAIL, NOT_RUN, PASS, Check, outcome, short, summary, table, without_run, worst_of
from validation.compare.diagnosis import diagnosis

Refusal = Callable[[Case, str], InputError | None]
Outcomes = Mapping[str, Mapping[str, str]]  # verdicts by scene or case, and by engine
LEGEND = """\
model: difference from velocity Verlet at the same step; error: difference from the exact motion;
both relative to the largest change of force, unless stated otherwise"""
INACCURATE = "inaccurate"  # the right computation, with larger errors than allowed
NOT_INSTALLED, REFUSED = "not installed", "refused"  # accepted reasons for a missing run
SCALES = (
    "differences of force, energy and momentum are divided by the first run's largest change of force, kinetic energy"
    " and momentum, those of peaks by its height above static load, others by its value"
)
KINDS = ("peak", "later peak", "speed")  # of observables of two runs that are shown
LEVELS = (1e-9, 1e-6, 1e-3, 1e-2)  # of the largest change: rounding, horizon, coarse steps, experiments
MIN_SAMPLES = 4  # for peaks
TIME_TOLERANCE = 1e-9  # of the longer run


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

    def of_engine(self, engine: str) -> list[Check]:
        """Checks of an engine."""
        return [check for check in self.checks if check.engine == engine]

    @property
    def verdicts(self) -> dict[str, str]:
        """Verdict of each engine, codes first; ``INACCURATE`` if nothing but its whole errors are too large."""
        verdicts = {}
        for engine in in_order([*self.runs, *self.absent]):
            failed = {check.quantity.partition(":")[0] for check in self.of_engine(engine) if check.verdict == FAIL}
            verdicts[engine] = INACCURATE if failed == {ERROR} else outcome(self.of_engine(engine))
        return verdicts


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
        others = (VERLET, REFERENCE) if self.engines else expected_engines()
        return sorted({*self.engines, *self.require, *others})

    def unmet(self, scenes: Sequence[ComparedScene]) -> dict[str, str]:
        """Messages on unmet requirements, by engine; a failed run counts as a run."""
        ran = {check.engine for scene in scenes for check in scene.checks if check.verdict != NOT_RUN}
        absent = {engine: why for scene in reversed(scenes) for engine, why in scene.absent.items()}
        needed = {*self.require, *(() if self.allow_missing else self.engines)}
        messages = {
            name: f"{name} is required and did not run: {load_engine(name).absence if why == NOT_INSTALLED else why}"
            for name, why in absent.items()
            if name in needed - ran
        }
        if not (messages or self.allow_missing or ran & {*codes()}):
            how = ", ".join(f"{name} ({load_engine(name).how_to_get})" for name in codes())
            install = "" if installed_codes() else f": install one of {how}"
            messages["codes"] = f"no established code ran{install}; use --allow-missing to accept this"
        return messages


def compare_cases(
    cases: Sequence[Case], engines: Sequence[str], runs: Path, cannot: Refusal = inability, *, unsafe: bool = False
) -> Iterator[ComparedScene]:
    """Run cases on the engines that are installed, in parallel, reusing finished runs, and compare them.

    ``cannot`` refuses a case.

    Raises:
        InputError: a run would be refused and ``unsafe`` is False.
    """
    absent = [absences(case, engines, cannot) for case in cases]
    jobs = [[(case, name) for name in engines if name not in whys] for case, whys in zip(cases, absent, strict=True)]
    ended = iter(run_many([*chain(*jobs)], runs, unsafe=unsafe))
    for case, whys, own in zip(cases, absent, jobs, strict=True):
        yield _compared(case, {name: next(ended) for _, name in own}, whys)


def absences(case: Case, engines: Iterable[str], cannot: Refusal = inability) -> dict[str, str]:
    """Reasons why some of these engines do not run a case, by engine."""
    absent = {}
    for engine in engines:
        if load_engine(engine).find() is None:
            absent[engine] = NOT_INSTALLED
        elif (refusal := cannot(case, engine)) is not None:
            absent[engine] = f"{REFUSED}: {refusal}"
    return absent


def _compared(case: Case, ended: dict[str, EndedRun], absent: dict[str, str]) -> ComparedScene:
    """Assess and judge the finished and failed runs of a case."""
    runs = {engine: assess(run, case) for engine, run in ended.items() if run.done}
    failed = {engine: run for engine, run in ended.items() if not run.done}
    absent = absent | {engine: f"{run.record.status}: {run.record.reason}" for engine, run in failed.items()}
    refused = {engine: trace_with_state(run) for engine, run in failed.items() if FORCES in run.record.files}
    checks = [*missing(case, absent), *(check for run in runs.values() for check in kept_budget(case, run).checks)]
    causes = {engine: cause for engine, trace in refused.items() if (cause := diagnosis(case, engine, trace)[1])}
    return ComparedScene(case, runs, absent, checks, causes, refused)


def missing(case: Case, absent: dict[str, str]) -> list[Check]:
    """Checks of engines without a finished run, with the reason by engine.

    An engine that is not installed or refused the case counts as not run; any other absence is a failure.
    """
    return [
        without_run(case.scene.name, engine, why, NOT_RUN if why.startswith((NOT_INSTALLED, REFUSED)) else FAIL)
        for engine, why in absent.items()
    ]


def compare_scenes(
    sources: Sequence[str],
    settings: tuple[str, ...],
    runs: Path,
    asked: EngineSelection,
    *,
    unsafe: bool,
    brief: bool = False,
) -> int:
    """Prints checks, diagnoses and error budgets of scenes.

    With ``brief`` the answer and the worst check of each engine. The exit code is 1 if a check fails or a required
    engine did not run.

    Raises:
        InputError: a scene is wrong, or a run would be refused and ``unsafe`` is False.
    """
    scenes, cases = [], [planned_case(source, *settings) for source in sources]
    with counted(f"{sources[0] if len(sources) == 1 else f'{len(sources)} scenes'} on all engines, compared"):
        for compared in compare_cases(cases, asked.names, runs, unsafe=unsafe):
            print(*_lines(compared, brief=brief), "", sep="\n", flush=True)
            scenes.append(compared)
    unmet = asked.unmet(scenes)
    if unmet:
        say("; ".join(unmet.values()))
    return 1 if unmet or any(check.verdict == FAIL for scene in scenes for check in scene.checks) else 0


def _lines(compared: ComparedScene, *, brief: bool) -> Iterator[str]:
    """Lines on a scene: summary, checks, diagnoses, error budgets; or the answer and the worst check of each engine."""
    name, sentences = compared.case.scene.name, " ".join(answer([compared]))
    if brief:
        by_engine = map(compared.of_engine, compared.verdicts)
        yield from (sentences, *table([worst_of(checks) or checks[0] for checks in by_engine]))
        return
    yield from (f"{name}: {summary(compared.checks)}", sentences, LEGEND, "", *table(compared.checks))
    if compared.diagnoses:
        yield from ("", *text_table([(name, *said) for said in compared.diagnoses.items()]))
    yield from budget_lines("engine", compared.runs)


def answer(scenes: Sequence[ComparedScene], cases: Outcomes | None = None) -> Iterator[str]:
    """Sentences that say if the codes agree: failures first, then the agreement, then missing runs.

    Args:
        scenes: compared scenes.
        cases: verdicts of independent cases, by case and engine.
    """
    rows = {scene.case.scene.name: scene.verdicts for scene in scenes}
    right = in_order(name for cells in rows.values() for name, verdict in cells.items() if verdict == PASS)
    agreeing = [name for name in right if not load_engine(name).in_repository]
    failed = [f"{name} fails on {where}" for name, where in _places(rows | dict(cases or {}), FAIL)]
    failed += [f"{name} is right but not accurate enough on {where}" for name, where in _places(rows, INACCURATE)]
    first = "Yes." if agreeing else "Not known whether the codes are right: none of them ran."
    yield f"No: {'; '.join(failed)}." if failed else first
    yield from _agreement(scenes, agreeing or [VERLET])
    left = defaultdict(list)
    for name, where in _places(rows, NOT_RUN):
        left[where].append(name)
    if left:
        yield f"Not judged, since not run: {'; '.join(f'{listed(left[where])} on {where}' for where in left)}."


def listed(items: Sequence[str]) -> str:
    """Words with commas, and "and" before the last."""
    return " and ".join(filter(None, (", ".join(items[:-1]), *items[-1:])))


def _agreement(scenes: Sequence[ComparedScene], engines: Sequence[str]) -> Iterator[str]:
    """Sentence on the largest deviations and the cost of these engines on the scenes on which they are right."""
    right = [(scene, engine) for scene in scenes for engine in engines if scene.verdicts.get(engine) == PASS]
    checks = [check for scene, engine in right for check in scene.of_engine(engine)]
    said = []
    for part, words in ((MODEL, "velocity Verlet at the same step"), (ERROR, "the exact motion")):
        if off := [check.value for check in checks if check.quantity == f"{part}: {FORCE}"]:
            said.append(f"with {words} to {short(max(off))}")
    if said:
        number, names = len({check.scene for check in checks}), listed([load_engine(name).in_print for name in engines])
        most_s = max(scene.runs[engine].record.loop_s or 0.0 for scene, engine in right)
        where = f"On {number} scenes the" if number > 1 else "The"
        yield f"{where} forces of {names} agree {listed(said)}, for at most {in_words(most_s)} of computing per run."


def _places(rows: Outcomes, verdict: str) -> Iterator[tuple[str, str]]:
    """Name of each engine with a verdict, and the rows that have it, such as "fig4 and fig5"."""
    for engine in in_order({engine for cells in rows.values() for engine in cells}):
        where = [row for row, cells in rows.items() if cells.get(engine) == verdict]
        if where:
            yield load_engine(engine).in_print, listed(where)


def compare_runs(first: Path, second: Path) -> int:
    """Prints the differences of two runs; the exit code is 1 if one failed or departs from its scheme.

    Raises:
        InputError: the runs cannot be compared.
    """
    both = {"first": open_run(first, failed=True), "second": open_run(second, failed=True)}
    runs, wrong, about = [*both.values()], [], []
    traces = common_samples(runs)
    for name, run in both.items():
        record = run.record
        departure, cause = diagnosis(case_of_run(run), record.engine, trace_with_state(run))
        if departure or not run.done:
            wrong.append(f"the {name} run {'departs from its scheme' if departure else 'failed'}")
        code = f"{record.scene_name} on {record.engine} ({record.engine_version})"
        step = f"time step {record.time_step_s:g} s, {len(run.trace.time_s)} samples, commit {record.commit[:10]}"
        edits = [f"deck changed: {edit}" for edit in record.edits or ()]
        lines = (paths.shown(run.folder), f"{code}, {step}", run.trouble, *edits, departure, cause)
        about += [(name, line) for line in lines if line]
    keys = [
        f"the scenes differ in {key}: {setting_text(key, a) or 'none'} against {setting_text(key, b) or 'none'}"
        for key, a, b in differences(runs[0].record.scene, runs[1].record.scene)
    ]
    print(f"FAIL: {'; '.join(wrong)}" if wrong else "pass: both runs are those of their schemes", "", sep="\n")
    print(*text_table(about), "", *(keys or ["the scenes are the same"]), "", sep="\n")
    print(*difference_lines(runs, traces), *budget_lines("run", both), sep="\n")
    return 1 if wrong else 0


def common_samples(runs: Sequence[EndedRun]) -> list[Trace]:
    """Traces of two runs at their common sample times.

    Raises:
        InputError: there are too few, or their contacts differ.
    """
    where, traces = " ".join(paths.shown(run.folder) for run in runs), [run.trace for run in runs]
    contacts = [trace.force_N.shape[1] for trace in traces]
    if contacts[0] != contacts[1]:
        raise InputError(where, "", f"{contacts[0]} contacts against {contacts[1]}", "equal numbers")
    unit = TIME_TOLERANCE * max(float(trace.time_s[-1]) for trace in traces)
    one, other = (np.round(trace.time_s / unit) for trace in traces)
    _, *places = np.intersect1d(one, other, return_indices=True)
    if len(places[0]) < MIN_SAMPLES:
        found = f"{len(places[0])} common sample times"
        raise InputError(where, "run.sample_interval", found, f"{MIN_SAMPLES} or more")
    return [part_of(trace, at) for trace, at in zip(traces, places, strict=True)]


def difference_rows(runs: Sequence[EndedRun], traces: Sequence[Trace]) -> Iterator[tuple[str, ...]]:
    """Quantity, relative difference, both values, and where they were taken."""
    case, (one, other) = case_of_run(runs[0]), traces
    for quantity, unit in UNITS.items():
        if not all(quantity in known_of(trace) for trace in traces):
            continue
        size, place, where = largest_difference(quantity, other, one, scale_of_motion(case, one, quantity))
        values = digits_apart(*(float(field_of(trace, quantity)[place]) for trace in traces))
        yield quantity, f"{size:.2e}", *(f"{value} {unit}" for value in values), where
    right, has = (observe(run.layout, trace) for run, trace in zip(runs, traces, strict=True))
    for name in of_kind(right, *KINDS):
        if np.isfinite([right[name], has.get(name, nan)]).all():
            share = abs(has[name] - right[name]) / (scale_of(name, right) or 1.0)
            values = digits_apart(right[name], has[name])
            yield without_unit(name), f"{share:.2e}", *(f"{value} {describe(name).unit}" for value in values)


def difference_lines(runs: Sequence[EndedRun], traces: Sequence[Trace]) -> Iterator[str]:
    """Table of the differences of two runs, and the times at which their forces begin to differ."""
    heading = ("quantity", "relative difference", "first run", "second run", "taken at")
    yield from text_table([heading, *difference_rows(runs, traces)], right=(1, 2, 3))
    one, other = traces
    yield from (SCALES, "", f"compared at {len(one.time_s)} common sample times")
    share = difference(FORCE, other, one, largest_change_N(one.force_N))
    for level in LEVELS:
        sample, contact = divmod(int(np.argmax(share > level)), share.shape[1])
        apart = share[sample, contact] > level
        when = f"first in {place_of(FORCE, one.time_s, (sample, contact))}" if apart else "never"
        yield f"forces differ by more than {level:g} of the largest change: {when}"
