"""The plan of a case: the largest time step that keeps the accuracy its scene asks for, and what to expect of it."""

import time
from dataclasses import dataclass, replace

from drivers.chain.case import Case
from drivers.engines import IN_HEIGHTS, load_engine


@dataclass(frozen=True)
class Plan:
    """What was asked for and what is predicted, by quantity; errors as in ``accuracy.error_measures``.

    Attributes:
        predicted: the error of the codes' scheme at the chosen step, measured with it on this very case.
        rounding_share: what rounding of absolute heights may add on engines that hold them, of the largest force.
        refused_steps: the largest step found too coarse, in steps a sample; 0 where none was.
        trials: runs of the in-repo scheme that it took.
        seconds: what the plan cost.
    """

    asked: dict[str, float]
    predicted: dict[str, float]
    rounding_share: float
    refused_steps: int
    trials: int
    seconds: float


def asked_of(case: Case) -> dict[str, float]:
    """The accuracy a scene asks for, by quantity; names may end in their unit, as observables do."""
    from postproc.read.observables import without_unit
    from validation.accuracy.error_measures import FORCE

    accuracy = case.scene.run.accuracy
    assert accuracy is not None
    if not isinstance(accuracy, dict):
        return {FORCE: accuracy}
    return {without_unit(name): share for name, share in accuracy.items()}


def planned(case: Case) -> Case:
    """The case at the largest time step that keeps its accuracy, without what matters too little for it.

    Where rounding takes a share of the accuracy, the step leaves room for it.

    Raises:
        InputError: no step keeps it, or the scene does not show a quantity.
    """
    from validation.accuracy.simplify import lean_case
    from validation.accuracy.step_choice import Chooser

    began = time.perf_counter()
    asked = asked_of(case)
    chooser = Chooser(lean_case(case, asked), tuple(asked), min(asked.values()))
    choice = chooser.choose_with_room(asked)
    plan = Plan(
        asked=asked,
        predicted=choice.errors,
        rounding_share=choice.rounding.allowance,
        refused_steps=choice.refused,
        trials=choice.trials,
        seconds=round(time.perf_counter() - began, 6),
    )
    return replace(choice.case, plan=plan)


def refuse_beyond_rounding(case: Case, engine: str) -> None:
    """Refuses an accuracy that the engine's coordinates cannot give.

    Raises:
        InputError: rounding of absolute heights may take more than is asked for; the attainable accuracy is named.
    """
    name = beyond_rounding(case, engine)
    if name is not None:
        from validation.accuracy.step_choice import attainable_in_heights, unattainable

        assert case.plan is not None
        share = case.plan.asked[name]
        why = f"what absolute heights leave on {engine}; verlet holds overlaps and reaches it"
        raise unattainable(case, name, share, attainable_in_heights(share, case.plan.rounding_share), why)


def beyond_rounding(case: Case, engine: str) -> str | None:
    """The first quantity whose accuracy the engine's coordinates cannot give; None where they can."""
    if case.plan is None or load_engine(engine).scheme != IN_HEIGHTS:
        return None
    plan = case.plan
    lost = (name for name, share in plan.asked.items() if plan.predicted[name] + plan.rounding_share > share)
    return next(lost, None)
