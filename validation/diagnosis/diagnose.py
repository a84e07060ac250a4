"""What a run that is off matches, in a sentence."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from drivers.base.tolerances import tolerance
from drivers.chain.case import Case
from drivers.chain.chain import Array, furthest_m
from drivers.chain.trace import Trace
from drivers.engines import EXACT, IN_HEIGHTS, IN_OVERLAPS
from drivers.run.guard import ROUNDINGS
from validation.accuracy.baseline import ROUNDING_MARGIN, baseline_of, comparable
from validation.compare.deviation import motion_scales
from validation.diagnosis.faults import faults
from validation.diagnosis.faulty_model import Model, Motion, model_of, moved
from validation.diagnosis.fit import Target, refined, start_values, worst
from validation.diagnosis.record_faults import moving, recorded, sums_of
from validation.diagnosis.scaled_variants import single_families, whole_families
from validation.diagnosis.variants import Family, Variant, conventions

BUDGET = 800_000_000  # bodies times steps of all variants together, some 3 s
LEAST_RUNS = 400  # of an early window, without which nothing is tried
SHORTEST_WINDOW = 1 / 40  # of a run: where not even that can be tried so often, nothing of it is integrated
FULL_RUNS = 150  # of all that is compared
ALIKE = 30.0  # times what the nearest family leaves in the early window
TELLING = 1e3  # times what rounding explains: such a deviation tells parameters
MOST_SCANNED = 3  # of them, for which all of a run is scanned where an early window has told nothing
MOST_EARLY = 12  # families that are followed from the first window to the second
EARLY = 1e-6  # precision of a fit in the early window
MOST_FULL = 5  # families that are followed to the end
NEAREST = 7  # beads and contacts that are tried one by one
LEAST_WINDOW = 20  # samples after the first that is off, without which nothing matches: a few match too much
EXPLAINED = 0.01  # of a deviation: what leaves more does not explain it
AT_ONCE = 1e-4  # likewise where rounding is large at once, as where damped bodies just touch: measured 2.3e-5
NEARBY = 0.5  # of a deviation: what leaves more comes nowhere near it
NEAR = 0.1  # of the largest force: what leaves more is not asked where rounding parts it
BEYOND = 100.0  # times the largest force of the scene: what follows is a blow-up
EXACT_COSTS = 8  # runs of fixed steps that one of the adaptive integrator costs


@dataclass(frozen=True)
class Diagnosis:
    """What a run matches.

    Attributes:
        kind: what is at fault, short; of the nearest variant where none matches, empty where none comes near or nothing
            was tried.
        sentence: what the run matches and how closely, or what comes nearest and what it leaves.
        matched: whether a variant explains it to rounding.
        left, deviation: of the largest force, with the variant and with the scene as it should be.
    """

    kind: str
    sentence: str
    matched: bool
    left: float = float("nan")
    deviation: float = float("nan")


@dataclass(frozen=True)
class Found:
    """A variant with what it leaves of the deviation, which is that of the samples that it is compared at."""

    kind: str
    words: str
    left: float
    allowed: float
    deviation: float

    @property
    def matches(self) -> bool:
        """Whether only rounding is left, and little of the deviation: where that is small, rounding is much of it."""
        return self.left <= min(self.allowed, EXPLAINED * self.deviation)

    @property
    def comes_near(self) -> bool:
        """Whether it is worth naming."""
        return self.left <= NEARBY * self.deviation


@dataclass(frozen=True)
class Task:
    """A deviation that is to be explained.

    Attributes:
        off: by how much the scene as it should be misses the run, of the largest force. Shape (samples,).
        allowed: what rounding explains of it.
        least: how many samples a match takes.
    """

    case: Case
    target: Target
    off: Array
    allowed: float
    least: int

    def found(self, kind: str, words: str, left: float) -> Found:
        """A variant that is compared at all samples."""
        return Found(kind, words, left, self.allowed, float(self.off.max()))


def diagnose(case: Case, engine: str, trace: Trace) -> Diagnosis | None:
    """What a run that is off matches; None where it is off by no more than rounding, which says nothing."""
    if case.chain.lateral is not None:
        return _untried("the variants are those of straight chains")
    model = model_of(case, engine)
    if model.bodies * case.scene.steps * SHORTEST_WINDOW * LEAST_RUNS > BUDGET:
        return _untried(f"{model.bodies} bodies over {case.scene.steps} steps are too much to try variants of")
    own = moved(model, case.scene.samples)
    own_largest = float(np.abs(own.force_N).max())
    allowed, comparable_samples = _allowed(case, model, own_largest)
    usable = _usable(trace, own_largest)
    samples = min(comparable_samples, usable)
    largest = max(own_largest, float(np.abs(trace.force_N[:samples]).max(initial=0.0)))
    if not samples or not largest:
        return _untried("there are no forces to compare")
    target = Target(trace.force_N[:samples], largest)
    off = np.abs(own.force_N[:samples] - target.force_N) / largest
    if off.max() > allowed:
        return _of_forces(case, model, target, off, allowed, usable)
    if samples < comparable_samples:
        return _untried(f"it is its scene until {case.sample_times_s[samples] * 1e6:g} us, where it ends or blows up")
    return _of_motion(case, model, own, trace, samples, max(allowed, tolerance("model", "motion").limit))


def _untried(why: str, deviation: float = float("nan")) -> Diagnosis:
    return Diagnosis("", f"no diagnosis: {why}", matched=False, deviation=deviation)


def _usable(trace: Trace, largest_N: float) -> int:
    """How many samples are finite and no blow-up."""
    with np.errstate(invalid="ignore"):
        good = (np.abs(trace.force_N) <= BEYOND * (largest_N or np.inf)).all(axis=1)
    return int(np.argmin(np.append(good, False)))


def _allowed(case: Case, model: Model, largest_N: float) -> tuple[float, int]:
    """What rounding explains, of the largest force, and for how many samples it is small."""
    stated = tolerance("model", "force").limit
    if model.scheme == EXACT:
        return stated, case.scene.samples
    allowed, samples = comparable(baseline_of(case).rounding_N / (largest_N or 1.0))
    return max(stated, allowed), samples


def _of_motion(case: Case, model: Model, own: Motion, trace: Trace, samples: int, allowed: float) -> Diagnosis | None:
    """What recorded velocities match, where the forces are right."""
    scales = motion_scales(case.chain, trace)[:, None]
    seen = np.array([trace.kinetic_energy_J, trace.momentum_N_s])[:, :samples]

    def left(sums: tuple[Array, Array]) -> float:
        return float((np.abs(np.array(sums)[:, :samples] - seen) / scales).max())

    deviation = left(sums_of(model, own.velocity_m_s))
    if deviation <= allowed:
        return _of_heights(case, model, own, trace, samples)
    found = [
        Found("velocities recorded", words, left((kinetic, momentum)), allowed, deviation)
        for words, kinetic, momentum in moving(model, own)
    ]
    return _said(found, deviation, "of the energy and the momentum; the forces are right")


def _of_heights(case: Case, model: Model, own: Motion, trace: Trace, samples: int) -> Diagnosis | None:
    """What recorded heights match, where they are known and all else is right."""
    if trace.height_m is None:
        return None
    seen, dt = (trace.height_m - case.chain.height_m)[:samples], case.scene.time_step_s
    allowed = ROUNDINGS * float(np.spacing(furthest_m(case.chain))) * np.sqrt(case.scene.steps + 1)

    def left(rise: Array) -> float:
        return float(np.abs(rise[:samples] - seen).max())

    deviation = left(own.rise_m)
    if deviation > allowed and model.scheme != EXACT:  # a chaotic chain multiplies what steps gather
        heights = [np.asarray(each.height_m) for each in (baseline_of(case).rounded, baseline_of(case).plain)]
        allowed = max(allowed, ROUNDING_MARGIN * float(np.abs(heights[0] - heights[1])[:samples].max()))
    if deviation <= allowed:
        return None
    size = f"({dt * 1e6:g} us)"
    before = own.rise_m - dt * (2 * own.velocity_m_s - own.later_m_s)
    found = [
        Found("heights recorded", words, left(rise), allowed, deviation)
        for words, rise in (
            (f"heights one time step {size} early", own.rise_m + dt * own.later_m_s),
            (f"heights one time step {size} late", before),
            ("heights that do not change", np.zeros_like(own.rise_m)),
        )
    ]
    return _said(found, deviation, "m; forces and velocities are right")


def _of_forces(case: Case, model: Model, target: Target, off: Array, allowed: float, usable: int) -> Diagnosis:
    """What forces match; off of shape (samples, bodies), until rounding parts the scene from itself or the run ends."""
    deviation, samples = float(off.max()), len(off)
    first = int(np.argmax(off.max(axis=1) > allowed))
    least = min(first + 1 + LEAST_WINDOW, usable)
    if samples < least:
        when, until = (f"{case.sample_times_s[sample] * 1e6:g} us" for sample in (first, samples))
        why = f"it leaves its scene at {when}, and from {until} on rounding alone may do that"
        return _untried(why, deviation)
    cost = model.bodies * model.steps_per_sample * (EXACT_COSTS if model.scheme == EXACT else 1)
    samples = max(min(samples, BUDGET // (cost * FULL_RUNS)), 2)
    part = f" in the first {samples} samples" if samples < len(off) else ""
    windows = [min(samples, first + 1 + more) for more in (LEAST_WINDOW, max(LEAST_WINDOW, samples // 8))]
    if off[: windows[0]].max() < TELLING * allowed:
        windows = windows[1:]
    if first >= samples or cost * windows[-1] * LEAST_RUNS > BUDGET:
        when = f"{case.sample_times_s[first] * 1e6:g} us"
        return _untried(
            f"it leaves its scene at {when}, until when {model.bodies} bodies are too much to try", deviation
        )
    task = Task(case, target.until(samples), off[:samples].max(axis=1), allowed, min(least, samples))
    found = [_plain(task, variant) for variant in faults(case, model)]
    found += [_recorded(task, each) for each in recorded(model, task.target.force_N)]
    if not any(each.matches for each in found):
        found += _fitted(task, list(whole_families(case, model)), windows)
    if not any(each.matches for each in found):
        near = _near(off[first], model.bodies)
        found += _fitted(task, list(single_families(case, model, near)), windows)
    return _said(found, float(task.off.max()), f"of the largest force{part}")


def _near(off: Array, bodies: int) -> list[int]:
    """Places to look at, the nearest to where a run parts from its scene first."""
    place = int(np.argmax(off > 0.5 * off.max()))
    return sorted(range(bodies), key=lambda j: abs(j - place))[:NEAREST]


def _said(found: list[Found], deviation: float, of_what: str) -> Diagnosis:
    """The first that matches, else the nearest, if any comes near."""
    best = next((each for each in found if each.matches), None)
    if best is not None:
        sentence = f"matches {best.words} {_to(best.left)} {of_what}"
        return Diagnosis(best.kind, sentence, True, best.left, deviation)
    best = min(found, key=lambda each: each.left / each.deviation)
    sentence = f"no variant explains it: it is off by {deviation:.1e} {of_what}, "
    if not best.comes_near:
        return Diagnosis("", f"{sentence}and none comes near", False, best.left, deviation)
    return Diagnosis(
        best.kind,
        f"{sentence}nearest is {best.words.rstrip(',')}, which leaves {best.left:.1e}",
        False,
        best.left,
        deviation,
    )


def _to(left: float) -> str:
    return f"to {left:.0e}" if left else "to the last bit"


def _recorded(task: Task, each: tuple[str, str, Array, slice]) -> Found:
    kind, words, forces, samples = each
    left = worst((forces[samples] - task.target.force_N[samples]) / task.target.largest_N)
    return Found(kind, words, left, task.allowed, float(task.off[samples].max()))


def _plain(task: Task, variant: Variant) -> Found:
    """The best of what conventions make of a variant."""
    models = conventions(variant.model)
    left = [worst(task.target.off(model)) for model in models]
    best = int(np.argmin(left))
    whole = task.found(variant.kind, variant.words, left[best])
    if not task.allowed < left[best] < NEAR:
        return whole
    apart, samples = _horizon(models[best], task.target, task.allowed)
    if samples < task.least:
        return _parted_at_once(whole)
    left_until = worst(task.target.until(samples).off(models[best]))
    return _cut(task, variant.kind, variant.words, left_until, apart, samples)


def _parted_at_once(whole: Found) -> Found:
    """A variant that rounding parts from itself at once: for want of samples before that all are compared, closely."""
    words = f"{whole.words}, which rounding parts from itself at once,"
    return replace(whole, words=words, allowed=max(whole.allowed, AT_ONCE * whole.deviation))


def _cut(task: Task, kind: str, words: str, left: float, apart: float, samples: int) -> Found:
    """A variant that is compared until rounding parts it from itself."""
    if samples < len(task.target.force_N):
        words += f" until {task.case.sample_times_s[samples] * 1e6:g} us, where rounding parts them,"
    return Found(kind, words, left, apart, float(task.off[:samples].max()))


def _horizon(model: Model, target: Target, allowed: float) -> tuple[float, int]:
    """What rounding does to a variant, of the largest force, and for how many samples that is small."""
    if model.scheme == EXACT:
        return allowed, len(target.force_N)
    other = replace(model, scheme=IN_OVERLAPS if model.scheme == IN_HEIGHTS else IN_HEIGHTS)
    forces = [moved(each, len(target.force_N)).force_N for each in (model, other)]
    apart, samples = comparable(np.abs(forces[0] - forces[1]).max(axis=1) / target.largest_N)
    return max(allowed, apart), samples


def _fitted(task: Task, families: list[Family], windows: list[int]) -> list[Found]:
    """The families that come nearest in an early window, followed to the end until one matches.

    Of those that come about as near the plainest is followed first.
    """
    target, deviation = task.target, float(task.off.max())
    candidates = []
    for place, family in enumerate(families):
        for start in start_values(family, target.until(windows[0]), deviation):
            value, left = refined(family, target.until(windows[0]), start, EARLY)
            candidates.append((left, place, value))
    for window in windows[1:]:
        nearest = sorted(candidates)[:MOST_EARLY]
        again = [(place, *refined(families[place], target.until(window), value, EARLY)) for _, place, value in nearest]
        candidates = [(left, place, value) for place, value, left in again]
    alike = ALIKE * max(min(candidates)[0], task.allowed / 10)
    plainest_first = sorted((each for each in candidates if each[0] <= alike), key=lambda each: each[1])
    candidates = plainest_first + sorted((each for each in candidates if each[0] > alike), key=lambda each: each[0])
    found: list[Found] = []
    for rank, (_, place, value) in enumerate(candidates[:MOST_FULL]):
        found.append(_followed(task, families[place], value, again=rank < MOST_SCANNED))
        if found[-1].matches:
            break
    return found


def _followed(task: Task, family: Family, value: float, *, again: bool) -> Found:
    """A family fitted to all of a run, in the convention that comes nearest.

    An early window may not have told the value: a wall that is too low is felt later. Then all of the run is scanned
    ``again``.
    """
    found = _from(task, family, value)
    if found.matches or not again:
        return found
    starts = start_values(family, task.target, found.left)
    return min([found, *(_from(task, family, start) for start in starts)], key=lambda each: each.left / each.deviation)


def _from(task: Task, family: Family, value: float) -> Found:
    members = _conventional(family)
    values = [refined(replace(family, at=at), task.target, value)[0] for at in members]
    models = [at(t) for at, t in zip(members, values, strict=True)]
    left = [worst(task.target.off(model)) for model in models]
    best = int(np.argmin(left))
    whole = task.found(family.kind, family.words(values[best]), left[best])
    if not task.allowed < left[best] < NEAR:
        return whole
    apart, samples = _horizon(models[best], task.target, task.allowed)
    if samples < task.least:
        return _parted_at_once(whole)
    short, at = task.target.until(samples), members[best]
    t, _ = refined(replace(family, at=at), short, values[best])
    return _cut(task, family.kind, family.words(t), worst(short.off(at(t))), apart, samples)


def _conventional(family: Family) -> list[Callable[[float], Model]]:
    """The family in each convention."""

    def in_convention(place: int) -> Callable[[float], Model]:
        return lambda t: conventions(family.at(t))[place]

    return [in_convention(place) for place in range(len(conventions(family.at(family.neutral))))]
