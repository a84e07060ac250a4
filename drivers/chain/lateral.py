"""Additional properties of three-dimensional chains: positions off the axis, friction, the bore of the tube."""

import io
from dataclasses import dataclass
from functools import cached_property
from math import pi, tan
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from validation.reference.hertz_chain import Array

Cells = NDArray[np.int64]
CELL_ASPECT = 4.0  # height over width of a mesh's cells; LIGGGHTS rejects long slivers


@dataclass(frozen=True)
class Bore:
    """Bore of a tube about the chain's axis; arrays of shape (bodies,).

    Attributes:
        stiffness: k of each body's contact with the bore in F = k overlap^(3/2); 0 for bodies outside the tube.
        shear_stiffness: k_t of these contacts, as in ``Lateral.shear_stiffness``.
        low_m, high_m: heights of the ends.
        sides: number of flat sides of the mesh; None for a true cylinder.
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
        """Text of an STL file of the mesh; empty for a true cylinder."""
        if self.sides is None:
            return ""
        import meshio

        points, triangles = tube_mesh(self.radius_m, self.low_m, self.high_m, self.sides, self._rings)
        text = io.StringIO()
        meshio.write(text, meshio.Mesh(points, [("triangle", triangles)]), file_format="stl", binary=False)
        return text.getvalue()

    @property
    def triangles(self) -> int:
        """Number of triangles of the mesh; 0 for a true cylinder."""
        return 0 if self.sides is None else 2 * self.sides * self._rings

    @property
    def _rings(self) -> int:
        assert self.sides is not None
        width = 2 * self.radius_m * tan(pi / self.sides)
        return max(1, round((self.high_m - self.low_m) / (CELL_ASPECT * width)))

    def overlaps(self, radius_m: Array, place_m: Array) -> Array:
        """Overlaps of bodies with the bore, or with each of its flat sides, in m; a gap is negative.

        Args:
            radius_m: radii of the bodies, shape (bodies,).
            place_m: positions across the axis, shape (..., bodies, 2).

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
        """Indices of the bodies in the tube, from 0."""
        return [int(body) for body in np.flatnonzero(self.stiffness)]


def side_normals(sides: int) -> Array:
    """Unit normals of the flat sides of ``tube_mesh``, away from the axis. Shape (sides, 2)."""
    angle = 2 * pi * (np.arange(sides) + 0.5) / sides
    return np.column_stack([np.cos(angle), np.sin(angle)])


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


def block_bands(own: Array, coupling: Array) -> Array:
    """Upper bands, in scipy's layout, of a symmetric block-tridiagonal matrix.

    Args:
        own: blocks on the diagonal, shape (bodies, 3, 3).
        coupling: blocks above the diagonal, shape (bodies - 1, 3, 3).
    """
    bands = np.zeros((6, 3 * len(own)))
    for row in range(3):
        for column in range(3):
            if column >= row:
                bands[5 - (column - row), column::3] = own[:, row, column]
            bands[5 - (column + 3 - row), 3 + column :: 3] = coupling[:, row, column]
    return bands


def tube_mesh(inner_radius_m: float, low_m: float, high_m: float, sides: int, rings: int) -> tuple[Array, Cells]:
    """Mesh of the bore: a prism of flat sides about the z axis, open at both ends.

    The middle of every side touches the round bore from outside, so beads have at least as much room as in the round
    bore, and ``inner_radius_m (1 / cos(pi / sides) - 1)`` more at the edges.

    Returns:
        Points of shape ``((rings + 1) sides, 3)``, and triangles as indices of their corners, of shape
        ``(2 rings sides, 3)``. The mesh has ``rings`` rows of cells, each cut along a diagonal. Normals point inwards.
    """
    width = 2 * inner_radius_m * tan(pi / sides)
    corner = width / 2 / np.sin(pi / sides)
    angle = 2 * pi * np.arange(sides) / sides
    height = np.repeat(np.linspace(low_m, high_m, rings + 1), sides)
    around = np.tile(np.column_stack([corner * np.cos(angle), corner * np.sin(angle)]), (rings + 1, 1))
    points = np.column_stack([around, height])

    here = np.arange(sides)
    onward = (here + 1) % sides
    base = sides * np.arange(rings)[:, np.newaxis]
    low, low_next = base + here, base + onward
    up, up_next = low + sides, low_next + sides
    halves = np.stack([np.stack([low, up_next, low_next], -1), np.stack([low, up, up_next], -1)], axis=2)
    return points, halves.reshape(-1, 3)


def write_mesh(path: Path, points: Array, kind: str, cells: Cells, **fields: NDArray[Any]) -> None:
    """Write a mesh in the format of the file's suffix; ``kind`` is meshio's cell type, ``fields`` are point data."""
    import meshio

    meshio.write(path, meshio.Mesh(points, [(kind, cells)], point_data=fields))
