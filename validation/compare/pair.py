"""``beads compare RUN RUN``: differences of two runs at their common sample times.

The table is the error budget with the other run in the place of the scheme: its forces, energy and momentum, plus the
difference of the schemes of the two engines at their time steps, if they have two, have to be those of the second run
within what rounding explains.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from math import isclose, nan
from pathlib import Path
from typing import Any

import numpy as np

from drivers.base import paths
from drivers.base.errors import InputError
from drivers.base.tolerances import Tolerance, tolerance
from drivers.batch.store import ENDING
from drivers.chain.case import Case
from drivers.chain.chain import Array
from drivers.chain.elements import choose_elements
from drivers.chain.residual import FORCE
from drivers.chain.trace import Trace, part_of, until
from drivers.engines import EXACT, load_engine
from drivers.run.run_folder import EndedRun, is_run, open_run
from drivers.run.scheme import FIELDS, apart, force_tolerance, largest_difference, place_of
from drivers.scene.settings import differences, setting_text
from postproc.read.error_bounds import bounds_on_observables
from postproc.read.motion import chain_of, trace_with_state
from postproc.read.observables import describe, observe, of_kind, scale_of, without_unit
from validation.accuracy.budget import budget_lines, departure_of
from validation.accuracy.motions import Motions, motions_of
from validation.checks import FAIL, Check, judged, table
from validation.compare.diagnosis import diagnosis

KINDS = ("peak", "later peak", "speed")  # of judged observables
# of the largest change: rounding, horizon, coarse steps, experiments
LEVELS = (1e-9, 1e-6, 1e-3, 1e-2)
MIN_SAMPLES = 4  # for peaks
TIME_TOLERANCE = 1e-9  # of a sample time
SAME = "the same scheme at the same step: only rounding may differ"
OTHER = "beyond the difference of the schemes at the two time steps, computed here for the scene of the first: rounding"


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
        checks: checks of the second run against the first, by quantity.
        until: end of a sentence: until when samples were judged, and why; empty if to the end.
        parted: place at which the forces first differ by more than a level, as text, by level.
    """

    first: PairedRun
    second: PairedRun
    checks: list[Check]
    until: str
    parted: dict[float, str]

    @property
    def missed(self) -> list[str]:
        """Quantities that differ by more than allowed."""
        return [check.quantity for check in self.checks if check.verdict == FAIL]


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
    if not is_run(folder):
        if next(folder.glob(f"*{ENDING}"), None) or next(folder.glob(f"batch/*{ENDING}"), None):
            lay_out = "run folders (beads show STUDY CASE lays a case out as one)"
            raise InputError(paths.shown(folder), "", "the store of a batch", lay_out)
        if any(map(is_run, folder.glob("*/"))):
            raise InputError(paths.shown(folder), "", "a folder of runs", "one of the run folders in it")
    run = open_run(folder, failed=True)
    load_engine(run.record.engine, paths.shown(folder), "engine")
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
    motions = [motions_of(one.case, one.engine), motions_of(one.case, other.engine)]
    if not same_scheme(one, other) and other.case.scene.steps_per_sample != one.case.scene.steps_per_sample:
        motions[1] = Motions(one.case.at(other.case.scene.steps_per_sample), motions[1].law)
    known = motions[0].straight or not any(motion.why_unknown for motion in motions)
    samples = min(motion.scheme.samples for motion in motions) if known else len(one.trace.time_s)
    expected = until(one.trace, samples)
    if known and not same_scheme(one, other):
        expected = _with_other_scheme(expected, motions[0].scheme_of(one.engine), motions[1].scheme_of(other.engine))
    share = apart(other.trace.force_N, one.trace.force_N, motions[0].scale(FORCE))
    return Pair(
        first=one,
        second=other,
        checks=[*_checks(one, other, motions, expected, known=known)],
        until=max((motion.scheme.until_horizon for motion in motions), key=len) if known else "",
        parted={level: _first_beyond(share, one.trace, level) for level in LEVELS},
    )


def _with_other_scheme(trace: Trace, scheme: Trace, other: Trace) -> Trace:
    """A run, changed by the difference of the other scheme from its own."""
    samples = min(len(each.time_s) for each in (trace, scheme, other))
    trace, scheme, other = (until(each, samples) for each in (trace, scheme, other))
    columns = ("force_N", *FIELDS.values())
    changed = {name: getattr(trace, name) + getattr(other, name) - getattr(scheme, name) for name in columns}
    return replace(trace, **changed)


def same_scheme(one: PairedRun, other: PairedRun) -> bool:
    """True if two runs have the same scheme and the same step."""
    same_step = isclose(one.run.record.time_step_s, other.run.record.time_step_s, rel_tol=1e-12)
    exact = [load_engine(each.engine).scheme == EXACT for each in (one, other)]
    return all(exact) or (not any(exact) and same_step)


def _allowed(
    one: PairedRun, other: PairedRun, motions: list[Motions], quantity: str, samples: int, *, known: bool
) -> tuple[Array, str]:
    """Limits of the forces, the energy or the momentum at each sample, and their reason.

    Runs differ by what rounding explains, twice for two schemes; if that is not known, by a general tolerance.
    """
    laws = {load_engine(each.engine).shear for each in (one, other)}
    if len(laws) > 1 and one.case.chain.lateral is not None and one.case.chain.slips:
        general = tolerance("model", "sides")
    elif not known:
        same = same_scheme(one, other)
        general = tolerance("model", force_tolerance(one.case)) if same else tolerance("truncation", FORCE)
    elif same_scheme(one, other):
        others = [motions_of(other.case, other.engine)] if one.case.scene != other.case.scene else []
        limits = [each.scheme.explained(quantity)[:samples] for each in (motions[0], *others)]
        return np.max([limit[: min(map(len, limits))] for limit in limits], axis=0), SAME
    else:
        return np.sum([motion.scheme.explained(quantity)[:samples] for motion in motions], axis=0), OTHER
    return np.full(samples, general.limit), general.reason


