"""What ``python -m drivers plan`` says of a scene: the choice with its reasons, other accuracies, the horizon."""

import time
from collections.abc import Iterator
from dataclasses import asdict
from pathlib import Path

import numpy as np

from drivers.base.errors import InputError
from drivers.base.kept import kept
from drivers.chain.case import Case
from drivers.chain.chain import Array
from drivers.engines import installed, load_engine
from drivers.limits.criteria import CRITERIA
from drivers.limits.refusal import FORCE
from drivers.limits.stable_step import predicted_limit
from drivers.limits.trial import failure, first_failure_s
from postproc.read.residual import still
from validation.accuracy.baseline import HORIZON, ROUNDING_MARGIN, baseline_of
from validation.accuracy.budget import NOTHING_MOVES, predicted_error
from validation.accuracy.costs import cost_on
from validation.accuracy.plan import able, asked_of, cheapest, planned_case
from validation.accuracy.step_choice import ROUNDING_FACTOR, Chooser

TENFOLD = 10.0
MAX_WORK = 5e7  # bodies times steps of a line of the table that nobody asked for
BLOWN_UP = 100.0  # errors beyond it are of a motion that has nothing to do with the scene's
AS_GIVEN = ", as the scene has it"
AGREEMENT = 1e-2  # differences beyond it are no agreement at all


Row = tuple[str, Case | None, dict[str, float], str]  # label, and a case with its errors, or why there is none


def plan_report(source: str | Path, settings: tuple[str, ...] = ()) -> Iterator[str]:
    """The lines, for a scene with an accuracy or a time step.

    Raises:
        InputError: anything wrong with the scene or its accuracy.
    """
    case = planned_case(source, *settings)
    engines = [(name, load_engine(name).shear, asdict(cost_on(name))) for name in able(case)]
    there = installed(name for name, *_ in engines)
    scenes = [each.scene.model_dump(mode="json") for each in (case, case.full) if each]
    report = _straight if case.chain.lateral is None else _three_dimensional
    lines = kept(["plan", scenes, engines, there], lambda: [*report(case)])
    yield from (f"{case.scene.name}: {case.summary}", *lines)


def _straight(case: Case) -> Iterator[str]:
    began = time.perf_counter()
    steps, plan = case.scene.steps_per_sample, case.plan
    asked = asked_of(case) if plan else {FORCE: 0.0}
    chooser = Chooser(case, tuple(asked), min(asked.values()) / TENFOLD)
    errors = plan.predicted if plan else dict(chooser.errors_at(steps))
    rounding = chooser.rounding(steps)
    rows = [*_rows(case, chooser, asked if plan else errors, errors)]
    seconds = time.perf_counter() - began

    why = AS_GIVEN
    if plan:
        yield f"accuracy   {_listed(asked)}"
        why = ": one step a sample is enough; a larger sample_interval would allow a larger one"
        if plan.refused_steps:
            coarser = _us(case.scene.run.sample_interval / plan.refused_steps)
            why = f": {coarser} would err by {_listed(chooser.errors_at(plan.refused_steps))}"
    problem = failure(case) if case.scene.time_step_s > chooser.stable_s else None
    yield from _stability(case, chooser.stable_s, why, problem)
    if problem:
        return  # of a step that is refused there is nothing to predict
    allowance = ROUNDING_FACTOR * float(rounding[-1])
    if still(chooser.truth.trace.force_N):
        yield f"           {NOTHING_MOVES}"
    yield f"predicted  {_listed(errors)}; rounding of absolute heights up to {allowance:.1e} more"
    if chooser.known > min(errors.values(), default=1.0) / TENFOLD:
        yield f"           the exact motion itself is known to {chooser.known:.1e} only: it multiplies rounding"
    for element in case.elements:
        if case.full is not None and case.full.models(element.name) and not element.modelled:
            yield f"left out   {element.name}: {element.reason.partition(': ')[2]}"
    yield f"engine     {_engines(case)}"
    yield from ("", *_table(rows), "", f"horizon    {_horizon(case, ROUNDING_MARGIN * rounding)}")
    if plan:
        yield f"planned in {1e3 * plan.seconds:.0f} ms with {plan.trials} trial runs, this table in"
        yield f"           {1e3 * seconds:.0f} ms more"


def _three_dimensional(case: Case) -> Iterator[str]:
    """Of a scene whose exact motion nobody knows: errors by extrapolation."""
    limit = predicted_limit(case.chain, float(case.sample_times_s[-1]))
    problem = failure(case) if case.scene.time_step_s > limit else None
    yield from _stability(case, limit, AS_GIVEN, problem)
    if problem:
        return
    yield f"engine     {_engines(case)}"
    if baseline_of(case).unknown:
        yield f"predicted  {baseline_of(case).unknown}"
        return
    by_law: dict[str, list[str]] = {}
    for name in able(case):
        by_law.setdefault(load_engine(name).shear, []).append(name)
    for names in by_law.values():
        error, baseline = float(predicted_error(case, names[0]).max()), baseline_of(case, names[0])
        yield f"predicted  force {error:.3g} on {', '.join(names)}, which converges with order {baseline.order:.2g}"
        end = case.sample_times_s[baseline.samples - 1]
        yield f"horizon    engines with that law of friction can be compared point by point until {end * 1e3:.4g} ms"


