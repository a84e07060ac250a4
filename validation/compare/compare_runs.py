"""``python -m validation compare RUN RUN``."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

from drivers.base import paths
from drivers.base.files import sha256_of
from drivers.batch.study import unit_of
from drivers.chain.trace import FORCES
from validation.accuracy.budget import PARTS, for_terminal
from validation.compare.pair import Pair, PairedRun, compare_pair, open_pair

DERIVED = ("units", "name", "steps_per_sample", "samples")  # no keys of a scene file
FREE_TEXT = ("source",)


def compare_runs(first: Path, second: Path) -> int:
    """Prints how two runs differ; 1 if by more than is allowed.

    Raises:
        InputError: they cannot be compared.
    """
    pair = compare_pair(*open_pair(first, second))
    both = (("first", pair.first), ("second", pair.second))
    keys = [f"differs {line}" for line in different_keys(*(each.run.record.scene for _, each in both))]
    keys = keys or ["the scenes are the same"]
    parts = (*_runs(*both), "", *keys, "", *_table(pair), "", *_times(pair), *_budgets(*both), *_warnings(*both))
    print(*parts, sep="\n")
    print(f"\nFAIL: {', '.join(pair.missed)}" if pair.missed else "\npass")
    return 1 if pair.missed else 0


def _runs(*both: tuple[str, PairedRun]) -> Iterator[str]:
    """What the runs are."""
    for name, each in both:
        record = each.run.record
        step = f"time step {record.time_step_s:g} s, {record.steps} steps, {len(each.run.trace.time_s)} samples"
        commit = f"commit {record.commit[:10]}{' and changes' if record.dirty else ''}"
        yield f"{name:<7} {paths.shown(each.run.folder)}"
        yield f"        {record.scene_name} on {record.engine} ({record.engine_version}), {step}, {commit}"
    compared = both[0][1]
    samples, interval = len(compared.trace.time_s), compared.case.scene.run.sample_interval
    if any(len(each.run.trace.time_s) != samples for _, each in both):
        yield f"        compared at the {samples} sample times that both have, {interval:g} s apart"


def _table(pair: Pair) -> Iterator[str]:
    """The verdicts, and why so much is allowed, each reason once."""
    yield f"{'quantity':<24} {'difference':>10} {'allowed':>9}  verdict"
    for each in pair.verdicts:
        yield f"{each.quantity:<24} {each.value:10.2e} {each.limit:9.2e}  {each.verdict}: {each.where}"
    if pair.until:
        yield pair.until
    yield ""
    used: dict[tuple[float, str], list[str]] = {}
    for each in pair.verdicts:
        used.setdefault((each.limit, each.reason), []).append(each.quantity)
    for (limit, reason), quantities in used.items():
        names = quantities if len(quantities) < 4 else [quantities[0], "...", quantities[-1]]
        yield f"allowed {limit:.2g} ({', '.join(names)}): {reason}"


def _times(pair: Pair) -> Iterator[str]:
    """When the runs part, when each leaves the exact motion of its own scene, and what a miss looks like."""
    for level, found in pair.parted.items():
        place = f"at {found.time_s * 1e6:.6g} µs in {found.quantity}" if found else "never"
        yield f"parted by {level:g} of the largest force {place}"
    for name, first in zip(("first", "second"), pair.departures, strict=True):
        for each in (first, *first.later):
            yield f"{name:<7} {each.words}"
    if pair.missed and pair.taken_for.words != pair.departures[1].words:
        yield f"second, taken for a run of the first's scene: {pair.taken_for.words}"


def _budgets(*both: tuple[str, PairedRun]) -> Iterator[str]:
    """The parts of each run's errors, as signed shares; they add up to the whole."""
    budgets = {name: dict(for_terminal(each.run.record.error_budget or ())) for name, each in both}
    quantities = dict.fromkeys(quantity for budget in budgets.values() for quantity in budget)
    if quantities:
        yield f"\n{'error budget':<24} {'':<7} " + " ".join(f"{part:>10}" for part in PARTS)
    for quantity in quantities:
        for name, budget in budgets.items():
            if quantity in budget:
                yield f"{quantity:<24} {name:<7} {budget[quantity]}"
    for name, each in both:
        if each.run.record.error_note:
            yield f"{name:<7} {each.run.record.error_note}"


def _warnings(*both: tuple[str, PairedRun]) -> Iterator[str]:
    for name, each in both:
        for warning in each.run.record.warnings or ():
            yield f"{name:<7} warning: {warning}"
        if sha256_of(each.run.folder / FORCES) != each.run.record.forces_sha256:
            yield f"{name:<7} warning: its forces are not those that its record was written for"


def different_keys(one: dict[str, Any], other: dict[str, Any]) -> list[str]:
    """A line for each key that differs, such as ``run.time_step: 1e-07 s against 1e-06 s``.

    Args:
        one: the scene of a run record, in SI units.
        other: another.
    """
    return [f"{path}: {_shown(path, a)} against {_shown(path, b)}" for path, a, b in _different(one, other, "")]


def _different(one: Any, other: Any, path: str) -> Iterator[tuple[str, Any, Any]]:
    """Paths with both values; of what one of both lacks as a whole: one line."""
    if isinstance(one, dict) and isinstance(other, dict):
        for key in dict.fromkeys([*one, *other]):
            if key not in (FREE_TEXT if path else DERIVED):
                yield from _different(one.get(key), other.get(key), f"{path}.{key}" if path else key)
    elif isinstance(one, list) and isinstance(other, list) and len(one) == len(other):
        for place, values in enumerate(zip(one, other, strict=True)):
            yield from _different(*values, f"{path}.{place}")
    elif one != other:
        yield path, one, other


def _shown(path: str, value: Any) -> str:
    if value is None or value == []:
        return "none"
    if isinstance(value, dict):
        return ", ".join(
            f"{key} {_shown(f'{path}.{key}', each)}" for key, each in value.items() if key not in FREE_TEXT
        )
    if isinstance(value, list):
        return "; ".join(_shown(f"{path}.{place}", each) for place, each in enumerate(value))
    return f"{value!r} {unit_of(path)}".strip() if isinstance(value, float) else str(value)
