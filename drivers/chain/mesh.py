"""Meshes: the bore of a tube as triangles, for decks and pictures, and mesh files, by meshio."""

import io
from math import pi, tan
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

Points = NDArray[np.float64]
Cells = NDArray[np.int64]
LEAST_SIDES = 3


def tube_mesh(
    inner_radius_m: float, low_m: float, high_m: float, sides: int, rings: int | None = None
) -> tuple[Points, Cells]:
    """The bore as a prism of flat sides about the z axis, open at both ends.

    The middle of every side touches the bore from outside: no bead finds less room than in the round bore, and
    at the edges ``inner_radius_m (1 / cos(pi / sides) - 1)`` more.

    Args:
        inner_radius_m: of the round bore.
        low_m: height of its lower end.
        high_m: of its upper end.
        sides: flat sides.
        rings: rows of cells from end to end; left out: as many as make the cells about square.

    Returns:
        Points of shape ``((rings + 1) sides, 3)``, and triangles as indices of their corners, of shape
        ``(2 rings sides, 3)``. Each cell is cut once along a diagonal. Seen from the axis the corners go round
        counterclockwise: normals point inwards.

    Raises:
        ValueError: fewer than three sides, no ring, no radius or no length.
    """
    if sides < LEAST_SIDES or not inner_radius_m > 0 or not high_m > low_m:
        raise ValueError(f"no tube of {sides} sides, radius {inner_radius_m} m, from {low_m} to {high_m} m")
    width = 2 * inner_radius_m * tan(pi / sides)
    if rings is None:
        rings = max(1, round((high_m - low_m) / width))
    if rings < 1:
        raise ValueError(f"no tube of {rings} rings")
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


def write_mesh(path: Path, points: Points, kind: str, cells: Cells, **fields: NDArray[Any]) -> None:
    """Writes cells of one kind, named as meshio does, in the format of the file's ending; fields are of points."""
    import meshio

    meshio.write(path, meshio.Mesh(points, [(kind, cells)], point_data=fields))


def stl_text(points: Points, triangles: Cells) -> str:
    """Triangles as the text of an STL file, with all digits of their corners."""
    import meshio

    buffer = io.StringIO()
    meshio.write(buffer, meshio.Mesh(points, [("triangle", triangles)]), file_format="stl", binary=False)
    return buffer.getvalue()
