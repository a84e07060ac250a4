"""Chains drawn to scale: a scene at time 0 with its wall, tube, sensors and striker, and a wave as a film.

In a scene long rows of equal beads, wide gaps and very long strikers are cut. A label at each cut names the missing
part. All drawn parts are to scale. A chain that leans is drawn upright; an arrow shows the direction of gravity.

A film is a contact sheet of the chain at several times, and an animation.
"""

from math import cos, inf, pi, radians, sin
from pathlib import Path
from textwrap import fill
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.cm import ScalarMappable
from matplotlib.collections import EllipseCollection
from matplotlib.colors import PowerNorm
from matplotlib.patches import Rectangle
from matplotlib.ticker import EngFormatter
from PIL import Image

from drivers.base.files import whole_file
from drivers.chain.case import Case
from drivers.chain.chain import Array, Chain, ordinary_beads
from drivers.chain.trace import Trace
from drivers.scene.model import RIGID, Scene, Tube
from postproc.draw.plot import COLUMN_IN, GAMMA, GREY, MICRO, OPEN_SHARE, Product, colour_map, finish_bar, pyplot
from postproc.read.motion import spread
from postproc.read.signals import mean_forces

MAX_BEADS = 60  # in a drawing without a cut
ENDS, AROUND, SPECIAL = 8, 2, 8  # beads of a longer chain: at each end, next to special beads; number of special beads
WIDE_GAP, LONGEST_STRIKER = 6.0, 4.0  # in diameters of the neighbouring beads
MAX_HEIGHT_IN = 7.0
WRAP, NARROW = 26, 20  # characters per line of a label, and of those at the left
BEAD, SENSOR, PLATE, OTHER, STRIKER = "#f2f2f2", "#e69f00", "#7f4f00", "#bfe3d5", "#cfe3f2"
MEMBERS = (BEAD, "#bdbdbd", "#e3d5ea", "#969696")  # of a pattern, in turn
WALL, TUBE = "#c9b27c", "#dddddd"
OUTLINE: dict[str, Any] = {"edgecolor": "black", "lw": 0.6}
_mm = EngFormatter("m")
ARROW: dict[str, Any] = {"arrowstyle": "-|>", "color": "black"}
FRAMES, GIF_FRAMES = 12, 80
SHEET_IN, MIN_SHEET_IN = (6.4, 5.2), 1.2  # of a contact sheet: width, largest and smallest height
BEAD_IN = 0.025  # smallest drawn diameter of a bead; a smaller bead becomes a line as thick as this
BAND_IN = 0.15  # length of such a line
EDGE: dict[str, Any] = {"edgecolor": "#777777", "lw": 0.4}
GIF_IN, FILM_DPI, FILM_PER_S = (3.9, 4.8), 80, 12  # of the animation


