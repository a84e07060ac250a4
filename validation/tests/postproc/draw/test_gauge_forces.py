"""Tests of the figure of gauge forces by all engines."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from drivers.chain.trace import Trace
from postproc.draw import gauge_forces
from postproc.draw.gauge_forces import draw_gauge_forces
from postproc.draw.style import svg_of
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


def test_curves_are_the_forces_and_differences_of_the_runs(
    runs: dict[str, Simulation], monkeypatch: pytest.MonkeyPatch
) -> None:
    layout, traces = runs["verlet"].case.layout, {name: run.trace for name, run in runs.items()}
    *panels, differences = draw_gauge_forces(layout, traces, {}).axes
    signals = {name: sensor_signals(layout, trace) for name, trace in traces.items()}
    for axis, gauge in zip(panels, signals["verlet"], strict=True):
        drawn = curves(axis)
        assert set(drawn) == {"reference", "verlet"}
        assert all(np.array_equal(drawn[name], signals[name][gauge]) for name in drawn)
    (line,) = differences.lines
    assert line.get_label() == "verlet − reference"
    assert np.array_equal(line.get_ydata(), residual(traces["verlet"], traces["reference"]))
    monkeypatch.setattr(gauge_forces, "MAX_GAUGES", 1)
    wall, _ = draw_gauge_forces(layout, traces, {}).axes
    assert wall.get_title("left") == "wall (N)"


def test_a_partial_trace_is_drawn_on_the_scale_of_the_others(runs: dict[str, Simulation]) -> None:
    layout, traces = runs["verlet"].case.layout, {name: run.trace for name, run in runs.items()}
    part = traces["verlet"].force_N.copy()
    part[100:] = np.nan
    figure = draw_gauge_forces(layout, traces, {"yade": replace(traces["verlet"], force_N=part)})
    *panels, differences = figure.axes
    whole = draw_gauge_forces(layout, traces, {}).axes
    for axis, other in zip(panels, whole, strict=False):
        drawn = curves(axis)["yade (failed)"]
        assert np.isfinite(drawn[:100]).all()
        assert np.isnan(drawn[100:]).all()
        assert axis.get_ylim() == other.get_ylim()
    drawn = curves(differences)["yade (failed) − reference"]
    assert np.isnan(drawn[100:]).all()
    assert "yade (failed)" in svg_of(figure)


def test_nothing_is_drawn_without_gauges_and_differences(runs: dict[str, Simulation]) -> None:
    case = case_of("fig4", "wall=", "chain.sensors=[]")
    trace: Trace = runs["verlet"].trace
    assert draw_gauge_forces(case.layout, {"verlet": replace(trace, force_N=trace.force_N[:, 1:])}, {}) is None
