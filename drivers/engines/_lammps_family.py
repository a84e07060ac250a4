"""LAMMPS and its descendants: atoms and types of a deck, commands, error messages, traces of dumps."""

import math
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from drivers.base import decks
from drivers.base.errors import InputProblem, RunError
from drivers.base.processes import line_of
from drivers.chain.case import Case
from drivers.chain.chain import Array, Chain
from drivers.chain.trace import Trace, make_trace
from drivers.engines import Engine, last_line
from drivers.engines._raw_output import read_dump
from drivers.laws import KUWABARA_KONO, VISCOELASTIC
from validation.reference.hertz_chain import EXPONENT, loads_N

DUMP = "chain.bin"
CONTACT_FORCE = "f_contacts[3]"  # between beads, along the axis
# columns of three-dimensional chains; the force of the wall has another name in each code
PLACE, VELOCITY, SPIN = ("x", "y", "z"), ("vx", "vy", "vz"), ("omegax", "omegay", "omegaz")
MAX_TYPES = 60  # with a coefficient for each pair
# polynomial of LAMMPS' damping tsuji, lowest power first: gamma / sqrt(m* kn sqrt(R* overlap)) of its coefficient
TSUJI = (1.2728, -4.2783, 11.087, -22.348, 27.467, -18.022, 4.8218)
MINIMUM_AT = 1.1  # coefficient close to the polynomial's minimum, which is negative


def member(
    code: str,
    program: str,
    introduction: str,
    wall_force: str,
    bore_forces: Callable[[Case], list[str]],
    radii: Callable[[Case], Array],
    values: Callable[[Case, Array], dict[str, Any]],
    **fields: Any,
) -> Engine:
    """Build the engine of LAMMPS or a descendant.

    Args:
        code: name of the code; the folder of the template of ``chain.in`` has the same name in lower case.
        program: name of the program.
        introduction: regular expression that matches the line with the version.
        wall_force: column of the dump with the wall's force along the axis.
        bore_forces: function that returns the columns of a case with the bore's force along x, y and z, three for each
            of its fixes.
        radii: function that returns the radii of the atoms of a case.
        values: function of a case and the radii of its atoms that returns further values of the templates,
            among them ``types``, the names of all types, including those of ``labels_of``.
        fields: further fields of ``Engine``.
    """

    def render(case: Case) -> decks.Deck:
        """Render ``chain.in`` and ``chain.data``; atoms have the numbers of the bodies, from the wall up."""
        chain, place, radius_m = case.chain, case.chain.place_m, radii(case)
        place[:, 2] += above_face(chain, radius_m)
        given = values(case, radius_m)
        type_of = [given["types"].index(label) + 1 for label in labels_of(chain)]
        density = chain.mass_kg / (4 / 3 * math.pi * radius_m**3)
        given |= {
            "code": code,
            "case": case,
            "atoms": np.column_stack([type_of, 2 * radius_m, density, place]),
            "velocities": np.column_stack([chain.velocity_xyz_m_s, np.zeros((chain.bodies, 3))]),
            "types": [name.strip() for name in given["types"]],
            "box": {
                "half_width": float(f"{4 * radius_m.max():.1g}"),
                "low": (place[:, 2] - radius_m).min(),
                "high": (place[:, 2] + radius_m).max(),
            },
            "skin": float(f"{0.2 * radius_m.min():.1g}"),
            "columns": columns(case),
        }
        templates = (f"{code.lower()}/chain.in.j2", "lammps/chain.data.j2")  # same format of data files
        files = {Path(name).stem: decks.render(name, **given) for name in templates}
        command = ("stdbuf", "-oL", program, "-in", "chain.in")  # -oL keeps the last lines of an abort
        return decks.Deck(files, command, raw=(DUMP,), logs=(f"log.{code.lower()}",))

    def columns(case: Case) -> tuple[str, ...]:
        """Columns of the dump."""
        chain, wall = case.chain, (wall_force,) if case.chain.wall else ()
        if chain.straight:
            return ("id", "z", "vz", CONTACT_FORCE, *wall)
        spin, bore = SPIN if chain.turns else (), bore_forces(case) if chain.bore_m else ()
        return ("id", *PLACE, *VELOCITY, *spin, CONTACT_FORCE, *wall, *bore)

    def trace(case: Case, dump: dict[str, Array]) -> Trace:
        return _trace(case, radii(case), dump, wall_force, bore_forces(case))

    def read(case: Case, path: Path, names: tuple[str, ...] = ()) -> tuple[Trace, int]:
        """Read a dump as a trace, with its digits; RunError, with the samples before, if it is damaged."""
        try:
            dump, digits = read_dump(case, path, names or columns(case), named=bool(names))
            return trace(case, dump), digits
        except RunError as error:
            if error.partial is not None:
                error.partial = trace(case, error.partial)
            raise
        except KeyError as error:
            raise RunError(f"{path.name} has no column {error.args[0]}, so nothing can be judged: --columns") from error

    return Engine(
        title=code,
        program=program,
        version=lambda command: line_of(command, "-help", introduction),
        render=render,
        server=decks.Deck({}, ("stdbuf", "-oL", program, "-log", "none"), raw=()),  # reads commands from stdin
        request=request_by_include,
        read=lambda case, folder: read(case, folder / DUMP)[0],
        read_dump=read,
        failure_reason=failure_reason,
        loop_pattern=r"^Loop time of ([0-9.e+-]*[0-9]) on",
        **fields,
    )


