"""The ParaView series, read by VTK's own reader, and the mesh of the tube."""

import shutil
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pandas as pd
import pytest

from drivers.chain.chain import Array
from drivers.run.run_folder import STATE, EndedRun, open_run
from postproc.draw import vtk
from postproc.draw.vtk import tube_mesh, write_mesh, write_series
from validation.tests.helpers.commands import beads
from validation.tests.helpers.runs import edit_table, finished
from validation.tests.helpers.scenes import STRIKER, WALL, SceneWriter, case_of

pytestmark = pytest.mark.long

WITH_STATE = 'run.record=["forces", "state"]'
TUBE = '[tube]\ninner_diameter = "5 mm"\nmaterial = "ptfe"\n'
FLAT_STRIKER = '[striker]\nshape = "flat"\nmaterial = "alumina"\nmass = "0.47 g"\nspeed = "0.44 m/s"\n'


@dataclass(frozen=True)
class Grid:
    """Content of a file by VTK's reader."""

    point_m: Array
    fields: dict[str, Array]
    cells: list[tuple[int, tuple[int, ...]]]


def read_grid(path: Path) -> Grid:
    from vtkmodules.util.numpy_support import vtk_to_numpy
    from vtkmodules.vtkIOXML import vtkXMLUnstructuredGridReader

    reader: Any = vtkXMLUnstructuredGridReader()
    reader.SetFileName(str(path))
    reader.Update()
    assert reader.GetErrorCode() == 0
    grid = reader.GetOutput()
    data = grid.GetPointData()
    fields = {data.GetArrayName(i): vtk_to_numpy(data.GetArray(i)) for i in range(data.GetNumberOfArrays())}
    cells = []
    for i in range(grid.GetNumberOfCells()):
        cell = grid.GetCell(i)
        cells.append((cell.GetCellType(), tuple(cell.GetPointId(k) for k in range(cell.GetNumberOfPoints()))))
    return Grid(vtk_to_numpy(grid.GetPoints().GetData()), fields, cells)


def read_index(path: Path) -> list[tuple[float, Path]]:
    found = ElementTree.parse(path).getroot().iter("DataSet")
    return [(float(each.attrib["timestep"]), path.parent / each.attrib["file"]) for each in found]


def a_run(scene: Path, runs: Path, engine: str = "verlet") -> EndedRun:
    return finished(case_of(scene, WITH_STATE), engine, runs)


@pytest.mark.parametrize("engine", ["verlet", "yade", "liggghts"])
def test_another_reader_finds_the_values_of_the_run_to_the_last_bit(
    engine: str, scene_file: SceneWriter, shared_runs: Path, tmp_path: Path
) -> None:
    run = a_run(scene_file(wall=WALL + TUBE), shared_runs, engine)
    written = write_series(run, tmp_path / "series", 7)
    assert [path.name for path in written] == ["chain.pvd", "tube.vtu"]
    state = pd.read_parquet(run.folder / "state.parquet").set_index("time_s")
    forces = pd.read_parquet(run.folder / "forces.parquet").set_index("time_s")
    index = read_index(written[0])
    assert len(index) == 7
    assert [index[0][0], index[-1][0]] == [state.index[0], state.index[-1]]
    for time_s, path in index:
        grid, own, force = read_grid(path), state.loc[time_s], forces.loc[time_s]
        assert grid.cells == [(1, (j,)) for j in range(6)]  # VTK_VERTEX
        contact = np.array([force[f"contact_{j}_N"] for j in range(1, 7)] + [0.0])
        assert grid.point_m.dtype == np.float64
        assert (grid.point_m[:, :2] == 0).all()
        assert (grid.point_m[:, 2] == [own[f"body_{j}_height_m"] for j in range(1, 7)]).all()
        assert (grid.fields["velocity_m_s"][:, :2] == 0).all()
        assert (grid.fields["velocity_m_s"][:, 2] == [own[f"body_{j}_velocity_m_s"] for j in range(1, 7)]).all()
        assert (grid.fields["force_N"] == (contact[:-1] + contact[1:]) / 2).all()
        assert (grid.fields["radius_m"] == 0.00238).all()
        assert (grid.fields["body"] == np.arange(1, 7)).all()
        assert set(grid.fields) == {"body", "radius_m", "velocity_m_s", "force_N"}
    assert max(read_grid(path).fields["force_N"].max() for _, path in index) > 1