def _rows(case: Case, chooser: Chooser, asked: dict[str, float], errors: dict[str, float]) -> Iterator[Row]:
    """Ten times less accuracy, this, and ten times more."""
    yield _chosen("ten times less", chooser, asked, TENFOLD)
    yield "this", case, errors, ""
    more = "ten times more"
    needed = case.scene.steps * TENFOLD ** (1 if case.chain.damped else 0.5)  # by the scheme's order
    if case.full is not None:
        yield more, None, {}, "what is left out here would come in again: ask for it"
    elif needed * case.chain.bodies > MAX_WORK:
        yield more, None, {}, f"about {needed:.2g} steps, too many to try here"
    else:
        yield _chosen(more, chooser, asked, 1 / TENFOLD)


def _chosen(label: str, chooser: Chooser, asked: dict[str, float], factor: float) -> Row:
    try:
        chosen, plan = chooser.choose({name: min(factor * share, 0.99) for name, share in asked.items()}, MAX_WORK)
    except InputError as error:
        return label, None, {}, str(error).partition("allowed: ")[2] or str(error)
    return label, chosen, plan.predicted, ""


def _table(rows: list[Row]) -> Iterator[str]:
    names = able(next(case for _, case, *_ in rows if case))
    yield f"{'accuracy':<16}{'time step':>12}{'error':>10}" + "".join(f"{name:>12}" for name in names)
    for label, case, errors, why in rows:
        if case is None:
            yield f"{label:<16}not here: {why}"
            continue
        worst = max(errors.values())
        seconds = "".join(f"{cost_on(name).run_s(case):>10.2f} s" for name in names)
        error = f"{worst:.1e}" if worst < BLOWN_UP else "blows up"
        yield f"{label:<16}{_us(case.scene.time_step_s):>12}{error:>10}{seconds}"


def _engines(case: Case) -> str:
    needed = ", ".join(element.name for element in case.elements if element.modelled) or "beads alone"
    chosen = cheapest(case)
    seconds = {name: f"{cost_on(name).run_s(case):.2g} s" for name in installed(able(case))}
    others = ", ".join(f"{name} {cost}" for name, cost in seconds.items() if name != chosen)
    return f"{chosen}, {seconds[chosen]}: the cheapest that models {needed}" + (f" ({others})" if others else "")


def _horizon(case: Case, share: Array) -> str:
    """Up to when engines can be compared sample by sample, by what rounding may make until each."""
    ms = 1e3 * case.sample_times_s
    if share[-1] <= HORIZON:
        return (
            f"to the end ({ms[-1]:.4g} ms) engines can be compared point by point: rounding stays below"
            f" {share[-1]:.0e} of the largest change"
        )
    if share[0] > HORIZON:
        return "heights so far from the origin round too much for any comparison of engines point by point"
    until, later_until = (ms[max(int(np.argmax(share > level)) - 1, 0)] for level in (HORIZON, AGREEMENT))
    later = f", to {AGREEMENT:g} until {later_until:.4g} ms" if share[-1] > AGREEMENT else ""
    return (
        f"engines can be compared point by point to {HORIZON:g} until {until:.4g} ms{later}; after that compare"
        " energy, mean forces and other statistics"
    )


def _stability(case: Case, stable_s: float, why: str, problem: str | None) -> Iterator[str]:
    """The time step, the bound below which it is stable, trials beyond, and criteria that do not look at the motion."""
    steps = case.scene.steps_per_sample
    yield f"time step  {_us(case.scene.time_step_s)} ({steps} step{'s' if steps > 1 else ''} a sample){why}"
    if stable_s == float("inf"):
        yield "stability  no contact closes: no limit"
        return
    share = case.scene.time_step_s / stable_s
    fails_s = first_failure_s(case, stable_s)
    beyond = f"the first trial to blow up is at {_us(fails_s)}" if fails_s else "no trial beyond it that blows up"
    yield f"stability  up to {_us(stable_s)}, a lower bound; {beyond}; this step is {share:.2g} of the bound"
    if share > 1:
        yield (
            f"           a trial at this step {problem}: it is refused" if problem else "           and runs in a trial"
        )
    others = (f"{label} {_us(fraction * time(case))}" for label, (fraction, time) in CRITERIA.items())
    yield f"           (by criteria that do not look at the motion: {', '.join(others)})"


def _listed(errors: dict[str, float]) -> str:
    return ", ".join(f"{name} {f'{error:.3g}' if error < BLOWN_UP else 'blows up'}" for name, error in errors.items())


def _us(seconds: float) -> str:
    return f"{seconds * 1e6:.5g} us"
