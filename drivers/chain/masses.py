"""Masses of beads: given, or computed from diameter and density, with or without scatter."""

from math import pi

import numpy as np

from drivers.scene.model import Scene
from validation.reference.hertz_chain import Array


def bead_masses(scene: Scene, materials: list[str], diameters: Array) -> Array:
    """Masses of all beads in kg, shape (beads,).

    A mass given for one bead is used without scatter. Other beads have the mass of the chain, or, with a diameter or
    material of their own, the mass computed from the density; the scatter is added to these masses.
    """
    table = scene.chain
    given = {sensor.from_wall: sensor.mass for sensor in table.sensors if sensor.mass is not None}
    given |= {bead.from_wall: bead.mass for bead in table.bead if bead.mass is not None}
    masses = np.full(table.count, bead_mass(scene) if table.count else 0.0)
    for bead in table.bead:
        by_density = bead.material is not None or bead.diameter is not None
        if by_density and bead.from_wall not in given:
            place = bead.from_wall - 1
            masses[place] = sphere_mass(scene, materials[place], diameters[place])
    if table.mass_scatter:  # drawn for all beads, so that a mass given for one bead does not change other masses
        masses += np.random.default_rng(scene.seed).normal(0.0, table.mass_scatter, table.count)
    return np.array([given.get(place, mass) for place, mass in enumerate(masses.tolist(), start=1)])


def bead_mass(scene: Scene) -> float:
    """Mass of an ordinary bead in kg, given or computed from the density."""
    return scene.chain.mass or sphere_mass(scene, scene.chain.material, scene.chain.diameter)


def sphere_mass(scene: Scene, material: str, diameter_m: float) -> float:
    """Mass of a sphere from the density of its material, in kg."""
    density = scene.materials[material].density
    assert density is not None  # read_scene checks it
    return density * pi / 6 * diameter_m**3
