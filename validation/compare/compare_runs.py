"""``python -m validation compare RUN RUN``."""

from collections.abc import Iterator
from pathlib import Path

from drivers.base import paths
from validation.accuracy.parts import PARTS, for_terminal
from validation.compare.open_pair import Opened, changed_since, open_pair
from validation.compare.pair import Pair, compare_pair
from validation.compare.verdict import FAIL

NAMES = ("first", "second")


def compare_runs(first: Path, second: Path) -> int:
    """Prints how two runs differ; 1 if by more than is allowed.

    Raises:
        InputError: they cannot be compared.
    """
    pair = compare_pair(*open_pair(first, second))
    for part in (_runs, _keys, _table, _reasons, _times, _explained, _budgets, _warnings):
        for line in part(pair):
            print(line)
    missed = [verdict.quantity for verdict in pair.verdicts if verdict.verdict == FAIL]
    print(f"\nFAIL: {', '.join(missed)}" if missed else "\npass")
    return 1 if missed else 0


def _both(pair: Pair) -> Iterator[tuple[str, Opened]]:
    yield from zip(NAMES, (pair.first, pair.second), strict=True)


def _runs(pair: Pair) -> Iterator[str]:
    """What the runs are."""
    for name, opened in _both(pair):
        record = opened.run.record
        step = f"time step {record.time_step_s:g} s, {record.steps} steps, {len(opened.run.trace.time_s)} samples"
        commit = f"commit {record.commit[:10]}{' and changes' if record.dirty else ''}"
        yield f"{name:<7} {paths.shown(opened.run.folder)}"
        yield f"        {record.scene_name} on {record.engine} ({record.engine_version}), {step}, {commit}"
    samples, interval = len(pair.first.trace.time_s), pair.first.case.scene.run.sample_interval
    if any(len(opened.run.trace.time_s) != samples for _, opened in _both(pair)):
        yield f"        compared at the {samples} sample times that both have, {interval:g} s apart"


def _keys(pair: Pair) -> Iterator[str]:
    yield ""
    if not pair.keys:
        yield "the scenes are the same"
    for line in pair.keys:
        yield f"differs {line}"


def _table(pair: Pair) -> Iterator[str]:
    yield ""
    yield f"{'quantity':<24} {'difference':>10} {'allowed':>9}  verdict"
    for each in pair.verdicts:
        yield f"{each.quantity:<24} {each.value:10.2e} {each.limit:9.2e}  {each.verdict}: {each.where}"
    if pair.until:
        yield pair.until


def _reasons(pair: Pair) -> Iterator[str]:
    """Why so much is allowed, each reason once."""
    used: dict[tuple[float, str], list[str]] = {}
    for each in pair.verdicts:
        used.setdefault((each.limit, each.reason), []).append(each.quantity)
    yield ""
    for (limit, reason), quantities in used.items():
        names = quantities if len(quantities) < 4 else [quantities[0], "...", quantities[-1]]
        yield f"allowed {limit:.2g} ({', '.join(names)}): {reason}"


def _times(pair: Pair) -> Iterator[str]:
    """When the runs part, and when each leaves the exact motion of its own scene."""
    yield ""
    for level, found in pair.parted.items():
        place = f"at {found.time_s * 1e6:.6g} µs in contact {found.contact}" if found else "never"
        yield f"parted by {level:g} of the largest force {place}"
    for (name, _), first in zip(_both(pair), pair.departures, strict=True):
        for each in (first, *first.later):
            yield f"{name:<7} {each.words}"


def _explained(pair: Pair) -> Iterator[str]:
    """What a miss looks like: the second run taken for one of the first's scene."""
    if pair.missed and pair.taken_for.words != pair.departures[1].words:
        yield f"second, taken for a run of the first's scene: {pair.taken_for.words}"


def _budgets(pair: Pair) -> Iterator[str]:
    """The parts of each run's errors, as signed shares; they add up to the whole."""
    budgets = {name: dict(for_terminal(opened.run.record.error_budget or ())) for name, opened in _both(pair)}
    quantities = dict.fromkeys(quantity for budget in budgets.values() for quantity in budget)
    if quantities:
        yield f"\n{'error budget':<24} {'':<7} " + " ".join(f"{part:>10}" for part in PARTS)
    for quantity in quantities:
        for name, budget in budgets.items():
            if quantity in budget:
                yield f"{quantity:<24} {name:<7} {budget[quantity]}"
    for name, opened in _both(pair):
        if opened.run.record.error_note:
            yield f"{name:<7} {opened.run.record.error_note}"


def _warnings(pair: Pair) -> Iterator[str]:
    for name, opened in _both(pair):
        for warning in opened.run.record.warnings or ():
            yield f"{name:<7} warning: {warning}"
        if changed_since(opened.run):
            yield f"{name:<7} warning: its forces are not those that its record was written for"
