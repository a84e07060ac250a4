"""Meshes as files, by meshio: the tube's for decks, frames and the tube's for ParaView."""

import io
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

Points = NDArray[np.float64]
Cells = NDArray[np.int64]


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
