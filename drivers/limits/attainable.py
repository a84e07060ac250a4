"""Accuracies that cannot be had: what rounding of absolute heights leaves of them, and how an error says so."""

from math import ceil, floor, log10

from drivers.base.errors import InputError
from drivers.chain.case import Case
from drivers.engines import IN_HEIGHTS, load_engine

FORCE = "force"  # the quantity of an accuracy without a name
ROOM = 1.3  # times the rounding that is predicted, where a step has to leave room for it


def unattainable(case: Case, name: str, asked: float, least: float, why: str) -> InputError:
    """Error for an unattainable accuracy, naming the best attainable one, rounded up."""
    key = "run.accuracy" if name == FORCE else f"run.accuracy.{name}"
    if not least < 1:
        return InputError(case.scene.file, key, f"{asked:g}", f"none here, {why}")
    digits = 10.0 ** (floor(log10(least)) - 1)
    return InputError(case.scene.file, key, f"{asked:g}", f"at least {ceil(least / digits) * digits:.2g} here, {why}")


def attainable_in_heights(asked: float, rounding: float) -> float:
    """The accuracy that leaves room for the rounding of heights, from what rounding leaves at the accuracy asked for.

    Steps go with accuracy^(-1/2), and rounding with the root of the steps: ``2.6 rounding (asked / a)^(1/4) = a``.
    """
    return 1.5 * float((2 * ROOM * rounding * asked**0.25) ** 0.8)


def beyond_rounding(case: Case, engine: str) -> str | None:
    """The first quantity whose accuracy the engine's coordinates cannot give; None where they can."""
    if case.plan is None or load_engine(engine).scheme != IN_HEIGHTS:
        return None
    plan = case.plan
    lost = (name for name, share in plan.asked.items() if plan.predicted[name] + plan.rounding_share > share)
    return next(lost, None)


def refuse_beyond_rounding(case: Case, engine: str) -> None:
    """Refuses an accuracy that the engine's coordinates cannot give.

    Raises:
        InputError: rounding of absolute heights may take more than is asked for; the attainable accuracy is named.
    """
    name = beyond_rounding(case, engine)
    if name is not None:
        assert case.plan is not None
        share = case.plan.asked[name]
        why = f"what absolute heights leave on {engine}; verlet holds overlaps and reaches it"
        raise unattainable(case, name, share, attainable_in_heights(share, case.plan.rounding_share), why)
