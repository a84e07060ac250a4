"""Tests of the codes on Fig. 4: truncation error and observables; ``beads engine`` tests the rest."""

from pathlib import Path

import pytest

from drivers.engines import codes
from postproc.read.observables import observe
from postproc.read.residual import residual
from validation.tests.helpers.runs import finished
from validation.tests.helpers.scenes import case_of


@pytest.mark.parametrize("engine", codes())
@pytest.mark.parametrize(("step", "limit"), [("0.1 us", 4e-5), ("0.01 us", 4e-7)])
def test_fig4_is_as_exact_as_its_step(step: str, limit: float, engine: str, shared_runs: Path) -> None:
    case = case_of("fig4", f"run.time_step={step}")
    run, exact = finished(case, engine, shared_runs), finished(case, "reference", shared_runs)
    assert residual(run.trace, exact.trace).max() <= limit


@pytest.mark.parametrize("engine", [*codes(), "reference"])
def test_fig4_reads_what_physics_says(engine: str, shared_runs: Path) -> None:
    run = finished(case_of("fig4"), engine, shared_runs)
    values = observe(run.layout, run.trace)
    assert values["bead_9_peak_N"] == pytest.approx(5.34, abs=0.005)
    assert values["bead_5_peak_N"] == pytest.approx(5.35, abs=0.005)
    assert values["wall_peak_N"] == pytest.approx(16.37, abs=0.005)
    assert values["energy_drift_J"] < 1e-5 * values["kinetic_energy_start_J"]
    assert values["impulse_imbalance_share"] < 1e-5
