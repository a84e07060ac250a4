"""Reads are checks: a file is as it was written, or is refused by name in one line, or made again.

Kinds of files (of runs, of the cache, of batches, of results) and kinds of damage.
"""

import json
import os
import shutil
from collections.abc import Callable
from io import BytesIO
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from drivers.base import paths
from drivers.base.errors import InputError
from drivers.base.files import csv_of, read_sealed, read_sealed_file, sealed_file, table_in, write_sealed
from drivers.base.kept import kept
from drivers.base.units import to_si
from drivers.batch.store import ENDING, Store, _name_of
from drivers.batch.study_table import read_study_table
from drivers.run.run import run_case
from drivers.run.run_folder import FORCES, RECORD, SENSORS, STATE, EndedRun, open_run, read_record
from validation.tests.helpers.commands import beads
from validation.tests.helpers.runs import add_force, edit_record, edit_table, finished
from validation.tests.helpers.scenes import SPEEDS, SceneWriter, StudyWriter, case_of

FLIPS = 60
WITH_STATE = 'run.record=["forces", "state"]'


@pytest.fixture(scope="module")
def own_runs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Runs of these tests: others may not have the same names."""
    return tmp_path_factory.mktemp("reads")


@pytest.fixture
def pair(scene_file: SceneWriter, own_runs: Path, tmp_path: Path) -> tuple[Path, Path]:
    """Copies of two runs with positions, at two speeds."""
    settings = ((WITH_STATE,), (WITH_STATE, "striker.speed=2 m/s"))
    runs = [finished(case_of(scene_file("twin"), *each), "verlet", own_runs) for each in settings]
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


def edited_force(path: Path) -> None:
    add_force(pd.read_parquet(path), 50, 2, 1.0).to_parquet(path)


WRONG_JSON = (
    "",
    "5",
    "null",
    "[]",
    "[" * 100_000,
    '{"a": NaN}',
    '{"a": 1e999, "sha256": 5}',
    '{"a": ' + "9" * 5000 + "}",
)
DAMAGE: dict[str, Callable[[Path], object]] = {
    "cut": lambda path: path.write_bytes(path.read_bytes()[:-100]),
    "empty": lambda path: path.write_bytes(b""),
    "longer": lambda path: path.write_bytes(path.read_bytes() + b"{}"),
    "not utf-8": lambda path: path.write_bytes(b"\xff\xfe\x00" * 9),
    "missing": Path.unlink,
    "a folder": lambda path: in_place_of(path, Path.mkdir),
    "a pipe": lambda path: in_place_of(path, os.mkfifo),
    "a dangling link": lambda path: in_place_of(path, lambda link: link.symlink_to("nowhere")),
    "a loop of links": lambda path: in_place_of(path, lambda link: link.symlink_to(link)),
} | {f"json {text[:12]}": lambda path, text=text: path.write_text(text) for text in WRONG_JSON}


@pytest.mark.parametrize("name", [FORCES, STATE, RECORD])
@pytest.mark.parametrize("damage", DAMAGE)
def test_a_damaged_file_of_a_run_is_refused_in_one_line(name: str, damage: str, pair: tuple[Path, Path]) -> None:
    DAMAGE[damage](pair[0] / name)
    with pytest.raises(InputError) as refused:
        read_all(pair[0])
    assert name in str(refused.value)
    assert len(str(refused.value).splitlines()) == 1


@pytest.mark.parametrize("name", [FORCES, STATE, RECORD])
def test_no_flipped_bit_is_believed(name: str, pair: tuple[Path, Path]) -> None:
    path = pair[0] / name
    content, right = path.read_bytes(), read_all(pair[0])
    for seed in range(FLIPS):
        path.write_bytes(content)
        flip(path, seed)
        try:
            run = read_all(pair[0])
        except InputError:
            continue
        assert name == RECORD, seed  # blanks of the record have no meaning
        assert run.record == right.record


@pytest.mark.parametrize("name", [FORCES, STATE, RECORD])
def test_files_of_another_run_are_refused(name: str, pair: tuple[Path, Path]) -> None:
    shutil.copy(pair[1] / name, pair[0] / name)
    with pytest.raises(InputError, match=name):
        read_all(pair[0])


def test_a_folder_has_the_hash_of_its_record(pair: tuple[Path, Path], tmp_path: Path) -> None:
    one, other, aside = *pair, tmp_path / "aside"
    names = one.name, other.name
    one.rename(aside)
    other.rename(one)
    aside.rename(other)
    for folder in pair:
        assert read_record(folder) is None
        with pytest.raises(
            InputError, match=rf"found the record of the run \w+; allowed: the record of {folder.name[-12:]}"
        ):
            open_run(folder)
    assert read_all(one.rename(tmp_path / "mine")).folder.name not in names  # a name of one's own is allowed


def test_numbers_of_a_record_are_not_believed_without_its_digest(pair: tuple[Path, Path]) -> None:
    record = json.loads((pair[0] / RECORD).read_text())
    better = [part | {"whole": 0.0} for part in record["error_budget"]]
    moved = record["layout"] | {"load_N": 5.0}
    for change in ({"error_budget": better}, {"layout": moved}, {"wall_s": 1e-9}, {"bodies": 7}):
        (pair[0] / RECORD).write_text(json.dumps(record | change))
        with pytest.raises(InputError, match="altered since it was written"):
            open_run(pair[0])
    del record["sha256"]
    (pair[0] / RECORD).write_text(json.dumps(record))
    with pytest.raises(InputError, match="a file without its digest"):
        open_run(pair[0])


def test_no_command_reads_altered_forces(pair: tuple[Path, Path], tmp_path: Path) -> None:
    edited_force(pair[0] / FORCES)
    for words in (
        ("observables", pair[0]),
        ("spacetime", pair[0], "--results", tmp_path / "out"),
        ("film", pair[0], "--results", tmp_path / "out"),
        ("vtk", pair[0], "--results", tmp_path / "out"),
        ("compare", pair[1], pair[0]),
    ):
        ended = beads(*words)
        assert (ended.returncode, ended.stdout, ended.stderr.count("\n")) == (2, "", 1), words
        assert f"{FORCES}: found a file that was altered since it was written; allowed: the forces" in ended.stderr


@pytest.mark.parametrize("name", [FORCES, STATE, RECORD])
def test_a_command_that_runs_makes_it_again_with_one_line(
    name: str, scene_file: SceneWriter, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    case = case_of(scene_file(), WITH_STATE)
    first = run_case(case, "verlet", tmp_path)
    flip(first.folder / name, 2)
    capsys.readouterr()
    again = run_case(case, "verlet", tmp_path)
    (line,) = capsys.readouterr().err.splitlines()
    assert name in line
    assert line.endswith(": run again")
    assert again.folder == first.folder
    assert read_all(first.folder).forces_sha256 == first.forces_sha256


def test_damaged_gauge_signals_are_written_again(
    scene_file: SceneWriter, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    case = case_of(scene_file())
    run = finished(case, "verlet", tmp_path)
    right = (run.folder / SENSORS).read_bytes()
    (run.folder / SENSORS).write_bytes(right.replace(b"1", b"2"))
    assert SENSORS not in capsys.readouterr().err
    finished(case, "verlet", tmp_path)
    assert (run.folder / SENSORS).read_bytes() == right
    said = capsys.readouterr().err.splitlines()
    assert len(said) == 1
    assert said[0].endswith(": written again")


def test_forces_of_another_scene_are_refused(pair: tuple[Path, Path]) -> None:
    """Sealed by hand, with rows that are not those of the record's scene."""
    edit_table(pair[0], lambda table: table.iloc[:-10])
    with pytest.raises(InputError, match=r"found forces of 291 samples and 6 contacts .* 301 samples and 6 contacts"):
        open_run(pair[0]).trace  # noqa: B018
    edit_record(pair[1], bodies=5)
    with pytest.raises(InputError, match="5 contacts"):
        open_run(pair[1]).trace  # noqa: B018


