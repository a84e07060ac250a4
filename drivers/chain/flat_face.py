"""The sphere that stands for a flat face, where an engine's damped law knows spheres only."""

from math import sqrt

import numpy as np

from drivers.chain.chain import Chain
from drivers.scene.model import Scene

LEVEL_M = 10.0  # places 0.1 mm off the axis are level to 1e-5, and heights round to 1e-15 m


def furthest_m(chain: Chain) -> float:
    """The largest coordinate that a code may hold, of which heights are rounded."""
    height = float(np.abs(chain.height_m).max())
    return height + LEVEL_M if chain.lateral is not None and np.isinf(chain.radius_m[-1]) else height


def sphere_for_face(scene: Scene, chain: Chain) -> tuple[float, float]:
    """Radius and Young's modulus, in SI units, of the sphere whose contact is that of the striker's flat face.

    With the flat contact's ``1/E* = c_bead + c_face`` the sphere's radius S and its compliance c have
    ``c_bead + c = sqrt(S / (S + R)) / E*``. c is above zero for ``S > R c_bead / (2 c_face)``; S is about twice that,
    since the heights of larger ones round more. Where beads move sideways it is a large one, which they find level.
    """
    bead, face = (scene.materials[name] for name in chain.materials[-2:])
    under = float(chain.radius_m[-2])
    radius = float(f"{under * bead.compliance / face.compliance:.1g}")
    if chain.lateral is not None:
        radius = max(radius, LEVEL_M)
    compliance = (bead.compliance + face.compliance) * sqrt(radius / (radius + under)) - bead.compliance
    return radius, (1 - face.poisson_ratio**2) / compliance
