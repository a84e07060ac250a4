"""LIGGGHTS: deck, refusals."""

from math import exp, log, pi, sqrt
from typing import Any

import numpy as np

from drivers.base.errors import InputProblem
from drivers.chain.case import SIDEWAYS, STRAIGHT, Case
from drivers.chain.chain import Array, sphere_for_face
from drivers.engines._lammps_family import by_mass, coefficients_of, labels_of, member, refusal_by_mass, table_of_pairs
from drivers.laws import KUWABARA_KONO, VISCOELASTIC, ZETA_1, restitution_of

# with fewer bodies, checking all pairs costs no more than bins of the whole space, which grows in a blow-up
MAX_IN_PAIRS = 2000
# damping ratio of coefficientRestitution 0.05, which has to be larger
MAX_RATIO = ZETA_1 / sqrt(1 + (pi / log(0.05)) ** 2)
TUBE = " tube"  # the type of the bore: no material's name begins with a space


def _radii(case: Case) -> Array:
    """Radii of the atoms; a flat face has the radius of the bead below, or of ``sphere_for_face``."""
    chain = case.chain
    if not np.isinf(chain.radius_m[-1]):
        return chain.radius_m
    face = chain.radius_m[-2] if _by_springs(case) else sphere_for_face(case.scene, case.chain)[0]
    return np.where(np.isinf(chain.radius_m), face, chain.radius_m)


def _by_springs(case: Case) -> bool:
    """True if contacts get their stiffness by pairs of types: a flat striker, or a law by mass, in a straight chain."""
    chain = case.chain
    flat = bool(np.isinf(chain.radius_m[-1])) and not chain.damped
    return (flat or by_mass(chain)) and chain.straight


def _refusal(case: Case) -> InputProblem | None:
    """Refuse strong damping, and too many masses for a law whose coefficient depends on them."""
    law = case.chain.law
    if law.name == VISCOELASTIC and law.value >= MAX_RATIO:
        least = f"above {restitution_of(MAX_RATIO):.4g}, which is a damping_ratio below {MAX_RATIO:.4g}"
        return "contact", f"a restitution of {restitution_of(law.value):g}", least
    return refusal_by_mass(case)


def _with_attraction(damping_ratio: float) -> float:
    """Restitution ``e' = exp(-pi zeta / sqrt(1 - zeta^2))`` of the viscoelastic law with attractive forces.

    LIGGGHTS takes e' with and without ``limitForce``: ``zeta = |ln e'| / sqrt(ln(e')^2 + pi^2)``.
    """
    zeta = damping_ratio / ZETA_1
    return exp(-pi * zeta / sqrt((1 - zeta) * (1 + zeta)))


def values(case: Case, radius_m: Array) -> dict[str, Any]:
    """Values of the template: types with their constants, contacts of each pair of types."""
    scene, chain, labels = case.scene, case.chain, labels_of(case.chain)
    flat, springs = bool(np.isinf(chain.radius_m[-1])), _by_springs(case)
    materials = case.materials_by(labels)
    if scene.tube and chain.bore_m:
        materials[TUBE] = scene.materials[scene.tube.material]
    types = list(materials)
    moduli = [material.youngs_modulus for material in materials.values()]
    if flat and not springs:
        moduli[types.index(labels[-1])] = sphere_for_face(scene, chain)[1]
    below = [chain.wall, *labels[:-1]]
    kn, gn = coefficients_of(chain, radius_m)
    friction = np.full((len(types), len(types)), chain.friction)
    by_bore = {}
    if chain.bore_m:
        beside = [TUBE if stiffness else None for stiffness in chain.bore_stiffness]
        sheared = chain.bore_shear * (chain.bore_friction > 0)
        for name, stiffness in (("bore_kn", chain.bore_stiffness), ("bore_kt", sheared)):
            by_bore[name] = table_of_pairs(types, beside, labels, stiffness / np.sqrt(chain.radius_m), 0.0)
        friction[-1] = friction[:, -1] = chain.bore_friction
    return by_bore | {
        "types": types,
        "binsize": 100 * radius_m.max() if chain.straight and chain.bodies > MAX_IN_PAIRS else None,
        "moduli": moduli,
        "ratios": [material.poisson_ratio for material in materials.values()],
        "springs": springs,
        "restitution": _with_attraction(chain.law.value) if chain.law.name == VISCOELASTIC else 1.0,
        "contact_kn": table_of_pairs(types, below, labels, kn, max(kn)),
        "contact_gn": table_of_pairs(types, below, labels, gn, 0.0),
        "friction": friction,
        "face_radius": radius_m[-1] if flat and not springs else None,
    }


ENGINE = member(
    "LIGGGHTS",
    "liggghts",
    r"LIGGGHTS \(Version",
    "f_force_wall[3]",
    lambda case: [f"f_force_tube[{axis}]" for axis in (1, 2, 3)],
    _radii,
    values,
    how_to_get="Debian's package liggghts",
    models=STRAIGHT | SIDEWAYS,
    dissipation=frozenset({VISCOELASTIC, KUWABARA_KONO}),
    refusal=_refusal,
    style={"color": "#0072b2", "marker": "s", "ms": 4.5},
)
