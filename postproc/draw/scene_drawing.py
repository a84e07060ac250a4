"""A scene drawn to scale: wall, tube, beads, sensors, striker.

Long rows of equal beads, wide gaps, and very long strikers and tubes are cut. A label at each cut names the missing
part. All drawn parts are to scale.
"""

from dataclasses import dataclass
from math import inf, pi
from textwrap import fill
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.patches import Circle, Rectangle
from matplotlib.text import Annotation, Text
from matplotlib.transforms import Affine2D

from drivers.chain.chain import Array, Chain, ordinary_beads
from drivers.scene.model import RIGID, Scene
from postproc.draw.style import COLUMN_IN, GREY, pyplot

MAX_BEADS = 60  # in a drawing without a cut
ENDS, AROUND, SPECIAL = 8, 2, 8  # beads of a longer chain: at each end, next to special beads; number of special beads
WIDE_GAP, LONGEST_STRIKER, WIDEST_TUBE = 6.0, 4.0, 5.0  # in diameters of the neighbouring beads
MAX_HEIGHT_IN = 7.0
WRAP = 26  # characters per line of a label
BEAD, SENSOR, PLATE, OTHER, STRIKER = "#f2f2f2", "#e69f00", "#7f4f00", "#bfe3d5", "#cfe3f2"
MEMBERS = (BEAD, "#bdbdbd", "#e3d5ea", "#969696")  # of a pattern, in turn
WALL, TUBE = "#c9b27c", "#dddddd"
OUTLINE: dict[str, Any] = {"edgecolor": "black", "lw": 0.6}


@dataclass(frozen=True)
class Sketch:
    """Drawn bodies and cuts, in metres from the axis of the chain."""

    bodies: list[int]  # indices of the drawn bodies
    height_m: Array  # drawn heights, valid for those in ``bodies``. Shape (all bodies,)
    radius_m: Array  # 0 for a flat striker. Shape (bodies,)
    cuts: list[tuple[float, str]]  # drawn heights of cuts, and names of the missing parts
    special: dict[int, str]  # labels of sensors and of beads that differ from the others, by index
    widest_m: float  # the largest diameter drawn
    flat_m: tuple[float, float]  # drawn width and length of a flat striker, else 0, 0
    low_m: float  # lower end of the picture
    high_m: float  # upper end of the picture