def labels_of(chain: Chain) -> list[str]:
    """Types of the bodies: the material, with the size or mass if coefficients of contacts differ by it."""
    labels = list(chain.materials)
    if chain.bore_m:
        sized = list(zip(labels, chain.radius_m.tolist(), strict=True))
        sizes = Counter(label for label, _ in set(sized))
        labels = [
            f"{label} {2e3 * radius:g} mm" if sizes[label] > 1 and np.isfinite(radius) else label
            for label, radius in sized
        ]
    if by_mass(chain):
        labels = [f"{label} {1e3 * mass:.9g} g" for label, mass in zip(labels, chain.mass_kg.tolist(), strict=True)]
    if np.isinf(chain.radius_m[-1]):
        labels[-1] = f"flat {labels[-1]}"
    return labels


def by_mass(chain: Chain) -> bool:
    """True if the damping coefficient of the contacts depends on their reduced mass."""
    return chain.law.name == KUWABARA_KONO


def refusal_by_mass(case: Case) -> InputProblem | None:
    """Refuse too many masses for a law whose coefficient depends on them."""
    kinds = len(set(labels_of(case.chain)))
    if by_mass(case.chain) and kinds > MAX_TYPES:
        return "contact.dissipation", f'"{case.chain.law.name}" with {kinds} kinds of beads', f"at most {MAX_TYPES}"
    return None


def above_face(chain: Chain, radius_m: Array) -> Array:
    """Height of atoms above their bodies: a flat face is a sphere, which may touch the bead below off the axis."""
    above = np.zeros(chain.bodies)
    if np.isinf(chain.radius_m[-1]):
        apart = radius_m[-1] + radius_m[-2]
        off = float(np.hypot(*chain.across_m[-2]))
        above[-1] = math.sqrt(apart**2 - off**2) - radius_m[-2] if off else radius_m[-1]
        if chain.damped:  # a gap or an overlap above the rounding error: see Chain.height_m
            above[-1] += (-4 if chain.law.alpha else 4) * np.spacing(apart)
    return above


def table_of_pairs(
    types: Sequence[str], below: Sequence[str | None], above: Sequence[str], values: Iterable[float], otherwise: float
) -> Array:
    """Symmetric table with a value for each pair of types; of several contacts of a pair the last one counts.

    Args:
        types: names of all types.
        below: type on one side of each contact; None if there is no contact.
        above: type on the other side.
        values: value of each contact.
        otherwise: value of pairs without a contact.
    """
    table = np.full((len(types), len(types)), otherwise)
    for first, second, value in zip(below, above, values, strict=True):
        if first is not None:
            i, j = types.index(first), types.index(second)
            table[i, j] = table[j, i] = value
    return table


def request_by_include(folder: str, word: str) -> str:
    """Commands that run ``chain.in`` of a folder, clear all settings, and print the word."""
    deck = f"shell cd {folder}\ninclude chain.in\nclear\nshell cd ..\n" if folder else ""
    return f'{deck}print "{word}"\n'