def entry() -> Path:
    (path,) = paths.CACHE.iterdir()
    return path


def test_an_altered_entry_of_the_cache_is_computed_again(capsys: pytest.CaptureFixture[str]) -> None:
    """A factor of 0.002 in the place of 0.001 would give beads of twice the diameter."""
    assert kept(["mm", "m"], lambda: 0.001) == 0.001
    path = entry()
    for content in (path.read_text().replace("0.001", "0.002"), *WRONG_JSON):
        path.write_text(content)
        assert kept(["mm", "m"], lambda: 0.001) == 0.001
        (line,) = capsys.readouterr().err.splitlines()
        assert path.name in line
        assert line.endswith("computed again")
        assert kept(["mm", "m"], lambda: 5.0) == 0.001
        assert not capsys.readouterr().err
    assert to_si("4.76 mm", "m") == 4.76e-3


def test_an_entry_under_another_name_is_computed_again(capsys: pytest.CaptureFixture[str]) -> None:
    kept(["one"], lambda: 1.0)
    path = entry()
    kept(["other"], lambda: 2.0)
    (other,) = {*paths.CACHE.iterdir()} - {path}
    shutil.copy(other, path)
    assert kept(["one"], lambda: 1.0) == 1.0
    assert "a result under another name" in capsys.readouterr().err


def batch(path: Path, tmp_path: Path) -> pd.DataFrame:
    ended = beads("batch", path, "--runs", tmp_path / "r", "--results", tmp_path / "results")
    assert ended.returncode == 0, ended.stderr
    return read_study_table(path, tmp_path / "results")


def test_which_row_belongs_to_which_case_is_not_believed(study_file: StudyWriter, tmp_path: Path) -> None:
    path = study_file(SPEEDS.format(3), "verlet")
    right = batch(path, tmp_path)
    turned = 0
    for file in paths.CACHE.glob("*.json"):
        stored = read_sealed(file, "")
        if isinstance(stored["result"], list) and len(stored["result"]) == 3:
            file.write_text(json.dumps(stored | {"result": stored["result"][::-1], "sha256": "0" * 64}))
            turned += 1
    assert turned
    pd.testing.assert_frame_equal(batch(path, tmp_path), right)


