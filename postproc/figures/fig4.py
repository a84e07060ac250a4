"""Fig. 4: a single solitary wave on 21 beads, reflected by the wall; sensor averages and the wall's force."""

from pathlib import Path

from postproc.product import Product
from postproc.quoted import quoted
from postproc.stack import draw_stack, stack_table
from postproc.style import COLUMN_IN, FAINT


def make(runs: Path) -> Product:
    """Runs Fig. 4's scene and draws it as in the paper's (b), what is quoted of (a) as notes."""
    from validation.simulate import REFERENCE, case_of, simulate

    case = case_of("fig4", "run.duration=0.9 ms")  # until the reflected wave has passed bead 9
    found = {engine: one for engine, (one,) in simulate([case], runs).items()}
    traces = {engine: simulation.trace for engine, simulation in found.items()}
    figure, axes = draw_stack(case.layout, traces, width_in=COLUMN_IN)
    experiment, values = quoted().fig4, found[REFERENCE].values
    for name in ("bead_9", "bead_5"):
        axes[name].axhline(experiment.leading_force_N, color=FAINT, lw=0.8, ls=(0, (2, 2)))
    axes["bead_9"].annotate(
        f"exper.: about {experiment.leading_force_N:g} N", (0, experiment.leading_force_N),
        xycoords=("axes fraction", "data"), xytext=(4, 3), textcoords="offset points", color=FAINT, fontsize=7,
    )  # fmt: skip
    axes["bead_5"].text(
        0.015, 0.97, f"bead 9 to bead 5:\n{values['speed_9_to_5_m_s']:.1f} m/s,\nexper. {experiment.speed_m_s:g} m/s",
        transform=axes["bead_5"].transAxes, va="top", color=FAINT, fontsize=7,
    )  # fmt: skip
    return Product(figure, stack_table(case.layout, traces))
