"""``python -m validation compare RUN RUN``: differences of two runs at their common sample times."""

from collections.abc import Iterator
from dataclasses import dataclass
from math import isclose
from pathlib import Path
from typing import Any

import numpy as np

from drivers.base import paths
from drivers.base.errors import InputError
from drivers.base.files import sha256_of
from drivers.base.tolerances import Tolerance, tolerance
from drivers.batch.store import ENDING
from drivers.chain.case import Case
from drivers.chain.elements import choose_elements
from drivers.chain.trace import FORCES, Trace, part_of, until
from drivers.engines import EXACT, load_engine
from drivers.run.finished import FILE, EndedRun, open_run
from drivers.scene.settings import differences, setting_text
from postproc.read.motion import chain_of
from postproc.read.observables import describe, observe, of_kind, scale_of, without_unit
from postproc.read.residual import largest_change_N
from postproc.read.signals import integral
from validation.accuracy.baseline import HORIZON, baseline_of, model_quantity
from validation.accuracy.budget import BUDGET_WORDS, PARTS, budget_lines
from validation.accuracy.prediction import predicted_motion
from validation.compare.departure import Departure, Deviation, departure, deviation, first_deviation, motion_scales
from validation.compare.verdict import FAIL, Verdict, judged

KINDS = ("peak", "later peak", "speed")  # of judged observables
# of the largest change: rounding, horizon, coarse steps, experiments
LEVELS = (1e-9, 1e-6, 1e-3, 1e-2)
MIN_SAMPLES = 4  # for peaks
TIME_TOLERANCE = 1e-9  # of a sample time
PREDICTED = (
    "difference of velocity Verlet at the two time steps, computed here for the scene of the first, plus rounding"
)


@dataclass(frozen=True)
class PairedRun:
    """A run in a comparison.

    Attributes:
        case: case of the run's own scene, at the samples common to both runs.
        trace: trace at these samples.
    """

    run: EndedRun
    case: Case
    trace: Trace

    @property
    def engine(self) -> str:
        """Engine of the run."""
        return self.run.record.engine


@dataclass(frozen=True)
class Pair:
    """Comparison of two runs.

    Attributes:
        verdicts: verdicts on the second run against the first, by quantity.
        until: reason why not all samples were judged; empty if they were.
        parted: first sample at which the forces differ by more than a level, by level.
        departures: departure of each run from the exact motion of its own scene.
        against_first_scene: departure of the second run from the exact motion of the first run's scene.
    """

    first: PairedRun
    second: PairedRun
    verdicts: list[Verdict]
    until: str
    parted: dict[float, Deviation | None]
    departures: tuple[Departure, Departure]
    against_first_scene: Departure

    @property
    def missed(self) -> list[str]:
        """Quantities that differ by more than allowed."""
        return [verdict.quantity for verdict in self.verdicts if verdict.verdict == FAIL]


def open_pair(first: Path, second: Path) -> tuple[PairedRun, PairedRun]:
    """Open two runs at their common sample times.

    Raises:
        InputError: one is no finished run, both are the same, or their contacts or sample times differ.
    """
    where = f"{paths.shown(first)} {paths.shown(second)}"
    if first.resolve() == second.resolve():
        raise InputError(where, "", "both are the same run; name two run folders")
    one, other = _open(first), _open(second)
    counts = [run.trace.force_N.shape[1] for run in (one, other)]
    if counts[0] != counts[1]:
        raise InputError(where, "", f"{counts[0]} contacts against {counts[1]}", "equal numbers of contacts")
    every, samples = _common(where, one.trace, other.trace)
    if samples < MIN_SAMPLES:
        raise InputError(where, "", f"{samples} common sample times", f"{MIN_SAMPLES} or more")
    return _at_every(one, every[0], samples), _at_every(other, every[1], samples)


def _open(folder: Path) -> EndedRun:
    if not (folder / FILE).exists():
        if next(folder.glob(f"*{ENDING}"), None) or next(folder.glob(f"batch/*{ENDING}"), None):
            lay_out = "run folders (python -m drivers show STUDY CASE lays a case out as one)"
            raise InputError(paths.shown(folder), "", "the store of a batch", lay_out)
        if next(folder.glob(f"*/{FILE}"), None):
            raise InputError(paths.shown(folder), "", "a folder of runs", "one of the run folders in it")
    run = open_run(folder)
    load_engine(run.record.engine, paths.shown(folder / FILE), "engine")
    return run


