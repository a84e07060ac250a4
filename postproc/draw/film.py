"""A wave in a chain: a contact sheet of the chain at several times, and an animation."""

from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from textwrap import fill
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.cm import ScalarMappable
from matplotlib.collections import EllipseCollection
from matplotlib.colors import PowerNorm
from matplotlib.patches import Rectangle
from PIL import Image

from drivers.base.files import whole_file
from drivers.chain.chain import Array
from drivers.run.run_folder import EndedRun
from postproc.draw.product import GAMMA, OPEN_SHARE, Product
from postproc.draw.scene_drawing import WALL, flat_size
from postproc.draw.style import GREY, MICRO, finish_bar, force_colours, pyplot
from postproc.read.motion import chain_of, spread
from postproc.read.signals import mean_forces

FRAMES, GIF_FRAMES = 12, 80
WIDTH_IN, MAX_HEIGHT_IN, MIN_HEIGHT_IN = 6.4, 5.2, 1.2
BEAD_IN = 0.025  # smallest drawn diameter of a bead; smaller beads become a band
BAND_ROWS = 400
BAND_IN = 0.15  # smallest width of a band
BORE = "#9aa4af"
EDGE: dict[str, Any] = {"edgecolor": "#777777", "lw": 0.4}
FILM_DPI, FILM_PER_S = 80, 12


@dataclass(frozen=True)
class Film:
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


def film_of(run: EndedRun, frames: int, sideways: float = 1.0) -> Film:
    """A run at ``frames`` times, evenly spread; without kept positions the bodies stay where they were at time 0.

    Displacements from the axis are multiplied by ``sideways``.
    """
    scene, chain = chain_of(run)
    chosen = spread(len(run.trace.time_s), frames)
    place = np.zeros((len(chosen), chain.bodies, 2))
    place[..., 1], notes = chain.height_m, ["positions of time 0: the run kept no others"]
    if run.has_state:
        where = run.state.place_m[chosen]
        place, notes = np.stack([sideways * where[..., 0], where[..., 2]], axis=-1), []
    if sideways != 1:
        notes.append(f"sideways displacements {sideways:g} times as large")
    if scene.chain.angle:
        notes.append(f"upright in the picture: the chain leans by {scene.chain.angle:g} deg")
    force = mean_forces(run.trace.force_N)
    radius = chain.sphere_radius_m
    flat, size, tube = flat_size(scene), scene.chain.diameter, scene.tube
    low, high = float((place[..., 1] - radius).min()), float((place[..., 1] + radius).max()) + flat[1]
    bore, top = None, high
    if tube is not None and tube.inner_diameter < 5 * size:
        # beads touch the bore in the picture when they do in the run
        bore = (size + sideways * (tube.inner_diameter - size)) / 2
        tops = (place[..., 1] + radius)[:, 2 * radius <= tube.inner_diameter]
        top = float(tops.max(initial=low)) if tube.top is None else tube.top
    return Film(
        run.trace.time_s[chosen], place, force[chosen], radius, flat, bore, min(top, high),
        chain.wall_height_m if chain.wall else None, min(low, chain.wall_height_m), high,
        float(force.max(initial=0.0)) or 1.0, notes,
    )  # fmt: skip


def sheet(film: Film, title: str) -> Product:
    """Contact sheet: the chain at each time side by side, to scale, coloured by force."""
    plt, count, tall = pyplot(), len(film.time_s), film.high_m - film.low_m
    pitch_in = WIDTH_IN / count
    scale_in = min(MAX_HEIGHT_IN / tall, pitch_in / (2.5 * film.half_m))
    height_in = max(scale_in * tall, MIN_HEIGHT_IN) + 0.1
    lines = [title, *film.notes]
    page_in = height_in + 0.45 + 0.15 * len(lines)
    figure = plt.figure(figsize=(WIDTH_IN + 0.9, page_in))
    axis = _axis(figure, (0.1, 0.35, WIDTH_IN, height_in))
    pitch = pitch_in / scale_in
    axis.set(xlim=(-pitch / 2, (count - 0.5) * pitch), ylim=_around(film, height_in / scale_in))
    for i, time_s in enumerate(film.time_s):
        _draw_chain(axis, film, i, i * pitch, scale_in)
        axis.text(i * pitch, axis.get_ylim()[0], f"{time_s * MICRO:.0f} µs", ha="center", va="top", fontsize=7)
    bar_in = min(2.0, height_in)
    bar = figure.colorbar(_colours(film), cax=_axis(figure, (WIDTH_IN + 0.2, 0.35, 0.1, bar_in), framed=True))
    finish_bar(bar, "mean of the contact forces (N),\nsquare-root scale; grey: none")
    figure.text(0.1 / (WIDTH_IN + 0.9), 1 - 0.05 / page_in, "\n".join(lines), va="top")
    bodies = film.force_N.shape[1]
    return Product(figure, pd.DataFrame({
        "time_s": np.repeat(film.time_s, bodies), "body": np.tile(np.arange(1, bodies + 1), count),
        "height_m": film.place_m[..., 1].ravel(), "force_N": film.force_N.ravel(),
    }))  # fmt: skip


