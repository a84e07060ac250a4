"""Fig. 5: a train of solitary waves from a heavy striker.

Four times a bead's mass makes a train of four waves. The printed envelope of the elastic train (-0.0059 per µs) goes
through three maxima (-0.0060), not four (-0.0049).

Wall below eleven beads, struck by alumina of 0.47 g at 0.44 m/s. (a) In place of the measured curve the fit of Fig.
4(a): -0.0065 per µs; quoted -0.0067. (b) Elastic, 1.46 GPa; after 900 µs the returning train. (c) Mean contact forces
of the top two beads. Quoted: rise 50 µs, decay -0.0185 per µs, end at 370 µs. Computed, top bead, from 2 % of the peak
on: 31, -0.0125, 404.
"""

from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from drivers.base.errors import InputError
from drivers.engines import REFERENCE
from postproc.draw.plot import AVERAGE, DAMPED, GREY, MICRO, QUOTED, Product, letter_panel
from postproc.draw.stack import draw_curve, draw_pairs, quoted_rows
from postproc.paper import calibrated, quoted
from postproc.read.motion import Simulation, case_of, simulate
from postproc.read.observables import ENVELOPE_MAXIMA, LATER_PROMINENCE, train_envelope
from postproc.read.signals import Peak, incident_pulse, peaks

WALL = "wall"
PANELS = {"with dissipation: fit": DAMPED | {"ls": "-"}, "elastic": AVERAGE}
STEP_N = 1.0
PLACES = ("top bead", "second bead")  # of the incident pulse
SECOND_BEAD = AVERAGE | {"color": "#0072b2", "ls": (0, (6, 1.5, 1, 1.5))}
MAXIMA = (2, ENVELOPE_MAXIMA, 4)  # of envelopes: the paper does not state through which maxima its own go
ENVELOPE: dict[str, Any] = {"color": GREY, "lw": 0.9, "ls": (0, (5, 2))}
EXTENSION_S = 2e-4  # of the envelope after its last maximum
ENTRANCE_S = 4.2e-4
POINTS = 60  # per curve


def make(runs: Path) -> Product:
    """Runs Fig. 5's scene with the calibrated dissipation and without any."""
    top = case_of("fig5").chain.beads
    # gauges without a mass of their own do not change the run
    gauges = f"chain.sensors=[{{ from_wall = {top} }}, {{ from_wall = {top - 1} }}]"
    cases = [case_of("fig5", gauges, *calibrated().settings), case_of("fig5", gauges)]
    simulations, paper = simulate(cases, runs), quoted()
    axes, product = draw_pairs(7.0, 3, PANELS, simulations, _numbers, STEP_N, gauges=(WALL,))
    damped, elastic = (by_engine[REFERENCE] for by_engine in simulations)
    entrance = _draw_entrance(product.figure.add_subplot(3, 1, 3), damped, elastic).assign(panel="c")
    rates = paper.fig5_measured_envelope_per_us, paper.fig5_computed_envelope_per_us
    envelopes = [
        _draw_envelope(drawn[WALL], motion, rate).assign(panel=letter)
        for drawn, motion, rate, letter in zip(axes, (damped, elastic), rates, "ab", strict=True)
    ]
    pulse = quoted_rows("c", rise_us=paper.fig5_incident_rise_us, decay_per_us=paper.fig5_incident_decay_per_us,
                        duration_us=paper.fig5_incident_duration_us)  # fmt: skip
    stated = [quoted_rows(panel, envelope_per_us=rate) for panel, rate in zip("ab", rates, strict=True)]
    return product.with_rows(entrance, *envelopes, *stated, pulse)


def _train(motion: Simulation) -> tuple[list[Peak], dict[int, tuple[float, float]]]:
    """Maxima at the wall, and rates and amplitudes of envelopes by number of maxima."""
    time_s, wall = motion.trace.time_s, motion.trace.force_N[:, 0]
    maxima = peaks(time_s, wall, LATER_PROMINENCE)
    return maxima, {count: curve for count in MAXIMA if (curve := train_envelope(maxima, count))}


