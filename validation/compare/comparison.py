"""Scenes run on all engines and compared with two yardsticks: the same scheme at the same step, the exact reference.

Against ``verlet`` at the same step a run shows its modelling error, which should be rounding; against
``reference`` it shows what the user pays for the time step.
"""

from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

from drivers.base import paths
from drivers.base.kept import kept
from drivers.base.progress import following, step
from drivers.base.tolerances import Tolerance, tolerance
from drivers.chain.case import Case
from drivers.chain.trace import Trace, until
from drivers.engines import REFERENCE, VERLET, in_order, load_engine
from drivers.limits.refusal import FORCE, inability
from drivers.run.finished import EndedRun
from drivers.run.run import refuse_all, run_many
from postproc.read.observables import observe, of_kind
from validation.accuracy.assess import assess
from validation.accuracy.baseline import HORIZON, ROUNDING_MARGIN, ROUNDING_REASON, Baseline, baseline_of
from validation.accuracy.budget import PARTS, for_terminal
from validation.accuracy.plan import planned_case
from validation.accuracy.prediction import IMPULSE, predict, run_errors
from validation.accuracy.schemes import ENERGY
from validation.compare.asked import EVERYTHING, Asked, print_unmet
from validation.compare.departure import Departure, departure, departure_of, departure_rows, deviation, motion_deviation
from validation.compare.verdict import (
    FAIL,
    NOT_RUN,
    RUN,
    Verdict,
    heading,
    judged,
    line_of,
    names,
    share_of,
    without_run,
)

NOT_INSTALLED, REFUSED = "not installed", "refused"  # why an engine has no run, and need not have one


def compare_case(case: Case, runs: dict[str, EndedRun], absent: dict[str, str]) -> list[Verdict]:
    """Verdicts on all finished runs of a case, by engine, and on those that are absent, by why.

    What is not installed, or refused the case by name, counts as not run, all else is a failure.
    """
    verdicts = []
    for engine, why in absent.items():
        verdict = NOT_RUN if why.startswith((NOT_INSTALLED, REFUSED)) else FAIL
        verdicts.append(without_run(case.scene.name, engine, why, verdict))
    for engine, run in runs.items():
        verdicts += _model_verdicts(case, engine, run, runs)
        verdicts += _predicted_verdicts(case, engine, run, runs.get(REFERENCE) if engine != REFERENCE else None)
    return verdicts


def _model_verdicts(case: Case, engine: str, run: EndedRun, runs: dict[str, EndedRun]) -> list[Verdict]:
    """The verdicts on a run against its own scheme; against another code where nothing else has the scene."""
    verdicts = []
    if VERLET in runs and engine not in (VERLET, REFERENCE):
        baseline, own = baseline_of(case), baseline_of(case, engine)
        another_law = own.law != baseline.law and not own.unknown  # of friction: the same scheme with the engine's
        verlet, limit, samples = own.plain if another_law else runs[VERLET].trace, baseline.allowed, baseline.samples
        why = f"where rounding alone passes {HORIZON:g}"
        verdicts.append(_force_verdict(case, (engine, VERLET), run.trace, verlet, limit, samples, why))
        verdicts.append(motion_verdict(baseline, engine, run.trace, verlet))
    others = [name for name in runs if name != engine]
    if others and not {VERLET, REFERENCE} & set(runs):  # a bore of flat sides: only the codes have it
        other, limit = runs[others[0]].trace, tolerance("model", "sides")
        verdicts.append(_force_verdict(case, (engine, others[0]), run.trace, other, limit, case.scene.samples))
    return verdicts


def _force_verdict(
    case: Case, engines: tuple[str, str], trace: Trace, right: Trace, limit: Tolerance, samples: int, why: str = ""
) -> Verdict:
    """The verdict on the forces of an engine against another's, over the first samples; why no more of them."""
    found = deviation(trace, right, samples)
    engine, other = engines
    place = found.place + _judged_until(case, samples, why)
    return judged(case.scene.name, engine, f"force against {other}", found.share, limit, place)


