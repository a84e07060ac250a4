"""Charts of gauge forces, computed as coordinates for ``templates/report/chart.html.j2``.

Matplotlib chooses the ticks and simplifies the lines; the template draws the SVG. So a page of a dozen scenes takes a
tenth of a second, a script can show the values of curves, and colours follow the light or dark screen.
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

# lengths are in pixels of the chart at its full width
WIDTH, LEFT_EDGE, RIGHT_EDGE, TOP_EDGE = 720.0, 70.0, 712.0, 24.0
PANEL_HEIGHT, GAP_HEIGHT, AXIS_HEIGHT, NOTE_HEIGHT = 116.0, 32.0, 50.0, 24.0
LETTER_WIDTH, KEY_LETTERS = 11.7, 4.5  # of the legend on a phone; width of a line of the legend with its gaps
MAX_SAMPLES = 1600  # values of a curve; of longer records every n-th sample is kept
MAX_GAUGES = 4  # panels; the table of observables has all gauges
UNITS_PER_PIXEL = 10  # of the integer coordinates of curves
PATH_ERROR = 0.1  # largest displacement of a curve by simplification
NO_TRACES: Mapping[str, Trace] = {}
PLACES = {"width": WIDTH, "left": LEFT_EDGE, "right": RIGHT_EDGE}
TIMES = ((1e6, "µs"), (1e3, "ms"), (1.0, "s"))


@dataclass(frozen=True)
class Curve:
    """One line of a panel."""

    engine: str
    label: str  # engine, "(failed)" for a failed run, and in the panel of differences the subtracted engine
    colour: str
    width: float
    dashes: str
    values: str  # base64 of little-endian float32, one for each kept sample


@dataclass(frozen=True)
class Panel:
    """One pair of axes; ``ticks`` and ``notes`` (at the right end) are heights with their texts."""

    title: str
    unit: str
    top: float
    bottom: float
    ticks: list[tuple[float, str]]
    curves: list[Curve]
    paths: list[str]  # SVG path of each curve, in tenths of a pixel
    notes: list[tuple[float, str]]


@dataclass(frozen=True)
class Chart:
    """Panels over one axis of time, in ``unit``."""

    height: float
    unit: str
    start: float
    spacing: float  # between kept samples
    count: int
    last: float  # end of the record in kept samples from 0; not whole if the number of samples does not divide
    ticks: list[tuple[float, str]]
    engines: list[Curve]
    panels: list[Panel]
    left_out: int

    @property
    def legend(self) -> list[tuple[float, Curve]]:
        """Place of each engine's key, with the style of its curves; longer names get more room."""
        letters = np.array([KEY_LETTERS + len(each.label) for each in self.engines])
        letter = min(LETTER_WIDTH, (RIGHT_EDGE - LEFT_EDGE) / letters.sum())
        places = LEFT_EDGE + letter * (np.cumsum(letters) - letters)
        return list(zip(places.tolist(), self.engines, strict=True))

    @property
    def data(self) -> dict[str, Any]:
        """Values and places for the script of the page."""
        panels = [{k: v for k, v in asdict(panel).items() if k != "paths"} for panel in self.panels]
        return asdict(self) | PLACES | {"panels": panels}


@dataclass(frozen=True)
class _Series:
    """Values of a curve at every sample; a difference is from the engine ``against``."""

    engine: str
    label: str
    values: Array
    against: str = ""


