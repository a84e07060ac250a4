"""Plots of the live page, in Bokeh: forces on the gauges, residuals, force over contact and time, moving beads."""

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np
from bokeh.models import ColorBar, ColumnDataSource, HoverTool, Legend, LegendItem, LinearColorMapper, Range1d, Span
from bokeh.plotting import figure
from matplotlib.colors import rgb2hex

from drivers.chain.chain import Array
from postproc.draw.film import rgba
from postproc.draw.product import GAMMA, OPEN_SHARE
from postproc.draw.style import MICRO, OPEN_CONTACT, colour_map, marker_of
from validation.explore.views import POINTS, Laid, OnCode, View

COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9")  # of gauges
MARKERS = {
    "o": "circle",
    "s": "square",
    "^": "triangle",
    "D": "diamond",
    "v": "inverted_triangle",
    "x": "x",
    "+": "cross",
}
INK = {False: ("#222222", "#dddddd"), True: ("#e4e4e4", "#444444")}  # of text and of lines; True: on dark paper
MILLI = 1e3
BELOW = 0.15  # of the largest force: room for the beads below the curve
TOOLS = "pan,box_zoom,wheel_zoom,reset"
EMPTY: dict[str, Any] = {"x": [], "y": []}


def _palette(quantity: str) -> list[str]:
    """Colours of a map of matplotlib on the scale of ``GAMMA``, of a change for both signs."""
    share = np.linspace(-1, 1, 256) if quantity == "change" else np.linspace(0, 1, 256)
    root = np.sign(share) * np.abs(share) ** GAMMA
    return [rgb2hex(colour) for colour in colour_map(quantity)((root + 1) / 2 if quantity == "change" else root)]