def _common(where: str, *traces: Trace) -> tuple[list[int], int]:
    """Samples of each run per common sample, and the number of common samples."""
    times = [trace.time_s for trace in traces]
    intervals = [float(time[1] - time[0]) if len(time) > 1 else float("nan") for time in times]
    if np.isfinite(intervals).all():
        every = [round(max(intervals) / interval) for interval in intervals]
        thinned = [time[::each] for time, each in zip(times, every, strict=True)]
        samples = min(len(time) for time in thinned)
        whole = every == [1, 1] or samples == len(times[every.index(1)])  # all samples of the coarser run
        if whole and np.allclose(thinned[0][:samples], thinned[1][:samples], rtol=TIME_TOLERANCE, atol=0):
            return every, samples
    found = (f"samples each {each:g} s until {time[-1]:g} s" for each, time in zip(intervals, times, strict=True))
    common = "sample times of one run that the other has as well"
    raise InputError(where, "run.sample_interval", " against ".join(found), common)


def _at_every(run: EndedRun, every: int, samples: int) -> PairedRun:
    """A run at every n-th of its samples."""
    scene, chain = chain_of(run)
    if (every, samples) != (1, scene.samples):
        timing = scene.run.model_copy(update={"sample_interval": every * scene.run.sample_interval})
        changes = {"run": timing, "steps_per_sample": every * scene.steps_per_sample, "samples": samples}
        scene = scene.model_copy(update=changes)
    trace = part_of(run.trace, slice(0, every * samples, every))
    return PairedRun(run, Case(scene, chain, choose_elements(scene, chain)), trace)


def compare_pair(one: PairedRun, other: PairedRun) -> Pair:
    """Compare two runs."""
    (limits, samples), why_not_all = allowed_between(one, other), ""
    predicted: dict[str, Tolerance] = {}
    if not same_scheme(one, other):
        samples, predicted = _predicted(one, other, limits)
    if samples < len(one.trace.time_s):
        why_not_all = f"judged until {one.trace.time_s[samples] * 1e6:g} µs, where rounding alone exceeds {HORIZON:g}"
    first, second = (until(each.trace, samples) for each in (one, other))
    scene, engines = other.run.record.scene_name, f"{other.engine} against {one.engine}"
    verdicts = [
        judged(scene, engines, each.quantity, each.value, predicted.get(each.quantity, limits[each.kind]), each.where)
        for each in _differences(one, other, first, second)
    ]
    # one case after the other, since the baselines of the last case are cached
    of_first, against_first_scene = (departure(one.case, each.engine, each.trace) for each in (one, other))
    return Pair(
        first=one,
        second=other,
        verdicts=verdicts,
        until=why_not_all,
        parted={level: first_deviation(other.trace, one.trace, level) for level in LEVELS},
        departures=(of_first, departure(other.case, other.engine, other.trace)),
        against_first_scene=against_first_scene,
    )


def allowed_between(one: PairedRun, other: PairedRun) -> tuple[dict[str, Tolerance], int]:
    """Tolerances of two runs by kind of quantity, and the number of samples until rounding separates them.

    Runs of the same scheme at the same step differ by rounding only (and by their laws of friction). Other runs differ
    by their truncation errors: they get the general tolerances, which ``_predicted`` narrows.
    """
    if same_scheme(one, other):
        force, samples, of_gauges = *_by_rounding(one, other), {}
    else:
        force, samples = tolerance("truncation", "force"), len(one.trace.time_s)
        of_gauges = {quantity: tolerance("truncation", quantity) for quantity in ("peak", "speed")}
    factor = tolerance("between", "others")
    others = Tolerance(
        factor.limit * force.limit, f"{factor.limit:g} times the tolerance of the force; {factor.reason}"
    )
    limits = {"force": force, "peak": others, "speed": others, "others": others} | of_gauges
    return limits | {"later peak": limits["peak"]}, samples


def same_scheme(one: PairedRun, other: PairedRun) -> bool:
    """True if two runs have the same scheme and the same step."""
    same_step = isclose(one.run.record.time_step_s, other.run.record.time_step_s, rel_tol=1e-12)
    exact = [load_engine(each.engine).scheme == EXACT for each in (one, other)]
    return all(exact) or (not any(exact) and same_step)


