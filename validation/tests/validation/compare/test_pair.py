"""Comparison of two runs, on the command line and in numbers."""

import shutil
from collections.abc import Callable
from pathlib import Path

import pandas as pd
import pytest

from drivers.base.errors import InputError
from drivers.run.run_folder import FORCES, RECORD
from validation.checks import FAIL, PASS
from validation.compare.pair import Pair, compare_pair, compare_runs, different_keys, open_pair
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


def pair_of(first: Path, second: Path) -> Pair:
    return compare_pair(*open_pair(first, second))


def keys_of(pair: Pair) -> list[str]:
    return different_keys(pair.first.run.record.scene, pair.second.run.record.scene)


def red(pair: Pair) -> set[str]:
    return {check.quantity for check in pair.checks if check.verdict == FAIL}


@pytest.fixture
def copied(tmp_path: Path) -> Callable[[Path], Path]:
    """Copies a run folder, to be spoilt."""

    def copy(folder: Path) -> Path:
        return Path(shutil.copytree(folder, tmp_path / "spoilt"))

    return copy


def test_same_scheme_same_step_is_judged_by_rounding(run_of: FolderOf) -> None:
    need("liggghts")
    pair = pair_of(run_of("verlet", "fig4"), run_of("liggghts", "fig4"))
    limits = {check.quantity: check.limit for check in pair.checks}
    assert limits["force"] == 1e-9
    assert set(limits) == {"force", "energy", "momentum", "bead_9_peak", "bead_5_peak", "wall_peak", "speed_9_to_5"}
    assert {check.verdict for check in pair.checks} == {PASS}
    assert keys_of(pair) == []


def test_the_difference_of_the_schemes_explains_another_engine_and_step(run_of: FolderOf) -> None:
    for other in (run_of("reference", "fig4"), run_of("verlet", "fig4", "run.time_step=1 us")):
        pair = pair_of(run_of("verlet", "fig4"), other)
        assert not pair.missed
        force = pair.checks[0]
        assert force.value < force.limit == 2e-9
        assert "beyond the difference of the schemes" in force.reason
        assert pair.parted[1e-6]


@pytest.mark.parametrize(("engine", "step"), [("verlet", "1 us"), ("reference", "0.1 us")])
def test_another_step_explains_no_other_mass(run_of: FolderOf, engine: str, step: str) -> None:
    other = run_of(engine, "fig4", f"run.time_step={step}", "chain.mass=0.12258 g")
    assert {"force", "momentum", "wall_peak", "speed_9_to_5"} <= red(pair_of(run_of("verlet", "fig4"), other))


def test_the_first_force_that_differs_is_that_of_the_changed_contact(run_of: FolderOf) -> None:
    walls = [run_of("verlet", "fig4", "gravity=0 m/s^2", f"wall.material={wall}") for wall in ("brass", "alumina")]
    pair = pair_of(*walls)
    assert "wall.material: brass against alumina" in keys_of(pair)
    assert {"force", "wall_peak", "momentum", "energy"} <= red(pair)
    assert "bead_9_peak" not in red(pair)  # the wave has not been at the wall yet
    assert pair.parted[1e-9].startswith("contact 1 at 4")


@pytest.mark.parametrize(("setting", "samples"), [("sample_interval=0.5 us", 301), ("duration=0.2 ms", 201)])
def test_common_sample_times(setting: str, samples: int, run_of: FolderOf, scene_file: SceneWriter) -> None:
    folders = [run_of("verlet", scene_file()), run_of("verlet", scene_file(), f"run.{setting}")]
    for pair in (pair_of(*folders), pair_of(*reversed(folders))):
        assert len(pair.first.trace.time_s) == len(pair.second.trace.time_s) == samples
        assert pair.first.case.sample_times_s == pytest.approx(pair.second.trace.time_s)
        assert pair.checks[0].value == 0  # the same steps, looked at more often or for longer
        assert not pair.missed


def test_sample_times_that_do_not_meet(run_of: FolderOf, scene_file: SceneWriter) -> None:
    one = run_of("verlet", scene_file())
    for settings in (("run.sample_interval=0.7 us",), ("run.sample_interval=0.5 us", "run.duration=0.1 ms")):
        with pytest.raises(InputError, match=r"run\.sample_interval"):
            open_pair(one, run_of("verlet", scene_file(), *settings))
    with pytest.raises(InputError, match=r"4 contacts|6 contacts"):
        open_pair(one, run_of("verlet", scene_file(count=3)))
    with pytest.raises(InputError, match="4 or more"):
        open_pair(one, run_of("verlet", scene_file(duration="2 us")))


def test_a_chaotic_pair_is_judged_up_to_its_horizon(run_of: FolderOf) -> None:
    need("liggghts")
    long = ("run.duration=20 ms", "run.sample_interval=5 us")
    pair = pair_of(run_of("verlet", "fig4", *long), run_of("liggghts", "fig4", *long))
    assert "where rounding alone explains" in pair.until
    assert not pair.missed
    assert 12e3 < float(pair.parted[1e-2].split()[-2]) < 20e3  # µs: beyond the horizon, so not judged


