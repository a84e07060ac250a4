"""Fig. 6: smaller beads under a steel and a PTFE ball.

Force on the wall under 18 PTFE beads of 2.38 mm, struck at 0.89 m/s by a steel ball of 2 mm and 0.036 g (a, b) and by a
PTFE ball of 4.76 mm and 0.123 g (c, d). (a) and (c): with the dissipation of Fig. 4(a), which is fitted to experiments
on beads of 4.76 mm alone. Words in brown are the paper's on its measured curves, which are not available: a leading
solitary wave with an oscillatory tail in (a), an oscillatory "shock" in (c), with a delayed splitting into solitary
waves. Computed: between the first two maxima the force falls to 0.48 of the second one in (a), to 0.51 of it in (c).
(b) and (d): without dissipation, at 1.46 GPa, as in the paper: trains of solitary waves, with no force between the
first two. The leading wave is 0.41 times as high in (a) as in (b), 0.50 times in (c) as in (d). Strips: differences
between codes and reference as in Fig. 4.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pandas as pd

from drivers.chain.trace import Trace
from drivers.engines import REFERENCE
from postproc.draw.product import Product
from postproc.draw.stack import STRIP, Panel, draw_panel, name_codes
from postproc.draw.style import AVERAGE, DAMPED, MICRO, PAGE_IN, QUOTED, pyplot
from postproc.paper.calibrated import calibrated
from postproc.paper.simulate import case_of, simulate
from postproc.read.observables import LATER
from postproc.read.signals import Peak, peaks

SCENES = ("fig6b", "fig6d")
UNTIL_PASSED = "run.duration=0.62 ms"  # until the train has been at the wall, before it comes back
DAMPING, ELASTIC = DAMPED | {"ls": "-"}, AVERAGE
PANELS = (
    Panel("a", "2 mm steel ball, with dissipation", DAMPING, 0.5),
    Panel("b", "2 mm steel ball, elastic", ELASTIC, 0.5),
    Panel("c", "4.76 mm PTFE ball, with dissipation", DAMPING, 1.0),
    Panel("d", "4.76 mm PTFE ball, elastic", ELASTIC, 1.0),
)

SAID = {"a": ("leading wave", "oscillatory tail"), "c": ("", "oscillatory shock")}  # of the experiment, at two maxima


def make(runs: Path) -> Product:
    """Runs both scenes with the calibrated dissipation and without any."""
    cases = [case_of(scene, UNTIL_PASSED, *law) for scene in SCENES for law in (calibrated().settings, ())]
    found = simulate(cases, runs)
    figure = pyplot().figure(figsize=(PAGE_IN, 4.8), layout="constrained")
    grid, tables, chains = figure.add_gridspec(2, 2), [], {}
    for place, (case, panel, cell) in enumerate(
        zip(cases, PANELS, [grid[0, 0], grid[0, 1], grid[1, 0], grid[1, 1]], strict=True)
    ):
        traces = {engine: some[place].trace for engine, some in found.items()}
        axes, drawn = draw_panel(figure, cell, panel, case.layout, traces)
        if panel.letter in SAID:
            _note(axes["wall"], traces[REFERENCE], SAID[panel.letter])
        tables.append(pd.concat([drawn, _numbers(traces)]).assign(panel=panel.letter))
        chains[f"({panel.letter}) {panel.words}"] = traces[REFERENCE]
    name_codes(figure, axes[STRIP])
    return Product(figure, pd.concat(tables, ignore_index=True), chains)


def _two_maxima(trace: Trace) -> tuple[list[Peak], float]:
    """The first two maxima at the wall, and the least force between them in N."""
    first, second = peaks(trace.time_s, trace.force_N[:, 0], LATER)[:2]
    return [first, second], float(trace.force_N[first.sample : second.sample + 1, 0].min())


def _numbers(traces: Mapping[str, Trace]) -> pd.DataFrame:
    """Heights and times of the first two maxima, and by how much the force falls between them."""
    rows = []
    for engine, trace in traces.items():
        maxima, valley_N = _two_maxima(trace)
        for number, peak in enumerate(maxima, 1):
            rows += [(engine, f"maximum_{number}_N", peak.value), (engine, f"maximum_{number}_us", peak.time_s * MICRO)]
        rows.append((engine, "valley_over_second_maximum", valley_N / maxima[1].value))
    return pd.DataFrame(rows, columns=["engine", "quantity", "value"])


def _note(axis: Any, trace: Trace, words: tuple[str, str]) -> None:
    """Words of the text on the experiment, beside the first and above the second maximum."""
    for peak, said in zip(_two_maxima(trace)[0], words, strict=True):
        axis.annotate(
            said,
            (peak.time_s * MICRO, peak.value),
            (6, 2),
            textcoords="offset points",
            color=QUOTED["color"],
            fontsize=7,
        )
