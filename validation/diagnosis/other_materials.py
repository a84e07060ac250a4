"""Stiffnesses of a chain of other materials."""

from collections.abc import Sequence
from functools import cache
from math import inf

import numpy as np

from drivers.base import paths
from drivers.base.messages import validate
from drivers.chain.case import Case
from drivers.chain.chain import Array
from drivers.chain.contact_law import hertz_stiffness
from drivers.scene.model import RIGID, Material
from drivers.scene.read_scene import read_toml

# What FrictMat takes unless told (YADE 2023.02a; ``FrictMat()`` prints them), for forgotten elastic constants
YADE_YOUNGS_MODULUS = 1e9  # Pa
YADE_POISSON_RATIO = 0.25


@cache
def library() -> dict[str, Material]:
    """``inputs/materials.toml``."""
    return {
        name: validate(Material, table, f"{paths.shown(paths.MATERIALS)}: {name}")
        for name, table in read_toml(paths.MATERIALS).items()
    }


def known(case: Case) -> dict[str, Material | None]:
    """Materials by name: the scene's before those of the library, and the one that does not yield."""
    return {**library(), **case.scene.materials, RIGID: None}


def stiffness_of(
    case: Case, bodies: Sequence[Material | None], wall: Material | None, radius_m: Array | None = None
) -> Array:
    """Hertz stiffness of the contact under each body, shape (bodies,), for materials (and radii) from the lowest up."""
    chain = case.chain
    radius = [float(r) for r in (chain.radius_m if radius_m is None else radius_m)]
    stiffness = np.zeros(chain.bodies)
    for j in range(chain.bodies):
        if chain.stiffness[j] == 0:
            continue
        below, reach = (wall, inf) if j == 0 else (bodies[j - 1], radius[j - 1])
        stiffness[j] = hertz_stiffness(bodies[j], radius[j], below, reach)
    return stiffness


def own(case: Case) -> tuple[list[Material | None], Material | None]:
    """The materials of the bodies, and the wall's."""
    names, chain = known(case), case.chain
    return [names[name] for name in chain.materials], names[chain.wall] if chain.wall else None


def forgotten(material: Material | None, *, modulus: bool, ratio: bool) -> Material | None:
    """A material without its Young's modulus, its Poisson's ratio or both, as YADE completes it.

    One that does not yield has a modulus that is past all others, and a ratio of 0: without the latter it is the same.
    """
    if material is None and not modulus:
        return None
    youngs_modulus = YADE_YOUNGS_MODULUS if modulus or material is None else material.youngs_modulus
    own_ratio = material.poisson_ratio if material else 0.0
    poisson_ratio = YADE_POISSON_RATIO if ratio else own_ratio
    return Material.model_construct(youngs_modulus=youngs_modulus, poisson_ratio=poisson_ratio)
