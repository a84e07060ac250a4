"""Errors shown with observables are those from the true values of the scene as written."""

import re
from pathlib import Path

import numpy as np
import pytest

import postproc
from drivers.base.errors import InputError
from drivers.chain.schemes import exact_of
from drivers.run.run import run_case
from postproc.read.observables import scale_of, without_unit
from validation.accuracy.budget import assess
from validation.accuracy.motions import quantities
from validation.tests.helpers.commands import beads
from validation.tests.helpers.scenes import case_of

SETTINGS = (
    *("run.time_step=", "run.accuracy={ wall_peak = 1e-2 }", "chain.precompression=0.01 mN"),
    *("chain.mass_scatter=0.001 mg", "contact.restitution=0.9999", "seed=3"),
)


def test_printed_errors_are_from_the_scene_as_written(tmp_path: Path) -> None:
    """The accuracy leaves an element out, whose effect counts."""
    case = case_of("fig4", *SETTINGS)
    run = run_case(case, "verlet", tmp_path)
    with pytest.raises(InputError, match=re.escape("validation.assess(run)")):
        postproc.errors(run)
    run = assess(run, case)
    assert any(element.reason.startswith("left out (") for element in case.elements)
    found, true = quantities(case, run.trace), quantities(case.full or case, exact_of(case.full or case, finer=32))
    right = {name: abs(found[name] - true[name]) / scale_of(name, true) for name in found.keys() & true.keys()}
    table = postproc.errors(run)
    parts = table.drop(columns=["whole", "where"])
    assert np.abs(parts.sum(axis=1) - table["whole"]).max() < 1e-12
    assert table["elements"].abs().max() > 0
    printed = [line.split() for line in beads("observables", run.folder).stdout.splitlines()[1:]]
    shown = {words[0]: words[-1] for words in printed if len(words) == 3 and without_unit(words[0]) in right}
    assert len(shown) == len(right)
    for name, error in shown.items():
        assert float(error) == pytest.approx(right[without_unit(name)], rel=0.06, abs=1e-10), name
