"""Elastic constants as the decks of LIGGGHTS and YADE name them."""

from dataclasses import dataclass

from drivers.scene.model import RIGID, Scene

RIGID_PA = 1e40  # a wall that does not yield: its share of 1/E* is below rounding


@dataclass(frozen=True)
class NamedMaterial:
    """A material under the name that a deck gives it."""

    label: str
    youngs_modulus: float
    poisson_ratio: float


def named_material(scene: Scene, name: str, label: str | None = None) -> NamedMaterial:
    """A material of the scene, or the rigid wall's; ``label`` left out: its own name."""
    if name == RIGID:
        return NamedMaterial(name, RIGID_PA, 0.0)
    material = scene.materials[name]
    return NamedMaterial(label or name, material.youngs_modulus, material.poisson_ratio)
