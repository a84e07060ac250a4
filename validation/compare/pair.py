"""``beads compare RUN RUN``: differences of two runs at their common sample times.

Each run is judged by its own scheme, as everywhere; the differences of two right runs are those of their scenes, steps
and schemes, and are shown without a verdict.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from math import nan
from pathlib import Path

import numpy as np

from drivers.base import paths
from drivers.base.errors import InputError
from drivers.base.terminal import text_table
from drivers.chain.case import Case
from drivers.chain.trace import FORCE, Trace, part_of
from drivers.engines import load_engine
from drivers.run.run_folder import EndedRun, open_run
from drivers.run.scheme import COMPARED, difference, largest_difference, place_of, scale_of_motion
from drivers.scene.settings import differences, setting_text
from postproc.read.motion import chain_of, trace_with_state
from postproc.read.observables import describe, observe, of_kind, scale_of, without_unit
from validation.accuracy.budget import budget_lines
from validation.compare.diagnosis import diagnosis

KINDS = ("peak", "later peak", "speed")  # of observables shown
# of the largest change: rounding, horizon, coarse steps, experiments
LEVELS = (1e-9, 1e-6, 1e-3, 1e-2)
MIN_SAMPLES = 4  # for peaks
TIME_TOLERANCE = 1e-9  # of the longer run


@dataclass(frozen=True)
class PairedRun:
    """A run in a comparison.

    Attributes:
        case: case of the run's own scene.
        trace: trace at the sample times common to both runs.
    """

    run: EndedRun
    case: Case
    trace: Trace


def open_pair(first: Path, second: Path) -> tuple[PairedRun, PairedRun]:
    """Open two runs at their common sample times.

    Raises:
        InputError: one kept no forces, both are the same, or their contacts or sample times differ.
    """
    where = f"{paths.shown(first)} {paths.shown(second)}"
    if first.resolve() == second.resolve():
        raise InputError(where, "", "both are the same run; name two run folders")
    runs = [open_run(folder, failed=True) for folder in (first, second)]
    for run in runs:
        load_engine(run.record.engine, paths.shown(run.folder), "engine")
    counts = [run.trace.force_N.shape[1] for run in runs]
    if counts[0] != counts[1]:
        raise InputError(where, "", f"{counts[0]} contacts against {counts[1]}", "equal numbers of contacts")
    unit = TIME_TOLERANCE * max(float(run.trace.time_s[-1]) for run in runs)
    ticks = [np.round(run.trace.time_s / unit) for run in runs]
    common, *places = np.intersect1d(ticks[0], ticks[1], return_indices=True)
    if len(common) < MIN_SAMPLES:
        raise InputError(where, "run.sample_interval", f"{len(common)} common sample times", f"{MIN_SAMPLES} or more")
    one, other = (
        PairedRun(run, Case(*chain_of(run), ()), part_of(run.trace, at)) for run, at in zip(runs, places, strict=True)
    )
    return one, other


def compare_runs(first: Path, second: Path) -> int:
    """Prints the differences of two runs; the exit code is 1 if one failed or departs from its scheme.

    Raises:
        InputError: the runs cannot be compared.
    """
    pair = open_pair(first, second)
    both = dict(zip(("first", "second"), pair, strict=True))
    wrong, said = [], []
    for name, each in both.items():
        departure, cause = diagnosis(each.case, each.run.record.engine, trace_with_state(each.run))
        if departure or not each.run.done:
            wrong.append(f"the {name} run {'departs from its scheme' if departure else 'failed'}")
        said += [(name, words) for words in (departure, cause) if words]
    print(f"FAIL: {'; '.join(wrong)}" if wrong else "pass: both runs are those of their schemes")
    keys = [
        f"the scenes differ in {key}: {setting_text(key, a) or 'none'} against {setting_text(key, b) or 'none'}"
        for key, a, b in differences(pair[0].run.record.scene, pair[1].run.record.scene)
    ]
    table = text_table(_rows(*pair), right=(1,))
    for part in (_runs(both), keys or ["the scenes are the same"], table, _times(*pair), text_table(said)):
        print(*("", *part) if part else (), sep="\n")
    print(*budget_lines("run", {name: each.run for name, each in both.items()}), sep="\n")
    return 1 if wrong else 0


def _runs(both: dict[str, PairedRun]) -> Iterator[str]:
    """Lines on the two runs."""
    for name, each in both.items():
        record = each.run.record
        step = f"time step {record.time_step_s:g} s, {record.steps} steps, {len(each.run.trace.time_s)} samples"
        commit = f"commit {record.commit[:10]}{' and changes' if record.dirty else ''}"
        yield f"{name:<7} {paths.shown(each.run.folder)}"
        yield f"        {record.scene_name} on {record.engine} ({record.engine_version}), {step}, {commit}"
        if record.reason:
            yield f"        {record.status}: {record.reason}"
        for edit in record.edits or ():
            yield f"        deck changed: {edit}"
    time_s = both["first"].trace.time_s
    if any(len(each.run.trace.time_s) != len(time_s) for each in both.values()):
        yield f"        compared at {len(time_s)} common sample times, {time_s[1]:g} s apart"


def _rows(one: PairedRun, other: PairedRun) -> Iterator[tuple[str, str, str]]:
    """Quantity, difference, and its place or both values."""
    yield "quantity", "difference", "largest, or values of both runs"
    for quantity in COMPARED:
        scale = scale_of_motion(one.case, one.trace, quantity)
        size, _, where = largest_difference(quantity, other.trace, one.trace, scale)
        yield quantity, f"{size:.2e}", where
    has, right = observe(other.run.layout, other.trace), observe(one.run.layout, one.trace)
    for name in of_kind(right, *KINDS):
        if np.isfinite([has.get(name, nan), right[name]]).all():
            share = abs(has[name] - right[name]) / (scale_of(name, right) or 1.0)
            values = f"{right[name]:.7g} against {has[name]:.7g} {describe(name).unit}"
            yield without_unit(name), f"{share:.2e}", values


def _times(one: PairedRun, other: PairedRun) -> Iterator[str]:
    """Lines on the times at which the forces differ."""
    share = difference(FORCE, other.trace, one.trace, scale_of_motion(one.case, one.trace, FORCE))
    for level in LEVELS:
        beyond = (share > level).any(axis=1)
        sample = int(np.argmax(beyond))
        place = place_of(FORCE, one.trace.time_s, (sample, int(np.argmax(share[sample]))))
        when = f"first in {place}" if beyond.any() else "never"
        yield f"forces differ by more than {level:g} of the largest change: {when}"
