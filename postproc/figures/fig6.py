"""Fig. 6: small beads under a steel and a PTFE ball.

(b) and (d): 18 small beads under a steel ball and under a large PTFE ball; the force on the wall.
"""

from pathlib import Path

import pandas as pd

from drivers.engines import REFERENCE
from postproc.draw.product import Product
from postproc.draw.stack import draw_lines, draw_residuals, stack_table
from postproc.draw.style import COLUMN_IN, MICRO, pyplot
from postproc.paper.simulate import UNTIL_REFLECTED, case_of, simulate

PANELS = {"fig6b": "(b)", "fig6d": "(d)"}


def make(runs: Path) -> Product:
    """Runs both scenes and draws the wall's force over its residual for each."""
    cases = [case_of(scene, UNTIL_REFLECTED) for scene in PANELS]
    found = simulate(cases, runs)
    figure, axes = pyplot().subplots(4, 1, sharex=True, figsize=(COLUMN_IN, 5.8), height_ratios=[1.6, 0.8, 1.6, 0.8])
    tables, chains = [], {}
    for place, (case, letter) in enumerate(zip(cases, PANELS.values(), strict=True)):
        traces = {engine: simulations[place].trace for engine, simulations in found.items()}
        force, difference = axes[2 * place : 2 * place + 2]
        striker, time_s = case.scene.striker, case.sample_times_s
        assert striker is not None
        mass = f", {1e3 * striker.mass:g} g" if striker.mass else ""
        size = f"{1e3 * striker.diameter:g} mm " if striker.diameter else ""
        title = f"{letter} {size}{striker.material} ball{mass}, at {striker.speed:g} m/s"
        draw_lines(force, time_s, {engine: trace.force_N[:, 0] for engine, trace in traces.items()})
        force.set(ylabel="wall force (N)", xlim=(0, float(time_s[-1]) * MICRO))
        force.set_title(title, loc="left")
        draw_residuals(difference, traces)
        difference.set_ylabel("|ΔF| / largest change")
        tables.append(stack_table(case.layout, traces).assign(scene=case.scene.name))
        chains[title] = traces[REFERENCE]
    axes[0].legend(loc="upper right")
    axes[-1].set_xlabel("time since impact (µs)")
    figure.align_ylabels()
    figure.subplots_adjust(hspace=0.5)
    return Product(figure, pd.concat(tables, ignore_index=True), chains)
