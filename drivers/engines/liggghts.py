"""LIGGGHTS: deck, refusals."""

from typing import Any

import numpy as np

from drivers.chain.case import SIDEWAYS, STRAIGHT, Case
from drivers.chain.chain import Array, sphere_for_face
from drivers.engines._lammps_family import coefficients_of, labels_of, law_refusal, member, table_of_pairs

# with fewer bodies, checking all pairs costs no more than bins of the whole space, which grows in a blow-up
MAX_IN_PAIRS = 2000
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
    return (flat or chain.law.by_mass) and chain.lateral is None


def values(case: Case, radius_m: Array) -> dict[str, Any]:
    """Values of the template: types with their constants, contacts of each pair of types."""
    scene, chain, labels = case.scene, case.chain, labels_of(case.chain)
    lateral, bore = chain.lateral, chain.bore
    flat, springs = bool(np.isinf(chain.radius_m[-1])), _by_springs(case)
    material_of = dict(zip(labels, chain.materials, strict=True))
    if chain.wall:
        material_of.setdefault(chain.wall, chain.wall)
    if bore:
        assert scene.tube is not None
        material_of[TUBE] = scene.tube.material
    types = list(material_of)
    moduli, ratios = map(list, zip(*map(scene.elastic_constants, material_of.values()), strict=True))
    if flat and not springs:
        moduli[types.index(labels[-1])] = sphere_for_face(scene, chain)[1]
    below = [chain.wall, *labels[:-1]]
    kn, gn = coefficients_of(chain, radius_m)
    friction = np.full((len(types), len(types)), lateral.friction if lateral and lateral.slips else 0.0)
    by_bore = {}
    if bore:
        beside = [TUBE if stiffness else None for stiffness in bore.stiffness]
        sheared = bore.shear_stiffness * (bore.friction > 0)
        for name, stiffness in (("bore_kn", bore.stiffness), ("bore_kt", sheared)):
            by_bore[name] = table_of_pairs(types, beside, labels, stiffness / np.sqrt(chain.radius_m), 0.0)
        friction[-1] = friction[:, -1] = bore.friction
    return by_bore | {
        "types": types,
        "binsize": 100 * radius_m.max() if chain.straight and chain.bodies > MAX_IN_PAIRS else None,
        "moduli": moduli,
        "ratios": ratios,
        "springs": springs,
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
    refusal=lambda case: law_refusal(case, "liggghts"),
    style={"color": "#0072b2", "marker": "s", "ms": 4.5},
)
