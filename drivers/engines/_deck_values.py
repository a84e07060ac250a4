"""Values of decks that several codes need: elastic constants by name, tables of pairs of types, requests."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from drivers.scene.model import RIGID, Scene

RIGID_PA = 1e40  # a wall that does not yield: its share of 1/E* is below rounding


@dataclass(frozen=True)
class NamedMaterial:
    """A material under the name that a deck gives it."""

    label: str
    youngs_modulus: float
    poisson_ratio: float


def named_material(scene: Scene, name: str, label: str = "") -> NamedMaterial:
    """A material of the scene, or the rigid wall's; ``label`` left out: its own name."""
    if name == RIGID:
        return NamedMaterial(name, RIGID_PA, 0.0)
    material = scene.materials[name]
    return NamedMaterial(label or name, material.youngs_modulus, material.poisson_ratio)


def table_of_pairs(types: Sequence[str], pairs: Iterable[tuple[str, str, float]], otherwise: float) -> list[float]:
    """Symmetric table of a value for each pair of types, row by row; the last word on a pair counts."""
    table = np.full((len(types), len(types)), otherwise)
    for one, other, value in pairs:
        i, j = types.index(one), types.index(other)
        table[i, j] = table[j, i] = value
    return [float(value) for value in table.ravel()]


def request_by_include(folder: str, word: str) -> str:
    """Commands of LAMMPS and its descendants that run ``chain.in`` of a folder, forget it, and print the word."""
    deck = f"shell cd {folder}\ninclude chain.in\nclear\nshell cd ..\n" if folder else ""
    return f'{deck}print "{word}"\n'
