"""Tests of the figure of gauge forces by all engines."""

from dataclasses import replace
from typing import Any

import numpy as np

from drivers.chain.schemes import verlet_of
from drivers.chain.trace import residual
from postproc.draw.gauge_forces import draw_gauge_forces
from postproc.read.motion import exact
from postproc.read.sensors import sensor_signals
from validation.tests.helpers.scenes import case_of


def curves(axis: Any) -> dict[str, np.ndarray]:
    return {line.get_label(): np.asarray(line.get_ydata()) for line in axis.lines}


def test_curves_are_the_forces_and_differences_of_whole_and_failed_runs() -> None:
    case = case_of("fig4", "run.time_step=1 us")
    traces = {"reference": exact(case).trace, "verlet": verlet_of(case)}
    part = replace(traces["verlet"], force_N=traces["verlet"].force_N.copy())
    part.force_N[100:] = np.nan
    *panels, differences = draw_gauge_forces(case.layout, traces, {"yade": part}).axes
    drawn = traces | {"yade (failed)": part}
    signals = {name: sensor_signals(case.layout, trace) for name, trace in drawn.items()}
    for axis, gauge in zip(panels, signals["verlet"], strict=True):
        assert set(curves(axis)) == set(drawn)
        assert all(np.array_equal(curves(axis)[name], signals[name][gauge], equal_nan=True) for name in drawn)
    shares = curves(differences)
    assert np.array_equal(shares["verlet − reference"], residual(traces["verlet"], traces["reference"]))
    assert np.isnan(shares["yade (failed) − reference"][100:]).all()
