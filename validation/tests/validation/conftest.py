"""Fixtures of several folders of this one."""

from pathlib import Path

import pytest

from validation.accuracy.budget import kept_budget
from validation.compare.comparison import ComparedScene, missing
from validation.tests.helpers.runs import finished
from validation.tests.helpers.scenes import SceneWriter, case_of


@pytest.fixture
def compared(scene_file: SceneWriter, shared_runs: Path) -> ComparedScene:
    case = case_of(scene_file("scene", chain="sensors = [{from_wall = 4}, {from_wall = 2}]"))
    runs = {engine: finished(case, engine, shared_runs) for engine in ("verlet", "reference")}
    absent = {"liggghts": "not installed", "yade": "failed: exit code 1: ERROR <b>&"}
    checks = [check for run in runs.values() for check in kept_budget(case, run).checks]
    return ComparedScene(case, runs, absent, [*missing(case, absent), *checks])
