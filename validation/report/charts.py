"""Charts of the page, as numbers that ``templates/report/chart.html.j2`` draws.

They are not matplotlib's: a page of a dozen scenes is drawn in a tenth of a second, its curves know their values, and
its colours follow the reader's light or dark screen. Ticks and the thinning of lines are matplotlib's.
"""

from base64 import b64encode
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from drivers.chain.chain import Array
from drivers.chain.layout import Layout
from drivers.chain.trace import Trace
from postproc.draw.stack import gauge_title
from postproc.draw.style import drawing_order, line_of
from postproc.read.residual import REFERENCE, residuals
from postproc.read.sensors import sensor_signals
from validation.report.failed_runs import Failed, failed_label
from validation.report.inline_figures import colour_of, relative, thinned

WIDTH, LEFT, RIGHT, TOP = 720.0, 62.0, 712.0, 24.0
PANEL, GAP, BELOW = 116.0, 30.0, 40.0  # heights
MOST_SAMPLES = 1600  # that a curve keeps for its values; of longer records every n-th
MOST_GAUGES = 4  # drawn; the table of observables has them all
NOTE = 22.0  # height of a note's words on a phone
LETTER, KEY = 11.0, 4.5  # width of a letter of the legend on a phone, and of a line with its gaps in letters
FINE = 10  # coordinates are whole tenths
VERLET = "verlet"
NOTHING: Mapping[str, Failed] = {}
TIMES = ((1e6, "µs"), (1e3, "ms"), (1.0, "s"))


@dataclass(frozen=True)
class Curve:
    """One line of a panel.

    Attributes:
        label: the engine, whether its run failed, and in the panel of differences what is subtracted from it.
        path: its ``d``, in tenths.
        values: base64 of little-endian float32, one a kept sample.
    """

    engine: str
    label: str
    colour: str
    width: float
    dashes: str
    path: str
    values: str


@dataclass(frozen=True)
class Panel:
    """One pair of axes; ``ticks`` are places and labels, ``notes`` places and words at the right end."""

    title: str
    unit: str
    top: float
    bottom: float
    ticks: list[tuple[float, str]]
    curves: list[Curve]
    notes: list[tuple[float, str]]


@dataclass(frozen=True)
class Chart:
    """Panels over one axis of time.

    Attributes:
        spacing: between kept samples, in ``unit``.
        last: where time ends, in kept samples from 0: what does not divide leaves a part of one.
    """

    height: float
    unit: str
    start: float
    spacing: float
    count: int
    last: float
    ticks: list[tuple[float, str]]
    engines: list[Curve]
    panels: list[Panel]
    left_out: int

    @property
    def legend(self) -> list[tuple[float, Curve]]:
        """Where the key of each engine is, and how its curves are drawn; longer names have more room."""
        letters = np.array([KEY + len(each.label) for each in self.engines])
        letter = min(LETTER, (RIGHT - LEFT) / letters.sum())
        places = LEFT + letter * (np.cumsum(letters) - letters)
        return list(zip(places.tolist(), self.engines, strict=True))

    @property
    def data(self) -> dict[str, Any]:
        """What the script of the page reads."""
        return {
            "left": LEFT,
            "right": RIGHT,
            "width": WIDTH,
            "height": self.height,
            "unit": self.unit,
            "start": self.start,
            "spacing": self.spacing,
            "count": self.count,
            "last": self.last,
            "panels": [
                {
                    "title": panel.title,
                    "unit": panel.unit,
                    "top": panel.top,
                    "bottom": panel.bottom,
                    "curves": [
                        {"engine": c.engine, "label": c.label, "colour": c.colour, "values": c.values}
                        for c in panel.curves
                    ],
                }
                for panel in self.panels
            ],
        }


@dataclass(frozen=True)
class TimeAxis:
    """The axis below a picture.

    Attributes:
        per_s: how many of its units are a second.
        ticks: places and labels.
    """

    unit: str
    per_s: float
    ticks: list[tuple[float, str]]


