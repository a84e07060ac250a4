"""Forces on the gauges of chains in stacked panels, with the differences between engines below.

In figures of the paper codes are markers in a strip, in reports lines of their own.
"""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd

from drivers.chain.case import Layout
from drivers.chain.chain import Array
from drivers.chain.trace import Trace, residual
from drivers.engines import REFERENCE, VERLET
from postproc.draw.plot import COLUMN_IN, GREY, MICRO, Product, draw_codes, drawing_order, letter_panel, line_of, pyplot
from postproc.read.motion import Simulation
from postproc.read.signals import sensor_signals

GAUGE_IN = 1.126  # height of a panel
STRIP, RESIDUAL = "strip", "residual_to_reference_share"
STRIP_POINTS, STRIP_SIZE = 24, 2.5  # markers of a code, and their size
STRIP_RANGE, STRIP_TICKS = (3e-7, 3e-3), (1e-6, 1e-3)
STRIP_ROOM = 3.0  # factor of room beyond the smallest and largest value of a strip
STRIP_WORDS = "$\\delta F$: largest difference from the exact motion in any contact,\nas a share of the largest change"
ROOM = 0.3  # steps of the grid below and above curves
WIDTH_IN = 4.2  # legible on a phone
PANEL_IN = 0.92  # two panels, text and verdicts fit on the first screen of the report
MAX_GAUGES = 4  # panels of forces; the table of observables has all gauges
LEGEND_COLUMNS = 3
LABEL_AT = 0.012  # position of a label, as a share of the time axis