def draw_scene(scene: Scene, chain: Chain) -> tuple[Any, pd.DataFrame]:
    """Figure of the apparatus at time 0, and a table with a row per drawn body."""
    special = _special(scene, chain)
    kept = set(range(chain.bodies))
    if chain.beads > MAX_BEADS:
        near = {j for i in sorted(special)[:SPECIAL] for j in range(i - AROUND, i + AROUND + 1)}
        kept &= set(range(ENDS)) | set(range(chain.beads - ENDS, chain.bodies)) | near
    drawn = sorted(kept)
    radius, flat, tube, wall_m = chain.sphere_radius_m, flat_size(scene), scene.tube, chain.wall_height_m
    height, cuts = _closed_up(chain, drawn)
    widest = max(2 * radius[drawn].max(initial=0.0), flat[0])
    if tube is not None:
        widest = max(widest, 1.4 * tube.inner_diameter)
    top = (height + radius)[drawn].max(initial=wall_m) + flat[1]
    low = wall_m - (1.5 * min(widest, 0.2 * (top - wall_m) + 0.3 * widest) if chain.wall else 0.3 * widest)
    high = top + (1.2 * min(widest, scene.chain.diameter) if scene.striker is not None else 0.3 * widest)
    tall, beside = high - low, 0.75 * widest
    scale_in = min(MAX_HEIGHT_IN / tall, 0.3 * COLUMN_IN / widest)
    figure, axis = pyplot().subplots(figsize=(COLUMN_IN, max(scale_in * tall, 1.0)))
    figure.subplots_adjust(left=0, right=1, bottom=0, top=1)
    half = COLUMN_IN / scale_in / 2
    axis.set(xlim=(-0.8 * half, 1.2 * half), ylim=(low, high), aspect="equal")
    axis.axis("off")

    beads, sensors = [i for i in drawn if i < chain.beads], {place - 1 for place in scene.chain.sensor_at}
    labels = _beads(scene) if chain.beads else []
    if tube is not None:
        labels += [f"{tube.material} tube,", f"inner ⌀ {_mm(tube.inner_diameter)}"]
        labels += [f"up to {_mm(tube.top)}"] if tube.top is not None else []
        draw_tube(axis, tube, tube.inner_diameter / 2, wall_m, high)
    if chain.wall:
        axis.add_patch(Rectangle((-1.2 * widest, low), 2.4 * widest, wall_m - low, fc=WALL, hatch="////", **OUTLINE))
        named = "rigid wall" if chain.wall == RIGID else f"wall of {chain.wall}"
        axis.text(1.4 * widest, (wall_m + low) / 2, fill(named, WRAP), va="center")
    members = scene.chain.members
    plain = [MEMBERS[i % len(members) % len(MEMBERS)] if i < chain.beads else STRIKER for i in range(chain.bodies)]
    colours = [SENSOR if i in sensors else OTHER if i in special else plain[i] for i in drawn]
    place = np.column_stack([np.zeros(len(drawn)), height[drawn]])
    draw_bodies(axis, place, radius[drawn], flat, np.array(colours), **OUTLINE)
    below = -inf
    for i in beads:
        if i in sensors:
            corner = -0.95 * radius[i], height[i] - 0.1 * radius[i]
            axis.add_patch(Rectangle(corner, 1.9 * radius[i], 0.2 * radius[i], color=PLATE))
        if chain.drive is not None and i == chain.drive.body:
            ends = ((0, height[i] + side * radius[i]) for side in (-0.8, 0.8))
            axis.annotate("", *ends, arrowprops=ARROW | {"arrowstyle": "<|-|>", "lw": 0.8})
        if i in special:
            label = fill(special[i], WRAP)
            below = max(height[i], below + 0.022 * tall * (label.count("\n") + 1))  # labels do not overlap
            axis.annotate(label, (radius[i], height[i]), (beside, below), va="center",
                          arrowprops={"arrowstyle": "-", "lw": 0.5, "color": GREY})  # fmt: skip
    for height_m, left_out in cuts:
        axis.text(0, height_m, "⋮", ha="center", va="center")
        axis.text(beside, height_m, left_out, va="center", color=GREY)
    if striker := scene.striker:
        size = f", ⌀ {_mm(striker.diameter)}" if striker.diameter else ""
        shape = f"{'' if size else 'flat '}striker of {striker.material}{size}"
        label = f"{fill(shape, WRAP)}\n{1e3 * chain.mass_kg[-1]:.4g} g at {striker.speed:.4g} m/s"
        axis.text(beside, height[-1] + flat[1] / 2, label, va="center")
        end = height[-1] + radius[-1] + flat[1]
        axis.annotate("", (0, end + 0.1 * (high - end)), (0, high), arrowprops=ARROW)
    text = "\n".join(fill(line, NARROW) for line in labels)
    axis.text(-beside, (high + wall_m) / 2, text, ha="right", va="center")
    base, longest = (wall_m if chain.wall else low) + 0.02 * tall, min(0.3 * half, 0.5 * tall)
    length = max(size for size in np.outer(10.0 ** np.arange(-9, 3), (1, 2, 5)).flat if size <= longest)
    axis.plot([-0.78 * half, -0.78 * half + length], [base, base], color="black", lw=1.5, solid_capstyle="butt")
    axis.annotate(_mm(length), (-0.78 * half, base), (0, 4), textcoords="offset points")
    if scene.chain.angle and scene.gravity:
        angle, tail = radians(scene.chain.angle), np.array([0.95 * half, high - 0.05 * tall])
        tip = tail - 0.3 * half * np.array([sin(angle), cos(angle)])
        axis.annotate("g", tip, tail, ha="center", arrowprops=ARROW | {"relpos": (0.5, 0.0)})
    return figure, pd.DataFrame({
        "body": [i + 1 for i in drawn],
        "role": ["striker" if i >= chain.beads else "sensor" if i in sensors else "bead" for i in drawn],
        "material": [chain.materials[i] for i in drawn],
        "height_m": chain.height_m[drawn], "drawn_height_m": height[drawn],
        "diameter_m": np.where(np.isinf(chain.radius_m[drawn]), np.nan, 2 * chain.radius_m[drawn]),
        "mass_kg": chain.mass_kg[drawn], "velocity_m_s": chain.velocity_m_s[drawn],
    })  # fmt: skip


