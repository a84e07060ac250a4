"""Contact sheets, animations and spacetime diagrams."""

import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from drivers.chain.chain import Array, build_chain
from drivers.chain.schemes import verlet_of
from drivers.run.run_folder import STATE, EndedRun, open_run
from drivers.scene.read_scene import stored_scene
from postproc.draw import drawings, plot
from postproc.draw.drawings import Film, sheet, write_animation
from postproc.draw.plot import cells_of, draw_spacetime
from postproc.read.motion import case_of_run, trace_with_state
from postproc.read.signals import mean_forces
from validation.tests.helpers.commands import beads
from validation.tests.helpers.runs import edit_table, finished
from validation.tests.helpers.scenes import SceneWriter, case_of

Runner = Callable[..., EndedRun]


@pytest.fixture
def run_of(shared_runs: Path) -> Runner:
    """Runs a scene with settings, and keeps positions."""

    def run(*settings: str | Path) -> EndedRun:
        scene, *others = settings
        case = case_of(scene, *map(str, others), 'run.record=["forces", "state"]')
        return finished(case, "verlet", shared_runs)

    return run


def filmed(run: EndedRun, frames: int, sideways: float = 1.0) -> Film:
    return Film(case_of_run(run), trace_with_state(run), frames, sideways)


def notes_of(shown: Film) -> str:
    return str(sheet(shown, "a chain").figure.axes[0].get_title("left"))


def test_a_record_gives_back_its_chain() -> None:
    case = case_of(
        "fig4", "chain.precompression=2 N", "chain.mass_scatter=0.0008 g", "seed=5", "chain.origin=0.1 m",
        "chain.mass=", "materials.ptfe.youngs_modulus=0.6 GPa", "tube.top=90 mm", "chain.bead=[{ from_wall = 8, "
        "gap_below = '10 um', material = 'steel', diameter = '4 mm', velocity = '1 m/s' }]",
    )  # fmt: skip
    record = {"units": "SI"} | case.scene.model_dump(mode="json", exclude_none=True)
    scene = stored_scene(json.loads(json.dumps(record)))
    chain = build_chain(scene)
    for name in ("height_m", "mass_kg", "radius_m", "stiffness", "overlap_m", "velocity_m_s", "load_N"):
        assert np.array_equal(getattr(chain, name), getattr(case.chain, name))
    assert (chain.wall, chain.materials) == (case.chain.wall, case.chain.materials)
    assert scene.model_dump() == case.scene.model_dump()


@pytest.mark.parametrize(
    ("settings", "frames"),
    [
        (("fig5",), 5),
        (("fig4", "chain.count=0", "chain.sensors=[]", "gravity="), 2),
        (("long-chain", "run.duration=0.1 ms"), 12),
    ],
)
def test_a_sheet_has_every_body_at_every_time(settings: tuple[str, ...], frames: int, run_of: Runner) -> None:
    run = run_of(*settings)
    product = sheet(filmed(run, frames), "a chain")
    table, forces = product.table.set_index(["time_s", "body"]), mean_forces(run.trace.force_N)
    assert len(table) == frames * run.record.bodies
    for sample in (0, -1):
        rows = table.loc[run.trace.time_s[sample]]
        assert np.array_equal(rows["height_m"], run.state.place_m[sample, :, 2])
        assert np.array_equal(rows["force_N"], forces[sample])
    product.figure.draw_without_rendering()


def test_sideways_displacements_are_exaggerated_only_with_a_note(run_of: Runner, tmp_path: Path) -> None:
    run = run_of("fig4")
    folder = tmp_path / run.folder.name
    shutil.copytree(run.folder, folder)
    across = {f"body_{body}_{axis}_m": 1.2e-4 * (body == 3 and axis == "x") for body in range(1, 23) for axis in "xy"}
    edit_table(folder, lambda state: state.assign(**across), STATE)  # bead 3 touches the tube
    for factor, shown in ((1, filmed(open_run(folder), 3)), (8, filmed(open_run(folder), 3, 8.0))):
        assert (shown.place_m[:, 2, 0] == factor * 1.2e-4).all()
        assert shown.bore_m == pytest.approx(shown.place_m[0, 2, 0] + 0.00238)
        assert (f"sideways displacements {factor} times" in notes_of(shown)) == (factor != 1)


