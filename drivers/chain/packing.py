"""Rest of beads in a tube: they lean from side to side, held by the bore, the wall and each other, without friction.

Rest is a minimum of the potential energy, found from seeded places off the axis by Newton's method with damping
(Levenberg and Marquardt): the matrix of second derivatives is banded, since a bead meets only its neighbours.
"""

from dataclasses import dataclass

import numpy as np
from scipy.linalg import LinAlgError, solveh_banded

from drivers.chain.chain import AT_REST, Array
from drivers.chain.contact_law import contact_stiffness_at
from drivers.chain.lateral import side_normals
from validation.reference.hertz_chain import ENERGY_SHARE, EXPONENT

POLISHING_STEPS = 5  # more steps, down to rounding
MAX_STEPS = 20_000
MAX_SHIFT = 1e3  # a shift at which steps lead nowhere
MIN_SHIFT = 1e-14  # of the contacts' stiffness: turning about the axis costs nothing, and needs some
MAX_STEP_SHARE = 0.25  # of the play that a step may move a bead


@dataclass(frozen=True)
class Column:
    """Beads from the wall up, in a tube about the axis; arrays of shape (beads,), SI units.

    Attributes:
        load_N: on each bead, upwards positive.
        stiffness: k of the contact under each bead, the first with a flat wall at height 0.
        bore_stiffness: k of each bead's contact with the bore.
        sides: flat sides of a mesh that stands for it; None: a true cylinder.
    """

    radius_m: Array
    load_N: Array
    stiffness: Array
    bore_radius_m: float
    bore_stiffness: Array
    sides: int | None = None


@dataclass(frozen=True)
class Rest:
    """Where beads come to rest.

    Attributes:
        place_m: centres, shape (beads, 3).
        residual_N: the largest force that nothing balances, and on which bead (counted from 1).
    """

    place_m: Array
    residual_N: float
    bead: int
    load_N: float

    @property
    def at_rest(self) -> bool:
        """Whether what is left is rounding."""
        return self.residual_N <= AT_REST * self.load_N


def find_rest(column: Column, place_m: Array, steps: int = MAX_STEPS) -> Rest:
    """The rest that beads fall into from given places, of shape (beads, 3)."""
    place, shift = place_m.copy(), 1e-6
    load = float(np.abs(column.load_N).sum())
    scale = contact_stiffness_at(column.stiffness.max(), load)
    rounding = 1e-15 * load * float(place[-1, 2])  # of the energy: below it, Newton's steps count unchecked
    energy, gradient, bands = _potential(column, place)
    best, least, polished = place, float(np.abs(gradient).max()), 0
    for _ in range(steps):
        polished += least <= AT_REST * load
        if polished > POLISHING_STEPS or shift > MAX_SHIFT:
            break
        step = _step(bands, gradient, shift * scale)
        if step is not None and np.abs(step).max() <= MAX_STEP_SHARE * float(
            (column.bore_radius_m - column.radius_m).min()
        ):
            trial = _potential(column, place + step)
            if trial[0] < energy or -float((gradient * step).sum()) < rounding:
                place, (energy, gradient, bands) = place + step, trial
                residual = float(np.abs(gradient).max())
                if residual < least:
                    best, least = place, residual
                shift = max(shift / 4, MIN_SHIFT)
                continue
        shift = max(4 * shift, 1e-12)
    gradient = _potential(column, best)[1]
    worst = int(np.argmax(np.abs(gradient).max(axis=1)))
    return Rest(best, least, worst + 1, load)


def _step(bands: Array, gradient: Array, shift: float) -> Array | None:
    """Newton's step with every direction stiffened by ``shift``; None where that does not suffice."""
    shifted = bands.copy()
    shifted[-1] += shift
    try:
        return np.asarray(solveh_banded(shifted, -gradient.ravel(), check_finite=False)).reshape(-1, 3)
    except LinAlgError:
        return None


def _potential(column: Column, place: Array) -> tuple[float, Array, Array]:
    """Energy, its gradient of shape (beads, 3), and its second derivatives as upper bands of shape (6, 3 beads)."""
    count = len(place)
    energy = -float(column.load_N @ place[:, 2])
    gradient = np.zeros((count, 3))
    gradient[:, 2] -= column.load_N
    own = np.zeros((count, 3, 3))

    along = np.diff(place, axis=0)
    distance = np.linalg.norm(along, axis=1)
    normal = along / distance[:, None]
    pair_energy, force, slope = _hertz(column.stiffness[1:], column.radius_m[1:] + column.radius_m[:-1] - distance)
    push = force[:, None] * normal
    gradient[1:] -= push
    gradient[:-1] += push
    outer = normal[:, :, None] * normal[:, None, :]
    block = slope[:, None, None] * outer - (force / distance)[:, None, None] * (np.eye(3) - outer)
    own[1:] += block
    own[:-1] += block

    wall_energy, force, slope = _hertz(column.stiffness[:1], column.radius_m[:1] - place[:1, 2])
    gradient[0, 2] -= force[0]
    own[0, 2, 2] += slope[0]

    bore_energy, push, stiffness = _bore(column, place[:, :2])
    gradient[:, :2] += push
    own[:, :2, :2] += stiffness
    energy += float(pair_energy.sum() + wall_energy.sum()) + bore_energy
    return energy, gradient, _banded(own, -block)


def _bore(column: Column, place: Array) -> tuple[float, Array, Array]:
    """The bore's share of the energy, its gradient of shape (beads, 2) and second derivatives, (beads, 2, 2)."""
    if column.sides is not None:
        normal = side_normals(column.sides)
        overlap = place @ normal.T + column.radius_m[:, None] - column.bore_radius_m
        energy, force, slope = _hertz(column.bore_stiffness[:, None], overlap)
        return float(energy.sum()), force @ normal, np.einsum("bs,si,sj->bij", slope, normal, normal)
    off = np.maximum(np.hypot(place[:, 0], place[:, 1]), 1e-300)
    radial = place / off[:, None]
    energy, force, slope = _hertz(column.bore_stiffness, column.radius_m + off - column.bore_radius_m)
    outer = radial[:, :, None] * radial[:, None, :]
    turned = (force / off)[:, None, None] * (np.eye(2) - outer)
    return float(energy.sum()), force[:, None] * radial, slope[:, None, None] * outer + turned


def _hertz(stiffness: Array, overlap: Array) -> tuple[Array, Array, Array]:
    """Energy, force and contact stiffness."""
    closed = np.maximum(overlap, 0.0)
    root = np.sqrt(closed)
    return ENERGY_SHARE * stiffness * closed**2 * root, stiffness * closed * root, EXPONENT * stiffness * root


def _banded(own: Array, beside: Array) -> Array:
    """Upper bands of the block-tridiagonal matrix, as ``solveh_banded`` takes them."""
    count = len(own)
    bands = np.zeros((6, 3 * count))
    for row in range(3):
        for column in range(3):
            if column >= row:
                bands[5 - (column - row), column::3] = own[:, row, column]
            bands[5 - (column + 3 - row), 3 + column :: 3] = beside[:, row, column]
    return bands
