"""``reference``: the exact motion, by adaptive steps to a tolerance; the error of every run is measured against it."""

from drivers.base.decks import Deck
from drivers.chain.case import Case
from drivers.engines import EXACT, Style, _in_repo


def render(case: Case) -> Deck:
    """Render ``chain.json``, with a tolerance in place of a time step: runs at several steps share a reference run."""
    return _in_repo.render(
        case, "adaptive", tolerance=case.reference_tolerance, sample_interval_s=case.scene.run.sample_interval
    )


ENGINE = _in_repo.in_repository_engine(
    "adaptive_kernels", scheme=EXACT, render=render, style=Style("#b3b3b3", 3.2, marker="o", size=8.0)
)
