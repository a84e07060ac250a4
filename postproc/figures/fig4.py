"""Fig. 4: one solitary wave and its reflection.

Forces in a chain of 21 PTFE beads of 4.76 mm, struck by another bead at 2 m/s. Top: gauge in the 9th bead from the
wall; middle: gauge in the 5th bead; bottom: wall; all on one scale of force. A gauge in a bead shows the average of
the two contact forces. (a) Computed with dissipation, with a Young's modulus of 0.829 GPa and a coefficient of
restitution of 0.885 at every contact: one of several fits to the numbers that the paper quotes of its experiments
(Figs. 4 and 5, Table 1). The measured curves are not available. Brown marks show statements of the text: a leading
wave of about 2 N (level; computed above the static force: 2.85 N) and 164 µs (bar; computed at 4 % of the peak: 144
µs); a speed of 152 m/s from the 9th to the 5th bead (slanted line from the time of the computed peak; computed: 147
m/s) and a similar speed to the wall; a reflected wave in the 9th bead that is significantly smaller than the incident
wave (arrow from the height of the incident wave; computed: 0.70 of it). (b) Computed without dissipation, at 1.46 GPa,
as in the paper: 5.33 N, 99 µs, 193 m/s, 0.99. Strips: largest difference δF between a code and the reference over all
contacts, relative to the largest change of force. It is larger in (a), where the truncation error of the codes is of
first order in their time step of 0.1 µs.
"""

from itertools import pairwise
from pathlib import Path
from typing import Any

import pandas as pd
from matplotlib.patches import ConnectionPatch

from drivers.engines import REFERENCE
from postproc.draw.product import Product
from postproc.draw.stack import STRIP, ForcePanel, draw_curve, draw_panel, name_codes
from postproc.draw.style import AVERAGE, DAMPED, MICRO, PAGE_IN, QUOTED, pyplot
from postproc.paper.calibrated import calibrated
from postproc.paper.quoted import quoted
from postproc.paper.simulate import UNTIL_REFLECTED, Simulation, case_of, simulate
from postproc.paper.strikes import sensor_pair, speed_between_sensors

UNTIL_DAMPED_REFLECTED = "run.duration=1.2 ms"  # until the slower wave with dissipation has returned
PANELS = (
    ForcePanel("a", "with dissipation", DAMPED | {"ls": "-"}, 1.0, room=0.8, strip=0.18),
    ForcePanel("b", "elastic", AVERAGE, 2.0, strip=0.18),
)


def make(runs: Path) -> Product:
    """Runs the scene of Fig. 4 with the calibrated dissipation and without dissipation."""
    cases = [case_of("fig4", UNTIL_DAMPED_REFLECTED, *calibrated().settings), case_of("fig4", UNTIL_REFLECTED)]
    found = simulate(cases, runs)
    figure = pyplot().figure(figsize=(PAGE_IN, 4.4), layout="constrained")
    durations = [case.scene.run.duration for case in cases]  # same time scale in both panels
    grid, tables, chains = figure.add_gridspec(1, 2, width_ratios=durations), [], {}
    for place, (panel, own) in enumerate(zip(PANELS, found, strict=True)):
        axes, drawn = draw_panel(figure, grid[place], panel, own)
        marks = _draw_quoted(figure, axes, own[REFERENCE]) if panel.letter == "a" else pd.DataFrame()
        tables.append(pd.concat([drawn, marks, _numbers(own)]).assign(panel=panel.letter))
        chains[f"({panel.letter}) {panel.words}"] = own[REFERENCE].trace
    name_codes(figure, axes[STRIP])
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


def _draw_quoted(figure: Any, axes: dict[str, Any], one: Simulation) -> pd.DataFrame:
    """Draws marks of the statements on the experiment: level, duration, speed, smaller reflected wave."""
    paper, values, height = quoted(), one.values, one.case.chain.height_m
    upper, lower = sensor_pair(one.case)
    above, below = f"bead_{upper}", f"bead_{lower}"
    start_s, back_s = values[f"{above}_arrival_s"], values[f"{above}_reflected_arrival_s"]
    names = ("leading_force_N", "speed_m_s", "duration_us")
    stated = dict(zip(names, (paper.fig4_leading_force_N, paper.fig4_speed_m_s, paper.fig4_duration_us), strict=True))
    marks = [pd.DataFrame({"engine": "paper", "quantity": [*stated], "value": [*stated.values()]})]

    def mark(words: str, gauge: str, time_s: tuple[float, ...], force_N: tuple[float, ...], **look: Any) -> None:
        marks.append(draw_curve(axes[gauge], "paper", words, time_s, gauge, force_N, **QUOTED | look))

    def note(words: str, gauge: str, time_s: float, force_N: float, **look: Any) -> None:
        axes[gauge].text(time_s * MICRO, force_N, words, color=QUOTED["color"], fontsize=7, **look)

    half_s, level_N = paper.fig4_duration_us / MICRO / 2, paper.fig4_leading_force_N
    for gauge in (above, below):
        middle_s = values[f"{gauge}_arrival_s"]
        mark("leading_force_N", gauge, (middle_s - half_s, middle_s + half_s), (level_N, level_N))
    note(f"{level_N:g} N", above, start_s - 1.08 * half_s, level_N, ha="right", va="center")
    over_N = values[f"{below}_peak_N"] + 0.4
    mark("duration_us", below, (middle_s - half_s, middle_s + half_s), (over_N, over_N), ls="-", marker="|")
    note(f"{paper.fig4_duration_us:g} µs", below, middle_s + 1.08 * half_s, over_N, ha="left", va="center")
    places = {above: height[upper - 1], below: height[lower - 1], "wall": 0.0}
    passes_s = {gauge: start_s + (places[above] - place) / paper.fig4_speed_m_s for gauge, place in places.items()}
    for gauge, time_s in passes_s.items():
        mark("speed_m_s", gauge, (time_s,), (0.0,), marker="o", ms=3)
    for first, second in pairwise(passes_s):
        start, end = ((passes_s[gauge] * MICRO, 0.0) for gauge in (first, second))
        line = ConnectionPatch(start, end, "data", "data", axesA=axes[first], axesB=axes[second], **QUOTED)
        figure.add_artist(line)
    note(f"{paper.fig4_speed_m_s:g} m/s", "wall", passes_s[below], 0.6 * values["wall_peak_N"], ha="right")
    heights = values[f"{above}_peak_N"], values[f"{above}_reflected_amplitude_N"] + values[f"{above}_static_N"]
    mark("reflected_over_incident", above, (back_s, back_s), heights, marker="v", markevery=[1], ms=3)
    note("smaller", above, back_s + 0.2 * half_s, heights[0], ha="left", va="top")
    return pd.concat(marks)
