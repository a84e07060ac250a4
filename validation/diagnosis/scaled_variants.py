"""Variants by a parameter: how stiff, how heavy, how fast, how far apart, how damped."""

from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from math import pi, sqrt

import numpy as np

from drivers.chain.case import Case
from drivers.chain.chain import Array, energy_put_in
from drivers.chain.contact_law import restitution_with_attraction
from drivers.engines import EXACT
from drivers.scene.model import Material
from validation.diagnosis.faulty_model import Model
from validation.diagnosis.other_materials import own, stiffness_of
from validation.diagnosis.variants import (
    BEHIND_BY_THE_SCENES,
    BOTH_SIGNS,
    FEW_FACTORS,
    Family,
    behind_by,
    by_factor,
    number,
    of_one,
    scaled_at,
    weighing,
)

SMALL = 1e-5  # of the unit of what is added
ROOT_HALF = sqrt(0.5)


def whole_families(case: Case, model: Model) -> Iterator[Family]:
    """Those of the whole chain, its wall or its striker, the plainest first."""
    yield from _contacts(case, model)
    yield from _masses(case, model)
    yield from _moduli(case, model)
    yield from _radii(case, model)
    yield from _loads(case, model)
    yield from _starts(case, model)
    if model.scheme != EXACT:
        yield from _numerics(case, model)


def single_families(case: Case, model: Model, near: list[int]) -> Iterator[Family]:
    """Those of single beads and contacts, given by their places from 0."""
    chain = case.chain
    for j in near:
        if 0 < j < chain.beads and chain.stiffness[j] > 0:
            words = partial(_times_as_stiff, f"contact {j + 1}")
            yield by_factor(f"contact {j + 1}", words, partial(_stiffer, model, j), FEW_FACTORS)
    for j in near:
        if j < chain.beads:
            words = partial(_weighing, f"bead {j + 1}", float(chain.mass_kg[j]))
            heavier = partial(_heavier, model, [j], chain.gravity_m_s2)
            yield by_factor(f"mass of bead {j + 1}", words, heavier, FEW_FACTORS)
    for j in near:
        unit = _deepest(case, j)
        yield Family(
            f"place of body {j + 1}",
            partial(_placed, j, unit),
            partial(_shifted, model, j, unit),
            BOTH_SIGNS,
            size=SMALL,
        )
    for j in near:
        unit = _largest(case)
        yield Family(
            f"force on body {j + 1}",
            partial(_pushed, f"body {j + 1}", unit),
            partial(_push, model, [j], unit),
            BOTH_SIGNS,
            size=SMALL,
        )


def _contacts(case: Case, model: Model) -> Iterator[Family]:
    chain = case.chain
    striker = case.scene.striker is not None
    if chain.wall:
        words = partial(_wall_words, chain.wall, "a wall contact")
        yield by_factor("wall contact", words, partial(_stiffer, model, 0))
    if chain.beads > 1:
        words = partial(_times_as_stiff, "contacts of beads")
        yield by_factor("bead contacts", words, partial(_stiffer, model, slice(1, chain.beads)))
    if striker and chain.beads:
        words = partial(_times_as_stiff, "a striker's contact")
        yield by_factor("striker contact", words, partial(_stiffer, model, chain.bodies - 1))
    if chain.wall and striker and chain.beads and np.isinf(chain.radius_m[-1]):
        words = partial(_wall_words, "what the scene has", "contacts with wall and flat striker")
        yield by_factor("plane contacts", words, partial(_stiffer, model, [0, chain.bodies - 1]))
    if chain.bodies > 1:
        words = partial(_times_as_stiff, "all contacts")
        yield by_factor("all contacts", words, partial(_stiffer, model, slice(0, chain.bodies)))


