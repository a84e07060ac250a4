"""Decks: snapshots of the paper's scenes, nothing in them that the scene does not need, runnable by hand."""

import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from drivers.engines import load_engine
from drivers.process import scrubbed_environment
from drivers.trace import read_forces
from validation.tests.conftest import SceneWriter, case_of, finished, need

SNAPSHOTS = Path(__file__).parent / "decks"
PAPER = ("fig4", "fig5", "fig6b", "fig6d")


@pytest.mark.parametrize("engine", ["liggghts", "yade"])
@pytest.mark.parametrize("scene", PAPER)
def test_decks_of_the_paper_stay_as_they_are(scene: str, engine: str, request: pytest.FixtureRequest) -> None:
    for name, text in load_engine(engine).render(case_of(scene)).files.items():
        kept = SNAPSHOTS / f"{scene}.{engine}.{name}.txt"
        if request.config.getoption("--update-decks"):
            kept.write_text(text)
        assert text == kept.read_text(), f"{kept.name} differs; if it should: pytest --update-decks"


# a setting that takes the element out of (or into) fig4, and the word each deck has if and only if it is modelled
NEEDED_BY = {
    "precompression": ("chain.precompression=2 N", {"liggghts": "addforce", "yade": "setPermF"}),
    "gravity": ("gravity=", {"liggghts": "gravity", "yade": "gravity"}),
    "damping": ("contact.restitution=0.9", {"liggghts": "limitForce", "yade": "betan"}),
    "wall": ("wall=", {"liggghts": "wall/gran", "yade": "utils.wall"}),
}


@pytest.mark.parametrize("element", NEEDED_BY)
@pytest.mark.parametrize("engine", ["liggghts", "yade"])
def test_no_line_for_an_element_that_is_out(element: str, engine: str) -> None:
    setting, words = NEEDED_BY[element]

    def main_file(*settings: str) -> str:
        files = load_engine(engine).render(case_of("fig4", *settings)).files
        return next(text for name, text in files.items() if name in ("chain.in", "chain.py"))

    for settings in ((), (setting,)):
        assert (words[engine] in main_file(*settings)) == case_of("fig4", *settings).models(element)
    assert case_of("fig4").models(element) != case_of("fig4", setting).models(element)


@pytest.mark.parametrize("engine", ["liggghts", "yade"])
def test_straight_decks_have_no_tube_friction_or_rotation(engine: str) -> None:
    text = "".join(load_engine(engine).render(case_of("fig4", "contact.friction=0.3")).files.values()).lower()
    for word in ("cylinder", "facet", "coefficientfriction", "nve/sphere", "tangential history", "inertia ="):
        assert word not in text


def test_equal_physics_is_an_equal_deck(scene_file: SceneWriter) -> None:
    for engine in ("liggghts", "yade", "verlet", "reference"):
        one = load_engine(engine).render(case_of(scene_file("one", top='title = "one"')))
        other = load_engine(engine).render(case_of(scene_file("other", top='title = "other"')))
        assert one.sha256 == other.sha256


@pytest.mark.parametrize("engine", ["liggghts", "yade", "verlet"])
def test_a_deck_run_by_hand_gives_the_same_output(engine: str, shared_runs: Path, tmp_path: Path) -> None:
    need(engine)
    case = case_of("fig4")
    run = finished(case, engine, shared_runs)
    adapter = load_engine(engine)
    folder = tmp_path / "by-hand"
    shutil.copytree(run.folder, folder)
    first = (folder / next(iter(adapter.render(case).files))).read_text().splitlines()[0]
    command = first.removeprefix("# ").removeprefix('{"command": "').removesuffix('",')
    environment = scrubbed_environment()
    environment["PATH"] = f"{Path(sys.executable).parent}:{environment['PATH']}"
    with open(folder / "stdout.txt", "w") as out:
        subprocess.run(command, shell=True, cwd=folder, env=environment, stdout=out, check=True, timeout=100)
    np.testing.assert_array_equal(
        adapter.read(case, folder).force_N, read_forces(run.folder / "forces.parquet").force_N
    )