def _numbers(motion: Simulation) -> dict[str, float]:
    """Rates of the envelopes through the first maxima of the train; rise, decay and duration of the incident pulse.

    Raises:
        InputError: The scene ends too early.
    """
    _, envelopes = _train(motion)
    numbers = {f"envelope_{count}_maxima_per_us": rate / MICRO for count, (rate, _) in envelopes.items()}
    time_s = motion.trace.time_s
    pulses = [incident_pulse(time_s, signal - signal[0]) for signal in [*motion.signals.values()][: len(PLACES)]]
    found = f"fewer than {ENVELOPE_MAXIMA} maxima at the wall" if ENVELOPE_MAXIMA not in envelopes else ""
    if found or not all(pulses):
        allowed = "until the wave is back, and weaker dissipation"
        raise InputError(motion.case.scene.file, "run.duration", found or "no wave back at the top", allowed)
    for words, pulse in zip(PLACES, pulses, strict=True):
        shape = pulse["rise_s"] * MICRO, pulse["decay_per_s"] / MICRO, pulse["duration_s"] * MICRO
        names = (f"{words.replace(' ', '_')}_{name}" for name in ("rise_us", "decay_per_us", "duration_us"))
        numbers |= zip(names, shape, strict=True)
    return numbers


def _draw_envelope(axis: Any, motion: Simulation, quoted_per_us: float) -> pd.DataFrame:
    """Draws the envelope through the first three maxima, labelled with its rate and that of the paper.

    The envelope with the paper's rate would differ by about the width of a line.
    """
    maxima, envelopes = _train(motion)
    first, last = maxima[0], maxima[ENVELOPE_MAXIMA - 1]
    rate_per_s, amplitude_N = envelopes[ENVELOPE_MAXIMA]
    time_s = np.linspace(first.time_s, last.time_s + EXTENSION_S, POINTS)
    force_N = amplitude_N * np.exp(rate_per_s * time_s)
    look: dict[str, Any] = {"textcoords": "offset points", "ha": "right", "fontsize": 7}
    rates = ("", rate_per_s / MICRO, 9, GREY), ("paper: ", quoted_per_us, 0, QUOTED["color"])
    for words, rate, up, colour in rates:
        text = f"{words}{rate:.4f}/µs".replace("-", "\N{MINUS SIGN}")
        axis.annotate(text, (axis.get_xlim()[1], 0.75 * first.value), (-2, up), color=colour, **look)
    return draw_curve(axis, REFERENCE, f"envelope_{ENVELOPE_MAXIMA}_maxima", time_s, WALL, force_N, **ENVELOPE)


def _draw_entrance(axis: Any, damped: Simulation, elastic: Simulation) -> pd.DataFrame:
    """Draws averages of the two uppermost beads, and the quoted pulse with the height of the elastic pulse."""
    paper, upper = quoted(), [f"bead_{sensor.from_wall}" for sensor in elastic.case.layout.sensors]
    letter_panel(axis, "c", "incident pulse")
    tables = []
    curves = (elastic, 0, "", AVERAGE), (elastic, 1, "", SECOND_BEAD), (damped, 0, ", damped", DAMPED)
    for motion, place, more, look in curves:
        shown = motion.trace.time_s <= ENTRANCE_S
        time_s, force_N, words = motion.trace.time_s[shown], motion.signals[upper[place]][shown], PLACES[place] + more
        tables.append(draw_curve(axis, REFERENCE, words, time_s, "average", force_N, label=words, **look))
    top_N = float(tables[0]["average_N"].max())
    after_us = np.linspace(0, paper.fig5_incident_duration_us - paper.fig5_incident_rise_us, POINTS)
    time_s = np.concatenate([[0.0], paper.fig5_incident_rise_us + after_us]) / MICRO
    force_N = np.concatenate([[0.0], top_N * np.exp(paper.fig5_incident_decay_per_us * after_us)])
    look = QUOTED | {"label": "as quoted; straight rise\nand height: ours"}
    tables.append(draw_curve(axis, "paper", "as quoted", time_s, "average", force_N, **look))
    axis.legend(loc="upper right", handlelength=1.8, fontsize=7)
    axis.set(xlim=(0, ENTRANCE_S * MICRO), ylim=(0, 1.1 * top_N), xlabel="time since impact (µs)", ylabel="force (N)")
    return pd.concat(tables)