def draw_scene(scene: Scene, chain: Chain) -> tuple[Any, pd.DataFrame]:
    """Figure of the apparatus at time 0, and a table with a row per drawn body."""
    sketch, striker = _sketch(scene, chain), scene.striker
    height = sketch.high_m - sketch.low_m
    scale_in = min(MAX_HEIGHT_IN / height, 0.3 * COLUMN_IN / sketch.widest_m)
    figure, axis = pyplot().subplots(figsize=(COLUMN_IN, max(scale_in * height, 1.0)))
    figure.subplots_adjust(left=0, right=1, bottom=0, top=1)
    half = COLUMN_IN / scale_in / 2
    axis.set(xlim=(-0.8 * half, 1.2 * half), ylim=(sketch.low_m, sketch.high_m), aspect="equal")
    axis.axis("off")
    beads = [i for i in sketch.bodies if i < chain.beads]
    top = max((sketch.height_m[i] + sketch.radius_m[i] for i in beads), default=chain.wall_height_m)
    lines = [_tube(axis, scene, chain, float(top), sketch)] if scene.tube else []
    if chain.wall:
        foot, wide = chain.wall_height_m - sketch.low_m, 2.4 * sketch.widest_m
        axis.add_patch(Rectangle((-wide / 2, sketch.low_m), wide, foot, facecolor=WALL, hatch="////", **OUTLINE))
        named = "rigid wall" if chain.wall == RIGID else f"wall of {chain.wall}"
        axis.text(1.4 * sketch.widest_m, chain.wall_height_m - foot / 2, fill(named, WRAP), va="center")
    sensors, below = {from_wall - 1 for from_wall in scene.chain.sensor_at}, -inf
    for i in beads:
        radius, at = sketch.radius_m[i], sketch.height_m[i]
        plain = OTHER if i in sketch.special else MEMBERS[i % len(scene.chain.members) % len(MEMBERS)]
        colour = SENSOR if i in sensors else plain
        axis.add_patch(Circle((0, at), radius, facecolor=colour, **OUTLINE))
        if i in sensors:
            axis.add_patch(Rectangle((-0.95 * radius, at - 0.1 * radius), 1.9 * radius, 0.2 * radius, color=PLATE))
        if chain.drive is not None and i == chain.drive.body:
            ends = (0, at - 0.8 * radius), (0, at + 0.8 * radius)
            axis.annotate("", *ends, arrowprops={"arrowstyle": "<|-|>", "color": "black", "lw": 0.8})
        if i in sketch.special:
            label = fill(sketch.special[i], WRAP)
            below = max(at, below + 0.022 * height * (label.count("\n") + 1))  # labels do not overlap
            axis.annotate(label, (radius, at), (0.75 * sketch.widest_m, below), va="center",
                          arrowprops={"arrowstyle": "-", "lw": 0.5, "color": GREY})  # fmt: skip
    for height_m, left_out in sketch.cuts:
        axis.text(0, height_m, "⋮", ha="center", va="center")
        axis.text(0.75 * sketch.widest_m, height_m, left_out, va="center", color=GREY)
    if striker is not None:
        look, at = {"facecolor": STRIKER} | OUTLINE, float(sketch.height_m[-1])
        if striker.diameter is None:
            width, long = sketch.flat_m
            axis.add_patch(Rectangle((-width / 2, at), width, long, **look))
            shape, centre, end = f"flat striker of {striker.material}", at + long / 2, at + long
        else:
            axis.add_patch(Circle((0, at), striker.diameter / 2, **look))
            shape = f"striker of {striker.material}, ⌀ {_mm(striker.diameter)}"
            centre, end = at, at + striker.diameter / 2
        label = f"{fill(shape, WRAP)}\n{1e3 * chain.mass_kg[-1]:.4g} g at {striker.speed:.4g} m/s"
        axis.text(0.75 * sketch.widest_m, centre, label, va="center")
        arrow = {"arrowstyle": "-|>", "color": "black"}
        axis.annotate("", (0, end + 0.1 * (sketch.high_m - end)), (0, sketch.high_m), arrowprops=arrow)
    if chain.beads:
        lines = [*_beads(scene), *lines]
    if lines:
        middle = (sketch.high_m + chain.wall_height_m) / 2
        text = "\n".join(fill(line, 20) for line in "\n".join(lines).split("\n"))
        axis.text(-0.75 * sketch.widest_m, middle, text, ha="right", va="center")
    longest = min(0.3 * half, 0.5 * height)  # of the scale bar, at the left above the wall
    decade = 10 ** np.floor(np.log10(longest))
    length = decade * max(step for step in (1, 2, 5) if step * decade <= longest)
    left, base = -0.78 * half, (chain.wall_height_m if chain.wall else sketch.low_m) + 0.02 * height
    axis.plot([left, left + length], [base, base], color="black", lw=1.5, solid_capstyle="butt")
    axis.text(left, base + 0.008 * height, _mm(length), ha="left", va="bottom")
    if scene.chain.angle:
        _lean(figure, axis, scene)
    drawn = sketch.bodies
    return figure, pd.DataFrame({
        "body": [i + 1 for i in drawn],
        "role": ["striker" if i >= chain.beads else "sensor" if i in sensors else "bead" for i in drawn],
        "material": [chain.materials[i] for i in drawn],
        "height_m": chain.height_m[drawn], "drawn_height_m": sketch.height_m[drawn],
        "diameter_m": np.where(np.isinf(chain.radius_m[drawn]), np.nan, 2 * chain.radius_m[drawn]),
        "mass_kg": chain.mass_kg[drawn], "velocity_m_s": chain.velocity_m_s[drawn],
    })  # fmt: skip


