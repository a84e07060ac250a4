"""Plots of the live page, in Bokeh: forces on the gauges, residuals, force over contact and time, moving beads."""

from collections.abc import Iterable
from functools import cache
from typing import Any

import numpy as np
from bokeh import models
from bokeh.plotting import figure
from bokeh.themes import Theme
from matplotlib.colors import rgb2hex

from postproc.draw.plot import GAMMA, MICRO, OPEN_CONTACT, OPEN_SHARE, colour_map, marker_of
from validation.explore.views import KEPT, MEASURED, NOW, RESIDUAL, Curves, View

COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9")  # of gauges
MARKERS = {"s": "square", "D": "diamond", "x": "x"}  # of Bokeh by that of matplotlib
DASHES = ("dashed", "dotted", "dashdot")  # of kept curves, one after another, then fainter
STYLE = """:host { white-space: pre-line; } .bk-clearfix { max-width: 100%; }
pre { font-size: min(13px, 2.7vw); overflow-x: auto; } [role=alert] { color: #b00020; overflow-wrap: anywhere; }
.bk-btn:focus-visible { outline: 2px solid #222 !important; }"""
WIDGET = {"stylesheets": [STYLE], "margin": [3, 0], "sizing_mode": "stretch_width"}
THEME = Theme(json={"attrs": {
    "Widget": WIDGET,
    "Column": WIDGET,
    "AbstractButton": {"sizing_mode": None},
    "Axis": {"minor_tick_line_color": None},
    "Legend": {"border_line_alpha": 0, "padding": 0},
}})  # fmt: skip
INK = "#555555"
LEFT_PX = 64  # room for the longest labels, so that the axes of time are below each other
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
            "spacetime": _figure(290, "contact", SINCE, x_range=time, y_range=(0, 1)),
            "beads": _figure(200, "force (N)", "height (mm)", x_range=(0, 1), y_range=(0, 1)),
        }
        forces, residuals, spacetime, beads = self.figures.values()
        for each in (forces, residuals):
            each.line([0], [0])  # without anything to draw there is no range
        self._parts: dict[str, dict[str, Any]] = {}  # renderers by gauge and part
        self._kept = 0
        forces.add_layout(models.Legend(orientation="horizontal"), "above")
        self._colours, self._shades = (
            models.LinearColorMapper(palette=_palette("force"), low_color=OPEN_CONTACT) for _ in range(2)
        )
        self._cells = models.ColumnDataSource({"image": [], "x": [], "y": [], "dw": [], "dh": []})
        spacetime.image("image", "x", "y", "dw", "dh", source=self._cells, color_mapper=self._colours)
        spacetime.add_tools(models.HoverTool(tooltips=[("contact, µs", "$y{0}, $x{0.0}"), ("N", "@image{0.0000}")]))
        spacetime.add_layout(models.ColorBar(color_mapper=self._colours, title="N", height=8), "below")
        self._now = models.Span(dimension="height", line_dash="dotted")
        for each in (forces, spacetime):
            each.add_layout(self._now)
        self._wall = models.Span(dimension="height", line_width=4, line_color="#888888")
        beads.add_layout(self._wall)
        self._bodies = models.ColumnDataSource({"x": [], "y": [], "force": [], "radius": []})
        fill = {"field": "force", "transform": self._shades}
        ball = {"radius": "radius", "radius_dimension": "x", "line_color": "#777777", "fill_color": fill}
        beads.circle("x", "y", source=self._bodies, **ball)
        beads.line("x", "force", source=self._bodies, line_color="#888888")

    def show(self, view: View) -> None:
        """Show the forces of a motion; those of other gauges go."""
        time_us = view.time_s * MICRO
        for gauge in view.signals:
            self._parts.setdefault(gauge, {})
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

    def put(self, part: str, curves: Curves) -> None:
        """Show a part of the gauges; it goes from all other gauges."""
        for gauge, parts in self._parts.items():
            if gauge in curves and part not in parts:
                parts[part] = self._renderer(gauge, part)
                parts[part].visible = parts[NOW].visible
            if part in parts:
                parts[part].data_source.data = dict(zip("xy", curves.get(gauge, ((), ())), strict=True))

    def keep(self) -> str:
        """Keep the curves of the motion that is shown, beside those of others; words on their look."""
        self._kept += 1
        shown = {gauge: (*parts[NOW].data_source.data.values(),) for gauge, parts in self._parts.items()}
        self.put(f"{KEPT} {self._kept}", {gauge: curve for gauge, curve in shown.items() if len(curve[0])})
        dash, share = look_of(self._kept)
        return f"{dash}{', faint' * (share < 0.5)}"

    def drop(self) -> None:
        """Remove kept curves."""
        for number in range(self._kept):
            self.put(f"{KEPT} {number + 1}", {})
        self._kept = 0

    def _renderer(self, gauge: str, part: str) -> Any:
        """Glyphs of a part of a gauge, without data."""
        forces, colour = self.figures["forces"], COLOURS[[*self._parts].index(gauge) % len(COLOURS)]
        look: dict[str, Any] = {"source": models.ColumnDataSource({"x": [], "y": []}), "name": f"{gauge} {part}"}
        if part == RESIDUAL:
            return self.figures["residuals"].line("x", "y", line_color=colour, **look)
        if part.startswith(KEPT):
            dash, share = look_of(int(part.removeprefix(KEPT)))
            return forces.line("x", "y", line_color=colour, line_dash=dash, line_alpha=share, **look)
        if part == MEASURED:
            return forces.scatter("x", "y", size=3, color=colour, alpha=0.5, **look)
        if part != NOW:
            size = 1.5 * marker_of(part)["ms"]
            return forces.scatter("x", "y", marker=mark_of(part), line_color=INK, size=size, fill_alpha=0, **look)
        line = forces.line("x", "y", line_color=colour, line_width=2, legend_label=gauge, **look)
        tips = [("µs", "@x{0.00}"), (gauge, "@y{0.0000} N")]
        forces.add_tools(models.HoverTool(renderers=[line], mode="vline", tooltips=tips))
        return line

    def at(self, view: View, time_s: float) -> None:
        """Show the beads at the frame that is closest to a time."""
        film = view.film
        frame = int(np.abs(film.time_s - time_s).argmin())
        self._now.location = float(film.time_s[frame]) * MICRO
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
        for (gauge, parts), item in zip(self._parts.items(), self.figures["forces"].legend.items, strict=True):
            for each in (item, *parts.values()):
                each.visible = gauge in shown


def look_of(kept: int) -> tuple[str, float]:
    """Dashes and opacity of the curves that are kept as number 1, 2, ..., which tell six of them apart."""
    round_, place = divmod(kept - 1, len(DASHES))
    return DASHES[place], 0.9 if round_ % 2 == 0 else 0.45


def mark_of(code: str) -> str:
    """Marker of a code."""
    return MARKERS.get(marker_of(code)["marker"], "circle")


def _figure(height: int, y: str, x: str, **ranges: Any) -> Any:
    look = {"sizing_mode": "stretch_width", "tools": "xpan,xbox_zoom,xwheel_zoom,reset"}
    ranges = {"y_range": models.DataRange1d(only_visible=True)} | ranges
    return figure(height=height, y_axis_label=y, x_axis_label=x, min_border_left=LEFT_PX, **look, **ranges)


@cache
def _palette(quantity: str) -> list[str]:
    """Colours of a map of matplotlib on the scale of ``GAMMA``, of a change for both signs."""
    share = np.linspace(-1.0 if quantity == "change" else 0.0, 1.0, 256)
    root = np.sign(share) * np.abs(share) ** GAMMA
    return [rgb2hex(colour) for colour in colour_map(quantity)((root + 1) / 2 if quantity == "change" else root)]
