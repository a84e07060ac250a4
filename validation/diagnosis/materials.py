"""Stiffnesses of a chain of other materials."""

from collections.abc import Sequence
from functools import cache
from math import inf

import numpy as np

from drivers import paths
from drivers.case import Case
from drivers.chain import Array, hertz_stiffness
from drivers.complaints import validate
from drivers.read_scene import read_toml
from drivers.scene import RIGID, Material


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
