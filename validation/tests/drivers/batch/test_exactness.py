"""The reference of a batch is as exact as the force errors of the rows need."""

import json
from pathlib import Path

import pytest

from drivers.chain.schemes import verlet_of
from drivers.chain.trace import residual
from drivers.limits import needed_tolerance
from validation.accuracy.motions import exact_motion_of
from validation.reference.adaptive import MIN_TOLERANCE
from validation.tests.helpers.adversarial import KINDS, adversarial_case
from validation.tests.helpers.commands import beads
from validation.tests.helpers.scenes import StudyWriter, case_of

CASES = {
    **{scene: (scene,) for scene in ("fig4", "fig5", "small-signal", "two-spheres", "deep-chain")},
    "finest": ("fig4", "run.time_step=0.5 ns"),
    "coarse": ("fig4", "run.time_step=1 us"),
    "damped": ("fig5", "contact.restitution=0.5"),
}


@pytest.mark.parametrize("name", [*CASES, *KINDS])
def test_force_errors_are_right_to_one_percent(name: str) -> None:
    case = case_of(*CASES[name]) if name in CASES else adversarial_case(name, 1)
    motion, tolerances = verlet_of(case), (needed_tolerance(case), MIN_TOLERANCE)
    shown, true = (float(residual(motion, exact_motion_of(case, each, finer=False).trace).max()) for each in tolerances)
    assert shown == pytest.approx(true, rel=0.01)


def test_a_coarser_step_needs_a_less_exact_reference(study_file: StudyWriter, tmp_path: Path) -> None:
    assert [needed_tolerance(case_of(*CASES[name])) for name in ("coarse", "fig4", "finest")] == [
        1e-6, 1e-7, MIN_TOLERANCE,
    ]  # fmt: skip
    path = study_file('[[axis]]\nkey = "run.time_step"\nvalues = ["0.5 us", "0.1 us"]', "reference")
    shown = beads("show", path, "1", "--runs", tmp_path / "runs")
    assert shown.returncode == 0, shown.stderr
    (deck,) = (tmp_path / "runs" / "reference").glob("*/chain.json")
    assert json.loads(deck.read_text())["tolerance"] == 1e-6
    force = json.loads((deck.parent / "run.json").read_text())["error_budget"][0]
    assert force["model"] == force["rounding"] == 0
    assert 0 < abs(force["truncation"]) < 1e-6