def _by_rounding(one: PairedRun, other: PairedRun) -> tuple[Tolerance, int]:
    """Tolerance of the forces of runs of one scheme at one step, and the number of comparable samples."""
    everything = len(one.trace.time_s)
    laws = {load_engine(each.engine).shear for each in (one, other)}
    if len(laws) > 1 and one.case.chain.lateral is not None and one.case.chain.slips:
        return tolerance("model", "sides"), everything
    baselines = [baseline_of(one.case)]
    if one.case.scene != other.case.scene:
        baselines.append(baseline_of(other.case))
    if any(each.why_unknown for each in baselines):
        return tolerance("model", model_quantity(one.case)), everything
    widest = max((each.allowed for each in baselines), key=lambda each: each.limit)
    return widest, min(each.samples for each in baselines)


def _predicted(one: PairedRun, other: PairedRun, general: dict[str, Tolerance]) -> tuple[int, dict[str, Tolerance]]:
    """Number of samples at which the first scene is known, and predicted tolerances by quantity.

    Predicted tolerances above the general ones are left out; there are none if nothing can be predicted.
    """
    same = one.case.at(other.case.scene.steps_per_sample)
    first = predicted_motion(baseline_of(one.case, one.engine), one.engine)
    second = predicted_motion(baseline_of(same, other.engine), other.engine)
    if first is None or second is None:
        return len(one.trace.time_s), {}
    (motion, rest), (its_motion, its_rest) = first, second
    samples = min(len(motion.time_s), len(its_motion.time_s))
    others = tolerance("between", "others").limit
    limits = dict[str, Tolerance]()
    for apart in _differences(one, other, until(motion, samples), until(its_motion, samples)):
        factor = 1.0 if apart.kind == "force" else max(others, apart.change_share)
        limit = apart.value + factor * (rest + its_rest)
        if limit < general[apart.kind].limit:
            limits[apart.quantity] = Tolerance(limit, PREDICTED)
    return samples, limits


@dataclass(frozen=True)
class _Difference:
    """Difference of a quantity between two runs.

    Attributes:
        change_share: for peaks, the largest change of force over the scale of the peak.
    """

    quantity: str
    kind: str
    value: float
    where: str
    change_share: float = 0.0


def _differences(one: PairedRun, other: PairedRun, first: Trace, second: Trace) -> Iterator[_Difference]:
    """Differences of two traces, with the gauges of two runs."""
    found = deviation(second, first)
    yield _Difference("force", "force", found.share, found.place)

    should, has = observe(one.run.layout, first), observe(other.run.layout, second)
    for name in of_kind(should, *KINDS):
        if name not in has or (np.isnan(should[name]) and np.isnan(has[name])):
            continue
        observable = describe(name)
        arrival_s = should[name.replace("_peak_N", "_arrival_s")] if observable.kind == "peak" else np.nan
        when = f" at {arrival_s * 1e6:.6g} µs" if np.isfinite(arrival_s) else ""
        scale = scale_of(name, should) or 1.0
        values = f"{should[name]:.7g} against {has[name]:.7g} {observable.unit}"
        share = 0.0 if observable.kind == "speed" else largest_change_N(first.force_N) / scale
        error = float(abs(has[name] - should[name]) / scale)
        yield _Difference(without_unit(name), observable.kind, error, f"{values}{when}", share)

    energy_J, momentum_N_s = motion_scales(one.case.chain, first)
    series = {
        "kinetic energy": (first.kinetic_energy_J, second.kinetic_energy_J, energy_J),
        "total energy": (first.total_energy_J, second.total_energy_J, energy_J),
        "momentum": (first.momentum_N_s, second.momentum_N_s, momentum_N_s),
    }
    if one.run.layout.wall and other.run.layout.wall:
        own, others = (integral(each.time_s, each.force_N[:, 0]) for each in (first, second))
        series["wall impulse"] = (own, others, np.abs(own).max() or 1.0)
    for quantity, (expected, measured, scale) in series.items():
        share = np.abs(measured - expected) / scale
        sample = int(np.argmax(np.nan_to_num(share, nan=np.inf)))
        yield _Difference(quantity, "others", float(share[sample]), f"at {first.time_s[sample] * 1e6:g} µs")


