"""Comparison of two runs, on the command line and in numbers."""

import re
import shutil
from collections.abc import Callable
from functools import partial
from pathlib import Path

import pytest

from drivers.base.errors import InputError
from drivers.run.run_folder import open_run
from validation.compare.comparison import common_samples, compare_runs, difference_rows
from validation.tests.helpers.commands import beads
from validation.tests.helpers.runs import add_force, edit_record, edit_table, finished, need
from validation.tests.helpers.scenes import SceneWriter, case_of

FolderOf = Callable[..., Path]


@pytest.fixture
def run_of(shared_runs: Path) -> FolderOf:
    """Returns the folder of a run, made once a session."""

    def folder(engine: str, scene: str | Path, *settings: str) -> Path:
        return finished(case_of(scene, *settings), engine, shared_runs).folder

    return folder


def differences_of(first: Path, second: Path) -> dict[str, float]:
    """Differences by quantity."""
    runs = open_run(first), open_run(second)
    return {name: float(size) for name, size, *_ in difference_rows(runs, common_samples(runs))}


def test_codes_at_the_same_step_differ_by_rounding(run_of: FolderOf) -> None:
    need("liggghts")
    differences = differences_of(run_of("verlet", "fig4"), run_of("liggghts", "fig4"))
    assert [*differences] == ["force", "energy", "momentum", "bead_9_peak", "bead_5_peak", "wall_peak", "speed_9_to_5"]
    assert max(differences.values()) < 1e-9


@pytest.mark.parametrize(("setting", "samples"), [("sample_interval=0.5 us", 301), ("duration=0.2 ms", 201)])
def test_common_sample_times(setting: str, samples: int, run_of: FolderOf, scene_file: SceneWriter) -> None:
    folders = [run_of("verlet", scene_file()), run_of("verlet", scene_file(), f"run.{setting}")]
    for both in (folders, folders[::-1]):
        assert [len(each.time_s) for each in common_samples([*map(open_run, both)])] == [samples] * 2
        assert differences_of(*both)["force"] == 0  # the same steps, looked at more often or for longer


def test_on_the_command_line(run_of: FolderOf, tmp_path: Path) -> None:
    verlet, other = str(run_of("verlet", "fig4")), str(run_of("verlet", "fig4", "wall.material=alumina"))
    good = beads("compare", verlet, run_of("verlet", "fig4", "run.time_step=1 us"))
    assert (good.returncode, good.stderr) == (0, "")
    for words in (
        "pass: both runs are those of their schemes",
        "time step 1e-06 s, 801 samples, commit ",
        "the scenes differ in run.time_step: 0.1 us against 1 us",
        "forces differ by more than 0.001 of the largest change: first in contact 5 at 465 µs",
        "error budget",
    ):
        assert words in good.stdout
    assert "the scenes differ in wall.material: brass against alumina" in beads("compare", verlet, other).stdout
    bad = Path(shutil.copytree(verlet, tmp_path / Path(verlet).name))
    edit_table(bad, partial(add_force, sample=200, contact=3, force_N=1e-3))
    wrong = beads("compare", verlet, bad)
    assert (wrong.returncode, wrong.stderr) == (1, "")
    assert wrong.stdout.startswith("FAIL: the second run departs from its scheme\n")
    assert re.search(r"^second +departs from its scheme from 200 µs, .*contact 3 is ", wrong.stdout, re.MULTILINE)
    assert re.search(r"^second +no single change explains it; ", wrong.stdout, re.MULTILINE)
    for given, found in (([verlet], "exactly two runs"), ([verlet, other, "--set", "seed=1"], "--set")):
        wrong = beads("compare", *given)
        assert (wrong.returncode, len(wrong.stderr.splitlines())) == (2, 1)
        assert found in wrong.stderr


def test_runs_that_cannot_be_compared(run_of: FolderOf, scene_file: SceneWriter, tmp_path: Path) -> None:
    good = run_of("verlet", scene_file())
    (tmp_path / "empty").mkdir()
    failed, foreign = (Path(shutil.copytree(good, tmp_path / name)) for name in ("failed", "foreign"))
    edit_record(failed, status="failed", reason="unstable", files={})
    edit_record(foreign, engine="abacus")
    for folder, found in (
        (tmp_path / "empty", "no record of a run"),
        (good.parent, "no record of a run"),
        (failed, "failed: unstable"),
        (foreign, 'engine: found "abacus"'),
        (run_of("verlet", scene_file(count=3)), "6 contacts against 4"),
        (run_of("verlet", scene_file(duration="2 us")), "4 or more"),
    ):
        with pytest.raises(InputError, match=found):
            compare_runs(good, folder)
