"""Fig. 1: experimental set-up and sensor bead.

A chain in a tube, struck from above. Gauges in two beads and below the chain record a wave, its speed and its
reflection.

(a) 21 PTFE beads (4.76 mm, 0.1226 g) in a PTFE tube (inner diameter 5 mm), struck by a PTFE bead at 2 m/s. To scale,
except for sizes that the paper does not state: wall gauge, rod, block, tube wall. (b) Sensor bead, 0.116 g with glue:
lead zirconate titanate between two PTFE caps, whose cut is not stated.
"""

from math import nan
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from matplotlib.patches import Circle, Polygon, Rectangle

from drivers.chain.case import Case
from postproc.draw.drawings import BEAD, OUTLINE, STRIKER, TUBE
from postproc.draw.plot import COLUMN_IN, GREY, Product, letter_panel, pyplot
from postproc.paper import quoted
from postproc.read.motion import case_of

MM_PER_IN = 25.4
LOW, HIGH, LEFT, TITLE = -29.0, 116.0, -30.0, 5.0  # mm: edges of (a) from wall and axis; room for the letter
SIDE, MAGNIFICATION = 50.0, 6.5  # of (b): side on paper in mm, scale relative to (a)
GAUGE, STEEL = "#e69f00", "#b8c0c8"
COLOURS = {"striker": STRIKER, "tube": TUBE, "gauge": GAUGE, "wall gauge": GAUGE, "brass plate": "#c9b27c",
           "steel rod": STEEL, "steel block": "#98a2ac", "oscilloscope": "white"}  # fmt: skip
# lengths in mm that the paper does not state
TUBE_WALL, WALL_GAUGE, ROD, BLOCK, EMBEDDED, ABOVE = 0.7, (7.0, 1.0), 8.0, (26.0, 8.0), 3.0, 3.0
CUT, WAVE = 1.4, 0.5  # mm: gap of the cut rod, amplitude of its wavy ends
LEAD = {"arrowstyle": "-", "lw": 0.5, "color": GREY, "shrinkA": 1, "shrinkB": 0}
DIMENSION = {"lw": 0.5, "color": GREY, "shrinkA": 0, "shrinkB": 0, "mutation_scale": 5}
SCOPE = (-20.5, 25.0, 18.5, 10.0)  # oscilloscope: middle, bottom, width, height


class Piece(NamedTuple):
    """A drawn part; heights are above the wall in (a), above the particle's centre in (b)."""

    panel: str
    part: str
    shape: str  # box, disc, cap above, cap below; cut above, cut below: a box with a wavy end
    middle_mm: float  # from the chain's axis
    bottom_mm: float
    width_mm: float
    height_mm: float
    stated: str  # sizes that the paper states
    mass_g: float = nan

    @property
    def top_mm(self) -> float:
        """Height of its upper end."""
        return self.bottom_mm + self.height_mm


def make(_: Path) -> Product:
    """Draws the chain of Fig. 4 on the paper's wall, (a) at life size; runs no simulation."""
    case = case_of("fig4")
    set_up, particle = _set_up(case), _particle(1e3 * case.scene.chain.diameter)
    wide, tall = COLUMN_IN * MM_PER_IN, HIGH - LOW + TITLE
    figure = pyplot().figure(figsize=(COLUMN_IN, tall / MM_PER_IN))
    first = figure.add_axes((0, 0, 1, 1 - TITLE / tall))
    first.set(xlim=(LEFT, LEFT + wide), ylim=(LOW, HIGH))
    second = figure.add_axes((1 - SIDE / wide, (HIGH - SIDE - LOW) / tall, SIDE / wide, SIDE / tall))
    side = SIDE / MAGNIFICATION
    second.set(xlim=(-0.36 * side, 0.64 * side), ylim=(-side / 2, side / 2))  # the sizes on the right
    for axis, letter, pieces in ((first, "a", set_up), (second, "b", particle)):
        axis.axis("off")
        letter_panel(axis, letter)
        for piece in pieces:
            axis.add_patch(_patch(piece))
    _name_set_up(first, set_up)
    _name_particle(second, particle)
    return Product(figure, pd.DataFrame([*set_up, *particle]))


def _set_up(case: Case) -> list[Piece]:
    """Parts of (a)."""
    chain, tube, paper = case.chain, case.scene.tube, quoted()
    sensors = {sensor.from_wall for sensor in case.layout.sensors}
    pieces = []
    for body, (middle_m, radius_m) in enumerate(zip(chain.height_m, chain.sphere_radius_m, strict=True), 1):
        name = "striker" if body > chain.beads else f"sensor bead {body}" if body in sensors else f"bead {body}"
        middle, size, mass_g = 1e3 * float(middle_m), 2e3 * float(radius_m), 1e3 * float(chain.mass_kg[body - 1])
        pieces.append(Piece("a", name, "disc", 0, middle - size / 2, size, size, "both", mass_g))
        if body in sensors:
            plate = paper.sensor_gauge_side_mm, paper.sensor_gauge_thickness_mm
            pieces.append(Piece("a", "gauge", "box", 0, middle - plate[1] / 2, *plate, "both", paper.sensor_gauge_g))
    if tube:
        apart, long = 1e3 * tube.inner_diameter + TUBE_WALL, pieces[-1].top_mm + ABOVE
        pieces += [Piece("a", "tube", "box", at, 0, TUBE_WALL, long, "place") for at in (-apart / 2, apart / 2)]
    top = -paper.brass_mm - WALL_GAUGE[1]
    ends = top, top - 9, top - 9 - CUT, top - 18  # of the rod and of the cut through it
    return [
        *pieces,
        Piece("a", "brass plate", "box", 0, -paper.brass_mm, ROD, paper.brass_mm, "height"),
        Piece("a", "wall gauge", "box", 0, top, *WALL_GAUGE, "none"),
        Piece("a", "steel block", "box", 0, ends[3] + EMBEDDED - BLOCK[1], *BLOCK, "none"),
        Piece("a", "steel rod", "cut above", 0, ends[3], ROD, ends[2] - ends[3], "none"),
        Piece("a", "steel rod", "cut below", 0, ends[1], ROD, ends[0] - ends[1], "none"),
        Piece("a", "oscilloscope", "box", *SCOPE, "none"),
    ]


