"""Diagnosis of faulty runs: the variant of the case that a run matches, in a sentence."""

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

MAX_WORK = 2_000_000_000  # bodies times steps of all variants together, some 10 s
VARIANT_RUNS = 400  # runs of variants within MAX_WORK
WINDOW = 20  # samples after the first deviation that a match needs: many variants match a few samples
CANDIDATES = (12, 5)  # variants with a parameter that pass each window
PLACES = 7  # beads and contacts tried one by one
MAX_RESIDUAL = 0.01  # of a deviation, for a variant that explains it
MAX_RESIDUAL_NAMED = 0.5  # of a deviation, for a variant named as the closest
MAX_ROUNDING = 1e-4  # of a deviation: rounding allowed if large from the start, as for damped bodies just touching
BLOW_UP = 100.0  # times the largest force of the scene
NAN_SHARE = 1e3  # deviation that replaces NaN, over the largest change
FORCES_MATCH = (
    "the forces match the scene at this time step to rounding; the failed check is due to the error of the time step, "
    "to recorded velocities or heights, or to the run that it is compared with"
)


@dataclass(frozen=True)
class Diagnosis:
    """Result of a diagnosis.

    Attributes:
        kind: kind of the matching or closest variant; empty if none is close or none was tried.
        sentence: sentence on the matching or closest variant and the deviation that it leaves.
        matched: True if a variant explains the deviation to rounding.
        left: deviation from the variant over the largest change.
        deviation: deviation from the correct scene over the largest change.
    """

    kind: str
    sentence: str
    matched: bool = False
    left: float = float("nan")
    deviation: float = float("nan")


@dataclass(frozen=True)
class Found:
    """A variant fitted to a run.

    Attributes:
        left: deviation from the variant over the largest change.
        allowed: bound on rounding over the largest change.
        deviation: deviation from the correct scene over the largest change, at the same samples.
    """

    kind: str
    words: str
    left: float
    allowed: float
    deviation: float

    @property
    def matches(self) -> bool:
        """True if the variant leaves only rounding, and a small part of the deviation."""
        return self.left <= min(self.allowed, MAX_RESIDUAL * self.deviation)


@dataclass(frozen=True)
class Target:
    """Forces to be explained.

    Attributes:
        force_N: forces of the run. Shape (samples, bodies).
        scale_N: scale of deviations.
        off: deviation of the run from the correct case over the scale. Shape (samples, bodies).
        allowed: bound on rounding over the scale.
    """

    case: Case
    force_N: Array
    scale_N: float
    off: Array
    allowed: float

    @property
    def first(self) -> int:
        """First sample with a deviation beyond rounding."""
        return int(np.argmax(self.off.max(axis=1) > self.allowed))

    @property
    def least(self) -> int:
        """Number of samples that a match needs."""
        return min(self.first + 1 + WINDOW, len(self.off))

    def missed(self, model: variants.Model, samples: int | None = None) -> Array:
        """Deviation of a model from the first samples, in the reading that fits best. Shape (samples, bodies)."""
        force = self.force_N[:samples]
        with np.errstate(all="ignore"):
            try:
                readings = list(model.readings(model.motion(len(force)).force_N))
            except (ArithmeticError, ValueError):
                return np.full(force.shape, NAN_SHARE)
            shares = [np.nan_to_num((reading - force) / self.scale_N, nan=NAN_SHARE) for reading in readings]
        return min((np.clip(share, -NAN_SHARE, NAN_SHARE) for share in shares), key=_root_mean_square)


def diagnoses_of(case: Case, verdicts: Iterable[Verdict], traces: Mapping[str, Trace]) -> dict[str, str]:
    """Sentence on the variant that a run with a failed verdict matches, by engine.

    Engines without a trace have no diagnosis; runs that a guard failed have one.
    """
    red = dict.fromkeys(verdict.engine for verdict in verdicts if verdict.verdict == FAIL)
    found = {engine: diagnose(case, engine, traces[engine]) for engine in red if engine in traces}
    return {engine: diagnosis.sentence if diagnosis else FORCES_MATCH for engine, diagnosis in found.items()}


def diagnose(case: Case, engine: str, trace: Trace) -> Diagnosis | None:
    """Diagnose a faulty run; None if it deviates from its scene by rounding only."""
    if case.chain.lateral is not None:
        return _untried("only straight chains have variants")
    if load_engine(engine).scheme == EXACT:
        return _untried("the engine has no time step, the variants have one")
    cost = case.chain.bodies * case.scene.steps_per_sample
    affordable = min(MAX_WORK // (cost * VARIANT_RUNS), case.scene.samples)
    if affordable < min(WINDOW, case.scene.samples):
        return _untried(f"{case.chain.bodies} bodies over {case.scene.steps} steps take too long for variants")
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
            f"the run matches its scene until {when_us[min(samples, len(when_us) - 1)]:g} µs, then ends or blows up"
        )
    if samples == comparable_samples < min(target.first + 1 + WINDOW, int(usable.sum())):
        why = f"the run deviates from its scene at {when_us[target.first]:g} µs, too close to the horizon"
        return _untried(f"{why} at {when_us[samples]:g} µs", float(target.off.max()))
    return _concluded(_fitted_variants(target, model, engine), float(target.off.max()), f"of the largest change{part}")


def _of_velocities(model: variants.Model, own: Motion, trace: Trace, samples: int, allowed: float) -> Diagnosis | None:
    """Diagnose recorded velocities by kinetic energy and momentum, if the forces are correct."""
    mass, scales = model.chain.mass_kg, motion_scales(model.chain, trace)
    found = np.column_stack([trace.kinetic_energy_J, trace.momentum_N_s])[:samples] / scales
    misses = []
    for words, velocity in (("", own.velocity_m_s), *variants.misread_velocities(model, own)):
        sums = np.column_stack([0.5 * (velocity**2 @ mass), velocity @ mass])[:samples] / scales
        misses.append((words, float(np.abs(sums - found).max())))
    (_, off), *rest = misses
    read = (Found("velocities", words, left, allowed, off) for words, left in rest)
    return _concluded(read, off, "of the energy and the momentum; the forces are correct") if off > allowed else None