def motion_verdict(baseline: Baseline, engine: str, trace: Trace, verlet: Trace) -> Verdict:
    """Kinetic energy and momentum: recorded velocities that are off change no force.

    Where the forces are allowed more, by rounding or by a sphere for a face, so are they.
    """
    chain, samples = baseline.case.chain, baseline.samples
    found = motion_deviation(chain, trace, verlet, samples)
    limit = max(tolerance("model", "motion"), baseline.allowed, key=lambda each: each.limit)
    if found.share > limit.limit:
        rounded = ROUNDING_MARGIN * motion_deviation(chain, baseline.rounded, baseline.plain, samples).share
        limit = max(limit, Tolerance(rounded, ROUNDING_REASON), key=lambda each: each.limit)
    return judged(baseline.case.scene.name, engine, "motion against verlet", found.share, limit, found.place)


def _predicted_verdicts(case: Case, engine: str, run: EndedRun, reference: EndedRun | None) -> Iterator[Verdict]:
    """The verdicts on errors that the scheme of a run predicts: force, the worst peak and speed, energy, impulse."""
    baseline = baseline_of(case, engine)
    predicted, samples = predict(baseline, engine, capped=case.plan is None), _known_samples(baseline)
    trace = until(run.trace, samples)
    exact = until(reference.trace, samples) if reference else None
    errors = run_errors(baseline, trace, exact)
    end = _judged_until(case, samples, f"from when on the reference is off by {HORIZON:g}")

    def verdict(name: str, quantity: str, general: Tolerance, where: str) -> Verdict:
        limit, words = predicted.tolerance(name, general)
        return judged(case.scene.name, engine, quantity, errors[name], limit, where + words + end)

    if exact is not None:
        place = deviation(trace, exact).place
        yield verdict(FORCE, f"force against {REFERENCE}", tolerance("truncation", "force"), place)
        for label, kind in (("peak of a gauge", "peak"), ("speed between gauges", "speed")):
            general = tolerance("truncation", kind)
            found = [verdict(name, label, general, name) for name in of_kind(errors, kind)]
            if found:
                yield max(found, key=lambda each: (share_of(each), each.value))
    yield verdict(ENERGY, "energy drift", tolerance("energy", "drift"), "share of the largest kinetic energy")
    interval_s = case.scene.run.sample_interval
    where = f"share of momentum, with samples each {interval_s * 1e6:g} µs"
    yield verdict(IMPULSE, "impulse balance", _sampled(case, trace), where)


def _known_samples(baseline: Baseline) -> int:
    """At how many samples the exact motion is known to ``HORIZON``; all where nobody can tell."""
    try:
        return baseline.case.scene.samples if baseline.unknown else len(baseline.exact.time_s)
    except ArithmeticError:
        return baseline.case.scene.samples


def _sampled(case: Case, trace: Trace) -> Tolerance:
    """The general tolerance of the impulse, no finer than the samples of the wall's force allow."""
    general, sampling = tolerance("impulse", "balance"), observe(case.layout, trace)["impulse_sampling_share"]
    if sampling > general.limit:
        return Tolerance(sampling, "what the wall's impulse changes when every other sample is left out")
    return general


def _judged_until(case: Case, samples: int, why: str) -> str:
    """Until when a run is judged, and why no longer, for the end of a sentence; empty where all of it is."""
    if samples >= case.scene.samples:
        return ""
    return f"; judged until {case.sample_times_s[samples] * 1e6:g} µs, {why}"


