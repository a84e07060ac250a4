"""Runs, batches and records do not depend on measured traces."""

from pathlib import Path

import pytest

from drivers.engines import load_engine
from drivers.run.run import run_case
from drivers.run.run_folder import RunRecord
from validation.accuracy.plan import planned_case
from validation.tests.helpers.commands import beads
from validation.tests.helpers.scenes import SPEEDS, SceneWriter, StudyWriter
from validation.tests.postproc.read.test_measured import ENTRY, SENSORS


@pytest.mark.parametrize("engine", ["verlet", "reference"])
def test_measured_traces_are_not_part_of_a_run(scene_file: SceneWriter, tmp_path: Path, engine: str) -> None:
    """Deck, folder and record are the same; an earlier run is found, and the measured file is not read."""
    runs, path = tmp_path / "runs", scene_file(chain=SENSORS)
    plain = planned_case(path)
    before = run_case(plain, engine, runs)
    path.write_text(
        f"{path.read_text()}{ENTRY}[[measured]]\nvalues = {{ wall_peak = '2 N' }}\nerrors.wall_peak = 0.1\n"
    )
    case = planned_case(path)
    assert len(case.scene.measured) == 2
    assert load_engine(engine).render(case) == load_engine(engine).render(plain)
    assert case.scene.model_dump(mode="json") == plain.scene.model_dump(mode="json")
    found = run_case(case, engine, runs)
    assert found.folder == before.folder
    assert found.record == before.record
    assert described(run_case(case, engine, tmp_path / "others").record) == described(before.record)


def described(record: RunRecord) -> tuple[object, ...]:
    return record.scene, record.layout, record.elements, record.deck_sha256, record.files


@pytest.mark.long
def test_batches_and_runs_do_not_depend_on_measured_traces(study_file: StudyWriter, tmp_path: Path) -> None:
    """An earlier batch is complete and its table unchanged; an earlier run is found by the scene file."""
    study, scene = study_file(SPEEDS.format(2), "verlet"), tmp_path / "scene.toml"
    batch = ("batch", study, "--runs", tmp_path / "runs", "--results", tmp_path)
    assert "2 to do" in beads(*batch, "--dry-run").stdout
    assert beads(*batch).returncode == 0
    table = (tmp_path / "study.csv").read_bytes()
    ran = beads("run", scene, "--engine", "verlet", "--runs", tmp_path / "runs")
    assert ran.returncode == 0, ran.stderr
    scene.write_text(scene.read_text() + ENTRY)
    assert "2 to do" not in beads(*batch, "--dry-run").stdout
    assert beads(*batch).returncode == 0
    assert (tmp_path / "study.csv").read_bytes() == table
    found = beads("observables", f"verlet:{scene}", "--runs", tmp_path / "runs")
    assert (found.returncode, found.stderr) == (0, "")