def _beads(scene: Scene) -> list[str]:
    """Lines of the label of the beads: material, diameter and mass of each member of the pattern."""
    materials, diameter_m, mass_kg = ordinary_beads(scene)
    count, period = scene.chain.count, len(scene.chain.members)
    counted = f"{count} {'beads' if count > 1 else 'bead'}"
    lines = [f"{counted} in turn:"] if period > 1 else []
    for first in range(period):
        ends = first, first + (count - 1 - first) // period * period  # they differ in a taper
        sizes = dict.fromkeys(_mm(float(diameter_m[i])) for i in ends)
        masses = dict.fromkeys(f"{1e3 * mass_kg[i]:.4g}" for i in ends)
        lines.append(materials[first] if period > 1 else f"{counted} of {materials[first]}")
        lines += [f"⌀ {' to '.join(sizes)}", f"{' to '.join(masses)} g each"]
    return lines


def _lean(figure: Any, axis: Any, scene: Scene) -> None:
    """Turns the picture by the angle of the chain, to the left, with an arrow along gravity."""
    angle_deg = scene.chain.angle or 0.0
    (left, right), (low, high) = axis.get_xlim(), axis.get_ylim()
    turn = Affine2D().rotate_deg(angle_deg)
    for artist in [*axis.patches, *axis.lines, *axis.texts]:
        if isinstance(artist, Text):
            artist.set(rotation=angle_deg, rotation_mode="anchor", transform_rotates_text=False)
        artist.set_transform(turn + axis.transData)
        if isinstance(artist, Annotation):
            artist.xycoords = artist.anncoords = turn + axis.transData
    corners = turn.transform([(x, y) for x in (left, right) for y in (low, high)])
    (x_low, y_low), (x_high, y_high) = corners.min(axis=0), corners.max(axis=0)
    axis.set(xlim=(x_low, x_high), ylim=(y_low, y_high))
    scale_in = figure.get_figwidth() / (right - left)
    figure.set_size_inches(scale_in * (x_high - x_low), scale_in * (y_high - y_low))
    if scene.gravity:
        size = {"xycoords": "axes fraction", "textcoords": "axes fraction", "ha": "center", "va": "bottom"}
        axis.annotate("g", (0.95, 0.80), (0.95, 0.95), arrowprops={"arrowstyle": "-|>", "color": "black"}, **size)


def _sketch(scene: Scene, chain: Chain) -> Sketch:
    texts = {from_wall - 1: ["sensor"] for from_wall in scene.chain.sensor_at}
    for from_wall, odd in scene.chain.bead_at.items():
        said = texts.setdefault(from_wall - 1, [])
        said += [odd.material] if odd.material else []
        said += [f"⌀ {_mm(odd.diameter)}"] if odd.diameter else []
        said += [f"{odd.velocity:+.3g} m/s"] if odd.velocity else []
        said += [f"gap of {_mm(odd.gap_below)} below"] if odd.gap_below else []
    if scene.drive is not None and chain.drive is not None and chain.drive.body < chain.beads:
        what = "displacement" if scene.drive.prescribed else "force"
        texts.setdefault(chain.drive.body, []).append(f"driven by a {what} ({scene.drive.form})")
    special = {i: f"bead {i + 1}: {', '.join([*said, f'{1e3 * chain.mass_kg[i]:.4g} g'])}" for i, said in texts.items()}
    kept = set(range(chain.bodies))
    if chain.beads > MAX_BEADS:
        near = {j for i in sorted(special)[:SPECIAL] for j in range(i - AROUND, i + AROUND + 1)}
        kept &= set(range(ENDS)) | set(range(chain.beads - ENDS, chain.bodies)) | near
    bodies = sorted(kept)
    radius = chain.sphere_radius_m
    height, cuts = _closed_up(chain, bodies, special)
    flat = flat_size(scene)
    bead = max((2 * float(radius[i]) for i in bodies), default=0.0)
    widest = max(bead, flat[0])
    if scene.tube is not None and scene.tube.inner_diameter <= WIDEST_TUBE * widest:
        widest = max(widest, 1.4 * scene.tube.inner_diameter)
    tops = [height[i] + radius[i] for i in bodies]
    top = max(tops, default=chain.wall_height_m) + flat[1]
    foot = 1.5 * min(widest, 0.2 * (top - chain.wall_height_m) + 0.3 * widest) if chain.wall else 0.3 * widest
    margin = 1.2 * min(widest, scene.chain.diameter) if scene.striker is not None else 0.3 * widest
    return Sketch(
        bodies, height, radius, cuts, special, widest, flat, float(chain.wall_height_m - foot), float(top + margin)
    )


