"""Tests of ``drivers runs --prune``: runs that no command would use again are removed, and no others."""

import os
import shutil
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pytest

from drivers.base.errors import InputError
from drivers.engines import REFERENCE, VERLET, load_engine
from drivers.inventory import prune as module
from drivers.inventory.prune import prune
from drivers.inventory.run_folders import kept_runs
from drivers.run.build import build_of
from drivers.run.run import run_case, run_identity
from drivers.run.run_folder import FORCES, RECORD, EndedRun, record_of
from drivers.run.workplaces import ABANDONED_S, ALIVE, LEASE, _machine, leased, workplace
from validation.tests.helpers.runs import edit_record
from validation.tests.helpers.scenes import BASE, STRIKER, WALL, EnginesWriter, case_of

DAY_S = 86400.0


@pytest.fixture(scope="module")
def ran(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two finished runs and a failed one."""
    home = tmp_path_factory.mktemp("ran")
    scene = home / "small.toml"
    scene.write_text(BASE.format(count=3, chain="", striker=STRIKER, wall=WALL, duration="20 us", step="0.1 us"))
    for engine, limit_s, *settings in ((VERLET, 60.0), (REFERENCE, 60.0), (VERLET, 1e-6, "chain.count=4")):
        assert run_case(case_of(scene, *settings), engine, home / "runs", limit_s=limit_s).done is (limit_s > 1)
    return home


@pytest.fixture
def runs(ran: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A copy of these runs, dated yesterday; the present folder is that of the scene."""
    shutil.copytree(ran, tmp_path, dirs_exist_ok=True)
    monkeypatch.chdir(tmp_path)
    made_yesterday(tmp_path)
    return tmp_path / "runs"


def made_yesterday(folder: Path) -> None:
    for file in folder.rglob("*"):
        os.utime(file, (time.time() - DAY_S, time.time() - DAY_S))


def folders(runs: Path) -> set[str]:
    return {f"{run.record.engine}/{run.folder.name}" for run in kept_runs(runs)}


def done(runs: Path, engine: str) -> Path:
    return next(run.folder for run in kept_runs(runs) if run.record.engine == engine and not run.trouble)


def copied(folder: Path, name: str, **changes: object) -> Path:
    """A copy of a run in the same folder, with another record."""
    other = shutil.copytree(folder, folder.with_name(name))
    edit_record(other, **changes)
    made_yesterday(other.parent)
    return other


def pruned(capsys: pytest.CaptureFixture[str], runs: Path, *scenes: str, engines: tuple[str, ...] = ()) -> list[str]:
    """Lines of a dry run, which removes nothing, followed by the real run with the same lines."""
    before = folders(runs)
    prune(runs, scenes, engines, (), dry_run=True)
    assert folders(runs) == before
    lines_of_run = [line for line in capsys.readouterr().out.splitlines() if line[0] != " "]
    prune(runs, scenes, engines, ())
    lines = capsys.readouterr().out.splitlines()
    assert [line.replace("would remove", "removed").replace("would free", "freed") for line in lines_of_run] == lines
    return lines


def test_failed_runs_go(runs: Path, capsys: pytest.CaptureFixture[str]) -> None:
    used = {f"{engine}/{done(runs, engine).name}" for engine in (VERLET, REFERENCE)}
    size = sum(run.size for run in kept_runs(runs) if run.trouble)
    lines = pruned(capsys, runs)
    assert folders(runs) == used
    assert lines[0].startswith(f"removed 1 run ({VERLET} 1), {size / 1000:.0f} kB: failed or without forces")
    assert lines[1].startswith(f"kept 2 runs ({REFERENCE} 1, {VERLET} 1), ")
    assert lines[2:] == [f"freed {size / 1000:.0f} kB"]
    assert pruned(capsys, runs)[-1] == "freed 0 kB"
    assert [place.name for place in (runs / VERLET).iterdir() if place.name[0] == "."] == []


def test_a_dry_run_names_what_would_go(runs: Path, capsys: pytest.CaptureFixture[str]) -> None:
    failed = next(run.folder for run in kept_runs(runs) if run.trouble)
    prune(runs, (), (), (), dry_run=True)
    assert f"    runs/{VERLET}/{failed.name}" in capsys.readouterr().out.splitlines()


def test_what_is_damaged_or_lacks_its_forces_goes(runs: Path, capsys: pytest.CaptureFixture[str]) -> None:
    first, second = done(runs, VERLET), done(runs, REFERENCE)
    (first / RECORD).write_text("{")
    (second / FORCES).unlink()
    made_yesterday(runs)
    lines = pruned(capsys, runs)
    assert folders(runs) == set()
    assert "damaged or of another version" in lines[0]
    assert lines[1].startswith("removed 2 runs")


def test_runs_of_another_build_go(runs: Path, capsys: pytest.CaptureFixture[str]) -> None:
    run = done(runs, VERLET)
    copied(run, f"{run.name[:-12]}{'0' * 12}", identity="0" * 12)
    shutil.rmtree(run)
    lines = pruned(capsys, runs, engines=(VERLET,))
    assert [name.split("/")[0] for name in folders(runs)] == [REFERENCE]
    assert "run by another build" in lines[1]


def test_older_runs_of_a_former_deck_go(runs: Path, capsys: pytest.CaptureFixture[str]) -> None:
    run, former = done(runs, VERLET), "f" * 64
    identity = run_identity(VERLET, build_of(load_engine(VERLET)), former)
    older = copied(run, f"{run.name[:-12]}{identity}", deck_sha256=former, identity=identity)
    os.utime(older / RECORD, (time.time() - 2 * DAY_S, time.time() - 2 * DAY_S))
    lines = pruned(capsys, runs)
    assert not older.exists()
    assert run.exists()
    assert "with an older deck" in lines[1]


def test_what_cannot_be_judged_stays(runs: Path, capsys: pytest.CaptureFixture[str]) -> None:
    run = done(runs, VERLET)
    shutil.copytree(runs / VERLET, runs / "absent")
    for digit, folder in enumerate(list((runs / "absent").glob("[!.]*/"))):
        copied(folder, f"{folder.name[:-12]}{str(digit) * 12}", engine="absent", identity=str(digit) * 12)
        shutil.rmtree(folder)
    mine = copied(run, "mine")
    (runs / VERLET / "notes").mkdir()
    lines = pruned(capsys, runs)
    assert {"absent"} < {run.record.engine for run in kept_runs(runs)}
    assert mine.exists()
    assert (runs / VERLET / "notes").exists()
    assert any(
        line.startswith("kept 1 run (absent 1)") and "has no entry here; --engines FILE" in line for line in lines
    )
    assert any("their folders have been renamed" in line for line in lines)


def test_a_link_to_a_run_stays(runs: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Its folder is kept elsewhere on purpose, and its removal would free nothing."""
    failed = next(run.folder for run in kept_runs(runs) if run.trouble)
    failed.rename(tmp_path / "elsewhere")
    failed.symlink_to(tmp_path / "elsewhere")
    made_yesterday(runs)
    lines = pruned(capsys, runs)
    assert (failed / RECORD).exists()
    assert any(line.startswith(f"kept 1 run ({VERLET} 1)") and "are links" in line for line in lines)
    assert lines[-1] == "freed 0 kB"


def test_a_folder_that_cannot_be_written_to_is_named(runs: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The message names the folder that the user knows, and not a temporary one in it."""
    monkeypatch.setattr(os, "access", lambda *_: False)  # root may write to any folder
    with pytest.raises(InputError) as message:
        prune(runs, (), (), ())
    assert str(message.value) == f"runs/{VERLET}: found a read-only folder; allowed: one that can be written to"


@pytest.mark.parametrize("command", ["no-such-program", "true"])  # "true" prints no version
def test_runs_of_an_engine_without_a_build_stay(
    command: str, runs: Path, engines_file: EnginesWriter, capsys: pytest.CaptureFixture[str]
) -> None:
    engines_file(f'[own]\nadapter = "liggghts"\ncommand = "{command}"\n')
    copied(done(runs, VERLET), f"small-{'0' * 12}", engine="own", identity="0" * 12)
    assert any(
        line.startswith("kept 1 run (own 1)") and "is not installed, or" in line for line in pruned(capsys, runs)
    )


def test_what_just_ended_stays(runs: Path, capsys: pytest.CaptureFixture[str]) -> None:
    before = folders(runs)
    for run in kept_runs(runs):
        os.utime(run.folder / RECORD)
    assert pruned(capsys, runs)[0].startswith("kept 3 runs")
    assert folders(runs) == before


def test_only_what_is_selected_goes(runs: Path, capsys: pytest.CaptureFixture[str]) -> None:
    failed = next(run.folder for run in kept_runs(runs) if run.trouble)
    other = copied(failed, f"other-{'0' * 12}", scene_name="other")
    prune(runs, ("small",), (VERLET,), ("chain.count=3",))
    prune(runs, (), (REFERENCE,), ())
    assert failed.exists()
    prune(runs, ("small",), (), ("chain.count=4",))
    assert not failed.exists()
    assert other.exists()
    assert capsys.readouterr().out.count("removed") == 1


@pytest.fixture
def at_work(runs: Path) -> Iterator[Path]:
    """The workplace of a live process."""
    with workplace(runs / VERLET) as place:
        (place / "run").mkdir()
        yield place


def test_leftovers_of_killed_runs_go_and_no_others(
    runs: Path, at_work: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for name, age_s in (
        (f".{'a' * 12}@{_machine()}", 0.0),
        (f".{'b' * 12}@elsewhere", 0.0),
        (f".{'c' * 12}@elsewhere", ABANDONED_S / 2),
        (f".{'d' * 12}@elsewhere", 2 * ABANDONED_S),
    ):
        for home in (runs / VERLET, runs / "batch" / ".work"):
            (home / name).mkdir(parents=True)
            (home / name / ALIVE).write_bytes(b"x" * 1000)
            os.utime(home / name / ALIVE, (time.time() - age_s, time.time() - age_s))
    prune(runs, (), (), ("chain.count=3",))
    assert "killed" not in capsys.readouterr().out
    lines = pruned(capsys, runs)
    assert "removed 4 folders of killed processes, 4 kB" in lines
    (runs / VERLET / f".{'b' * 12}@elsewhere" / LEASE).write_text('["row"]')
    assert leased(runs / VERLET) == {"row"}
    left = {place.name[1:] for home in (VERLET, "batch/.work") for place in (runs / home).glob(".*@*")}
    assert left == {f"{'b' * 12}@elsewhere", f"{'c' * 12}@elsewhere", at_work.name[1:]}


def test_a_run_that_was_replaced_meanwhile_stays(
    runs: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Another process repeats a failed run after it was selected for removal."""
    failed, good = next(run.folder for run in kept_runs(runs) if run.trouble), done(runs, VERLET)

    def late(*_: object) -> list[EndedRun]:
        found = kept_runs(runs)
        shutil.rmtree(failed)
        shutil.copytree(good, failed)
        edit_record(failed, identity=failed.name[-12:])
        return found

    monkeypatch.setattr(module, "kept_runs", late)
    prune(runs, (), (), ())
    assert replace(record_of(failed), identity=record_of(good).identity) == record_of(good)
    assert "removed" not in capsys.readouterr().out


def test_rows_of_batches_stay(runs: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (runs / "batch").mkdir()
    (runs / "batch" / "a.jsonl").write_text("{}\n{}\n")
    (line,) = [line for line in pruned(capsys, runs) if "rows of batches" in line]
    assert line.startswith("kept runs/batch: 2 rows of batches")
    assert line.endswith("batches use those of unchanged decks and builds; remove the folder to free the space")
