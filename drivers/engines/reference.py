"""``reference``: adaptive and exact to its tolerance: what a run pays for its time step is measured against it."""

from drivers.base.decks import Deck
from drivers.chain.case import Case
from drivers.chain.elements import STRAIGHT
from drivers.engines import EXACT, TOTAL, _in_repo
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

SCHEME = EXACT
SHEAR = TOTAL  # of no use: it models straight chains only
MODELS = STRAIGHT


def render(case: Case) -> Deck:
    """``chain.json``; without a time step, so that every step is judged by the same run."""
    return _in_repo.render(case, "adaptive", sample_interval_s=case.scene.run.sample_interval)
