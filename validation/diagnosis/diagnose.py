"""What a run that is off matches, in a sentence."""

from dataclasses import dataclass, replace

import numpy as np

from drivers.case import Case
from drivers.chain import Array
from drivers.engines import EXACT
from drivers.tolerances import tolerance
from drivers.trace import Trace
from validation.diagnosis.faults import faults
from validation.diagnosis.fit import Target, refined, start_values, worst
from validation.diagnosis.model import Model, Motion, model_of, moved
from validation.diagnosis.records import moving, recorded, sums_of
from validation.diagnosis.scaled import single_families, whole_families
from validation.diagnosis.variants import Family, Variant, conventions
from validation.motion import motion_scales
from validation.rounding import HORIZON, ROUNDING_MARGIN, comparable, rounding_error

BUDGET = 800_000_000  # bodies times steps of all variants together, some 3 s
LEAST_RUNS = 400  # of an early window, without which nothing is tried
FULL_RUNS = 150  # of all that is compared
ALIKE = 30.0  # times what the nearest family leaves in the early window
TELLING = 1e3  # times what rounding explains: such a deviation tells parameters
MOST_EARLY = 12  # families that are followed from the first window to the second
EARLY = 1e-6  # precision of a fit in the early window
MOST_FULL = 5  # families that are followed to the end
NEAREST = 7  # beads and contacts that are tried one by one
LEAST_WINDOW = 20  # samples after the first that is off
BEYOND = 100.0  # times the largest force of the scene: what follows is a blow-up
EXACT_COSTS = 8  # runs of fixed steps that one of the adaptive integrator costs


