"""Rules that only the built chain can be judged by: masses, loads, and whether beads fit their tube."""

from collections.abc import Iterator
from math import sqrt

import numpy as np

from drivers.base.errors import InputProblem
from drivers.chain.chain import Chain
from drivers.scene.model import Scene

MAX_OVERLAP = 0.5  # of the radius, at rest: far beyond Hertz, and close to where engines lose a contact


def impossible(scene: Scene, chain: Chain) -> Iterator[InputProblem]:
    """What shows only in the chain as built: masses drawn below zero, beads pressed into each other."""
    if (chain.mass_kg <= 0).any():
        place = int(np.argmin(chain.mass_kg)) + 1
        yield "chain.mass_scatter", f"{scene.chain.mass_scatter:g} kg, which leaves bead {place} no mass", "less"
    deepest = chain.overlap_m / chain.smaller_radius_m
    if (deepest > MAX_OVERLAP).any():
        contact = int(np.argmax(deepest)) + 1
        key = "chain.precompression" if chain.precompression_N else "gravity"
        found = f"a load that presses {chain.overlap_m[contact - 1]:g} m deep at contact {contact}"
        yield key, found, f"overlaps of at most {MAX_OVERLAP:g} of the radius"
    yield from _tube_impossible(scene, chain)


def _tube_impossible(scene: Scene, chain: Chain) -> Iterator[InputProblem]:
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


def _passing(bore_radius_m: float, chain: Chain) -> Iterator[InputProblem]:
    """Beads so loose that they would touch the next but one."""
    radius = chain.radius_m[chain.radius_m < bore_radius_m]
    play = bore_radius_m - radius
    reach, across = radius[1:] + radius[:-1], play[1:] + play[:-1]
    apart = np.sqrt(np.maximum(reach**2 - across**2, 0.0))
    if (apart[1:] + apart[:-1] <= radius[2:] + radius[:-2]).any() or (across >= reach).any():
        allowed = "a tube so narrow that beads stay in line, each between its neighbours"
        yield "tube.inner_diameter", f"{2 * bore_radius_m:g} m", allowed