def compare_runs(first: Path, second: Path) -> int:
    """Prints the differences of two runs; the exit code is 1 if one is larger than allowed.

    Raises:
        InputError: the runs cannot be compared.
    """
    pair = compare_pair(*open_pair(first, second))
    both = (("first", pair.first), ("second", pair.second))
    lines = different_keys(*(each.run.record.scene for _, each in both))
    keys = [f"the scenes differ in {line}" for line in lines] or ["the scenes are the same"]
    result = f"FAIL: larger differences than allowed in {', '.join(pair.missed)}"
    result = result if pair.missed else f"pass: all {len(pair.verdicts)} quantities agree within their tolerances"
    parts = (result, "", *_runs(*both), "", *keys, "", *_table(pair), "", *_times(pair), *_budgets(*both))
    print(*parts, sep="\n")
    return 1 if pair.missed else 0


def _runs(*both: tuple[str, PairedRun]) -> Iterator[str]:
    """Lines on the two runs."""
    for name, each in both:
        record = each.run.record
        step = f"time step {record.time_step_s:g} s, {record.steps} steps, {len(each.run.trace.time_s)} samples"
        commit = f"commit {record.commit[:10]}{' and changes' if record.dirty else ''}"
        yield f"{name:<7} {paths.shown(each.run.folder)}"
        yield f"        {record.scene_name} on {record.engine} ({record.engine_version}), {step}, {commit}"
    compared = both[0][1]
    samples, interval = len(compared.trace.time_s), compared.case.scene.run.sample_interval
    if any(len(each.run.trace.time_s) != samples for _, each in both):
        yield f"        compared at {samples} common sample times, {interval:g} s apart"


def _table(pair: Pair) -> Iterator[str]:
    """Rows of the verdicts, and the reasons of the tolerances."""
    yield f"{'quantity':<24} {'difference':>10} {'allowed':>9}  verdict"
    for each in pair.verdicts:
        yield f"{each.quantity:<24} {each.value:10.2e} {each.limit:9.2e}  {each.verdict}: {each.where}"
    if pair.until:
        yield pair.until
    yield ""
    used: dict[str, list[Verdict]] = {}
    for each in pair.verdicts:
        used.setdefault(each.reason, []).append(each)
    for reason, judged_by in used.items():
        least, most = (f"{choose(each.limit for each in judged_by):.2g}" for choose in (min, max))
        names = [each.quantity for each in judged_by]
        names = names if len(names) < 4 else [names[0], "...", names[-1]]
        yield f"allowed {least if least == most else f'{least} to {most}'} ({', '.join(names)}): {reason}"


def _times(pair: Pair) -> Iterator[str]:
    """Lines on the times at which the forces differ, and on the departures of the runs."""
    for level, found in pair.parted.items():
        place = f"first at {found.time_s * 1e6:.6g} µs in {found.quantity}" if found else "never"
        yield f"forces differ by more than {level:g} of the largest change: {place}"
    for name, first in zip(("first", "second"), pair.departures, strict=True):
        for each in (first, *first.later):
            yield f"{name:<7} {each.words}"
    if pair.missed and pair.against_first_scene.words != pair.departures[1].words:
        yield f"second, against the exact motion of the first: {pair.against_first_scene.words}"


def _budgets(*both: tuple[str, PairedRun]) -> Iterator[str]:
    """Lines with the error budgets, as signed parts that add up to the whole, and with warnings."""
    budgets = {name: dict(budget_lines(each.run.record.error_budget or ())) for name, each in both}
    quantities = dict.fromkeys(quantity for budget in budgets.values() for quantity in budget)
    if quantities:
        yield f"\nerror budget: {BUDGET_WORDS}"
        yield f"{'quantity':<24} {'run':<7} " + " ".join(f"{part:>10}" for part in PARTS)
    for quantity in quantities:
        for name, budget in budgets.items():
            if quantity in budget:
                yield f"{quantity:<24} {name:<7} {budget[quantity]}"
    for name, each in both:
        if each.run.record.error_note:
            yield f"{name:<7} {each.run.record.error_note}"
    for name, each in both:
        for warning in each.run.record.warnings or ():
            yield f"{name:<7} warning: {warning}"
        if sha256_of(each.run.folder / FORCES) != each.run.record.forces_sha256:
            yield f"{name:<7} warning: the forces have changed since the record was written"


def different_keys(one: dict[str, Any], other: dict[str, Any]) -> list[str]:
    """Lines for the keys that differ, such as ``run.time_step: 0.1 us against 1 us``.

    Args:
        one: scene of a run record, in SI units.
        other: scene of another run record.
    """
    return [
        f"{key}: {setting_text(key, a) or 'none'} against {setting_text(key, b) or 'none'}"
        for key, a, b in differences(one, other)
    ]
