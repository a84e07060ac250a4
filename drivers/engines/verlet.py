"""``verlet``: velocity Verlet at the time step of the scene: the scheme of both other engines.

In three dimensions its friction keeps the shear displacement, as LIGGGHTS does: of the two codes' laws it is the one
whose force is Mindlin's without slip at the present radius of the contact.
"""

from drivers.base.decks import Deck
from drivers.chain.case import Case
from drivers.chain.elements import SIDEWAYS, STRAIGHT
from drivers.engines import IN_OVERLAPS, TOTAL, _in_repo
from drivers.engines._in_repo import (
    HOW_TO_GET,
    IN_REPOSITORY,
    LOST,
    SERVER,
    VARIABLES,
    complaint,
    find,
    loop_seconds,
    read,
    refusal,
    request,
    seen,
    version,
)

__all__ = [
    "HOW_TO_GET",
    "IN_REPOSITORY",
    "LOST",
    "MODELS",
    "SCHEME",
    "SERVER",
    "SHEAR",
    "VARIABLES",
    "complaint",
    "find",
    "loop_seconds",
    "read",
    "refusal",
    "render",
    "request",
    "seen",
    "version",
]

SCHEME = IN_OVERLAPS
SHEAR = TOTAL
MODELS = STRAIGHT | SIDEWAYS


def render(case: Case) -> Deck:
    """``chain.json``."""
    scene = case.scene
    return _in_repo.render(case, "verlet", time_step_s=scene.time_step_s, steps_per_sample=scene.steps_per_sample)
