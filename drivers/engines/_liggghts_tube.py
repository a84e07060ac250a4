"""LIGGGHTS in three dimensions: the tube and friction of its deck, sideways motion of its dump."""

from dataclasses import dataclass
from math import sqrt

import numpy as np

from drivers.chain.case import Case
from drivers.chain.chain import Array
from drivers.chain.lateral import Bore, Lateral
from drivers.chain.trace import Sideways, Trace, make_sideways_trace
from drivers.engines._sums import contact_forces, towards_axis

TUBE = "tube"  # the label of its type
PLACES, SPINS = ("x", "y", "z", "vx", "vy", "vz"), ("omegax", "omegay", "omegaz")
ON_BORE = tuple(f"f_force_tube[{axis}]" for axis in (1, 2, 3))


@dataclass(frozen=True)
class Tube:
    """What the template needs of the tube; matrices are row by row, a row for each type.

    Attributes:
        type: its type of atom, counted from 1.
        normal, shear: kn and kt of each pair of types; 0 for pairs that this law is not for.
        inside: the bodies it holds as a range of numbers; empty: all.
        mesh: the file of its mesh; empty: a true cylinder.
    """

    type: int
    radius: float
    normal: list[float]
    shear: list[float]
    slips: bool
    inside: str
    mesh: str


def columns(case: Case) -> tuple[str, ...]:
    """What the dump holds of each atom."""
    wall = ("f_force_wall[3]",) if case.chain.wall else ()
    lateral = case.chain.lateral
    if lateral is None:
        return ("id", "z", "vz", "fz", *wall)
    return ("id", *PLACES, *(SPINS if lateral.turns else ()), "fz", *wall, *(ON_BORE if lateral.bore else ()))


def bead_labels(case: Case) -> list[str]:
    """Names of the types of the bodies: a material, and a size where the bore tells one from another."""
    chain = case.chain
    labels = list(chain.materials)
    if chain.lateral is None or chain.lateral.bore is None:
        return labels
    sizes: dict[str, set[float]] = {}
    for label, radius in zip(labels, chain.radius_m, strict=True):
        sizes.setdefault(label, set()).add(float(radius))
    return [
        f"{label} {2e3 * radius:g} mm" if len(sizes[label]) > 1 and np.isfinite(radius) else label
        for label, radius in zip(labels, chain.radius_m, strict=True)
    ]


def tube_of(case: Case, lateral: Lateral, labels: list[str], types: list[str], mesh: str) -> Tube | None:
    """The tube of a deck; None where the scene has none."""
    bore = lateral.bore
    if bore is None:
        return None
    last = len(bore.guided)
    return Tube(
        type=types.index(TUBE) + 1,
        radius=bore.radius_m,
        normal=_pairs(case, bore, bore.stiffness, labels, types),
        shear=_pairs(case, bore, bore.shear_stiffness * (bore.friction > 0), labels, types),
        slips=bore.friction > 0,
        inside=f"1:{last}" if last < case.chain.bodies else "",
        mesh=mesh if bore.sides else "",
    )


def _pairs(case: Case, bore: Bore, stiffness: Array, labels: list[str], types: list[str]) -> list[float]:
    pairs = np.zeros((len(types), len(types)))
    tube = types.index(TUBE)
    for body in bore.guided:
        own = types.index(labels[body])
        pairs[own, tube] = pairs[tube, own] = stiffness[body] / sqrt(case.chain.radius_m[body])
    return [float(value) for value in pairs.ravel()]


def friction_of(lateral: Lateral, types: list[str]) -> list[float]:
    """Coefficients of friction of each pair of types, row by row; nothing where none slips."""
    if not lateral.slips:
        return []
    pairs = np.full((len(types), len(types)), lateral.friction)
    if lateral.bore is not None:
        tube = types.index(TUBE)
        pairs[tube, :] = pairs[:, tube] = lateral.bore.friction
    return [float(value) for value in pairs.ravel()]


def sideways_trace(case: Case, dumped: dict[str, Array], height_m: Array) -> Trace:
    """The trace of a dump; contact forces follow by summing from the wall up, without the bore's share.

    Args:
        case: the case.
        dumped: columns of the dump by name, each of shape (samples, bodies).
        height_m: of the centres, or of the striker's face. Shape (samples, bodies).
    """
    chain, shape = case.chain, height_m.shape
    place = np.stack([dumped["x"], dumped["y"]], axis=2)
    velocity = np.stack([dumped["vx"], dumped["vy"]], axis=2)
    spin = np.stack([dumped[name] for name in SPINS], axis=2) if SPINS[0] in dumped else np.zeros((*shape, 3))
    bore = np.stack([dumped[name] for name in ON_BORE], axis=2) if ON_BORE[0] in dumped else np.zeros((*shape, 3))
    lowest = dumped["f_force_wall[3]"][:, 0] if chain.wall else np.zeros(shape[0])
    force = contact_forces(lowest, dumped["fz"] - chain.load_N - bore[:, :, 2])
    sideways = Sideways(place, velocity, spin, towards_axis(place, bore[:, :, :2]))
    friction = bore[:, :, 2].sum(axis=1) if chain.lateral and chain.lateral.bore else None
    times = case.sample_times_s[: shape[0]]
    return make_sideways_trace(chain, times, force, height_m, dumped["vz"], friction, sideways)
