"""Planning of a case: the largest time step that meets an accuracy, without elements of negligible effect; its report.

Velocity Verlet in this repository costs about a fiftieth of a code's run at the same step and has the same error to
ten digits, rounding of heights included, so predicted errors are measured ones. The exact motion is computed only as
exactly as needed.
"""

from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from dataclasses import asdict, replace
from math import ceil, inf, pi, sqrt
from pathlib import Path
from typing import Any, NoReturn

import numpy as np

from drivers.base import paths
from drivers.base.cache import cached
from drivers.base.errors import InputError
from drivers.base.terminal import counted, text_table
from drivers.chain.case import Case, StepPlan, build_case, choose_elements
from drivers.chain.chain import arrays_of, build_chain
from drivers.chain.schemes import exact_of
from drivers.chain.trace import FORCE, is_at_rest
from drivers.engines import VERLET, load_engine
from drivers.limits import EXACT_SHARE, inability, refuse_depth, resolved_trial, step_limit, until_words, why_unstable
from drivers.run.scheme import COMPARED, Scheme, scheme_of
from drivers.scene.model import Contact, Scene
from drivers.scene.read_scene import read_scene
from drivers.scene.rules import MAX_STEPS
from drivers.scene.settings import setting_texts
from postproc.read.measured import read_traces
from postproc.read.observables import of_kind, scale_of, without_unit
from postproc.read.signals import gauges_of
from validation.accuracy.budget import AT_REST_NOTE
from validation.accuracy.costs import Cost, ranking_of
from validation.accuracy.motions import ExactMotion, errors_of, exact_motion_of, motions_of, predicted_error
from validation.reference.adaptive import MIN_TOLERANCE, scales
from validation.reference.tube import TOTAL

ELEMENTS_SHARE = 0.5  # of the accuracy, for the effect of all elements left out; the rest is for the time step
MIN_ACCURACY = 10 * MIN_TOLERANCE
MAX_TOLERANCE = 1e-4  # of the exact motion
STEP_RATIO = 1.2  # the search ends when the steps accepted and refused are within this factor
COARSE_ERROR = 0.1  # larger errors are too large to extrapolate
PLATEAU = 0.9  # an error that a smaller step lowers by less is one of rounding
MAX_WORK = 4e9  # bodies times steps of one trial: some seconds
MAX_EXACT_WORK = 4e6  # bodies times duration divided by the time scale of a contact: some seconds for the exact motion
MARGIN = 1.25  # on the best accuracy named in errors
TENFOLD = 10.0
OTHERS_WORK = 5e7  # bodies times steps, for the rows of other accuracies
MAX_ERROR = 100.0  # larger errors are printed as "blows up"
LISTED = 5  # errors in a line
AS_GIVEN = ", as given in the scene"
CRITERIA = ("0.2 Rayleigh", "0.1 Hertz", "P-wave")


def _with(scene: Scene, **changes: object) -> Scene:
    """Scene with changes of its chain."""
    return scene.model_copy(update={"chain": scene.chain.model_copy(update=changes)})


# functions that remove an element of ``drivers.chain.case`` from a scene
REMOVALS: dict[str, Callable[[Scene], Scene]] = {
    "gravity": lambda scene: scene.model_copy(update={"gravity": 0.0}),
    "precompression": lambda scene: _with(scene, precompression=0.0),
    "sensor masses": lambda scene: _with(
        scene, sensors=tuple(sensor.model_copy(update={"mass": None}) for sensor in scene.chain.sensors)
    ),
    "mass scatter": lambda scene: _with(scene, mass_scatter=0.0),
    "damping": lambda scene: scene.model_copy(
        update={"contact": Contact(friction=scene.contact.friction, rotation=scene.contact.rotation)}
    ),
}


