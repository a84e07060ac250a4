"""The ParaView series, read again, and the mesh of the tube."""

import shutil
from collections.abc import Callable
from pathlib import Path
from xml.etree import ElementTree

import meshio
import numpy as np
import pytest

from drivers.chain.chain import Array
from drivers.run.run_folder import STATE, EndedRun, open_run
from postproc.draw.vtk import tube_mesh, write_series
from postproc.read.signals import mean_forces
from validation.tests.helpers.commands import beads
from validation.tests.helpers.runs import edit_table, finished
from validation.tests.helpers.scenes import WALL, SceneWriter, case_of

TUBE = '[tube]\ninner_diameter = "5 mm"\nmaterial = "ptfe"\n'
FLAT_STRIKER = '[striker]\nshape = "flat"\nmaterial = "alumina"\nmass = "0.47 g"\nspeed = "0.44 m/s"\n'
RADIUS_M = 0.00238

Runner = Callable[..., EndedRun]


@pytest.fixture
def run_of(scene_file: SceneWriter, shared_runs: Path) -> Runner:
    """Runs the small scene with replaced parts, and keeps positions."""

    def run(**parts: str) -> EndedRun:
        return finished(case_of(scene_file(**parts), 'run.record=["forces", "state"]'), "verlet", shared_runs)

    return run


def read_index(path: Path) -> list[tuple[float, Path]]:
    """Times and files of a series."""
    frames = ElementTree.parse(path).getroot().findall("Collection/DataSet")
    return [(float(frame.attrib["timestep"]), path.parent / frame.attrib["file"]) for frame in frames]


def test_a_series_has_the_values_of_the_run_to_the_last_bit(run_of: Runner, tmp_path: Path) -> None:
    """Sideways motion and forces of the bore are made up. A flat striker is a sphere that touches where its face is."""
    run = run_of(striker=FLAT_STRIKER, wall=WALL + TUBE)
    folder = tmp_path / run.folder.name
    shutil.copytree(run.folder, folder)
    random, place_m, velocity_m_s = np.random.default_rng(1), run.state.place_m, run.state.velocity_xyz_m_s
    moved: dict[str, Array] = {}
    for ending, values in (("m", place_m), ("velocity_m_s", velocity_m_s)):
        values[..., :2] = random.normal(size=(*values.shape[:2], 2))
        moved |= {f"body_{j + 1}_{'xy'[k]}_{ending}": values[:, j, k] for j in range(6) for k in range(2)}
    bore_N = random.normal(size=place_m.shape[:2])
    bore_N[:, 5] = 0.0  # the striker stays above the tube
    edit_table(folder, lambda table: table.assign(**moved), STATE)
    edit_table(folder, lambda table: table.assign(**{f"bore_{j + 1}_N": bore_N[:, j] for j in range(6)}))
    written = write_series(open_run(folder), tmp_path / "series", 7)
    assert [path.name for path in written] == ["chain.pvd", "tube.vtu"]
    index, time_s, force_N = read_index(written[0]), run.trace.time_s, mean_forces(run.trace.force_N)
    chosen = np.searchsorted(time_s, [at_s for at_s, _ in index])
    assert (len(chosen), chosen[0], chosen[-1]) == (7, 0, len(time_s) - 1)
    place_m[:, 5, 2] += RADIUS_M
    for sample, (at_s, path) in zip(chosen, index, strict=True):
        assert at_s == time_s[sample]
        mesh = meshio.read(path)
        assert np.array_equal(mesh.points, place_m[sample])
        assert [(cells.type, cells.data.tolist()) for cells in mesh.cells] == [("vertex", [[j] for j in range(6)])]
        expected = {"body": np.arange(1, 7), "radius_m": np.full(6, RADIUS_M), "velocity_m_s": velocity_m_s[sample]}
        expected |= {"force_N": force_N[sample], "bore_N": bore_N[sample]}
        assert mesh.point_data.keys() == expected.keys()
        assert all(np.array_equal(mesh.point_data[name], values) for name, values in expected.items())
    tube = meshio.read(written[1])  # it reaches over the bodies that fit, so not over the striker
    top_m = place_m[chosen, :5, 2].max() + RADIUS_M
    assert [tube.points[:, 2].min(), tube.points[:, 2].max()] == pytest.approx([0, top_m], rel=1e-12)
    assert np.hypot(*tube.points[:, :2].T).min() == pytest.approx(0.0025, rel=3e-3)
    assert tube.cells[0].type == "quad"


def test_a_series_replaces_a_longer_one_and_an_interrupted_one_leaves_no_files(
    run_of: Runner, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    run, home = run_of(), tmp_path / "out"
    write_series(run, home / "former", 9)
    (home / "former" / "view.pvsm").write_text("of the user")
    write_series(run, home / "former", 4)
    frames = [path.name for _, path in read_index(home / "former" / "chain.pvd")]
    assert {path.name for path in (home / "former").iterdir()} == {*frames, "chain.pvd", "view.pvsm"}
    before = {path: path.read_bytes() for path in home.rglob("*") if path.is_file()}

    write = meshio.write

    def break_off(path: Path, mesh: meshio.Mesh) -> None:
        if path.name == "chain-00002.vtu":
            path.write_text("<VTKFile")
            raise KeyboardInterrupt
        write(path, mesh)

    monkeypatch.setattr(meshio, "write", break_off)
    for name in ("former", "new"):
        with pytest.raises(KeyboardInterrupt):
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
        ((kept, "--frames", "1"), "1 is not in the range 2<=x"),
    ]:
        refused = beads("vtk", *words)
        assert (refused.returncode, refused.stderr.count("\n")) == (2, 1)
        assert message in refused.stderr


def test_the_bore_is_an_open_prism() -> None:
    mesh = tube_mesh(0.0025, -0.01, 0.04)
    quads = mesh.cells[0].data
    corners = mesh.points[quads]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    area = np.linalg.norm(normal, axis=1)
    distance = np.einsum("ij,ij->i", normal, corners[:, 0]) / area
    assert distance == pytest.approx(-0.0025, rel=1e-12)  # normals point inwards, every side touches the bore
    assert area.sum() == pytest.approx(2 * len(quads) * np.tan(np.pi / len(quads)) * 0.0025 * 0.05, rel=1e-12)
    edges = np.sort(np.stack([quads, np.roll(quads, 1, 1)], -1).reshape(-1, 2))
    edges, counts = np.unique(edges, axis=0, return_counts=True)
    assert set(counts) == {1, 2}
    assert np.unique(mesh.points[edges[counts == 1], 2]).tolist() == [-0.01, 0.04]  # two ends are the only holes
