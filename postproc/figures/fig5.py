"""Fig. 5: a heavy striker's train, its envelope and the incident pulse.

A heavy flat striker on 11 beads: a train of solitary waves at the wall, and the pulse that enters.
"""

from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from drivers.base.errors import InputError
from drivers.chain.case import Case
from drivers.chain.trace import Trace
from drivers.engines import REFERENCE
from postproc.draw.product import Product
from postproc.draw.stack import chain_of_reference, draw_stack, stack_table
from postproc.draw.style import FAINT, MICRO
from postproc.paper.quoted import quoted
from postproc.paper.simulate import case_of, simulate_one
from postproc.read.sensors import sensor_signals
from postproc.read.signals import ENVELOPE_MAXIMA, Envelope, PulseShape, incident_pulse, peaks, train_envelope

PLACES = ("top bead", "second bead")  # where the pulse enters


def make(runs: Path) -> Product:
    """Runs Fig. 5's scene and draws the entrance, the wall with its envelope, and what is quoted of both."""
    top = case_of("fig5").chain.beads
    # gauges without a mass of their own only change what is read, not what is run
    case = case_of("fig5", f"chain.sensors=[{{ from_wall = {top} }}, {{ from_wall = {top - 1} }}]")
    traces = {engine: one.trace for engine, one in simulate_one(case, runs).items()}
    shapes = {engine: _shapes(case, trace) for engine, trace in traces.items()}
    figure, axes = draw_stack(case.layout, traces)
    paper, look = quoted().fig5, {"va": "top", "color": FAINT}
    wall, until_s, entrance = shapes[REFERENCE]
    for bead, place, shape in zip((top, top - 1), PLACES, entrance, strict=True):
        axis = axes[f"bead_{bead}"]
        axis.set_title(f"{place}: mean of its contact forces (in brackets: quoted)", loc="left")
        words = (
            f"rise {shape.rise_s * MICRO:.0f} µs ({paper.incident_rise_us:g})\n"
            f"rate {shape.decay_per_s / MICRO:.4f} ({paper.incident_decay_per_us:g})\n"
            f"lasts {shape.duration_s * MICRO:.0f} µs ({paper.incident_duration_us:g})"
        )
        axis.text(0.12, 1.0, words, transform=axis.transAxes, fontsize=6.5, **look)
    axis, trace = axes["wall"], traces[REFERENCE]
    curve = wall.amplitude_N * np.exp(wall.rate_per_s * trace.time_s)
    inside = (trace.time_s <= until_s) & (curve <= 1.5 * trace.force_N[:, 0].max())
    axis.plot(trace.time_s[inside] * MICRO, curve[inside], color="black", lw=0.8)
    words = (
        f"exp({wall.rate_per_s / MICRO:.4f} t / µs)\n"
        f"paper: {paper.computed_envelope_per_us} computed,\n{paper.measured_envelope_per_us} measured"
    )
    axis.text(0.57, 0.97, words, transform=axis.transAxes, fontsize=7, **look)
    names = ("engine", "place", "wall_envelope_per_us", "rise_us", "decay_per_us", "duration_us")
    rows: list[tuple[Any, ...]] = [
        (engine, place, own_wall.rate_per_s / MICRO, shape.rise_s * MICRO, shape.decay_per_s / MICRO,
         shape.duration_s * MICRO)
        for engine, (own_wall, _, own) in shapes.items()
        for place, shape in zip(PLACES, own, strict=True)
    ]  # fmt: skip
    incident = (paper.incident_rise_us, paper.incident_decay_per_us, paper.incident_duration_us)
    rows.append(("paper, computed", None, paper.computed_envelope_per_us, None, None, None))
    rows.append(("paper, measured", "entrance", paper.measured_envelope_per_us, *incident))
    shown = pd.DataFrame(rows, columns=names).assign(part="shape")
    tables = [shown, stack_table(case.layout, traces).assign(part="trace")]
    return Product(figure, pd.concat(tables, ignore_index=True), chain_of_reference(traces))


def _shapes(case: Case, trace: Trace) -> tuple[Envelope, float, list[PulseShape]]:
    """Envelope of the wall's force, time of the first maximum beyond it, the pulse in each of ``PLACES``.

    An InputError where the scene ends too early.
    """
    shown, top = sensor_signals(case.layout, trace), case.chain.beads
    maxima = peaks(trace.time_s, shown["wall"])
    wall = train_envelope(maxima)
    readings = [shown[f"bead_{bead}"] for bead in (top, top - 1)]
    entrance = [incident_pulse(trace.time_s, reading - reading[0]) for reading in readings]
    whole = [shape for shape in entrance if shape is not None]
    if wall is None or len(maxima) <= ENVELOPE_MAXIMA or len(whole) < len(PLACES):
        raise InputError(case.scene.file, "run.duration", "no reflected wave within it", "until the wave is back")
    return wall, maxima[ENVELOPE_MAXIMA].time_s, whole
