"""A finished run as a ParaView series: a file a frame, an index with their times, and the tube as its own mesh."""

from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from xml.etree import ElementTree

import numpy as np

from drivers.chain.chain import Array, Chain
from drivers.chain.mesh import tube_mesh, write_mesh
from drivers.chain.trace import FORCES, read_bore_forces
from drivers.run.finished import EndedRun
from drivers.scene.model import Scene
from postproc.read.motion import chain_of, read_motion, spread
from postproc.read.sensors import mean_forces

FRAMES = 100
INDEX, TUBE, FRAME = "chain.pvd", "tube.vtu", "chain-{:05}.vtu"
SIDES, MOST_RINGS = 48, 400  # of the tube as drawn; a long one gets longer cells
Field = Array | np.ndarray[tuple[int, ...], np.dtype[np.int32]]


@dataclass(frozen=True)
class Frame:
    """The bodies at one time."""

    time_s: float
    point_m: Array  # shape (bodies, 3)
    fields: dict[str, Field]  # by name, each of shape (bodies,) or (bodies, 3)


def frames_of(run: EndedRun, scene: Scene, chain: Chain, frames: int) -> list[Frame]:
    """Frames spread evenly over a run, each value as the run's files hold it.

    A flat striker has no radius and its position is that of its face. It is shown as a sphere of a bead's size that
    touches where the face does: its point lies that radius above the face.
    """
    motion, bore = read_motion(run), read_bore_forces(run.folder / FORCES, run.record.bodies)
    force = mean_forces(run.trace.force_N)
    flat = np.isinf(chain.radius_m)
    radius = np.where(flat, scene.chain.diameter / 2, chain.radius_m)
    number = np.arange(1, chain.bodies + 1, dtype=np.int32)
    found = []
    for i in spread(len(motion.time_s), frames):
        point = motion.place_m[i].copy()
        point[flat, 2] += radius[flat]
        fields: dict[str, Field] = {
            "body": number, "radius_m": radius, "velocity_m_s": motion.velocity_m_s[i], "force_N": force[i]
        }  # fmt: skip
        if bore is not None:
            fields["bore_N"] = bore[i]
        found.append(Frame(float(motion.time_s[i]), point, fields))
    return found


def write_series(run: EndedRun, folder: Path, frames: int = FRAMES) -> list[Path]:
    """Writes ``chain.pvd`` with its frames, and ``tube.vtu`` where the scene has a tube.

    All is written beside the folder first. The index goes first and comes last, so that it never names a frame that
    is not there; frames of a former series go with it, other files stay. Returns the index, and the tube's file.

    Raises:
        InputError: the run kept no positions.
        OSError: it cannot be written; what was there before stays.
    """
    scene, chain = chain_of(run)
    found = frames_of(run, scene, chain, frames)
    folder.parent.mkdir(parents=True, exist_ok=True)
    with TemporaryDirectory(dir=folder.parent, prefix=f".{folder.name}.") as drafts:  # of the same file system
        draft = Path(drafts)
        names = [FRAME.format(i) for i in range(len(found))]
        root = ElementTree.Element("VTKFile", type="Collection", version="0.1")
        collection = ElementTree.SubElement(root, "Collection")
        for name, frame in zip(names, found, strict=True):
            vertices = np.arange(chain.bodies)[:, np.newaxis]
            write_mesh(draft / name, frame.point_m, "vertex", vertices, **frame.fields)
            ElementTree.SubElement(collection, "DataSet", timestep=repr(frame.time_s), part="0", file=name)
        ElementTree.indent(root)
        (draft / INDEX).write_bytes(ElementTree.tostring(root, xml_declaration=True, encoding="utf-8"))
        if scene.tube is not None:
            _write_tube(draft / TUBE, scene, chain, found)
            names.append(TUBE)
        folder.mkdir(exist_ok=True)
        for former in [folder / INDEX, folder / TUBE, *folder.glob(FRAME.replace("{:05}", "[0-9]*"))]:
            former.unlink(missing_ok=True)
        for name in [*names, INDEX]:
            (draft / name).replace(folder / name)
    return [folder / INDEX] + [folder / TUBE for _ in range(scene.tube is not None)]


def _write_tube(path: Path, scene: Scene, chain: Chain, frames: list[Frame]) -> None:
    """The bore from the wall to its top; without one, over all that fits into it."""
    assert scene.tube is not None
    bore = scene.tube.inner_diameter / 2
    inside = chain.radius_m <= bore
    tops = [float((frame.point_m[inside, 2] + chain.radius_m[inside]).max()) for frame in frames if inside.any()]
    high = scene.tube.top if scene.tube.top is not None else max(tops, default=0.0)
    high = max(high, chain.wall_height_m + bore)
    rings = max(1, min(MOST_RINGS, round((high - chain.wall_height_m) / (2 * bore * np.pi / SIDES))))
    points, triangles = tube_mesh(bore, chain.wall_height_m, high, SIDES, rings)
    write_mesh(path, points, "triangle", triangles)