def draw_bodies(
    axis: Any, place_m: Array, radius_m: Array, flat_m: tuple[float, float], colours: Any, **look: Any
) -> None:
    """Draws spheres and a flat striker, the last body, to the scale of the axes.

    Args:
        axis: Axes.
        place_m: Centres across and along the chain, of a flat striker its face. Shape (bodies, 2).
        radius_m: 0 for a flat striker. Shape (bodies,).
        flat_m: Width and length of a flat striker, else 0, 0.
        colours: Colours of the bodies.
        look: Keywords of their outlines.
    """
    for radius in np.unique(radius_m[radius_m > 0]):  # spheres of one size together, for a small file
        alike, size = radius_m == radius, (2 * radius,)
        spheres = EllipseCollection(size, size, (0,), units="xy", offsets=place_m[alike], facecolors=colours[alike],
                                    offset_transform=axis.transData, zorder=1, **look)  # fmt: skip
        axis.add_collection(spheres, autolim=False)
    if flat_m[0]:
        corner = (place_m[-1, 0] - flat_m[0] / 2, place_m[-1, 1])
        axis.add_patch(Rectangle(corner, *flat_m, facecolor=colours[-1], **look))


def draw_tube(axis: Any, tube: Tube, bore_m: float, low_m: float, high_m: float, middle_m: float = 0.0) -> None:
    """Draws both sides of a tube around a vertical line from its bore outwards, up to its top or ``high_m``."""
    height_m = max(min(high_m if tube.top is None else tube.top, high_m) - low_m, 0.0)
    for side_m in (-1.2 * bore_m, bore_m):
        corner = middle_m + side_m, low_m
        axis.add_patch(Rectangle(corner, 0.2 * bore_m, height_m, facecolor=TUBE, edgecolor=GREY, lw=0.4, zorder=0))


def _beads(scene: Scene) -> list[str]:
    """Lines of the label of the beads: material, diameter and mass of each member of the pattern."""
    materials, diameter_m, mass_kg = ordinary_beads(scene)
    count, period = scene.chain.count, len(scene.chain.members)
    lines = [f"{count} {'beads' if count > 1 else 'bead'}{' in turn' if period > 1 else ''}:"]
    for first in range(period):
        ends = first, first + (count - 1 - first) // period * period  # they differ in a taper
        sizes = dict.fromkeys(_mm(float(diameter_m[i])) for i in ends)
        masses = dict.fromkeys(f"{1e3 * mass_kg[i]:.4g}" for i in ends)
        lines += [materials[first], f"⌀ {' to '.join(sizes)}", f"{' to '.join(masses)} g each"]
    return lines


def _special(scene: Scene, chain: Chain) -> dict[int, str]:
    """Labels of sensors and of beads that differ from the others, by index."""
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
    return {i: f"bead {i + 1}: {', '.join([*said, f'{1e3 * chain.mass_kg[i]:.4g} g'])}" for i, said in texts.items()}


def _closed_up(chain: Chain, bodies: list[int]) -> tuple[Array, list[tuple[float, str]]]:
    """Heights with cut rows of beads and wide gaps closed up; drawn heights of the cuts, and the missing parts."""
    height, radius, cuts, shift = chain.height_m.copy(), chain.sphere_radius_m, [], 0.0
    before, floor, near = -1, chain.wall_height_m, 0.0
    for body in bodies:
        gap, room = chain.height_m[body] - shift - radius[body] - floor, 4 * max(near, radius[body])
        left_out = body - before - 1
        if left_out or gap > WIDE_GAP / 2 * room:
            shift += gap - room
            missing = f"{left_out} beads" if left_out else f"{_mm(gap)} apart"
            cuts.append((float(floor + room / 2), missing))
        height[body] = chain.height_m[body] - shift
        before, floor, near = body, height[body] + radius[body], radius[body]
    return height, cuts