def test_codes_in_a_tube_may_differ_by_their_laws_of_friction(run_of: FolderOf) -> None:
    short = ("run.duration=40 us",)
    tube = pair_of(*(run_of(engine, "fig5-tube", *short) for engine in ("liggghts", "yade")))
    assert not tube.missed
    assert tube.checks[0].limit == 3e-2
    own = pair_of(run_of("verlet", "fig5-tube", *short), run_of("liggghts", "fig5-tube", *short))
    assert not own.missed
    assert own.checks[0].limit == 1e-4


def test_keys_have_units_and_may_be_missing_in_one_scene() -> None:
    one = {"name": "a", "run": {"time_step": 1e-7}, "chain": {"sensors": [{"from_wall": 9}]}}
    other = {"name": "b", "run": {"time_step": 2e-7}, "chain": {"sensors": []}, "wall": {"material": "m"}}
    assert different_keys(one, other) == [
        "run.time_step: 0.1 us against 0.2 us",
        "chain.sensors: [{from_wall=9}] against []",
        'wall: none against {material="m"}',
    ]


def test_on_the_command_line(run_of: FolderOf) -> None:
    verlet, other = str(run_of("verlet", "fig4")), str(run_of("verlet", "fig4", "wall.material=alumina"))
    good = beads("compare", verlet, run_of("verlet", "fig4", "run.time_step=1 us"))
    assert (good.returncode, good.stderr) == (0, "")
    for words in (
        "pass: all ",
        "time step 1e-06 s, 800 steps, 801 samples, commit ",
        "the scenes differ in run.time_step: 0.1 us against 1 us",
        "allowed: beyond the difference of the schemes at the two time steps",
        "forces differ by more than 0.001 of the largest change: first in contact 5 at 465 µs",
        "error budget",
    ):
        assert words in good.stdout
    bad = beads("compare", verlet, other)
    assert (bad.returncode, bad.stderr) == (1, "")
    assert bad.stdout.startswith("FAIL: larger differences than allowed in force, energy, momentum, wall_peak")
    for given, found in (([verlet], "exactly two runs"), ([verlet, other, "--set", "seed=1"], "--set")):
        wrong = beads("compare", *given)
        assert (wrong.returncode, len(wrong.stderr.splitlines())) == (2, 1)
        assert found in wrong.stderr


def test_folders_that_are_no_runs(run_of: FolderOf, copied: Callable[[Path], Path], tmp_path: Path) -> None:
    good = run_of("verlet", "fig4")
    for folder in (tmp_path / "empty", tmp_path / "batch"):
        folder.mkdir()
    (tmp_path / "batch" / "part.jsonl").write_text("{}\n")
    for folder, found in (
        (good.parent / "." / good.name, "both are the same run"),
        (tmp_path / "empty", "no record of a run"),
        (good.parent, "a folder of runs"),
        (tmp_path, "the store of a batch"),
        (tmp_path / "batch", "the store of a batch"),
    ):
        with pytest.raises(InputError, match=found):
            compare_runs(good, folder)
    spoilt = copied(good)
    record, forces = (spoilt / RECORD).read_text(), (spoilt / FORCES).read_bytes()

    def refused(found: str) -> None:
        with pytest.raises(InputError, match=found):
            compare_runs(good, spoilt)
        (spoilt / RECORD).write_text(record)

    edit_record(spoilt, status="failed", reason="unstable", files={})
    refused("failed: unstable")
    edit_record(spoilt, engine="abacus")
    refused('engine: found "abacus"')
    edit_record(spoilt, bodies=None)
    refused("of another version")
    (spoilt / RECORD).write_text(record[:200])
    refused("a damaged file")
    (spoilt / FORCES).write_bytes(forces[:1000])
    refused("altered")
    (spoilt / FORCES).unlink()
    refused("no such file")


# tables that this version never writes: rows that do not match the scene of the record
ODD_FORCES: dict[str, Callable[[pd.DataFrame], pd.DataFrame]] = {
    "backwards": lambda table: table.iloc[::-1],
    "no rows": lambda table: table.iloc[:0],
    "words": lambda table: table.assign(contact_3_N="a"),
    "no time": lambda table: table * 0.0,
    "rows missing at the end": lambda table: table.iloc[:-100],
    "a contact missing": lambda table: table.drop(columns="contact_22_N"),
}


@pytest.mark.parametrize("name", ODD_FORCES)
def test_forces_that_are_none(name: str, run_of: FolderOf, copied: Callable[[Path], Path]) -> None:
    good = run_of("verlet", "fig4")
    spoilt = copied(good)
    edit_table(spoilt, lambda table: ODD_FORCES[name](table).reset_index(drop=True))
    with pytest.raises(InputError, match=r"a damaged file|forces of the record's scene"):
        compare_runs(good, spoilt)


def test_a_copy_is_the_same_and_changed_forces_are_refused(
    run_of: FolderOf, copied: Callable[[Path], Path], capsys: pytest.CaptureFixture[str]
) -> None:
    good = run_of("verlet", "fig4")
    copy = copied(good)
    assert compare_runs(good, copy) == 0
    assert "warning" not in capsys.readouterr().out
    add_force(pd.read_parquet(copy / FORCES), 600, 7, 1e-6).to_parquet(copy / FORCES)
    with pytest.raises(InputError, match="altered since"):
        compare_runs(good, copy)
    edit_table(copy, lambda table: table)  # sealed again
    assert compare_runs(good, copy) == 1
    assert "contact 7 at 600 µs" in capsys.readouterr().out
