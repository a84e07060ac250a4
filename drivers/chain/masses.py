"""Material, diameter and mass of each bead; masses are given or computed from the density, with or without scatter."""

from dataclasses import dataclass
from math import pi

import numpy as np

from drivers.scene.model import Member, Scene
from validation.reference.hertz_chain import Array


@dataclass(frozen=True)
class Beads:
    """Material, diameter and mass of each bead; arrays of shape (beads,)."""

    materials: list[str]
    diameter_m: Array
    mass_kg: Array


def ordinary_beads(scene: Scene) -> Beads:
    """Beads by the keys of the chain, its pattern and its taper, without ``[[chain.bead]]``, sensors and scatter."""
    table, members = scene.chain, scene.chain.members
    places, taper = np.arange(table.count) % len(members), table.taper_at(np.arange(1.0, table.count + 1))
    materials = [member.material or table.material for member in members]
    diameters = [member.diameter or table.diameter for member in members]
    masses = [bead_mass(scene, member) for member in members] if table.count else [0.0]
    return Beads(
        [materials[place] for place in places.tolist()],
        np.array(diameters)[places] * taper,
        np.array(masses)[places] * taper**3,
    )


def beads_of(scene: Scene) -> Beads:
    """All beads of a scene.

    A mass given for one bead is used without scatter. Other beads have the mass of the chain or of their member in the
    pattern or, with a diameter or material of their own, the mass computed from the density; the scatter is added to
    these masses.
    """
    table, beads = scene.chain, ordinary_beads(scene)
    given = {sensor.from_wall: sensor.mass for sensor in table.sensors if sensor.mass is not None}
    given |= {bead.from_wall: bead.mass for bead in table.bead if bead.mass is not None}
    materials, diameters, masses = beads.materials, beads.diameter_m, beads.mass_kg
    for bead in table.bead:
        place = bead.from_wall - 1
        materials[place] = bead.material or materials[place]
        diameters[place] = bead.diameter or diameters[place]
        if (bead.material is not None or bead.diameter is not None) and bead.from_wall not in given:
            masses[place] = sphere_mass(scene, materials[place], diameters[place])
    if table.mass_scatter:  # drawn for all beads, so that a mass given for one bead does not change other masses
        masses = masses + np.random.default_rng(scene.seed).normal(0.0, table.mass_scatter, table.count)
    for from_wall, mass in given.items():
        masses[from_wall - 1] = mass
    return Beads(materials, diameters, masses)


def bead_mass(scene: Scene, member: Member) -> float:
    """Mass of a member of the pattern without taper, in kg."""
    table = scene.chain
    given = member.mass or (table.mass if table.is_like(member) else None)
    return given or sphere_mass(scene, member.material or table.material, member.diameter or table.diameter)


def sphere_mass(scene: Scene, material: str, diameter_m: float) -> float:
    """Mass of a sphere from the density of its material, in kg."""
    density = scene.materials[material].density
    assert density is not None  # read_scene checks it
    return density * pi / 6 * diameter_m**3
