"""What all of YADE's decks are rendered with, straight or not."""

from typing import Any

import numpy as np

from drivers.chain.case import Case
from drivers.chain.chain import Array
from drivers.engines._materials import named_material


def staggered_velocities(case: Case) -> Array:
    """Axial velocities half a step before time 0, where YADE's leapfrog keeps them. Shape (bodies,)."""
    return np.asarray(case.chain.velocity_m_s - 0.5 * case.scene.time_step_s * case.chain.acceleration_m_s2)


def common_values(case: Case) -> dict[str, Any]:
    """Timing, loads, materials, wall, damping, and which contacts are with a plane."""
    scene, chain = case.scene, case.chain
    labels = [*chain.materials, *([chain.wall] if chain.wall else [])]
    first = 0 if chain.wall else 1
    flat = bool(np.isinf(chain.radius_m[-1]))
    return {
        "summary": case.summary,
        "time_step": scene.time_step_s,
        "every": scene.steps_per_sample,
        "samples": scene.samples,
        "gravity": chain.gravity_m_s2 if case.models("gravity") else None,
        "precompression": chain.precompression_N if case.models("precompression") else None,
        "top": chain.beads - 1,
        "materials": [named_material(scene, name) for name in dict.fromkeys(labels)],
        "wall": {"height": chain.wall_height_m, "material": chain.wall} if case.models("wall") else None,
        "planes": ([0] if chain.wall else []) + ([chain.bodies - 1 - first] if flat else []),
        "damping_ratio": chain.damping_ratio,
    }
