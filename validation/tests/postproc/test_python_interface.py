"""The functions for notebooks: their examples, and the wrong calls they refuse."""

import doctest
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
def runs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Runs folder with rows of a study for which docstrings have examples."""
    folder = tmp_path_factory.mktemp("runs")
    options = ("--engine", "verlet", "--only", "striker.speed=2 m/s", "--slice", "1/1")
    assert beads("batch", "wall-material", "--runs", folder, *options).returncode == 0
    return folder


@pytest.mark.parametrize("name", [f"{package.__name__}.{name}" for package in PACKAGES for name in package.__all__])
def test_examples_in_docstrings(name: str, run: EndedRun, runs: Path) -> None:
    package, _, function = name.partition(".")
    exported = getattr(sys.modules[package], function)
    assert isinstance(exported, FunctionType)
    names = exported.__globals__ | {"folder": run.folder.parents[1], "run": run, "runs": runs, function: exported}
    (examples,) = doctest.DocTestFinder(recurse=False).find(exported, function, globs=names)
    assert examples.examples or function == "assess"
    failures: list[str] = []
    doctest.DocTestRunner().run(examples, out=failures.append)
    assert not failures, "".join(failures)


def test_wrong_calls_are_refused(tmp_path: Path) -> None:
    case, _ = validation.plan("fig4", SHORT_RUN)
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
        drivers.read_study_table("striker-mass", runs=tmp_path)
