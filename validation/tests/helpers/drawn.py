"""Properties of drawn figures: all numbers are in the table, all artists are inside."""

import re
from collections.abc import Iterator
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.container import ErrorbarContainer
from matplotlib.lines import Line2D

FACTORS = (1.0, 1e6, 1e3, 1e2)  # of axes over columns in SI units: micro, milli, per cent
SLACK_PX = 1.0
LETTER = re.compile(r"\((\w)\)")


def lettered_axes(figure: Any) -> Iterator[tuple[str, Any]]:
    """Axes with the letter of their panel: their own, else that of the previous axes, else empty."""
    letter = ""
    for axis in figure.axes:
        found = LETTER.match(axis.get_title(loc="left"))
        letter = found[1] if found else letter
        yield letter, axis


def not_in_table(figure: Any, table: pd.DataFrame) -> list[str]:
    """Lines and points in data coordinates that are in no pair of columns of the rows of their panel.

    Schemes (on axes that are switched off) and caps of error bars are left out.
    """
    missing = []
    for letter, axis in lettered_axes(figure):
        rows = table[table["panel"] == letter] if letter else table
        columns = {str(name): rows[name].to_numpy(float) for name in rows.select_dtypes("number")}
        caps = [cap for bars in axis.containers if isinstance(bars, ErrorbarContainer) for cap in bars.lines[1]]
        for line in axis.lines if axis.axison else ():
            points = np.asarray(line.get_xydata(), float)
            points = points[np.isfinite(points).all(axis=1)]
            if line.get_transform() != axis.transData or line in caps or not len(points):
                continue
            if not _is_held(points, columns):
                missing.append(f"({letter}) {line.get_label()}: {len(points)} points from {points[0]}")
    return missing


def _is_held(points: np.ndarray, columns: dict[str, np.ndarray]) -> bool:
    """True if two columns, times some factors, contain all the points, each in one row."""
    x, y = _rounded(points.T)
    across = [held for column in columns.values() for factor in FACTORS
              if np.isin(x, held := _rounded(factor * column)).all()]  # fmt: skip
    up = [held for column in columns.values() for factor in FACTORS
          if np.isin(y, held := _rounded(factor * column)).all()]  # fmt: skip
    wanted = set(zip(x, y, strict=True))
    return any(wanted <= set(zip(first, second, strict=True)) for first in across for second in up)


def _rounded(values: np.ndarray) -> np.ndarray:
    """Values to eight digits."""
    with np.errstate(divide="ignore", invalid="ignore"):
        size = 10.0 ** (7 - np.floor(np.log10(np.abs(values))))
        return np.where(values == 0, 0.0, np.round(values * size) / size)


def out_of_bounds(figure: Any, widths_in: tuple[float, ...]) -> list[str]:
    """Problems of a figure: wider than all allowed widths, text beyond its axes, cut points, curves and patches.

    On a logarithmic axis curves may leave through the bottom.
    """
    figure.draw_without_rendering()
    width_in, found = figure.get_tightbbox().width, []
    if width_in > max(width for width in widths_in if width <= figure.get_figwidth() + 0.01):
        found.append(f"{width_in:.3f} in wide")
    for axis in (axis for axis in figure.axes if axis.get_visible()):
        box, legend = axis.get_window_extent(), axis.get_legend()
        for words in (*axis.texts, axis.title, axis._left_title, axis._right_title, *([legend] if legend else [])):
            extent = words.get_window_extent()
            if extent.width and not (box.x0 - SLACK_PX <= extent.x0 and extent.x1 <= box.x1 + SLACK_PX):
                found.append(f"beyond the sides of its axes: {getattr(words, 'get_text', lambda: 'legend')()!r}")
        found += [f"cut: {artist}" for artist in (*axis.lines, *axis.patches) if _is_cut(artist, axis, box)]
    return found


def _is_cut(artist: Any, axis: Any, box: Any) -> bool:
    """True if a line, a marker or a patch is cut by the edges of its axes."""
    if not artist.get_visible() or not artist.get_clip_on():
        return False
    room = SLACK_PX
    if isinstance(artist, Line2D):
        if artist.get_transform() != axis.transData:
            return False
        with np.errstate(divide="ignore"):
            points = np.asarray(axis.transData.transform(artist.get_xydata()))
        points = points[np.isfinite(points).all(axis=1)]
        marked = artist.get_marker() not in ("None", "", " ", None)
        room -= artist.get_markersize() / 2 * axis.figure.dpi / 72 if marked else 0.0
    else:
        points = artist.get_window_extent().get_points()
        marked = False
    if not len(points):
        return False
    (left, low), (right, high) = points.min(axis=0), points.max(axis=0)
    below = low < box.y0 - room and (marked or axis.get_yscale() != "log")
    return bool(below or left < box.x0 - room or right > box.x1 + room or high > box.y1 + room)
