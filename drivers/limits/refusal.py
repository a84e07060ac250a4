"""What is refused before it runs: steps that blow up, beads pressed through each other, what an engine cannot take.

Accuracies cannot be had either beyond what rounding of absolute heights leaves of them.
"""

from math import ceil, floor, log10

import numpy as np

from drivers.base.errors import InputError
from drivers.chain.case import Case
from drivers.chain.chain import Array, Chain
from drivers.engines import EXACT, IN_HEIGHTS, engine_names, load_engine
from drivers.limits.energy_bounds import at_most, certainly_stable
from validation.reference.hertz_chain import Extremes

FORCE = "force"  # the quantity of an accuracy without a name
ROOM = 1.3  # times the rounding that is predicted, where a step has to leave room for it
ON_COMMAND = "--unsafe"


def refuse(case: Case, engine: str, override: str = ON_COMMAND) -> None:
    """Refuses what cannot end well on an engine; ``override`` is what runs it all the same.

    Raises:
        InputError: the time step fails in a trial, or may blow up where a trial takes too long; contacts would be
            pressed deeper than Hertz's law can mean; the engine's coordinates cannot give the accuracy asked for; the
            engine cannot take the case; nobody has planned the time step of a scene that asks for an accuracy.
    """
    if case.scene.run.accuracy is not None and case.plan is None:
        raise InputError(case.scene.file, "run.accuracy", "an accuracy", "a run.time_step: nothing plans one here")
    refuse_beyond_rounding(case, engine)
    cannot = inability(case, engine)
    if cannot is not None:
        raise cannot
    _refuse_depth(case, override)
    if load_engine(engine).scheme != EXACT:
        _refuse_step(case, load_engine(engine).shear, override)


def inability(case: Case, engine: str) -> InputError | None:
    """What an engine cannot take, by name; None where it takes the case."""
    asked, needed = load_engine(engine), [each.name for each in case.elements if each.modelled]
    missing = [name for name in needed if name not in asked.models]
    if missing:
        able = ", ".join(name for name in engine_names() if load_engine(name).models >= set(needed))
        where = f'"{engine}" for a scene with {", ".join(missing)}'
        return InputError(
            case.scene.file, "", where, f"an engine that models it: {able}" if able else "nothing: none models it"
        )
    law = case.scene.contact.dissipation
    if case.chain.damped and law not in asked.dissipation:
        allowed = " or ".join(f'"{each}"' for each in sorted(asked.dissipation))
        return InputError(case.scene.file, "contact.dissipation", f'"{law}"', f"on {engine} {allowed}")
    problem = asked.refusal(case)
    if problem is None:
        return None
    key, found, allowed = problem
    return InputError(case.scene.file, key, found, f"on {engine} {allowed}")


def _refuse_step(case: Case, shear: str, override: str) -> None:
    """A step beyond the predicted bound, where a trial of the scheme fails or takes too long."""
    chain, duration, step = case.chain, float(case.sample_times_s[-1]), case.scene.time_step_s
    if certainly_stable(chain, duration, step):
        return
    from drivers.limits.stable_step import BEGINNING, predicted_limit
    from drivers.limits.trial import failure

    for share in (BEGINNING, 1.0):
        limit = predicted_limit(chain, duration, share)
        if step > limit:
            if problem := failure(case, shear):
                digits = 10.0 ** (floor(log10(limit)) - 2)
                most = f"at most {floor(limit / digits) * digits:.3g} s, which is stable"
                allowed = f"{most}; a trial at this step {problem} ({override} runs it)"
                raise InputError(case.scene.file, "run.time_step", f"{step:g} s", allowed)
            return


def _refuse_depth(case: Case, override: str) -> None:
    """Contacts, with the bore too, that are pressed deeper than Hertz's law can mean."""
    chain, duration = case.chain, float(case.sample_times_s[-1])
    if (_depths(chain, at_most(chain, duration)) < 1).all():
        return
    from drivers.limits.stable_step import BEGINNING, reached

    for share in (BEGINNING, 1.0):
        between, in_bore = _depths(chain, reached(chain, duration, share))
        for key, what, depth, where in (
            ("striker.speed" if case.scene.striker else "chain", "contact", between, ""),
            ("chain", "body", in_bore, " into the bore"),
        ):
            if (depth >= 1).any():
                place = int(np.argmax(depth))
                found = f"a motion that presses {what} {place + 1} {depth[place]:.3g} radii deep{where}"
                allowed = f"overlaps below a radius: beyond, Hertz's law means nothing ({override} runs it)"
                raise InputError(case.scene.file, key, found, allowed)


def _depths(chain: Chain, reached: Extremes) -> Array:
    """Overlaps of contacts, and with the bore, over the smaller radius. Shape (2, bodies)."""
    return np.array([reached.overlap_m / chain.smaller_radius_m, reached.bore_overlap_m / chain.radius_m])


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