def write_animation(film: Film, title: str, path: Path) -> Path:
    """Writes the film as an animated GIF, whole or not at all: the chain next to its forces."""
    plt, tall = pyplot(), film.high_m - film.low_m
    chain_in, force_in, height_in = 1.3, 2.3, 3.8
    scale_in = min((height_in - 0.1) / tall, chain_in / (2.2 * film.half_m))
    figure = plt.figure(figsize=(chain_in + force_in + 0.3, height_in + 1.0))
    axis = _axis(figure, (0.05, 0.5, chain_in, height_in))
    forces_axis = _axis(figure, (0.15 + chain_in, 0.5, force_in, height_in), framed=True)
    limits = _around(film, height_in / scale_in)
    forces_axis.set(xlim=(0, 1.05 * film.largest_N), ylim=limits, xlabel="mean of the contact forces (N)", yticks=[])
    line = forces_axis.plot([], [], color=GREY, lw=0.8, marker="o" if _circles(film, scale_in) else "", ms=2.5)[0]
    figure.text(0.03, 0.98, fill("; ".join([title, *film.notes]), 62), va="top")
    images = []
    for i, time_s in enumerate(film.time_s):
        axis.clear()
        axis.axis("off")
        axis.set(xlim=(-chain_in / scale_in / 2, chain_in / scale_in / 2), ylim=limits)
        _draw_chain(axis, film, i, 0.0, scale_in)
        line.set_data(film.force_N[i], film.place_m[i, :, 1])
        forces_axis.set_title(f"{time_s * MICRO:.0f} µs", loc="left")
        figure.savefig(image := BytesIO(), dpi=FILM_DPI)
        images.append(Image.open(image).convert("RGB"))
    plt.close(figure)
    path.parent.mkdir(parents=True, exist_ok=True)
    look: dict[str, Any] = {"format": "GIF", "save_all": True, "duration": 1000 // FILM_PER_S, "loop": 0}
    with whole_file(path) as draft:
        images[0].save(draft, append_images=images[1:], **look)
    return path


def _axis(figure: Any, box_in: tuple[float, float, float, float], *, framed: bool = False) -> Any:
    """Axes at a position in inches: left, bottom, width, height."""
    axis = figure.add_axes(np.divide(box_in, np.tile(figure.get_size_inches(), 2)))
    axis.axis("on" if framed else "off")
    return axis


def _around(film: Film, range_m: float) -> tuple[float, float]:
    """Ends of a range of heights centred on the chain."""
    middle = (film.low_m + film.high_m) / 2
    return middle - range_m / 2, middle + range_m / 2


def _circles(film: Film, scale_in: float) -> bool:
    """True if beads are large enough on paper to be drawn one by one."""
    return bool(2 * np.median(film.radius_m) * scale_in >= BEAD_IN)


def _colours(film: Film) -> Any:
    return ScalarMappable(PowerNorm(GAMMA, 0, film.largest_N), force_colours())


def _draw_chain(axis: Any, film: Film, frame: int, middle: float, scale_in: float) -> None:
    """Draws the chain at one time around a vertical line."""
    colours, width = _colours(film), 2 * film.half_m
    force = np.ma.masked_less_equal(film.force_N[frame], OPEN_SHARE * film.largest_N)
    if film.wall_m is not None:
        thick = 0.05 / scale_in
        axis.add_patch(Rectangle((middle - width / 2, film.wall_m - thick), width, thick, color=WALL, lw=0))
    if film.bore_m is not None and film.wall_m is not None and _circles(film, scale_in):
        for side in (-film.bore_m, film.bore_m):
            axis.plot([middle + side] * 2, [film.wall_m, film.tube_top_m], color=BORE, lw=0.6, zorder=0)
    if film.flat_m[0]:
        corner = (middle - film.flat_m[0] / 2, film.place_m[frame, -1, 1])
        axis.add_patch(Rectangle(corner, *film.flat_m, facecolor=colours.to_rgba(force[-1:])[0], **EDGE))
    place = film.place_m[frame] + (middle, 0.0)
    if _circles(film, scale_in):
        rgba = colours.to_rgba(force)
        for radius in np.unique(film.radius_m[film.radius_m > 0]):  # beads of one size together, for a small file
            alike, size = film.radius_m == radius, (2 * radius,)
            beads = EllipseCollection(size, size, (0,), units="xy", offsets=place[alike], facecolors=rgba[alike],
                                      offset_transform=axis.transData, **EDGE)  # fmt: skip
            axis.add_collection(beads, autolim=False)
        return
    # a band: the largest force in each slice of the height, masked where no body is
    height, step = film.place_m[frame, :, 1] - film.low_m, (film.high_m - film.low_m) / BAND_ROWS
    reach = np.multiply.outer((-0.999, 0.999), film.radius_m)
    first, last = np.clip(((height + reach) / step).astype(int), 0, BAND_ROWS - 1)
    counts = last - first + 1
    rows = np.repeat(first - np.cumsum(counts) + counts, counts) + np.arange(counts.sum())
    largest_N = np.full(BAND_ROWS, -1.0)
    np.maximum.at(largest_N, rows, np.repeat(film.force_N[frame], counts))
    band = np.ma.masked_less_equal(largest_N, OPEN_SHARE * film.largest_N)[:, np.newaxis]
    half = max(film.half_m, BAND_IN / 2 / scale_in)
    extent = (middle - half, middle + half, film.low_m, film.high_m)
    axis.set_autoscale_on(False)
    axis.imshow(colours.to_rgba(band), extent=extent, origin="lower", aspect="auto", interpolation="none")
