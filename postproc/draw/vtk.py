"""A finished run as a ParaView series: a file per frame, an index with the times, and a mesh of the tube."""

from math import pi, tan
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any
from xml.etree import ElementTree

import meshio
import numpy as np
from numpy.typing import NDArray

from drivers.chain.chain import Array
from drivers.run.run_folder import EndedRun
from postproc.read.motion import chain_of, spread
from postproc.read.signals import mean_forces

Cells = NDArray[np.int64]
FRAMES = 100
INDEX, TUBE, FRAME = "chain.pvd", "tube.vtu", "chain-{:05}.vtu"
SIDES, MAX_RINGS = 48, 400  # cells of the tube around and along its axis


def write_series(run: EndedRun, folder: Path, frames: int = FRAMES) -> list[Path]:
    """Writes ``chain.pvd`` with frames spread evenly over a run, and ``tube.vtu`` if the scene has a tube.

    A flat striker, whose position is that of its face, is shown as a sphere of a bead's size that touches where the
    face does.

    All files are written to a temporary folder first. The old index is removed first and the new one comes last, so
    that an index never names a missing frame. Frames of an earlier series are removed; other files stay.

    Returns:
        Path of the index, and of the tube's file if there is one.

    Raises:
        InputError: The run kept no positions; an earlier series stays.
    """
    scene, chain = chain_of(run)
    motion, pressed = run.state, run.trace.bore_N
    chosen = spread(len(motion.time_s), frames)
    place, flat = motion.place_m[chosen], np.isinf(chain.radius_m)  # shape (frames, bodies, 3)
    radius = np.where(flat, scene.chain.diameter / 2, chain.radius_m)
    place[:, flat, 2] += radius[flat]
    number = np.arange(1, chain.bodies + 1, dtype=np.int32)
    moving = {"velocity_m_s": motion.velocity_xyz_m_s, "force_N": mean_forces(run.trace.force_N)}
    moving |= {"bore_N": pressed} if pressed is not None else {}
    folder.parent.mkdir(parents=True, exist_ok=True)
    with TemporaryDirectory(dir=folder.parent, prefix=f".{folder.name}.") as drafts:  # on the same file system
        draft = Path(drafts)
        names = [FRAME.format(frame) for frame in range(len(chosen))]
        root = ElementTree.Element("VTKFile", type="Collection", version="0.1")
        collection = ElementTree.SubElement(root, "Collection")
        for name, i, point in zip(names, chosen, place, strict=True):
            fields = {field: values[i] for field, values in moving.items()}
            vertices = np.arange(chain.bodies)[:, np.newaxis]
            write_mesh(draft / name, point, "vertex", vertices, body=number, radius_m=radius, **fields)
            time_s = repr(float(motion.time_s[i]))
            ElementTree.SubElement(collection, "DataSet", timestep=time_s, part="0", file=name)
        ElementTree.indent(root)
        (draft / INDEX).write_bytes(ElementTree.tostring(root, xml_declaration=True, encoding="utf-8"))
        if scene.tube is not None:
            bore, foot = scene.tube.inner_diameter / 2, chain.wall_height_m
            inside = chain.radius_m <= bore  # a tube without a top reaches the highest bead that fits
            top = float((place[:, inside, 2] + chain.radius_m[inside]).max()) if inside.any() else 0.0
            high = max(top if scene.tube.top is None else scene.tube.top, foot + bore)
            rings = max(1, min(MAX_RINGS, round((high - foot) / (2 * bore * np.pi / SIDES))))
            points, triangles = tube_mesh(bore, foot, high, SIDES, rings)
            write_mesh(draft / TUBE, points, "triangle", triangles)
            names.append(TUBE)
        folder.mkdir(exist_ok=True)
        for earlier in [folder / INDEX, folder / TUBE, *folder.glob(FRAME.replace("{:05}", "[0-9]*"))]:
            earlier.unlink(missing_ok=True)
        for name in [*names, INDEX]:
            (draft / name).replace(folder / name)
    return [folder / INDEX] + [folder / TUBE for _ in range(scene.tube is not None)]


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
    meshio.write(path, meshio.Mesh(points, [(kind, cells)], point_data=fields))
