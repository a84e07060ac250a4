"""Fig. 6 (b) and (d): 18 small beads under a steel ball and under a large PTFE ball; the force on the wall."""

from pathlib import Path

from postproc.product import Product
from postproc.residual import residual
from postproc.stack import MICRO, stack_table
from postproc.style import COLUMN_IN, drawing_order, line_of, pyplot

PANELS = {
    "fig6b": "(b) 2 mm steel ball, 0.036 g, at 0.89 m/s",
    "fig6d": "(d) 4.76 mm PTFE ball, 0.123 g, at 0.89 m/s",
}


def make(runs: Path) -> Product:
    """Runs both scenes and draws the wall's force over its residual for each."""
    import numpy as np
    import pandas as pd

    from validation.simulate import REFERENCE, case_of, simulate

    cases = [case_of(scene, "run.duration=0.9 ms") for scene in PANELS]
    found = simulate(cases, runs)
    figure, axes = pyplot().subplots(
        4, 1, sharex=True, figsize=(COLUMN_IN, 5.6), height_ratios=[1.6, 0.8, 1.6, 0.8], squeeze=True
    )
    tables = []
    for place, (case, (scene, title)) in enumerate(zip(cases, PANELS.items(), strict=True)):
        traces = {engine: simulations[place].trace for engine, simulations in found.items()}
        force, difference = axes[2 * place : 2 * place + 2]
        for engine in drawing_order(list(traces)):
            line, trace = line_of(engine), traces[engine]
            force.plot(
                trace.time_s * MICRO,
                trace.force_N[:, 0],
                color=line.colour,
                lw=line.width,
                ls=line.dashes,
                label=engine,
            )
            if engine != REFERENCE:
                share = residual(trace, traces[REFERENCE])
                shown = np.where(share > 0, share, np.nan)
                difference.plot(trace.time_s * MICRO, shown, color=line.colour, lw=1.2, ls=line.dashes)
        force.set_title(title, loc="left")
        force.set_ylabel("wall force (N)")
        difference.set(yscale="log", ylim=(1e-7, 1e-3), ylabel="|ΔF| / largest")
        tables.append(stack_table(case.layout, traces).assign(scene=scene))
    axes[0].legend(loc="upper right")
    axes[-1].set(xlabel="time since impact (µs)", xlim=(0, 900))
    figure.align_ylabels()
    figure.subplots_adjust(hspace=0.4)
    return Product(figure, pd.concat(tables, ignore_index=True))
