"""What ``python -m drivers plan`` says of a scene: the choice with its reasons, other accuracies, the horizon."""

import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from drivers.base.errors import InputError
from drivers.chain.case import Case
from drivers.engines import installed, load_engine
from drivers.limits.attainable import FORCE
from drivers.limits.criteria import CRITERIA
from drivers.limits.stable_step import predicted_limit
from validation.accuracy.baseline import HORIZON, ROUNDING_MARGIN, baseline_of
from validation.accuracy.costs import able, cheapest, cost_on
from validation.accuracy.plan import asked_of, planned_case
from validation.accuracy.run_warnings import predicted_error
from validation.accuracy.step_choice import Chooser, Rounding

TENFOLD = 10.0
MOST_WORK = 5e7  # bodies times steps of a line of the table that nobody asked for
BLOWN_UP = 100.0  # errors beyond it are of a motion that has nothing to do with the scene's
AMPLE = 1e-2  # differences beyond it are no agreement at all


def outlook(source: str | Path, settings: tuple[str, ...] = ()) -> Iterator[str]:
    """The lines, for a scene with an accuracy or a time step.

    Raises:
        InputError: anything wrong with the scene or its accuracy.
    """
    case = planned_case(source, *settings)
    if case.chain.lateral is not None:
        yield from _sideways(case)
        return
    began = time.perf_counter()
    chooser, asked = _chooser(case)
    errors = case.plan.predicted if case.plan else chooser.errors_at(case.scene.steps_per_sample)
    rounding = chooser.rounding(case.scene.steps_per_sample)
    rows = [*_neighbours(case, chooser, asked, errors)]
    seconds = time.perf_counter() - began

    yield f"{case.scene.name}: {case.summary}"
    if case.plan:
        yield f"accuracy   {_listed(asked)}"
        yield f"time step  {_step(case)}: {_why(case, chooser)}"
    else:
        yield f"time step  {_step(case)}, as the scene has it"
    yield from _stability(case, chooser.stable_s)
    if case.scene.time_step_s > chooser.stable_s:
        return  # of a step that is refused there is nothing to predict
    yield f"predicted  {_listed(errors)}; rounding of absolute heights up to {rounding.allowance:.1e} more"
    if chooser.known > min(errors.values(), default=1.0) / TENFOLD:
        yield f"           the exact motion itself is known to {chooser.known:.1e} only: it multiplies rounding"
    for element in case.elements:
        if case.full is not None and case.full.models(element.name) and not element.modelled:
            yield f"left out   {element.name}: {element.reason.partition(': ')[2]}"
    yield f"engine     {_engines(case)}"
    yield ""
    yield from _table(rows)
    yield ""
    yield f"horizon    {_horizon(case, rounding)}"
    if case.plan:
        yield f"planned in {1e3 * case.plan.seconds:.0f} ms with {case.plan.trials} trial runs, this table in"
        yield f"           {1e3 * seconds:.0f} ms more"


def _sideways(case: Case) -> Iterator[str]:
    """The lines of a three-dimensional scene, whose exact motion nobody knows: errors by extrapolation."""
    limit = predicted_limit(case.chain, float(case.sample_times_s[-1]))
    yield f"{case.scene.name}: {case.summary}"
    yield f"time step  {_step(case)}, as the scene has it"
    yield from _stability(case, limit)
    if case.scene.time_step_s > limit:
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


def _chooser(case: Case) -> tuple[Chooser, dict[str, float]]:
    """What answers questions about the case, and the accuracy asked for; of a given time step its own error."""
    if case.plan:
        asked = asked_of(case)
        strictest = min(asked.values()) / TENFOLD
        return Chooser(case, tuple(asked), strictest), asked
    chooser = Chooser(case, (FORCE,), 0.0)
    return chooser, dict(chooser.errors_at(case.scene.steps_per_sample))


