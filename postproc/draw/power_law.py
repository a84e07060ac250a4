"""Power laws of a study's rows, one for each engine."""

from typing import Any

import numpy as np
import pandas as pd
from matplotlib.ticker import MaxNLocator

from drivers.base.errors import InputError
from postproc.draw.style import grey_of

MIN_ROWS = 3  # of a fit


def draw_power_laws(axis: Any, done: pd.DataFrame, x: str, y: str, x_factor: float, y_factor: float) -> list[str]:
    """Draws ``y = C x^n`` for each engine, by least squares of the logarithms; returns a line of text for each.

    The factors turn the columns ``x`` and ``y`` into the units of the axes.

    Raises:
        InputError: An engine has less than three rows with both columns above zero, or all at one x.
    """
    from scipy.stats import linregress

    lines = []
    for engine, rows in done.groupby("engine", sort=False):
        own = rows[(rows[[x, y]] > 0).all(axis=1)]
        if len(own) < MIN_ROWS or own[x].nunique() == 1:
            found = f"{engine} has {len(own)} rows with {x} and {y} above zero"
            raise InputError("--power-law", "", found, f"at least {MIN_ROWS} rows, with different {x}")
        fit = linregress(np.log(own[x]), np.log(own[y]))
        constant, exponent = np.exp(fit.intercept), f"{fit.slope:.4g}"
        left = f"; {len(rows) - len(own)} left out, not seen or not above zero" if len(own) < len(rows) else ""
        law = f"{y} = {constant:.4g} x^{exponent}, exponent {exponent} ± {fit.stderr:.2g}"
        lines.append(f"{engine}: {law} ({len(own)} rows{left})")
        places = np.geomspace(own[x].min(), own[x].max(), 100)
        look = {"color": grey_of(str(engine))["color"], "ls": (0, (6, 3)), "lw": 1.2}
        axis.plot(x_factor * places, y_factor * constant * places**fit.slope, label=f"{engine}: x^{exponent}", **look)
    return lines


def make_logarithmic(axis: Any) -> None:
    """Makes both axes logarithmic; within a decade ticks are plain numbers, since powers of ten would overlap."""
    axis.set(xscale="log", yscale="log")
    for ticks, (low, high) in ((axis.xaxis, axis.get_xlim()), (axis.yaxis, axis.get_ylim())):
        if high / low < 10:
            ticks.set_major_locator(MaxNLocator(4))
            ticks.set_major_formatter("{x:g}")
            ticks.set_minor_formatter("")