def test_sideways_positions_and_bore_forces_are_written(
    scene_file: SceneWriter, shared_runs: Path, tmp_path: Path
) -> None:
    run = a_run(scene_file(wall=WALL + TUBE), shared_runs)
    folder = tmp_path / run.folder.name
    shutil.copytree(run.folder, folder)
    random = np.random.default_rng(1)
    state = pd.read_parquet(folder / STATE)
    more = {f"body_{j}_{name}": random.normal(size=len(state)) for j in range(1, 7)
            for name in ("x_m", "y_m", "x_velocity_m_s", "y_velocity_m_s")}  # fmt: skip
    edit_table(folder, lambda table: table.assign(**more), STATE)
    bore = {f"bore_{j}_N": random.normal(size=len(state)) for j in range(1, 6)}  # the striker stays above the tube
    edit_table(folder, lambda table: table.assign(**bore))
    (_, first), (_, last) = read_index(write_series(open_run(folder), tmp_path / "series", 2)[0])
    assert first != last
    grid = read_grid(last)
    assert (grid.point_m[:, 0] == [more[f"body_{j}_x_m"][-1] for j in range(1, 7)]).all()
    assert (grid.point_m[:, 1] == [more[f"body_{j}_y_m"][-1] for j in range(1, 7)]).all()
    assert (grid.fields["velocity_m_s"][:, 0] == [more[f"body_{j}_x_velocity_m_s"][-1] for j in range(1, 7)]).all()
    assert (grid.fields["velocity_m_s"][:, 1] == [more[f"body_{j}_y_velocity_m_s"][-1] for j in range(1, 7)]).all()
    assert (grid.fields["bore_N"] == [*(bore[f"bore_{j}_N"][-1] for j in range(1, 6)), 0]).all()


def test_a_flat_striker_is_a_sphere_that_touches_where_its_face_is(
    scene_file: SceneWriter, shared_runs: Path, tmp_path: Path
) -> None:
    run = a_run(scene_file(striker=FLAT_STRIKER), shared_runs)
    written = write_series(run, tmp_path / "series", 3)
    assert [path.name for path in written] == ["chain.pvd"]  # no tube
    state = pd.read_parquet(run.folder / "state.parquet")
    grid = read_grid(read_index(written[0])[0][1])
    assert grid.fields["radius_m"][-1] == 0.00238
    assert grid.point_m[-1, 2] == state["body_6_height_m"].iloc[0] + 0.00238
    assert grid.point_m[0, 2] == state["body_1_height_m"].iloc[0]


def test_the_tube_reaches_from_the_wall_over_the_beads(
    scene_file: SceneWriter, shared_runs: Path, tmp_path: Path
) -> None:
    run = a_run(scene_file(wall=WALL + TUBE), shared_runs)
    series = write_series(run, tmp_path / "series", 5)
    tube = read_grid(series[1])
    assert {kind for kind, _ in tube.cells} == {5}  # VTK_TRIANGLE
    assert tube.point_m[:, 2].min() == 0
    tops = [grid.point_m[:, 2].max() for grid in (read_grid(path) for _, path in read_index(series[0]))]
    assert tube.point_m[:, 2].max() == pytest.approx(max(tops) + 0.00238, rel=1e-12)
    assert (np.hypot(tube.point_m[:, 0], tube.point_m[:, 1]) >= 0.0025).all()


def test_a_series_replaces_a_longer_one_and_keeps_other_files(
    scene_file: SceneWriter, shared_runs: Path, tmp_path: Path
) -> None:
    run, folder = a_run(scene_file(), shared_runs), tmp_path / "series"
    write_series(run, folder, 9)
    (folder / "view.pvsm").write_text("mine")
    write_series(run, folder, 4)
    assert len(list(folder.iterdir())) == 4 + 2
    assert all(path.exists() for _, path in read_index(folder / "chain.pvd"))