def _neighbours(
    case: Case, chooser: Chooser, asked: dict[str, float], errors: dict[str, float]
) -> Iterator[tuple[str, Case | None, dict[str, float], str]]:
    """Ten times less accuracy, this, and ten times more: label, case and errors, or why there is none."""
    for label, factor in (("ten times less", TENFOLD), ("this", 1.0), ("ten times more", 1 / TENFOLD)):
        if factor == 1.0:
            yield label, case, errors, ""
            continue
        if factor < 1 and case.full is not None:
            yield label, None, {}, "what is left out here would come in again: ask for it"
            continue
        needed = case.scene.steps * factor ** (-1 if case.chain.damping_ratio else -0.5)  # by the scheme's order
        if factor < 1 and needed * case.chain.bodies > MOST_WORK:
            yield label, None, {}, f"about {needed:.2g} steps, too many to try here"
            continue
        try:
            choice = chooser.choose({name: min(factor * share, 0.99) for name, share in asked.items()})
        except InputError as error:
            yield label, None, {}, str(error).partition("allowed: ")[2] or str(error)
            continue
        yield label, choice.case, choice.errors, ""


def _table(rows: list[tuple[str, Case | None, dict[str, float], str]]) -> Iterator[str]:
    names = able(next(case for _, case, _, _ in rows if case))
    yield f"{'accuracy':<16}{'time step':>12}{'error':>10}" + "".join(f"{name:>12}" for name in names)
    for label, case, errors, why in rows:
        if case is None:
            yield f"{label:<16}not here: {why}"
            continue
        worst = max(errors.values())
        seconds = "".join(f"{cost_on(name).run_s(case):>10.2f} s" for name in names)
        error = f"{worst:.1e}" if worst < BLOWN_UP else "blows up"
        yield f"{label:<16}{_us(case.scene.time_step_s):>12}{error:>10}{seconds}"


def _why(case: Case, chooser: Chooser) -> str:
    assert case.plan is not None
    refused = case.plan.refused_steps
    if not refused:
        return "one step a sample is enough; a larger sample_interval would allow a larger one"
    coarser = chooser.errors_at(refused)
    return f"{_us(case.scene.run.sample_interval / refused)} would err by {_listed(coarser)}"


def _engines(case: Case) -> str:
    needed = ", ".join(element.name for element in case.elements if element.modelled) or "beads alone"
    there = installed(able(case))
    chosen = cheapest(case)
    others = ", ".join(f"{name} {cost_on(name).run_s(case):.2g} s" for name in there if name != chosen)
    seconds = cost_on(chosen).run_s(case)
    return f"{chosen}, {seconds:.2g} s: the cheapest that models {needed}" + (f" ({others})" if others else "")


def _horizon(case: Case, rounding: Rounding) -> str:
    """Up to when engines can be compared sample by sample."""
    share = ROUNDING_MARGIN * rounding.share
    times = case.sample_times_s
    if share[-1] <= HORIZON:
        return (
            f"to the end ({times[-1] * 1e3:.4g} ms) engines can be compared point by point: rounding stays below"
            f" {share[-1]:.0e} of the largest force"
        )
    if share[0] > HORIZON:
        return "heights so far from the origin round too much for any comparison of engines point by point"
    until = times[max(int(np.argmax(share > HORIZON)) - 1, 0)]
    beyond = share > AMPLE
    later = f", to {AMPLE:g} until {times[max(int(np.argmax(beyond)) - 1, 0)] * 1e3:.4g} ms" if beyond.any() else ""
    return (
        f"engines can be compared point by point to {HORIZON:g} until {until * 1e3:.4g} ms{later}; after that compare"
        " energy, mean forces and other statistics"
    )


def _stability(case: Case, stable_s: float) -> Iterator[str]:
    """The predicted limit, and criteria that do not look at the motion."""
    if stable_s == float("inf"):
        yield "stability  no contact closes: no limit"
        return
    share = case.scene.time_step_s / stable_s
    refused = ": it blows up, and is refused" if share > 1 else ""
    yield f"stability  up to {_us(stable_s)}; this step is {share:.2g} of it{refused}"
    others = (f"{label} {_us(fraction * time(case))}" for label, (fraction, time) in CRITERIA.items())
    yield f"           (by criteria that do not look at the motion: {', '.join(others)})"


def _listed(errors: dict[str, float]) -> str:
    return ", ".join(f"{name} {f'{error:.3g}' if error < BLOWN_UP else 'blows up'}" for name, error in errors.items())


def _step(case: Case) -> str:
    steps = case.scene.steps_per_sample
    return f"{_us(case.scene.time_step_s)} ({steps} step{'s' if steps > 1 else ''} a sample)"


def _us(seconds: float) -> str:
    return f"{seconds * 1e6:.5g} us"