def flat_size(scene: Scene) -> tuple[float, float]:
    """Drawn width and length of a flat striker: the diameter of a bead, and the length for its mass, up to a limit."""
    if scene.striker is None or scene.striker.diameter is not None:
        return 0.0, 0.0
    width = scene.chain.diameter
    density, mass = scene.materials[scene.striker.material].density, scene.striker.mass
    length = mass / (density * pi / 4 * width**2) if density and mass else width
    return width, min(max(length, 0.2 * width), LONGEST_STRIKER * width)


class Film:
    """A chain at ``frames`` times, evenly spread; without positions the bodies stay where they were at time 0.

    Displacements from the axis are multiplied by ``sideways``. ``notes`` are differences between the picture and the
    run.
    """

    def __init__(self, case: Case, trace: Trace, frames: int, sideways: float = 1.0) -> None:
        scene, chain, chosen = case.scene, case.chain, spread(len(trace.time_s), frames)
        where, self.notes = np.broadcast_to(chain.place_m, (len(chosen), chain.bodies, 3)), list[str]()
        if trace.height_m is not None:
            where = trace.place_m[chosen]
        else:
            self.notes.append("positions of time 0: the run kept no others")
        if sideways != 1:
            self.notes.append(f"sideways displacements {sideways:g} times as large")
        if scene.chain.angle:
            self.notes.append(f"upright in the picture: the chain leans by {scene.chain.angle:g} deg")
        self.time_s = trace.time_s[chosen]  # shape (frames,)
        # exaggerated x and height of each body, seen along y. Shape (frames, bodies, 2)
        self.place_m = np.stack([sideways * where[..., 0], where[..., 2]], axis=-1)
        force = mean_forces(trace.force_N)
        self.force_N = force[chosen]  # mean of the contact forces below and above each body. Shape (frames, bodies)
        self.largest_N = float(force.max(initial=0.0)) or 1.0  # of the whole run
        self.radius_m, self.flat_m = chain.sphere_radius_m, flat_size(scene)
        low, high = self.place_m[..., 1] - self.radius_m, self.place_m[..., 1] + self.radius_m
        self.wall_m = chain.wall_height_m if chain.wall else None
        self.low_m, self.high_m = min(float(low.min()), chain.wall_height_m), float(high.max()) + self.flat_m[1]
        size, self.tube = scene.chain.diameter, scene.tube
        # half the drawn width of the tube: beads touch the bore in the picture when they do in the run
        self.bore_m = (size + sideways * (scene.tube.inner_diameter - size)) / 2 if scene.tube else 0.0
        # half of the width of all bodies
        reach = float((np.abs(self.place_m[..., 0]) + self.radius_m).max(initial=self.flat_m[0] / 2))
        self.half_m = max(reach, 1.1 * self.bore_m)


def sheet(film: Film, title: str) -> Product:
    """Contact sheet: the chain at each time side by side, to scale, coloured by force."""
    count, tall, lines = len(film.time_s), film.high_m - film.low_m, [title, *film.notes]
    scale_in = min(SHEET_IN[1] / tall, SHEET_IN[0] / count / (2.5 * film.half_m))
    height_in, pitch = max(scale_in * tall, MIN_SHEET_IN) + 0.1, SHEET_IN[0] / count / scale_in
    size = (SHEET_IN[0] + 0.9, height_in + 0.4 + 0.15 * len(lines))
    figure, axis = pyplot().subplots(figsize=size, layout="constrained")
    axis.set(xlim=(-pitch / 2, (count - 0.5) * pitch), ylim=_around(film, height_in / scale_in), yticks=[])
    axis.set_aspect("equal")
    axis.set_xticks(pitch * np.arange(count), [f"{time_s * MICRO:.0f} µs" for time_s in film.time_s], fontsize=7)
    axis.tick_params(length=0)
    axis.grid(visible=False)
    axis.spines[:].set_visible(False)
    axis.set_title("\n".join(lines), loc="left")
    for i in range(count):
        _draw_chain(axis, film, i, i * pitch, scale_in)
    bar = figure.colorbar(_colours(film), ax=axis, pad=0.01, aspect=20, anchor=(0, 0), shrink=min(2 / height_in, 1))
    finish_bar(bar, "mean of the contact forces (N),\nsquare-root scale; grey: none")
    bodies = film.force_N.shape[1]
    return Product(figure, pd.DataFrame({
        "time_s": np.repeat(film.time_s, bodies), "body": np.tile(np.arange(1, bodies + 1), count),
        "height_m": film.place_m[..., 1].ravel(), "force_N": film.force_N.ravel(),
    }))  # fmt: skip


