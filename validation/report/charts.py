"""Charts of the page, as numbers that ``templates/report/chart.html.j2`` draws.

They are not matplotlib's: a page of a dozen scenes is drawn in a tenth of a second, its curves know their values, and
its colours follow the reader's light or dark screen. Ticks and the thinning of lines are matplotlib's.
"""

from base64 import b64encode
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from drivers.chain.case import Layout
from drivers.chain.chain import Array
from drivers.chain.trace import Trace
from drivers.engines import REFERENCE, VERLET
from postproc.draw.stack import gauge_title, residuals
from postproc.draw.style import drawing_order, line_of
from postproc.read.sensors import sensor_signals

WIDTH, LEFT, RIGHT, TOP = 720.0, 62.0, 712.0, 24.0
PANEL, GAP, BELOW = 116.0, 30.0, 40.0  # heights
MAX_SAMPLES = 1600  # of a curve's values; of longer records every n-th is kept
MAX_GAUGES = 4  # drawn; the table of observables has them all
NOTE = 22.0  # height of a note's words on a phone
LETTER, KEY = 11.0, 4.5  # width of a letter of the legend on a phone, and of a line with its gaps in letters
FINE = 10  # coordinates are whole tenths
SEEN = 0.1  # by how much a line may be moved by thinning
NO_TRACES: Mapping[str, Trace] = {}
PLACES = {"width": WIDTH, "left": LEFT, "right": RIGHT}
TIMES = ((1e6, "µs"), (1e3, "ms"), (1.0, "s"))


@dataclass(frozen=True)
class Curve:
    """One line of a panel."""

    engine: str
    label: str  # the engine, whether its run failed, and in the panel of differences what is subtracted from it
    colour: str
    width: float
    dashes: str
    values: str  # base64 of little-endian float32, one a kept sample


@dataclass(frozen=True)
class Panel:
    """One pair of axes; ``ticks`` are places and labels, ``notes`` places and words at the right end."""

    title: str
    unit: str
    top: float
    bottom: float
    ticks: list[tuple[float, str]]
    curves: list[Curve]
    paths: list[str]  # the ``d`` of each curve, in tenths
    notes: list[tuple[float, str]]


@dataclass(frozen=True)
class Chart:
    """Panels over one axis of time."""

    height: float
    unit: str
    start: float
    spacing: float  # between kept samples, in ``unit``
    count: int
    last: float  # where time ends, in kept samples from 0: what does not divide leaves a part of one
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
        panels = [{k: v for k, v in asdict(panel).items() if k != "paths"} for panel in self.panels]
        return asdict(self) | PLACES | {"panels": panels}


@dataclass(frozen=True)
class _Series:
    """Values of a curve at every sample; ``against`` is the yardstick of a difference."""

    engine: str
    label: str
    values: Array
    against: str = ""


