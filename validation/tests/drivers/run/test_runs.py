"""Tests of runs: run once, found by their content, each scene with signals of its own."""

import json
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from drivers.run.run import run_case, run_many
from drivers.run.run_folder import FORCES, RECORD, SENSORS, open_run
from validation.accuracy.budget import assess
from validation.tests.helpers.runs import assessed, edit_record, finished
from validation.tests.helpers.scenes import SceneWriter, case_of


def test_done_run_is_found_again_under_any_name(scene_file: SceneWriter, tmp_path: Path) -> None:
    """It is assessed once for each scene."""
    case, other = case_of(scene_file("one")), case_of(scene_file("two"))
    first = run_case(case, "verlet", tmp_path)
    assert (first.record.error_budget, first.record.warnings, first.has_sensors) == (None, None, False)
    once = assess(first, case)
    assert once.record.error_budget
    files = [first.folder / name for name in (FORCES, RECORD)]
    stamps = [file.stat().st_mtime_ns for file in files]
    assert assess(run_case(case, "verlet", tmp_path), case).record.error_budget == once.record.error_budget
    assert [file.stat().st_mtime_ns for file in files] == stamps
    edit_record(first.folder, error_note="by other sources")  # the budget is that of the cache
    assert assess(run_case(case, "verlet", tmp_path), case).record.error_note == once.record.error_note
    again = run_case(other, "verlet", tmp_path)
    assert (again.folder, again.record.scene_name, again.record.error_budget) == (first.folder, "two", None)
    assert files[0].stat().st_mtime_ns == stamps[0]
    anew = run_case(other, "verlet", tmp_path, rerun=True)
    assert anew.folder.name.startswith("two-")
    assert not first.folder.exists()


def test_changed_physics_are_another_run(scene_file: SceneWriter, tmp_path: Path) -> None:
    """The speed and the height count, for the reference no time step does."""

    def folder(engine: str, *settings: str) -> Path:
        return run_case(case_of(scene_file(duration="20 us"), *settings), engine, tmp_path).folder

    changes = [(), ("striker.speed=1.0000001 m/s",), ("chain.origin=1 m",), ("run.time_step=0.2 us",)]
    for engine, runs in (("verlet", 4), ("reference", 3)):
        assert len({folder(engine, *change) for change in changes}) == runs
    assert folder("reference", "run.time_step=1 us") == folder("reference")


def test_run_folder_holds_forces_state_signals_and_record(scene_file: SceneWriter, tmp_path: Path) -> None:
    path = scene_file(chain='sensors = [{ from_wall = 2 }]\nbead = [{ from_wall = 1, velocity = "0 m/s" }]')
    run = finished(case_of(path, "run.record=['forces', 'state']"), "verlet", tmp_path)
    names = {file.name for file in run.folder.iterdir()}
    assert names == {
        "chain.json", "stdout.txt", "stderr.txt", "forces.parquet", "state.parquet", "sensors.csv", "run.json",
    }  # fmt: skip
    forces = pd.read_parquet(run.folder / "forces.parquet")
    sensors = pd.read_csv(run.folder / "sensors.csv")
    assert list(forces.columns) == [
        "time_s", *(f"contact_{j}_N" for j in range(1, 7)), "kinetic_energy_J", "total_energy_J", "momentum_N_s",
    ]  # fmt: skip
    assert list(sensors.columns) == ["time_s", "bead_2_N", "wall_N"]
    np.testing.assert_array_equal(sensors["bead_2_N"], (forces["contact_2_N"] + forces["contact_3_N"]) / 2)
    record = json.loads((run.folder / "run.json").read_text())
    assert record["status"] == "done"
    assert record["scene"]["chain"]["mass"] == 0.0001226
    assert record["steps"] == 3000
    assert 0 < record["loop_s"] < record["wall_s"]
    assert record["commit"]


def test_scenes_that_differ_in_gauges_share_a_run(
    scene_file: SceneWriter, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each keeps its signals when another is run again or fails."""
    path = scene_file()
    settings = ("chain.sensors=[{from_wall=2}]", "chain.sensors=[{from_wall=4}]", "sensor.time_constant=1 ms")
    cases = [case_of(path, setting) for setting in settings]
    shared = run_many([(case, "verlet") for case in cases], tmp_path)
    assert [open_run(run.folder).layout for run in shared] == [case.layout for case in cases]
    assert (len({run.folder for run in shared}), len({run.record.wall_s for run in shared})) == (3, 1)
    runs = [assessed(case, "verlet", tmp_path) for case in cases]
    signals = {run.folder: (run.folder / SENSORS).read_bytes() for run in runs}
    assert (len(signals), len(set(signals.values()))) == (3, 3)
    again = run_case(cases[0], "verlet", tmp_path, rerun=True)

    def late(*_: object) -> None:
        raise TimeoutError

    monkeypatch.setattr("drivers.run.compute.endable", late)
    assert run_case(cases[1], "verlet", tmp_path, rerun=True).record.status == "timeout"
    assert all((folder / SENSORS).read_bytes() == signals[folder] for folder in {*signals} - {again.folder})


def test_weak_impact_under_gravity_is_no_instability(scene_file: SceneWriter, tmp_path: Path) -> None:
    path = scene_file(count=0, top='gravity = "9.81 m/s^2"', step="1 us")
    assert run_case(case_of(path, "striker.speed=1e-6 m/s"), "verlet", tmp_path).done