def simplify(case: Case, asked: dict[str, float]) -> Case:
    """Case without the elements whose effect is negligible for its accuracy, removed in order of increasing effect.

    Effects are measured on the exact motion, one by one and together. If they cannot be measured, the case is
    returned unchanged.

    Args:
        case: case of a straight chain.
        asked: accuracy by quantity; errors as in ``validation.accuracy.motions``.
    """
    candidates = [name for name in case.reasons if name in REMOVALS]
    if not candidates:
        return case
    try:
        truth = exact_motion_of(case)

        def effect(*names: str) -> dict[str, float]:
            changed = errors_of(case, exact_of(_without(case, names)), truth, asked)
            return {name: changed[name] / share for name, share in asked.items()}

        alone = {name: effect(name) for name in candidates}
    except (ArithmeticError, KeyError):  # ``Chooser`` reports an unknown quantity
        return case
    left: dict[str, str] = {}  # reasons by name
    for largest, name in sorted((max(shares.values()), name) for name, shares in alone.items()):
        if largest <= ELEMENTS_SHARE and max(effect(*left, name).values()) <= ELEMENTS_SHARE:
            worst = max(asked, key=alone[name].__getitem__)
            why = f"it changes the {worst} by {largest * asked[worst]:.1e}; the requested accuracy is {asked[worst]:g}"
            left[name] = f"left out ({case.reasons[name]}): {why}"
    simple = _without(case, left)
    elements = tuple(replace(each, reason=left.get(each.name, each.reason)) for each in simple.elements)
    return replace(simple, elements=elements, full=case) if left else case


def _without(case: Case, names: Iterable[str]) -> Case:
    scene = case.scene
    for name in names:
        scene = REMOVALS[name](scene)
    chain = build_chain(scene)
    return replace(case, scene=scene, chain=chain, elements=choose_elements(scene, chain))


