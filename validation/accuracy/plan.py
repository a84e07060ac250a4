"""Planning of a case: the largest time step that keeps the accuracy its scene asks for, and what to expect of it."""

import time
from dataclasses import replace
from pathlib import Path

from drivers.chain.case import Case, build_case
from drivers.limits.refusal import FORCE
from drivers.scene.read_scene import read_scene


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
    from validation.accuracy.simplify import simplify  # runs the in-repo scheme: only where it is needed
    from validation.accuracy.step_choice import Chooser

    began = time.perf_counter()
    asked = asked_of(case)
    chooser = Chooser(simplify(case, asked), tuple(asked), min(asked.values()))
    chosen, plan = chooser.choose_with_room(asked)
    return replace(chosen, plan=replace(plan, asked=asked, seconds=round(time.perf_counter() - began, 6)))
