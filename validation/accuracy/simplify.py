"""Model only what an accuracy requires: elements whose measured effect is small beside it are left out."""

from collections.abc import Callable
from dataclasses import replace

from drivers.chain.case import Case
from drivers.chain.chain import build_chain
from drivers.chain.elements import Element, choose_elements
from drivers.limits.refusal import FORCE
from drivers.scene.model import Scene
from validation.accuracy.error_measures import ENERGY, errors_of, truth_of

SHARE = 0.5  # of the accuracy: what all that is left out may take together; the time step has the rest


def _with(scene: Scene, table: str, **changes: object) -> Scene:
    return scene.model_copy(update={table: getattr(scene, table).model_copy(update=changes)})


def _equal_sensors(scene: Scene) -> Scene:
    return _with(scene, "chain", sensors=tuple(each.model_copy(update={"mass": None}) for each in scene.chain.sensors))


# the scene without an element of ``drivers.chain.elements``
WITHOUT: dict[str, Callable[[Scene], Scene]] = {
    "gravity": lambda scene: scene.model_copy(update={"gravity": 0.0}),
    "precompression": lambda scene: _with(scene, "chain", precompression=0.0),
    "sensor masses": _equal_sensors,
    "mass scatter": lambda scene: _with(scene, "chain", mass_scatter=0.0),
    "damping": lambda scene: _with(scene, "contact", restitution=None, damping_ratio=None),
}


def simplify(case: Case, asked: dict[str, float]) -> Case:
    """The case without what changes too little of what is asked for, the smallest effects first.

    Effects are those on the exact motion, one by one and together; a case that they cannot be measured on stays whole.

    Args:
        case: a straight chain's.
        asked: accuracies by quantity, as ``validation.accuracy.error_measures`` counts errors.
    """
    candidates = [each.name for each in case.elements if each.modelled and each.name in WITHOUT]
    if not candidates:
        return case
    try:
        truth = truth_of(case)
        if any(name not in truth.true for name in asked if name not in (FORCE, ENERGY)):
            return case  # whoever chooses the step says so

        def effect(names: list[str]) -> dict[str, float]:
            changed = errors_of(case, truth_of(_without(case, names), finer=False).trace, truth, asked)
            return {name: changed[name] / share for name, share in asked.items()}

        alone = {name: effect([name]) for name in candidates}
    except ArithmeticError:
        return case
    left: list[str] = []
    for largest, name in sorted((max(shares.values()), name) for name, shares in alone.items()):
        if largest <= SHARE and max(effect([*left, name]).values()) <= SHARE:
            left.append(name)
    if not left:
        return case
    simple = _without(case, left)
    elements = tuple(_explained(each, case, alone, asked) if each.name in left else each for each in simple.elements)
    return replace(simple, elements=elements, full=case)


def _without(case: Case, names: list[str]) -> Case:
    scene = case.scene
    for name in names:
        scene = WITHOUT[name](scene)
    chain = build_chain(scene)
    return replace(case, scene=scene, chain=chain, elements=choose_elements(scene, chain))


def _explained(element: Element, case: Case, alone: dict[str, dict[str, float]], asked: dict[str, float]) -> Element:
    worst = max(alone[element.name], key=lambda name: alone[element.name][name])
    change = alone[element.name][worst] * asked[worst]
    scene_has = next(each.reason for each in case.elements if each.name == element.name)
    reason = f"left out ({scene_has}): it changes the {worst} by {change:.1e}, where {asked[worst]:g} is asked for"
    return replace(element, reason=reason)