def _checks(
    one: PairedRun, other: PairedRun, motions: list[Motions], expected: Trace, *, known: bool
) -> Iterator[Check]:
    """Checks of forces, energy, momentum and observables of the second run.

    The limit of an observable is the largest change that an allowed difference of forces can make.
    """
    scene, engines = other.case.scene.name, f"{other.engine} against {one.engine}"
    second = until(other.trace, len(expected.time_s))
    samples = len(expected.time_s)
    allowed = {name: _allowed(one, other, motions, name, samples, known=known) for name in (FORCE, *FIELDS)}
    for quantity, (limits, why) in allowed.items():
        size, (sample, _), where = largest_difference(quantity, second, expected, motions[0].scale(quantity), limits)
        yield judged(scene, engines, quantity, size, Tolerance(float(limits[sample]), why), where)

    force, layout = float(allowed[FORCE][0].max()), one.run.layout
    reason = f"the change that a difference of forces of {force:.2g} can make"
    has, right = observe(other.run.layout, second), observe(layout, expected)
    first = observe(layout, until(one.trace, len(expected.time_s)))
    bounds = bounds_on_observables(layout, expected, right, force * motions[0].scale(FORCE))
    for name in of_kind(right, *KINDS):
        if name in has and np.isfinite([has[name], right[name]]).any():
            scale = scale_of(name, right) or 1.0
            error, limit = abs(has[name] - right[name]) / scale, Tolerance(bounds[name] / scale, reason)
            values = f"{first.get(name, nan):.7g} against {has[name]:.7g} {describe(name).unit}"
            yield judged(scene, engines, without_unit(name), float(error), limit, values)


def _first_beyond(share: np.ndarray, trace: Trace, level: float) -> str:
    """Place of the largest difference at the first sample at which one exceeds a level; empty if none does."""
    beyond = (share > level).any(axis=1)
    if not beyond.any():
        return ""
    sample = int(np.argmax(beyond))
    return place_of(FORCE, trace.time_s, (sample, int(np.argmax(share[sample]))))


def compare_runs(first: Path, second: Path) -> int:
    """Prints the differences of two runs; the exit code is 1 if one is larger than allowed, or a run failed.

    Raises:
        InputError: the runs cannot be compared.
    """
    pair = compare_pair(*open_pair(first, second))
    both = (("first", pair.first), ("second", pair.second))
    lines = different_keys(*(each.run.record.scene for _, each in both))
    keys = [f"the scenes differ in {line}" for line in lines] or ["the scenes are the same"]
    troubles = [f"larger differences than allowed in {', '.join(pair.missed)}"] if pair.missed else []
    troubles += [f"the {name} run failed" for name, each in both if not each.run.done]
    result = f"pass: all {len(pair.checks)} quantities agree within their limits"
    result = f"FAIL: {'; '.join(troubles)}" if troubles else result
    budgets = budget_lines("run", {name: each.run for name, each in both})
    print(result + pair.until, "", *_runs(*both), "", *keys, "", *_table(pair), "", *_times(pair), *budgets, sep="\n")
    return 1 if troubles else 0


def _runs(*both: tuple[str, PairedRun]) -> Iterator[str]:
    """Lines on the two runs."""
    for name, each in both:
        record = each.run.record
        step = f"time step {record.time_step_s:g} s, {record.steps} steps, {len(each.run.trace.time_s)} samples"
        commit = f"commit {record.commit[:10]}{' and changes' if record.dirty else ''}"
        yield f"{name:<7} {paths.shown(each.run.folder)}"
        yield f"        {record.scene_name} on {record.engine} ({record.engine_version}), {step}, {commit}"
        if record.reason:
            yield f"        {record.status}: {record.reason}"
        for edit in record.edits or ():
            yield f"        deck changed: {edit}"
    compared = both[0][1]
    samples, interval = len(compared.trace.time_s), compared.case.scene.run.sample_interval
    if any(len(each.run.trace.time_s) != samples for _, each in both):
        yield f"        compared at {samples} common sample times, {interval:g} s apart"


def _table(pair: Pair) -> Iterator[str]:
    """Rows of the checks, and the reasons of the limits."""
    yield from table(pair.checks)
    yield ""
    for reason in dict.fromkeys(check.reason for check in pair.checks):
        yield f"allowed: {reason}"


def _times(pair: Pair) -> Iterator[str]:
    """Lines on the times at which the forces differ, and on runs that depart from their schemes."""
    for level, place in pair.parted.items():
        yield f"forces differ by more than {level:g} of the largest change: {f'first in {place}' if place else 'never'}"
    for name, paired in (("first", pair.first), ("second", pair.second)):
        if departure := departure_of(paired.case, paired.engine, paired.trace):
            yield f"{name:<7} {departure}"
            if paired.run.has_state:
                yield f"{name:<7} {diagnosis(paired.case, paired.engine, trace_with_state(paired.run))}"


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
