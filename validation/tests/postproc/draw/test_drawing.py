"""Scenes drawn to scale."""

from pathlib import Path

import pandas as pd
import pytest

from postproc.draw.drawings import draw_scene
from postproc.draw.plot import pyplot
from validation.tests.helpers.commands import beads
from validation.tests.helpers.scenes import SceneWriter, case_of


def test_a_short_chain_is_drawn_where_it_is(scene_file: SceneWriter, tmp_path: Path) -> None:
    done = beads("draw", scene_file("mine"), "--set", "chain.sensors=[{ from_wall = 2 }]", "--results", tmp_path)
    assert done.returncode == 0, done.stderr
    table = pd.read_csv(tmp_path / "scene-mine.csv")
    assert (table["height_m"] == table["drawn_height_m"]).all()
    assert [*table["role"]] == ["bead", "sensor", "bead", "bead", "bead", "striker"]
    assert {path.suffix for path in tmp_path.glob("scene-mine.*")} == {".csv", ".png", ".svg"}


@pytest.mark.parametrize(
    "settings",
    [
        ("wall=", "gravity=", "striker=", "chain.bead=[{ from_wall = 1, velocity = '1 m/s' }]"),
        ("chain.bead=[{ from_wall = 3, diameter = '1 m' }]", "striker.diameter=1 um", "tube=", "gravity="),
        ("striker.shape=flat", "striker.diameter=", "striker.mass=50 kg"),
        ("chain.count=0", "chain.sensors=[]"),
        ("chain.bead=[{ from_wall = 8, gap_below = '100 m' }]",),
        ("tube.top=3 m",),
        ("chain.count=100000",),
    ],
)
def test_any_scene_fits_a_column(settings: tuple[str, ...]) -> None:
    case = case_of("fig4", *settings)
    figure, _ = draw_scene(case.scene, case.chain)
    width, height = figure.get_size_inches()
    assert width < 5
    assert 0.3 < height < 9
    figure.draw_without_rendering()
    pyplot().close(figure)


def test_a_long_chain_is_cut_but_keeps_its_ends_sensors_and_special_beads() -> None:
    case = case_of("fig4", "chain.count=1000", "chain.bead=[{ from_wall = 400, diameter = '4 mm' }]")
    figure, table = draw_scene(case.scene, case.chain)
    assert set(table["body"]) >= {1, 2, 5, 9, 400, 1000, 1001}
    assert len(table) < 60
    assert (table["drawn_height_m"].diff().iloc[1:] > 0).all()
    drawn = " ".join(text.get_text() for text in figure.axes[0].texts)
    assert all(text in drawn for text in ("bead 400: ⌀ 4 mm", "590 beads", "386 beads"))