def chart_of(
    layout: Layout,
    traces: Mapping[str, Trace],
    failed: Mapping[str, Trace] = NO_TRACES,
    *,
    gauges: int = MAX_GAUGES,
) -> Chart:
    """Forces of all engines, a panel for each gauge, and a panel of the largest difference over all contacts.

    Differences are from the exact motion and from the baseline; without both, from the first engine.

    Args:
        layout: of the chain.
        traces: by engine, of equal sample times; at least one, here or in ``failed``.
        failed: by engine, partial traces of failed runs, at the same times.
        gauges: largest number of panels of forces; the gauges closest to the wall are shown.
    """
    everything = {**traces, **failed}
    labels = {engine: failed_label(engine) if engine in failed else engine for engine in drawing_order([*everything])}
    time_s = next(iter(everything.values())).time_s
    # at most four digits
    per_s, unit = next((each for each in TIMES if float(time_s[-1]) * each[0] < 1e4), TIMES[-1])
    start, span = float(time_s[0]) * per_s, float(np.ptp(time_s)) * per_s
    scale = (RIGHT_EDGE - LEFT_EDGE) / (span or 1.0)
    every = -(-len(time_s) // MAX_SAMPLES)
    x = LEFT_EDGE + (RIGHT_EDGE - LEFT_EDGE) * (time_s - time_s[0]) / (float(np.ptp(time_s)) or 1.0)
    signals = {engine: sensor_signals(layout, trace) for engine, trace in everything.items()}
    names = list(next(iter(signals.values())))
    subtracted = [name for name in (REFERENCE, VERLET) if name in traces] or list(traces)[:1]
    differences = [
        _Series(engine, f"{labels[engine]} − {against}", values, against)
        for against in subtracted
        for engine, values in residuals(everything, against).items()
    ]
    panels: list[Panel] = []
    for gauge in names[-gauges:]:
        own = [_Series(engine, label, signals[engine][gauge]) for engine, label in labels.items()]
        panels.append(_forces(gauge_title(layout, gauge), own, x, every, _top(len(panels))))
    panels += [_differences(differences, x, every, _top(len(panels)))] if differences else []
    return Chart(
        height=_top(len(panels)) - GAP_HEIGHT + AXIS_HEIGHT,
        unit=unit,
        start=start,
        spacing=float(time_s[every] - time_s[0]) * per_s if len(time_s) > every else 0.0,
        count=len(time_s[::every]),
        last=(len(time_s) - 1) / every,
        ticks=[(LEFT_EDGE + scale * t, f"{t + start:g}") for t in _round_ticks(0.0, span, 8)],
        engines=[_curve(_Series(engine, label, np.empty(0)), 1) for engine, label in labels.items()],
        panels=panels,
        left_out=max(0, len(names) - gauges),
    )


def failed_label(engine: str) -> str:
    """Label of a failed run."""
    return f"{engine} (failed)"


def _round_ticks(low: float, high: float, count: int) -> list[float]:
    """About ``count`` round numbers between two numbers."""
    from matplotlib.ticker import MaxNLocator

    return [float(value) for value in MaxNLocator(count).tick_values(low, high) if low <= value <= high * (1 + 1e-9)]


def _top(panels: int) -> float:
    return TOP_EDGE + 18.0 + panels * (PANEL_HEIGHT + GAP_HEIGHT)


def _forces(title: str, forces: list[_Series], x: Array, every: int, top: float) -> Panel:
    """Panel of forces on a linear axis from zero, or from the smallest force if negative."""
    finite = np.concatenate([each.values[np.isfinite(each.values)] for each in forces])
    low, high = float(finite.min(initial=0.0)), float(finite.max(initial=0.0)) or 1.0

    def place(values: Array) -> Array:
        return top + PANEL_HEIGHT * (1.0 - (values - low) / ((high - low) * 1.04))

    paths = [_path(x, place(each.values)) for each in forces]
    ticks = [(float(place(np.array(value))), f"{value:g}") for value in _round_ticks(low, high, 4)]
    return Panel(title, "N", top, top + PANEL_HEIGHT, ticks, [_curve(each, every) for each in forces], paths, [])


def _differences(found: list[_Series], x: Array, every: int, top: float) -> Panel:
    """Panel of the largest force difference over all contacts, over the largest change, on a logarithmic axis."""
    above_zero = np.concatenate([each.values[np.isfinite(each.values) & (each.values > 0)] for each in found])
    low = np.floor(np.log10(above_zero.min())) if len(above_zero) else -17.0
    high = max(low + 1.0, np.ceil(np.log10(above_zero.max()))) if len(above_zero) else -16.0

    def place(values: Array) -> Array:
        with np.errstate(divide="ignore", invalid="ignore"):
            logarithm = np.where(values > 0, np.log10(values), np.nan)
        return np.asarray(top + PANEL_HEIGHT * (high - logarithm) / (high - low))

    notes: dict[str, float] = {}
    heights = [place(each.values) for each in found]
    for each, y in zip(found, heights, strict=True):
        if np.isfinite(y).any():
            words, last = f"from {each.against}", float(y[np.isfinite(y)][-1])
            last = last - 4.0 if last > top + NOTE_HEIGHT else last + NOTE_HEIGHT  # below the title
            notes[words] = max(notes.get(words, -np.inf), last)  # at the lowest curve, the smallest difference
    stride = max(1, int(np.ceil((high - low) / 5)))
    ticks = [(float(place(np.array(10.0**power))), f"1e{power:g}") for power in np.arange(low, high + 1, stride)]
    title = "largest force difference of any contact / largest change"
    paths, right = [_path(x, y) for y in heights], [(y, words) for words, y in notes.items()]
    return Panel(title, "", top, top + PANEL_HEIGHT, ticks, [_curve(each, every) for each in found], paths, right)


def _curve(series: _Series, every: int) -> Curve:
    line = line_of(series.engine)
    dashes = "" if line.dashes == "-" else " ".join(f"{each * line.width:g}" for each in line.dashes[1])
    numbers = b64encode(series.values[::every].astype("<f4").tobytes()).decode()
    return Curve(series.engine, series.label, line.colour, line.width, dashes, numbers)


def _path(x: Array, y: Array) -> str:
    """SVG path of a curve in integer steps, simplified; interrupted where ``y`` is NaN."""
    from matplotlib.path import Path as Line

    line = Line(np.column_stack([x, y]))
    line.simplify_threshold = PATH_ERROR
    clean = line.cleaned(remove_nans=True, simplify=True)
    whole = np.rint(UNITS_PER_PIXEL * np.asarray(clean.vertices)).astype(int)  # rounded before diff: no drift
    steps = np.diff(whole, axis=0, prepend=0)
    kept = zip(steps.tolist(), np.asarray(clean.codes).tolist(), strict=True)
    return "".join(f"{'m' if code == Line.MOVETO else 'l'}{dx} {dy}" for (dx, dy), code in kept if code != Line.STOP)
