"""Scenes drawn to scale."""

from math import atan2, radians
from pathlib import Path

import pytest
from matplotlib.patches import Circle

from postproc.draw.product import Product, write_product
from postproc.draw.scene_drawing import draw_scene
from validation.tests.helpers.commands import beads
from validation.tests.helpers.scenes import SceneWriter, case_of

PAPER = ("fig4", "fig5", "fig6b", "fig6d", "table1")


@pytest.mark.parametrize("scene", PAPER)
def test_the_paper_s_scenes(scene: str) -> None:
    case = case_of(scene)
    _, table = draw_scene(case.scene, case.chain)
    assert len(table) == case.chain.bodies
    assert (table["height_m"] == table["drawn_height_m"]).all()
    assert list(table["role"]).count("sensor") == len(case.scene.chain.sensors)


@pytest.mark.parametrize(
    "settings",
    [
        ("chain.count=0", "chain.sensors=[]"),
        ("chain.count=1", "chain.sensors=[]"),
        ("striker=",),
        ("wall=", "gravity="),
        ("wall=", "gravity=", "striker=", "chain.bead=[{ from_wall = 1, velocity = '1 m/s' }]"),
        ("chain.bead=[{ from_wall = 3, diameter = '1 m' }]", "striker.diameter=1 um", "tube=", "gravity="),
        ("chain.bead=[{ from_wall = 8, gap_below = '10 mm' }]",),
        ("tube=",),
        ("tube.inner_diameter=50 mm",),
        ("striker.shape=flat", "striker.diameter=", "striker.material=alumina"),
        ("chain.bead=[{ from_wall = 8, gap_below = '100 m' }]",),
        ("tube.inner_diameter=1 m",),
        ("tube.top=3 m",),
        ("tube.top=0 mm",),
        ("striker.shape=flat", "striker.diameter=", "striker.mass=50 kg"),
        ("chain.count=2000", "chain.sensors=[{ from_wall = 1500 }, { from_wall = 3 }]"),
        ("chain.count=100000",),
    ],
)
def test_any_scene_can_be_drawn(settings: tuple[str, ...], tmp_path: Path) -> None:
    case = case_of("fig4", *settings)
    figure, table = draw_scene(case.scene, case.chain)
    width, height = figure.get_size_inches()
    assert 0.3 < height < 9
    assert width < 5
    assert len(table) <= case.chain.bodies
    write_product(Product(figure, table), "scene", tmp_path)


def test_a_long_chain_is_cut_but_keeps_its_ends_and_sensors() -> None:
    case = case_of("fig4", "chain.count=500")
    _, table = draw_scene(case.scene, case.chain)
    assert set(table["body"]) >= {1, 2, 500, 501, 9, 5}
    assert len(table) < 60
    below = table["drawn_height_m"].diff().iloc[1:]
    assert (below > 0).all()


def test_special_beads_are_drawn_in_a_long_chain() -> None:
    case = case_of("fig4", "chain.count=1000", "chain.bead=[{ from_wall = 400, diameter = '4 mm' }]")
    figure, table = draw_scene(case.scene, case.chain)
    assert 400 in set(table["body"])
    words = " ".join(text.get_text() for text in figure.axes[0].texts)
    assert "bead 400: ⌀ 4 mm" in words
    for cut in ("590 beads", "386 beads"):
        assert cut in words


def test_members_of_a_pattern_are_drawn_and_named() -> None:
    case = case_of(
        "fig4", "chain.mass=", "chain.sensors=[]", "chain.taper=0.98", "chain.pattern=[{}, {material='steel'}]"
    )
    figure, table = draw_scene(case.scene, case.chain)
    words = " ".join(" ".join(text.get_text() for text in figure.axes[0].texts).split())
    lightest, heaviest = table["mass_kg"][19], table["mass_kg"][1]
    assert "21 beads in turn: ptfe ⌀ 4.76 mm to 3.178 mm" in words
    assert f"{1e3 * heaviest:.4g} to {1e3 * lightest:.4g} g each" in words
    colours = [patch.get_facecolor() for patch in figure.axes[0].patches if isinstance(patch, Circle)][:21]
    assert len(set(colours)) == 2
    assert len(set(colours[::2])) == len(set(colours[1::2])) == 1


@pytest.mark.parametrize("angle_deg", [30, 90])
def test_a_leaning_chain_is_drawn_at_its_angle(angle_deg: int) -> None:
    case = case_of("fig4", f"chain.angle={angle_deg} deg")
    figure, _ = draw_scene(case.scene, case.chain)
    figure.canvas.draw()
    (axis,) = figure.axes
    centres = [each.get_transform().transform((0, 0)) for each in axis.patches if isinstance(each, Circle)]
    across, up = centres[20] - centres[0]
    assert atan2(-across, up) == pytest.approx(radians(angle_deg))
    for artist in [*axis.patches, *axis.texts]:
        assert (artist.get_window_extent().extents > -1).all()
        assert (artist.get_window_extent().max < figure.bbox.max + 1).all()


def test_on_the_command_line(scene_file: SceneWriter, tmp_path: Path) -> None:
    done = beads("draw", scene_file("mine"), "--set", "chain.count=7", "--results", tmp_path / "out")
    assert done.returncode == 0, done.stderr
    assert {path.name for path in (tmp_path / "out").glob("[!.]*")} == {
        f"scene-mine.{e}" for e in ("csv", "png", "svg")
    }
    refused = beads("draw", "no-such-scene", "--results", tmp_path / "out")
    assert refused.returncode == 2
    assert len(refused.stderr.strip().splitlines()) == 1
