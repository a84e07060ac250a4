"""A wave in a chain: a contact sheet of the chain at several times, and an animation."""

from pathlib import Path
from textwrap import fill
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from matplotlib.cm import ScalarMappable
from matplotlib.colors import PowerNorm
from matplotlib.patches import Rectangle
from PIL import Image

from drivers.base.files import whole_file
from drivers.chain.case import Case
from drivers.chain.chain import Array
from drivers.chain.trace import Trace
from postproc.draw.product import GAMMA, OPEN_SHARE, Product
from postproc.draw.scene_drawing import WALL, draw_bodies, draw_tube, flat_size
from postproc.draw.style import GREY, MICRO, colour_map, finish_bar, pyplot
from postproc.read.motion import spread
from postproc.read.signals import mean_forces

FRAMES, GIF_FRAMES = 12, 80
WIDTH_IN, MAX_HEIGHT_IN, MIN_HEIGHT_IN = 6.4, 5.2, 1.2
BEAD_IN = 0.025  # smallest drawn diameter of a bead; a smaller bead becomes a line as thick as this
BAND_IN = 0.15  # length of such a line
EDGE: dict[str, Any] = {"edgecolor": "#777777", "lw": 0.4}
GIF_IN, FILM_DPI, FILM_PER_S = (3.9, 4.8), 80, 12  # of the animation


class Film(NamedTuple):
    """A chain at several times."""

    time_s: Array  # shape (frames,)
    place_m: Array  # exaggerated x and height of each body, seen along y. Shape (frames, bodies, 2)
    force_N: Array  # mean of the contact forces below and above each body. Shape (frames, bodies)
    radius_m: Array  # 0 for a flat striker. Shape (bodies,)
    flat_m: tuple[float, float]  # width and length of a flat striker, else 0, 0
    bore_m: float | None  # half the drawn width of the tube; None without a tube
    tube_top_m: float
    wall_m: float | None  # None for a free chain
    low_m: float  # lower end of the picture
    high_m: float  # upper end of the picture
    largest_N: float  # largest force of the whole run
    notes: list[str]  # differences between the picture and the run

    @property
    def half_m(self) -> float:
        """Half of the width of all bodies."""
        reach = float((np.abs(self.place_m[..., 0]) + self.radius_m).max(initial=self.flat_m[0] / 2))
        return max(reach, 1.1 * (self.bore_m or 0.0))


def film_of(case: Case, trace: Trace, frames: int, sideways: float = 1.0) -> Film:
    """A motion at ``frames`` times, evenly spread; without positions the bodies stay where they were at time 0.

    Displacements from the axis are multiplied by ``sideways``.
    """
    scene, chain = case.scene, case.chain
    chosen = spread(len(trace.time_s), frames)
    where = np.broadcast_to(chain.place_m, (len(chosen), chain.bodies, 3))
    notes = ["positions of time 0: the run kept no others"]
    if trace.height_m is not None:
        where, notes = trace.place_m[chosen], []
    place = np.stack([sideways * where[..., 0], where[..., 2]], axis=-1)
    if sideways != 1:
        notes.append(f"sideways displacements {sideways:g} times as large")
    if scene.chain.angle:
        notes.append(f"upright in the picture: the chain leans by {scene.chain.angle:g} deg")
    force = mean_forces(trace.force_N)
    radius = chain.sphere_radius_m
    flat, size, tube = flat_size(scene), scene.chain.diameter, scene.tube
    low, high = float((place[..., 1] - radius).min()), float((place[..., 1] + radius).max()) + flat[1]
    # beads touch the bore in the picture when they do in the run
    bore = None if tube is None else (size + sideways * (tube.inner_diameter - size)) / 2
    top = high if tube is None or tube.top is None else min(tube.top, high)
    return Film(
        trace.time_s[chosen], place, force[chosen], radius, flat, bore, top,
        chain.wall_height_m if chain.wall else None, min(low, chain.wall_height_m), high,
        float(force.max(initial=0.0)) or 1.0, notes,
    )  # fmt: skip


def sheet(film: Film, title: str) -> Product:
    """Contact sheet: the chain at each time side by side, to scale, coloured by force."""
    count, tall, lines = len(film.time_s), film.high_m - film.low_m, [title, *film.notes]
    scale_in = min(MAX_HEIGHT_IN / tall, WIDTH_IN / count / (2.5 * film.half_m))
    height_in, pitch = max(scale_in * tall, MIN_HEIGHT_IN) + 0.1, WIDTH_IN / count / scale_in
    size = (WIDTH_IN + 0.9, height_in + 0.4 + 0.15 * len(lines))
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
    plt, tall = pyplot(), film.high_m - film.low_m
    figure, (axis, beside) = plt.subplots(
        1, 2, figsize=GIF_IN, dpi=FILM_DPI, width_ratios=(1.3, 2.3), layout="constrained"
    )
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


def _rgba(film: Film, force_N: Array) -> Any:
    return _colours(film).to_rgba(np.ma.masked_less_equal(force_N, OPEN_SHARE * film.largest_N))


def _draw_chain(axis: Any, film: Film, frame: int, middle: float, scale_in: float) -> None:
    """Draws the chain at one time around a vertical line."""
    width, place = 2 * film.half_m, film.place_m[frame] + (middle, 0.0)
    if film.wall_m is not None:
        thick = 0.05 / scale_in
        axis.add_patch(Rectangle((middle - width / 2, film.wall_m - thick), width, thick, color=WALL, lw=0))
    if _circles(film, scale_in):
        if film.bore_m is not None and film.wall_m is not None:
            draw_tube(axis, film.bore_m, film.wall_m, film.tube_top_m, middle)
        draw_bodies(axis, place, film.radius_m, film.flat_m, _rgba(film, film.force_N[frame]), **EDGE)
        return
    order = np.argsort(film.force_N[frame])  # the largest forces are drawn last
    look = {"c": _rgba(film, film.force_N[frame][order]), "s": (72 * BAND_IN) ** 2, "lw": 72 * BEAD_IN}
    axis.scatter(*place[order].T, marker="_", rasterized=True, **look)
