"""Tests of existing runs: listed, named without a hash, selected, and removed if no command would use them."""

import os
import shutil
from pathlib import Path

import pytest

from drivers.base.errors import InputError
from drivers.engines import REFERENCE, VERLET
from drivers.run import inventory
from drivers.run.inventory import kept_runs, print_runs, prune, run_folder, select
from drivers.run.run import run_case
from drivers.run.run_folder import FORCES, RECORD, EndedRun, record_of
from validation.tests.helpers.runs import edit_record
from validation.tests.helpers.scenes import BASE, STRIKER, WALL, EnginesWriter, case_of

RUNS = Path("runs")
NAME = f"{VERLET}:small"
CHANGED = ("striker.speed=1.5 m/s", "run.time_step=50 ns")


@pytest.fixture(scope="module")
def three(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a scene and its runs: by ``verlet`` and ``reference``, and at another speed and step."""
    home = tmp_path_factory.mktemp("kept")
    scene = home / "small.toml"
    scene.write_text(BASE.format(count=3, chain="", striker=STRIKER, wall=WALL, duration="20 us", step="0.1 us"))
    for i, (engine, settings) in enumerate([(VERLET, ()), (REFERENCE, ()), (VERLET, CHANGED)]):
        ended = run_case(case_of(scene, *settings), engine, home / "runs")
        assert ended.done
        os.utime(ended.folder / RECORD, (1e9 + i, 1e9 + i))
    return home


@pytest.fixture(autouse=True)
def home(three: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A copy of this folder, as the present folder."""
    shutil.copytree(three, tmp_path, dirs_exist_ok=True)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def copied(run: EndedRun, digit: str, **changes: object) -> Path:
    """A newer copy of a run with another identity."""
    other = shutil.copytree(run.folder, run.folder.with_name(f"{run.folder.name[:-12]}{digit * 12}"))
    edit_record(other, **{"identity": digit * 12} | changes)
    return other


def failed() -> Path:
    return run_case(case_of("small.toml", "chain.count=4"), VERLET, RUNS, limit_s=1e-6).folder


def listed(capsys: pytest.CaptureFixture[str], *scenes: str) -> list[list[str]]:
    print_runs(RUNS, scenes, (), ())
    return [line.split() for line in capsys.readouterr().out.splitlines()]


def pruned(capsys: pytest.CaptureFixture[str]) -> tuple[set[str], str]:
    """Names of the folders of removed runs, and the last line; a dry run before says the same and removes nothing."""
    before = {run.folder for run in kept_runs(RUNS)}
    prune(RUNS, (), (), (), dry_run=True)
    assert {run.folder for run in kept_runs(RUNS)} == before
    planned = capsys.readouterr().out
    prune(RUNS, (), (), ())
    lines = capsys.readouterr().out
    assert planned.replace("would remove", "removed") == lines
    gone = before - {run.folder for run in kept_runs(RUNS)}
    assert {line.split()[1] for line in lines.splitlines()[:-1]} == {f"{folder}:" for folder in gone}
    return {folder.name for folder in gone}, lines.splitlines()[-1]


def test_a_line_for_each_run(home: Path, capsys: pytest.CaptureFixture[str]) -> None:
    *rows, total = listed(capsys)
    names = [row[0] for row in rows]
    assert names[:2] == [NAME, f"{REFERENCE}:small"]
    assert [run_folder(name, RUNS) for name in names] == [run.folder for run in kept_runs(RUNS)]
    assert [row[1:3] for row in rows] == [["small", VERLET], ["small", REFERENCE], ["small", VERLET]]
    assert [" ".join(row[7:]) for row in rows] == ["done", "done", f"done {', '.join(CHANGED)}"]
    assert rows[0][3].startswith("2001-09-0")
    size = sum(file.stat().st_size for file in RUNS.glob("*/*/*"))
    assert total == ["3", "runs", "(3", "done):", f"{size / 1000:,.0f}", "kB"]
    (home / "small.toml").write_text("wrong")
    (RUNS / "batch.sqlite").write_bytes(b"x" * 1_200_000)
    *rows, _, batches = listed(capsys)
    assert [" ".join(row[8:]) for row in rows] == ["found no scene file of this name"] * 3
    assert " ".join(batches) == "runs/batch.sqlite: rows of batches: 1.2 MB"


def test_failed_runs_and_other_folders(capsys: pytest.CaptureFixture[str]) -> None:
    """Characters of a folder's name cannot break the table."""
    folder = failed()
    folder.rename(folder.with_name("my\nrun\t\x1b[31m"))
    for other in (f"{VERLET}/notes", f"{VERLET}/.work@x", "empty"):
        (RUNS / other).mkdir()
    *rows, total = listed(capsys)
    assert rows[-1][7:9] == ["timeout", "chain.count=4;"]
    assert rows[-1][0] == f"runs/{VERLET}/my?run??[31m"
    assert total[:6] == ["4", "runs", "(3", "done,", "1", "timeout):"]


@pytest.mark.parametrize("text", [None, "", "[]", '{"engine": 1}', "\ud800", "another digest"])
def test_a_damaged_record_is_a_line(text: str | None, capsys: pytest.CaptureFixture[str]) -> None:
    folder = kept_runs(RUNS)[0].folder
    record = (folder / RECORD).read_text()
    (folder / RECORD).unlink()
    if text is not None:
        text = record.replace(VERLET, REFERENCE) if text == "another digest" else text
        (folder / RECORD).write_bytes(text.encode(errors="surrogatepass"))
    *rows, total = listed(capsys)
    (row,) = [row for row in rows if folder.name in row[0]]
    assert row[7] == "damaged"
    assert total[2:6] == ["(1", "damaged,", "2", "done):"]


def test_a_record_of_another_version_is_read() -> None:
    """A run whose scene has keys that exist no more is not damaged: ``prune`` would remove it."""
    before = kept_runs(RUNS)
    for run in before:
        path, scene = run.folder / RECORD, record_of(run.folder).scene
        when = path.stat().st_mtime
        edit_record(run.folder, scene=scene | {"former": 1, "wall": scene["wall"] | {"former": 1}})
        os.utime(path, (when, when))
    after = kept_runs(RUNS)
    assert [run.trouble for run in after] == [run.trouble for run in before]
    assert [run.resolved for run in after] == [run.resolved for run in before]


def test_the_name_is_that_of_the_newest_finished_run_of_the_file_as_it_is() -> None:
    first, _, other = kept_runs(RUNS)
    assert run_folder(NAME, RUNS) == run_folder(f"{NAME}.toml", RUNS) == first.folder
    changed_by_hand = copied(first, "1", edits=["another line"])
    newer = copied(first, "0")
    assert run_folder(NAME, RUNS) == newer
    (newer / FORCES).unlink()
    assert run_folder(NAME, RUNS) == first.folder
    for folder in (newer, first.folder, changed_by_hand):
        shutil.rmtree(folder)
    with pytest.raises(InputError) as message:
        run_folder(NAME, RUNS)
    assert str(message.value) == (
        f"{NAME}: found no finished run of small.toml as it is now, but {other.folder} with {', '.join(CHANGED)}; "
        f"allowed: a run folder, or this name after beads run small.toml --engine {VERLET} --runs runs"
    )
    shutil.rmtree(other.folder)
    with pytest.raises(InputError, match=r"small\.toml as it is now; allowed: "):
        run_folder(NAME, RUNS)


def test_a_name_without_a_file_is_that_of_the_record(home: Path) -> None:
    (home / "small.toml").rename(home / "other.toml")
    assert run_folder(NAME, RUNS) == kept_runs(RUNS)[-1].folder
    (home / "small.toml").write_text("wrong")
    with pytest.raises(InputError, match=r"^small\.toml: not valid TOML"):
        run_folder(NAME, RUNS)


def test_a_run_is_found_by_its_scene_and_by_a_copy_that_was_run_last(
    home: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A record has the name of the scene that was run last."""
    first, copy = kept_runs(RUNS)[0].folder, home / "sub" / "copy.toml"
    copy.parent.mkdir()
    copy.write_text(f'title = "Another"\n{(home / "small.toml").read_text()}record = ["forces"]\n')
    assert run_case(case_of(copy), VERLET, RUNS).folder == first
    assert record_of(first).scene_name == "copy"
    for name in ("small", "./small", "sub/copy.toml", "sub/copy"):
        assert run_folder(f"{VERLET}:{name}", RUNS) == first
    assert [row[:2] for row in listed(capsys, "sub/copy.toml")[:-1]] == [[f"{VERLET}:copy", "copy"]]


def test_other_gauges_or_physics_are_another_scene_and_more_files_are_not(home: Path) -> None:
    """Gauges change no deck, but the signals in the folder; two folders may have a file of one name."""
    first, scene = run_folder(NAME, RUNS), home / "small.toml"
    assert run_case(case_of(scene, "run.record=['forces', 'state']"), VERLET, RUNS, rerun=True).folder == first
    gauges = run_case(case_of(scene, "chain.sensors=[{from_wall=2}]"), VERLET, RUNS).folder
    (home / "sub").mkdir()
    (home / "sub" / "small.toml").write_text(scene.read_text().replace("0.1226 g", "0.2 g"))
    heavier = run_case(case_of(home / "sub" / "small.toml"), VERLET, RUNS).folder
    assert len({first, gauges, heavier}) == 3
    assert run_folder(NAME, RUNS) == first
    assert run_folder(f"{VERLET}:sub/small.toml", RUNS) == heavier


def test_a_material_may_have_the_name_of_a_text(home: Path) -> None:
    """Texts change no number, and a table ``materials.source`` is no text."""
    scene = home / "small.toml"
    own = 'materials.source = {youngs_modulus = "2 GPa", poisson_ratio = 0.4}\n'
    scene.write_text(own + scene.read_text().replace('material = "ptfe"', 'material = "source"', 1))
    ended = run_case(case_of(scene), VERLET, RUNS)
    assert run_folder(NAME, RUNS) == ended.folder
    scene.write_text(scene.read_text().replace("2 GPa", "1 GPa"))
    with pytest.raises(InputError, match="materials"):
        run_folder(NAME, RUNS)


@pytest.mark.parametrize("name", [f"{VERLET}:other", "absent:small", ":"])
def test_a_wrong_name_is_an_error(home: Path, name: str) -> None:
    (home / "a:b").mkdir()
    assert run_folder("a:b") == Path("a:b")  # a path is taken as it is
    with pytest.raises(InputError) as message:
        run_folder(name, RUNS)
    assert str(message.value) == f"{name}: found no such run in runs; allowed: {REFERENCE}:small, {NAME}"


def test_runs_are_found_by_scene_engine_and_settings() -> None:
    def selected(*settings: str, scenes: tuple[str, ...] = (), engines: tuple[str, ...] = ()) -> list[EndedRun]:
        return select(kept_runs(RUNS), scenes, engines, settings)

    first, exact, other = kept_runs(RUNS)
    assert selected(scenes=("small",)) == selected(scenes=("sub/small.toml",)) == [first, exact, other]
    assert selected(engines=(REFERENCE,)) == [exact]
    assert selected("striker.speed=1.5 m/s") == selected("striker.speed=1500 mm/s") == [other]
    assert selected("striker.speed=1.?*") == selected("run.time_step=0.05 us") == [other]
    assert selected("run.time_step=0.1 us", "chain.count=3", engines=(VERLET,)) == [first]
    assert selected("wall.material=brass", "tube=", 'run.record=["forces"]') == [first, exact, other]
    for words in ({"scenes": ("smal",)}, {"engines": ("absent",)}):
        with pytest.raises(InputError, match=f"^runs: found no run of .*; allowed: {REFERENCE}:small, {NAME}$"):
            selected(**words)
    with pytest.raises(InputError, match=r"found no run of striker\.speed=2 m/s; allowed"):
        selected("striker.speed=2 m/s")
    with pytest.raises(InputError, match=r"--set striker\.speed: not of the form KEY=VALUE"):
        selected("striker.speed")


def test_runs_that_are_not_done_or_not_of_today_go(capsys: pytest.CaptureFixture[str]) -> None:
    first, exact, other = kept_runs(RUNS)
    (copied(first, "1") / FORCES).unlink()
    (copied(first, "2") / RECORD).write_text("{")
    gone = {copied(exact, "0").name, f"{first.folder.name[:-12]}{'1' * 12}", f"{first.folder.name[:-12]}{'2' * 12}"}
    gone |= {failed().name}
    sizes = {run.folder.name: run.size for run in kept_runs(RUNS)}
    removed, last = pruned(capsys)
    assert removed == gone
    assert last == f"removed 4 of 7 runs: {sum(sizes[name] for name in gone) / 1000:.0f} kB"
    assert {run.folder for run in kept_runs(RUNS)} == {first.folder, exact.folder, other.folder}
    assert pruned(capsys) == (set(), "removed 0 of 3 runs: 0 kB")
    assert [*RUNS.glob("*/.*")] == []


def test_runs_that_cannot_be_made_again_or_judged_stay(
    engines_file: EnginesWriter, capsys: pytest.CaptureFixture[str]
) -> None:
    engines_file(
        '[own]\nadapter = "liggghts"\ncommand = "no-such-program"\n'
        '[silent]\nadapter = "liggghts"\ncommand = "true"\n'  # prints no version
    )
    first, folder = kept_runs(RUNS)[0], failed()
    for engine in ("absent", "own", "silent"):
        (RUNS / engine).mkdir()
        away = copied(first, "0", engine=engine)
        away.rename(RUNS / engine / away.name)
    copied(first, "1", edits=[])
    folder.rename(folder.with_name("mine"))
    assert pruned(capsys) == (set(), "removed 0 of 8 runs: 0 kB")


def test_only_what_is_selected_goes() -> None:
    folder = failed()
    other = copied(EndedRun(folder, record_of(folder)), "0", scene_name="other")
    prune(RUNS, ("small",), (VERLET,), ("chain.count=3",))
    assert folder.exists()
    prune(RUNS, ("small",), (), ("chain.count=4",))
    assert [folder.exists(), other.exists()] == [False, True]


def test_a_run_that_was_replaced_meanwhile_stays(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Another process repeats a failed run after it was selected for removal."""
    folder = failed()

    def late(*_: object) -> list[EndedRun]:
        before = kept_runs(RUNS)
        assert run_case(case_of("small.toml", "chain.count=4"), VERLET, RUNS).folder == folder
        return before

    monkeypatch.setattr(inventory, "kept_runs", late)
    prune(RUNS, (), (), ())
    assert (folder / FORCES).exists()
    assert capsys.readouterr().out == "removed 0 of 4 runs: 0 kB\n"