@dataclass(frozen=True)
class ComparedScene:
    """A scene with its runs and verdicts.

    Attributes:
        runs: finished runs by engine.
        absent: why an engine has none.
        departures: when each run first leaves the exact motion, and why; also those that failed.
        diagnoses: by engine, what a run with a failed verdict matches, in a sentence.
        refused: by engine, what there is of the trace of a run that failed; no verdict and no observable is of it.
        wall_s: seconds of each run, well or badly ended, by engine.
    """

    case: Case
    runs: dict[str, EndedRun]
    absent: dict[str, str]
    verdicts: list[Verdict]
    departures: dict[str, Departure] = field(default_factory=dict)
    diagnoses: dict[str, str] = field(default_factory=dict)
    refused: dict[str, Trace] = field(default_factory=dict)
    wall_s: dict[str, float] = field(default_factory=dict)


def run_and_compare(
    source: str | Path,
    settings: tuple[str, ...] = (),
    runs: Path = paths.RUNS,
    asked: Asked = EVERYTHING,
    *,
    unsafe: bool = False,
) -> ComparedScene:
    """Runs and compares one scene, as ``run_and_compare_all``."""
    (compared,) = run_and_compare_all([source], settings, runs, asked, unsafe=unsafe)
    return compared


def run_and_compare_all(
    sources: Sequence[str | Path],
    settings: tuple[str, ...] = (),
    runs: Path = paths.RUNS,
    asked: Asked = EVERYTHING,
    *,
    unsafe: bool = False,
) -> Iterator[ComparedScene]:
    """Runs scenes on every installed engine that is asked for, side by side, unless they are done, and compares them.

    Raises:
        InputError: a scene is wrong, or cannot end well and is not to be run all the same.
    """
    cases = [planned_case(source, *settings) for source in sources]
    absences = [_absences(case, asked) for case in cases]
    pairs = list(zip(cases, absences, strict=True))
    jobs = [(case, engine) for case, absent in pairs for engine in asked.names if engine not in absent]
    refuse_all([] if unsafe else jobs)
    ended = iter(run_many(jobs, runs, alone=True))
    for case, absent in following(pairs, "scenes compared", len(pairs), "scene"):
        yield _compared(case, {name: next(ended) for name in asked.names if name not in absent}, absent)


def _absences(case: Case, asked: Asked) -> dict[str, str]:
    """Why some engines that are asked for do not run a case."""
    absent = {}
    for engine in asked.names:
        if load_engine(engine).find() is None:
            absent[engine] = NOT_INSTALLED
        elif (cannot := inability(case, engine)) is not None:
            absent[engine] = f"{REFUSED}: {cannot}"
    return absent


def _compared(case: Case, ended: dict[str, EndedRun], absent: dict[str, str]) -> ComparedScene:
    """A case with its runs, well or badly ended, assessed and compared; what was compared before is kept."""
    assessed = {engine: assess(run, case) for engine, run in ended.items()}
    finished = {engine: run for engine, run in assessed.items() if run.done}
    failed = {engine: run for engine, run in assessed.items() if not run.done}
    absent = absent | {engine: f"{run.record.status}: {run.record.reason}" for engine, run in failed.items()}
    refused = {engine: run.partial_trace for engine, run in failed.items() if run.partial_trace is not None}
    scene = [each.scene.model_dump(mode="json") for each in (case, case.full) if each]
    digests = {engine: [run.record.build_sha256, run.record.forces_sha256] for engine, run in finished.items()}
    if refused:  # of which no folder keeps the samples
        found = _judged(case, finished, absent, refused)
    else:
        found = kept(["compare", scene, absent, digests], lambda: _judged(case, finished, absent, {}))
    return ComparedScene(
        case,
        finished,
        absent,
        [Verdict(**verdict) for verdict in found["verdicts"]],
        {engine: departure_of(each) for engine, each in found["departures"].items()},
        found["diagnoses"],
        refused,
        {engine: run.record.wall_s for engine, run in assessed.items()},
    )


