"""Contact sheets, animations and spacetime diagrams."""

import json
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from drivers.chain.chain import build_chain
from drivers.chain.trace import Trace
from drivers.run.run_folder import STATE, open_run
from drivers.scene.read_scene import stored_scene
from postproc.draw import film
from postproc.draw.film import film_of, sheet, write_animation
from postproc.draw.product import cells_of, draw_spacetime, write_product
from postproc.read.sensors import mean_forces
from validation.tests.helpers.commands import beads
from validation.tests.helpers.runs import edit_table, finished
from validation.tests.helpers.scenes import SceneWriter, case_of

pytestmark = pytest.mark.long

WITH_STATE = 'run.record=["forces", "state"]'
ODD = (
    "chain.precompression=2 N", "chain.mass_scatter=0.0008 g", "seed=5", "chain.origin=0.1 m", "chain.mass=",
    "chain.bead=[{ from_wall = 8, gap_below = '10 um', material = 'steel', diameter = '4 mm', velocity = '1 m/s' }]",
    "materials.ptfe.youngs_modulus=0.6 GPa", "tube.top=90 mm",
)  # fmt: skip


@pytest.mark.parametrize("settings", [("fig4",), ("fig5",), ("fig6b",), ("steel-chain",), ("fig4", *ODD)])
def test_a_record_gives_back_its_chain(settings: tuple[str, ...]) -> None:
    case = case_of(*settings)
    stored = json.loads(json.dumps({"units": "SI"} | case.scene.model_dump(mode="json", exclude_none=True)))
    scene = stored_scene(stored)
    found = build_chain(scene)
    for name in ("height_m", "mass_kg", "radius_m", "stiffness", "overlap_m", "velocity_m_s", "load_N"):
        assert (getattr(found, name) == getattr(case.chain, name)).all()
    assert (found.wall, found.materials) == (case.chain.wall, case.chain.materials)
    assert scene.model_dump() == case.scene.model_dump()


@pytest.mark.parametrize(
    ("settings", "frames"),
    [
        (("fig4", "chain.count=3", "chain.sensors=[]"), 12),
        (("fig4",), 12),
        (("fig5",), 5),
        (("fig6d",), 40),
        (("fig4", "chain.count=0", "chain.sensors=[]", "gravity="), 2),
        (("fig4", "wall=", "tube=", "gravity="), 3),
        (("fig4", "chain.bead=[{ from_wall = 8, gap_below = '10 m' }]", "gravity="), 3),
        (("long-chain", "run.duration=1 ms"), 12),
    ],
)
def test_a_sheet_has_every_body_at_every_time(
    settings: tuple[str, ...], frames: int, shared_runs: Path, tmp_path: Path
) -> None:
    run = finished(case_of(*settings, WITH_STATE), "verlet", shared_runs)
    product = sheet(film_of(run, frames), "a chain")
    table, state = product.table.set_index(["time_s", "body"]), pd.read_parquet(run.folder / "state.parquet")
    assert len(table) == frames * run.record.bodies
    forces = mean_forces(run.trace.force_N)
    for i in (0, len(state) - 1):
        own = table.loc[state["time_s"].iloc[i]]
        heights = [state[f"body_{j}_height_m"].iloc[i] for j in range(1, run.record.bodies + 1)]
        assert (own["height_m"] == heights).all()
        assert (own["force_N"] == forces[i]).all()
    width, height = product.figure.get_size_inches()
    assert width < 8
    assert 1 < height < 7
    written = write_product(product, "film", tmp_path)
    assert all(path.stat().st_size < 1e6 for path in written if path.suffix != ".csv")


def test_beads_are_drawn_to_scale_and_in_the_colour_of_their_force(shared_runs: Path) -> None:
    from matplotlib.collections import EllipseCollection

    run = finished(case_of("fig6b", WITH_STATE), "verlet", shared_runs)
    shown = film_of(run, 4)
    axis = sheet(shown, "a chain").figure.axes[0]
    drawn: list[Any] = [each for each in axis.collections if isinstance(each, EllipseCollection)]
    assert len(drawn) == 4 * 2  # the steel ball is of another size
    sizes = sorted({float(each.get_widths()[0]) for each in drawn})
    assert sizes == pytest.approx([0.002, 0.00238])
    (left, right), (low, high) = axis.get_xlim(), axis.get_ylim()
    box = axis.get_position()
    width, height = axis.figure.get_size_inches()
    across, up = (right - left) / (box.width * width), (high - low) / (box.height * height)
    assert across == pytest.approx(up, rel=1e-9)  # a circle is a circle
    dark = [each.get_facecolor()[:, :3].sum(axis=1).argmin() for each in drawn if len(each.get_offsets()) > 1]
    assert dark[1] == shown.force_N[1, :-1].argmax()