class Chooser:
    """Chooses time steps of one case; exact motions and trial runs are cached."""

    def __init__(self, case: Case, strictest: dict[str, float]) -> None:
        """Compute the exact motion of the full case, for accuracies down to the strictest, by quantity.

        Raises:
            InputError: the case lacks a quantity, or its exact motion cannot be computed.
        """
        self.case = case
        self.names = tuple(strictest)
        self.gauges = [name for name in strictest if name not in COMPARED]
        self._errors: dict[int, dict[str, float]] = {}
        duration = float(case.sample_times_s[-1])
        overlap, speed = scales(arrays_of(case.chain), duration)
        if case.chain.bodies * duration * speed > MAX_EXACT_WORK * overlap:
            self._refuse("", "the run is too long for its exact motion; set run.time_step instead, or shorten the run")
        try:
            self.truth = self._follow(min(strictest.values()))
        except ArithmeticError as error:
            raise InputError(case.scene.file, "run.accuracy", f"{error}; set run.time_step instead") from error
        for name in self.gauges:
            if not self.truth.true.get(name):
                has = (quantity for quantity, value in self.truth.true.items() if value)
                self._refuse(name, f"unknown quantity; allowed: {', '.join([*COMPARED, *has])}")
            if self.truth.factor == 1:
                found = "too many samples times contacts to measure the sampling error"
                self._refuse(name, f"{found}; allowed: {', '.join(COMPARED)}")
        self.guess_s = resolved_trial(case).two_over_omega_s  # the order of magnitude of the largest stable step

    def _refuse(self, name: str, statement: str) -> NoReturn:
        raise InputError(self.case.scene.file, f"run.accuracy{name and f'.{name}'}", statement)

    def _follow(self, strictest: float) -> ExactMotion:
        """Exact motion; errors grow in a chaotic one, so the tolerance is tightened until the error is small."""
        tolerance = min(max(EXACT_SHARE * strictest, MIN_TOLERANCE), MAX_TOLERANCE)
        while True:
            truth = exact_motion_of(self.case.full or self.case, tolerance, finer=bool(self.gauges))
            if truth.error[-1] <= EXACT_SHARE * strictest or tolerance <= MIN_TOLERANCE:
                return truth
            tolerance = max(0.1 * tolerance * min(EXACT_SHARE * strictest / truth.error[-1], 1.0), MIN_TOLERANCE)

    def errors_at(self, steps_per_sample: int) -> dict[str, float]:
        """Errors of velocity Verlet in absolute heights, as the codes have them, at a number of steps per sample."""
        if steps_per_sample not in self._errors:
            scheme = Scheme(self.case.at(steps_per_sample), TOTAL)
            with np.errstate(over="ignore", invalid="ignore"):  # too large a step blows up
                self._errors[steps_per_sample] = errors_of(scheme.case, scheme.rounded, self.truth, self.names)
        return self._errors[steps_per_sample]

    def choose(self, wanted: dict[str, float], most_work: float = MAX_WORK) -> tuple[Case, StepPlan]:
        """Case at the fewest steps per sample that keep all errors below the wanted accuracies.

        Raises:
            InputError: no step does; the attainable accuracy is named.
        """
        self._check_attainable(wanted)
        scene, order = self.case.scene, 1 if self.case.chain.damped else 2
        work = self.case.chain.bodies * (scene.samples - 1)
        steps = max(1, ceil(min(scene.run.sample_interval / self.guess_s, 1e15)))
        refused, taken, before = 0, 0, inf
        while not taken or taken > max(refused + 1, STEP_RATIO * refused):
            if steps * work > most_work or steps * (scene.samples - 1) > MAX_STEPS:
                why = "within the steps that a plan may try; run.time_step takes any step"
                raise self._missed(refused, wanted, why)
            errors = self.errors_at(steps)
            excess = max((errors[name] + self.truth.error[-1]) / wanted[name] for name in wanted)
            if 1 < PLATEAU * before < excess and not taken:
                why = "limited by rounding of absolute heights; a chain.origin near 0 allows more"
                raise self._missed(steps, wanted, why)
            coarse = max(errors.values()) > COARSE_ERROR  # too large to extrapolate
            before = inf if coarse else excess
            if excess <= 1 and not why_unstable(self.case.at(steps)):  # after the gauges it may blow up
                taken = steps
            else:
                refused = max(refused, steps)
            steps = _next(refused, taken, 2 * steps if coarse else ceil(1.003 * steps * excess ** (1 / order)))
        return self.case.at(taken), StepPlan(wanted, self.errors_at(taken), refused)

    def _missed(self, steps: int, wanted: dict[str, float], why: str) -> InputError:
        """Error for an accuracy that the smallest step that was tried misses."""
        errors = self._errors.get(steps, {})
        worst = max(wanted, key=lambda name: errors.get(name, 0.0) / wanted[name])
        return unattainable(self.case, worst, wanted[worst], MARGIN * errors[worst] if errors else 1.0, why)

    def _check_attainable(self, wanted: dict[str, float]) -> None:
        for name, share in wanted.items():
            least = max(MIN_ACCURACY, 10 * self.truth.error[-1])
            if share < least:
                why = "limited by the error of the exact motion itself"
                raise unattainable(self.case, name, share, MARGIN * least if least > MIN_ACCURACY else least, why)
            if name in self.gauges:
                true = self.truth.true
                left = abs(self.truth.sampled.get(name, inf) - true[name]) / scale_of(name, true)
                if left >= share:
                    why = "limited by sampling at any time step; a smaller sample_interval allows more"
                    raise unattainable(self.case, name, share, MARGIN * left, why)


def unattainable(case: Case, name: str, asked: float, least: float, why: str) -> InputError:
    """Error for an unattainable accuracy; it names the best attainable one, rounded up to two digits, if below 1."""
    key, rounded_up = "run.accuracy" if name == FORCE else f"run.accuracy.{name}", f"{1.05 * least:.2g}"
    allowed = f"at least {rounded_up} here, {why}" if 0 < float(rounded_up) < 1 else f"none here, {why}"
    return InputError(case.scene.file, key, f"{asked:g}", allowed)


def _next(refused: int, taken: int, guess: int) -> int:
    """Next number of steps to try: the guess, or one whose refusal ends the search, between refused and taken."""
    if not taken:
        return max(refused + 1, guess)
    if guess >= taken:
        guess = min(taken - 1, ceil(taken / STEP_RATIO))
    if guess <= refused:
        return refused + max(1, round((taken - refused) / 2))
    return min(guess, taken - 1)


