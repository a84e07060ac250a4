"""Modelling elements: the parts of a scene that decks model or leave out, each with the reason.

Elements without any effect are left out. An exactly straight chain has no force across its axis, so its beads never
touch the tube, slip or turn.
"""

from dataclasses import dataclass

import numpy as np

from drivers.chain.chain import Chain
from drivers.chain.drives import drive_words
from drivers.chain.lateral import Lateral
from drivers.chain.masses import ordinary_beads
from drivers.laws.viscoelastic import Viscoelastic
from drivers.scene.model import RIGID, Scene

# elements of straight chains, and further elements of three-dimensional chains
STRAIGHT = frozenset(
    {"gravity", "wall", "striker", "precompression", "sensor masses", "mass scatter", "damping", "drive"}
)
SIDEWAYS = frozenset({"lateral freedom", "tube", "friction", "rotation"})
Row = tuple[str, object, str | None, str]  # name, value (false: not modelled), reason if modelled, reason if not
NONE = "the scene has none"


@dataclass(frozen=True)
class ModellingElement:
    """Modelling element, modelled or left out, with the reason."""

    name: str
    modelled: bool
    reason: str


def choose_elements(scene: Scene, chain: Chain) -> tuple[ModellingElement, ...]:
    """Modelling elements of a scene, each modelled or left out, with the reason."""
    striker, scatter = scene.striker, scene.chain.mass_scatter
    ordinary = ordinary_beads(scene).mass_kg if scene.chain.sensors else np.zeros(0)
    unlike = len(
        [sensor for sensor in scene.chain.sensors if sensor.mass not in (None, ordinary[sensor.from_wall - 1])]
    )
    gravity, angle = f"{scene.axial_gravity:g} m/s^2", scene.chain.angle
    gravity += f" along the axis, which leans by {angle:g} deg" if angle else ""
    across = "horizontal: gravity acts across the axis, along which alone the beads of a straight chain move"
    wall = "rigid half-space" if chain.wall == RIGID else f"half-space of {chain.wall}"
    shape = "flat face" if striker and striker.shape == "flat" else "sphere"
    alike = "sensor beads weigh as much as the others" if scene.chain.sensors else "no bead carries a sensor"
    damped = chain.law.description
    if isinstance(chain.law, Viscoelastic):
        damped += f", by a damping ratio of {chain.law.damping_ratio:.6g}"
    table = [
        ("gravity", scene.axial_gravity, gravity, across if scene.gravity else NONE),
        ("wall", chain.wall, f"{wall}, Hertz law with R* = R", "a free chain"),
        ("striker", striker, striker and f"{shape} of {striker.material} at {striker.speed:g} m/s", NONE),
        ("precompression", chain.precompression_N, f"{chain.precompression_N:g} N on the top bead", NONE),
        ("sensor masses", unlike, f"{unlike} of {len(scene.chain.sensors)} sensor beads are of another mass", alike),
        ("mass scatter", scatter, f"standard deviation {scatter:g} kg, seed {scene.seed}", NONE),
        *(_straight(scene) if chain.lateral is None else _sideways(scene, chain.lateral)),
        ("damping", chain.damped, damped, "restitution 1: contacts are elastic"),
        ("drive", chain.drive, drive_words(scene), NONE),
    ]
    return tuple(
        ModellingElement(name, bool(there), str(why if there else why_not)) for name, there, why, why_not in table
    )


def _straight(scene: Scene) -> list[Row]:
    axis = "the chain is exactly straight: no force acts across its axis"
    return [
        ("lateral freedom", False, "", f"{axis}, so no bead leaves it"),
        ("tube", False, "", f"{axis}, so no bead touches the bore" if scene.tube else NONE),
        ("friction", False, "", f"{axis}, so no contact slips"),
        ("rotation", False, "", f"{axis}, so no bead turns"),
    ]


def _sideways(scene: Scene, lateral: Lateral) -> list[Row]:
    freedom, tube, bore = "a bead moves across the axis", "", lateral.bore
    if scene.chain.lateral_offset is not None:
        freedom = f"beads off the axis by {scene.chain.lateral_offset:g} m, standard deviation, seed {scene.seed}"
    if bore is not None:
        tube = f"bore of {2 * bore.radius_m:g} m, a true cylinder"
    slipping = f"coefficient {lateral.friction:g} between beads and with the wall"
    slipping += f", {bore.friction if bore else 0.0:g} in the bore"
    still = "rotation = false in the scene" if lateral.slips else "without friction no bead turns"
    return [
        ("lateral freedom", True, freedom, ""),
        ("tube", bore, tube, NONE),
        ("friction", lateral.slips, slipping, NONE),
        ("rotation", lateral.turns, "friction turns beads", still),
    ]