def test_sideways_displacements_are_exaggerated_only_with_a_note(shared_runs: Path, tmp_path: Path) -> None:
    run = finished(case_of("fig4", WITH_STATE), "verlet", shared_runs)
    folder = tmp_path / run.folder.name
    shutil.copytree(run.folder, folder)
    edit_table(folder, lambda state: state.assign(body_3_x_m=1.2e-4), STATE)  # it touches the tube
    plain, large = film_of(open_run(folder), 3), film_of(open_run(folder), 3, 8.0)
    assert (plain.place_m[:, 2, 0] == 1.2e-4).all()
    assert (large.place_m[:, 2, 0] == 8 * 1.2e-4).all()
    for shown in (plain, large):
        assert shown.bore_m == pytest.approx(shown.place_m[0, 2, 0] + 0.00238)
    texts = [" ".join(text.get_text() for text in sheet(shown, "t").figure.texts) for shown in (plain, large)]
    assert "sideways" not in texts[0]
    assert "8 times" in texts[1]


def test_without_positions_bodies_stay_where_they_were(scene_file: SceneWriter, shared_runs: Path) -> None:
    case = case_of(scene_file("still", duration="0.15 ms"))
    shown = film_of(finished(case, "verlet", shared_runs), 4)
    assert (shown.place_m[:, :, 1] == case.chain.height_m).all()
    assert shown.force_N[1].max() > 0.1
    assert "kept no others" in " ".join(text.get_text() for text in sheet(shown, "t").figure.texts)


def test_the_animation_is_whole_and_small(
    scene_file: SceneWriter, shared_runs: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from PIL import Image

    run = finished(case_of(scene_file(), WITH_STATE), "verlet", shared_runs)
    shown = film_of(run, 20)
    path = write_animation(shown, "a chain", tmp_path / "out" / "film.gif")
    with Image.open(path) as animation:
        assert animation.n_frames == 20  # type: ignore[attr-defined]
    assert path.stat().st_size < 1e6
    before = path.read_bytes()

    def break_off(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(film, "_draw_chain", break_off)
    with pytest.raises(KeyboardInterrupt):
        write_animation(shown, "a chain", path)
    assert path.read_bytes() == before
    assert list(path.parent.iterdir()) == [path]


def test_cells_keep_the_largest_force() -> None:
    force = np.random.default_rng(3).random((1001, 37))
    none = np.zeros(1001)
    trace = Trace(1e-6 * np.arange(1001.0), force, none, none, none)
    time_s, contact, cells_N = cells_of(trace.time_s, force, 100, 10)
    assert cells_N.shape == (len(contact), len(time_s)) == (10, 91)
    assert cells_N[2, 5] == force[55:66, 8:12].max()
    assert cells_N[-1, -1] == force[990:, 36:].max()
    assert (contact[2], time_s[5]) == (9, 1e-6 * 55)
    assert (cells_of(trace.time_s, force, 5000, 50)[2] == force.T).all()


def test_open_contacts_are_grey_and_cells_are_at_their_times_and_contacts() -> None:
    from matplotlib.colors import to_rgb

    from postproc.draw.style import OPEN_CONTACT

    force = np.zeros((50, 4))
    force[20:30, 2] = 5.0
    none = np.zeros(50)
    trace = Trace(1e-6 * np.arange(50.0), force, none, none, none)
    axis = draw_spacetime({"one": trace}, 4.0).figure.axes[0]
    (image,) = axis.images
    assert image.get_extent() == pytest.approx([0, 50, 0.5, 4.5])
    colours = image.to_rgba(image.get_array())[..., :3]
    assert np.allclose(colours[2, 20:30], colours[2, 20])
    assert colours[2, 20].sum() < 0.5
    assert np.allclose(colours[1], to_rgb(OPEN_CONTACT))


def test_on_the_command_line(scene_file: SceneWriter, shared_runs: Path, tmp_path: Path) -> None:
    folder = finished(case_of(scene_file(), WITH_STATE), "verlet", shared_runs).folder
    name = f"verlet-{folder.name}"
    for command, kinds in (("film", {"csv", "png", "svg", "gif"}), ("spacetime", {"csv", "png", "svg"})):
        done = beads(command, folder, "--results", tmp_path / command)
        assert done.returncode == 0, done.stderr
        assert {path.name for path in (tmp_path / command).glob("[!.]*")} == {
            f"{command}-{name}.{kind}" for kind in kinds
        }
    for words in (("film", folder, "--frames", "0"), ("film", folder, "--sideways", "-1"), ("spacetime", tmp_path)):
        refused = beads(*words)
        assert refused.returncode == 2
        assert len(refused.stderr.strip().splitlines()) == 1