def failure_reason(stdout: str, stderr: str) -> str:
    """Last line that begins with ERROR; else the last line that is not from hwloc."""
    errors = [line.strip() for line in f"{stderr}\n{stdout}".splitlines() if line.startswith("ERROR")]
    return errors[-1] if errors else last_line(stderr, stdout, ("[hwloc/",))


def roots(radius_m: Array) -> Array:
    """``sqrt(R*)`` of each contact of atoms of these radii. Shape (bodies,)."""
    return np.asarray(np.sqrt(np.append(radius_m[0], 1 / (1 / radius_m[1:] + 1 / radius_m[:-1]))))


def coefficients_of(chain: Chain, radius_m: Array) -> tuple[list[float], list[float]]:
    """Stiffness kn in ``F = kn sqrt(R*) overlap^(3/2)`` of each contact of atoms, and its damping coefficient.

    The coefficient is that of LAMMPS' ``damping tsuji``, or gamma of ``damping velocity``, a linear dashpot, or eta of
    ``damping viscoelastic``, whose force is ``eta m* sqrt(R* d) d'``. LIGGGHTS' ``gamman`` is the latter, too.
    """
    kn = (chain.stiffness / roots(radius_m)).tolist()
    law = chain.law
    if by_mass(chain):
        return kn, (EXPONENT * law.value * np.array(kn) / chain.reduced_mass_kg).tolist()
    return kn, [tsuji_coefficient(law.value) if law.name == VISCOELASTIC else law.value] * chain.bodies


@cache
def tsuji_coefficient(damping_ratio: float) -> float:
    """Coefficient of LAMMPS' ``damping tsuji``: its polynomial equals ``2 sqrt(3/2) B``.

    Up to B = 0.52 it is the restitution of the law with attractive forces; above, it exceeds 1 and has no meaning.
    """
    from scipy.optimize import brentq

    wanted = 2 * math.sqrt(1.5) * damping_ratio

    def excess(coefficient: float) -> float:
        return sum(factor * coefficient**power for power, factor in enumerate(TSUJI)) - wanted

    ends = (0.0, MINIMUM_AT) if wanted <= TSUJI[0] else (MINIMUM_AT, 3 + wanted)
    return float(brentq(excess, *ends, xtol=1e-300, rtol=1e-15))


def _trace(case: Case, radius_m: Array, dump: dict[str, Array], wall_force: str, bore_forces: Sequence[str]) -> Trace:
    """Trace of a dump's columns; without heights or velocities, the energies that they give are NaN.

    Contact forces are those of the wall and of the beads. A dump of another deck may have the total forces ``fz``
    instead, from which they follow from the uppermost body downwards: ``F_j = F_{j+1} + fz_j - load_j``.
    """
    chain, samples = case.chain, len(dump["id"])
    times, unknown = case.sample_times_s[:samples], np.full(samples, np.nan)
    if chain.straight and not (CONTACT_FORCE in dump and (wall_force in dump or not chain.wall)):
        on_bodies = dump["fz"] - loads_N(chain.load_N, chain.drive, times)
        force = np.cumsum(on_bodies[:, ::-1], axis=1)[:, ::-1] * (chain.stiffness > 0)
    else:
        wall = dump[wall_force][:, 0] if chain.wall else np.zeros(samples)
        force = np.column_stack([wall, -np.cumsum(dump[CONTACT_FORCE], axis=1)[:, :-1]])

    def vectors(names: Sequence[str]) -> Array:
        return np.stack([dump[name] for name in names], axis=2)

    height = dump["z"] - above_face(chain, radius_m) if "z" in dump else None
    velocity = dump.get("vz")
    if height is None or velocity is None:
        momentum = unknown if velocity is None else velocity @ chain.mass_kg
        return Trace(times, force, unknown, unknown, momentum, height, velocity)
    if chain.straight:
        return make_trace(chain, times, force, height, velocity)
    place, spin = vectors(PLACE), vectors(SPIN) if chain.turns else None
    place[:, :, 2] = height
    by_fix = [bore_forces[at : at + 3] for at in range(0, len(bore_forces), 3)]
    bore = np.sum([*map(vectors, by_fix)], axis=0) if chain.bore_m else None
    return make_trace(chain, times, force, place, vectors(VELOCITY), spin, bore)