@dataclass(frozen=True)
class Diagnosis:
    """What a run matches.

    Attributes:
        kind: what is at fault, short; of the nearest variant where none matches, empty where nothing was tried.
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
    """A variant with what it leaves of the deviation."""

    kind: str
    words: str
    left: float
    allowed: float

    @property
    def matches(self) -> bool:
        """Whether only rounding is left."""
        return self.left <= self.allowed


def diagnose(case: Case, engine: str, trace: Trace) -> Diagnosis | None:
    """What a run that is off matches; None where it is off by no more than rounding, which says nothing."""
    if case.chain.lateral is not None:
        return Diagnosis("", "no diagnosis: the variants are those of straight chains", matched=False)
    model = model_of(case, engine)
    if model.bodies * case.scene.steps * LEAST_RUNS / 40 > BUDGET:
        words = f"no diagnosis: {model.bodies} bodies over {case.scene.steps} steps are too much to try variants of"
        return Diagnosis("", words, matched=False)
    own = moved(model, case.scene.samples)
    allowed, comparable_samples = _allowed(case, model)
    samples = min(comparable_samples, _usable(trace, float(np.abs(own.force_N).max())))
    largest = max(float(np.abs(own.force_N).max()), float(np.abs(trace.force_N[:samples]).max()))
    if not samples or not largest:
        return Diagnosis("", "no diagnosis: there are no forces to compare", matched=False)
    target = Target(trace.force_N[:samples], largest)
    off = np.abs(own.force_N[:samples] - target.force_N) / largest
    if off.max() <= allowed:
        return _of_motion(case, model, own, trace, samples, max(allowed, tolerance("model", "motion").limit))
    return _of_forces(case, model, target, off, allowed)


def _usable(trace: Trace, largest_N: float) -> int:
    """How many samples are finite and no blow-up."""
    with np.errstate(invalid="ignore"):
        good = (np.abs(trace.force_N) <= BEYOND * (largest_N or np.inf)).all(axis=1)
    return int(np.argmin(good)) if not good.all() else len(good)


def _allowed(case: Case, model: Model) -> tuple[float, int]:
    """What rounding explains, of the largest force, and for how many samples it is small."""
    stated = tolerance("model", "force").limit
    if model.scheme == EXACT:
        return stated, case.scene.samples
    forces = moved(model, case.scene.samples).force_N
    allowed, samples = comparable(rounding_error(case) / (float(np.abs(forces).max()) or 1.0))
    return max(stated, allowed), samples


def _of_motion(
    case: Case, model: Model, own: Motion, trace: Trace, samples: int, allowed: float
) -> Diagnosis | None:
    """What recorded velocities match, where the forces are right."""
    scales = motion_scales(case.chain, trace)[:, None]
    seen = np.array([trace.kinetic_energy_J, trace.momentum_N_s])[:, :samples]

    def left(sums: tuple[Array, Array]) -> float:
        return float((np.abs(np.array(sums)[:, :samples] - seen) / scales).max())

    deviation = left(sums_of(model, own.velocity_m_s))
    if deviation <= allowed:
        return None
    found = [Found("velocities recorded", words, left(sums), allowed) for words, *sums in moving(model, own)]
    return _said(found, deviation, "of the energy and the momentum; the forces are right")


def _of_forces(case: Case, model: Model, target: Target, off: Array, allowed: float) -> Diagnosis:
    deviation, samples = float(off.max()), len(off)
    first = int(np.argmax(off.max(axis=1) > allowed))
    cost = model.bodies * model.steps_per_sample * (EXACT_COSTS if model.scheme == EXACT else 1)
    samples = max(min(samples, BUDGET // (cost * FULL_RUNS)), 2)
    windows = [min(samples, first + 1 + more) for more in (LEAST_WINDOW, max(LEAST_WINDOW, samples // 8))]
    if off[: windows[0]].max() < TELLING * allowed:
        windows = windows[1:]
    if first >= samples or cost * windows[-1] * LEAST_RUNS > BUDGET:
        words = f"no diagnosis: it parts at {first} samples of {model.bodies} bodies, too much to try variants of"
        return Diagnosis("", words, matched=False, deviation=deviation)
    target = target.until(samples)
    found = [_recorded(each, target, allowed) for each in recorded(model, target.force_N)]
    found += [_plain(variant, target, allowed) for variant in faults(case, model)]
    if not any(each.matches for each in found):
        found += _fitted(list(whole_families(case, model)), target, windows, deviation, allowed)
    if not any(each.matches for each in found):
        near = _near(off[first], model.bodies)
        found += _fitted(list(single_families(case, model, near)), target, windows, deviation, allowed)
    return _said(found, deviation, "of the largest force")


def _near(off: Array, bodies: int) -> list[int]:
    """Places to look at, the nearest to where a run parts from its scene first."""
    place = int(np.argmax(off > 0.5 * off.max()))
    return sorted(range(bodies), key=lambda j: abs(j - place))[:NEAREST]


def _said(found: list[Found], deviation: float, of_what: str) -> Diagnosis:
    """The first that matches, else the nearest."""
    best = next((each for each in found if each.matches), None)
    if best is not None:
        sentence = f"matches {best.words} {_to(best.left)} {of_what}"
        return Diagnosis(best.kind, sentence, True, best.left, deviation)
    best = min(found, key=lambda each: each.left)
    sentence = (
        f"no variant explains it: it is off by {deviation:.1e} {of_what}, "
        f"nearest is {best.words}, which leaves {best.left:.1e}"
    )
    return Diagnosis(best.kind, sentence, False, best.left, deviation)


def _to(left: float) -> str:
    return f"to {left:.0e}" if left else "to the last bit"


def _recorded(each: tuple[str, str, Array, slice], target: Target, allowed: float) -> Found:
    kind, words, forces, samples = each
    left = worst((forces[samples] - target.force_N[samples]) / target.largest_N)
    return Found(kind, words, left, allowed)


def _plain(variant: Variant, target: Target, allowed: float) -> Found:
    """The best of what conventions make of a variant."""
    models = conventions(variant.model)
    left = [worst(target.off(model)) for model in models]
    best = int(np.argmin(left))
    return _judged(variant.kind, variant.words, models[best], left[best], target, allowed)


def _judged(kind: str, words: str, model: Model, left: float, target: Target, allowed: float) -> Found:
    """With what rounding does to the variant, where that is what is left."""
    if allowed < left < HORIZON * ROUNDING_MARGIN and model.scheme != EXACT:
        other = replace(model, scheme="in overlaps" if model.scheme != "in overlaps" else model.scheme)
        forces = [moved(each, len(target.force_N)).force_N for each in (model, other)]
        apart = ROUNDING_MARGIN * float(np.abs(forces[0] - forces[1]).max()) / target.largest_N
        allowed = max(allowed, apart)
    return Found(kind, words, left, allowed)


def _fitted(
    families: list[Family], target: Target, windows: list[int], deviation: float, allowed: float
) -> list[Found]:
    """The families that come nearest in an early window, followed to the end until one matches.

    Of those that come about as near the plainest is followed first.
    """
    candidates = []
    for place, family in enumerate(families):
        for start in start_values(family, target.until(windows[0]), deviation):
            value, left = refined(family, target.until(windows[0]), start, EARLY)
            candidates.append((left, place, value))
    for window in windows[1:]:
        nearest = sorted(candidates)[:MOST_EARLY]
        again = [(place, *refined(families[place], target.until(window), value, EARLY)) for _, place, value in nearest]
        candidates = [(left, place, value) for place, value, left in again]
    least = max(min(candidates)[0], allowed / 10)
    candidates.sort(key=lambda each: (each[0] > ALIKE * least, each[1] if each[0] <= ALIKE * least else each[0]))
    found: list[Found] = []
    for _, place, value in candidates[:MOST_FULL]:
        found.append(_followed(families[place], value, target, allowed))
        if found[-1].matches:
            break
    return found


def _followed(family: Family, value: float, target: Target, allowed: float) -> Found:
    """A family fitted to all of a run, in the convention that comes nearest."""
    best: tuple[float, float, Model] | None = None
    count = len(conventions(family.at(value)))
    for place in range(count):

        def at(t: float, place: int = place) -> Model:
            return conventions(family.at(t))[place]

        t, _ = refined(replace(family, at=at), target, value)
        model = at(t)
        left = worst(target.off(model))
        if best is None or left < best[0]:
            best = left, t, model
    assert best is not None
    left, t, model = best
    return _judged(family.kind, family.words(t), model, left, target, allowed)
