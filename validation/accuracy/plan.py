"""Planning of a case: the largest time step that keeps the accuracy its scene asks for, and the cheapest engine."""

import time
from dataclasses import replace
from pathlib import Path

from drivers.base.errors import RunError
from drivers.chain.case import Case, build_case
from drivers.engines import engine_names, installed, load_engine
from drivers.limits.refusal import FORCE, beyond_rounding
from drivers.scene.read_scene import read_scene
from validation.accuracy.costs import cost_on


def able(case: Case) -> list[str]:
    """Engines that model all that the case requires, as accurately as it asks, installed or not."""
    needed = {element.name for element in case.elements if element.modelled}
    return [
        name
        for name in engine_names()
        if needed <= load_engine(name).models
        and not beyond_rounding(case, name)
        and load_engine(name).refusal(case) is None
    ]


def cheapest(case: Case) -> str:
    """The cheapest installed engine that models all that the case requires.

    Raises:
        RunError: there is none.
    """
    found = installed(able(case))
    if not found:
        raise RunError(f"no installed engine models all of this scene; {', '.join(able(case)) or 'none'} would")
    return min(found, key=lambda name: cost_on(name).run_s(case))


def planned_case(source: str | Path, *settings: str) -> Case:
    """The case of a scene with settings laid over it, planned.

    Raises:
        InputError: anything wrong with the scene or its accuracy.
    """
    return plan_case(build_case(read_scene(source, settings)))


def asked_of(case: Case) -> dict[str, float]:
    """The accuracy a scene asks for, by quantity; names may end in their unit, as observables do."""
    from postproc.read.observables import without_unit

    accuracy = case.scene.run.accuracy
    assert accuracy is not None
    if not isinstance(accuracy, dict):
        return {FORCE: accuracy}
    return {without_unit(name): share for name, share in accuracy.items()}


def plan_case(case: Case) -> Case:
    """The case at the largest time step that keeps its accuracy, without what matters too little for it.

    Where rounding takes a share of the accuracy, the step leaves room for it. A case that asks for no accuracy stays
    as it is.

    Raises:
        InputError: no step keeps it, or the scene does not show a quantity.
    """
    if case.scene.run.accuracy is None:
        return case
    from validation.accuracy.step_choice import (
        Chooser,
        simplify,  # runs the in-repo scheme: only where it is needed
    )

    began = time.perf_counter()
    asked = asked_of(case)
    chooser = Chooser(simplify(case, asked), tuple(asked), min(asked.values()))
    chosen, plan = chooser.choose_with_room(asked)
    return replace(chosen, plan=replace(plan, asked=asked, seconds=round(time.perf_counter() - began, 6)))
