"""Fixtures of several folders of this one."""

from pathlib import Path

import pytest

from validation.compare.comparison import ComparedScene
from validation.tests.helpers.runs import checks_of, finished
from validation.tests.helpers.scenes import BASE, STRIKER, WALL, case_of

GAUGES = "sensors = [{from_wall = 4}, {from_wall = 2}]"


@pytest.fixture(scope="session")
def compared(tmp_path_factory: pytest.TempPathFactory, shared_runs: Path) -> ComparedScene:
    """A small scene on two engines, without one that is missing and one that failed; not to be changed."""
    file = tmp_path_factory.mktemp("compared") / "scene.toml"
    file.write_text(BASE.format(count=5, chain=GAUGES, striker=STRIKER, wall=WALL, duration="0.3 ms", step="0.1 us"))
    case = case_of(file)
    runs = {engine: finished(case, engine, shared_runs) for engine in ("verlet", "reference")}
    absent = {"liggghts": "not installed", "yade": "failed: exit code 1: ERROR <b>&"}
    return ComparedScene(case, runs, absent, checks_of(case, runs, absent))
