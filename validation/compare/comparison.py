"""Runs of scenes on all engines, compared with the baseline and with the exact motion.

The deviation from ``verlet``, the same scheme at the same step, is the modelling error, which should be rounding only.
The deviation from ``reference`` includes the error of the time step.
"""

from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

from drivers.base import paths
from drivers.base.kept import kept
from drivers.base.progress import following
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
from validation.accuracy.plan import planned_case
from validation.accuracy.prediction import IMPULSE, predict, run_errors
from validation.accuracy.schemes import ENERGY
from validation.compare.departure import Departure, departure, departure_of, deviation, motion_deviation
from validation.compare.selection import ALL_ENGINES, EngineSelection
from validation.compare.verdict import (
    FAIL,
    NOT_RUN,
    Verdict,
    judged,
    share_of_tolerance,
    without_run,
)

NOT_INSTALLED, REFUSED = "not installed", "refused"  # accepted reasons for a missing run


def compare_case(case: Case, runs: dict[str, EndedRun], absent: dict[str, str]) -> list[Verdict]:
    """Verdicts on the finished runs of a case, by engine, and on absent engines, with the reason by engine.

    An engine that is not installed or refused the case counts as not run; any other absence is a failure.
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
    """Verdicts on a run against its own scheme, or against another code if no in-repo engine models the scene."""
    verdicts = []
    if VERLET in runs and engine not in (VERLET, REFERENCE):
        baseline, own = baseline_of(case), baseline_of(case, engine)
        another_law = own.law != baseline.law and not own.why_unknown  # law of friction of the engine
        verlet, limit, samples = own.plain if another_law else runs[VERLET].trace, baseline.allowed, baseline.samples
        why = f"where rounding alone exceeds {HORIZON:g}"
        verdicts.append(_force_verdict(case, (engine, VERLET), run.trace, verlet, limit, samples, why))
        verdicts.append(motion_verdict(baseline, engine, run.trace, verlet))
    others = [name for name in runs if name != engine]
    if others and not {VERLET, REFERENCE} & set(runs):  # no in-repo engine models the scene
        other, limit = runs[others[0]].trace, tolerance("model", "sides")
        verdicts.append(_force_verdict(case, (engine, others[0]), run.trace, other, limit, case.scene.samples))
    return verdicts


def _force_verdict(
    case: Case, engines: tuple[str, str], trace: Trace, right: Trace, limit: Tolerance, samples: int, why: str = ""
) -> Verdict:
    """Verdict on the forces of an engine against another engine, over the first samples, with the reason to stop there.

    Args:
        case: the case of both runs.
        engines: the engine and the other engine.
        trace: trace of the engine.
        right: trace of the other engine.
        limit: the tolerance.
        samples: number of samples to compare.
        why: reason to compare no more samples.
    """
    found = deviation(trace, right, samples)
    engine, other = engines
    place = found.place + _judged_until(case, samples, why)
    return judged(case.scene.name, engine, f"force against {other}", found.share, limit, place)


def motion_verdict(baseline: Baseline, engine: str, trace: Trace, verlet: Trace) -> Verdict:
    """Verdict on kinetic energy and momentum, which shows wrong recorded velocities that affect no force.

    The tolerance is at least the tolerance of the forces.
    """
    chain, samples = baseline.case.chain, baseline.samples
    found = motion_deviation(chain, trace, verlet, samples)
    limit = max(tolerance("model", "motion"), baseline.allowed, key=lambda each: each.limit)
    if found.share > limit.limit:
        rounded = ROUNDING_MARGIN * motion_deviation(chain, baseline.rounded, baseline.plain, samples).share
        limit = max(limit, Tolerance(rounded, ROUNDING_REASON), key=lambda each: each.limit)
    return judged(baseline.case.scene.name, engine, "motion against verlet", found.share, limit, found.place)


def _predicted_verdicts(case: Case, engine: str, run: EndedRun, reference: EndedRun | None) -> Iterator[Verdict]:
    """Verdicts on the predicted errors of a run: force, the worst peak and speed, energy, impulse."""
    baseline = baseline_of(case, engine)
    predicted, samples = predict(baseline, engine, capped=case.plan is None), _known_samples(baseline)
    trace = until(run.trace, samples)
    exact = until(reference.trace, samples) if reference else None
    errors = run_errors(baseline, trace, exact)
    end = _judged_until(case, samples, f"where the error of the reference exceeds {HORIZON:g}")

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
                yield _closest(found)
    yield verdict(ENERGY, "energy drift", tolerance("energy", "drift"), "relative to the largest kinetic energy")
    interval_s = case.scene.run.sample_interval
    where = f"relative to the largest momentum, sampled every {interval_s * 1e6:g} µs"
    yield verdict(IMPULSE, "impulse balance", _sampled(case, trace), where)


def _closest(verdicts: list[Verdict]) -> Verdict:
    """Verdict closest to its limit, or furthest beyond; names the largest error if that is of another verdict."""
    closest = max(verdicts, key=lambda each: (share_of_tolerance(each), each.value))
    largest = max(verdicts, key=lambda each: each.value)
    if largest.value <= closest.value:
        return closest
    name, _, words = closest.where.partition(";")
    other = f"the largest error is {largest.value:.2e}, {largest.where.partition(';')[0]}"
    return replace(closest, where="; ".join(filter(None, (f"{name}, closest to its limit", other, words.strip()))))


def _known_samples(baseline: Baseline) -> int:
    """Number of samples at which the exact motion is known to ``HORIZON``; all if that is not known."""
    try:
        return baseline.case.scene.samples if baseline.why_unknown else len(baseline.exact.time_s)
    except ArithmeticError:
        return baseline.case.scene.samples


def _sampled(case: Case, trace: Trace) -> Tolerance:
    """General tolerance of the impulse, at least the sampling error of the wall force."""
    general, sampling = tolerance("impulse", "balance"), observe(case.layout, trace)["impulse_sampling_share"]
    if sampling > general.limit:
        return Tolerance(sampling, "the change of the wall's impulse if every other sample is left out")
    return general


def _judged_until(case: Case, samples: int, why: str) -> str:
    """End of a sentence: until when a run is judged and why; empty if all samples are."""
    if samples >= case.scene.samples:
        return ""
    return f"; judged until {case.sample_times_s[samples] * 1e6:g} µs, {why}"


@dataclass(frozen=True)
class ComparedScene:
    """A scene with its runs and verdicts.

    Attributes:
        runs: finished runs by engine.
        absent: reason for a missing run, by engine.
        departures: first departure of each run from the exact motion and its cause, for failed runs too.
        diagnoses: sentence on the variant that a run with a failed verdict matches, by engine.
        refused: partial trace of a failed run, by engine; used for no verdict and no observable.
        wall_s: wall time of each finished or failed run in s, by engine.
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
    asked: EngineSelection = ALL_ENGINES,
    *,
    unsafe: bool = False,
) -> ComparedScene:
    """Run and compare one scene, as ``run_and_compare_all``."""
    (compared,) = run_and_compare_all([source], settings, runs, asked, unsafe=unsafe)
    return compared


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
    absences = [_absences(case, asked) for case in cases]
    pairs = list(zip(cases, absences, strict=True))
    jobs = [(case, engine) for case, absent in pairs for engine in asked.names if engine not in absent]
    refuse_all([] if unsafe else jobs)
    ended = iter(run_many(jobs, runs, alone=True))
    for case, absent in following(pairs, "scenes compared", len(pairs), "scene"):
        yield _compared(case, {name: next(ended) for name in asked.names if name not in absent}, absent)