def write_animation(film: Film, title: str, path: Path) -> Path:
    """Writes the film as an animated GIF, whole or not at all: the chain next to its forces."""
    plt, tall, look = pyplot(), film.high_m - film.low_m, {"dpi": FILM_DPI, "layout": "constrained"}
    figure, (axis, beside) = plt.subplots(1, 2, figsize=GIF_IN, width_ratios=(1.3, 2.3), **look)
    figure.suptitle(fill("; ".join([title, *film.notes]), 54), x=0.03, ha="left")
    scale_in = min((GIF_IN[1] - 1.1) / tall, 1.3 / (2.2 * film.half_m))
    height, width = (GIF_IN[1] - 1.0) / scale_in, 1.3 / scale_in
    beside.set(xlim=(0, 1.05 * film.largest_N), ylim=_around(film, height), yticks=[])
    beside.set(xlabel="mean of the contact forces (N)")
    line = beside.plot([], [], color=GREY, lw=0.8, marker="o" if _circles(film, scale_in) else "", ms=2.5)[0]
    axis.axis("off")
    axis.set(xlim=(-width / 2, width / 2), ylim=_around(film, height), aspect="equal")
    images = []
    for i, time_s in enumerate(film.time_s):
        for artist in (*axis.patches, *axis.collections):
            artist.remove()
        _draw_chain(axis, film, i, 0.0, scale_in)
        line.set_data(film.force_N[i], film.place_m[i, :, 1])
        beside.set_title(f"{time_s * MICRO:.0f} µs", loc="left")
        figure.canvas.draw()
        figure.set_layout_engine("none")  # that of the first picture is kept
        images.append(Image.fromarray(np.asarray(figure.canvas.buffer_rgba())).convert("RGB"))
    plt.close(figure)
    path.parent.mkdir(parents=True, exist_ok=True)
    with whole_file(path) as draft:
        images[0].save(draft, "GIF", save_all=True, append_images=images[1:], duration=1000 // FILM_PER_S, loop=0)
    return path


def _around(film: Film, range_m: float) -> tuple[float, float]:
    """Ends of a range of heights centred on the chain."""
    middle = (film.low_m + film.high_m) / 2
    return middle - range_m / 2, middle + range_m / 2


def _circles(film: Film, scale_in: float) -> bool:
    """True if beads are large enough on paper to be drawn one by one."""
    return bool(2 * np.median(film.radius_m) * scale_in >= BEAD_IN)


def _colours(film: Film) -> ScalarMappable:
    return ScalarMappable(PowerNorm(GAMMA, 0, film.largest_N), colour_map("force"))


def _draw_chain(axis: Any, film: Film, frame: int, middle: float, scale_in: float) -> None:
    """Draws the chain at one time around a vertical line."""
    width, place, force_N = 2 * film.half_m, film.place_m[frame] + (middle, 0.0), film.force_N[frame]
    colours = _colours(film).to_rgba(np.ma.masked_less_equal(force_N, OPEN_SHARE * film.largest_N))
    if film.wall_m is not None:
        thick = 0.05 / scale_in
        axis.add_patch(Rectangle((middle - width / 2, film.wall_m - thick), width, thick, color=WALL, lw=0))
    if _circles(film, scale_in):
        if film.tube is not None and film.wall_m is not None:
            draw_tube(axis, film.tube, film.bore_m, film.wall_m, film.high_m, middle)
        draw_bodies(axis, place, film.radius_m, film.flat_m, colours, **EDGE)
    else:
        order = np.argsort(force_N)  # the largest forces are drawn last
        look = {"c": colours[order], "s": (72 * BAND_IN) ** 2, "lw": 72 * BEAD_IN}
        axis.scatter(*place[order].T, marker="_", rasterized=True, **look)
