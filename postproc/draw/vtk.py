"""A finished run as a ParaView series: a file per frame, an index with the times, and a mesh of the tube."""

from math import cos, pi
from pathlib import Path
from tempfile import TemporaryDirectory

import meshio
import numpy as np

from drivers.run.run_folder import EndedRun
from postproc.read.motion import case_of_run, spread
from postproc.read.signals import mean_forces

FRAMES = 100
INDEX, TUBE, FRAME = "chain.pvd", "tube.vtu", "chain-{:05}.vtu"
COLLECTION = '<VTKFile type="Collection" version="0.1"><Collection>\n{}\n</Collection></VTKFile>\n'
SIDES = 48  # of the prism that shows the tube


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
    case = case_of_run(run)
    scene, chain = case.scene, case.chain
    motion = run.state
    chosen = spread(len(motion.time_s), frames)
    place, flat = motion.place_m[chosen], np.isinf(chain.radius_m)  # shape (frames, bodies, 3)
    radius = np.where(flat, scene.chain.diameter / 2, chain.radius_m)
    place[:, flat, 2] += radius[flat]
    number, vertices = np.arange(1, chain.bodies + 1, dtype=np.int32), np.arange(chain.bodies)[:, np.newaxis]
    moving = {"velocity_m_s": motion.velocity_xyz_m_s, "force_N": mean_forces(run.trace.force_N)}
    if run.trace.bore_N is not None:
        moving["bore_N"] = run.trace.bore_N
    folder.parent.mkdir(parents=True, exist_ok=True)
    with TemporaryDirectory(dir=folder.parent, prefix=f".{folder.name}.") as drafts:  # on the same file system
        draft = Path(drafts)
        names, sets = [FRAME.format(frame) for frame in range(len(chosen))], list[str]()
        for name, i, point in zip(names, chosen, place, strict=True):
            fields = {"body": number, "radius_m": radius} | {field: values[i] for field, values in moving.items()}
            meshio.write(draft / name, meshio.Mesh(point, [("vertex", vertices)], point_data=fields))
            sets.append(f'<DataSet timestep="{float(motion.time_s[i])!r}" part="0" file="{name}"/>')
        (draft / INDEX).write_text(COLLECTION.format("\n".join(sets)))
        written = [folder / INDEX]
        if scene.tube is not None:
            bore, foot = scene.tube.inner_diameter / 2, chain.wall_height_m
            inside, top = chain.radius_m <= bore, scene.tube.top
            if top is None:  # it reaches the highest bead that fits
                top = (place[:, inside, 2] + chain.radius_m[inside]).max(initial=foot)
            meshio.write(draft / TUBE, tube_mesh(bore, foot, max(top, foot + bore)))
            names.append(TUBE)
            written.append(folder / TUBE)
        folder.mkdir(exist_ok=True)
        for earlier in [folder / INDEX, folder / TUBE, *folder.glob(FRAME.replace("{:05}", "[0-9]*"))]:
            earlier.unlink(missing_ok=True)
        for name in [*names, INDEX]:
            (draft / name).replace(folder / name)
    return written


def tube_mesh(inner_radius_m: float, low_m: float, high_m: float) -> meshio.Mesh:
    """Mesh of the bore: a prism of flat sides about the z axis, open at both ends, with normals inwards.

    The middle of every side touches the round bore from outside, so beads have at least as much room as in the round
    bore, and ``inner_radius_m (1 / cos(pi / SIDES) - 1)`` more at the edges.
    """
    low = np.arange(SIDES)
    angle, corner = 2 * pi * low / SIDES, inner_radius_m / cos(pi / SIDES)
    ring = np.column_stack([corner * np.cos(angle), corner * np.sin(angle)])
    points = np.column_stack([np.tile(ring, (2, 1)), np.repeat([low_m, high_m], SIDES)])
    onward = np.roll(low, -1)
    return meshio.Mesh(points, [("quad", np.column_stack([low, low + SIDES, onward + SIDES, onward]))])