def _judged(
    case: Case, finished: dict[str, EndedRun], absent: dict[str, str], refused: dict[str, Trace]
) -> dict[str, Any]:
    """Verdicts, departures and diagnoses of a scene's runs, as JSON holds them."""
    verdicts = compare_case(case, finished, absent)
    traces = {engine: run.trace for engine, run in finished.items()} | refused
    departures = {engine: asdict(departure(case, engine, traces[engine])) for engine in in_order(traces)}
    diagnoses = {}
    if any(verdict.verdict == FAIL for verdict in verdicts):  # few are: only then are the variants loaded
        from validation.compare.diagnosis import diagnoses_of

        diagnoses = diagnoses_of(case, verdicts, traces)
    return {"verdicts": [asdict(verdict) for verdict in verdicts], "departures": departures, "diagnoses": diagnoses}


def compare_scenes(sources: Sequence[str], settings: tuple[str, ...], runs: Path, asked: Asked, *, unsafe: bool) -> int:
    """Prints verdicts, departures, diagnoses and error budgets of scenes.

    Builds of one code that are asked for are compared with each other as well; without ``sources`` that alone is done,
    on all shipped scenes. The exit code is 1 if a verdict is a failure or an engine that has to run did not.

    Raises:
        InputError: a scene is wrong, or cannot end well and is not to be run all the same.
    """
    verdicts: list[Verdict] = []
    between: list[Verdict] = []
    ran = set[str]()
    scenes = sources or sorted(path.stem for path in paths.SCENES.glob("*.toml"))
    with step(f"{scenes[0] if len(scenes) == 1 else f'{len(scenes)} scenes'} on all engines, compared"):
        for compared in run_and_compare_all(scenes, settings, runs, asked, unsafe=unsafe):
            between += [verdict for pair in asked.builds for verdict in _between(compared, *pair)]
            ran |= set(compared.wall_s)
            if sources:
                print(*_lines(compared), "", sep="\n", flush=True)
                verdicts += compared.verdicts
    if between:
        print(heading(), *map(line_of, between), sep="\n")
    failed = any(verdict.verdict == FAIL for verdict in verdicts + between)
    return 1 if print_unmet(asked.unmet(ran)) or failed else 0


def _between(compared: ComparedScene, one: str, other: str) -> list[Verdict]:
    """Verdicts on the quantities in which two builds of a code differ."""
    scene, pair = compared.case.scene.name, f"{other} against {one}"
    why = [f"{engine}: {compared.absent[engine]}" for engine in (one, other) if engine in compared.absent]
    if why:
        failed = any(v.verdict == FAIL for v in compared.verdicts if v.engine in (one, other) and v.quantity == RUN)
        return [without_run(scene, pair, "; ".join(why), FAIL if failed else NOT_RUN)]
    from validation.compare.moved import moved  # what looks at two runs is loaded only where two are looked at

    rows = moved(compared.runs[one].folder, compared.runs[other].folder)
    return [replace(verdict, scene=scene, engine=pair) for verdict in rows]


def _lines(compared: ComparedScene) -> Iterator[str]:
    """Verdicts; when each run first leaves the exact motion and why, and what a failed one matches; error budgets."""
    yield heading()
    yield from map(line_of, compared.verdicts)
    yield ""
    name = compared.case.scene.name
    for engine, each in departure_rows(compared.departures):
        yield f"{names(name, engine)} {each.words}"
    for engine, sentence in compared.diagnoses.items():
        yield f"{names(name, engine)} diagnosis: {sentence}"
    yield f"\n{names('error budget', '')} {'quantity':<24} " + " ".join(f"{part:>10}" for part in PARTS)
    for engine, run in compared.runs.items():
        lines = [f"{quantity:<24} {numbers}" for quantity, numbers in for_terminal(run.record.error_budget or ())]
        lines += [f"warning: {warning}" for warning in run.record.warnings or ()]
        lines += [run.record.error_note] if run.record.error_note else []
        yield from (f"{names(name, engine)} {line}" for line in lines)
