"""Forces in every contact against time, as a picture of one colour a cell."""

from base64 import b64encode
from dataclasses import dataclass
from io import BytesIO
from typing import Any

import numpy as np

from drivers.trace import Trace
from postproc.spacetime import GAMMA, LEAST, cells_of
from postproc.style import force_colours
from validation.report.charts import LEFT, RIGHT, TOP, WIDTH, round_ticks, time_unit

HEIGHT, BELOW, SCALE_LEFT, SCALE_WIDTH = 190.0, 40.0, 632.0, 14.0
PLOT_RIGHT = SCALE_LEFT - 14.0
TITLE = 12.0  # of the picture, what the words above it need on a phone
STEPS = 64  # of the colour scale
PLACES = {"width": WIDTH, "left": LEFT, "right": RIGHT, "top": TOP, "plot_right": PLOT_RIGHT, "plot_height": HEIGHT,
          "scale_left": SCALE_LEFT, "scale_width": SCALE_WIDTH}  # fmt: skip


@dataclass(frozen=True)
class Raster:
    """The picture with its axes.

    Attributes:
        image, scale: data addresses of PNGs, time to the right and contacts upwards; the scale upwards.
        ticks, contacts, forces: places and labels along time, contacts, and the scale of force.
    """

    engine: str
    unit: str
    height: float
    bottom: float
    image: str
    scale: str
    ticks: list[tuple[float, str]]
    contacts: list[tuple[float, str]]
    forces: list[tuple[float, str]]


def raster_of(trace: Trace, engine: str) -> Raster:
    """A chain's forces; a colour goes with the root of the force, contacts that are open are grey."""
    cells, contacts = cells_of(trace), trace.force_N.shape[1]
    largest = float(cells.force_N.max(initial=0.0)) or 1.0
    share = np.ma.masked_less_equal(cells.force_N / largest, LEAST) ** GAMMA
    colours = force_colours()
    long = float(np.ptp(trace.time_s)) or 1.0
    scale, unit = time_unit(long)
    bottom = TOP + HEIGHT
    return Raster(
        engine=engine,
        unit=unit,
        height=bottom + BELOW,
        bottom=bottom,
        image=_png(colours(share[::-1], bytes=True)),
        scale=_png(colours(np.linspace(1.0, 0.0, STEPS)[:, None], bytes=True)),
        ticks=[(LEFT + (PLOT_RIGHT - LEFT) * t / (long * scale), f"{t:g}") for t in round_ticks(0.0, long * scale, 8)],
        contacts=[
            (bottom - HEIGHT * (each - 0.5) / contacts, f"{each:g}")
            for each in round_ticks(1.0, float(contacts), 5)
            if each == int(each)
        ],
        forces=[
            (place, f"{force:g}")
            for force in round_ticks(0.0, largest, 5)
            if (place := bottom - HEIGHT * (force / largest) ** GAMMA) > TOP + TITLE
        ],
    )


def _png(rgba: Any) -> str:
    from matplotlib.image import imsave

    buffer = BytesIO()
    imsave(buffer, np.asarray(rgba), format="png")
    return f"data:image/png;base64,{b64encode(buffer.getvalue()).decode()}"