def _masses(case: Case, model: Model) -> Iterator[Family]:
    chain, g = case.chain, case.chain.gravity_m_s2
    gauges = [sensor.from_wall - 1 for sensor in case.scene.chain.sensors]
    if case.scene.striker is not None:
        words = partial(_weighing, "a striker", float(chain.mass_kg[-1]))
        yield by_factor("striker mass", words, partial(_heavier, model, [chain.bodies - 1], g))
    if len(gauges) > 1:
        words = partial(_times_as_heavy, "sensor beads")
        yield by_factor("sensor mass", words, partial(_heavier, model, gauges, g))
    if chain.beads:
        words = partial(_times_as_heavy, "beads")
        yield by_factor("bead masses", words, partial(_heavier, model, list(range(chain.beads)), g))
    words = partial(_times_as_heavy, "all bodies")
    yield by_factor("all masses", words, partial(_heavier, model, list(range(chain.bodies)), g))
    ordinary = [j for j in range(chain.beads) if j not in gauges]
    if gauges and ordinary:
        words = partial(_times_as_heavy, "beads other than the sensors'")
        yield by_factor("ordinary masses", words, partial(_heavier, model, ordinary, g))
    for who, bodies in (("beads", chain.beads), ("bodies", chain.bodies)):
        round_ones = np.isfinite(chain.radius_m) & (np.arange(chain.bodies) < bodies)
        densities = chain.mass_kg[round_ones] / chain.radius_m[round_ones] ** 3
        if densities.size and np.ptp(densities) > 1e-9 * densities.max():  # else it is a factor of all masses
            at = partial(_of_density, model, np.where(round_ones, chain.radius_m, 0.0), g)
            yield by_factor("density", partial(_density_words, who), at)


def _moduli(case: Case, model: Model) -> Iterator[Family]:
    bodies, wall = own(case)
    names = dict.fromkeys([*case.chain.materials, *([case.chain.wall] if case.chain.wall else [])])
    for name in names:
        if name in case.scene.materials and len(names) > 1:
            words = partial(_times_as_stiff, name, remark=" in E/(1 - nu^2)")
            yield by_factor(f"modulus of {name}", words, partial(_of_modulus, case, model, bodies, wall, name))


def _radii(case: Case, model: Model) -> Iterator[Family]:
    chain = case.chain
    if model.scheme == EXACT or not chain.beads:
        return
    radius = float(np.median(chain.radius_m[: chain.beads])) * 1e3
    grid = np.log(1 + 0.03 * BOTH_SIGNS)
    for who, count in (("beads", chain.beads), ("bodies", chain.bodies)):
        for solid, remark in ((False, ""), (True, ", and the mass that goes with it")):
            words = partial(_radius_words, who, radius, remark)
            yield by_factor("radius", words, partial(_of_radius, case, model, count, solid), grid)


def _loads(case: Case, model: Model) -> Iterator[Family]:
    chain = case.chain
    values = np.concatenate([-np.logspace(1, -1, 7), np.logspace(-2, 2, 25)])
    has = f"the scene has {number(chain.gravity_m_s2)}" if chain.gravity_m_s2 else "the scene has none"
    falling = partial(_falling, model, chain.gravity_m_s2)
    yield Family("gravity", partial(_gravity_words, has), falling, values, chain.gravity_m_s2 / 9.81)
    unit = _largest(case)
    if chain.beads:
        own_N = chain.precompression_N
        pressed = partial(_pressed, model, chain.beads - 1, own_N, unit)
        yield Family("precompression", partial(_pressed_words, own_N, unit), pressed, BOTH_SIGNS, own_N / unit, SMALL)
    if chain.bodies > 1:
        pushed = partial(_push, model, list(range(chain.bodies)), unit)
        yield Family("force on all", partial(_pushed, "every body", unit), pushed, BOTH_SIGNS, size=SMALL)


def _starts(case: Case, model: Model) -> Iterator[Family]:
    chain = case.chain
    if model.velocity_m_s[-1] and case.scene.striker is not None:
        speed = -float(model.velocity_m_s[-1])
        yield by_factor("striker speed", partial(_speed_words, speed), partial(_faster, model))
    if (chain.overlap_m > 0).any():
        yield by_factor("placing", _placing_words, partial(_deeper, model))
    if chain.wall and chain.beads:
        unit = _deepest(case, 0)
        yield Family(
            "place of wall", partial(_wall_placed, unit), partial(_shifted, model, 0, unit), BOTH_SIGNS, size=SMALL
        )
    if case.scene.striker is not None and chain.beads:
        unit = _deepest(case, chain.bodies - 1)
        yield Family(
            "place of striker",
            partial(_gap, unit),
            partial(_shifted, model, chain.bodies - 1, unit),
            BOTH_SIGNS,
            size=SMALL,
        )