def chart_of(layout: Layout, traces: Mapping[str, Trace], failed: Mapping[str, Trace] = NO_TRACES) -> Chart:
    """Gauge forces of all engines over each other, a panel each, and below the largest differences of any contact.

    Args:
        layout: of the chain.
        traces: by engine, of equal sample times; at least one, here or in ``failed``.
        failed: by engine, what can be shown of runs that failed, at the same times; they are no yardstick.
    """
    everything = {**traces, **failed}
    labels = {engine: failed_label(engine) if engine in failed else engine for engine in drawing_order([*everything])}
    time_s = next(iter(everything.values())).time_s
    # four digits at most
    per_s, unit = next((each for each in TIMES if float(time_s[-1]) * each[0] < 1e4), TIMES[-1])
    start, span = float(time_s[0]) * per_s, float(np.ptp(time_s)) * per_s
    scale = (RIGHT - LEFT) / (span or 1.0)
    every = -(-len(time_s) // MAX_SAMPLES)
    x = LEFT + (RIGHT - LEFT) * (time_s - time_s[0]) / (float(np.ptp(time_s)) or 1.0)
    signals = {engine: sensor_signals(layout, trace) for engine, trace in everything.items()}
    gauges = list(next(iter(signals.values())))
    yardsticks = [name for name in (REFERENCE, VERLET) if name in traces] or list(traces)[:1]
    differences = [
        _Series(engine, f"{labels[engine]} − {yardstick}", values, yardstick)
        for yardstick in yardsticks
        for engine, values in residuals(everything, yardstick).items()
    ]
    panels: list[Panel] = []
    for gauge in gauges[-MAX_GAUGES:]:
        own = [_Series(engine, label, signals[engine][gauge]) for engine, label in labels.items()]
        panels.append(_forces(gauge_title(layout, gauge), own, x, every, _top(len(panels))))
    panels += [_differences(differences, x, every, _top(len(panels)))] if differences else []
    return Chart(
        height=_top(len(panels)) - GAP + BELOW,
        unit=unit,
        start=start,
        spacing=float(time_s[every] - time_s[0]) * per_s if len(time_s) > every else 0.0,
        count=len(time_s[::every]),
        last=(len(time_s) - 1) / every,
        ticks=[(LEFT + scale * t, f"{t + start:g}") for t in _round_ticks(0.0, span, 8)],
        engines=[_curve(_Series(engine, label, np.empty(0)), 1) for engine, label in labels.items()],
        panels=panels,
        left_out=max(0, len(gauges) - MAX_GAUGES),
    )


def failed_label(engine: str) -> str:
    """What a run that failed is called beside those that finished."""
    return f"{engine} (failed)"


def _round_ticks(low: float, high: float, count: int) -> list[float]:
    """Round numbers between two, some ``count`` of them."""
    from matplotlib.ticker import MaxNLocator

    return [float(value) for value in MaxNLocator(count).tick_values(low, high) if low <= value <= high * (1 + 1e-9)]


def _top(panels: int) -> float:
    return TOP + 18.0 + panels * (PANEL + GAP)


def _forces(title: str, forces: list[_Series], x: Array, every: int, top: float) -> Panel:
    """Forces on a linear axis from zero, or from the lowest where that is below."""
    finite = np.concatenate([each.values[np.isfinite(each.values)] for each in forces])
    low, high = float(finite.min(initial=0.0)), float(finite.max(initial=0.0)) or 1.0

    def place(values: Array) -> Array:
        return top + PANEL * (1.0 - (values - low) / ((high - low) * 1.04))

    paths = [_path(x, place(each.values)) for each in forces]
    ticks = [(float(place(np.array(value))), f"{value:g}") for value in _round_ticks(low, high, 4)]
    return Panel(title, "N", top, top + PANEL, ticks, [_curve(each, every) for each in forces], paths, [])


def _differences(found: list[_Series], x: Array, every: int, top: float) -> Panel:
    """Largest force difference of any contact to each yardstick, over the largest change, on a logarithmic axis."""
    above_zero = np.concatenate([each.values[np.isfinite(each.values) & (each.values > 0)] for each in found])
    low = np.floor(np.log10(above_zero.min())) if len(above_zero) else -17.0
    high = max(low + 1.0, np.ceil(np.log10(above_zero.max()))) if len(above_zero) else -16.0

    def place(values: Array) -> Array:
        with np.errstate(divide="ignore", invalid="ignore"):
            logarithm = np.where(values > 0, np.log10(values), np.nan)
        return np.asarray(top + PANEL * (high - logarithm) / (high - low))

    notes: dict[str, float] = {}
    heights = [place(each.values) for each in found]
    for each, y in zip(found, heights, strict=True):
        if np.isfinite(y).any():
            words, last = f"from {each.against}", float(y[np.isfinite(y)][-1])
            last = last - 4.0 if last > top + NOTE else last + NOTE  # clear of the title
            notes[words] = max(notes.get(words, -np.inf), last)  # at the lowest curve: a run that is off has left it
    stride = max(1, int(np.ceil((high - low) / 5)))
    ticks = [(float(place(np.array(10.0**power))), f"1e{power:g}") for power in np.arange(low, high + 1, stride)]
    title = "largest difference over all contacts, of the largest change"
    paths, right = [_path(x, y) for y in heights], [(y, words) for words, y in notes.items()]
    return Panel(title, "", top, top + PANEL, ticks, [_curve(each, every) for each in found], paths, right)


def _curve(series: _Series, every: int) -> Curve:
    line = line_of(series.engine)
    dashes = "" if line.dashes == "-" else " ".join(f"{each * line.width:g}" for each in line.dashes[1])
    numbers = b64encode(series.values[::every].astype("<f4").tobytes()).decode()
    return Curve(series.engine, series.label, line.colour, line.width, dashes, numbers)


def _path(x: Array, y: Array) -> str:
    """A line's ``d`` in steps of tenths, without points that nobody sees; it breaks where ``y`` is no number."""
    from matplotlib.path import Path as Line

    line = Line(np.column_stack([x, y]))
    line.simplify_threshold = SEEN
    clean = line.cleaned(remove_nans=True, simplify=True)
    whole = np.rint(FINE * np.asarray(clean.vertices)).astype(int)  # before the differences: steps do not drift
    steps = np.diff(whole, axis=0, prepend=0)
    kept = zip(steps.tolist(), np.asarray(clean.codes).tolist(), strict=True)
    return "".join(f"{'m' if code == Line.MOVETO else 'l'}{dx} {dy}" for (dx, dy), code in kept if code != Line.STOP)
