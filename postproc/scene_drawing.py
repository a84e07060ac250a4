"""A scene drawn to scale: wall, tube, beads, sensors, striker."""

from dataclasses import dataclass
from math import pi
from typing import Any

import numpy as np
import pandas as pd

from drivers.chain import Array, Chain, bead_mass
from drivers.scene import RIGID, Scene
from postproc.style import COLUMN_IN, FAINT, pyplot

WHOLE = 60  # beads up to which a chain is drawn without a break
ENDS, AROUND = 8, 2  # beads kept at the ends and around sensors where it is broken
TALLEST_IN = 7.0
BEAD, SENSOR, PLATE, STRIKER, WALL, TUBE = "#f2f2f2", "#e69f00", "#7f4f00", "#cfe3f2", "#c9b27c", "#dddddd"
FOOT = 1.5  # thickness of the wall as drawn, in diameters of bead 1


@dataclass(frozen=True)
class Break:
    """Beads left out of the drawing, above a drawn height."""

    beads: int
    height_m: float


def draw_scene(scene: Scene, chain: Chain) -> tuple[Any, pd.DataFrame]:
    """The apparatus at time 0, to scale; of a long chain the ends and the sensors' surroundings.

    Returns:
        The figure, and a row per drawn body with its place and size.
    """
    kept = _kept(scene, chain)
    radius = np.where(np.isinf(chain.radius_m), 0.0, chain.radius_m)
    drawn_height, breaks = _closed_up(chain, kept, radius)
    widest = max((2 * float(radius[i]) for i in kept), default=0.0) or _flat_size(scene)[0]
    if scene.tube is not None:
        widest = max(widest, 1.4 * scene.tube.inner_diameter)
    foot = FOOT * widest if chain.wall else 0.5 * widest
    top = max((drawn_height[i] + radius[i] for i in kept), default=chain.wall_height_m) + 2.5 * widest
    low, high = chain.wall_height_m - foot, float(top)
    scale_in = min(TALLEST_IN / (high - low), 0.3 * COLUMN_IN / widest)
    figure, axis = pyplot().subplots(figsize=(COLUMN_IN, scale_in * (high - low)))
    figure.subplots_adjust(left=0, right=1, bottom=0, top=1)
    half = COLUMN_IN / scale_in / 2
    axis.set(xlim=(-0.6 * half, 1.4 * half), ylim=(low, high), aspect="equal")
    axis.axis("off")
    if scene.tube is not None:
        _draw_tube(axis, scene, chain, drawn_height, kept, radius)
    if chain.wall:
        _draw_wall(axis, chain, widest, foot)
    sensors = {sensor.from_wall for sensor in scene.chain.sensors}
    text_at = 0.75 * widest
    for i in kept:
        if i < chain.beads:
            _draw_bead(axis, drawn_height[i], radius[i], sensor=i + 1 in sensors)
            if i + 1 in sensors:
                words = f"sensor, bead {i + 1}: {1e3 * chain.mass_kg[i]:.4g} g"
                axis.annotate(words, (radius[i], drawn_height[i]), (text_at, drawn_height[i]), va="center",
                              arrowprops={"arrowstyle": "-", "lw": 0.5, "color": FAINT})  # fmt: skip
    for each in breaks:
        axis.text(0, each.height_m, f"⋮ {each.beads} beads", ha="center", va="center", color=FAINT)
    if scene.striker is not None:
        _draw_striker(axis, scene, chain, drawn_height[-1], text_at)
    if chain.beads:
        words = f"{chain.beads} {'beads' if chain.beads > 1 else 'bead'} of {scene.chain.material}\n"
        words += f"⌀ {1e3 * scene.chain.diameter:.4g} mm, {1e3 * bead_mass(scene):.4g} g"
        axis.text(text_at, drawn_height[kept[len(kept) // 2 if len(kept) > 4 else 0]], words, va="center")
    _draw_scale(axis, half, low, high)
    return figure, _table(scene, chain, kept, drawn_height, sensors)


def _kept(scene: Scene, chain: Chain) -> list[int]:
    """Indices of the bodies to draw."""
    if chain.bodies <= WHOLE:
        return list(range(chain.bodies))
    wanted = set(range(ENDS)) | set(range(chain.beads - ENDS, chain.bodies))
    for sensor in scene.chain.sensors[:4]:
        near = range(sensor.from_wall - 1 - AROUND, sensor.from_wall + AROUND)
        wanted |= {i for i in near if 0 <= i < chain.bodies}
    return sorted(wanted)


def _closed_up(chain: Chain, kept: list[int], radius: Array) -> tuple[Array, list[Break]]:
    """Heights with the stretches between drawn bodies shortened, and where they were."""
    height, breaks, shift = chain.height_m.copy(), [], 0.0
    for before, body in zip([-1, *kept], kept, strict=False):
        if before >= 0 and body > before + 1:
            floor = height[before] + radius[before]
            gap = 4 * max(radius[before], radius[body])
            shift = chain.height_m[body] - radius[body] - (floor + gap)
            breaks.append(Break(body - before - 1, float(floor + gap / 2)))
        height[body] = chain.height_m[body] - shift
    return height, breaks


def _draw_bead(axis: Any, height: float, radius: float, *, sensor: bool) -> None:
    from matplotlib.patches import Circle, Rectangle

    axis.add_patch(Circle((0, height), radius, facecolor=SENSOR if sensor else BEAD, edgecolor="black", lw=0.6))
    if sensor:
        axis.add_patch(Rectangle((-0.95 * radius, height - 0.1 * radius), 1.9 * radius, 0.2 * radius, color=PLATE))


def _draw_wall(axis: Any, chain: Chain, widest: float, foot: float) -> None:
    from matplotlib.patches import Rectangle

    corner = (-1.5 * widest, chain.wall_height_m - foot)
    axis.add_patch(Rectangle(corner, 3 * widest, foot, facecolor=WALL, edgecolor="black", lw=0.6, hatch="////"))
    words = "rigid wall" if chain.wall == RIGID else f"wall: {chain.wall}"
    axis.text(1.7 * widest, chain.wall_height_m - foot / 2, words, va="center")


def _draw_tube(axis: Any, scene: Scene, chain: Chain, height: Array, kept: list[int], radius: Array) -> None:
    from matplotlib.patches import Rectangle

    assert scene.tube is not None
    inner = scene.tube.inner_diameter
    beads = [i for i in kept if i < chain.beads]
    top = scene.tube.top or max((height[i] + radius[i] for i in beads), default=chain.wall_height_m)
    if scene.striker is not None and (scene.striker.diameter or 0) < inner and scene.tube.top is None:
        top += inner  # the striker falls through it
    for side in (-1.2 * inner / 2, inner / 2):
        size = (0.1 * inner, top - chain.wall_height_m)
        axis.add_patch(Rectangle((side, chain.wall_height_m), *size, facecolor=TUBE, edgecolor=FAINT, lw=0.4))
    words = f"{scene.tube.material} tube,\ninner ⌀ {1e3 * inner:.4g} mm"
    axis.text(-0.75 * inner, (top + chain.wall_height_m) / 2, words, ha="right", va="center", color=FAINT)


def _flat_size(scene: Scene) -> tuple[float, float]:
    """Diameter and height of a flat striker as drawn: as wide as a bead, as high as its mass asks for."""
    assert scene.striker is not None
    width = scene.chain.diameter
    density, mass = scene.materials[scene.striker.material].density, scene.striker.mass
    return width, mass / (density * pi / 4 * width**2) if density and mass else width


def _draw_striker(axis: Any, scene: Scene, chain: Chain, height: float, text_at: float) -> None:
    from matplotlib.patches import Circle, Rectangle

    striker = scene.striker
    assert striker is not None
    look: dict[str, Any] = {"facecolor": STRIKER, "edgecolor": "black", "lw": 0.6}
    if striker.diameter is None:
        width, length = _flat_size(scene)
        axis.add_patch(Rectangle((-width / 2, height), width, length, **look))
        shape, centre, top = f"flat striker of {striker.material}", height + length / 2, height + length
    else:
        axis.add_patch(Circle((0, height), striker.diameter / 2, **look))
        shape = f"striker of {striker.material}, ⌀ {1e3 * striker.diameter:.4g} mm"
        centre, top = height, height + striker.diameter / 2
    words = f"{shape}\n{1e3 * chain.mass_kg[-1]:.4g} g at {striker.speed:.4g} m/s"
    axis.text(text_at, centre, words, va="center")
    length = 0.8 * scene.chain.diameter
    axis.annotate("", (0, top + 0.1 * length), (0, top + length), arrowprops={"arrowstyle": "-|>", "color": "black"})


def _draw_scale(axis: Any, half: float, low: float, high: float) -> None:
    """A scale bar of a round length."""
    raw = min(0.3 * half, 0.5 * (high - low))
    length = 10 ** np.floor(np.log10(raw))
    length *= max(step for step in (1, 2, 5) if step * length <= raw)
    left, base = -0.55 * half, low + 0.03 * (high - low)
    axis.plot([left, left + length], [base, base], color="black", lw=1.5, solid_capstyle="butt")
    axis.text(left + length / 2, base + 0.01 * (high - low), f"{1e3 * length:g} mm", ha="center", va="bottom")


def _table(scene: Scene, chain: Chain, kept: list[int], drawn_m: Array, sensors: set[int]) -> pd.DataFrame:
    return pd.DataFrame(
        {
            "body": [i + 1 for i in kept],
            "role": ["striker" if i >= chain.beads else "sensor" if i + 1 in sensors else "bead" for i in kept],
            "material": [chain.materials[i] for i in kept],
            "height_m": chain.height_m[kept],
            "drawn_height_m": drawn_m[kept],
            "diameter_m": 2 * chain.radius_m[kept],
            "mass_kg": chain.mass_kg[kept],
            "velocity_m_s": chain.velocity_m_s[kept],
        }
    )
