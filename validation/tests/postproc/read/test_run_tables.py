"""Errors shown with observables are those from the true values of the scene as written."""

from pathlib import Path

import numpy as np
import pytest

import postproc
from drivers.chain.case import Case
from drivers.chain.schemes import exact_of
from drivers.run.run import run_case
from postproc.read.observables import scale_of, without_unit
from validation.accuracy.assess import assess
from validation.accuracy.exact_motion import quantities
from validation.tests.helpers.commands import beads
from validation.tests.helpers.scenes import case_of

SETTINGS = (
    *("run.time_step=", "run.accuracy={ wall_peak = 1e-2 }", "chain.precompression=0.01 mN"),
    *("chain.mass_scatter=0.001 mg", "contact.restitution=0.9999", "seed=3"),
)


def true_errors(case: Case, found: dict[str, float]) -> dict[str, float]:
    """Relative errors of observables from the exact motion of all elements of the scene, finely sampled."""
    true = quantities(case.full or case, exact_of(case.full or case, finer=32))
    return {name: abs(found[name] - true[name]) / scale_of(name, true) for name in found.keys() & true.keys()}


def test_printed_errors_are_from_the_scene_as_written(tmp_path: Path) -> None:
    """The accuracy leaves an element out, whose effect counts."""
    case = case_of("fig4", *SETTINGS)
    run = assess(run_case(case, "verlet", tmp_path), case)
    assert any(element.reason.startswith("left out (") for element in case.elements)
    right = true_errors(case, quantities(case, run.trace))
    table = postproc.errors(run)
    parts = table.drop(columns=["whole", "where"])
    assert np.abs(parts.sum(axis=1) - table["whole"]).max() < 1e-12
    assert table["elements"].abs().max() > 0
    said = beads("observables", run.folder).stdout.splitlines()
    printed = {
        words[0]: float(words[-1]) for words in map(str.split, said[1:]) if len(words) == 3 and words[-1] != "seen"
    }
    shown = {name: error for name, error in printed.items() if without_unit(name) in right}
    assert len(shown) == len(right)
    for name, error in shown.items():
        assert error == pytest.approx(right[without_unit(name)], rel=0.06, abs=1e-10), name
