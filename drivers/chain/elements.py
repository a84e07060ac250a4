"""Model only what a scene requires: which elements the deck gets, and why.

What provably changes nothing is left out. An exactly collinear chain has no force across its axis, so it
never touches its tube, never slips and never turns.
"""

from dataclasses import dataclass

from drivers.chain.chain import Chain, bead_mass
from drivers.chain.contact_law import restitution
from drivers.chain.lateral import Lateral
from drivers.scene.model import RIGID, Scene

# what every engine of a straight chain models, and what one of three dimensions does beside
STRAIGHT = frozenset({"gravity", "wall", "striker", "precompression", "sensor masses", "mass scatter", "damping"})
SIDEWAYS = frozenset({"lateral freedom", "tube", "friction", "rotation"})


@dataclass(frozen=True)
class Element:
    """One thing that a deck models, or does not, with the reason."""

    name: str
    modelled: bool
    reason: str


def choose_elements(scene: Scene, chain: Chain) -> tuple[Element, ...]:
    """The modelling elements of a scene, each in or out with its reason."""
    ordinary = bead_mass(scene) if scene.chain.sensors else None
    lighter = [sensor for sensor in scene.chain.sensors if sensor.mass not in (None, ordinary)]
    wall = "rigid half-space" if chain.wall == RIGID else f"half-space of {chain.wall}"
    return (
        Element("gravity", scene.gravity > 0, f"{scene.gravity:g} m/s^2" if scene.gravity else "the scene has none"),
        Element("wall", chain.wall is not None, f"{wall}, Hertz law with R* = R" if chain.wall else "a free chain"),
        Element("striker", scene.striker is not None, _striker(scene)),
        Element(
            "precompression",
            chain.precompression_N > 0,
            f"{chain.precompression_N:g} N on the top bead" if chain.precompression_N else "the scene has none",
        ),
        Element(
            "sensor masses",
            bool(lighter),
            f"{len(lighter)} sensor bead(s) of another mass than the beads" if lighter else _no_sensor_mass(scene),
        ),
        Element(
            "mass scatter",
            scene.chain.mass_scatter > 0,
            f"standard deviation {scene.chain.mass_scatter:g} kg, seed {scene.seed}"
            if scene.chain.mass_scatter
            else "the scene has none",
        ),
        *(_straight(scene) if chain.lateral is None else _sideways(scene, chain.lateral)),
        Element("damping", chain.damping_ratio > 0, _damping(chain)),
    )


def _straight(scene: Scene) -> tuple[Element, ...]:
    axis = "the chain is exactly straight: no force acts across its axis"
    return (
        Element("lateral freedom", False, f"{axis}, so no bead leaves it"),
        Element("tube", False, f"{axis}, so no bead touches the bore" if scene.tube else "the scene has none"),
        Element("friction", False, f"{axis}, so no contact slips"),
        Element("rotation", False, f"{axis}, so no bead turns"),
    )


def _sideways(scene: Scene, lateral: Lateral) -> tuple[Element, ...]:
    if scene.chain.lateral_offset is None:
        freedom = "a bead moves across the axis"
    else:
        freedom = f"beads off the axis by {scene.chain.lateral_offset:g} m, standard deviation, seed {scene.seed}"
    if lateral.bore is None:
        tube = "the scene has none"
    else:
        kind = f"a mesh of {lateral.bore.sides} sides" if lateral.bore.sides else "a true cylinder"
        tube = f"bore of {2 * lateral.bore.radius_m:g} m, {kind}"
    between, bore = lateral.friction, lateral.bore.friction if lateral.bore else 0.0
    slipping = f"coefficient {between:g} between beads and with the wall" + (f", {bore:g} in the bore" if tube else "")
    return (
        Element("lateral freedom", True, freedom),
        Element("tube", lateral.bore is not None, tube),
        Element("friction", lateral.slips, slipping if lateral.slips else "the scene has none"),
        Element("rotation", lateral.turns, _turning(lateral)),
    )


def _turning(lateral: Lateral) -> str:
    if not lateral.slips:
        return "without friction no bead turns"
    return "friction turns beads" if lateral.turns else "the scene forbids it"


def _striker(scene: Scene) -> str:
    striker = scene.striker
    if striker is None:
        return "nothing strikes"
    shape = "flat face" if striker.shape == "flat" else "sphere"
    return f"{shape} of {striker.material} at {striker.speed:g} m/s"


def _damping(chain: Chain) -> str:
    if not chain.damping_ratio:
        return "restitution 1: contacts are elastic"
    ratio = chain.damping_ratio
    return f"impacts have a restitution of {restitution(ratio):.6g}, by a damping ratio of {ratio:.6g}"


def _no_sensor_mass(scene: Scene) -> str:
    return "sensor beads weigh what the others do" if scene.chain.sensors else "no bead carries a sensor"
