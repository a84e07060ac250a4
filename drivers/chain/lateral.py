"""Additional properties of three-dimensional chains: positions off the axis, friction, the bore of the tube."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from validation.reference.hertz_chain import Array


@dataclass(frozen=True)
class Bore:
    """Bore of a tube about the chain's axis; arrays of shape (bodies,).

    Attributes:
        stiffness: k of each body's contact with the bore in F = k overlap^(3/2); 0 for bodies outside the tube.
        shear_stiffness: k_t of these contacts, as in ``Lateral.shear_stiffness``.
        top_m: height of the upper end; inf for a tube above all bodies.
    """

    radius_m: float
    stiffness: Array
    shear_stiffness: Array
    friction: float
    top_m: float

    def overlaps(self, radius_m: Array, place_m: Array) -> Array:
        """Overlaps of bodies with the bore in m; a gap is negative. Shape (..., bodies).

        Args:
            radius_m: radii of the bodies, shape (bodies,).
            place_m: positions across the axis, shape (..., bodies, 2).
        """
        return np.asarray(np.hypot(place_m[..., 0], place_m[..., 1]) + radius_m - self.radius_m)

    @cached_property
    def guided(self) -> list[int]:
        """Indices of the bodies in the tube, from 0."""
        return [int(body) for body in np.flatnonzero(self.stiffness)]


@dataclass(frozen=True)
class Lateral:
    """Properties of bodies that can move sideways and turn.

    Attributes:
        offset_m: positions of the centres across the axis at time 0, shape (bodies, 2).
        velocity_m_s: velocities across the axis at time 0, shape (bodies, 2).
        shear_stiffness: k_t of each contact, shape (bodies,): a shear ds adds ``k_t sqrt(overlap) ds`` to the
            tangential force.
        friction: coefficient between bodies and with the wall.
        turns: True if friction turns bodies.
    """

    offset_m: Array
    velocity_m_s: Array
    shear_stiffness: Array
    friction: float
    turns: bool
    bore: Bore | None

    @property
    def slips(self) -> bool:
        """True if any contact has friction."""
        return self.friction > 0 or (self.bore is not None and self.bore.friction > 0)


def block_bands(diagonal: Array, coupling: Array) -> Array:
    """Upper bands, in scipy's layout, of a symmetric block-tridiagonal matrix.

    Args:
        diagonal: blocks on the diagonal, shape (bodies, 3, 3).
        coupling: blocks above the diagonal, shape (bodies - 1, 3, 3).
    """
    bands = np.zeros((6, 3 * len(diagonal)))
    for row in range(3):
        for column in range(3):
            if column >= row:
                bands[5 - (column - row), column::3] = diagonal[:, row, column]
            bands[5 - (column + 3 - row), 3 + column :: 3] = coupling[:, row, column]
    return bands
