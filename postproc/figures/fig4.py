"""Fig. 4: one solitary wave and its reflection."""

from pathlib import Path

from drivers.engines import REFERENCE
from postproc.draw.product import Product
from postproc.draw.stack import chain_of_reference, draw_stack, stack_table
from postproc.draw.style import FAINT
from postproc.paper.quoted import quoted
from postproc.paper.simulate import UNTIL_REFLECTED, case_of, simulate_one
from postproc.paper.strikes import sensor_pair, speed_between_sensors


def make(runs: Path) -> Product:
    """Runs Fig. 4's scene and draws it as in the paper's (b), what is quoted of (a) as notes."""
    case = case_of("fig4", UNTIL_REFLECTED)
    found = simulate_one(case, runs)
    traces = {engine: simulation.trace for engine, simulation in found.items()}
    figure, axes = draw_stack(case.layout, traces)
    experiment = quoted().fig4
    upper, lower = (f"bead_{bead}" for bead in sensor_pair(case))
    for name in (upper, lower):
        axes[name].axhline(experiment.leading_force_N, color=FAINT, lw=0.8, ls=(0, (2, 2)))
    axes[upper].annotate(
        f"exper.: about {experiment.leading_force_N:g} N", (0, experiment.leading_force_N),
        xycoords=("axes fraction", "data"), xytext=(4, 3), textcoords="offset points", color=FAINT, fontsize=7,
    )  # fmt: skip
    speed = speed_between_sensors(found[REFERENCE])
    words = f"from one to the next\n{speed:.1f} m/s,\nexper. {experiment.speed_m_s:g} m/s"
    axes[lower].text(0.015, 0.97, words, transform=axes[lower].transAxes, va="top", color=FAINT, fontsize=7)
    return Product(figure, stack_table(case.layout, traces), chain_of_reference(traces))