class Plots:
    """The plots and their data.

    Attributes:
        forces, residuals, spacetime, beads: Figures.
        sources: Data by gauge and part: ``now``, ``before``, ``measured``, ``residual``, and the name of each code.
    """

    def __init__(self) -> None:
        look: dict[str, Any] = {"sizing_mode": "stretch_width", "tools": TOOLS, "toolbar_location": "right"}
        time = Range1d(0, 1)
        since = "time since impact (µs)"
        self.forces = figure(height=340, x_range=time, y_axis_label="force (N)", x_axis_label=since, **look)
        self.residuals = figure(height=130, x_range=time, y_axis_label="residual (N)", visible=False, **look)
        self.spacetime = figure(
            height=240, x_range=time, y_range=Range1d(0, 1), y_axis_label="contact", x_axis_label=since, **look
        )
        self.beads = figure(
            height=200,
            x_range=Range1d(0, 1),
            y_range=Range1d(0, 1),
            y_axis_label="force (N)",
            x_axis_label="height (mm)",
            **look,
        )
        self.sources: dict[str, dict[str, ColumnDataSource]] = {}
        self._lines: dict[str, list[Any]] = {}
        self._dark = False
        self._legend = Legend(orientation="horizontal", background_fill_alpha=0, border_line_alpha=0, padding=0)
        self.forces.add_layout(self._legend, "above")
        self._cells, self._colours = (
            ColumnDataSource({"image": [], "x": [], "y": [], "dw": [], "dh": []}),
            LinearColorMapper(_palette("force")),
        )
        self.spacetime.image("image", "x", "y", "dw", "dh", source=self._cells, color_mapper=self._colours)
        self.spacetime.add_tools(
            HoverTool(tooltips=[("contact", "$y{0}"), ("time (µs)", "$x{0.0}"), ("N", "@image{0.0000}")])
        )
        self._bar = ColorBar(color_mapper=self._colours, title="N", width=10, background_fill_alpha=0)
        self.spacetime.add_layout(self._bar, "right")
        self._now = [Span(dimension="height", line_dash="dotted") for _ in "ab"]
        self.forces.add_layout(self._now[0])
        self.spacetime.add_layout(self._now[1])
        self._frame = ColumnDataSource({"x": [], "y": [], "force": [], "radius": [], "colour": []})
        self._wall = Span(dimension="height", line_width=4, line_color="#888888")
        self.beads.add_layout(self._wall)
        ball = {"radius": "radius", "radius_dimension": "x", "fill_color": "colour", "line_color": "#777777"}
        self.beads.circle("x", "y", source=self._frame, **ball)
        self.beads.line("x", "force", source=self._frame, line_color="#888888")

    @property
    def figures(self) -> dict[str, Any]:
        """Figures by name."""
        return {name: getattr(self, name) for name in ("forces", "residuals", "spacetime", "beads")}

    def show(self, view: View) -> None:
        """Show a motion; what belongs to other gauges goes."""
        if [*self.sources] != [*view.signals]:
            self._gauges([*view.signals])
        time_us = view.time_s * MICRO
        for gauge, force_N in view.signals.items():
            self.sources[gauge]["now"].data = {"x": time_us, "y": force_N}
        if self.forces.x_range.bounds != (0, time_us[-1]):
            self.forces.x_range.update(start=0, end=time_us[-1], bounds=(0, time_us[-1]))
        start_s, contact, cells = view.cells
        largest = float(np.abs(cells).max(initial=0.0)) or 1.0
        palette = _palette("change" if view.signed else "force")
        low = -largest if view.signed else OPEN_SHARE * largest
        self._colours.update(low=low, high=largest, palette=palette, low_color=OPEN_CONTACT)
        wide_us = float(start_s[1] - start_s[0]) * MICRO * len(start_s)
        high = (contact[1] - contact[0] if len(contact) > 1 else 1.0) * len(contact)
        self.spacetime.y_range.update(start=0.5, end=0.5 + high)
        self._cells.data = {"image": [cells], "x": [0], "y": [0.5], "dw": [wide_us], "dh": [high]}
        film = view.film
        low, top, most_N = film.low_m * MILLI, film.high_m * MILLI, film.largest_N
        self.beads.x_range.update(start=low, end=top)
        self.beads.y_range.update(start=-BELOW * most_N, end=1.05 * most_N)
        self._wall.update(location=(film.wall_m or 0.0) * MILLI, visible=film.wall_m is not None)

    def _gauges(self, gauges: Sequence[str]) -> None:
        """New curves for other gauges."""
        self.forces.renderers, self.residuals.renderers = [], []
        self.forces.tools = [tool for tool in self.forces.tools if not isinstance(tool, HoverTool)]
        self.sources, self._lines, items = {}, {}, []
        for gauge, colour in zip(gauges, COLOURS * (len(gauges) // len(COLOURS) + 1), strict=False):
            parts = {part: ColumnDataSource(dict(EMPTY)) for part in ("measured", "before", "now", "residual")}
            dots = self.forces.scatter("x", "y", source=parts["measured"], size=3, color=colour, alpha=0.5)
            old = self.forces.line("x", "y", source=parts["before"], color=colour, line_dash="dashed", alpha=0.8)
            line = self.forces.line("x", "y", source=parts["now"], color=colour, line_width=2)
            left = self.residuals.line("x", "y", source=parts["residual"], color=colour)
            shown = [("µs", "@x{0.00}"), (gauge, "@y{0.0000} N")]
            self.forces.add_tools(HoverTool(renderers=[line], mode="vline", tooltips=shown, line_policy="nearest"))
            items.append(LegendItem(label=gauge.replace("_", " "), renderers=[line]))
            self.sources[gauge], self._lines[gauge] = parts, [dots, old, line, left]
        self._legend.items = items

    def show_before(self, views: Iterable[View]) -> None:
        """Show the curves that were kept, dashed."""
        views = [*views]
        for gauge, parts in self.sources.items():
            curves = [(view.time_s * MICRO, view.signals[gauge]) for view in views if gauge in view.signals]
            parts["before"].data = _joined(curves)

    def show_codes(self, runs: Iterable[OnCode]) -> None:
        """Show points of the runs of codes, and no others."""
        runs = [*runs]
        for gauge, parts in self.sources.items():
            for code in {*parts} - {"measured", "before", "now", "residual"} - {run.engine for run in runs}:
                parts[code].data = dict(EMPTY)
            for run in (run for run in runs if gauge in run.signals):
                if run.engine not in parts:
                    parts[run.engine] = ColumnDataSource(dict(EMPTY))
                    look = marker_of(run.engine)
                    points = self.forces.scatter(
                        "x", "y", source=parts[run.engine], size=7, fill_alpha=0, line_color=look["color"],
                        marker=MARKERS.get(look["marker"], "circle"),
                    )  # fmt: skip
                    self._lines[gauge].append(points)
                every = slice(None, None, max(len(run.time_s) // POINTS, 1))
                parts[run.engine].data = {"x": run.time_s[every] * MICRO, "y": run.signals[gauge][every]}

    def show_measured(self, laid: Laid | None, view: View) -> None:
        """Show measured traces above the static load, and residuals."""
        self.residuals.visible = laid is not None
        for gauge, parts in self.sources.items():
            time_s, force_N, run_s, left_N = laid.gauges[gauge] if laid and gauge in laid.gauges else [np.zeros(0)] * 4
            parts["measured"].data = {"x": time_s * MICRO, "y": force_N + view.signals[gauge][0]}
            parts["residual"].data = {"x": run_s * MICRO, "y": left_N}

    def at(self, view: View, time_s: float) -> None:
        """Show the beads at the frame that is closest to a time."""
        film = view.film
        frame = int(np.abs(film.time_s - time_s).argmin())
        for span in self._now:
            span.location = float(film.time_s[frame]) * MICRO
        radius = np.where(film.radius_m > 0, film.radius_m, film.flat_m[1] / 2)
        place, force_N = film.place_m[frame], film.force_N[frame]
        height = place[:, 1] + np.where(film.radius_m > 0, 0.0, radius)
        self._frame.data = {
            "x": height * MILLI,
            "y": place[:, 0] / film.half_m * BELOW * film.largest_N,
            "force": force_N,
            "radius": radius * MILLI,
            "colour": [rgb2hex(colour) for colour in rgba(film, force_N)],
        }

    def only(self, gauges: Iterable[str]) -> None:
        """Hide the curves of all other gauges."""
        shown = {*gauges}
        for gauge, lines in self._lines.items():
            for line in lines:
                line.visible = gauge in shown

    def paint(self, *, dark: bool) -> None:
        """Colours for light or dark paper."""
        ink, faint = INK[dark]
        for each in self.figures.values():
            each.update(background_fill_color=None, border_fill_color=None, outline_line_color=faint)
            each.grid.grid_line_color = faint
            for name in ("axis_label_text_color", "major_label_text_color", "axis_line_color", "major_tick_line_color"):
                setattr(each.axis, name, ink)
        self._legend.label_text_color = ink
        self._bar.update(title_text_color=ink, major_label_text_color=ink)
        for span in self._now:
            span.line_color = ink


def _joined(curves: Sequence[tuple[Array, Array]]) -> Mapping[str, Array]:
    """Curves one after another, with a gap between them."""
    parts = [np.append(np.column_stack(curve), [[np.nan, np.nan]], axis=0) for curve in curves]
    x, y = np.concatenate([np.zeros((0, 2)), *parts]).T
    return {"x": x, "y": y}
