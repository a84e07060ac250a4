"""Figures of the report."""

from typing import Any

from postproc.spacetime import Panel, draw_spacetime
from postproc.stack import EXACT, draw_stack
from validation.scenes import ComparedScene


def draw_scene(scene: ComparedScene) -> Any:
    """Gauge signals of all engines over each other, with the force residuals below. Returns a figure."""
    traces = {engine: run.trace for engine, run in scene.runs.items()}
    figure, _ = draw_stack(scene.case.layout, traces, width_in=6.4, yardsticks=("reference", "verlet"))
    return figure


def draw_chain(scene: ComparedScene) -> Any:
    """Forces of every contact against time, by the reference where it ran. Returns a figure."""
    engine = EXACT if EXACT in scene.runs else next(iter(scene.runs))
    return draw_spacetime([Panel(f"every contact of the chain ({engine})", scene.runs[engine].trace)], 6.4)
