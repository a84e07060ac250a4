"""Tests of the figure of gauge forces by all engines."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from postproc.draw import gauge_forces
from postproc.draw.gauge_forces import draw_gauge_forces
from postproc.paper.simulate import Simulation, run_codes
from postproc.read.residual import residual
from postproc.read.sensors import sensor_signals
from validation.tests.helpers.scenes import case_of


@pytest.fixture(scope="module")
def runs(shared_runs: Path) -> dict[str, Simulation]:
    case = case_of("fig4", "run.time_step=1 us")
    return {name: run for name, (run,) in run_codes({"reference": [case], "verlet": [case]}, shared_runs).items()}


def curves(axis: Any) -> dict[str, np.ndarray]:
    return {line.get_label(): np.asarray(line.get_ydata()) for line in axis.lines}


def test_curves_are_the_forces_and_differences_of_whole_and_failed_runs(
    runs: dict[str, Simulation], monkeypatch: pytest.MonkeyPatch
) -> None:
    layout, traces = runs["verlet"].case.layout, {name: run.trace for name, run in runs.items()}
    part = replace(traces["verlet"], force_N=traces["verlet"].force_N.copy())
    part.force_N[100:] = np.nan
    *panels, differences = draw_gauge_forces(layout, traces, {"yade": part}).axes
    whole = draw_gauge_forces(layout, traces, {}).axes
    drawn = {"reference": traces["reference"], "verlet": traces["verlet"], "yade (failed)": part}
    signals = {name: sensor_signals(layout, trace) for name, trace in drawn.items()}
    for axis, gauge, other in zip(panels, signals["verlet"], whole, strict=False):
        assert set(curves(axis)) == set(drawn)
        assert all(np.array_equal(curves(axis)[name], signals[name][gauge], equal_nan=True) for name in drawn)
        assert axis.get_ylim() == other.get_ylim()
    assert set(curves(differences)) >= {"verlet − reference", "yade (failed) − reference"}
    assert np.array_equal(curves(differences)["verlet − reference"], residual(traces["verlet"], traces["reference"]))
    assert np.isnan(curves(differences)["yade (failed) − reference"][100:]).all()
    monkeypatch.setattr(gauge_forces, "MAX_GAUGES", 1)
    wall, _ = draw_gauge_forces(layout, traces, {}).axes
    assert wall.get_title("left") == "wall (N)"


def test_nothing_is_drawn_without_gauges_and_differences(runs: dict[str, Simulation]) -> None:
    case, trace = case_of("fig4", "wall=", "chain.sensors=[]"), runs["verlet"].trace
    assert draw_gauge_forces(case.layout, {"verlet": replace(trace, force_N=trace.force_N[:, 1:])}, {}) is None
