"""Tests of files of users: a pipe or a device in place of any of them is refused at once, in one line."""

import os
from pathlib import Path

import pytest

from validation.tests.helpers.commands import beads
from validation.tests.helpers.scenes import SceneWriter, StudyWriter

DRIVE = '[drive]\nfrom_wall = 5\nform = "file"\nfile = "{0}"\n'


@pytest.fixture(params=["pipe", "device"])
def odd(request: pytest.FixtureRequest, tmp_path: Path) -> Path:
    """A file that never ends, or that nobody writes to."""
    path = tmp_path / "odd.toml"
    if request.param == "pipe":
        os.mkfifo(path)
    else:
        path.symlink_to("/dev/zero")
    return path


@pytest.fixture
def deck(scene_file: SceneWriter, tmp_path: Path) -> Path:
    """Folder with a deck of ``verlet`` that can be imported."""
    scene, folder = scene_file("made", duration="20 us"), tmp_path / "deck"
    assert beads("render", scene, "--engine", "verlet", "--out", folder).returncode == 0
    return folder


def is_refused(odd: Path, *words: str | Path) -> bool:
    """True if a command names the file and ends with code 2 and one line."""
    done = beads(*words)
    assert done.stderr.count("\n") == 1, done.stderr
    assert odd.name in done.stderr
    assert "no regular file" in done.stderr
    return done.returncode == 2


@pytest.mark.timeout(60)
def test_scenes_studies_engines_and_measured_files(
    odd: Path, scene_file: SceneWriter, study_file: StudyWriter, tmp_path: Path
) -> None:
    plain = scene_file("plain")
    assert is_refused(odd, "plan", odd)
    assert is_refused(odd, "batch", odd)
    assert is_refused(odd, "plan", plain, "--engines", odd)
    assert is_refused(odd, "claims", "--file", odd, "--results", tmp_path / "results")
    assert is_refused(odd, "overlay", plain, "--measured", odd, "--results", tmp_path / "results")
    assert is_refused(odd, "plan", scene_file("driven", striker="", chain=DRIVE.format(odd.name)))
    assert is_refused(odd, "batch", study_file(f'[[axis]]\ntable = "{odd.name}"\n', "verlet"))


@pytest.mark.timeout(60)
@pytest.mark.parametrize("name", ["chain.json", "chain.npy", "stdout.txt", "scene.json"])
def test_decks_and_their_output(name: str, odd: Path, deck: Path, tmp_path: Path) -> None:
    (deck / name).unlink(missing_ok=True)
    place = odd.rename(deck / name)
    assert is_refused(place, "import", deck, "--engine", "verlet", "--runs", tmp_path / "runs")