def plan(
    scene: str | Path, settings: Mapping[str, Any] | None = None, engine: str = VERLET
) -> tuple[Case, dict[str, float]]:
    """Plan a scene: choose the time step where the scene asks for an accuracy, and predict the errors.

    Args:
        scene: Name of a scene in ``inputs/scenes``, or path of a scene file.
        settings: Values that replace those of the scene file, by key: text with a unit (``"2 m/s"``) or a number in
            SI units; None removes the key.
        engine: Engine whose error is predicted for a scene with a time step of its own; all codes have the scheme of
            ``"verlet"``.

    Returns:
        case: The scene with its time step, for ``drivers.run_scene``.
        errors: Predicted error of each quantity that the scene asks for, or of ``force``: the largest difference from
            the exact motion over all contacts and times, relative to the largest change of force. Errors of other
            quantities are relative to their exact value (of a peak: to the peak above the static load).

    Raises:
        InputError: The scene or a setting is wrong, or no time step keeps the accuracy.

    Examples:
        >>> case, errors = plan("fig4", {"run.time_step": None, "run.accuracy": 1e-4})
        >>> case.scene.time_step_s, errors["force"] <= 1e-4
        (1.6666666666666668e-07, True)
    """
    case = planned_case(scene, *setting_texts(settings or {}))
    if case.plan is not None:
        return case, dict(case.plan.predicted)
    return case, {FORCE: predicted_error(case, engine)}


def planned_case(source: str | Path, *settings: str) -> Case:
    """Planned case of a scene with settings.

    Raises:
        InputError: the scene or its accuracy is wrong.
    """
    return plan_case(build_case(read_scene(source, settings)))


def plan_case(case: Case) -> Case:
    """Case at the largest time step that meets its accuracy, without elements of negligible effect.

    The step leaves room for rounding errors. A case without an accuracy is returned unchanged.

    Raises:
        InputError: no step meets the accuracy, or the scene lacks one of its quantities.
    """
    accuracy = case.scene.run.accuracy
    if accuracy is None:
        return case
    by_quantity = accuracy if isinstance(accuracy, dict) else {FORCE: accuracy}
    asked = {without_unit(name): share for name, share in by_quantity.items()}
    with counted(f"planning {case.scene.name}"):
        chosen, plan = Chooser(simplify(case, asked), asked).choose(asked)
    return replace(chosen, plan=plan)


def usual_steps(case: Case) -> dict[str, float]:
    """Time steps of the usual criteria, by their names in ``CRITERIA``, in s; inf where nothing limits.

    Fractions of the smallest Rayleigh time of a bead, ``pi R sqrt(rho / G) / (0.1631 nu + 0.8766)``; of the smallest
    duration of an isolated collision of two neighbours, ``2.87 (m*^2 / (R* E*^2 v))^(1/5)`` with the largest speed v at
    time 0, as in LIGGGHTS' ``check/timestep/gran``; and the smallest ``R sqrt(rho / E)``, as in YADE's
    ``PWaveTimeStep``.
    """
    chain, rayleigh_s, wave_s, hertz_s = case.chain, [], [], inf
    for name, radius, mass in {*zip(chain.materials, chain.radius_m, chain.mass_kg, strict=True)}:
        if np.isfinite(radius):
            density, material = float(mass / (4 / 3 * pi * radius**3)), case.scene.material(name)
            modulus, ratio = material.youngs_modulus, material.poisson_ratio
            shear = modulus / (2 * (1 + ratio))
            rayleigh_s.append(pi * float(radius) * sqrt(density / shear) / (0.1631 * ratio + 0.8766))
            wave_s.append(float(radius) * sqrt(density / modulus))
    speed = float(np.abs(chain.velocity_m_s).max())
    inverse = 1 / chain.mass_kg + np.append(0.0, 1 / chain.mass_kg[:-1])
    stiffest = chain.stiffness * inverse  # k = (4/3) E* sqrt(R*), so R* E*^2 = (3 k / 4)^2
    if speed and stiffest.any():
        worst = int(np.argmax(stiffest))
        hertz_s = float(2.87 * (1 / inverse[worst] ** 2 / ((0.75 * chain.stiffness[worst]) ** 2 * speed)) ** 0.2)
    return dict(zip(CRITERIA, (0.2 * min(rayleigh_s), 0.1 * hertz_s, min(wave_s)), strict=True))


