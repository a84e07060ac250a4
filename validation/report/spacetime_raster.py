"""Forces in every contact against time, as a picture of one colour a cell."""

from base64 import b64encode
from dataclasses import dataclass
from io import BytesIO
from typing import Any

import numpy as np

from drivers.chain.trace import Trace
from postproc.draw.spacetime import GAMMA, cells_of
from postproc.draw.style import force_colours
from validation.report.charts import LEFT, RIGHT, TOP, WIDTH, round_ticks, time_axis

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
    share = (cells.closed_N / cells.largest_N) ** GAMMA
    colours, axis = force_colours(), time_axis(trace.time_s, PLOT_RIGHT)
    bottom = TOP + HEIGHT
    return Raster(
        engine=engine,
        unit=axis.unit,
        height=bottom + BELOW,
        bottom=bottom,
        image=_png(colours(share[::-1], bytes=True)),
        scale=_png(colours(np.linspace(1.0, 0.0, STEPS)[:, None], bytes=True)),
        ticks=axis.ticks,
        contacts=[
            (bottom - HEIGHT * (each - 0.5) / contacts, f"{each:g}")
            for each in round_ticks(1.0, float(contacts), 5)
            if each == int(each)
        ],
        forces=[
            (place, f"{force:g}")
            for force in round_ticks(0.0, cells.largest_N, 5)
            if (place := bottom - HEIGHT * (force / cells.largest_N) ** GAMMA) > TOP + TITLE
        ],
    )


def _png(rgba: Any) -> str:
    from matplotlib.image import imsave

    buffer = BytesIO()
    imsave(buffer, np.asarray(rgba), format="png")
    return f"data:image/png;base64,{b64encode(buffer.getvalue()).decode()}"
