"""Values for decks of several codes: elastic constants, tables of pairs of types."""

from collections.abc import Iterable, Sequence

import numpy as np

from drivers.scene.model import RIGID, Scene

RIGID_PA = 1e40  # modulus of a rigid wall: its part of 1/E* is below rounding


def elastic_constants(scene: Scene, name: str) -> tuple[float, float]:
    """Young's modulus in Pa and Poisson's ratio of a material of the scene, or of the rigid wall."""
    if name == RIGID:
        return RIGID_PA, 0.0
    return scene.materials[name].youngs_modulus, scene.materials[name].poisson_ratio


def table_of_pairs(types: Sequence[str], pairs: Iterable[tuple[str, str, float]], otherwise: float) -> list[float]:
    """Symmetric table with a value for each pair of types, row by row; the last value given for a pair counts."""
    table = np.full((len(types), len(types)), otherwise)
    for one, other, value in pairs:
        i, j = types.index(one), types.index(other)
        table[i, j] = table[j, i] = value
    return [float(value) for value in table.ravel()]