def _numerics(case: Case, model: Model) -> Iterator[Family]:
    weak = np.log(np.logspace(-6, -0.02, 30))
    yield by_factor("local damping", _local_words, partial(_locally, model), weak)
    damping = np.log(np.logspace(-6, 0.5, 30))
    own_ratio = case.chain.damping_ratio
    has = f"the scene has {number(own_ratio)}" if own_ratio else "the scene's are elastic"
    laws = [(True, ", which may pull"), (False, ", without attraction")]
    for pulls, remark in laws[::-1] if own_ratio else laws:  # the plainest first: the law of the scene, if it has one
        words = partial(_damping_words, remark, has)
        yield by_factor("damping", words, partial(_damped, model, slice(0, model.bodies), pulls), damping)
        if case.chain.wall and not case.chain.damping_ratio:
            words = partial(_damping_words, f" at the wall alone{remark}", has)
            yield by_factor("damping", words, partial(_damped, model, 0, pulls), damping)
    yield by_factor("time step", partial(_step_words, model.time_step_s, ""), partial(_slower, model))
    if model.assumed_m_s2.any():
        words = partial(_step_words, model.time_step_s, BEHIND_BY_THE_SCENES)
        yield by_factor("time step", words, partial(_slower_from_behind, model))


def _stiffer(model: Model, places: slice | int | list[int], factor: float) -> Model:
    return replace(model, stiffness=scaled_at(model.stiffness, places, factor))


def _heavier(model: Model, places: list[int], gravity_m_s2: float, factor: float) -> Model:
    return weighing(model, scaled_at(model.mass_kg, places, factor), gravity_m_s2)


def _of_density(model: Model, radius_m: Array, gravity_m_s2: float, relative: float) -> Model:
    mass = 1000 * relative * 4 / 3 * pi * radius_m**3
    return weighing(model, np.where(mass > 0, mass, model.mass_kg), gravity_m_s2)


def _of_modulus(
    case: Case, model: Model, bodies: list[Material | None], wall: Material | None, name: str, factor: float
) -> Model:
    original = case.scene.materials[name]
    other = original.model_copy(update={"youngs_modulus": original.youngs_modulus * factor})
    changed = [other if case.chain.materials[j] == name else bodies[j] for j in range(case.chain.bodies)]
    under = other if case.chain.wall == name else wall
    return replace(model, stiffness=stiffness_of(case, changed, under))


def _of_radius(case: Case, model: Model, count: int, solid: bool, factor: float) -> Model:
    """The lowest bodies of another radius at the same heights, so that all overlaps change."""
    chain = case.chain
    grown = scaled_at(chain.radius_m, slice(0, count), factor)
    more = (factor - 1) * np.where(np.isfinite(chain.radius_m), chain.radius_m, 0.0)
    more[count:] = 0.0
    deeper = more + np.append(0.0, more[:-1])
    overlap = chain.overlap_m + np.where(chain.stiffness > 0, deeper, 0.0)
    stiffness = stiffness_of(case, *own(case), grown)
    # heights stay: what an overlap gains is no move of the body
    other = replace(model, stiffness=stiffness, overlap_m=overlap, resting_m=overlap, reach_m=model.reach_m + deeper)
    mass = scaled_at(model.mass_kg, slice(0, count), factor**3)
    return weighing(other, mass, chain.gravity_m_s2) if solid else other


def _falling(model: Model, own_m_s2: float, t: float) -> Model:
    return replace(model, load_N=model.load_N + (own_m_s2 - 9.81 * t) * model.mass_kg)


def _pressed(model: Model, place: int, own_N: float, unit_N: float, t: float) -> Model:
    load = model.load_N.copy()
    load[place] += own_N - unit_N * t
    return replace(model, load_N=load)


def _push(model: Model, places: list[int], unit_N: float, t: float) -> Model:
    load = model.load_N.copy()
    load[places] += unit_N * t
    return replace(model, load_N=load)


def _faster(model: Model, factor: float) -> Model:
    return replace(model, velocity_m_s=scaled_at(model.velocity_m_s, -1, factor))


def _deeper(model: Model, factor: float) -> Model:
    overlap = model.overlap_m
    return replace(model, overlap_m=np.where(overlap > 0, factor * overlap, overlap))


def _shifted(model: Model, place: int, unit_m: float, t: float) -> Model:
    overlap = model.overlap_m.copy()
    overlap[place] += unit_m * t
    return replace(model, overlap_m=overlap)


def _slower(model: Model, factor: float) -> Model:
    return replace(model, time_step_s=factor * model.time_step_s)