@pytest.mark.parametrize("damage", ["other name", "a folder", "a dangling link", "wrong shape", "cut", "deep"])
def test_damaged_rows_do_not_count(damage: str, study_file: StudyWriter, tmp_path: Path) -> None:
    path = study_file(SPEEDS.format(2), "verlet")
    right = batch(path, tmp_path)
    home = tmp_path / "r" / "batch"
    content = b"".join(file.read_bytes() for file in home.glob(f"*{ENDING}"))
    for each in home.glob(f"*{ENDING}"):
        each.unlink()
    file = home / _name_of(content)
    file.write_bytes(content)
    rows = [json.loads(line) for line in file.read_text().splitlines()]
    wrong = b"".join(json.dumps(row | {"values": 5, "cost": []}).encode() + b"\n" for row in rows)
    contents = {"wrong shape": wrong, "deep": b"[" * 100_000}
    if damage in contents:
        file.unlink()
        (home / _name_of(contents[damage])).write_bytes(contents[damage])
    elif damage == "other name":
        file.rename(home / f"{'0' * 24}{ENDING}")
    elif damage == "cut":
        file.write_bytes(file.read_bytes()[:-9])
    else:
        DAMAGE[damage](file)
    store = Store(tmp_path / "r")
    assert (store.refresh(), len(store.damaged)) == ([], 1)
    pd.testing.assert_frame_equal(batch(path, tmp_path), right)


@pytest.mark.parametrize("damage", [*DAMAGE, "edited"])
def test_a_damaged_table_of_a_study_is_refused_and_written_again(
    damage: str, study_file: StudyWriter, tmp_path: Path
) -> None:
    path = study_file(SPEEDS.format(2), "verlet")
    right = batch(path, tmp_path)
    file = tmp_path / "results" / "study.parquet"
    if damage == "edited":
        right.assign(**{"striker.speed_m_s": 5.0}).to_parquet(file)
    else:
        DAMAGE[damage](file)
    with pytest.raises(InputError) as refused:
        read_study_table(path, tmp_path / "results")
    assert "study.parquet" in str(refused.value)
    assert "beads batch" in str(refused.value)
    if not file.is_dir():
        pd.testing.assert_frame_equal(batch(path, tmp_path), right)


@pytest.mark.parametrize("edited", ["study", "scene", "title"])
def test_a_table_is_of_the_cases_that_the_study_has_now(edited: str, study_file: StudyWriter, tmp_path: Path) -> None:
    path = study_file(SPEEDS.format(2), "verlet")
    right = batch(path, tmp_path)
    if edited == "scene":
        scene = tmp_path / "scene.toml"
        scene.write_text(scene.read_text().replace("count = 5", "count = 4"))
    else:
        text = path.read_text().replace("2 m/s", "3 m/s" if edited == "study" else "2 m/s")
        path.write_text(f'title = "new"\n{text}')
    if edited == "title":
        pd.testing.assert_frame_equal(read_study_table(path, tmp_path / "results"), right)
        return
    with pytest.raises(InputError, match="a table of other cases than the study has now; run beads batch"):
        read_study_table(path, tmp_path / "results")
    assert not batch(path, tmp_path).equals(right)


def test_sealed_files_have_the_name_under_which_they_were_written(tmp_path: Path) -> None:
    for name in ("a", "b"):
        with sealed_file(tmp_path / name) as draft:
            draft.write_text(name)
    assert read_sealed_file(tmp_path / "a", "") == b"a"
    for source, target in ((tmp_path / "b", tmp_path / "a"), (tmp_path / ".sha256/b", tmp_path / ".sha256/a")):
        shutil.copy(source, target)
        with pytest.raises(InputError, match="altered"):
            read_sealed_file(tmp_path / "a", "")


def test_blanks_of_a_sealed_record_have_no_meaning(tmp_path: Path) -> None:
    content = {"a": [1.5, None, {"b": 0.1 + 0.2}], "text": "ß"}
    for indent in (None, 2):
        write_sealed(tmp_path / "x", content, indent)
        assert read_sealed(tmp_path / "x", "") == content


FORMULAS = ["=1+1", "+1", "-1", "@x", "\t=1", "\r=1", "'=1", "''-1", "plain", "a=b", "", "'quoted'"]


def test_text_does_not_become_a_formula() -> None:
    table = pd.DataFrame({"=text": FORMULAS, "number": -np.arange(float(len(FORMULAS)))})
    content = csv_of(table)
    cells = pd.read_csv(BytesIO(content), keep_default_na=False)
    assert cells.columns[0] == "'=text"
    assert not [cell for cell in cells.iloc[:, 0] if cell.startswith(("=", "+", "-", "@", "\t", "\r"))]
    assert (cells["number"] == table["number"]).all()
    pd.testing.assert_frame_equal(table_in(content, keep_default_na=False), table, check_dtype=False)