def chart_of(layout: Layout, traces: Mapping[str, Trace], failed: Mapping[str, Failed] = NOTHING) -> Chart:
    """Gauge forces of all engines over each other, a panel each, and below the largest differences of any contact.

    Args:
        layout: of the chain.
        traces: by engine, of equal sample times; at least one, here or in ``failed``.
        failed: by engine, what can be shown of runs that failed, at the same times; they are no yardstick.
    """
    everything = {**traces, **{engine: each.trace for engine, each in failed.items()}}
    time_s = next(iter(everything.values())).time_s
    axis = time_axis(time_s, RIGHT)
    every = -(-len(time_s) // MOST_SAMPLES)
    x = LEFT + (RIGHT - LEFT) * (time_s - time_s[0]) / (float(np.ptp(time_s)) or 1.0)
    signals = {engine: sensor_signals(layout, trace) for engine, trace in traces.items()}
    signals |= {engine: each.signals for engine, each in failed.items()}
    labels = {engine: failed_label(engine) if engine in failed else engine for engine in everything}
    gauges = list(next(iter(signals.values())))
    panels: list[Panel] = []
    for gauge in gauges[-MOST_GAUGES:]:
        own = {engine: (labels[engine], found[gauge]) for engine, found in signals.items()}
        panels.append(_panel(gauge_title(layout, gauge), own, x, every, _top(len(panels))))
    found = _apart(traces, everything, labels)
    panels += [_differences(found, x, every, _top(len(panels)))] if found else []
    return Chart(
        height=_top(len(panels)) - GAP + BELOW,
        unit=axis.unit,
        start=float(time_s[0]) * axis.per_s,
        spacing=float(time_s[every] - time_s[0]) * axis.per_s if len(time_s) > every else 0.0,
        count=len(time_s[::every]),
        last=(len(time_s) - 1) / every,
        ticks=axis.ticks,
        engines=[_line(engine, labels[engine], "", np.empty(0)) for engine in drawing_order(list(everything))],
        panels=panels,
        left_out=max(0, len(gauges) - MOST_GAUGES),
    )


def time_axis(time_s: Array, right: float) -> TimeAxis:
    """The axis of a record from ``LEFT`` to ``right``, in the unit in which times have four digits at most."""
    per_s, unit = next((each for each in TIMES if float(time_s[-1]) * each[0] < 1e4), TIMES[-1])
    long, start = float(np.ptp(time_s)) * per_s, float(time_s[0]) * per_s
    scale = (right - LEFT) / (long or 1.0)
    return TimeAxis(unit, per_s, [(LEFT + scale * t, f"{t + start:g}") for t in round_ticks(0.0, long, 8)])


def _top(panels: int) -> float:
    return TOP + 18.0 + panels * (PANEL + GAP)


def _panel(title: str, forces: Mapping[str, tuple[str, Array]], x: Array, every: int, top: float) -> Panel:
    """Forces on a linear axis from zero, or from the lowest where that is below."""
    finite = [values[np.isfinite(values)] for _, values in forces.values()]
    low = min(0.0, *(float(values.min(initial=0.0)) for values in finite))
    high = max(float(values.max(initial=0.0)) for values in finite) or 1.0

    def place(values: Array) -> Array:
        return top + PANEL * (1.0 - (values - low) / ((high - low) * 1.04))

    curves = [
        _line(engine, *(forces[engine][0], _path(x, place(forces[engine][1])), forces[engine][1][::every]))
        for engine in drawing_order(list(forces))
    ]
    ticks = [(float(place(np.array(value))), f"{value:g}") for value in round_ticks(low, high, 4)]
    return Panel(title, "N", top, top + PANEL, ticks, curves, [])


@dataclass(frozen=True)
class _Apart:
    """How far an engine is from a yardstick at each sample."""

    engine: str
    label: str
    yardstick: str
    values: Array


def _apart(traces: Mapping[str, Trace], everything: Mapping[str, Trace], labels: Mapping[str, str]) -> list[_Apart]:
    """Of every engine from each yardstick that finished."""
    yardsticks = [name for name in (REFERENCE, VERLET) if name in traces] or list(traces)[:1]
    return [
        _Apart(engine, f"{labels[engine]} − {yardstick}", yardstick, values)
        for yardstick in yardsticks
        for engine, values in residuals(everything, yardstick).items()
    ]


def _differences(found: list[_Apart], x: Array, every: int, top: float) -> Panel:
    """Largest force difference of any contact to each yardstick, over the largest force, on a logarithmic axis."""
    seen = np.concatenate([each.values[np.isfinite(each.values) & (each.values > 0)] for each in found])
    low = np.floor(np.log10(seen.min())) if len(seen) else -17.0
    high = max(low + 1.0, np.ceil(np.log10(seen.max()))) if len(seen) else -16.0

    def place(values: Array) -> Array:
        with np.errstate(divide="ignore", invalid="ignore"):
            logarithm = np.where(values > 0, np.log10(values), np.nan)
        return np.asarray(top + PANEL * (high - logarithm) / (high - low))

    curves: list[Curve] = []
    notes: dict[str, float] = {}
    for each in found:
        y = place(each.values)
        curves.append(_line(each.engine, each.label, _path(x, y), each.values[::every]))
        if np.isfinite(y).any():
            words, last = f"from {each.yardstick}", float(y[np.isfinite(y)][-1])
            last = last - 4.0 if last > top + NOTE else last + NOTE  # clear of the title
            notes[words] = max(notes.get(words, -np.inf), last)  # at the lowest curve: a run that is off has left it
    stride = max(1, int(np.ceil((high - low) / 5)))
    ticks = [(float(place(np.array(10.0**power))), f"1e{power:g}") for power in np.arange(low, high + 1, stride)]
    title = "largest difference over all contacts, of the largest force"
    return Panel(title, "", top, top + PANEL, ticks, curves, [(y, words) for words, y in notes.items()])


def _line(engine: str, label: str, path: str, values: Array) -> Curve:
    line = line_of(engine)
    dashes = "" if line.dashes == "-" else " ".join(f"{each * line.width:g}" for each in line.dashes[1])
    numbers = b64encode(values.astype("<f4").tobytes()).decode()
    return Curve(engine, label, colour_of(line.colour), line.width, dashes, path, numbers)


def _path(x: Array, y: Array) -> str:
    """A line's ``d`` in tenths; it breaks where ``y`` is no number."""
    points, codes = thinned(x, y)
    return relative(FINE * points, codes, 0)


def round_ticks(low: float, high: float, most: int) -> list[float]:
    """Round numbers between two, some ``most`` of them."""
    from matplotlib.ticker import MaxNLocator

    return [float(value) for value in MaxNLocator(most).tick_values(low, high) if low <= value <= high * (1 + 1e-9)]
