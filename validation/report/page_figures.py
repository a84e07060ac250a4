"""Figures of files as the page shows them, each an image with its own bytes; the paper's figures and Table 1.

Inside an ``<img>`` a browser runs no script of an SVG and asks for nothing outside it, whatever the file holds.
"""

import re
from base64 import b64encode
from collections.abc import Callable
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pandas as pd
from markupsafe import Markup, escape

from drivers.base import paths
from drivers.base.errors import InputError
from postproc.draw.product import SPACETIME
from postproc.draw.style import svg_of
from postproc.figures import captions
from postproc.figures.table1 import printed
from postproc.paper.strikes import READINGS

TABLE, SCORED = "table1.csv", "fig3"
LARGE_N = 2.0  # amplitudes from here on are the large ones of the scores
PX_PER_PT = 1.6  # print's type, made as large as the page's
UNSEEN_DIGITS = re.compile(r"(?<=\.\d\d)\d+")  # of a coordinate: below a hundredth of a point
TAG = re.compile(r"<[^>]*>")
BLANKS = re.compile(r"\s+")
SUBSCRIPT = re.compile(r"\b([^\W_])_(\w)\b")  # as captions write symbols: F_m


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
    """``made``: caption and image of each of the paper's figures, its chains ``beside`` it; ``missing``: names.

    The figure of speeds comes with the ``scores`` of the moduli.

    Raises:
        InputError: one is damaged.
    """
    made, missing = [], []
    for name, caption in captions().items():
        if f"{name}.csv" == TABLE:
            continue
        if image := read_image(results / f"{name}.svg"):
            words = {"title": caption.title, "text": set_symbols(caption.text)}
            scores = read_scores(results) if name == SCORED else None
            made.append({**words, "image": image, "beside": read_beside(results, name), "scores": scores})
        else:
            missing.append(name)
    return {"made": made, "missing": missing}


def set_symbols(caption: str) -> Markup:
    """A caption with the subscripts of its symbols set as such."""
    return Markup(SUBSCRIPT.sub(r"\1<sub>\2</sub>", str(escape(caption))))


def read_beside(results: Path, name: str) -> Image | None:
    """The chains of a figure in space and time; None where that was not made."""
    return read_image(results / f"{name}-{SPACETIME}.svg")


def read_scores(results: Path) -> dict[str, Any] | None:
    """How far the experiment is from each modulus: a row per reading of the measured force; None without the numbers.

    Deviations in per cent of the simulated speed by amplitude, then root mean squares in standard errors.

    Raises:
        InputError: the figure's table is damaged.
    """
    path = results / f"{SCORED}.csv"
    if not path.exists():
        return None
    try:
        table = pd.read_csv(path)
        table = table[table["source"] == "score"]
        forces = [f"{force:g}" for force in table["force_N"].unique()]
        rows = []
        for reading, modulus in product(READINGS, table["modulus_MPa"].unique()):
            own = table[(table["force_read_as"] == reading) & (table["modulus_MPa"] == modulus)]
            large = own["force_N"] >= LARGE_N
            rms = [np.sqrt((own["deviation_standard_errors"][which] ** 2).mean()) for which in (large, ~large)]
            deviations = [f"{value:+.1f}" for value in own["deviation_pct"]]
            rows.append([reading, f"{modulus:g}", *deviations, *(f"{value:.1f}" for value in rms)])
    except (ValueError, KeyError, TypeError) as error:
        raise InputError(paths.shown(path), "", "a damaged table", f"what make {SCORED} writes") from error
    return {"forces": forces, "rows": rows, "large_N": f"{LARGE_N:g}"}


def read_table1(results: Path) -> dict[str, Any]:
    """Rows by amplitude: measured, the paper's, the exact numbers and the codes' deviation; empty without the table.

    Raises:
        InputError: it is damaged.
    """
    path = results / TABLE
    if not path.exists():
        return {}
    try:
        rows = [printed(row) for row in pd.read_csv(path).to_dict("records")]
    except (ValueError, KeyError, TypeError) as error:  # pandas' own errors are ValueErrors
        raise InputError(paths.shown(path), "", "a damaged table", "what make table1 writes") from error
    caption = captions()["table1"]
    return {
        "rows": rows,
        "title": caption.title,
        "text": set_symbols(caption.text),
        "beside": read_beside(results, "table1"),
    }
