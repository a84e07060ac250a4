"""Tests of ``drivers runs --prune``: runs that no command would use again are removed, and no others."""

import os
import shutil
import time
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


def pruned(capsys: pytest.CaptureFixture[str], runs: Path) -> list[str]:
    """Lines of a real run; a dry run before prints the same lines, removes nothing, and names what will go."""
    before = folders(runs)
    prune(runs, (), (), (), dry_run=True)
    assert folders(runs) == before
    planned = capsys.readouterr().out.splitlines()
    named = {line.strip().removeprefix("runs/") for line in planned if line[0] == " " and "@" not in line}
    prune(runs, (), (), ())
    lines = capsys.readouterr().out.splitlines()
    told = [line.replace("would remove", "removed").replace("would free", "freed") for line in planned]
    assert [line for line in told if line[0] != " "] == lines
    assert before - folders(runs) == named
    return lines


def test_runs_that_no_command_would_use_go(runs: Path, capsys: pytest.CaptureFixture[str]) -> None:
    used = {f"{engine}/{done(runs, engine).name}" for engine in (VERLET, REFERENCE)}
    run, former = done(runs, VERLET), "f" * 64
    start, identity = run.name[:-12], run_identity(VERLET, build_of(load_engine(VERLET)), former)
    copied(run, f"{start}{'0' * 12}", identity="0" * 12)
    (copied(run, f"{start}{'1' * 12}", identity="1" * 12) / FORCES).unlink()
    (copied(run, f"{start}{'2' * 12}") / RECORD).write_text("{")
    older = copied(run, f"{start}{identity}", deck_sha256=former, identity=identity)
    (runs / "batch").mkdir()
    (runs / "batch" / "a.jsonl").write_text("{}\n{}\n")
    made_yesterday(runs)
    os.utime(older / RECORD, (time.time() - 2 * DAY_S, time.time() - 2 * DAY_S))
    sizes = {f"{kept.record.engine}/{kept.folder.name}": kept.size for kept in kept_runs(runs)}
    *removed, kept, batches, freed = pruned(capsys, runs)
    assert folders(runs) == used
    reasons = {"damaged or of another version": 1, "failed or without": 2, "another build": 1, "an older deck": 1}
    for line, (reason, count) in zip(removed, reasons.items(), strict=True):
        assert line.startswith(f"removed {count} run{'s' * (count > 1)} ({VERLET} {count}), ")
        assert reason in line
    assert kept.startswith(f"kept 2 runs ({REFERENCE} 1, {VERLET} 1), ")
    assert batches.startswith("kept runs/batch: 2 rows of batches")
    assert freed == f"freed {sum(size for name, size in sizes.items() if name not in used) / 1000:.0f} kB"
    assert pruned(capsys, runs)[-1] == "freed 0 kB"
    assert [place.name for place in (runs / VERLET).iterdir() if place.name[0] == "."] == []


def test_runs_that_cannot_be_judged_or_just_ended_stay(
    runs: Path, tmp_path: Path, engines_file: EnginesWriter, capsys: pytest.CaptureFixture[str]
) -> None:
    """A link stays too: its folder is kept elsewhere on purpose, and its removal would free nothing."""
    engines_file(
        '[own]\nadapter = "liggghts"\ncommand = "no-such-program"\n'
        '[silent]\nadapter = "liggghts"\ncommand = "true"\n'  # prints no version
    )
    run, failed = done(runs, VERLET), next(run.folder for run in kept_runs(runs) if run.trouble)
    for engine in ("absent", "own", "silent"):
        (runs / engine).mkdir()
        away = copied(run, f"small-{'0' * 12}", engine=engine, identity="0" * 12)
        away.rename(runs / engine / away.name)
    copied(run, "mine")
    copied(run, f"{run.name[:-12]}{'1' * 12}", identity="1" * 12, edits=["another line"])
    failed.rename(tmp_path / "elsewhere")
    failed.symlink_to(tmp_path / "elsewhere")
    (runs / VERLET / "notes").mkdir()
    made_yesterday(runs)
    recent = copied(run, f"{run.name[:-12]}{'2' * 12}", identity="2" * 12)
    made_yesterday(runs)
    os.utime(recent / RECORD)
    before, lines = folders(runs), pruned(capsys, runs)
    assert folders(runs) == before
    assert (failed / RECORD).exists()
    assert (runs / VERLET / "notes").exists()
    for start, reason in (
        (f"kept 1 run ({VERLET} 1)", "ended less than 10 minutes ago"),
        ("kept 1 run (absent 1)", "has no entry here; --engines FILE"),
        ("kept 2 runs (own 1, silent 1)", "is not installed, or"),
        (f"kept 2 runs ({VERLET} 2)", "renamed or are links"),
        (f"kept 1 run ({VERLET} 1)", "imported, so"),
    ):
        assert any(line.startswith(start) and reason in line for line in lines), (reason, lines)
    assert lines[-1] == "freed 0 kB"


def test_a_folder_that_cannot_be_written_to_is_named(runs: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The message names the folder that the user knows, and not a temporary one in it."""
    monkeypatch.setattr(os, "access", lambda *_: False)  # root may write to any folder
    with pytest.raises(InputError) as message:
        prune(runs, (), (), ())
    assert str(message.value) == f"runs/{VERLET}: found a read-only folder; allowed: one that can be written to"


def test_only_what_is_selected_goes(runs: Path) -> None:
    failed = next(run.folder for run in kept_runs(runs) if run.trouble)
    other = copied(failed, f"other-{'0' * 12}", scene_name="other")
    prune(runs, ("small",), (VERLET,), ("chain.count=3",))
    prune(runs, (), (REFERENCE,), ())
    assert failed.exists()
    prune(runs, ("small",), (), ("chain.count=4",))
    assert not failed.exists()
    assert other.exists()


def test_leftovers_of_killed_runs_go_and_no_others(runs: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with workplace(runs / VERLET) as at_work:
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
        assert "removed 4 folders of killed processes, 4 kB" in pruned(capsys, runs)
        assert at_work.exists()
    (runs / VERLET / f".{'b' * 12}@elsewhere" / LEASE).write_text('["row"]')
    assert leased(runs / VERLET) == {"row"}
    left = {place.name[1:] for home in (VERLET, "batch/.work") for place in (runs / home).glob(".*@*")}
    assert left == {f"{'b' * 12}@elsewhere", f"{'c' * 12}@elsewhere"}


def test_a_run_that_was_replaced_meanwhile_stays(
    runs: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Another process repeats a failed run after it was selected for removal."""
    failed, good = next(run.folder for run in kept_runs(runs) if run.trouble), done(runs, VERLET)

    def late(*_: object) -> list[EndedRun]:
        before = kept_runs(runs)
        shutil.rmtree(failed)
        shutil.copytree(good, failed)
        edit_record(failed, identity=failed.name[-12:])
        return before

    monkeypatch.setattr(module, "kept_runs", late)
    prune(runs, (), (), ())
    assert replace(record_of(failed), identity=record_of(good).identity) == record_of(good)
    assert "removed" not in capsys.readouterr().out