def _particle(size: float) -> list[Piece]:
    """Parts of (b), a particle with diameter ``size`` in mm."""
    paper = quoted()
    side, thick, cap_g = paper.sensor_gauge_side_mm, paper.sensor_gauge_thickness_mm, paper.sensor_caps_g / 2
    cap = (size - thick) / 2
    return [
        Piece("b", "cap", "cap above", 0, thick / 2, size, cap, "none", cap_g),
        Piece("b", "cap", "cap below", 0, -thick / 2 - cap, size, cap, "none", cap_g),
        Piece("b", "gauge", "box", 0, -thick / 2, side, thick, "both", paper.sensor_gauge_g),
    ]


def _patch(piece: Piece) -> Any:
    """Filled outline of a part."""
    half, low, high = piece.width_mm / 2, piece.bottom_mm, piece.top_mm
    look = {"facecolor": COLOURS.get(piece.part, BEAD)} | OUTLINE
    if piece.shape == "box":
        return Rectangle((piece.middle_mm - half, low), piece.width_mm, piece.height_mm, **look)
    if piece.shape == "disc":
        return Circle((piece.middle_mm, low + half), half, **look)
    along, sign = np.linspace(-1, 1, 61), 1 if piece.shape.endswith("above") else -1
    flat, end = (low, high) if sign > 0 else (high, low)
    if piece.shape.startswith("cap"):
        turn = along * np.arccos(abs(flat) / half)  # on a sphere around the origin
        return Polygon(np.transpose([half * np.sin(turn), sign * half * np.cos(turn)]), **look)
    edge = np.transpose([half * along, end + WAVE * np.sin(np.pi * along)])
    return Polygon([(-half, flat), *edge, (half, flat)], **look)


def _name_set_up(axis: Any, pieces: list[Piece]) -> None:
    """Draws names, leads to the oscilloscope and the arrow of the striker."""
    at = {piece.part: (piece.middle_mm, piece.bottom_mm + piece.height_mm / 2, piece.width_mm / 2) for piece in pieces}
    sensors = [part for part in at if part.startswith("sensor")]
    side = quoted().sensor_gauge_side_mm
    words = [("striker", "striker", -8.0, 0.0), ("PTFE tube", "tube", -8.0, 0.0), ("PTFE beads", "bead 14", -8.0, 0.0)]
    words += [(part.replace("bead", "in bead"), part, 8.0, 0.0) for part in sensors]
    words += [("brass plate, 1 mm", "brass plate", 8.0, 3.0), ("gauge", "wall gauge", 8.0, -1.2),
              ("steel rod (wave guide)", "steel rod", 8.0, -2.0),
              ("steel block", "steel block", 15.0, 0.0)]  # fmt: skip
    for text, part, end, up in words:
        middle, height, half = at[part]
        axis.annotate(text, (np.sign(end) * (half + abs(middle)), height), (end, height + up), va="center",
                      ha="left" if end > 0 else "right", arrowprops=LEAD)  # fmt: skip
    scope = pieces[-1]
    axis.text(scope.middle_mm, scope.bottom_mm + scope.height_mm / 2, "oscilloscope", ha="center", va="center")
    for part, half, aside in (*((part, side / 2, 4.0) for part in sensors), ("wall gauge", WALL_GAUGE[0] / 2, -4.0)):
        height, to = at[part][1], scope.middle_mm + aside
        edge = scope.top_mm if height > scope.top_mm else scope.bottom_mm
        axis.plot([-half, to, to], [height, height, edge], color="black", lw=0.6)
    axis.annotate("", (0, at["striker"][1] + 3.2), (0, HIGH), arrowprops={"arrowstyle": "-|>", "color": "black"})


def _name_particle(axis: Any, pieces: list[Piece]) -> None:
    """Draws names with masses, and the stated sizes of the plate."""
    paper, upper, plate = quoted(), pieces[0], pieces[-1]
    half, thick, radius = plate.width_mm / 2, plate.height_mm / 2, upper.width_mm / 2
    axis.text(0, upper.top_mm + 0.25, f"PTFE caps, $2M$ = {paper.sensor_caps_g:g} g", ha="center", va="bottom")
    axis.text(0, -upper.top_mm - 0.25, f"gauge, $m$ = {paper.sensor_gauge_g:g} g", ha="center", va="top")
    for sign in (-1, 1):
        axis.text(0, sign * 1.35, "$M$", ha="center", va="center")
        axis.plot([-half, -radius - 0.2], [0.2 * sign * thick] * 2, color="black", lw=0.6)  # a lead of the gauge
        axis.plot([radius + 0.1, radius + 0.5], [sign * thick] * 2, color=GREY, lw=0.5)
        tip, tail = (radius + 0.3, sign * thick), (radius + 0.3, sign * (thick + 0.5))
        axis.annotate("", tip, tail, arrowprops=DIMENSION | {"arrowstyle": "-|>"})
    axis.text(radius + 0.6, 0, f"{plate.height_mm:g} mm", va="center")
    axis.annotate("", (-half, thick + 0.2), (half, thick + 0.2), arrowprops=DIMENSION | {"arrowstyle": "<|-|>"})
    axis.text(0, thick + 0.25, f"{plate.width_mm:g} mm", ha="center", va="bottom")
