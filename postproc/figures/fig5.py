"""Fig. 5: a train of solitary waves from a heavy striker.

Four times a bead's mass makes a train of four waves. The printed envelope of the elastic train (-0.0059 per µs) goes
through three maxima (-0.0060), not four (-0.0049).

Wall below eleven beads, struck by alumina of 0.47 g at 0.44 m/s. (a) Dissipation of Fig. 4(a): -0.0064 per µs; measured
-0.0067. (b) Elastic, 1.46 GPa; after 900 µs the returning train. (c) Mean contact forces of the top two beads. Quoted:
rise 50 µs, decay -0.0185 per µs, end at 370 µs. Computed, top bead: 31, -0.0125, 404.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from drivers.base.errors import InputError
from drivers.engines import REFERENCE
from postproc.draw.product import Product
from postproc.draw.stack import ForcePanel, draw_curve, draw_row, name_codes
from postproc.draw.style import AVERAGE, DAMPED, GREY, MICRO, PAGE_IN, QUOTED, letter_panel, pyplot
from postproc.paper.calibrated import calibrated
from postproc.paper.quoted import quoted
from postproc.paper.simulate import Simulation, case_of, simulate
from postproc.read.observables import LATER_PROMINENCE
from postproc.read.sensors import sensor_signals
from postproc.read.signals import (
    ENVELOPE_MAXIMA,
    Envelope,
    Peak,
    PulseShape,
    incident_pulse,
    peaks,
    train_envelope,
)

WALL = "wall"
PANELS = (
    ForcePanel("a", "with dissipation: fit", DAMPED | {"ls": "-"}),
    ForcePanel("b", "elastic", AVERAGE),
)
STEP_N = 1.0
PLACES = ("top bead", "second bead")  # of the incident pulse
DAMPED_SUFFIX = ", damped"  # to a place in the chain with dissipation
SECOND_BEAD = AVERAGE | {"color": "#0072b2", "ls": (0, (6, 1.5, 1, 1.5))}
MAXIMA = (2, ENVELOPE_MAXIMA, 4)  # of envelopes: the paper does not state through which maxima its own go
ENVELOPE: dict[str, Any] = {"color": GREY, "lw": 0.9, "ls": (0, (5, 2))}
EXTENSION_S = 1e-4  # of envelopes after the last maximum
ENTRANCE_S = 4.2e-4
POINTS = 60  # per curve


def make(runs: Path) -> Product:
    """Runs Fig. 5's scene with the calibrated dissipation and without any."""
    top = case_of("fig5").chain.beads
    # gauges without a mass of their own do not change the run
    gauges = f"chain.sensors=[{{ from_wall = {top} }}, {{ from_wall = {top - 1} }}]"
    cases = [case_of("fig5", gauges, *calibrated().settings), case_of("fig5", gauges)]
    found = simulate(cases, runs)
    shapes = [{engine: _shape(one) for engine, one in own.items()} for own in found]
    paper = quoted()
    figure = pyplot().figure(figsize=(PAGE_IN, 3.0), layout="constrained")
    grid = figure.add_gridspec(1, 3, width_ratios=[1.15, 1.15, 1])
    axes, tables = draw_row(figure, [grid[0], grid[1]], PANELS, found, STEP_N, gauges=(WALL,))
    rates = paper.fig5_measured_envelope_per_us, paper.fig5_computed_envelope_per_us
    for place, (panel, rate) in enumerate(zip(PANELS, rates, strict=True)):
        line = _draw_envelope(axes[place][WALL], shapes[place][REFERENCE], rate)
        tables[place] = pd.concat([tables[place], line, _envelopes(shapes[place], rate)]).assign(panel=panel.letter)
    chains = {f"({panel.letter}) {panel.words}": own[REFERENCE].trace for panel, own in zip(PANELS, found, strict=True)}
    entrance = figure.add_subplot(grid[2])
    letter_panel(entrance, "c", "incident pulse")
    damped, elastic = (own[REFERENCE] for own in found)
    tables += [each.assign(panel="c") for each in (_draw_entrance(entrance, damped, elastic), _pulses(*shapes))]
    name_codes(figure, axes)
    return Product(figure, pd.concat(tables, ignore_index=True), chains)


@dataclass(frozen=True)
class Shape:
    """Train at the wall, and incident pulse in each of ``PLACES``."""

    first: Peak  # first maximum of the train
    last_s: float  # time of the last maximum in an envelope
    envelopes: Mapping[int, Envelope]  # by number of maxima
    entrance: tuple[PulseShape, ...]


def _shape(one: Simulation) -> Shape:
    """Shapes of the signals of Fig. 5.

    Raises:
        InputError: The scene ends too early.
    """
    time_s, signals = one.trace.time_s, sensor_signals(one.case.layout, one.trace)
    *upper, wall = signals.values()
    maxima = [
        replace(peak, value=peak.value + float(wall[0])) for peak in peaks(time_s, wall - wall[0], LATER_PROMINENCE)
    ]
    envelopes = {count: curve for count in MAXIMA if (curve := train_envelope(maxima, count))}
    pulses = [incident_pulse(time_s, force - force[0]) for force in upper]
    entrance = tuple(pulse for pulse in pulses if pulse is not None)
    if ENVELOPE_MAXIMA not in envelopes or len(entrance) < len(PLACES):
        found = f"fewer than {ENVELOPE_MAXIMA} maxima at the wall, or no wave back at the top"
        raise InputError(one.case.scene.file, "run.duration", found, "until the wave is back, and weaker dissipation")
    return Shape(maxima[0], maxima[max(envelopes) - 1].time_s, envelopes, entrance)


