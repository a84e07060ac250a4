"""Tests of existing runs: listed with their settings, found, and named without a hash."""

import os
import shutil
from pathlib import Path

import pytest

from drivers.base.errors import InputError
from drivers.engines import REFERENCE, VERLET
from drivers.inventory.run_folders import kept_runs, key_of, print_runs, run_folder, select
from drivers.run.run import run_case
from drivers.run.run_folder import FORCES, RECORD, EndedRun, record_of
from validation.tests.helpers.runs import edit_record
from validation.tests.helpers.scenes import BASE, STRIKER, WALL, case_of


@pytest.fixture(scope="module")
def three(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a scene and its runs: by ``verlet`` and ``reference``, and at another speed and step."""
    home = tmp_path_factory.mktemp("kept")
    scene = home / "small.toml"
    scene.write_text(BASE.format(count=3, chain="", striker=STRIKER, wall=WALL, duration="20 us", step="0.1 us"))
    changed = ("striker.speed=1.5 m/s", "run.time_step=50 ns")
    jobs: list[tuple[str, tuple[str, ...]]] = [(VERLET, ()), (REFERENCE, ()), (VERLET, changed)]
    for i, (engine, settings) in enumerate(jobs):
        ended = run_case(case_of(scene, *settings), engine, home / "runs")
        assert ended.done
        os.utime(ended.folder / RECORD, (1e9 + i, 1e9 + i))
    return home


@pytest.fixture
def home(three: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A copy of this folder, as the present folder."""
    shutil.copytree(three, tmp_path, dirs_exist_ok=True)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def listed(capsys: pytest.CaptureFixture[str], home: Path, *scenes: str) -> list[list[str]]:
    print_runs(home / "runs", scenes, (), ())
    return [line.split() for line in capsys.readouterr().out.splitlines()]


def test_a_line_for_each_run(home: Path, capsys: pytest.CaptureFixture[str]) -> None:
    *rows, total = listed(capsys, home)
    names = [row[0] for row in rows]
    assert names[:2] == [f"{VERLET}:small", f"{REFERENCE}:small"]
    assert Path(names[2]).is_dir()
    assert [row[1:3] for row in rows] == [["small", VERLET], ["small", REFERENCE], ["small", VERLET]]
    assert [" ".join(row[7:]) for row in rows] == [
        "done", "done", "done striker.speed=1.5 m/s, run.time_step=50 ns",
    ]  # fmt: skip
    assert rows[0][3].startswith("2001-09-0")
    files = [file for file in (home / "runs").glob("*/*/*") if file.is_file()]
    assert total[:4] == ["3", "runs", "(3", "done):"]
    assert total[4] == f"{sum(file.stat().st_size for file in files) / 1000:,.0f}"
    assert [run_folder(name, home / "runs").resolve() for name in names] == [
        run.folder for run in kept_runs(home / "runs")
    ]
    assert [row[0] for row in listed(capsys, home, "small.toml")[:-1]] == [
        f"{VERLET}:small.toml", f"{REFERENCE}:small.toml", names[2],
    ]  # fmt: skip


def test_a_scene_without_its_file_is_listed(home: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (home / "small.toml").unlink()
    rows = listed(capsys, home)[:-1]
    assert all(" ".join(row[8:]) == "found no scene file of this name" for row in rows)
    assert run_folder(f"{VERLET}:small", home / "runs") == kept_runs(home / "runs")[-1].folder
    said = capsys.readouterr().err
    assert said.startswith(f"{VERLET}:small: found no scene file of this name; using runs/{VERLET}/small-")
    assert said.endswith(", which is the newest run recorded as small\n")


@pytest.mark.parametrize("text", [None, "", "[]", '{"engine": 1}', "\ud800", "another digest"])
def test_a_damaged_record_is_a_line(home: Path, text: str | None, capsys: pytest.CaptureFixture[str]) -> None:
    folder = kept_runs(home / "runs")[0].folder
    record = (folder / RECORD).read_text()
    (folder / RECORD).unlink()
    if text is not None:
        text = record.replace(VERLET, REFERENCE) if text == "another digest" else text
        (folder / RECORD).write_bytes(text.encode(errors="surrogatepass"))
    *rows, total = listed(capsys, home)
    (row,) = [row for row in rows if folder.name in row[0]]
    assert row[7] == "damaged"
    assert total[2:6] == ["(1", "damaged,", "2", "done):"]


def test_a_record_of_another_version_is_read(home: Path) -> None:
    """A run whose scene has keys that exist no more is not damaged: ``prune`` would remove it."""
    before = kept_runs(home / "runs")
    for run in before:
        path = run.folder / RECORD
        when, scene = path.stat().st_mtime, record_of(run.folder).scene
        edit_record(run.folder, scene=scene | {"former": 1, "wall": scene["wall"] | {"former": 1}})
        os.utime(path, (when, when))
    after = kept_runs(home / "runs")
    assert [run.trouble for run in after] == [run.trouble for run in before]
    assert [run.resolved for run in after] == [run.resolved for run in before]


def test_failed_runs_and_other_folders(home: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Characters of a folder's name cannot break the table."""
    ended = run_case(case_of(home / "small.toml", "chain.count=4"), VERLET, home / "runs", limit_s=1e-6)
    ended.folder.rename(ended.folder.with_name("my\nrun\t\x1b[31m"))
    for other in ("verlet/notes", f"batch/x-{'0' * 12}", f"{VERLET}/.work@x", "empty"):
        (home / "runs" / other).mkdir(parents=True)
    (home / "runs" / "batch" / "a.jsonl").write_text("{}\n{}\n")
    *rows, total, batches = listed(capsys, home)
    assert rows[-1][7:9] == ["timeout", "chain.count=4;"]
    assert rows[-1][0] == f"runs/{VERLET}/my?run??[31m"
    assert len(rows) == 4
    assert total[:6] == ["4", "runs", "(3", "done,", "1", "timeout):"]
    assert batches[1:5] == ["2", "rows", "of", "batches:"]


def selected(home: Path, *settings: str, scenes: tuple[str, ...] = (), engines: tuple[str, ...] = ()) -> list[EndedRun]:
    return select(kept_runs(home / "runs"), scenes, engines, settings)


def test_runs_are_found_by_scene_engine_and_settings(home: Path) -> None:
    first, exact, other = kept_runs(home / "runs")
    assert selected(home, scenes=("small",)) == selected(home, scenes=("small.toml",)) == [first, exact, other]
    assert selected(home, engines=(REFERENCE,)) == [exact]
    assert selected(home, "striker.speed=1.5 m/s") == selected(home, "striker.speed=1500 mm/s") == [other]
    assert selected(home, "striker.speed=1.?*") == selected(home, "run.time_step=0.05 us") == [other]
    assert selected(home, "run.time_step=50 ns", "run.time_step=0.1 us") == [first, exact, other]
    assert selected(home, "run.time_step=0.1 us", "chain.count=3", engines=(VERLET,)) == [first]
    assert selected(home, "wall.material=brass", "tube=") == [first, exact, other]


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ({"scenes": ("smal",)}, 'no run of "smal"; allowed: small'),
        ({"engines": ("absent",)}, f'no run of "absent"; allowed: {REFERENCE}, {VERLET}'),
        ({"settings": ("striker.speed=2 m/s",)}, "--set striker.speed=2 m/s: matches no run"),
        ({"settings": ("striker.speed",)}, "--set striker.speed: not of the form KEY=VALUE"),
    ],
)
def test_a_selection_without_runs_is_an_error(home: Path, words: dict[str, tuple[str, ...]], said: str) -> None:
    with pytest.raises(InputError, match=said.replace("(", r"\(")):
        selected(home, *words.pop("settings", ()), **words)


def test_the_name_is_that_of_the_newest_run_as_the_file_has_it(home: Path, capsys: pytest.CaptureFixture[str]) -> None:
    first, _, other = kept_runs(home / "runs")
    name = f"{VERLET}:small"
    assert run_folder(name, home / "runs") == run_folder(f"{name}.toml", home / "runs") == first.folder
    newer = shutil.copytree(first.folder, first.folder.with_name(f"{first.folder.name[:-12]}{'0' * 12}"))
    edit_record(newer, identity="0" * 12)
    os.utime(newer / RECORD, (2e9, 2e9))
    assert run_folder(name, home / "runs") == newer
    (newer / FORCES).unlink()
    assert run_folder(name, home / "runs") == first.folder
    assert not capsys.readouterr().err
    for folder in (newer, first.folder):
        shutil.rmtree(folder)
    assert run_folder(name, home / "runs") == other.folder
    said, differs = "small.toml has not been run as it is", "striker.speed=1.5 m/s, run.time_step=50 ns"
    using = f"runs/{VERLET}/{other.folder.name}"
    assert capsys.readouterr().err == f"{name}: {said}; using {using}, which differs by {differs}\n"


def test_a_run_is_found_by_its_scene_and_by_a_copy_that_was_run_last(
    home: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A record has the name of the scene that was run last."""
    first, copy, runs = kept_runs(home / "runs")[0].folder, home / "sub" / "copy.toml", home / "runs"
    copy.parent.mkdir()
    copy.write_text(f'title = "Another"\n{(home / "small.toml").read_text()}record = ["forces"]\n')
    assert run_case(case_of(copy), VERLET, runs).folder.resolve() == first.resolve()
    assert record_of(first).scene_name == "copy"
    for name in ("small", "./small", "sub/copy.toml", "sub/copy"):
        assert run_folder(f"{VERLET}:{name}", runs).resolve() == first.resolve()
    assert not capsys.readouterr().err
    assert [f"{VERLET}:small", "copy"] in [row[:2] for row in listed(capsys, home, "small")]
    assert [f"{VERLET}:copy", "copy"] in [row[:2] for row in listed(capsys, home)]
    assert [run.record.engine for run in selected(home, scenes=("sub/copy.toml",))] == [REFERENCE, VERLET]


def test_other_gauges_are_another_scene_and_more_files_are_not(home: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Gauges change no deck, but the signals in the folder."""
    first, scene, runs = run_folder(f"{VERLET}:small", home / "runs"), home / "small.toml", home / "runs"
    more = run_case(case_of(scene, "run.record=['forces', 'state']"), VERLET, runs, rerun=True).folder
    assert more.resolve() == run_folder(f"{VERLET}:small", runs).resolve() == first.resolve()
    other = run_case(case_of(scene, "chain.sensors=[{from_wall=2}]"), VERLET, runs).folder
    assert run_folder(f"{VERLET}:small", runs) == first != other
    assert not capsys.readouterr().err
    shutil.rmtree(first)
    assert run_folder(f"{VERLET}:small", runs).resolve() == other.resolve()
    assert "chain.sensors=" in capsys.readouterr().err


def test_a_material_may_have_the_name_of_a_text(home: Path) -> None:
    """Texts change no number, and a table ``materials.title`` is no text."""
    stiff, soft = (
        run_case(case_of(home / "small.toml", f"materials.title={each}", "chain.material=title"), VERLET, home / "runs")
        for each in (f"{{youngs_modulus='{modulus} GPa', poisson_ratio=0.4}}" for modulus in (2, 1))
    )
    assert key_of(stiff) != key_of(soft)


def test_a_scene_of_the_same_name_with_other_physics_is_not_meant(
    home: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Two folders have a file of this name: each finds its own run, also if the other run is newer."""
    (home / "sub").mkdir()
    heavier = (home / "small.toml").read_text().replace("0.1226 g", "0.2 g")
    (home / "sub" / "small.toml").write_text(heavier)
    first = kept_runs(home / "runs")[0].folder
    other = run_case(case_of(home / "sub" / "small.toml"), VERLET, home / "runs").folder.resolve()
    assert run_folder(f"{VERLET}:small", home / "runs") == first
    assert run_folder(f"{VERLET}:sub/small.toml", home / "runs").resolve() == other
    assert not capsys.readouterr().err
    rows = listed(capsys, home, "sub/small.toml")[:-1]
    assert [row[0] for row in rows if row[8:] == []] == [f"{VERLET}:sub/small.toml"]
    assert [row[8] for row in rows if row[8:]][:2] == ["chain.mass=0.1226", "chain.mass=0.1226"]
    assert f"{VERLET}:small" in [row[0] for row in rows]


@pytest.mark.parametrize(
    ("name", "allowed"),
    [
        (f"{VERLET}:other", f"{VERLET}:small"),
        ("absent:small", f"{REFERENCE}:small, {VERLET}:small"),
        (":", f"{REFERENCE}:far, {REFERENCE}:small, {VERLET}:small"),
    ],
)
def test_a_wrong_name_is_an_error(home: Path, name: str, allowed: str) -> None:
    exact = kept_runs(home / "runs")[1].folder
    edit_record(shutil.copytree(exact, exact.with_name(f"far-{'0' * 12}")), scene_name="far", identity="0" * 12)
    (home / "a:b").mkdir()
    assert run_folder("a:b") == Path("a:b")  # a path is taken as it is
    with pytest.raises(InputError) as message:
        run_folder(name, home / "runs")
    assert str(message.value) == f"{name}: no such run in runs; allowed: {allowed}"