@pytest.mark.parametrize("blow", [OSError(28, "No space left on device"), KeyboardInterrupt()])
def test_an_interrupted_series_leaves_no_files(
    blow: BaseException, scene_file: SceneWriter, shared_runs: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    run, home = a_run(scene_file(), shared_runs), tmp_path / "out"
    write_series(run, home / "former", 4)
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


def test_on_the_command_line(scene_file: SceneWriter, shared_runs: Path, tmp_path: Path) -> None:
    run = a_run(scene_file(), shared_runs)
    done = beads("vtk", run.folder, "--results", tmp_path / "out")
    assert done.returncode == 0, done.stderr
    folder = tmp_path / "out" / f"vtk-verlet-{run.folder.name}"
    assert done.stdout.split() == [str(folder / "chain.pvd")]
    assert len(read_index(folder / "chain.pvd")) == 100


def test_bad_input_is_refused_in_one_line(scene_file: SceneWriter, shared_runs: Path, tmp_path: Path) -> None:
    without = finished(case_of(scene_file("bare", duration="0.2 ms")), "verlet", shared_runs).folder
    kept = a_run(scene_file("kept"), shared_runs).folder
    damaged, alien = tmp_path / "damaged", tmp_path / "alien"
    for folder in (damaged, alien):
        shutil.copytree(kept, folder)
    (damaged / "state.parquet").write_bytes((kept / "state.parquet").read_bytes()[:999])
    edit_table(alien, lambda table: table.drop(columns="body_3_height_m"), STATE)
    (tmp_path / "file").write_text("")
    for words, message in [
        ((without,), 'beads run bare.toml --engine verlet --set run.record=\'["forces", "state"]\''),
        ((damaged,), "altered since"),
        ((alien,), "body_3_height_m"),
        ((tmp_path,), "no record of a run"),
        ((kept, "--frames", "1"), "whole numbers from 2"),
        ((kept, "--frames", "many"), "whole numbers from 2"),
        ((kept, "--results", tmp_path / "file"), "is a file"),
    ]:
        refused = beads("vtk", *words)
        assert refused.returncode == 2, refused.stderr
        assert message in refused.stderr
        assert len(refused.stderr.strip().splitlines()) == 1


@pytest.mark.parametrize(("sides", "rings"), [(3, 6), (8, 24), (48, 153), (48, 2)])
def test_the_bore_as_triangles(sides: int, rings: int) -> None:
    points, triangles = tube_mesh(0.0025, -0.01, 0.04, sides, rings)
    corners = points[triangles]
    edges = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2)
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    area = np.linalg.norm(normal, axis=1) / 2
    middle = corners.mean(axis=1)
    assert (np.einsum("ij,ij->i", normal[:, :2], middle[:, :2]) < 0).all()  # inwards
    assert np.abs(normal[:, 2]).max() < 1e-12 * np.abs(normal).max()
    distance = np.einsum("ij,ij->i", normal, corners[:, 0]) / (2 * area)
    assert distance == pytest.approx(-0.0025, rel=1e-12)  # every side touches the bore
    assert area.sum() == pytest.approx(2 * sides * np.tan(np.pi / sides) * 0.0025 * 0.05, rel=1e-12)
    assert [points[:, 2].min(), points[:, 2].max()] == [-0.01, 0.04]
    if rings > 2:
        assert (edges.max(axis=1) / edges.min(axis=1)).max() < 1.6  # the halves of a square: sqrt(2)
    sides_of, counts = np.unique(np.sort(np.stack([triangles, np.roll(triangles, 1, 1)], -1).reshape(-1, 2)),
                                 axis=0, return_counts=True)  # fmt: skip
    assert set(counts) == {1, 2}
    open_ends = points[sides_of[counts == 1], 2]
    assert len(open_ends) == 2 * sides  # the two ends are the only holes
    assert set(open_ends.ravel()) == {-0.01, 0.04}


def test_a_striker_is_no_bead_of_the_tube(scene_file: SceneWriter, shared_runs: Path, tmp_path: Path) -> None:
    wide = STRIKER.replace("4.76 mm", "9 mm")
    run = a_run(scene_file(striker=wide, wall=WALL + TUBE), shared_runs)
    series = write_series(run, tmp_path / "series", 3)
    frames = [read_grid(path) for _, path in read_index(series[0])]
    top = max(grid.point_m[:5, 2].max() for grid in frames) + 0.00238
    assert read_grid(series[1]).point_m[:, 2].max() == pytest.approx(top, rel=1e-12)
