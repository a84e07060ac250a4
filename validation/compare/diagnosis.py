"""What runs that are off match, in a sentence."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import least_squares

from drivers.base.tolerances import tolerance
from drivers.chain.case import Case
from drivers.chain.chain import Array, furthest_m
from drivers.chain.trace import Trace
from drivers.engines import EXACT, load_engine
from postproc.read.residual import largest_change_N
from validation.accuracy.baseline import ROUNDING_MARGIN, baseline_of, comparable
from validation.compare import variants
from validation.compare.departure import motion_scales
from validation.compare.verdict import FAIL, Verdict
from validation.reference.hertz_chain import Motion

BUDGET = 2_000_000_000  # bodies times steps of all variants together, some 10 s
RUNS = 400  # of all that is compared, within that budget
WINDOW = 20  # samples after the first that is off, without which nothing matches: a few match too much
KEPT = (12, 5)  # variants with a parameter that are followed from a window to the next
NEAREST = 7  # beads and contacts that are tried one by one
EXPLAINED = 0.01  # of a deviation: what leaves more does not explain it
NAMED = 0.5  # of a deviation: what leaves more is not worth naming
AT_ONCE = 1e-4  # of a deviation: what rounding may leave where it is large at once, as where damped bodies just touch
BLOW_UP = 100.0  # times the largest force of the scene
NO_NUMBER = 1e3  # what a motion that is no number counts, of the largest change
ITS_OWN = (
    "its forces are those of its scene at its time step, but for rounding: what it misses is the time step's, that of "
    "velocities or heights as recorded, or of what it is measured against"
)


@dataclass(frozen=True)
class Diagnosis:
    """What a run matches.

    Attributes:
        kind: what is at fault, short; of the nearest variant where none matches, empty where none comes near or nothing
            was tried.
        sentence: what the run matches and how closely, or what comes nearest and what it leaves.
        matched: whether a variant explains it to rounding.
        left, deviation: of the largest change, with the variant and with the scene as it should be.
    """

    kind: str
    sentence: str
    matched: bool = False
    left: float = float("nan")
    deviation: float = float("nan")


@dataclass(frozen=True)
class Found:
    """A variant with what it leaves of a deviation, over the samples that it is compared at, and what it may leave."""

    kind: str
    words: str
    left: float
    allowed: float
    deviation: float

    @property
    def matches(self) -> bool:
        """Whether only rounding is left, and little of the deviation: where that is small, rounding is much of it."""
        return self.left <= min(self.allowed, EXPLAINED * self.deviation)


@dataclass(frozen=True)
class Target:
    """Forces that are to be explained.

    Attributes:
        force_N: of the run. Shape (samples, bodies).
        scale_N: what deviations are counted by.
        off: deviation of the case as it should be from the run. Shape (samples, bodies).
        allowed: what rounding explains of it.
    """

    case: Case
    force_N: Array
    scale_N: float
    off: Array
    allowed: float

    @property
    def first(self) -> int:
        """The first sample that is off."""
        return int(np.argmax(self.off.max(axis=1) > self.allowed))

    @property
    def least(self) -> int:
        """How many samples a match takes, where there are as many."""
        return min(self.first + 1 + WINDOW, len(self.off))

    def missed(self, model: variants.Model, samples: int | None = None) -> Array:
        """Deviation of a model from the first samples, read as it comes nearer. Shape (samples, bodies)."""
        force = self.force_N[:samples]
        with np.errstate(all="ignore"):
            try:
                readings = list(model.readings(model.motion(len(force)).force_N))
            except (ArithmeticError, ValueError):
                return np.full(force.shape, NO_NUMBER)
            shares = [np.nan_to_num((reading - force) / self.scale_N, nan=NO_NUMBER) for reading in readings]
        return min((np.clip(share, -NO_NUMBER, NO_NUMBER) for share in shares), key=_root_mean_square)


def diagnoses_of(case: Case, verdicts: Iterable[Verdict], traces: Mapping[str, Trace]) -> dict[str, str]:
    """What each engine with a failed verdict matches, in a sentence.

    An engine without a trace gets no diagnosis; one whose run a guard failed does.
    """
    red = dict.fromkeys(verdict.engine for verdict in verdicts if verdict.verdict == FAIL)
    found = {engine: diagnose(case, engine, traces[engine]) for engine in red if engine in traces}
    return {engine: diagnosis.sentence if diagnosis else ITS_OWN for engine, diagnosis in found.items()}


def diagnose(case: Case, engine: str, trace: Trace) -> Diagnosis | None:
    """What a run that is off matches; None where it is off by no more than rounding, which says nothing."""
    if case.chain.lateral is not None:
        return _untried("the variants are those of straight chains")
    if load_engine(engine).scheme == EXACT:
        return _untried("the variants are followed by time steps")
    cost = case.chain.bodies * case.scene.steps_per_sample
    affordable = min(BUDGET // (cost * RUNS), case.scene.samples)
    if affordable < min(WINDOW, case.scene.samples):
        return _untried(f"{case.chain.bodies} bodies over {case.scene.steps} steps are too much to try variants of")
    part = f" in the first {affordable} samples" if affordable < case.scene.samples else ""
    model = variants.model_of(case)
    own = model.motion(affordable)
    own_N = own.force_N
    scale = largest_change_N(own_N)
    rounding, comparable_samples = comparable(baseline_of(case).rounding_N[:affordable] / scale)
    allowed = max(tolerance("model", "force").limit, rounding)
    with np.errstate(invalid="ignore"):
        usable = (np.abs(trace.force_N) <= BLOW_UP * (np.abs(own_N).max() or np.inf)).all(axis=1)
    samples = min(comparable_samples, int(np.argmin(np.append(usable, False))))
    force = trace.force_N[:samples]
    if not samples or not (own_N.any() or force.any()):
        return _untried("there are no forces to compare")
    scale = max(scale, largest_change_N(force))
    target = Target(case, force, scale, np.abs(own_N[:samples] - force) / scale, allowed)
    when_us = case.sample_times_s * 1e6
    if target.off.max() <= allowed:
        if samples == comparable_samples:
            return _of_velocities(model, own, trace, samples, max(allowed, tolerance("model", "motion").limit))
        return _untried(
            f"it is its scene until {when_us[min(samples, len(when_us) - 1)]:g} us, where it ends or blows up"
        )
    if samples == comparable_samples < min(target.first + 1 + WINDOW, int(usable.sum())):
        why = f"it leaves its scene at {when_us[target.first]:g} us, and from {when_us[samples]:g} us on rounding alone"
        return _untried(f"{why} may do that", float(target.off.max()))
    return _said(_tried(target, model, engine), float(target.off.max()), f"of the largest change{part}")


def _of_velocities(model: variants.Model, own: Motion, trace: Trace, samples: int, allowed: float) -> Diagnosis | None:
    """Misreading that recorded velocities match by kinetic energy and momentum, where the forces are right."""
    mass, scales = model.chain.mass_kg, motion_scales(model.chain, trace)
    found = np.column_stack([trace.kinetic_energy_J, trace.momentum_N_s])[:samples] / scales
    misses = []
    for words, velocity in (("", own.velocity_m_s), *variants.misread_velocities(model, own)):
        sums = np.column_stack([0.5 * (velocity**2 @ mass), velocity @ mass])[:samples] / scales
        misses.append((words, float(np.abs(sums - found).max())))
    (_, off), *rest = misses
    read = (Found("velocities", words, left, allowed, off) for words, left in rest)
    return _said(read, off, "of the energy and the momentum; the forces are right") if off > allowed else None


def _untried(why: str, deviation: float = float("nan")) -> Diagnosis:
    return Diagnosis("", f"no diagnosis: {why}", deviation=deviation)


def _said(found: Iterable[Found], deviation: float, what: str) -> Diagnosis:
    """The first that matches, else the nearest, if any comes near."""
    tried = []
    for each in found:
        if each.matches:
            closely = f"to {each.left:.0e}" if each.left else "to the last bit"
            return Diagnosis(each.kind, f"matches {each.words} {closely} {what}", True, each.left, deviation)
        tried.append(each)
    best = min(tried, key=lambda each: each.left / each.deviation)
    sentence = f"no variant explains it: it is off by {deviation:.1e} {what}, "
    if best.left > NAMED * best.deviation:
        return Diagnosis("", f"{sentence}and none comes near", False, best.left, deviation)
    nearest = f"nearest is {best.words}, which leaves {best.left:.1e}"
    return Diagnosis(best.kind, sentence + nearest, False, best.left, deviation)


def _tried(target: Target, model: variants.Model, engine: str) -> Iterator[Found]:
    """All that forces may match, the plainest first."""
    for variant in variants.plain_variants(model, engine):
        yield from _followed(target, variant, 0.0)
    scale, right = target.scale_N, model.motion(len(target.off)).force_N
    for kind, words, values, chosen in variants.misread_forces(model, target.force_N):
        left, deviation = (float(np.abs(N - target.force_N)[chosen].max()) / scale for N in (values, right))
        yield Found(kind, words, left, target.allowed, deviation)
    place = int(np.argmax(target.off[target.first] > 0.5 * target.off[target.first].max()))
    near = sorted(range(model.chain.bodies), key=lambda j: abs(j - place))[:NEAREST]
    for some in (variants.families(model, engine), variants.single_families(model, near)):
        for variant, value in _nearest(target, list(some)):
            yield from _followed(target, variant, value)


def _nearest(target: Target, tried: Sequence[variants.Variant]) -> list[tuple[variants.Variant, float]]:
    """Variants with a parameter that come nearest in early windows, with the value at which they do.

    Each starts from the two lowest minima among its first values, and from the middle one.
    """
    windows = target.least, max(target.least, len(target.off) // 8)
    candidates = []
    for variant in tried:
        misses = np.array([_root_mean_square(target.missed(variant.at(t), target.least)) for t in variant.values])
        padded = np.pad(misses, 1, constant_values=np.inf)
        minima = np.flatnonzero((misses <= padded[:-2]) & (misses <= padded[2:]))
        places = [*minima[np.argsort(misses[minima])][:2].tolist(), len(misses) // 2]  # of factors the middle one is 1
        candidates += [(variant, float(variant.values[i])) for i in dict.fromkeys(places)]
    for window, kept in zip(windows, KEPT, strict=True):
        fits = [(variant, *_refined(target, variant, value, window, 1e-6)) for variant, value in candidates]
        fits.sort(key=lambda fit: max(fit[2], target.allowed))  # of those as near the plainest first
        candidates = [(variant, value) for variant, value, _ in fits[:kept]]
    return candidates


def _refined(
    target: Target, variant: variants.Variant, value: float, samples: int, precision: float = 1e-15
) -> tuple[float, float]:
    """The value next to another at which a variant comes nearest, and the root mean square that it leaves."""

    def missed(log: Array) -> Array:  # 1 and not 0 at the start, by which steps for slopes are counted
        return target.missed(variant.at(value * float(np.exp(log[0] - 1))), samples).ravel()

    if not variant.values.size:
        return value, float("nan")
    fit = least_squares(
        missed, [1.0], method="lm", diff_step=[1e-4], max_nfev=40, xtol=precision, ftol=precision, gtol=precision
    )
    return value * float(np.exp(fit.x[0] - 1)), _root_mean_square(np.asarray(fit.fun))


def _followed(target: Target, variant: variants.Variant, value: float) -> Iterator[Found]:
    """A variant fitted to the whole run, in each convention of start velocities in which it is another.

    Where rounding parts it from itself, it is compared until then.
    """
    starts = replace(variant, at=lambda t: replace(variant.at(t), staggered=True))
    same = np.array_equal(variant.at(value).start_velocity_m_s, starts.at(value).start_velocity_m_s)
    for each in (variant,) if same else (variant, starts):
        samples, allowed, until = len(target.off), target.allowed, ""
        fitted, _ = _refined(target, each, value, samples)
        left = float(np.abs(target.missed(each.at(fitted))).max())
        if allowed < left < 0.1:
            apart, samples = _horizon(target, each.at(fitted))
            allowed, (fitted, _) = max(allowed, apart), _refined(target, each, fitted, samples)
            left = float(np.abs(target.missed(each.at(fitted), samples)).max())
            if samples < len(target.off):
                until = f" until {target.case.sample_times_s[samples] * 1e6:g} us, where rounding parts them,"
        if each is starts and each.at(fitted).time_step_s != target.case.scene.time_step_s:
            until = f", with velocities that are set back by half the scene's step{until}"
        yield Found(variant.kind, variant.words(fitted) + until, left, allowed, float(target.off[:samples].max()))


def _horizon(target: Target, model: variants.Model) -> tuple[float, int]:
    """What rounding does to a variant, of the largest change, and for how many samples that is small."""
    samples = len(target.off)
    forces = [model.motion(samples, lift).force_N for lift in (0.0, furthest_m(model.chain) / 3)]
    share = np.abs(forces[0] - forces[1]).max(axis=1) / target.scale_N
    apart, small = comparable(share)
    if small >= target.least:
        return apart, small
    at_once = ROUNDING_MARGIN * float(share[: target.least].max())
    return min(at_once, AT_ONCE * float(target.off[: target.least].max())), target.least


def _root_mean_square(off: Array) -> float:
    return float(np.sqrt(np.mean(off**2)))
