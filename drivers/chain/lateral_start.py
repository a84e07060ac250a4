"""Where a three-dimensional chain starts.

Beads that rest on the wall lean from side to side, where gravity or a precompression presses them down: they start in
the rest that they fall into without friction from their seeded places. All others start at those, just touching.
"""

from dataclasses import replace

import numpy as np

from drivers.base.errors import InputError
from drivers.chain.chain import AT_REST, Array, Chain, stiffness_by
from drivers.chain.contact_law import conformity, hertz_stiffness, mindlin_stiffness, side_share
from drivers.chain.lateral import Bore, Lateral
from drivers.chain.packing import Column, find_rest
from drivers.scene.model import Scene

TUBE_ABOVE = 8.0  # bore radii above the highest body, where no tube.top is given
OFFSET_STREAM = 1  # stream of random numbers beside that of the masses


def with_lateral(scene: Scene, chain: Chain) -> Chain:
    """The chain of a three-dimensional scene at its start; of a straight one, as it is.

    Raises:
        InputError: its beads do not come to rest.
    """
    if not scene.three_dimensional:
        return chain
    velocity = np.zeros((chain.bodies, 2))
    for bead in scene.chain.bead:
        velocity[bead.from_wall - 1, 0] = bead.lateral_velocity or 0.0
    lateral = Lateral(
        offset_m=_seeded_offsets(scene, chain),
        velocity_m_s=velocity,
        shear_stiffness=stiffness_by(mindlin_stiffness, scene, chain.materials, chain.radius_m),
        friction=scene.contact.friction,
        turns=scene.contact.rotation and max(scene.contact.friction, scene.tube.friction if scene.tube else 0.0) > 0,
        bore=_bore(scene, chain),
    )
    started = replace(chain, lateral=lateral)
    resting = _resting(chain)
    if lateral.bore is None or not resting or not lateral.offset_m[:resting].any():
        return started
    return _packed(scene, started, lateral.bore, resting)


def _seeded_offsets(scene: Scene, chain: Chain) -> Array:
    """Places off the axis, drawn from a normal distribution and kept within the play. Shape (bodies, 2)."""
    tube, spread = scene.tube, scene.chain.lateral_offset
    if tube is None or not spread:
        return np.zeros((chain.bodies, 2))
    offset = np.random.default_rng([scene.seed, OFFSET_STREAM]).normal(0.0, spread, (chain.bodies, 2))
    play = np.maximum(tube.inner_diameter / 2 - chain.radius_m, 0.0)  # what is wider stands above the tube, on the axis
    distance = np.maximum(np.hypot(offset[:, 0], offset[:, 1]), 1e-300)
    return np.asarray(offset * np.minimum(1.0, play / distance)[:, np.newaxis])


def _bore(scene: Scene, chain: Chain) -> Bore | None:
    tube = scene.tube
    if tube is None:
        return None
    radius = tube.inner_diameter / 2
    stiffness, shear = np.zeros(chain.bodies), np.zeros(chain.bodies)
    for j in range(chain.bodies):
        own, material = chain.radius_m[j], scene.materials[chain.materials[j]]
        if own < radius and (tube.top is None or chain.height_m[j] <= tube.top):
            stiffer = conformity(own, radius) * (side_share(tube.sides) if tube.sides else 1.0)
            stiffness[j] = stiffer * hertz_stiffness(scene.materials[tube.material], np.inf, material, own)
            shear[j] = stiffer * mindlin_stiffness(scene.materials[tube.material], np.inf, material, own)
    top = float(chain.height_m[-1]) + TUBE_ABOVE * radius if tube.top is None else tube.top
    return Bore(radius, stiffness, shear, tube.friction, chain.wall_height_m, top, tube.sides)


def _resting(chain: Chain) -> int:
    """How many beads, from the wall up, are pressed onto it."""
    pressed = chain.overlap_m[: chain.beads] > 0
    return int(pressed.argmin()) if not pressed.all() else chain.beads


def _packed(scene: Scene, chain: Chain, bore: Bore, resting: int) -> Chain:
    """The chain with its lowest beads at rest."""
    assert chain.lateral is not None
    touching = replace(chain, overlap_m=np.minimum(chain.overlap_m, 0.0))
    place = np.column_stack([chain.lateral.offset_m, touching.height_m - chain.wall_height_m])[:resting]
    rest = find_rest(
        Column(
            radius_m=chain.radius_m[:resting],
            load_N=chain.load_N[:resting],
            stiffness=chain.stiffness[:resting],
            bore_radius_m=bore.radius_m,
            bore_stiffness=bore.stiffness[:resting],
            sides=bore.sides,
        ),
        place,
    )
    if not rest.at_rest:
        found = f"beads that do not come to rest: {rest.residual_N:.2g} N are left on bead {rest.bead}"
        allowed = f"at most {AT_REST:g} of the load: fewer beads, another seed or a wider tube"
        raise InputError(scene.file, "chain.lateral_offset", found, allowed)
    offset, overlap = chain.lateral.offset_m.copy(), chain.overlap_m.copy()
    offset[:resting] = rest.place_m[:, :2]
    along = np.diff(rest.place_m, axis=0)
    radius = chain.radius_m[:resting]
    overlap[0] = radius[0] - rest.place_m[0, 2]
    overlap[1:resting] = radius[1:] + radius[:-1] - np.sqrt((along**2).sum(axis=1))
    return replace(chain, overlap_m=overlap, lateral=replace(chain.lateral, offset_m=offset))
