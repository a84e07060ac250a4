"""Figures of the report."""

from typing import Any

from postproc.stack import draw_stack
from validation.scenes import ComparedScene


def draw_scene(scene: ComparedScene) -> Any:
    """Gauge signals of all engines over each other, with the force residuals below. Returns a figure."""
    traces = {engine: run.trace for engine, run in scene.runs.items()}
    figure, _ = draw_stack(scene.case.layout, traces, width_in=6.4, yardsticks=("reference", "verlet"))
    return figure
