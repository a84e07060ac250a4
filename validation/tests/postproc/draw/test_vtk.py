"""The ParaView series, read again, and the mesh of the tube."""

import shutil
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import meshio
import numpy as np
import pytest

from drivers.run.run_folder import STATE, EndedRun, open_run
from postproc.draw import vtk
from postproc.draw.vtk import tube_mesh, write_mesh, write_series
from postproc.read.sensors import mean_forces
from validation.tests.helpers.commands import beads
from validation.tests.helpers.runs import edit_table, finished
from validation.tests.helpers.scenes import STRIKER, WALL, SceneWriter, case_of

TUBE = '[tube]\ninner_diameter = "5 mm"\nmaterial = "ptfe"\n'
FLAT_STRIKER = '[striker]\nshape = "flat"\nmaterial = "alumina"\nmass = "0.47 g"\nspeed = "0.44 m/s"\n'
WIDE_STRIKER = STRIKER.replace("4.76 mm", "9 mm")
RADIUS_M = 0.00238
FILE = {
    "type": "UnstructuredGrid", "version": "0.1", "byte_order": "LittleEndian", "compressor": "vtkZLibDataCompressor",
}  # fmt: skip
GEOMETRY = {"Points": "Float64", "connectivity": "Int64", "offsets": "Int64", "types": "Int64"}
BODIES = {"body": "Int32", "radius_m": "Float64", "velocity_m_s": "Float64", "force_N": "Float64"}

Runner = Callable[..., EndedRun]


@pytest.fixture
def run_of(scene_file: SceneWriter, shared_runs: Path) -> Runner:
    """Runs the small scene with replaced parts, and keeps positions."""

    def run(**parts: str) -> EndedRun:
        return finished(case_of(scene_file(**parts), 'run.record=["forces", "state"]'), "verlet", shared_runs)

    return run


def read_grid(path: Path, kind: str, **fields: str) -> meshio.Mesh:
    """Mesh of a file by meshio, which has such cells and types of fields, and the counts that it states."""
    root = ElementTree.parse(path).getroot()
    assert root.attrib == FILE
    (piece,) = root.findall("UnstructuredGrid/Piece")
    arrays = list(piece.iter("DataArray"))
    assert {array.attrib["Name"]: array.attrib["type"] for array in arrays} == GEOMETRY | fields
    assert {array.attrib["format"] for array in arrays} == {"binary"}
    mesh = meshio.read(path)
    (cells,) = mesh.cells
    counts = len(mesh.points), len(cells.data)
    assert counts == (int(piece.attrib["NumberOfPoints"]), int(piece.attrib["NumberOfCells"]))
    assert cells.type == kind
    return mesh


def read_index(path: Path) -> list[tuple[float, Path]]:
    """Times and files of a series, whose times increase."""
    root = ElementTree.parse(path).getroot()
    assert root.attrib == {"type": "Collection", "version": "0.1"}
    frames = root.findall("Collection/DataSet")
    index = [(float(frame.attrib["timestep"]), path.parent / frame.attrib["file"]) for frame in frames]
    assert all(before < after for (before, _), (after, _) in pairwise(index))
    return index


def test_a_series_has_the_values_of_the_run_to_the_last_bit(run_of: Runner, tmp_path: Path) -> None:
    """The run, which moves along the axis alone, gets sideways motion and forces of the bore by chance."""
    run = run_of(wall=WALL + TUBE)
    folder = tmp_path / run.folder.name
    shutil.copytree(run.folder, folder)
    random, samples = np.random.default_rng(1), len(run.trace.time_s)
    names = [f"body_{j}_{name}" for j in range(1, 7) for name in ("x_m", "y_m", "x_velocity_m_s", "y_velocity_m_s")]
    sideways = {name: random.normal(size=samples) for name in names}
    bore = {f"bore_{j}_N": random.normal(size=samples) for j in range(1, 6)}  # the striker stays above the tube
    edit_table(folder, lambda table: table.assign(**sideways), STATE)
    edit_table(folder, lambda table: table.assign(**bore))
    written = write_series(open_run(folder), tmp_path / "series", 7)
    assert [path.name for path in written] == ["chain.pvd", "tube.vtu"]
    index, time_s = read_index(written[0]), run.trace.time_s
    assert len(index) == 7
    assert [index[0][0], index[-1][0]] == [time_s[0], time_s[-1]]
    for at_s, path in index:
        grid, (sample,) = read_grid(path, "vertex", bore_N="Float64", **BODIES), np.flatnonzero(time_s == at_s)
        motion = {name: values[sample] for name, values in sideways.items()}
        motion |= {f"body_{j + 1}_m": run.state.place_m[sample, j, 2] for j in range(6)}
        motion |= {f"body_{j + 1}_velocity_m_s": run.state.velocity_m_s[sample, j, 2] for j in range(6)}
        vectors = {
            ending: np.array([[motion[f"body_{j}_{axis}{ending}"] for axis in ("x_", "y_", "")] for j in range(1, 7)])
            for ending in ("m", "velocity_m_s")
        }
        expected = {
            "body": np.arange(1, 7),
            "radius_m": np.full(6, RADIUS_M),
            "velocity_m_s": vectors["velocity_m_s"],
            "force_N": mean_forces(run.trace.force_N)[sample],
            "bore_N": np.array([*(force[sample] for force in bore.values()), 0.0]),
        }
        assert np.array_equal(grid.points, vectors["m"])
        assert all(np.array_equal(grid.point_data[name], values) for name, values in expected.items())
        assert grid.cells[0].data.tolist() == [[j] for j in range(6)]
    assert expected["force_N"].max() > 0.1


