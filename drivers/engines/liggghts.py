"""LIGGGHTS: deck, refusals."""

import math
from collections.abc import Iterator

import numpy as np

from drivers.base.decks import Deck
from drivers.chain.case import SIDEWAYS, STRAIGHT, Case
from drivers.chain.chain import Array, Chain, sphere_for_face
from drivers.engines import Style
from drivers.engines._lammps_family import (
    above_face,
    contact_kn,
    deck_of,
    labels_of,
    law_refusal,
    member,
    table_of_pairs,
)
from drivers.laws import LAWS

HARD_PA, SOFT_PA = 1e9, 5e6  # moduli outside this range need hard_particles or soft_particles
# with fewer bodies, checking all pairs costs no more than bins of the whole space, which grows in a blow-up
MAX_BODIES_IN_PAIRS = 2000
TUBE = " tube"  # the type of the bore: no material's name begins with a space
WALL_FORCE = "f_force_wall[3]"


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


def render(case: Case) -> Deck:
    """Render ``chain.in`` and ``chain.data``."""
    scene, chain, bore, radius = case.scene, case.chain, case.chain.bore, _radii(case)
    flat, springs = bool(np.isinf(chain.radius_m[-1])), _by_springs(case)
    height = chain.height_m + above_face(chain, radius)
    labels = labels_of(chain)
    material_of = dict(zip(labels, chain.materials, strict=True))
    if chain.wall:
        material_of.setdefault(chain.wall, chain.wall)
    if bore:
        assert scene.tube is not None
        material_of[TUBE] = scene.tube.material
    types = list(material_of)
    constants = [scene.elastic_constants(name) for name in material_of.values()]
    moduli, ratios = [young for young, _ in constants], [poisson for _, poisson in constants]
    if flat and not springs:
        moduli[types.index(labels[-1])] = sphere_for_face(scene, chain)[1]
    below = [chain.wall, *labels[:-1]]  # type of the lower body of each contact
    kn = contact_kn(chain, radius).tolist()
    gn = map(chain.law.lammps, kn, chain.reduced_mass_kg.tolist())
    contacts = zip(below, labels, kn, gn, strict=True)
    pairs = [(lower, upper, k, g) for lower, upper, k, g in contacts if lower]
    return deck_of(
        "LIGGGHTS",
        "liggghts",
        case,
        radius,
        types,
        WALL_FORCE,
        box={
            "half_width": float(f"{4 * radius.max():.1g}"),
            "low": (height - radius).min(),
            "high": (height + radius).max(),
        },
        skin=float(f"{0.2 * radius.min():.1g}"),
        binsize=100 * radius.max() if chain.straight and chain.bodies > MAX_BODIES_IN_PAIRS else None,
        moduli=moduli,
        ratios=ratios,
        wall_type=types.index(chain.wall) + 1 if chain.wall else 0,
        contact_kn=table_of_pairs(types, [(lower, upper, value) for lower, upper, value, _ in pairs], 1.0)
        if springs
        else [],
        contact_gn=table_of_pairs(types, [(lower, upper, value) for lower, upper, _, value in pairs], 0.0),
        bore_kn=table_of_pairs(types, _bore_kn(chain, labels), 0.0),
        bore_kt=table_of_pairs(types, _bore_kn(chain, labels, shear=True), 0.0),
        friction=_friction(chain, types),
        face_radius=radius[-1] if flat and not springs else None,
        guided_face=flat and chain.lateral,
        hard=not springs and max(moduli) > HARD_PA,
        soft=not springs and min(moduli) < SOFT_PA,
    )


def _bore_kn(chain: Chain, labels: list[str], *, shear: bool = False) -> Iterator[tuple[str, str, float]]:
    """Stiffness of bore contacts by pairs of types, kn in ``F = kn sqrt(R) overlap^(3/2)``; with ``shear`` kt."""
    bore = chain.bore
    if bore is None:
        return
    stiffness = bore.shear_stiffness * (bore.friction > 0) if shear else bore.stiffness
    for body in bore.guided:
        yield labels[body], TUBE, stiffness[body] / math.sqrt(chain.radius_m[body])


def _friction(chain: Chain, types: list[str]) -> list[float]:
    """Coefficients of friction of all pairs of types, row by row; empty without friction."""
    if chain.lateral is None or not chain.lateral.slips:
        return []
    in_bore = [(type_, TUBE, chain.bore.friction) for type_ in types] if chain.bore else []
    return table_of_pairs(types, in_bore, chain.lateral.friction)


ENGINE = member(
    "liggghts",
    r"LIGGGHTS \(Version",
    _radii,
    WALL_FORCE,
    how_to_get="Debian's package liggghts",
    models=STRAIGHT | SIDEWAYS,
    dissipation=frozenset(LAWS),
    refusal=lambda case: law_refusal(case, "liggghts"),
    render=render,
    style=Style("#0072b2", marker="s", size=4.5),
)
