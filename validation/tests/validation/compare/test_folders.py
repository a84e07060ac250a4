"""Comparison of two folders of runs, and of builds of a code: changed quantities, missing and failed runs."""

import os
import re
import shutil
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from drivers.base import paths
from drivers.base.errors import InputError
from drivers.engines import VERLET
from drivers.run.run_folder import RECORD, open_run
from validation.commands.beads import answer
from validation.compare.selection import EngineSelection
from validation.tests.helpers.commands import beads
from validation.tests.helpers.runs import add_force, edit_record, edit_table, finished
from validation.tests.helpers.scenes import EnginesWriter, SceneWriter, case_of

Compare = Callable[..., tuple[int, list[str]]]
SCENES = {"scene": (), "other": ("striker.speed=2 m/s",)}


@pytest.fixture
def folders(scene_file: SceneWriter, shared_runs: Path, tmp_path: Path) -> tuple[Path, Path]:
    """Two folders of the same runs."""
    old, new = tmp_path / "old", tmp_path / "new"
    for name, settings in SCENES.items():
        folder = finished(case_of(scene_file(name), *settings), VERLET, shared_runs).folder
        for side in (old, new):
            shutil.copytree(folder, side / VERLET / folder.name)
    return old, new


@pytest.fixture
def compare(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Compare:
    """Runs a comparison that requires no code; returns its exit code and lines."""

    def run(*words: str | Path) -> tuple[int, list[str]]:
        capsys.readouterr()
        monkeypatch.setattr("sys.argv", ["beads", "compare", *map(str, words), "--allow-missing"])
        code = answer()
        return code, capsys.readouterr().out.splitlines()

    return run


def run_of(side: Path, scene: str) -> Path:
    """Folder of a run."""
    (folder,) = (side / VERLET).glob(f"{scene}-*")
    return folder


def tamper(folder: Path, sample: int, contact: int, force_N: float) -> None:
    """Adds to a single force."""
    edit_table(folder, lambda table: add_force(table, sample, contact, force_N))


def test_a_changed_force_is_named_with_its_size_and_place(folders: tuple[Path, Path], compare: Compare) -> None:
    old, new = folders
    change = open_run(run_of(new, "scene")).trace.force_N.max()
    words = ("--runs", old, "--against", new)
    code, lines = compare(*words)
    assert code == 0
    rows = [line for line in lines if line.startswith(tuple(SCENES))][1:]  # below the heading
    assert [row.split()[:3] for row in rows] == [["other", VERLET, "all"], ["scene", VERLET, "all"]]
    assert all(row.endswith("pass: identical bit for bit") for row in rows)
    assert lines[-1] == "2 runs: 2 compared, 0 failed, missing or changed by more than allowed"
    tamper(run_of(new, "scene"), 37, 3, 1e-12 * change)
    code, lines = compare(*words, "scene")
    assert code == 0
    assert any(line.endswith("equal to rounding, largest difference in force") for line in lines)
    tamper(run_of(new, "scene"), 37, 3, 1e-3 * change)
    code, lines = compare(*words)
    assert code == 1
    rows = [line for line in lines if line.startswith("scene")][1:]
    assert re.match(rf"scene +{VERLET} +force +1\.\d\de-03 +1\.00e-09  fail: contact 3 at 37 µs; "
                    r"forces differ first in contact 3 at 37 µs$", rows[0])  # fmt: skip
    assert [row for row in lines if row.startswith("other")] == [row for row in lines if "bit for bit" in row]
    assert lines[-1] == f"details: beads compare {run_of(old, 'scene')} {run_of(new, 'scene')}"


def test_a_missing_run_is_a_failure_unless_allowed_and_the_closest_is_named(
    folders: tuple[Path, Path], compare: Compare, scene_file: SceneWriter, shared_runs: Path
) -> None:
    old, new = folders
    shutil.rmtree(run_of(new, "scene"))
    finer = finished(case_of(scene_file(), "run.time_step=0.05 us"), VERLET, shared_runs).folder
    shutil.copytree(finer, new / VERLET / finer.name)
    words = ("--runs", old, "--against", new)
    code, lines = compare(*words)
    assert code == 0  # with --allow-missing
    rows = [line for line in lines if re.search(rf"{VERLET} +run +not run: no such run in", line)]
    steps = ("0.1 us against 50 ns", "50 ns against 0.1 us")
    for row, step in zip(rows, steps, strict=True):
        assert row.endswith(f"; the closest differs: run.time_step: {step}")
    strict = beads("compare", *words)
    assert strict.returncode == 1
    assert f"fail: no such run in {new}" in strict.stdout
    assert strict.stderr.startswith("no established code ran")  # the pair of the other scene is of verlet
    assert len(strict.stderr.splitlines()) == 1


@pytest.mark.parametrize("place", [0, 1])
def test_runs_that_failed_or_cannot_be_read_are_rows(place: int, folders: tuple[Path, Path], compare: Compare) -> None:
    edit_record(run_of(folders[place], "scene"), status="failed", reason="unstable")
    record = run_of(folders[place], "other") / RECORD
    record.write_text(record.read_text()[:100])
    words = ("--runs", folders[0], "--against", folders[1])
    code, lines = compare(*words)
    assert code == 1
    (row,) = [line for line in lines if "failed: unstable" in line]
    assert row.endswith(f"fail: failed: unstable (in {folders[place]})")
    (row,) = [line for line in lines if "a record that is damaged" in line]
    assert f"(in {folders[place]})" in row
    code, lines = compare("scene", *words)
    assert code == 1
    assert not any("a record that is damaged" in line for line in lines)
    for side in folders:
        edit_record(run_of(side, "scene"), engine="abacus", status="done", reason="")
    code, lines = compare("scene", *words)
    assert code == 1
    assert any(re.match(r'scene +abacus +run .* fail: .*found "abacus"; allowed: ', line) for line in lines)


def test_the_last_of_several_builds_counts(folders: tuple[Path, Path], compare: Compare) -> None:
    old, new = folders
    first = run_of(new, "scene")
    last = shutil.copytree(first, first.with_name(f"{first.name[:-12]}{'0' * 12}"))
    edit_record(last, engine_version="another version", identity="0" * 12)
    tamper(last, 37, 3, 1.0)
    for folder, time_s in ((first, 1e9), (last, 2e9)):
        os.utime(folder / RECORD, (time_s, time_s))
    code, lines = compare("scene", "--runs", old, "--against", new)
    assert code == 1
    assert lines[0].endswith(" against another version")
    os.utime(first / RECORD, (3e9, 3e9))
    assert compare("scene", "--runs", old, "--against", new)[0] == 0


def test_a_list_of_scenes_and_engines(folders: tuple[Path, Path], compare: Compare) -> None:
    old, new = folders
    words = ("--runs", old, "--against", new)
    code, lines = compare("other.toml", *words, "--engine", VERLET)
    assert code == 0
    assert lines[-1].startswith("1 runs: 1 compared, 0 failed")
    assert compare(*words, "--require", "reference")[0] == 1
    for wrong, found in (
        (("third", *words), '"third" has no run in either folder; allowed: other, scene'),
        (("--runs", old, "--against", old.parent / "none"), "--against .*none: no runs here"),
        (("--runs", old.parent / "none", "--against", new), "--runs .*none: no runs here"),
        ((*words, "--set", "seed=1"), "--set: not allowed with --against"),
        ((run_of(old, "scene"), run_of(new, "scene"), "--against", new), "--against: not allowed with two runs"),
        ((), "compare: scene missing"),
    ):
        with pytest.raises(InputError, match=found):
            compare(*wrong)


ADAPTER = """from dataclasses import replace
from drivers.engines.verlet import ENGINE as VERLET
ENGINE = replace(VERLET, integrate=None, version=lambda command: "twin 1.0")
"""
SOFTER_BUILD = """#!{python}
import json, os, sys
from pathlib import Path
deck = Path("chain.json")
if deck.exists():
    values = json.loads(deck.read_text())
    values["stiffness_N_m-3/2"] = [(1 - 1e-6) * each for each in values["stiffness_N_m-3/2"]]
    deck.write_text(json.dumps(values))
os.execv({python!r}, [{python!r}, *sys.argv[1:]])
"""


def test_builds_of_a_code_side_by_side(
    engines_file: EnginesWriter, scene_file: SceneWriter, compare: Compare, tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:  # fmt: skip
    """Builds of one version and adapter: the same, too soft, missing."""
    (tmp_path / "twin.py").write_text(ADAPTER)
    (tmp_path / "softer").write_text(SOFTER_BUILD.format(python=sys.executable))
    (tmp_path / "softer").chmod(0o755)
    commands = {"twin": sys.executable, "same": f"env {sys.executable}", "missing": "./missing", "softer": "./softer"}
    engines_file("".join(f'[{name}]\nadapter = "twin.py"\ncommand = "{commands[name]}"\n' for name in commands))
    pairs = [("twin", "same"), ("twin", "softer")]
    assert EngineSelection((VERLET, "twin", "reference", "same", "softer")).builds == pairs

    scene = scene_file(duration="60 us")
    words = ["--runs", tmp_path / "runs", *(word for name in commands for word in ("--engine", name))]
    code, lines = compare(scene, *words)
    assert code == 1
    between = {other: [line for line in lines if f"{other} against twin " in line] for other in commands}
    assert re.match(r"scene +same against twin +all .*pass: identical bit for bit$", between["same"][0])
    moved = r" force +\d\.\d\de-0[5-8] .* fail: .*; forces differ first in contact \d at \d+ µs$"
    assert re.search(moved, between["softer"][0])
    assert re.search(r" run .* not run: missing: not installed$", between["missing"][0])

    (tmp_path / "scenes").mkdir()
    shutil.copy(scene, tmp_path / "scenes")
    monkeypatch.setattr(paths, "SCENES", tmp_path / "scenes")
    for name, expected in (("same", 0), ("softer", 1)):  # builds alone, on all shipped scenes
        code, lines = compare("--runs", tmp_path / "runs", "--engine", "twin", "--engine", name)
        assert code == expected
        assert len(lines) > 1
        assert all(line.startswith("scene ") and f"{name} against twin" in line for line in lines[1:])