def test_a_flat_striker_is_a_sphere_that_touches_where_its_face_is(run_of: Runner, tmp_path: Path) -> None:
    run = run_of(striker=FLAT_STRIKER)
    written = write_series(run, tmp_path / "series", 3)
    assert [path.name for path in written] == ["chain.pvd"]  # no tube
    grid = read_grid(read_index(written[0])[0][1], "vertex", **BODIES)
    assert grid.point_data["radius_m"][-1] == RADIUS_M
    assert (grid.points[:, 2] - run.state.place_m[0, :, 2]).tolist() == pytest.approx([0.0] * 5 + [RADIUS_M])


@pytest.mark.parametrize(("striker", "inside"), [(STRIKER, 6), (WIDE_STRIKER, 5)], ids=["narrow", "wide"])
def test_the_tube_reaches_from_the_wall_over_the_bodies_that_fit(
    striker: str, inside: int, run_of: Runner, tmp_path: Path
) -> None:
    run = run_of(striker=striker, wall=WALL + TUBE)
    points = read_grid(write_series(run, tmp_path / "series", 301)[1], "triangle").points
    top_m = run.state.place_m[:, :inside, 2].max() + RADIUS_M
    assert [points[:, 2].min(), points[:, 2].max()] == pytest.approx([0, top_m], rel=1e-12)
    assert (np.hypot(points[:, 0], points[:, 1]) >= 0.0025).all()


@pytest.mark.parametrize("blow", [OSError(28, "No space left on device"), KeyboardInterrupt()])
def test_a_series_replaces_a_longer_one_and_an_interrupted_one_leaves_no_files(
    blow: BaseException, run_of: Runner, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    run, home = run_of(), tmp_path / "out"
    write_series(run, home / "former", 9)
    (home / "former" / "view.pvsm").write_text("of the user")
    write_series(run, home / "former", 4)
    assert len(list((home / "former").iterdir())) == 4 + 2
    assert all(path.exists() for _, path in read_index(home / "former" / "chain.pvd"))
    before = {path: path.read_bytes() for path in home.rglob("*") if path.is_file()}

    def break_off(path: Path, *mesh: Any, **fields: Any) -> None:
        if path.name == "chain-00002.vtu":
            path.write_text("<VTKFile")
            raise blow
        write_mesh(path, *mesh, **fields)

    monkeypatch.setattr(vtk, "write_mesh", break_off)
    for name in ("former", "new"):
        with pytest.raises(type(blow)):
            write_series(run, home / name, 8)
    assert {path: path.read_bytes() for path in home.rglob("*") if path.is_file()} == before
    assert [path.name for path in home.iterdir()] == ["former"]


def test_the_command_writes_100_frames_or_refuses_in_one_line(
    run_of: Runner, scene_file: SceneWriter, shared_runs: Path, tmp_path: Path
) -> None:
    kept = run_of().folder
    done = beads("vtk", kept, "--results", tmp_path / "out")
    assert done.returncode == 0, done.stderr
    index = tmp_path / "out" / f"vtk-verlet-{kept.name}" / "chain.pvd"
    assert done.stdout.split() == [str(index)]
    assert len(read_index(index)) == 100
    bare = finished(case_of(scene_file("bare", duration="0.2 ms")), "verlet", shared_runs).folder
    for words, message in [
        ((bare,), 'beads run bare.toml --engine verlet --set run.record=\'["forces", "state"]\''),
        ((kept, "--frames", "1"), "whole numbers from 2"),
    ]:
        refused = beads("vtk", *words)
        assert (refused.returncode, refused.stderr.count("\n")) == (2, 1)
        assert message in refused.stderr


def test_the_bore_is_an_open_prism_of_triangles() -> None:
    sides = 48
    points, triangles = tube_mesh(0.0025, -0.01, 0.04, sides, 153)
    corners = points[triangles]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    area = np.linalg.norm(normal, axis=1) / 2
    distance = np.einsum("ij,ij->i", normal, corners[:, 0]) / (2 * area)
    assert distance == pytest.approx(-0.0025, rel=1e-12)  # normals point inwards, every side touches the bore
    assert area.sum() == pytest.approx(2 * sides * np.tan(np.pi / sides) * 0.0025 * 0.05, rel=1e-12)
    sides_of = np.sort(np.stack([triangles, np.roll(triangles, 1, 1)], -1).reshape(-1, 2))
    edges, counts = np.unique(sides_of, axis=0, return_counts=True)
    assert set(counts) == {1, 2}
    ends = points[edges[counts == 1], 2]
    assert len(ends) == 2 * sides  # the two ends are the only holes
    assert set(ends.ravel()) == {-0.01, 0.04}
