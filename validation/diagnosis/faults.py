"""Variants without a parameter: what is forgotten, reversed, swapped, or taken half a step off."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from drivers.chain.case import Case
from drivers.chain.chain import Array
from drivers.engines import EXACT
from validation.diagnosis.faulty_model import Model
from validation.diagnosis.other_materials import (
    YADE_POISSON_RATIO,
    YADE_YOUNGS_MODULUS,
    forgotten,
    known,
    own,
    stiffness_of,
)
from validation.diagnosis.variants import BEHIND_BY_THE_SCENES, MOST_PLACES, Variant, behind_by, number, weighing

YADE_DAMPING = 0.2  # what NewtonIntegrator takes by itself
OTHER_STEPS = (2, 4, 5, 8, 10)


def faults(case: Case, model: Model) -> Iterator[Variant]:
    """All of them, the plainest first."""
    yield from _loads(case, model)
    yield from _striker(case, model)
    yield from _numerics(case, model)
    yield from _masses(case, model)
    yield from _materials(case, model)
    yield from _forgotten(case, model)
    yield from _placing(case, model)


def _loads(case: Case, model: Model) -> Iterator[Variant]:
    chain = case.chain
    weight = chain.gravity_m_s2 * model.mass_kg
    if chain.gravity_m_s2:
        yield Variant("gravity", "the scene without gravity", replace(model, load_N=model.load_N + weight))
        yield Variant("gravity", "gravity that points upwards", replace(model, load_N=model.load_N + 2 * weight))
    if chain.precompression_N and chain.beads:
        for words, times in (("the scene without its precompression", 1), ("a precompression that points upwards", 2)):
            load = model.load_N.copy()
            load[chain.beads - 1] += times * chain.precompression_N
            yield Variant("precompression", words, replace(model, load_N=load))


def _striker(case: Case, model: Model) -> Iterator[Variant]:
    if not model.velocity_m_s.any():
        return
    if case.scene.striker is not None:
        for words, factor in (("a striker at rest", 0.0), ("a striker that moves upwards", -1.0)):
            velocity = model.velocity_m_s.copy()
            velocity[-1] *= factor
            yield Variant("striker speed", words, replace(model, velocity_m_s=velocity))
            if not factor and model.assumed_m_s2[-1]:  # a velocity of zero half a step before time 0
                yield Variant("striker speed", words, replace(model, velocity_m_s=velocity, ahead=0.5))
    nothing = np.zeros(model.bodies)
    yield Variant("velocities", "all bodies at rest at time 0", replace(model, velocity_m_s=nothing))
    yield Variant("velocities", "all velocities at time 0 reversed", replace(model, velocity_m_s=-model.velocity_m_s))


def _numerics(case: Case, model: Model) -> Iterator[Variant]:
    if model.scheme == EXACT:
        return
    dt, every = model.time_step_s, model.steps_per_sample
    step_us = number(dt * 1e6)
    for steps, words in ((0.5, "half a step"), (1.0, "a step"), (-0.5, "half a step"), (-1.0, "a step")):
        place = "ahead" if steps > 0 else "behind"
        euler = ", as symplectic Euler has them" if abs(steps) == 0.5 else ""
        sentence = f"velocities that start {words} {place}{euler}; a step is {step_us} us"
        yield Variant("velocity shift", sentence, replace(model, ahead=steps))
    damped = replace(model, local_damping=YADE_DAMPING)
    yield Variant("local damping", f"non-viscous damping of {YADE_DAMPING}, which YADE has unless told", damped)
    if case.chain.damping_ratio:
        none = np.zeros(model.bodies)
        yield Variant("damping", "contacts that lose no energy", replace(model, damping_ratio=none))
        yield Variant("damping", "damped contacts that may pull", replace(model, attracts=True))
    for other in sorted({every * n for n in OTHER_STEPS} | {every // n for n in OTHER_STEPS if every % n == 0}):
        now = dt * every / other
        words = f"a time step of {number(now * 1e6)} us (the scene has {step_us})"
        slower = replace(model, time_step_s=now, steps_per_sample=other)
        yield Variant("time step", words, slower)
        if model.assumed_m_s2.any():
            yield Variant("time step", words + BEHIND_BY_THE_SCENES, behind_by(slower, dt))
    for other in (every + n for n in (-2, -1, 1, 2) if every + n > 0):
        words = f"samples that are {other} steps apart (the scene has {every})"
        yield Variant("samples", words, replace(model, steps_per_sample=other))
    yield Variant("scheme", "the exact motion, without the error of a time step", replace(model, scheme=EXACT))


def _masses(case: Case, model: Model) -> Iterator[Variant]:
    chain, gauges = case.chain, [sensor.from_wall - 1 for sensor in case.scene.chain.sensors]
    ordinary = [j for j in range(chain.beads) if j not in gauges]
    if not gauges or not ordinary:
        return
    usual = float(np.median(chain.mass_kg[ordinary]))
    unlike = [j for j in gauges if chain.mass_kg[j] != usual]
    for places in [unlike, *([j] for j in unlike if len(unlike) > 1)]:
        if places:
            mass = model.mass_kg.copy()
            mass[places] = usual
            who = "sensor beads" if len(places) > 1 else f"bead {places[0] + 1}"
            words = f"{who} weighing {number(usual * 1e3)} g, as other beads do"
            kind = "sensor mass" if places == unlike else f"mass of bead {places[0] + 1}"
            yield Variant(kind, words, weighing(model, mass, chain.gravity_m_s2))


def _materials(case: Case, model: Model) -> Iterator[Variant]:
    """Bodies and wall of any known material: by place, and where a name serves for several of them by name."""
    chain, names = case.chain, known(case)
    bodies, wall = own(case)
    striker = case.scene.striker is not None
    roles: dict[str, list[int]] = {"beads": list(range(chain.beads))} if chain.beads else {}
    if striker:
        roles["a striker"] = [chain.bodies - 1]
    for name in dict.fromkeys(chain.materials):
        places = [j for j in range(chain.bodies) if chain.materials[j] == name]
        if places not in roles.values() or chain.wall == name:
            roles[name] = places
    for role, places in roles.items():
        by_name = role in names
        for other, material in names.items():
            changed = [material if j in places else bodies[j] for j in range(chain.bodies)]
            under = material if by_name and chain.wall == role else wall
            if material is None or (changed == bodies and under == wall):
                continue  # only walls are rigid
            words = f"{role} taken for {other}" if by_name else f"{role} of {other}"
            kind = f"material of {role.removeprefix('a ')}"
            swapped = replace(model, stiffness=stiffness_of(case, changed, under))
            yield Variant(kind, words, swapped)
            mass = _by_density(case, places, other)
            if mass is not None:
                weighed = weighing(swapped, mass, chain.gravity_m_s2)
                yield Variant(kind, f"{words}, in stiffness and in mass", weighed)
    if chain.wall:
        for other, material in names.items():
            if other != chain.wall:
                stiffness = stiffness_of(case, bodies, material)
                yield Variant("material of wall", f"a wall of {other}", replace(model, stiffness=stiffness))


def _forgotten(case: Case, model: Model) -> Iterator[Variant]:
    """All materials or one without elastic constants, which YADE completes."""
    bodies, wall = own(case)
    chain = case.chain
    names = list(dict.fromkeys([*chain.materials, *([chain.wall] if chain.wall else [])]))
    young = f"Young's modulus of {number(YADE_YOUNGS_MODULUS / 1e9)} GPa"
    poisson = f"Poisson's ratio of {number(YADE_POISSON_RATIO)}"
    for modulus, ratio, has in (
        (False, True, f"the {poisson}"), (True, False, f"the {young}"), (True, True, f"the {young} and {poisson}"),
    ):  # fmt: skip
        for group in [names, *([name] for name in names if len(names) > 1)]:
            changed = [
                forgotten(material, modulus=modulus, ratio=ratio) if name in group else material
                for name, material in zip(chain.materials, bodies, strict=True)
            ]
            under = forgotten(wall, modulus=modulus, ratio=ratio) if chain.wall in group else wall
            stiffness = stiffness_of(case, changed, under)
            if np.array_equal(stiffness, model.stiffness):
                continue
            who = "all materials" if len(group) > 1 else group[0]
            words = f"{who} with {has} that YADE has unless told"
            yield Variant(f"elastic constants of {who}", words, replace(model, stiffness=stiffness))


def _by_density(case: Case, places: list[int], other: str) -> Array | None:
    """Masses of another material where the scene leaves masses to the density."""
    scene, names = case.scene, known(case)
    given = scene.chain.mass is not None if places[0] < case.chain.beads else (scene.striker and scene.striker.mass)
    new, old = names[other], names[case.chain.materials[places[0]]]
    if given or new is None or old is None or not new.density or not old.density:
        return None
    mass = case.chain.mass_kg.copy()
    mass[places] *= new.density / old.density
    return mass


def _placing(case: Case, model: Model) -> Iterator[Variant]:
    chain = case.chain
    if (chain.overlap_m > 0).any():
        words = "beads that start just touching, not in equilibrium"
        yield Variant("placing", words, replace(model, overlap_m=np.minimum(chain.overlap_m, 0.0)))
    if (chain.overlap_m < 0).any():
        words = "beads that start without their gaps"
        yield Variant("placing", words, replace(model, overlap_m=np.maximum(chain.overlap_m, 0.0)))
    existing = [j for j in range(model.bodies) if model.stiffness[j] > 0]
    for j in existing if len(existing) <= MOST_PLACES else existing[:1]:
        stiffness = model.stiffness.copy()
        stiffness[j] = 0.0
        what = "the scene without its wall" if j == 0 else f"contact {j + 1} missing"
        yield Variant("missing contact", what, replace(model, stiffness=stiffness))