def plan_report(source: str | Path, settings: tuple[str, ...] = (), among: Collection[str] = ()) -> Iterator[str]:
    """Lines of the report, for a scene with an accuracy or a time step, on all engines or those ``among``.

    Raises:
        InputError: the scene, its accuracy or a measured file is wrong, an overlap exceeds a radius, or an engine
            cannot model it.
    """
    case = planned_case(source, *settings)
    traces = read_traces(case.scene, gauges_of(case.layout))
    for error in (inability(case, name) for name in among):
        if error:
            raise error
    costs, faults = ranking_of(case, among)
    scenes = [variant.scene.model_dump(mode="json") for variant in (case, case.full) if variant]
    report = _straight if case.chain.straight else _three_dimensional

    def computed() -> list[str]:
        refuse_depth(case)
        return [*report(case, costs)]

    engines = [(name, load_engine(name).shear, asdict(cost)) for name, cost in costs.items()]
    lines = cached(["plan", scenes, engines], computed)
    yield from (f"{case.scene.name}: {case.summary}", *lines)
    yield from (f"left out   {name}: {why}" for name, why in faults.items())
    for trace in traces:
        yield f"measured   {paths.shown(trace.file)}: {len(trace.time_s)} readings of {', '.join(trace.reading)}"


def _straight(case: Case, costs: Mapping[str, Cost]) -> Iterator[str]:
    steps, plan = case.scene.steps_per_sample, case.plan
    asked = plan.asked if plan else {FORCE: 0.0}
    try:
        chooser = Chooser(case, {name: share / TENFOLD for name, share in asked.items()})
    except InputError as error:
        if plan:
            raise
        yield from (*_stability(case, TOTAL, AS_GIVEN), *_engines(case, costs))
        yield f"predicted  not measured: {error.args[2].partition(';')[0]}"
        return
    errors = plan.predicted if plan else dict(chooser.errors_at(steps))
    scheme = scheme_of(case)
    why = AS_GIVEN
    if plan:
        yield f"accuracy   {_listed(asked)} (requested)"
        why = "; one step per sample is enough, a larger sample_interval would allow a larger step"
        if plan.refused_steps:
            coarser = _us(case.scene.run.sample_interval / plan.refused_steps)
            why = f"; {coarser} would exceed the accuracy ({_listed(chooser.errors_at(plan.refused_steps))})"
    yield from _stability(case, TOTAL, why)
    if why_unstable(case):
        return
    if is_at_rest(chooser.truth.trace.force_N):
        yield f"           {AT_REST_NOTE}"
    yield f"predicted  relative error: {_listed(errors)}; of that rounding of heights {scheme.rounding[FORCE][-1]:.1e}"
    if names := [name for name in of_kind(chooser.truth.true, "peak", "speed") if chooser.truth.true[name]]:
        yield f"           at the gauges: {_listed(errors_of(case, scheme.plain, chooser.truth, names))}"
    if (known := chooser.truth.error[-1]) > min(errors.values(), default=1.0) / TENFOLD:
        yield f"           the exact motion is known to {known:.1e} only: the chain amplifies rounding"
    for element in case.elements:
        if case.full is not None and element.name in case.full.reasons and not element.modelled:
            yield f"left out   {element.name}: {element.reason.partition(': ')[2]}"
    yield from _engines(case, costs)
    yield from (
        "",
        "time steps, errors and run times at larger and smaller errors",
        *_other_errors(case, chooser, asked if plan else errors, errors, costs),
        "",
        f"horizon    codes can be compared point by point{scheme.until_horizon or ' to the end'}",
    )


def _three_dimensional(case: Case, costs: Mapping[str, Cost]) -> Iterator[str]:
    """Report on a three-dimensional scene: errors by extrapolation."""
    law = load_engine(min(costs, key=lambda name: name != VERLET, default=VERLET)).shear
    yield from _stability(case, law, AS_GIVEN)
    if why_unstable(case, law):
        return
    yield from _engines(case, costs)
    for name in costs:
        motions = motions_of(case, name)
        if motions.why_unknown:
            yield f"predicted  {motions.why_unknown}"
            return
        error, end_ms = predicted_error(case, name), 1e3 * case.sample_times_s[motions.scheme.samples - 1]
        order = f"order of convergence {motions.order:.2g}"
        yield f"predicted  relative error: force {error:.3g} on {name}; {order}; comparable until {end_ms:.4g} ms"


