"""Refusal of cases before they run.

Refused are unstable time steps, overlaps beyond the range of Hertz's law, and scenes that an engine cannot model.
"""

import numpy as np

from drivers.base.errors import InputError
from drivers.chain.case import Case
from drivers.chain.trace import FORCE
from drivers.engines import EXACT, TOTAL, engine_names, load_engine

ON_COMMAND = "--unsafe"


def refuse(case: Case, engine: str, override: str = ON_COMMAND) -> None:
    """Refuse a case that would fail on an engine; ``override`` is the option that runs it anyway, for the message.

    Raises:
        InputError: the time step blows up in a trial; an overlap exceeds a radius; the engine cannot model the case; or
            the scene has an accuracy and no time step was planned for it.
    """
    if case.scene.run.accuracy is not None and case.plan is None:
        raise InputError(case.scene.file, "run.accuracy", "no time step is planned for it here; give run.time_step")
    if cannot := inability(case, engine):
        raise cannot
    refuse_depth(case, override, load_engine(engine).shear)
    if load_engine(engine).scheme != EXACT:
        _refuse_step(case, load_engine(engine).shear, override)


def inability(case: Case, engine: str) -> InputError | None:
    """Error that says why an engine cannot model a case; None if the engine can."""
    interface, needed = load_engine(engine), [element.name for element in case.elements if element.modelled]
    missing = [name for name in needed if name not in interface.models]
    if missing:
        able = ", ".join(name for name in engine_names() if load_engine(name).models >= set(needed))
        found = f'"{engine}" for a scene with {", ".join(missing)}'
        allowed = f"an engine that models it: {able}" if able else "none, since no engine models the scene"
        return InputError(case.scene.file, "", found, allowed)
    law = case.chain.law.name
    if case.chain.damped and law not in interface.dissipation:
        allowed = " or ".join(f'"{name}"' for name in sorted(interface.dissipation))
        return InputError(case.scene.file, "contact.dissipation", f'"{law}"', f"on {engine} {allowed}")
    if problem := interface.refusal(case):
        key, found, allowed = problem
        return InputError(case.scene.file, key, found, f"on {engine} {allowed}")
    return None


def _refuse_step(case: Case, shear: str, override: str) -> None:
    """Refuse a step at which a trial blows up."""
    from drivers.limits.stable_step import step_limit, why_unstable  # the integrators take long to load

    if problem := why_unstable(case, shear):
        rounded_down_s = 0.995 * step_limit(case, shear).stable_s
        allowed = f"at most {rounded_down_s:.3g} s; a trial {problem} ({override} runs it)"
        raise InputError(case.scene.file, "run.time_step", f"{case.scene.time_step_s:g} s", allowed)


def refuse_depth(case: Case, override: str = ON_COMMAND, shear: str = TOTAL) -> None:
    """Refuse overlaps of contacts, or with the bore, of a radius or more.

    Raises:
        InputError: a motion that reaches them.
    """
    from drivers.limits.stable_step import resolved_trial

    chain, reached = case.chain, resolved_trial(case, shear).extremes
    pressed = np.where(chain.stiffness > 0, reached.overlap_m / chain.smaller_radius_m, 0.0)  # there may be no wall
    for key, what, depth, where in (
        ("striker.speed" if case.scene.striker else "chain", "contact", pressed, ""),
        ("chain", "body", reached.bore_overlap_m / chain.radius_m, " into the bore"),
    ):
        if (depth >= 1).any():
            place = int(np.argmax(depth))
            found = f"a motion that presses {what} {place + 1} {depth[place]:.3g} radii deep{where}"
            allowed = f"overlaps below a radius, the range of Hertz's law ({override} runs it)"
            raise InputError(case.scene.file, key, found, allowed)


def unattainable(case: Case, name: str, asked: float, least: float, why: str) -> InputError:
    """Error for an unattainable accuracy; it names the best attainable one, rounded up to two digits, if below 1."""
    key, rounded_up = "run.accuracy" if name == FORCE else f"run.accuracy.{name}", f"{1.05 * least:.2g}"
    allowed = f"at least {rounded_up} here, {why}" if 0 < float(rounded_up) < 1 else f"none here, {why}"
    return InputError(case.scene.file, key, f"{asked:g}", allowed)
