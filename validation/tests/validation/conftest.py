"""Fixtures of several folders of this one."""

from pathlib import Path

import pytest

from validation.compare.comparison import ComparedScene
from validation.tests.helpers.runs import checks_of, finished
from validation.tests.helpers.scenes import SceneWriter, case_of


@pytest.fixture
def compared(scene_file: SceneWriter, shared_runs: Path) -> ComparedScene:
    case = case_of(scene_file("scene", chain="sensors = [{from_wall = 4}, {from_wall = 2}]"))
    runs = {engine: finished(case, engine, shared_runs) for engine in ("verlet", "reference")}
    absent = {"liggghts": "not installed", "yade": "failed: exit code 1: ERROR <b>&"}
    return ComparedScene(case, runs, absent, checks_of(case, runs, absent))
