"""By how much two runs differ, quantity by quantity, each with a verdict; and since when."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from drivers.base.tolerances import Tolerance
from drivers.chain.chain import Array
from drivers.chain.trace import Trace, until
from postproc.read.observables import describe, observe, of_kind, without_unit
from postproc.read.signals import integral
from validation.accuracy.deviation import Deviation, deviation, first_beyond, shares_apart
from validation.accuracy.rounding import HORIZON
from validation.compare.departure import Departure, departure
from validation.compare.open_pair import Opened
from validation.compare.pair_keys import different_keys
from validation.compare.pair_tolerances import Allowed, allowed_between
from validation.compare.verdict import FAIL, Verdict, judged

LEVELS = (1e-9, 1e-6, 1e-3, 1e-2)  # of the largest force: rounding, its horizon, coarse steps, what experiments resolve


@dataclass(frozen=True)
class Pair:
    """Two runs and what became of comparing them.

    Attributes:
        keys: a line for each key of their scenes that differs.
        verdicts: by quantity; the second run is the one in question.
        until: why not all samples were judged; empty where they were.
        parted: by level, the first sample at which the forces differ by more.
        departures: of each run from the exact motion of its own scene.
        taken_for: what the second run looks like, taken for one of the first's scene.
    """

    first: Opened
    second: Opened
    keys: list[str]
    verdicts: list[Verdict]
    until: str
    parted: dict[float, Deviation | None]
    departures: tuple[Departure, Departure]
    taken_for: Departure

    @property
    def missed(self) -> bool:
        """Whether something differs by more than is allowed."""
        return any(verdict.verdict == FAIL for verdict in self.verdicts)


def compare_pair(one: Opened, other: Opened) -> Pair:
    """All that is known of two runs."""
    allowed, why_not_all = allowed_between(one, other), ""
    if allowed.samples < len(one.trace.time_s):
        end = one.trace.time_s[allowed.samples] * 1e6
        why_not_all = f"judged until {end:g} µs, where rounding alone passes {HORIZON:g}"
    # one case after the other, since what is expected of the last one is kept
    of_first, taken_for = (departure(one.case, each.engine, each.trace) for each in (one, other))
    first, second = (until(each.trace, allowed.samples) for each in (one, other))
    return Pair(
        first=one,
        second=other,
        keys=different_keys(one.run.record.scene, other.run.record.scene),
        verdicts=[*_verdicts(one, other, first, second, allowed)],
        until=why_not_all,
        parted={level: _parted(one.trace, other.trace, level) for level in LEVELS},
        departures=(of_first, departure(other.case, other.engine, other.trace)),
        taken_for=taken_for,
    )


def _verdicts(one: Opened, other: Opened, first: Trace, second: Trace, allowed: Allowed) -> Iterator[Verdict]:
    found = deviation(second, first)
    place = f"contact {found.contact} at {found.time_s * 1e6:g} µs"
    yield _verdict(one, other, "force", found.share, allowed.force, place)
    yield from _of_gauges(one, other, first, second, allowed)
    series = {
        "kinetic energy": (first.kinetic_energy_J, second.kinetic_energy_J, first.kinetic_energy_J),
        "total energy": (first.total_energy_J, second.total_energy_J, first.kinetic_energy_J),
        "momentum": (first.momentum_N_s, second.momentum_N_s, first.momentum_N_s),
    }
    if one.run.layout.wall and other.run.layout.wall:
        impulses = [integral(each.time_s, each.force_N[:, 0]) for each in (first, second)]
        series["wall impulse"] = (impulses[0], impulses[1], impulses[0])
    for quantity, (should, has, scale) in series.items():
        share, sample = _largest(has - should, scale)
        yield _verdict(one, other, quantity, share, allowed.balance, f"at {first.time_s[sample] * 1e6:g} µs")


def _largest(difference: Array, scale: Array) -> tuple[float, int]:
    """The largest difference over the largest value, and where; of nothing but zeros: over 1."""
    share = np.abs(difference) / (float(np.abs(scale).max()) or 1.0)
    sample = int(np.argmax(np.nan_to_num(share, nan=np.inf)))
    return float(share[sample]), sample


def _of_gauges(one: Opened, other: Opened, first: Trace, second: Trace, allowed: Allowed) -> Iterator[Verdict]:
    """Peaks and speeds that both runs have a gauge for."""
    should, has = observe(one.run.layout, first), observe(other.run.layout, second)
    limits = {"peak": allowed.peak, "later peak": allowed.peak, "speed": allowed.speed}
    for name in of_kind(should, *limits):
        observable = describe(name)
        if name not in has or (np.isnan(should[name]) and np.isnan(has[name])):
            continue
        values = f"{should[name]:.7g} against {has[name]:.7g} {observable.unit}"
        arrival_s = should[name.replace("_peak_N", "_arrival_s")] if observable.kind == "peak" else np.nan
        when = f" at {arrival_s * 1e6:.6g} µs" if np.isfinite(arrival_s) else ""
        error = abs(has[name] / should[name] - 1) if should[name] else abs(has[name])
        yield _verdict(one, other, without_unit(name), float(error), limits[observable.kind], f"{values}{when}")


def _verdict(one: Opened, other: Opened, quantity: str, value: float, limit: Tolerance, where: str) -> Verdict:
    engines = f"{other.engine} against {one.engine}"
    return judged(other.run.record.scene_name, engines, quantity, value, limit, where)


def _parted(first: Trace, second: Trace, level: float) -> Deviation | None:
    """The first sample at which forces differ by more than a level."""
    share = shares_apart(second.force_N, first.force_N)
    beyond = first_beyond(share, level)
    if beyond is None:
        return None
    sample, column = beyond
    return Deviation(float(share[sample, column]), float(first.time_s[sample]), column + 1)
