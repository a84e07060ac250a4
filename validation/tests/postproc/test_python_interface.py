"""The functions for notebooks: their examples, the wrong calls they refuse, and how little they load."""

import doctest
import subprocess
import sys
from pathlib import Path
from types import FunctionType
from typing import Any

import pytest

import drivers
import postproc
import validation
from drivers.base.errors import InputError, RunError
from drivers.run.run_folder import EndedRun
from validation.tests.helpers.commands import beads

PACKAGES = (drivers, postproc, validation)
SHORT_RUN = {"run.duration": "20 us", "run.time_step": 1e-7}


@pytest.fixture(scope="module")
def run(shared_runs: Path) -> EndedRun:
    return drivers.run_scene("fig4", "verlet", runs=shared_runs)


@pytest.fixture(scope="module")
def tables(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Results of a study for which docstrings have examples."""
    folder = tmp_path_factory.mktemp("tables")
    options = ("--engine", "verlet", "--only", "striker.speed=2 m/s", "--runs", folder / "runs", "--results", folder)
    assert beads("batch", "wall-material", *options).returncode == 0
    return folder


@pytest.mark.parametrize("name", [f"{package.__name__}.{name}" for package in PACKAGES for name in package.__all__])
def test_examples_in_docstrings(name: str, run: EndedRun, tables: Path) -> None:
    package, _, function = name.partition(".")
    exported = getattr(sys.modules[package], function)
    assert isinstance(exported, FunctionType)
    names = exported.__globals__ | {"folder": run.folder.parents[1], "run": run, "tables": tables, function: exported}
    (examples,) = doctest.DocTestFinder(recurse=False).find(exported, function, globs=names)
    assert examples.examples or function == "assess"
    failures: list[str] = []
    doctest.DocTestRunner().run(examples, out=failures.append)
    assert not failures, "".join(failures)


def test_a_done_run_is_found_again(run: EndedRun, shared_runs: Path) -> None:
    written = (run.folder / "forces.parquet").stat().st_mtime_ns
    again = drivers.run_scene("fig4", "verlet", {"striker.speed": 2}, runs=shared_runs)  # 2 m/s, as in the file
    assert again.folder == run.folder
    assert (again.folder / "forces.parquet").stat().st_mtime_ns == written
    assert drivers.open_run(run.folder).record == run.record


def test_a_planned_case_keeps_its_accuracy(tmp_path: Path) -> None:
    case, errors = validation.plan("fig4", {"run.time_step": None, "run.accuracy": {"wall_peak": 1e-3}})
    assert set(errors) == {"wall_peak"}
    ended = validation.assess(drivers.run_scene(case, "verlet", runs=tmp_path), case)
    assert ended.record.accuracy is not None
    measured = ended.record.accuracy["wall_peak"]["measured"]
    assert measured == pytest.approx(errors["wall_peak"], rel=1e-4)
    assert measured < 1e-3
    assert postproc.gauges(ended).reset_index().columns.tolist() == ["time_s", "bead_9_N", "bead_5_N", "wall_N"]
    assert (ended.folder / "sensors.csv").is_file()


def test_wrong_calls_are_refused(tmp_path: Path) -> None:
    case, errors = validation.plan("fig4", SHORT_RUN)
    assert set(errors) == {"force"}  # of a scene with a time step of its own
    wrong: list[tuple[Any, dict[str, Any], str]] = [
        ("fig4", {"run.time_step": None, "run.accuracy": 1e-4}, r"run\.accuracy"),
        ("fig4", {"striker.sped": 1.0}, "striker"),
        (case, SHORT_RUN, "settings"),
    ]
    for scene, settings, message in wrong:
        with pytest.raises(InputError, match=message):
            drivers.run_scene(scene, "verlet", settings, runs=tmp_path)
    with pytest.raises(RunError, match="timeout"):
        drivers.run_scene("fig4", "verlet", {"run.time_step": "0.1 ns"}, runs=tmp_path, time_limit_s=0.2)
    with pytest.raises(InputError):
        drivers.open_run("verlet:fig4", runs=tmp_path)
    with pytest.raises(InputError, match="beads batch striker-mass"):
        drivers.read_study_table("striker-mass", results=tmp_path)


def test_packages_load_nothing_when_they_are_imported() -> None:
    probe = """import sys, drivers, postproc, validation
print([name for name in sys.modules if name in ("numpy", "pandas") or name.partition(".")[2] and
       name.partition(".")[0] in ("drivers", "postproc", "validation")])"""
    assert subprocess.run([sys.executable, "-c", probe], capture_output=True, text=True, check=True).stdout == "[]\n"