def _untried(why: str, deviation: float = float("nan")) -> Diagnosis:
    return Diagnosis("", f"no diagnosis: {why}", deviation=deviation)


def _concluded(found: Iterable[Found], deviation: float, what: str) -> Diagnosis:
    """Diagnosis with the first matching variant, else the closest one."""
    tried = []
    for each in found:
        if each.matches:
            closely = f"to {each.left:.0e} {what}" if each.left else "bit for bit"
            return Diagnosis(each.kind, f"matches {each.words} {closely}", True, each.left, deviation)
        tried.append(each)
    best = min(tried, key=lambda each: each.left / each.deviation)
    sentence = f"no variant explains the deviation of {deviation:.1e} {what}"
    if best.left > MAX_RESIDUAL_NAMED * best.deviation:
        return Diagnosis("", f"{sentence}; none is close", False, best.left, deviation)
    closest = f"; the closest, {best.words}, leaves {best.left:.1e}"
    return Diagnosis(best.kind, sentence + closest, False, best.left, deviation)


def _fitted_variants(target: Target, model: variants.Model, engine: str) -> Iterator[Found]:
    """All variants and misreadings of the forces, fitted, the simplest first."""
    for variant in variants.plain_variants(model, engine):
        yield from _fitted_to_run(target, variant, 0.0)
    scale, right = target.scale_N, model.motion(len(target.off)).force_N
    for kind, words, values, chosen in variants.misread_forces(model, target.force_N):
        left, deviation = (float(np.abs(N - target.force_N)[chosen].max()) / scale for N in (values, right))
        yield Found(kind, words, left, target.allowed, deviation)
    place = int(np.argmax(target.off[target.first] > 0.5 * target.off[target.first].max()))
    near = sorted(range(model.chain.bodies), key=lambda j: abs(j - place))[:PLACES]
    for some in (variants.families(model, engine), variants.single_families(model, near)):
        for variant, value in _best_fits(target, list(some)):
            yield from _fitted_to_run(target, variant, value)


def _best_fits(target: Target, tried: Sequence[variants.Variant]) -> list[tuple[variants.Variant, float]]:
    """Variants with a parameter that fit best in early windows, with the fitted values.

    Each fit starts from the two lowest minima of the initial values, and from the middle value.
    """
    windows = target.least, max(target.least, len(target.off) // 8)
    candidates = []
    for variant in tried:
        misses = np.array([_root_mean_square(target.missed(variant.at(t), target.least)) for t in variant.values])
        padded = np.pad(misses, 1, constant_values=np.inf)
        minima = np.flatnonzero((misses <= padded[:-2]) & (misses <= padded[2:]))
        places = [*minima[np.argsort(misses[minima])][:2].tolist(), len(misses) // 2]  # of factors the middle one is 1
        candidates += [(variant, float(variant.values[i])) for i in dict.fromkeys(places)]
    for window, kept in zip(windows, CANDIDATES, strict=True):
        fits = [(variant, *_refined(target, variant, value, window, 1e-6)) for variant, value in candidates]
        fits.sort(key=lambda fit: max(fit[2], target.allowed))  # stable: equal fits keep the simplest first
        candidates = [(variant, value) for variant, value, _ in fits[:kept]]
    return candidates


def _refined(
    target: Target, variant: variants.Variant, value: float, samples: int, precision: float = 1e-15
) -> tuple[float, float]:
    """Fitted value of a variant's parameter, starting from a value, and the root mean square deviation left."""

    def missed(log: Array) -> Array:  # starts at 1, not 0: least_squares takes relative steps
        return target.missed(variant.at(value * float(np.exp(log[0] - 1))), samples).ravel()

    if not variant.values.size:
        return value, float("nan")
    fit = least_squares(
        missed, [1.0], method="lm", diff_step=[1e-4], max_nfev=40, xtol=precision, ftol=precision, gtol=precision
    )
    return value * float(np.exp(fit.x[0] - 1)), _root_mean_square(np.asarray(fit.fun))


def _fitted_to_run(target: Target, variant: variants.Variant, value: float) -> Iterator[Found]:
    """Fit a variant to the whole run, in both conventions of start velocities if they differ.

    The comparison ends where rounding alone changes the variant.
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
                until = f" until {target.case.sample_times_s[samples] * 1e6:g} µs, the horizon,"
        if each is starts and each.at(fitted).time_step_s != target.case.scene.time_step_s:
            until = f", with velocities set back by half the scene's step{until}"
        yield Found(variant.kind, variant.words(fitted) + until, left, allowed, float(target.off[:samples].max()))


def _horizon(target: Target, model: variants.Model) -> tuple[float, int]:
    """Effect of rounding on a variant over the largest change, and the number of samples until the horizon."""
    samples = len(target.off)
    forces = [model.motion(samples, lift).force_N for lift in (0.0, furthest_m(model.chain) / 3)]
    share = np.abs(forces[0] - forces[1]).max(axis=1) / target.scale_N
    apart, small = comparable(share)
    if small >= target.least:
        return apart, small
    early = ROUNDING_MARGIN * float(share[: target.least].max())  # chaotic from the start: a tighter threshold
    return min(early, MAX_ROUNDING * float(target.off[: target.least].max())), target.least


def _root_mean_square(off: Array) -> float:
    return float(np.sqrt(np.mean(off**2)))