def _envelopes(shapes: dict[str, Shape], quoted_per_us: float) -> pd.DataFrame:
    """Table of the rates of the envelopes through the first maxima of the train, per µs."""
    rows = [("paper", "envelope_per_us", quoted_per_us)]
    for engine, shape in shapes.items():
        for count, curve in shape.envelopes.items():
            rows.append((engine, f"envelope_{count}_maxima_per_us", curve.rate_per_s / MICRO))
    return pd.DataFrame(rows, columns=["engine", "quantity", "value"])


def _pulses(damped: dict[str, Shape], elastic: dict[str, Shape]) -> pd.DataFrame:
    """Table of rise, decay and duration of the incident pulse with and without dissipation, by place."""
    paper, names = quoted(), ("rise_us", "decay_per_us", "duration_us")
    incident = (paper.fig5_incident_rise_us, paper.fig5_incident_decay_per_us, paper.fig5_incident_duration_us)
    rows: list[tuple[str, str, str, float]] = [
        ("paper", "entrance", *pair) for pair in zip(names, incident, strict=True)
    ]
    for engine in damped:
        for shape, more in ((elastic[engine], ""), (damped[engine], DAMPED_SUFFIX)):
            for place, pulse in zip(PLACES, shape.entrance, strict=True):
                values = (pulse.rise_s * MICRO, pulse.decay_per_s / MICRO, pulse.duration_s * MICRO)
                rows += [(engine, place + more, *pair) for pair in zip(names, values, strict=True)]
    return pd.DataFrame(rows, columns=["engine", "place", "quantity", "value"])


def _draw_envelope(axis: Any, shape: Shape, quoted_per_us: float) -> pd.DataFrame:
    """Draws the envelope through the first three maxima, labelled with its rate and that of the paper.

    The envelope with the paper's rate would lie within the width of a line beside it.
    """
    curve = shape.envelopes[ENVELOPE_MAXIMA]
    time_s = np.linspace(shape.first.time_s, shape.last_s + EXTENSION_S, POINTS)
    force_N = curve.amplitude_N * np.exp(curve.rate_per_s * time_s)
    texts = [f"{words}{rate:.4f}/µs".replace("-", "\N{MINUS SIGN}")
             for words, rate in (("", curve.rate_per_s / MICRO), ("paper: ", quoted_per_us))]  # fmt: skip
    place, look = (axis.get_xlim()[1], 0.75 * shape.first.value), {"textcoords": "offset points", "ha": "right"}
    for text, up, colour in zip(texts, (9, 0), (GREY, QUOTED["color"]), strict=True):
        axis.annotate(text, place, (-2, up), color=colour, fontsize=7, **look)
    return draw_curve(axis, REFERENCE, f"envelope_{ENVELOPE_MAXIMA}_maxima", time_s, WALL, force_N, **ENVELOPE)


def _draw_entrance(axis: Any, damped: Simulation, elastic: Simulation) -> pd.DataFrame:
    """Draws averages of the two uppermost beads, and the quoted pulse with the height of the elastic pulse."""
    paper, upper = quoted(), [f"bead_{sensor.from_wall}" for sensor in elastic.case.layout.sensors]
    tables = []
    looks = ((elastic, 0, AVERAGE), (elastic, 1, SECOND_BEAD), (damped, 0, DAMPED))
    for one, place, look in looks:
        shown = one.trace.time_s <= ENTRANCE_S
        time_s, force_N = one.trace.time_s[shown], sensor_signals(one.case.layout, one.trace)[upper[place]][shown]
        words = PLACES[place] + DAMPED_SUFFIX * (one is damped)
        tables.append(draw_curve(axis, REFERENCE, words, time_s, "average", force_N, label=words, **look))
    top_N = float(tables[0]["average_N"].max())
    after_us = np.linspace(0, paper.fig5_incident_duration_us - paper.fig5_incident_rise_us, POINTS)
    time_s = np.concatenate([[0.0], paper.fig5_incident_rise_us + after_us]) / MICRO
    force_N = np.concatenate([[0.0], top_N * np.exp(paper.fig5_incident_decay_per_us * after_us)])
    tables.append(
        draw_curve(
            axis,
            "paper",
            "as quoted",
            time_s,
            "average",
            force_N,
            label="as quoted; straight rise\nand height: ours",
            **QUOTED,
        )
    )
    axis.legend(loc="upper right", handlelength=1.8, fontsize=7)
    axis.set(xlim=(0, ENTRANCE_S * MICRO), ylim=(0, 1.1 * top_N), xlabel="time since impact (µs)", ylabel="force (N)")
    return pd.concat(tables)
