"""What is refused before it runs: steps that blow up, beads pressed through each other, what an engine cannot take."""

from math import floor, log10

import numpy as np

from drivers.base.errors import InputError
from drivers.chain.case import Case
from drivers.chain.chain import Array, Chain
from drivers.engines import EXACT, engine_names, load_engine
from drivers.limits.attainable import refuse_beyond_rounding
from drivers.limits.energy_bounds import Reached, at_most, certainly_stable

ON_COMMAND = "--unsafe"


def refuse(case: Case, engine: str, override: str = ON_COMMAND) -> None:
    """Refuses what cannot end well on an engine; ``override`` is what runs it all the same.

    Raises:
        InputError: the time step is beyond the stability limit; contacts would be pressed deeper than Hertz's law can
            mean; the engine's coordinates cannot give the accuracy asked for; the engine cannot take the case; nobody
            has planned the time step of a scene that asks for an accuracy.
    """
    if case.scene.run.accuracy is not None and case.plan is None:
        raise InputError(case.scene.file, "run.accuracy", "an accuracy", "a run.time_step: nothing plans one here")
    refuse_beyond_rounding(case, engine)
    cannot = inability(case, engine)
    if cannot is not None:
        raise cannot
    _refuse_depth(case, override)
    if load_engine(engine).scheme != EXACT:
        _refuse_step(case, override)


def inability(case: Case, engine: str) -> InputError | None:
    """What an engine cannot take, by name; None where it takes the case."""
    missing = [each.name for each in case.elements if each.modelled and each.name not in load_engine(engine).models]
    if missing:
        able = ", ".join(name for name in engine_names() if _models_all(case, name))
        where = f'"{engine}" for a scene with {", ".join(missing)}'
        return InputError(
            case.scene.file, "", where, f"an engine that models it: {able}" if able else "nothing: none models it"
        )
    problem = load_engine(engine).refusal(case)
    if problem is None:
        return None
    key, found, allowed = problem
    return InputError(case.scene.file, key, found, f"on {engine} {allowed}")


def _models_all(case: Case, engine: str) -> bool:
    return {each.name for each in case.elements if each.modelled} <= load_engine(engine).models


def _refuse_step(case: Case, override: str) -> None:
    chain, duration, step = case.chain, float(case.sample_times_s[-1]), case.scene.time_step_s
    if certainly_stable(chain, duration, step):
        return
    from drivers.limits.stable_step import predicted_limit

    limit = predicted_limit(chain, duration)
    if step > limit:
        digits = 10.0 ** (floor(log10(limit)) - 2)
        allowed = (
            f"at most {floor(limit / digits) * digits:.3g} s, beyond which this chain blows up ({override} runs it)"
        )
        raise InputError(case.scene.file, "run.time_step", f"{step:g} s", allowed)


def _refuse_depth(case: Case, override: str) -> None:
    """Contacts, with the bore too, that are pressed deeper than Hertz's law can mean."""
    chain, duration = case.chain, float(case.sample_times_s[-1])
    if (_depths(chain, at_most(chain, duration)) < 1).all():
        return
    from drivers.limits.stable_step import reached

    between, in_bore = _depths(chain, reached(chain, duration))
    for key, what, depth, where in (
        ("striker.speed" if case.scene.striker else "chain", "contact", between, ""),
        ("chain", "body", in_bore, " into the bore"),
    ):
        if (depth >= 1).any():
            place = int(np.argmax(depth))
            found = f"a motion that presses {what} {place + 1} {depth[place]:.3g} radii deep{where}"
            allowed = f"overlaps below a radius: beyond, Hertz's law means nothing ({override} runs it)"
            raise InputError(case.scene.file, key, found, allowed)


def _depths(chain: Chain, reached: Reached) -> Array:
    """Overlaps of contacts, and with the bore, over the smaller radius. Shape (2, bodies)."""
    return np.array([reached.overlap_m / chain.smaller_radius_m, reached.bore_overlap_m / chain.radius_m])
