"""Tests of reading back: a file is as it was written, or is refused by name in one line, or made again."""

import json
import os
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from drivers.base.errors import InputError
from drivers.batch import rows
from drivers.batch.tables import read_study_table
from drivers.run.run_folder import FORCES, RECORD, SENSORS, STATE, EndedRun, find_run, open_run, record_of
from validation.tests.helpers.commands import beads
from validation.tests.helpers.runs import finished
from validation.tests.helpers.scenes import SPEEDS, SceneWriter, StudyWriter, case_of

FLIPS = 20
WITH_STATE = 'run.record=["forces", "state"]'


@pytest.fixture(scope="module")
def shared(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder of the runs that ``pair`` copies."""
    return tmp_path_factory.mktemp("reads")


@pytest.fixture
def pair(scene_file: SceneWriter, shared: Path, tmp_path: Path) -> tuple[Path, Path]:
    """Copies of two runs with positions, at two speeds."""
    speeds = ("striker.speed=1 m/s", "striker.speed=2 m/s")
    runs = [finished(case_of(scene_file("twin"), WITH_STATE, speed), "verlet", shared) for speed in speeds]
    first, second = (shutil.copytree(run.folder, tmp_path / "runs" / "verlet" / run.folder.name) for run in runs)
    return first, second


def read_all(folder: Path) -> EndedRun:
    """A run, with everything that is read back."""
    run = open_run(folder)
    assert len(run.trace.time_s) == len(run.state.time_s)
    return run


def flip(path: Path, seed: int) -> None:
    """Flip a random bit of a file."""
    content, random = bytearray(path.read_bytes()), np.random.default_rng(seed)
    content[random.integers(len(content))] ^= 1 << int(random.integers(8))
    path.write_bytes(content)


def in_place_of(path: Path, make: Callable[[Path], object]) -> None:
    path.unlink()
    make(path)


def edited(path: Path, **changes: object) -> None:
    """Change a record without sealing it again."""
    path.write_text(json.dumps(json.loads(path.read_text()) | changes))


EDITS: dict[str, Callable[[Path], object]] = {
    "a faster run": lambda path: edited(path, wall_s=1e-9),
    "a smaller error": lambda path: edited(path, exact_to=0.0),
    "another layout": lambda path: edited(path, layout=5),
    "no digest": lambda path: edited(path, sha256=None),
}
DAMAGE: dict[str, Callable[[Path], object]] = {
    "cut": lambda path: path.write_bytes(path.read_bytes()[:-100]),
    "empty": lambda path: path.write_bytes(b""),
    "longer": lambda path: path.write_bytes(path.read_bytes() + b"{}"),
    "not utf-8": lambda path: path.write_bytes(b"\xff\xfe\x00" * 9),
    "missing": Path.unlink,
    "a pipe": lambda path: in_place_of(path, os.mkfifo),
    "a dangling link": lambda path: in_place_of(path, lambda link: link.symlink_to("nowhere")),
    "a loop of links": lambda path: in_place_of(path, lambda link: link.symlink_to(link)),
    "a number": lambda path: path.write_text("5"),
    "a deep list": lambda path: path.write_text("[" * 100_000),
    "not finite": lambda path: path.write_text('{"a": 1e999, "b": NaN, "sha256": 5}'),
    "thousands of digits": lambda path: path.write_text('{"a": ' + "9" * 5000 + "}"),
}


@pytest.mark.parametrize("name", [FORCES, STATE, RECORD])
def test_damaged_file_of_a_run_is_refused_in_one_line(name: str, pair: tuple[Path, Path]) -> None:
    path = pair[0] / name
    content, right = path.read_bytes(), read_all(pair[0])
    for kind, damage in (DAMAGE | (EDITS if name == RECORD else {})).items():
        damage(path)
        with pytest.raises(InputError) as refused:
            read_all(pair[0])
        assert name in str(refused.value), kind
        assert len(str(refused.value).splitlines()) == 1, kind
        path.unlink(missing_ok=True)
        path.write_bytes(content)
    for seed in range(FLIPS):
        flip(path, seed)
        try:
            run = read_all(pair[0])
        except InputError:
            pass
        else:
            assert name == RECORD, seed  # blanks of the record have no meaning
            assert run.record == right.record
        path.write_bytes(content)
    shutil.copy(pair[1] / name, path)
    with pytest.raises(InputError, match="altered since"):
        read_all(pair[0])


def test_a_run_in_a_folder_of_another_name_is_not_taken_for_another(pair: tuple[Path, Path], tmp_path: Path) -> None:
    one, other = pair
    identities = [record_of(folder).identity for folder in pair]
    other.rename(tmp_path / "aside")
    one.rename(other)
    assert read_all(other).record.identity == identities[0]
    assert [find_run(other.parent, identity, {}) for identity in identities] == [None, None]


def test_damaged_run_is_made_again_with_one_line(
    scene_file: SceneWriter, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    case = case_of(scene_file(), WITH_STATE)
    first = finished(case, "verlet", tmp_path)
    right = {name: (first.folder / name).read_bytes() for name in (FORCES, SENSORS)}
    for name, damaged in ((FORCES, True), (STATE, True), (RECORD, True), (FORCES, False), (SENSORS, True)):
        if damaged:
            flip(first.folder / name, 2)
        else:
            (first.folder / name).unlink()
        capsys.readouterr()
        again = finished(case, "verlet", tmp_path)
        (line,) = capsys.readouterr().err.splitlines()
        assert name in line
        assert line.endswith(": written again" if name == SENSORS else ": run again")
        assert again.folder == first.folder
        assert {kept: (first.folder / kept).read_bytes() for kept in right} == right
        assert len(read_all(first.folder).trace.time_s) == case.scene.samples


def test_rows_of_a_study_are_read_as_its_file_is_now(
    study_file: StudyWriter, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Another title of the study changes no case; rows of an earlier program still count."""
    path, scene, runs = study_file(SPEEDS.format(2), "verlet"), tmp_path / "scene.toml", tmp_path / "runs"
    assert beads("batch", path, "--runs", runs, "--slice", "1/1").returncode == 0
    right = read_study_table(path, runs)
    assert list(right["striker.speed_m_s"]) == [0.5, 2.0]
    assert right["wall_peak_N"].notna().all()
    path.write_text(f'title = "new"\n{path.read_text()}')
    pd.testing.assert_frame_equal(read_study_table(path, runs), right)
    for source, old, new in ((path, "2 m/s", "3 m/s"), (scene, "count = 5", "count = 4")):
        text = source.read_text()
        source.write_text(text.replace(old, new))
        status = read_study_table(path, runs)["status"] if source == path else None
        assert status is None or list(status) == ["done", "to do"]
        if source == scene:
            with pytest.raises(InputError, match="no rows of the study study as it is now; run beads batch"):
                read_study_table(path, runs)
        source.write_text(text)
    assert capsys.readouterr().err == ""
    monkeypatch.setattr(rows, "digest_of_sources", lambda: "of another version")
    pd.testing.assert_frame_equal(read_study_table(path, runs), right)
    assert capsys.readouterr().err.startswith("2 of 2 rows are of an earlier version")
