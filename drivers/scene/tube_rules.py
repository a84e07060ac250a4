"""Rules of three-dimensional scenes: beads have to fit their tube, and what does not must stay above it."""

from collections.abc import Iterator
from math import acos, ceil, pi, sqrt

import numpy as np

from drivers.base.messages import Complaint
from drivers.chain.chain import Chain
from drivers.scene.model import Scene

ROUNDED = 1e-6  # of the play, the difference of two diameters


def tube_contradictions(scene: Scene) -> Iterator[Complaint]:
    """What of a three-dimensional scene does not go together."""
    chain, tube, offset = scene.chain, scene.tube, scene.chain.lateral_offset
    if not scene.three_dimensional:
        return
    if scene.run.accuracy is not None:
        allowed = "a run.time_step: the exact motion is known of straight chains only"
        yield "run.accuracy", "an accuracy for beads that move sideways", allowed
    if tube is None:
        if offset is not None:
            yield "chain.lateral_offset", f"{offset:g} m without a tube", "a [tube] to hold the beads"
        return
    if chain.count == 0:
        yield "chain.count", "0 with beads to move sideways", "1 or more"
        return
    widest = max([chain.diameter, *(bead.diameter for bead in chain.bead if bead.diameter)])
    play = (tube.inner_diameter - widest) / 2
    if play <= 0:
        yield "tube.inner_diameter", f"{tube.inner_diameter:g} m", f"more than the beads' {widest:g} m"
    elif offset is not None and offset > play * (1 + ROUNDED):
        yield "chain.lateral_offset", f"{offset:g} m", f"at most the play of {play:.4g} m"
    elif tube.sides is not None and tube.sides < (least := _least_sides(tube.inner_diameter / 2, play)):
        yield (
            "tube.sides",
            str(tube.sides),
            f"at least {least}: the edges of fewer lie off the bore by more than its play",
        )


def _least_sides(radius_m: float, play_m: float) -> int:
    """Sides whose edges are off the bore by its play at most: ``R (1 / cos(pi / n) - 1) <= play``."""
    return ceil(pi / acos(radius_m / (radius_m + play_m)))


def tube_impossible(scene: Scene, chain: Chain) -> Iterator[Complaint]:
    """What shows only in the chain as built: beads that pass each other, a striker that would enter the tube."""
    tube = scene.tube
    if not scene.three_dimensional or tube is None:
        return
    yield from _passing(tube.inner_diameter / 2, chain)
    height, radius = chain.height_m, chain.radius_m
    if tube.top is not None and height[chain.beads - 1] > tube.top:
        yield "tube.top", f"{tube.top:g} m", f"at least {height[chain.beads - 1]:.4g} m, the height of the top bead"
    if scene.striker is not None and radius[-1] >= tube.inner_diameter / 2:
        # where the striker's surface stands above the rim of the bore
        sphere = np.isfinite(radius[-1])
        rim = height[-1] - (sqrt(radius[-1] ** 2 - tube.inner_diameter**2 / 4) if sphere else 0.0)
        if tube.top is None or tube.top > rim:
            found = "nothing" if tube.top is None else f"{tube.top:g} m"
            yield "tube.top", found, f"at most {rim:.4g} m: the striker is wider than the bore and stays above it"


def _passing(bore_radius_m: float, chain: Chain) -> Iterator[Complaint]:
    """Beads so loose that they would touch the next but one."""
    radius = chain.radius_m[chain.radius_m < bore_radius_m]
    play = bore_radius_m - radius
    reach, across = radius[1:] + radius[:-1], play[1:] + play[:-1]
    apart = np.sqrt(np.maximum(reach**2 - across**2, 0.0))
    if (apart[1:] + apart[:-1] <= radius[2:] + radius[:-2]).any() or (across >= reach).any():
        allowed = "a tube so narrow that beads stay in line, each between its neighbours"
        yield "tube.inner_diameter", f"{2 * bore_radius_m:g} m", allowed
