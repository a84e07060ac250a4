"""Fig. 5: a heavy flat striker on 11 beads: a train of solitary waves at the wall, and the pulse that enters."""

from pathlib import Path

from postproc.product import Product
from postproc.pulse import envelope, incident_pulse
from postproc.quoted import quoted
from postproc.sensors import sensor_signals
from postproc.signals import peaks
from postproc.stack import MICRO, draw_stack, stack_table
from postproc.style import COLUMN_IN, FAINT

ENTRANCE = ("bead_11", "bead_10")  # the top bead and the next
MAXIMA = 3  # that the envelope goes through


def make(runs: Path) -> Product:
    """Runs Fig. 5's scene and draws the entrance, the wall with its envelope, and what is quoted of both."""
    import pandas as pd

    from validation.simulate import REFERENCE, case_of, simulate

    # gauges without a mass of their own only change what is read, not what is run
    case = case_of("fig5", "chain.sensors=[{ from_wall = 11 }, { from_wall = 10 }]")
    traces = {engine: one.trace for engine, (one,) in simulate([case], runs).items()}
    figure, axes = draw_stack(case.layout, traces, width_in=COLUMN_IN)
    paper = quoted().fig5
    rows = []
    for engine, trace in traces.items():
        signals, time = sensor_signals(case.layout, trace), trace.time_s
        wall = envelope(peaks(time, signals["wall"])[:MAXIMA])
        row = {"engine": engine, "wall_envelope_per_us": wall.rate_per_s / MICRO}
        for name in ENTRANCE:
            shape = incident_pulse(time, signals[name] - signals[name][0])
            row |= {
                f"{name}_rise_us": shape.rise_s * MICRO,
                f"{name}_decay_per_us": shape.decay_per_s / MICRO,
                f"{name}_duration_us": shape.duration_s * MICRO,
            }
            if engine == REFERENCE:
                text = (
                    f"rise {shape.rise_s * MICRO:.0f} µs ({paper.incident_rise_us:g})\n"
                    f"rate {shape.decay_per_s / MICRO:.4f} ({paper.incident_decay_per_us:g})\n"
                    f"lasts {shape.duration_s * MICRO:.0f} µs ({paper.incident_duration_us:g})"
                )
                which = "top bead" if name == ENTRANCE[0] else "second bead"
                axes[name].set_title(f"{which}: mean of its contact forces (in brackets: quoted)", loc="left")
                axes[name].text(0.12, 1.0, text, transform=axes[name].transAxes, va="top", color=FAINT, fontsize=6.5)
        rows.append(row)
        if engine == REFERENCE:
            until = time <= peaks(time, signals["wall"])[MAXIMA].time_s
            inside = until & (wall.at(time) <= 1.5 * signals["wall"].max())
            axes["wall"].plot(time[inside] * MICRO, wall.at(time[inside]), color="black", lw=0.8)
            axes["wall"].text(
                0.57, 0.97, f"exp({wall.rate_per_s / MICRO:.4f} t / µs)\n"
                f"paper: {paper.computed_envelope_per_us} computed,\n{paper.measured_envelope_per_us} measured",
                transform=axes["wall"].transAxes, va="top", color=FAINT, fontsize=7,
            )  # fmt: skip
    quotes = {"engine": "paper, computed", "wall_envelope_per_us": paper.computed_envelope_per_us}
    measured = {"engine": "paper, measured", "wall_envelope_per_us": paper.measured_envelope_per_us}
    for name in ENTRANCE:
        measured |= {
            f"{name}_rise_us": paper.incident_rise_us,
            f"{name}_decay_per_us": paper.incident_decay_per_us,
            f"{name}_duration_us": paper.incident_duration_us,
        }
    shapes = pd.DataFrame([*rows, quotes, measured]).assign(part="shape")
    table = pd.concat([shapes, stack_table(case.layout, traces).assign(part="trace")], ignore_index=True)
    return Product(figure, table)
