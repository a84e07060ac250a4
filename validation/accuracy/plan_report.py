"""Output of ``beads plan``: time step, stability, errors, cheapest engine, other accuracies, horizon."""

from collections.abc import Collection, Iterator, Mapping
from dataclasses import asdict
from math import inf
from pathlib import Path

from drivers.base import paths
from drivers.base.cache import cached
from drivers.base.errors import InputError
from drivers.base.terminal import text_table
from drivers.chain.case import Case
from drivers.chain.trace import FORCE, is_at_rest
from drivers.engines import TOTAL, VERLET, installed, load_engine
from drivers.limits import inability, refuse_depth, step_limit, until_words, why_unstable
from drivers.run.scheme import scheme_of
from postproc.read.measured import read_traces
from postproc.read.observables import of_kind
from postproc.read.sensors import gauges_of
from validation.accuracy.budget import AT_REST_NOTE
from validation.accuracy.costs import capable_engines, cost_on, fault
from validation.accuracy.motions import errors_of, motions_of, predicted_error
from validation.accuracy.plan import Chooser, planned_case, usual_steps

TENFOLD = 10.0
MAX_WORK = 5e7  # bodies times steps, for the rows of other accuracies
MAX_ERROR = 100.0  # larger errors are printed as "blows up"
LISTED = 5  # errors in a line
AS_GIVEN = ", as given in the scene"


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
    engines = [(name, load_engine(name).shear, asdict(cost_on(name))) for name in capable_engines(case, among)]
    there = [(name, fault(case, name)) for name in installed(name for name, *_ in engines)]
    scenes = [variant.scene.model_dump(mode="json") for variant in (case, case.full) if variant]
    report = _straight if case.chain.straight else _three_dimensional

    def computed() -> list[str]:
        refuse_depth(case)
        return [*report(case, among)]

    lines = cached(["plan", scenes, engines, there], computed)
    yield from (f"{case.scene.name}: {case.summary}", *lines)
    for trace in traces:
        yield f"measured   {paths.shown(trace.file)}: {len(trace.time_s)} readings of {', '.join(trace.reading)}"


def _straight(case: Case, among: Collection[str]) -> Iterator[str]:
    steps, plan = case.scene.steps_per_sample, case.plan
    asked = plan.asked if plan else {FORCE: 0.0}
    try:
        chooser = Chooser(case, {name: share / TENFOLD for name, share in asked.items()})
    except InputError as error:
        if plan:
            raise
        yield from (*_stability(case, TOTAL, AS_GIVEN), *_engines(case, among))
        yield f"predicted  not measured: {error.args[2].partition(';')[0]}"
        return
    errors = plan.predicted if plan else dict(chooser.errors_at(steps))
    scheme = scheme_of(case)
    others = [*_other_errors(case, chooser, asked if plan else errors, errors, among)]

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
        if case.full is not None and case.full.models(element.name) and not element.modelled:
            yield f"left out   {element.name}: {element.reason.partition(': ')[2]}"
    yield from _engines(case, among)
    yield from (
        "",
        "time steps, errors and run times at larger and smaller errors",
        *others,
        "",
        f"horizon    codes can be compared point by point{scheme.until_horizon or ' to the end'}",
    )


def _three_dimensional(case: Case, among: Collection[str]) -> Iterator[str]:
    """Report on a three-dimensional scene: errors by extrapolation."""
    law = load_engine(min(capable_engines(case, among), key=lambda name: name != VERLET, default=VERLET)).shear
    yield from _stability(case, law, AS_GIVEN)
    if why_unstable(case, law):
        return
    yield from _engines(case, among)
    for name in capable_engines(case, among):
        motions = motions_of(case, name)
        if motions.why_unknown:
            yield f"predicted  {motions.why_unknown}"
            return
        error, end_ms = predicted_error(case, name), 1e3 * case.sample_times_s[motions.scheme.samples - 1]
        order = f"order of convergence {motions.order:.2g}"
        yield f"predicted  relative error: force {error:.3g} on {name}; {order}; comparable until {end_ms:.4g} ms"


def _other_errors(
    case: Case, chooser: Chooser, asked: dict[str, float], errors: dict[str, float], among: Collection[str]
) -> Iterator[str]:
    """Table of time steps, errors and run times for ten times the error of this run, this run, and a tenth."""
    names, missed = capable_engines(case, among), []
    cells = [["", "time step", f"{'largest ' * (len(errors) > 1)}error of {', '.join(errors)}", *names]]
    needed = case.scene.steps * TENFOLD ** (1 if case.chain.damped else 0.5)  # by the scheme's order
    for label, factor in (("ten times the error of", TENFOLD), ("", 1.0), ("a tenth of the error of", 1 / TENFOLD)):
        chosen, found, why = case, errors, ""
        if factor < 1 and case.full is not None:
            why = "it may need the elements left out here: set run.accuracy and plan again"
        elif factor < 1 and needed * case.chain.bodies > MAX_WORK:
            why = f"it takes about {needed:.2g} steps, too many to try here"
        elif factor != 1:
            wanted = {name: min(factor * share, 0.99) for name, share in asked.items()}
            try:
                chosen, plan = chooser.choose(wanted, MAX_WORK)
                found = plan.predicted
            except InputError as refusal:
                why = str(refusal).partition("allowed: ")[2] or str(refusal)
        label = f"{label} this run".lstrip()
        if why:
            missed.append(f"{label}: not computed: {why}")
        else:
            worst = max(found.values())
            error = f"{worst:.1e}" if worst < MAX_ERROR else "blows up"
            seconds = [f"{cost_on(name).run_s(chosen):.2f} s" for name in names]
            cells.append([label, _us(chosen.scene.time_step_s), error, *seconds])
    yield from (*text_table(cells, right=range(1, len(cells[0]))), *missed)


def _engines(case: Case, among: Collection[str]) -> Iterator[str]:
    faults = {name: fault(case, name) for name in installed(capable_engines(case, among))}
    seconds = {name: cost_on(name).run_s(case) for name, why in faults.items() if not why}
    by_cost = ", ".join(f"{name} {seconds[name]:.2g} s" for name in sorted(seconds, key=seconds.__getitem__))
    yield f"engines    that model the scene, the cheapest first: {by_cost or 'none is left'}"
    yield from (f"           left out: {name}, since {why}" for name, why in faults.items() if why)


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