def test_without_positions_bodies_stay_where_they_were(scene_file: SceneWriter, shared_runs: Path) -> None:
    case = case_of(scene_file("still", duration="0.15 ms"))
    shown = filmed(finished(case, "verlet", shared_runs), 4)
    assert (shown.place_m[:, :, 1] == case.chain.height_m).all()
    assert shown.force_N[1].max() > 0.1
    assert "kept no others" in notes_of(shown)


def test_an_interrupted_animation_leaves_the_former(
    run_of: Runner, scene_file: SceneWriter, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    save, path = Image.Image.save, tmp_path / "out" / "film.gif"
    path.parent.mkdir()
    path.write_text("the former")

    def break_off(image: Image.Image, file: Any, *words: Any, **look: Any) -> None:
        save(image, file, *words, **look)
        raise KeyboardInterrupt

    monkeypatch.setattr(Image.Image, "save", break_off)
    with pytest.raises(KeyboardInterrupt):
        write_animation(filmed(run_of(scene_file()), 2), "a chain", path)
    assert [(file, file.read_bytes()) for file in path.parent.iterdir()] == [(path, b"the former")]


def test_a_weak_wave_on_a_load_is_drawn_as_changes_of_both_signs() -> None:
    for scene, loaded in (("fig4", False), ("driven-steel", True)):
        trace = verlet_of(case_of(scene))
        product = draw_spacetime({scene: trace})
        force_N = trace.force_N - trace.force_N[0] if loaded else trace.force_N
        table = product.table.filter(like="_change_N" if loaded else "contact_")
        assert (table.to_numpy().max(), table.shape[1]) == (force_N.max(), force_N.shape[1])
        assert not loaded or table.to_numpy().min() == force_N.min()
        assert ("change from static force" in product.figure.axes[1].get_ylabel()) == loaded


def test_cells_keep_the_largest_force(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(plot, "COLUMNS", 100)
    monkeypatch.setattr(plot, "ROWS", 10)
    force = np.random.default_rng(3).random((1001, 37))
    samples_s: Array = np.arange(1001.0) * 1e-6
    time_s, contact, cells_N = cells_of(samples_s, force)
    assert cells_N.shape == (len(contact), len(time_s)) == (10, 91)
    assert cells_N[2, 5] == force[55:66, 8:12].max()
    assert cells_N[-1, -1] == force[990:, 36:].max()
    assert (contact[2], time_s[5]) == (9, 1e-6 * 55)
    monkeypatch.undo()
    assert (cells_of(samples_s[:50], force[:50])[2] == force[:50].T).all()


def test_commands_write_their_files_or_refuse_in_one_line(
    run_of: Runner, scene_file: SceneWriter, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = run_of(scene_file()).folder
    monkeypatch.setattr(drawings, "GIF_FRAMES", 5)
    for command, kinds in (("film", {"csv", "png", "svg", "gif"}), ("spacetime", {"csv", "png", "svg"})):
        frames = ("--frames", "3") if command == "film" else ()
        done = beads(command, folder, *frames, "--results", tmp_path / command)
        assert done.returncode == 0, done.stderr
        names = {path.name for path in (tmp_path / command).glob("[!.]*")}
        assert names == {f"{command}-verlet-{folder.name}.{kind}" for kind in kinds}
    with Image.open(tmp_path / "film" / f"film-verlet-{folder.name}.gif") as animation:
        assert animation.n_frames == 5  # type: ignore[attr-defined]
    for words in (("film", folder, "--frames", "0"), ("film", folder, "--sideways", "-1"), ("spacetime", tmp_path)):
        refused = beads(*words)
        assert (refused.returncode, refused.stderr.count("\n")) == (2, 1)