def _absences(case: Case, asked: EngineSelection) -> dict[str, str]:
    """Reasons why selected engines do not run a case, by engine."""
    absent = {}
    for engine in asked.names:
        if load_engine(engine).find() is None:
            absent[engine] = NOT_INSTALLED
        elif (cannot := inability(case, engine)) is not None:
            absent[engine] = f"{REFUSED}: {cannot}"
    return absent


def _compared(case: Case, ended: dict[str, EndedRun], absent: dict[str, str]) -> ComparedScene:
    """Assess and compare the finished and failed runs of a case; results are cached."""
    assessed = {engine: assess(run, case) for engine, run in ended.items()}
    finished = {engine: run for engine, run in assessed.items() if run.done}
    failed = {engine: run for engine, run in assessed.items() if not run.done}
    absent = absent | {engine: f"{run.record.status}: {run.record.reason}" for engine, run in failed.items()}
    refused = {engine: run.partial_trace for engine, run in failed.items() if run.partial_trace is not None}
    scene = [each.scene.model_dump(mode="json") for each in (case, case.full) if each]
    digests = {engine: [run.record.build_sha256, run.record.forces_sha256] for engine, run in finished.items()}
    if refused:  # partial traces are in no folder: no digest, no cache
        found = _judged(case, finished, absent, refused)
    else:
        found = kept(["compare", scene, absent, digests], lambda: _judged(case, finished, absent, {}))
    return ComparedScene(
        case,
        finished,
        absent,
        [Verdict(**verdict | {"scene": case.scene.name}) for verdict in found["verdicts"]],  # kept by content, not name
        {engine: departure_of(each) for engine, each in found["departures"].items()},
        found["diagnoses"],
        refused,
        {engine: run.record.wall_s for engine, run in assessed.items()},
    )


def _judged(
    case: Case, finished: dict[str, EndedRun], absent: dict[str, str], refused: dict[str, Trace]
) -> dict[str, Any]:
    """Verdicts, departures and diagnoses of the runs of a case, as JSON values."""
    verdicts = compare_case(case, finished, absent)
    traces = {engine: run.trace for engine, run in finished.items()} | refused
    departures = {engine: asdict(departure(case, engine, traces[engine])) for engine in in_order(traces)}
    diagnoses = {}
    if any(verdict.verdict == FAIL for verdict in verdicts):  # slow import, rarely needed
        from validation.compare.diagnosis import diagnoses_of

        diagnoses = diagnoses_of(case, verdicts, traces)
    return {"verdicts": [asdict(verdict) for verdict in verdicts], "departures": departures, "diagnoses": diagnoses}
