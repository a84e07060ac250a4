"""A finished run as a ParaView series: a file per frame, an index with the times, and a mesh of the tube."""

from pathlib import Path
from tempfile import TemporaryDirectory
from xml.etree import ElementTree

import numpy as np

from drivers.chain.lateral import tube_mesh, write_mesh
from drivers.chain.trace import FORCES, read_bore_forces
from drivers.run.finished import EndedRun
from postproc.read.motion import chain_of, read_motion, spread
from postproc.read.sensors import mean_forces

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
    motion, pressed = read_motion(run), read_bore_forces(run.folder / FORCES, run.record.bodies)
    chosen = spread(len(motion.time_s), frames)
    place, flat = motion.place_m[chosen], np.isinf(chain.radius_m)  # shape (frames, bodies, 3)
    radius = np.where(flat, scene.chain.diameter / 2, chain.radius_m)
    place[:, flat, 2] += radius[flat]
    number = np.arange(1, chain.bodies + 1, dtype=np.int32)
    moving = {"velocity_m_s": motion.velocity_m_s, "force_N": mean_forces(run.trace.force_N)}
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
