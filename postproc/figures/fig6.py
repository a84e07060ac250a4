"""Fig. 6: smaller beads under a steel and a PTFE ball.

Force on the wall below 18 PTFE beads of 2.38 mm, struck at 0.89 m/s by a steel ball of 2 mm and 0.036 g (a, b) and by
a PTFE ball of 4.76 mm and 0.123 g (c, d). (a) and (c): with the dissipation of Fig. 4(a), which is fitted to
experiments on beads of 4.76 mm only. Brown text is the paper's description of its measured curves, which are not
available: a leading solitary wave with an oscillatory tail in (a), an oscillatory "shock" with a delayed splitting
into solitary waves in (c). Computed: between the first two maxima the force falls to 0.29 of the second maximum in (a)
and to 0.38 of it in (c). (b) and (d): without dissipation, at 1.46 GPa, as in the paper: trains of solitary waves,
without force between the first two. The leading wave is 0.46 times as high in (a) as in (b), and 0.54 times as high in
(c) as in (d). Strips: differences between codes and reference as in Fig. 4.
"""

from collections.abc import Mapping
from pathlib import Path

import pandas as pd

from drivers.base.errors import InputError
from drivers.engines import REFERENCE
from postproc.draw.product import Product
from postproc.draw.stack import STRIP, ForcePanel, draw_panel, name_codes
from postproc.draw.style import AVERAGE, DAMPED, MICRO, PAGE_IN, QUOTED, pyplot
from postproc.paper.calibrated import calibrated
from postproc.paper.simulate import Simulation, case_of, simulate
from postproc.read.observables import LATER_PROMINENCE
from postproc.read.signals import Peak, peaks

SCENES = ("fig6b", "fig6d")
UNTIL_PASSED = "run.duration=0.62 ms"  # until the train has reached the wall, before it returns
DAMPING, ELASTIC = DAMPED | {"ls": "-"}, AVERAGE
PANELS = (
    ForcePanel("a", "2 mm steel ball, with dissipation", DAMPING, 0.5),
    ForcePanel("b", "2 mm steel ball, elastic", ELASTIC, 0.5),
    ForcePanel("c", "4.76 mm PTFE ball, with dissipation", DAMPING, 1.0),
    ForcePanel("d", "4.76 mm PTFE ball, elastic", ELASTIC, 1.0),
)

DESCRIPTIONS = {"a": ("leading wave", "oscillatory tail"), "c": ("", "oscillatory shock")}  # of the first two maxima


def make(runs: Path) -> Product:
    """Runs both scenes with the calibrated dissipation and without dissipation."""
    cases = [case_of(scene, UNTIL_PASSED, *law) for scene in SCENES for law in (calibrated().settings, ())]
    found = simulate(cases, runs)
    figure = pyplot().figure(figsize=(PAGE_IN, 4.8), layout="constrained")
    grid, tables, chains = figure.add_gridspec(2, 2), [], {}
    for place, (panel, own) in enumerate(zip(PANELS, found, strict=True)):
        axes, drawn = draw_panel(figure, grid[place], panel, own)
        for peak, words in zip(_first_maxima(own[REFERENCE]), DESCRIPTIONS.get(panel.letter, ("", "")), strict=True):
            look = {"color": QUOTED["color"], "fontsize": 7}
            axes["wall"].annotate(words, (peak.time_s * MICRO, peak.value), (6, 2), textcoords="offset points", **look)
        tables.append(pd.concat([drawn, _numbers(own)]).assign(panel=panel.letter))
        chains[f"({panel.letter}) {panel.words}"] = own[REFERENCE].trace
    name_codes(figure, axes[STRIP])
    return Product(figure, pd.concat(tables, ignore_index=True), chains)


def _first_maxima(one: Simulation) -> tuple[Peak, Peak]:
    """First two maxima at the wall.

    Raises:
        InputError: There are fewer.
    """
    found = peaks(one.trace.time_s, one.trace.force_N[:, 0], LATER_PROMINENCE)
    if len(found) < 2:
        allowed = "at least two: use a longer run or weaker dissipation"
        raise InputError(one.case.scene.file, "run.duration", f"{len(found)} maxima at the wall", allowed)
    return found[0], found[1]


def _numbers(found: Mapping[str, Simulation]) -> pd.DataFrame:
    """Heights and times of the first two maxima, and the smallest force between them over the second maximum."""
    rows = []
    for engine, one in found.items():
        first, second = _first_maxima(one)
        for number, peak in enumerate((first, second), 1):
            rows += [(engine, f"maximum_{number}_N", peak.value), (engine, f"maximum_{number}_us", peak.time_s * MICRO)]
        valley_N = float(one.trace.force_N[first.sample : second.sample + 1, 0].min())
        rows.append((engine, "valley_over_second_maximum", valley_N / second.value))
    return pd.DataFrame(rows, columns=["engine", "quantity", "value"])
