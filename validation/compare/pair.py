"""By how much two runs differ, quantity by quantity, each with a verdict; and since when."""

from collections.abc import Iterator
from dataclasses import dataclass
from math import isclose

import numpy as np

from drivers.base.tolerances import Tolerance, tolerance
from drivers.chain.chain import Array
from drivers.chain.trace import until
from drivers.engines import EXACT, load_engine
from postproc.read.observables import describe, observe, of_kind, without_unit
from postproc.read.signals import integral
from validation.accuracy.baseline import HORIZON, baseline_of, model_quantity, shipped_name
from validation.compare.departure import Departure, departure
from validation.compare.deviation import Deviation, deviation, first_deviation
from validation.compare.open_pair import PairedRun
from validation.compare.verdict import FAIL, Verdict, judged

KINDS = ("peak", "later peak", "speed")  # of observables that are judged
LEVELS = (1e-9, 1e-6, 1e-3, 1e-2)  # of the largest force: rounding, its horizon, coarse steps, what experiments resolve


@dataclass(frozen=True)
class Pair:
    """Two runs and what became of comparing them.

    Attributes:
        verdicts: by quantity; the second run is the one in question.
        until: why not all samples were judged; empty where they were.
        parted: by level, the first sample at which the forces differ by more.
        departures: of each run from the exact motion of its own scene.
        taken_for: what the second run looks like, taken for one of the first's scene.
    """

    first: PairedRun
    second: PairedRun
    verdicts: list[Verdict]
    until: str
    parted: dict[float, Deviation | None]
    departures: tuple[Departure, Departure]
    taken_for: Departure

    @property
    def missed(self) -> bool:
        """Whether something differs by more than is allowed."""
        return any(verdict.verdict == FAIL for verdict in self.verdicts)


def compare_pair(one: PairedRun, other: PairedRun) -> Pair:
    """All that is known of two runs."""
    (limits, samples), why_not_all = allowed_between(one, other), ""
    if samples < len(one.trace.time_s):
        why_not_all = f"judged until {one.trace.time_s[samples] * 1e6:g} µs, where rounding alone passes {HORIZON:g}"
    # one case after the other, since what is expected of the last one is kept
    of_first, taken_for = (departure(one.case, each.engine, each.trace) for each in (one, other))
    return Pair(
        first=one,
        second=other,
        verdicts=[*_verdicts(one, other, limits, samples)],
        until=why_not_all,
        parted={level: first_deviation(other.trace, one.trace, level) for level in LEVELS},
        departures=(of_first, departure(other.case, other.engine, other.trace)),
        taken_for=taken_for,
    )


def allowed_between(one: PairedRun, other: PairedRun) -> tuple[dict[str, Tolerance], int]:
    """Tolerances of two runs by kind of quantity, and how many samples can be compared until rounding parts them.

    Runs of the same scheme at the same step differ by rounding alone, in friction by their laws; others by what their
    time steps, or the lack of one, do.
    """
    same_step = isclose(one.run.record.time_step_s, other.run.record.time_step_s, rel_tol=1e-12)
    exact = [load_engine(each.engine).scheme == EXACT for each in (one, other)]
    if all(exact) or (not any(exact) and same_step):
        force, samples = _by_rounding(one, other)
        of_gauges = {}
    else:
        names = {shipped_name(each.case) for each in (one, other)}
        name = names.pop() if len(names) == 1 else None
        force, samples = tolerance("truncation", "force", name), len(one.trace.time_s)
        of_gauges = {quantity: tolerance("truncation", quantity, name) for quantity in ("peak", "speed")}
    factor = tolerance("between", "others")
    others = Tolerance(factor.limit * force.limit, f"{factor.limit:g} times the force's: {factor.reason}")
    limits = {"force": force, "peak": others, "speed": others, "others": others} | of_gauges
    return limits | {"later peak": limits["peak"]}, samples


def _by_rounding(one: PairedRun, other: PairedRun) -> tuple[Tolerance, int]:
    """Of runs of one scheme at one step, and for how many samples they can be compared."""
    everything = len(one.trace.time_s)
    laws = {load_engine(each.engine).shear for each in (one, other)}
    if len(laws) > 1 and one.case.chain.lateral is not None and one.case.chain.slips:
        return tolerance("model", "sides"), everything
    baselines = [baseline_of(one.case)]
    if one.case.scene != other.case.scene:
        baselines.append(baseline_of(other.case))
    if any(each.unknown for each in baselines):
        return tolerance("model", model_quantity(one.case)), everything
    widest = max((each.allowed for each in baselines), key=lambda each: each.limit)
    return widest, min(each.samples for each in baselines)


def _verdicts(one: PairedRun, other: PairedRun, limits: dict[str, Tolerance], samples: int) -> Iterator[Verdict]:
    first, second = (until(each.trace, samples) for each in (one, other))

    def verdict(quantity: str, value: float, limit: Tolerance, where: str) -> Verdict:
        engines = f"{other.engine} against {one.engine}"
        return judged(other.run.record.scene_name, engines, quantity, value, limit, where)

    found = deviation(second, first)
    yield verdict("force", found.share, limits["force"], found.place)

    should, has = observe(one.run.layout, first), observe(other.run.layout, second)
    for name in of_kind(should, *KINDS):  # that both runs have a gauge for
        if name not in has or (np.isnan(should[name]) and np.isnan(has[name])):
            continue
        observable = describe(name)
        arrival_s = should[name.replace("_peak_N", "_arrival_s")] if observable.kind == "peak" else np.nan
        when = f" at {arrival_s * 1e6:.6g} µs" if np.isfinite(arrival_s) else ""
        error = abs(has[name] / should[name] - 1) if should[name] else abs(has[name])
        values = f"{should[name]:.7g} against {has[name]:.7g} {observable.unit}"
        yield verdict(without_unit(name), float(error), limits[observable.kind], f"{values}{when}")

    series = {
        "kinetic energy": (first.kinetic_energy_J, second.kinetic_energy_J, first.kinetic_energy_J),
        "total energy": (first.total_energy_J, second.total_energy_J, first.kinetic_energy_J),
        "momentum": (first.momentum_N_s, second.momentum_N_s, first.momentum_N_s),
    }
    if one.run.layout.wall and other.run.layout.wall:
        impulses = [integral(each.time_s, each.force_N[:, 0]) for each in (first, second)]
        series["wall impulse"] = (impulses[0], impulses[1], impulses[0])
    for quantity, (expected, measured, scale) in series.items():
        share, sample = _largest(measured - expected, scale)
        yield verdict(quantity, share, limits["others"], f"at {first.time_s[sample] * 1e6:g} µs")


def _largest(difference: Array, scale: Array) -> tuple[float, int]:
    """The largest difference over the largest value, and where; of nothing but zeros: over 1."""
    share = np.abs(difference) / (float(np.abs(scale).max()) or 1.0)
    sample = int(np.argmax(np.nan_to_num(share, nan=np.inf)))
    return float(share[sample]), sample
