"""Fig. 6: smaller beads under a steel and a PTFE ball.

Dissipation, fitted to beads of 4.76 mm only, divides the leading wave on beads of 2.38 mm by 2.3 in (a) and by 1.9 in
(c), and delays the splitting.

Wall below 18 PTFE beads, struck at 0.89 m/s (a) by a steel ball, (c) by a PTFE ball, in place of the measured curves
with the fitted dissipation: between the first two maxima the force falls to 0.42 and 0.48 of the second. (b), (d)
Elastic, 1.46 GPa: it falls to zero. Brown: the paper's words on its measured curves.
"""

from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from drivers.base.errors import InputError
from drivers.engines import REFERENCE
from postproc.draw.plot import AVERAGE, DAMPED, GREY, MICRO, QUOTED, Product
from postproc.draw.stack import draw_curve, draw_pairs
from postproc.paper import calibrated
from postproc.read.motion import Simulation, case_of, simulate
from postproc.read.observables import LATER_PROMINENCE
from postproc.read.signals import Peak, peaks

SCENES = ("fig6b", "fig6d")
UNTIL_PASSED = "run.duration=0.62 ms"  # until the train has reached the wall, before it returns
HALF_LEVEL_S = 4e-5
LEVEL: dict[str, Any] = {"color": GREY, "ls": (0, (3, 2)), "lw": 0.9}
PANELS = {
    f"{ball} ball, {law}": look
    for ball in ("2 mm steel", "4.76 mm PTFE")
    for law, look in (("with dissipation: fit", DAMPED | {"ls": "-"}), ("elastic", AVERAGE))
}
STEP_N = 1.0
# of the first two maxima in the panels with dissipation
DESCRIPTIONS = {"a": ("leading wave", "oscillatory tail"), "c": ("", "oscillatory shock")}


def make(runs: Path) -> Product:
    """Runs both scenes with the calibrated dissipation and without dissipation."""
    cases = [case_of(scene, UNTIL_PASSED, *law) for scene in SCENES for law in (calibrated().settings, ())]
    simulations = simulate(cases, runs)
    axes, product = draw_pairs(8.0, 4, PANELS, simulations, _numbers, STEP_N)
    maxima, losses = [_first_maxima(by_engine[REFERENCE]) for by_engine in simulations], []
    for letter, described in DESCRIPTIONS.items():
        place = "abcd".index(letter)
        wall, look = axes[place]["wall"], {"color": QUOTED["color"], "fontsize": 7, "textcoords": "offset points"}
        for peak, words in zip(maxima[place], described, strict=True):
            wall.annotate(words, (peak.time_s * MICRO, peak.value), (6, 2), **look)
        loss = _draw_loss(wall, maxima[place][0], maxima[place + 1][0])
        losses.append(loss.assign(panel=letter))
    return product.with_rows(*losses)


def _draw_loss(axis: Any, damped: Peak, elastic: Peak) -> pd.DataFrame:
    """Draws the height of the leading wave without dissipation, with its ratio to the height with dissipation."""
    reach_s = damped.time_s + np.array([-HALF_LEVEL_S, HALF_LEVEL_S])
    words = f"elastic: {elastic.value / damped.value:.1f} times as high"
    axis.text(reach_s[0] * MICRO - 10, elastic.value, words, ha="right", va="center", fontsize=7)
    return draw_curve(axis, REFERENCE, "elastic_maximum_1_N", reach_s, "wall", [elastic.value] * 2, **LEVEL)


def _first_maxima(simulation: Simulation) -> tuple[Peak, Peak]:
    """First two maxima at the wall.

    Raises:
        InputError: There are fewer.
    """
    maxima = peaks(simulation.trace.time_s, simulation.trace.force_N[:, 0], LATER_PROMINENCE)
    if len(maxima) < 2:
        allowed = "at least two: use a longer run or weaker dissipation"
        raise InputError(simulation.case.scene.file, "run.duration", f"{len(maxima)} maxima at the wall", allowed)
    return maxima[0], maxima[1]


def _numbers(simulation: Simulation) -> dict[str, float]:
    """Heights and times of the first two maxima, and the smallest force between them divided by the second maximum."""
    first, second = _first_maxima(simulation)
    valley_N = float(simulation.trace.force_N[first.sample : second.sample + 1, 0].min())
    return {
        "maximum_1_N": first.value, "maximum_1_us": first.time_s * MICRO,
        "maximum_2_N": second.value, "maximum_2_us": second.time_s * MICRO,
        "valley_over_second_maximum": valley_N / second.value,
    }  # fmt: skip