def _slower_from_behind(model: Model, factor: float) -> Model:
    return behind_by(_slower(model, factor), model.time_step_s)


def _locally(model: Model, share: float) -> Model:
    return replace(model, local_damping=min(share, 1.0))


def _damped(model: Model, places: slice | int, pulls: bool, ratio: float) -> Model:
    damping = model.damping_ratio.copy()
    damping[places] = ratio
    return replace(model, damping_ratio=damping, attracts=pulls)


def _times_as_stiff(what: str, factor: float, remark: str = "") -> str:
    return f"{what} {of_one(factor)} times as stiff{remark}"


def _wall_words(has: str, what: str, factor: float) -> str:
    half = "; 0.5^(1/2) comes of R* = R/2, which YADE takes unless told"
    known = half if abs(factor / ROOT_HALF - 1) < 1e-6 else ""
    return f"{what} {of_one(factor)} times as stiff ({has} takes 1{known})"


def _times_as_heavy(what: str, factor: float) -> str:
    return f"{what} {of_one(factor)} times as heavy"


def _weighing(what: str, mass_kg: float, factor: float) -> str:
    return f"{what} weighing {number(factor * mass_kg * 1e3)} g (the scene has {number(mass_kg * 1e3)})"


def _density_words(who: str, relative: float) -> str:
    return f"{who} weighing what spheres of {number(1000 * relative)} kg/m^3 do"


def _placed(j: int, unit_m: float, t: float) -> str:
    size = f"{number(abs(unit_m * t) * 1e6)} um too {'low' if t > 0 else 'high'}"
    return f"body {j + 1}, and those above it, {size} at time 0"


def _pushed(who: str, unit_N: float, t: float) -> str:
    return f"a force of {number(abs(unit_N * t))} N {'upwards' if t > 0 else 'downwards'} on {who}"


def _gap(unit_m: float, t: float) -> str:
    place = "above its bead" if t < 0 else "deep in its bead"
    return f"a striker {number(abs(unit_m * t) * 1e6)} um {place} at time 0"


def _wall_placed(unit_m: float, t: float) -> str:
    return f"a wall {number(abs(unit_m * t) * 1e6)} um {'higher' if t > 0 else 'lower'} than the scene's"


def _speed_words(speed_m_s: float, factor: float) -> str:
    return f"a striker at {number(factor * speed_m_s)} m/s (the scene has {number(speed_m_s)})"


def _placing_words(factor: float) -> str:
    return f"beads that start with {of_one(factor)} times their overlaps, not in equilibrium"


def _step_words(step_s: float, remark: str, factor: float) -> str:
    has = f"the scene has {number(step_s * 1e6)}"
    return f"a time step of {number(factor * step_s * 1e6)} us ({has}) at stamps of the scene's{remark}"


def _radius_words(who: str, radius_mm: float, remark: str, factor: float) -> str:
    has = f"a bead's is {number(radius_mm)} mm"
    return f"{who} {of_one(factor)} times as large in radius at the same places{remark} ({has})"


def _gravity_words(has: str, t: float) -> str:
    return f"gravity of {number(9.81 * t)} m/s^2 ({has})"


def _pressed_words(own_N: float, unit_N: float, t: float) -> str:
    return f"a precompression of {number(unit_N * t)} N (the scene has {number(own_N)})"


def _local_words(share: float) -> str:
    return f"non-viscous damping of {number(share)}"


def _damping_words(remark: str, has: str, ratio: float) -> str:
    words = f"contacts of damping ratio {number(ratio)}{remark} ({has}"
    coefficient = restitution_with_attraction(ratio) if ratio < sqrt(5 / 6) else 0.0
    return f"{words}; LIGGGHTS' coefficientRestitution of {number(coefficient)})" if coefficient > 0 else f"{words})"


def _largest(case: Case) -> float:
    """A force to count forces by, in N: of the order of the largest in the chain."""
    chain = case.chain
    stiffest = float(chain.stiffness.max()) or 1.0
    energy = energy_put_in(chain, float(case.sample_times_s[-1]))
    return float(stiffest * (2.5 * energy / stiffest) ** 0.6) or 1.0


def _deepest(case: Case, place: int) -> float:
    """An overlap to count places by, in m: what that force makes of a contact."""
    stiffness = float(case.chain.stiffness[place]) or float(case.chain.stiffness.max()) or 1.0
    return float((_largest(case) / stiffness) ** (2 / 3))
