"""Fig. 4: one solitary wave and its reflection.

The elastic wave has 5.33 N and returns with 0.99 of it; the paper measured 2 N and a smaller reflection. A fit with
dissipation gives 2.85 N and 0.70.

(a) Fit to the paper's numbers: 0.829 GPa, coefficient of restitution 0.885. Computed: 147 m/s, 144 µs (at 4 % of the
peak). Measured, in brown: 2 N, 152 m/s, 164 µs, "significantly smaller". (b) Elastic, 1.46 GPa, as in the paper: 193
m/s, 99 µs. Gauges in beads 9 and 5 show the mean of two contacts.
"""

from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.patches import ConnectionPatch

from drivers.engines import REFERENCE
from postproc.draw.product import Product
from postproc.draw.stack import ForcePanel, draw_curve, draw_row, name_codes
from postproc.draw.style import AVERAGE, DAMPED, MICRO, PAGE_IN, QUOTED, pyplot
from postproc.paper.calibrated import calibrated
from postproc.paper.quoted import quoted
from postproc.paper.simulate import UNTIL_REFLECTED, Simulation, case_of, simulate
from postproc.paper.strikes import sensor_pair, speed_between_sensors

UNTIL_DAMPED_REFLECTED = "run.duration=1.2 ms"  # until the slower wave with dissipation has returned
PANELS = (
    ForcePanel("a", "with dissipation: fit, not measured", DAMPED | {"ls": "-"}),
    ForcePanel("b", "elastic", AVERAGE),
)
STEP_N, STRIP_SHARE = 2.0, 0.14
LEVEL_S = 160e-6  # length of the drawn level
BROWN: dict[str, Any] = {"color": QUOTED["color"], "fontsize": 7}


def make(runs: Path) -> Product:
    """Runs the scene of Fig. 4 with the calibrated dissipation and without dissipation."""
    cases = [case_of("fig4", UNTIL_DAMPED_REFLECTED, *calibrated().settings), case_of("fig4", UNTIL_REFLECTED)]
    found = simulate(cases, runs)
    figure = pyplot().figure(figsize=(PAGE_IN, 4.9), layout="constrained")
    durations = [case.scene.run.duration for case in cases]  # same time scale in both panels
    grid = figure.add_gridspec(1, 2, width_ratios=durations)
    axes, tables = draw_row(figure, grid, PANELS, found, STEP_N, strip=STRIP_SHARE)
    for place, (panel, own) in enumerate(zip(PANELS, found, strict=True)):
        _name_reflected(axes[place], own[REFERENCE])
        marks = _draw_quoted(figure, axes[place], own[REFERENCE]) if panel.letter == "a" else pd.DataFrame()
        tables[place] = pd.concat([tables[place], marks, _numbers(own)]).assign(panel=panel.letter)
    name_codes(figure, axes)
    chains = {f"({panel.letter}) {panel.words}": own[REFERENCE].trace for panel, own in zip(PANELS, found, strict=True)}
    return Product(figure, pd.concat(tables, ignore_index=True), chains)


def _numbers(found: dict[str, Simulation]) -> pd.DataFrame:
    rows = []
    for engine, one in found.items():
        upper, lower = (f"bead_{bead}" for bead in sensor_pair(one.case))
        values = one.values
        ratio = values[f"{upper}_reflected_amplitude_N"] / values[f"{upper}_amplitude_N"]
        rows += [
            (engine, "leading_force_N", values[f"{upper}_amplitude_N"]),
            (engine, "speed_m_s", speed_between_sensors(one)),
            (engine, "duration_us", values[f"{lower}_duration_4pct_s"] * MICRO),
            (engine, "reflected_over_incident", ratio),
        ]
    return pd.DataFrame(rows, columns=["engine", "quantity", "value"])


def _name_reflected(axes: dict[str, Any], one: Simulation) -> None:
    """Names the height of the reflected wave in the upper bead, between both waves."""
    values, gauge = one.values, f"bead_{sensor_pair(one.case)[0]}"
    share = values[f"{gauge}_reflected_amplitude_N"] / values[f"{gauge}_amplitude_N"]
    middle_s = (values[f"{gauge}_arrival_s"] + values[f"{gauge}_reflected_arrival_s"]) / 2
    axes[gauge].text(middle_s * MICRO, 0.8, f"reflected:\n{share:.2f} of incident", fontsize=7, ha="center")


def _draw_quoted(figure: Any, axes: dict[str, Any], one: Simulation) -> pd.DataFrame:
    """Draws marks of the statements on the experiment: level, speed, smaller reflected wave.

    Their duration is not drawn: the paper does not state at which share of the peak it ends, and the computed force
    does not end before the reflection.
    """
    paper, values, height = quoted(), one.values, one.case.chain.height_m
    upper, lower = sensor_pair(one.case)
    above, below = f"bead_{upper}", f"bead_{lower}"
    start_s = values[f"{above}_arrival_s"]
    names = ("leading_force_N", "speed_m_s", "duration_us")
    stated = dict(zip(names, (paper.fig4_leading_force_N, paper.fig4_speed_m_s, paper.fig4_duration_us), strict=True))
    marks = [pd.DataFrame({"engine": "paper", "quantity": [*stated], "value": [*stated.values()]})]

    level_N, reach_s = paper.fig4_leading_force_N, LEVEL_S / 2
    for gauge in (above, below):
        level = values[f"{gauge}_arrival_s"] + np.array([-reach_s, reach_s])
        marks.append(draw_curve(axes[gauge], "paper", names[0], level, gauge, (level_N, level_N), **QUOTED))
    axes[above].text(
        (start_s - 1.08 * reach_s) * MICRO, level_N, f"paper: {level_N:g} N", ha="right", va="center", **BROWN
    )
    places = {above: height[upper - 1], below: height[lower - 1], "wall": 0.0}
    passes_s = {gauge: start_s + (places[above] - place) / paper.fig4_speed_m_s for gauge, place in places.items()}
    for gauge, time_s in passes_s.items():
        marks.append(
            draw_curve(axes[gauge], "paper", names[1], [time_s], gauge, [0.0], **QUOTED | {"marker": "o", "ms": 3})
        )
    for first, second in pairwise(passes_s):
        start, end = ((passes_s[gauge] * MICRO, 0.0) for gauge in (first, second))
        line = ConnectionPatch(start, end, "data", "data", axesA=axes[first], axesB=axes[second], **QUOTED)
        figure.add_artist(line)
    speed = f"paper: {paper.fig4_speed_m_s:g} m/s"
    axes["wall"].text(passes_s[below] * MICRO, 0.6 * values["wall_peak_N"], speed, ha="right", **BROWN)
    back_s, end_s = values[f"{above}_reflected_arrival_s"], one.trace.time_s[-1]
    heights = values[f"{above}_peak_N"], values[f"{above}_reflected_amplitude_N"] + values[f"{above}_static_N"]
    arrow = {"color": QUOTED["color"], "lw": 0.8, "marker": "v", "markevery": [1], "ms": 3}
    marks.append(draw_curve(axes[above], "paper", "smaller", (back_s, back_s), above, heights, **arrow))
    words = "paper: significantly smaller"
    axes[above].text(end_s * MICRO, heights[0] + 0.2, words, ha="right", va="bottom", **BROWN)
    return pd.concat(marks)