def _closed_up(chain: Chain, bodies: list[int], special: dict[int, str]) -> tuple[Array, list[tuple[float, str]]]:
    """Heights with cut rows of beads and wide gaps closed up, and the cuts."""
    height, radius, cuts, shift = chain.height_m.copy(), chain.sphere_radius_m, [], 0.0
    for before, body in zip([-1, *bodies], bodies, strict=False):
        floor = height[before] + radius[before] if before >= 0 else chain.wall_height_m
        gap = chain.height_m[body] - shift - radius[body] - floor
        near = 2 * max(radius[before] if before >= 0 else 0.0, radius[body])
        left_out = body - before - 1
        if left_out or gap > WIDE_GAP * near:
            room = 2 * near
            shift += gap - room
            hidden = sum(before < i < body for i in special)
            missing = f"{left_out} beads" if left_out else f"{_mm(gap)} apart"
            missing += f", {hidden} of them special" if hidden else ""
            cuts.append((float(floor + room / 2), missing))
        height[body] = chain.height_m[body] - shift
    return height, cuts


def flat_size(scene: Scene) -> tuple[float, float]:
    """Drawn width and length of a flat striker: the diameter of a bead, and the length for its mass, up to a limit."""
    if scene.striker is None or scene.striker.diameter is not None:
        return 0.0, 0.0
    width = scene.chain.diameter
    density, mass = scene.materials[scene.striker.material].density, scene.striker.mass
    length = mass / (density * pi / 4 * width**2) if density and mass else width
    return width, min(max(length, 0.2 * width), LONGEST_STRIKER * width)


def _tube(axis: Any, scene: Scene, chain: Chain, beads_top: float, sketch: Sketch) -> str:
    """Draws the tube within the picture; returns its label."""
    tube = scene.tube
    assert tube is not None
    inner, label = tube.inner_diameter, f"{tube.material} tube,\ninner ⌀ {_mm(tube.inner_diameter)}"
    if inner > WIDEST_TUBE * max(2 * float(sketch.radius_m[i]) for i in sketch.bodies):
        return f"{label}\n(outside the picture)"
    striker = scene.striker
    top = beads_top + (inner if striker is not None and (striker.diameter or 0) < inner else 0)
    if tube.top is not None:
        top = tube.top
        label += f"\nup to {_mm(tube.top)}"
    top = min(top, sketch.high_m)
    for side in (-1.2 * inner / 2, inner / 2):
        size = (0.1 * inner, max(top - chain.wall_height_m, 0.0))
        axis.add_patch(Rectangle((side, chain.wall_height_m), *size, facecolor=TUBE, edgecolor=GREY, lw=0.4))
    return label


def _mm(length_m: float) -> str:
    """Text of a length in µm, mm or m."""
    if length_m and abs(length_m) < 1e-4:
        return f"{1e6 * length_m:.4g} µm"
    return f"{1e3 * length_m:.4g} mm" if abs(length_m) < 1 else f"{length_m:.4g} m"
