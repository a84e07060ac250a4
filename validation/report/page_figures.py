"""Figures of files as the page shows them, each an image with its own bytes; the paper's figures and Table 1.

Inside an ``<img>`` a browser runs no script of an SVG and asks for nothing outside it, whatever the file holds.
"""

import re
from base64 import b64encode
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import pandas as pd

from drivers.base import paths
from drivers.base.errors import InputError
from postproc.draw.product import SPACETIME
from postproc.draw.style import svg_of
from postproc.figures import captions
from postproc.paper.strikes import COLUMNS, engines_of

TABLE = "table1.csv"
MEASURED = ("duration_us", "speed_m_s", "width_diameters")
HEADINGS = {"speed_m_s": "speed, m/s", "width_0.2pct_diameters": "L/2R at 0.2 %", "width_4pct_diameters": "L/2R at 4 %"}
DIGITS = {"speed_m_s": 2}  # after the point, else 3
PX_PER_PT = 1.6  # print's type, made as large as the page's
UNSEEN_DIGITS = re.compile(r"(?<=\.\d\d)\d+")  # of a coordinate: below a hundredth of a point
TAG = re.compile(r"<[^>]*>")
BLANKS = re.compile(r"\s+")


@dataclass(frozen=True)
class Image:
    """An SVG file as it stands in the page: a data address with its bytes, and its width where there is room for it."""

    address: str
    width_px: int


def image_of(svg: str) -> Image:
    """The text of a file of matplotlib's as an image; digits that nobody sees are left out.

    Raises:
        ValueError: it is no SVG with a width in points.
    """
    try:
        root = ElementTree.fromstring(svg.encode())
    except ElementTree.ParseError as error:
        raise ValueError(str(error)) from error
    small = TAG.sub(lambda tag: BLANKS.sub(" ", UNSEEN_DIGITS.sub("", tag[0])), svg)
    address = f"data:image/svg+xml;base64,{b64encode(small.encode()).decode()}"
    return Image(address, round(PX_PER_PT * float(root.attrib.get("width", "").removesuffix("pt"))))


def read_image(path: Path) -> Image | None:
    """A figure's file; None where there is none.

    Raises:
        InputError: it is no figure.
    """
    try:
        return image_of(path.read_text())
    except FileNotFoundError:
        return None
    except (ValueError, OSError) as error:
        found = f"a damaged figure ({error})"
        raise InputError(paths.shown(path), "", found, "an SVG that this project made") from error


def stored_or_drawn(path: Path, table: Path, draw: Callable[[], Any]) -> Image:
    """The figure that was stored with its table; drawn anew where there is none as new as the table.

    Raises:
        InputError: what is stored is no figure.
    """
    stored = read_image(path) if path.exists() and path.stat().st_mtime >= table.stat().st_mtime else None
    return stored or image_of(svg_of(draw()))


def read_figures(results: Path) -> dict[str, Any]:
    """``made``: caption and image of each of the paper's figures, and its chains ``beside`` it; ``missing``: names.

    Raises:
        InputError: one is damaged.
    """
    made, missing = [], []
    for name, caption in captions().items():
        if f"{name}.csv" == TABLE:
            continue
        if image := read_image(results / f"{name}.svg"):
            made.append(
                {"title": caption.title, "text": caption.text, "image": image, "beside": read_beside(results, name)}
            )
        else:
            missing.append(name)
    return {"made": made, "missing": missing}


def read_beside(results: Path, name: str) -> Image | None:
    """The chains of a figure in space and time; None where that was not made."""
    return read_image(results / f"{name}-{SPACETIME}.svg")


def read_table1(results: Path) -> dict[str, Any]:
    """Rows by amplitude: measured, printed, and by each engine; empty without the table.

    Raises:
        InputError: it is damaged.
    """
    path = results / TABLE
    if not path.exists():
        return {}
    try:
        table = pd.read_csv(path)
        engines = engines_of(table)
        rows = [
            {
                "force": f"{row['force_N']:g}",
                "measured": [f"{row[f'measured_{name}']:g}" for name in MEASURED],
                "computed": [
                    ("the paper", [f"{row[f'computed_{name}']:g}" for name in COLUMNS]),
                    *((e, [f"{row[f'{e}_{name}']:.{DIGITS.get(name, 3)}f}" for name in COLUMNS]) for e in engines),
                ],
            }
            for row in table.to_dict("records")
        ]
    except (ValueError, KeyError, TypeError) as error:  # pandas' own errors are ValueErrors
        raise InputError(paths.shown(path), "", "a damaged table", "what make table1 writes") from error
    return {"rows": rows, "headings": list(HEADINGS.values()), "beside": read_beside(results, "table1")}