def draw_pairs(
    height_in: float,
    rows: int,
    panels: Mapping[str, Mapping[str, Any]],
    simulations: Sequence[Mapping[str, Simulation]],
    numbers: Callable[[Simulation], Mapping[str, float]],
    step_N: float,
    gauges: tuple[str, ...] = (),
    strip: float = 0.22,
) -> tuple[list[dict[str, Any]], Product]:
    """Stacked gauge forces of the reference, on one scale in each pair of panels, and the codes' differences in strips.

    Args:
        height_in: Height of the figure, which is as wide as a column.
        rows: Rows of equal height; those after the panels stay empty.
        panels: Plot keywords by title; the first two are a pair, and so on. Their letters are a to d.
        simulations: Simulations by engine, for each panel.
        numbers: Function that computes further numbers of a simulation by name, for the table.
        step_N: Force between two grid lines.
        gauges: Drawn gauges; empty for all.
        strip: Height of a strip, as a share of the height of the gauges above it.

    Returns:
        For each panel its axes by gauge in the order in which a wave meets them, then the axes of the strip; the figure
        with all drawn numbers and those of ``numbers``.
    """
    axes, tables, chains, bottom = [], [], {}, -ROOM * step_N
    tops, figure = dict[str, float](), pyplot().figure(figsize=(COLUMN_IN, height_in), layout="constrained")
    of_panels = zip("abcd", figure.add_gridspec(rows, 1), panels.items(), simulations, strict=False)
    for place, (letter, cell, (title, look), by_engine) in enumerate(of_panels):
        exact = by_engine[REFERENCE]
        if place % 2 == 0:
            pair = [half[REFERENCE].signals for half in simulations[place:][:2]]
            names = gauges or pair[0]
            tops = {name: max(float(signals[name].max()) for signals in pair) + ROOM * step_N for name in names}
        heights = [top - bottom for top in tops.values()]
        grid = cell.subgridspec(len(tops) + 1, 1, height_ratios=[*heights, strip * sum(heights)], hspace=0)
        drawn = dict(zip([*tops, STRIP], grid.subplots(sharex=True).flat, strict=True))
        stacked = [drawn[name] for name in tops]
        for axis, (name, top) in zip(stacked, tops.items(), strict=True):
            axis.plot(exact.trace.time_s * MICRO, exact.signals[name], **look)
            axis.set(xlim=(0, exact.trace.time_s[-1] * MICRO), ylim=(bottom, top))
            axis.yaxis.set_major_locator(pyplot().MultipleLocator(step_N))
            axis.tick_params(axis="x", length=0, labelbottom=False)
            axis.spines["bottom"].set_visible(False)
            if len(tops) > 1:
                axis.text(LABEL_AT, 0.97, name.replace("_", " "), va="top", transform=axis.transAxes)
        letter_panel(stacked[0], letter, title)
        stacked[len(stacked) // 2].set_ylabel("force (N)")
        strips = _draw_strip(drawn[STRIP], {engine: motion.trace for engine, motion in by_engine.items()})
        curves, further = [], []
        for engine, motion in by_engine.items():
            forces = {f"{name}_N": motion.signals[name] for name in tops}
            columns = {"engine": engine, "time_s": motion.trace.time_s} | forces
            curves.append(pd.DataFrame(columns | {RESIDUAL: residual(motion.trace, exact.trace)}))
            further += [(engine, *number) for number in numbers(motion).items()]
        values = pd.DataFrame(further, columns=["engine", "quantity", "value"])
        axes.append(drawn)
        tables.append(pd.concat([strips, *curves, values]).assign(panel=letter))
        chains[f"({letter}) {title}"] = exact.trace
    if markers := {line.get_label(): line for drawn in axes for line in drawn[STRIP].lines}:
        look = {"ncols": 6, "handletextpad": 0.1, "title": STRIP_WORDS, "title_fontsize": 8}
        figure.legend(markers.values(), markers, loc="outside lower center", **look)
    return axes, Product(figure, pd.concat(tables, ignore_index=True), chains)


def _draw_strip(axis: Any, traces: Mapping[str, Trace]) -> pd.DataFrame:
    """Largest difference of each code from the reference in equal intervals of time, as a marker in the middle."""
    differences, time_s = residuals(traces, REFERENCE), traces[REFERENCE].time_s
    every = max(len(time_s) // STRIP_POINTS, 1)
    starts = np.arange(0, len(time_s) - every + 1, every)
    largest = {code: np.maximum.reduceat(share, starts) for code, share in differences.items()}
    everything = np.concatenate([*largest.values(), STRIP_RANGE])
    low, high = everything[everything > 0].min(), everything.max()
    axis.set(xlabel="time since impact (µs)", yscale="log", ylabel=r"$\delta F$", yticks=STRIP_TICKS)
    axis.set_ylim(low / STRIP_ROOM, high * STRIP_ROOM)
    axis.minorticks_off()
    if not differences:
        axis.text(0.5, 0.5, "no code", transform=axis.transAxes, ha="center", va="center", color=GREY)
    middle_s = time_s[starts + every // 2]
    draw_codes(axis, {code: (middle_s * MICRO, share) for code, share in largest.items()}, STRIP_SIZE)
    columns = {"quantity": STRIP, "time_s": middle_s}
    strips = [pd.DataFrame({"engine": code} | columns | {RESIDUAL: share}) for code, share in largest.items()]
    return pd.concat([pd.DataFrame(), *strips])


def draw_curve(
    axis: Any, engine: str, words: str, time_s: Array | Sequence[float], gauge: str, force_N: Any, **look: Any
) -> pd.DataFrame:
    """Draws a curve of forces against time; returns its numbers, with the forces in the column of a gauge."""
    axis.plot(np.asarray(time_s) * MICRO, force_N, **look)
    return pd.DataFrame({"engine": engine, "quantity": words, "time_s": time_s, f"{gauge}_N": force_N})


def quoted_rows(panel: str, **values: float) -> pd.DataFrame:
    """Rows of a table with numbers that the paper states."""
    return pd.DataFrame({"panel": panel, "engine": "paper", "quantity": [*values], "value": [*values.values()]})


def gauge_title(layout: Layout, gauge: str) -> str:
    """Title of a gauge, with the time constant of its electronics."""
    name = "wall" if gauge == "wall" else f"sensor bead {gauge.removeprefix('bead_')}: mean of its two contact forces"
    constant_s = layout.time_constant_s
    return name if constant_s is None else f"{name}, behind electronics of {constant_s * 1e3:g} ms"


def residuals(traces: Mapping[str, Trace], baseline: str) -> dict[str, Array]:
    """Deviation of each engine except the reference from a baseline engine at each sample, in the order of drawing."""
    others = [engine for engine in drawing_order(list(traces)) if engine not in (baseline, REFERENCE)]
    return {engine: residual(traces[engine], traces[baseline]) for engine in others}


def draw_gauge_forces(layout: Layout, traces: Mapping[str, Trace], failed: Mapping[str, Trace]) -> Any:
    """Draws a panel for each gauge, and a panel of the largest difference over all contacts.

    Of many gauges those closest to the wall are drawn. Differences are from the exact motion and from velocity Verlet;
    without both, from the first engine.

    Args:
        layout: Layout of the chain.
        traces: Traces by engine, of equal sample times; at least one, here or in ``failed``.
        failed: Partial traces of failed runs by engine, at the same times.

    Returns:
        The figure; None without a gauge and without a difference.
    """
    everything = {**traces, **failed}
    labels = {engine: f"{engine}{' (failed)' * (engine in failed)}" for engine in drawing_order([*everything])}
    signals = {engine: sensor_signals(layout, trace) for engine, trace in everything.items()}
    names = [*next(iter(signals.values()))][-MAX_GAUGES:]
    baselines = [name for name in (REFERENCE, VERLET) if name in traces] or [*traces][:1]
    differences = {baseline: residuals(everything, baseline) for baseline in baselines}
    count = len(names) + any(differences.values())
    if not count:
        return None
    size = (WIDTH_IN, PANEL_IN * count + 0.7)
    figure, grid = pyplot().subplots(count, 1, sharex=True, figsize=size, squeeze=False, layout="constrained")
    time_us, last = next(iter(everything.values())).time_s * MICRO, grid[-1, 0]
    for axis, name in zip(grid[:, 0], names, strict=False):
        for engine, label in labels.items():
            axis.plot(time_us, signals[engine][name], label=label, **line_of(engine))
        axis.set_title(f"{gauge_title(layout, name)} (N)", loc="left")
        axis.set_ylim(bottom=min(0.0, axis.dataLim.y0))
    for baseline, shares in differences.items():
        for engine, share in shares.items():
            last.plot(time_us, share, label=f"{labels[engine]} − {baseline}", **line_of(engine))
        lowest = min(shares.values(), key=lambda share: share[share > 0].min(initial=1.0), default=np.zeros(0))
        for sample in np.flatnonzero(lowest > 0)[-1:]:  # none, if all differences are zero
            look = {"textcoords": "offset points", "ha": "right", "color": GREY}
            last.annotate(f"from {baseline}", (time_us[sample], lowest[sample]), (0, 2), **look)
    if count > len(names):
        last.set_yscale("log", nonpositive="mask")
        last.margins(y=0.25)  # space for words above the highest line
        last.set_title("largest force difference of any contact / largest change", loc="left")
    last.set(xlim=(time_us[0], time_us[-1] if len(time_us) > 1 else None), xlabel="time since impact (µs)")
    handles = [pyplot().Line2D([], [], label=label, **line_of(engine)) for engine, label in labels.items()]
    figure.legend(handles=handles, loc="outside upper left", ncols=LEGEND_COLUMNS)
    return figure
