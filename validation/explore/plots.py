"""Plots of the live page, in Bokeh: forces on the gauges, residuals, force over contact and time, moving beads."""

from collections.abc import Iterable, Mapping
from functools import cache
from typing import Any

import numpy as np
from bokeh import models
from bokeh.plotting import figure
from matplotlib.colors import rgb2hex

from drivers.chain.chain import Array
from postproc.draw.plot import GAMMA, MICRO, OPEN_CONTACT, OPEN_SHARE, colour_map, marker_of
from validation.explore.views import BEFORE, MEASURED, NOW, RESIDUAL, View

COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9")  # of gauges
LOOKS: dict[str, dict[str, Any]] = {  # of lines; other parts are points
    NOW: {"line_width": 2},
    BEFORE: {"line_dash": "dashed", "line_alpha": 0.8},
    RESIDUAL: {},
}
MARKERS = {"s": "square", "D": "diamond", "x": "x"}  # of Bokeh by that of matplotlib
INK = {False: ("#222222", "#dddddd"), True: ("#e4e4e4", "#444444")}  # of text and of lines; True: on dark paper
MILLI = 1e3
BELOW = 0.3  # of the largest force: room for the beads below the curve
SINCE = "time since impact (µs)"


class Plots:
    """The plots: a figure each for forces, residuals, contacts against time, and the beads."""

    def __init__(self) -> None:
        time = models.Range1d(start=0, end=1)
        self.figures = {
            "forces": _figure(340, "force (N)", SINCE, x_range=time),
            "residuals": _figure(130, "residual (N)", SINCE, x_range=time),
            "spacetime": _figure(240, "contact", SINCE, x_range=time, y_range=models.Range1d(start=0, end=1)),
            "beads": _figure(
                200, "force (N)", "height (mm)",
                x_range=models.Range1d(start=0, end=1), y_range=models.Range1d(start=0, end=1),
            ),
        }  # fmt: skip
        for name in ("forces", "residuals"):
            self.figures[name].line([0], [0])  # without anything to draw there is no range
        self._parts: dict[str, dict[str, Any]] = {}  # renderers by gauge and part
        self._legend = models.Legend(orientation="horizontal", background_fill_alpha=0, border_line_alpha=0, padding=0)
        self.figures["forces"].add_layout(self._legend, "above")
        self._colours = models.LinearColorMapper(palette=_palette("force"), low_color=OPEN_CONTACT)
        cells, bodies = dict.fromkeys(("image", "x", "y", "dw", "dh"), ()), ("x", "y", "force", "radius")
        self._cells = models.ColumnDataSource({name: [] for name in cells})
        self._bodies = models.ColumnDataSource({name: [] for name in bodies})
        self._shades = models.LinearColorMapper(palette=_palette("force"), low_color=OPEN_CONTACT)
        self._bar = models.ColorBar(color_mapper=self._colours, title="N", width=10, background_fill_alpha=0)
        self._now = [models.Span(dimension="height", line_dash="dotted") for _ in range(2)]
        self._wall = models.Span(dimension="height", line_width=4, line_color="#888888")
        spacetime, beads = self.figures["spacetime"], self.figures["beads"]
        spacetime.image(*cells, source=self._cells, color_mapper=self._colours)
        spacetime.add_tools(models.HoverTool(tooltips=[("contact, µs", "$y{0}, $x{0.0}"), ("N", "@image{0.0000}")]))
        spacetime.add_layout(self._bar, "right")
        spacetime.add_layout(self._now[0])
        self.figures["forces"].add_layout(self._now[1])
        beads.add_layout(self._wall)
        ball: dict[str, Any] = {"radius": "radius", "radius_dimension": "x", "line_color": "#777777"}
        ball["fill_color"] = {"field": "force", "transform": self._shades}
        beads.circle("x", "y", source=self._bodies, **ball)
        beads.line("x", "force", source=self._bodies, line_color="#888888")

    def show(self, view: View) -> None:
        """Show the forces of a motion; what belongs to other gauges goes."""
        if [*self._parts] != [*view.signals]:
            self._parts = {gauge: {} for gauge in view.signals}
            for name in ("forces", "residuals"):
                self.figures[name].renderers = self.figures[name].renderers[:1]
            tools = self.figures["forces"].tools
            self.figures["forces"].tools = [each for each in tools if not isinstance(each, models.HoverTool)]
            self._legend.items = []
        time_us = view.time_s * MICRO
        self.put(NOW, {gauge: (time_us, force_N) for gauge, force_N in view.signals.items()})
        time = self.figures["forces"].x_range
        if time.bounds != (0, time_us[-1]):  # else the zoom stays
            time.update(start=0, end=time_us[-1], bounds=(0, time_us[-1]))

    def show_cells(self, view: View) -> None:
        """Show the forces of all contacts of a motion against time, and the room for its beads."""
        start_s, contact, cells = view.cells
        largest = float(np.abs(cells).max(initial=0.0)) or 1.0
        low, quantity = (-largest, "change") if view.signed else (OPEN_SHARE * largest, "force")
        self._colours.update(low=low, high=largest, palette=_palette(quantity))
        wide, high = (float(edge[1] - edge[0]) * len(edge) if len(edge) > 1 else 1.0 for edge in (start_s, contact))
        self.figures["spacetime"].y_range.update(start=0.5, end=0.5 + high)
        self._cells.data = {"image": [cells], "x": [0], "y": [0.5], "dw": [wide * MICRO], "dh": [high]}
        film = view.film
        self.figures["beads"].x_range.update(start=film.low_m * MILLI, end=film.high_m * MILLI)
        self.figures["beads"].y_range.update(start=-BELOW * film.largest_N, end=1.05 * film.largest_N)
        self._shades.update(low=OPEN_SHARE * film.largest_N, high=film.largest_N)
        self._wall.update(location=(film.wall_m or 0.0) * MILLI, visible=film.wall_m is not None)

    def put(self, part: str, curves: Mapping[str, tuple[Any, Any]]) -> None:
        """Show a part of the gauges, times in µs with forces in N; it goes from all other gauges."""
        for gauge, parts in self._parts.items():
            if gauge in curves and part not in parts:
                parts[part] = self._renderer(gauge, part)
            if part in parts:
                parts[part].data_source.data = dict(zip("xy", curves.get(gauge, ((), ())), strict=True))

    def _renderer(self, gauge: str, part: str) -> Any:
        """Glyphs of a part of a gauge, without data."""
        forces, colour = self.figures["forces"], COLOURS[[*self._parts].index(gauge) % len(COLOURS)]
        source, name = models.ColumnDataSource({"x": [], "y": []}), f"{gauge} {part}"
        if part in LOOKS:
            axes = self.figures["residuals"] if part == RESIDUAL else forces
            line = axes.line("x", "y", source=source, line_color=colour, name=name, **LOOKS[part])
            if part == NOW:
                self._legend.items = [*self._legend.items, models.LegendItem(label=gauge, renderers=[line])]
                tips = [("µs", "@x{0.00}"), (gauge, "@y{0.0000} N")]
                forces.add_tools(models.HoverTool(renderers=[line], mode="vline", tooltips=tips))
            return line
        if part == MEASURED:
            return forces.scatter("x", "y", source=source, size=3, color=colour, alpha=0.5, name=name)
        look = marker_of(part)
        points: dict[str, Any] = {"marker": MARKERS.get(look["marker"], "circle"), "line_color": look["color"]}
        return forces.scatter("x", "y", source=source, size=7, fill_alpha=0, name=name, **points)

    @property
    def curves(self) -> dict[str, dict[str, tuple[Any, Any]]]:
        """Times in µs and forces that are shown, by gauge and part."""
        return {
            gauge: {
                part: (each.data_source.data["x"], each.data_source.data["y"])
                for part, each in parts.items()
                if part != RESIDUAL and len(each.data_source.data["x"])
            }
            for gauge, parts in self._parts.items()
            if parts[NOW].visible
        }

    def at(self, view: View, time_s: float) -> None:
        """Show the beads at the frame that is closest to a time."""
        film = view.film
        frame = int(np.abs(film.time_s - time_s).argmin())
        for span in self._now:
            span.location = float(film.time_s[frame]) * MICRO
        radius_m, round_ = np.where(film.radius_m > 0, film.radius_m, film.flat_m[1] / 2), film.radius_m > 0
        self._bodies.data = {
            "x": (film.place_m[frame, :, 1] + np.where(round_, 0.0, radius_m)) * MILLI,
            "y": film.place_m[frame, :, 0] / film.half_m * BELOW * film.largest_N,
            "force": film.force_N[frame],
            "radius": radius_m * MILLI,
        }

    def only(self, gauges: Iterable[str]) -> None:
        """Hide the curves of all other gauges."""
        shown = {*gauges}
        for gauge, parts in self._parts.items():
            for renderer in parts.values():
                renderer.visible = gauge in shown

    def paint(self, *, dark: bool) -> None:
        """Colours for light or dark paper."""
        ink, faint = INK[dark]
        for each in self.figures.values():
            each.update(background_fill_color=None, border_fill_color=None, outline_line_color=faint)
            each.grid.grid_line_color = faint
            for name in ("axis_label_text_color", "major_label_text_color", "axis_line_color", "major_tick_line_color"):
                setattr(each.axis, name, ink)
        self._legend.label_text_color = self._bar.title_text_color = self._bar.major_label_text_color = ink
        for span in self._now:
            span.line_color = ink


def _figure(height: int, y: str, x: str, **ranges: Any) -> Any:
    look = {"sizing_mode": "stretch_width", "tools": "xpan,xbox_zoom,xwheel_zoom,reset"}
    return figure(height=height, y_axis_label=y, x_axis_label=x, **look, **ranges)


@cache
def _palette(quantity: str) -> list[str]:
    """Colours of a map of matplotlib on the scale of ``GAMMA``, of a change for both signs."""
    share = np.linspace(-1.0 if quantity == "change" else 0.0, 1.0, 256)
    root = np.sign(share) * np.abs(share) ** GAMMA
    return [rgb2hex(colour) for colour in colour_map(quantity)((root + 1) / 2 if quantity == "change" else root)]


def joined(curves: Iterable[tuple[Array, Array]]) -> tuple[Array, Array]:
    """Curves one after another, with a gap between them."""
    points = [np.append(np.column_stack(curve), [[np.nan, np.nan]], axis=0) for curve in curves]
    x, y = np.concatenate([np.zeros((0, 2)), *points]).T
    return x, y