def _other_errors(
    case: Case, chooser: Chooser, asked: dict[str, float], errors: dict[str, float], costs: Mapping[str, Cost]
) -> Iterator[str]:
    """Table of time steps, errors and run times for ten times the error of this run, this run, and a tenth."""
    missed = []
    cells = [["", "time step", f"{'largest ' * (len(errors) > 1)}error of {', '.join(errors)}", *costs]]
    needed = case.scene.steps * TENFOLD ** (1 if case.chain.damped else 0.5)  # by the scheme's order
    for label, factor in (("ten times the error of", TENFOLD), ("", 1.0), ("a tenth of the error of", 1 / TENFOLD)):
        chosen, found, why = case, errors, ""
        if factor < 1 and case.full is not None:
            why = "it may need the elements left out here: set run.accuracy and plan again"
        elif factor < 1 and needed * case.chain.bodies > OTHERS_WORK:
            why = f"it takes about {needed:.2g} steps, too many to try here"
        elif factor != 1:
            wanted = {name: min(factor * share, 0.99) for name, share in asked.items()}
            try:
                chosen, plan = chooser.choose(wanted, OTHERS_WORK)
                found = plan.predicted
            except InputError as refusal:
                why = str(refusal).partition("allowed: ")[2] or str(refusal)
        label = f"{label} this run".lstrip()
        if why:
            missed.append(f"{label}: not computed: {why}")
        else:
            worst = max(found.values())
            error = f"{worst:.1e}" if worst < MAX_ERROR else "blows up"
            seconds = [f"{cost.run_s(chosen):.2g} s" for cost in costs.values()]
            cells.append([label, _us(chosen.scene.time_step_s), error, *seconds])
    yield from (*text_table(cells, right=range(1, len(cells[0]))), *missed)


def _engines(case: Case, costs: Mapping[str, Cost]) -> Iterator[str]:
    """Lines on the engines by cost."""
    by_cost = ", ".join(f"{name} {cost.run_s(case):.2g} s" for name, cost in costs.items())
    yield f"engines    that model the scene, the cheapest first: {by_cost or 'none is left'}"
    starts = [name for name, cost in costs.items() if cost.start_s > cost.loop_s(case)]
    if starts:
        yield f"           mostly the start of the program: {', '.join(starts)}"


def _stability(case: Case, law: str, why: str) -> Iterator[str]:
    """Lines on the time step, the limit found by trials, and the usual criteria, which ignore the motion."""
    step_s, steps = case.scene.time_step_s, case.scene.steps_per_sample
    yield f"time step  {_us(step_s)} ({steps} step{'s' if steps > 1 else ''} per sample){why}"
    stable_s, unstable_s, until_s = step_limit(case, law)
    if stable_s == inf:
        yield "stability  no limit: no contact closes"
        return
    used = f"this run uses {100 * step_s / stable_s:.3g} % of that"
    yield f"stability  stable up to {_us(stable_s)}, by trials{until_words(case, until_s)}; {used}"
    blown_up = f"the next one, at {_us(unstable_s)}, blows up" if unstable_s else "larger ones not tried"
    yield f"           {blown_up}"
    if problem := why_unstable(case, law):
        yield f"           a trial at this step {problem}: the run is refused"
    others = ", ".join(f"{label} {_us(step_s)}" for label, step_s in usual_steps(case).items() if step_s < inf)
    yield f"           usual criteria, which ignore the motion: {others}"


def _listed(errors: Mapping[str, float]) -> str:
    """Errors by quantity; of many the number and the largest."""
    many = len(errors) > LISTED
    names = sorted(errors, key=lambda name: -errors[name])[:LISTED] if many else errors
    listed = ", ".join(f"{name} {f'{errors[name]:.3g}' if errors[name] < MAX_ERROR else 'blows up'}" for name in names)
    return f"{len(errors)} quantities, the largest errors: {listed}" if many else listed


def _us(seconds: float) -> str:
    return f"{seconds * 1e6:.5g} µs"
