"""What a three-dimensional chain has beside a straight one: places off the axis, friction, the bore of its tube."""

from dataclasses import dataclass
from functools import cached_property
from math import pi, tan

import numpy as np

from drivers.chain.mesh import stl_text, tube_mesh
from validation.reference.hertz_chain import Array

CELL_ASPECT = 4.0  # height over width of a mesh's cells: as few as are no slivers


@dataclass(frozen=True)
class Bore:
    """The inside of a tube about the chain's axis; arrays of shape (bodies,).

    Attributes:
        stiffness: k of each body's contact with it in F = k overlap^(3/2); 0 for a body that is not in the tube.
        shear_stiffness: as ``Lateral.shear_stiffness``.
        low_m, high_m: heights of its ends.
        sides: flat sides of the mesh that stands for it; None: a true cylinder.
    """

    radius_m: float
    stiffness: Array
    shear_stiffness: Array
    friction: float
    low_m: float
    high_m: float
    sides: int | None

    @property
    def mesh(self) -> str:
        """The text of the STL file of the mesh; empty for a true cylinder."""
        if self.sides is None:
            return ""
        return stl_text(*tube_mesh(self.radius_m, self.low_m, self.high_m, self.sides, self._rings))

    @property
    def triangles(self) -> int:
        """Of the mesh; 0 for a true cylinder."""
        return 0 if self.sides is None else 2 * self.sides * self._rings

    @property
    def _rings(self) -> int:
        assert self.sides is not None
        width = 2 * self.radius_m * tan(pi / self.sides)
        return max(1, round((self.high_m - self.low_m) / (CELL_ASPECT * width)))

    def overlaps(self, radius_m: Array, place_m: Array) -> Array:
        """How deep bodies are in the bore, or in each of its flat sides; a gap is negative.

        Args:
            radius_m: shape (bodies,).
            place_m: off the axis, shape (..., bodies, 2).

        Returns:
            Shape (..., bodies, 1), or (..., bodies, sides).
        """
        if self.sides is None:
            beyond = np.hypot(place_m[..., 0], place_m[..., 1])[..., np.newaxis]
        else:
            beyond = place_m @ side_normals(self.sides).T
        return np.asarray(beyond + radius_m[:, np.newaxis] - self.radius_m)

    @cached_property
    def guided(self) -> list[int]:
        """The bodies in the tube, counted from 0."""
        return [int(body) for body in np.flatnonzero(self.stiffness)]


def side_normals(sides: int) -> Array:
    """Directions in which the flat sides of ``drivers.chain.mesh`` stand. Shape (sides, 2)."""
    angle = 2 * pi * (np.arange(sides) + 0.5) / sides
    return np.column_stack([np.cos(angle), np.sin(angle)])


@dataclass(frozen=True)
class Lateral:
    """Freedom to move sideways and to turn; arrays of shape (bodies, 2), or (bodies,).

    Attributes:
        offset_m: centres off the axis at time 0.
        velocity_m_s: across the axis at time 0.
        shear_stiffness: k_t of each contact: a shear ds adds ``k_t sqrt(overlap) ds`` to its tangential force.
        friction: of contacts between bodies and with the wall.
        turns: whether friction turns bodies.
    """

    offset_m: Array
    velocity_m_s: Array
    shear_stiffness: Array
    friction: float
    turns: bool
    bore: Bore | None

    @property
    def slips(self) -> bool:
        """Whether any contact has friction."""
        return self.friction > 0 or (self.bore is not None and self.bore.friction > 0)
