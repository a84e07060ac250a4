"""Figures of the page, embedded as images; sections on the paper's figures and on Table 1.

A browser runs no script of an SVG inside an ``<img>`` and loads nothing from outside the file.
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
from drivers.base.files import read_sealed_file, table_in
from drivers.base.progress import say
from postproc.draw.product import SPACETIME
from postproc.draw.style import svg_of
from postproc.figures import captions
from postproc.figures.table1 import printed
from postproc.paper.strikes import READINGS

TABLE, SCORED = "table1", "fig3"
LARGE_N = 2.0  # smallest force counted among the large amplitudes of the scores
PX_PER_PT = 1.6  # scale that makes the figures' type as large as the page's
EXTRA_DIGITS = re.compile(r"(?<=\.\d\d)\d+")  # of a coordinate, below a hundredth of a point
TAG = re.compile(r"<[^>]*>")
BLANKS = re.compile(r"\s+")
SUBSCRIPT = re.compile(r"\b([^\W_])_(\w)\b")  # symbols in captions, such as F_m


@dataclass(frozen=True)
class Image:
    """An embedded SVG file: data address with its bytes, and its full width."""

    address: str
    width_px: int


def image_of(svg: str) -> Image:
    """Image of an SVG written by matplotlib, with coordinates rounded to a hundredth of a point.

    Raises:
        ValueError: the text is not an SVG with a width in points.
    """
    try:
        root = ElementTree.fromstring(svg.encode())
    except ElementTree.ParseError as error:
        raise ValueError(str(error)) from error
    small = TAG.sub(lambda tag: BLANKS.sub(" ", EXTRA_DIGITS.sub("", tag[0])), svg)
    address = f"data:image/svg+xml;base64,{b64encode(small.encode()).decode()}"
    return Image(address, round(PX_PER_PT * float(root.attrib.get("width", "").removesuffix("pt"))))


def read_image(path: Path) -> Image | None:
    """Image of a figure's file; None if the file does not exist.

    Raises:
        InputError: the file is not an SVG figure.
    """
    allowed = "an SVG as make figures or a study writes it"
    try:
        return image_of(read_sealed_file(path, allowed).decode())
    except FileNotFoundError:
        return None
    except ValueError as error:
        raise InputError(paths.shown(path), "", f"a damaged figure ({error})", allowed) from error


def stored_or_drawn(path: Path, table: Path, draw: Callable[[], Any]) -> Image:
    """Stored figure of a table, or a newly drawn figure if it is damaged or none is as new as the table."""
    stored = None
    if path.exists() and path.stat().st_mtime >= table.stat().st_mtime:
        try:
            stored = read_image(path)
        except InputError as error:
            say(f"{error}: drawn again")
    return stored or image_of(svg_of(draw()))


def read_figures(results: Path) -> dict[str, Any]:
    """``made``: caption, image and space-time picture of each of the paper's figures; ``missing``: other names.

    The figure of speeds has the ``scores`` of the moduli as well.

    Raises:
        InputError: a figure or its table is damaged.
    """
    images = {name: read_image(results / f"{name}.svg") for name in captions() if name != TABLE}
    made = [
        {
            "title": caption.title,
            "text": set_symbols(caption.text),
            "image": image,
            "spacetime": read_spacetime(results, name),
            "scores": read_values(results, SCORED, scores_in) if name == SCORED else None,
        }
        for name, caption in captions().items()
        if (image := images.get(name))
    ]
    return {"made": made, "missing": [name for name, image in images.items() if not image]}


def set_symbols(caption: str) -> Markup:
    """Caption with subscripts in its symbols."""
    return Markup(SUBSCRIPT.sub(r"\1<sub>\2</sub>", str(escape(caption))))


def read_spacetime(results: Path, name: str) -> Image | None:
    """Space-time picture of a figure's chains; None if it does not exist."""
    return read_image(results / f"{name}-{SPACETIME}.svg")


def read_values(results: Path, name: str, values_in: Callable[[pd.DataFrame], Any]) -> Any:
    """Values in the table of a figure; None without the table.

    Raises:
        InputError: the table is damaged.
    """
    path, allowed = results / f"{name}.csv", f"the table that make {name} writes"
    try:
        return values_in(table_in(read_sealed_file(path, allowed)))
    except FileNotFoundError:
        return None
    except (ValueError, KeyError, TypeError) as error:  # errors of pandas are ValueErrors
        raise InputError(paths.shown(path), "", "a damaged table", allowed) from error


def scores_in(table: pd.DataFrame) -> dict[str, Any]:
    """Deviation of measured from computed speeds: a row for each reading of the force and modulus.

    Deviations are in per cent of the computed speed by amplitude, root mean squares in standard errors.
    """
    table, rows = table[table["source"] == "score"], []
    for reading, modulus in product(READINGS, table["modulus_MPa"].unique()):
        own = table[(table["force_read_as"] == reading) & (table["modulus_MPa"] == modulus)]
        large = own["force_N"] >= LARGE_N
        rms = [np.sqrt((own["deviation_standard_errors"][which] ** 2).mean()) for which in (large, ~large)]
        deviations = [f"{value:+.1f}" for value in own["deviation_pct"]]
        rows.append([reading, f"{modulus:g}", *deviations, *(f"{value:.1f}" for value in rms)])
    return {"forces": [f"{force:g}" for force in table["force_N"].unique()], "rows": rows, "large_N": f"{LARGE_N:g}"}


def read_table1(results: Path) -> dict[str, Any]:
    """Rows by amplitude: measured, the paper's and exact numbers, deviation of the codes; empty without the table.

    Raises:
        InputError: the table is damaged.
    """
    rows = read_values(results, TABLE, lambda table: [printed(row) for row in table.to_dict("records")])
    if rows is None:
        return {}
    caption, spacetime = captions()[TABLE], read_spacetime(results, TABLE)
    return {"rows": rows, "title": caption.title, "text": set_symbols(caption.text), "spacetime": spacetime}
