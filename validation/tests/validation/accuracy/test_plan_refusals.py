"""Refusals of a plan: the same as those of a run, and a best accuracy that is allowed."""

import re
from pathlib import Path

import numpy as np
import pytest

from drivers.base.errors import InputError
from drivers.limits.refusal import refuse, unattainable
from validation.accuracy.plan_report import plan_report
from validation.tests.helpers.scenes import SceneWriter, case_of

STEP, ACCURACY = ("run.time_step=1 ns", "run.duration=50 us"), ("run.time_step=", "run.accuracy=1e-2")


@pytest.mark.parametrize("least", [1e-11, 0.0123, 0.9, 0.985, 0.989, 0.9901, 0.995, 0.99999, 1.0, 3.0, np.inf, np.nan])
def test_a_refusal_names_an_attainable_accuracy_that_is_allowed_or_none(least: float) -> None:
    said = str(unattainable(case_of("fig4"), "force", 1e-12, least, "here is why"))
    named = re.search(r"allowed: at least (\S+) here, here is why", said)
    if named is None:
        assert not least <= 0.99
        assert "allowed: none here, here is why" in said
    else:
        assert least <= float(named[1]) <= min(1.1 * least, 0.99)


def refusal_by_run(path: Path, settings: tuple[str, ...]) -> str:
    try:
        refuse(case_of(path, *settings), "reference")
    except InputError as error:
        return str(error)
    return ""


def refusal_by_plan(path: Path, settings: tuple[str, ...]) -> str:
    try:
        list(plan_report(path, settings))
    except InputError as error:
        return str(error)
    return ""


@pytest.mark.parametrize("timing", [STEP, ACCURACY])
def test_a_motion_refused_to_a_run_is_refused_to_its_plan(timing: tuple[str, ...], scene_file: SceneWriter) -> None:
    """From striker speeds at which the beads are pressed a tenth of a radius deep to three radii."""
    path, refused = scene_file(), []
    for speed in np.geomspace(3, 1500, 7):
        settings = (f"striker.speed={speed:.4g} m/s", *timing)
        said = refusal_by_run(path, settings)
        assert refusal_by_plan(path, settings) == said
        refused.append("radii deep" in said)
    assert refused == sorted(refused)
    assert not refused[0]
    assert refused[-1]
