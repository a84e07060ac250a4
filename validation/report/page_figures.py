"""Parts of the page: stored results of chapters and figures, and its section on the paper's figures and Table 1.

The page is made from the stored results alone, each a JSON file with its digest; tables and pictures of the results
folder are outputs for people. Figures are embedded as images: a browser runs no script of an SVG inside an ``<img>``
and loads nothing from outside the file.
"""

import re
from base64 import b64encode
from collections.abc import Collection, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pandas as pd
from markupsafe import Markup, escape

from drivers.base import paths
from drivers.base.errors import InputError
from drivers.base.files import read_sealed, write_sealed
from postproc.draw.product import SPACETIME
from postproc.figures import Caption, captions
from postproc.figures.table1 import GROUPS, printed

PARTS = "parts"  # folder of the stored results, below that of tables and pictures
TABLE, SCORED = "table1", "fig3"
LARGE_N = 2.0  # smallest force counted among the large amplitudes of the scores
PX_PER_PT = 1.6  # scale that makes the figures' type as large as the page's
SUBSCRIPT = re.compile(r"\b([^\W_])_(\w)\b")  # symbols in captions, such as F_m
SPEED = Markup("V<sub>s</sub>, m/s")
COMPUTED = (SPEED, "L/2R, 0.2 %", "L/2R, 4 %")
TABLE_HEADINGS = (Markup("F<sub>m</sub>, N"), "duration, µs", SPEED, "L/2R", *COMPUTED * 3, "deviation of codes")
TABLE_GROUPS = (("", 1), *((words, last - first + 1) for words, first, last in GROUPS), ("", 1))


@dataclass(frozen=True)
class Image:
    """An embedded SVG file: data address with its bytes, and its full width."""

    address: str
    width_px: int


@contextmanager
def refused_if_damaged(path: Path, command: str) -> Iterator[None]:
    """Turns errors of reading or using a stored result into an InputError that names the command."""
    try:
        yield
    except (ValueError, LookupError, TypeError, AttributeError) as error:  # errors of pandas and of XML among them
        found = f"damaged file, or one of another version ({error}); {command} writes it again"
        raise InputError(paths.shown(path), "", found) from error


def image_of(svg: str) -> Image:
    """Image of an SVG written by matplotlib.

    Raises:
        ValueError: the text is not an SVG with a width in points.
    """
    try:
        width = ElementTree.fromstring(svg.encode()).attrib.get("width", "")
    except ElementTree.ParseError as error:
        raise ValueError(str(error)) from error
    address = f"data:image/svg+xml;base64,{b64encode(svg.encode()).decode()}"
    return Image(address, round(PX_PER_PT * float(width.removesuffix("pt"))))


def part_file(name: str, results: Path) -> Path:
    """File with the stored result of a chapter or figure."""
    return results / PARTS / f"{name}.json"


def write_part(name: str, results: Path, tables: Mapping[str, pd.DataFrame], written: Iterable[Path]) -> None:
    """Store the tables of a chapter or figure, by name, and those of its written files that are SVG figures."""
    path = part_file(name, results)
    columns = {key: table.to_dict("list") for key, table in tables.items()}
    figures = {file.stem: file.read_text(encoding="utf-8") for file in written if file.suffix == ".svg"}
    path.parent.mkdir(parents=True, exist_ok=True)
    write_sealed(path, {"name": name, "tables": columns, "figures": figures})


def read_part(name: str, results: Path, command: str = "") -> tuple[dict[str, pd.DataFrame], dict[str, Image]]:
    """Tables and images of a stored result, by name; none if it has not been made.

    Args:
        name: chapter or figure.
        results: folder of its tables and pictures.
        command: makes it, for messages; empty for ``make NAME``.

    Raises:
        InputError: the file is not as it was written, or of another version.
    """
    path, command = part_file(name, results), command or f"make {name}"
    with refused_if_damaged(path, command):
        try:
            stored = read_sealed(path, f"the result that {command} stores")
        except FileNotFoundError:
            return {}, {}
        if stored["name"] != name:
            raise ValueError(f"the result of {stored['name']}")
        tables = {key: pd.DataFrame(columns) for key, columns in stored["tables"].items()}
        return tables, {key: image_of(svg) for key, svg in stored["figures"].items()}


def read_figures(results: Path, to_come: Collection[str] = ()) -> dict[str, Any]:
    """The paper's figures and its table in the order of the paper, without those to come.

    Returns:
        made: title, finding (``shows``), text, image or ``rows`` of the table, and space-time picture of each; the
            figure of speeds has the ``scores`` of the moduli as well.
        missing: names of the others.

    Raises:
        InputError: a figure or its table is damaged.
    """
    asked = {name: caption for name, caption in captions().items() if name not in to_come}
    figures = {name: _read_figure(results, name, caption) for name, caption in asked.items()}
    made = {name: item for name, item in figures.items() if item["image"] or item["rows"]}
    return {"made": [*made.values()], "missing": [name for name in captions() if name not in made]}


def _read_figure(results: Path, name: str, caption: Caption) -> dict[str, Any]:
    tables, images = read_part(name, results)
    with refused_if_damaged(part_file(name, results), f"make {name}"):
        scores = scores_in(tables[name]) if tables and name == SCORED else None
        rows = rows_in(tables[name]) if tables and name == TABLE else None
    return {
        "title": caption.title,
        "shows": set_symbols(caption.shows),
        "text": set_symbols(caption.text),
        "image": images.get(name) if name != TABLE else None,
        "spacetime": images.get(f"{name}-{SPACETIME}"),
        "scores": scores,
        "rows": rows,
        "headings": TABLE_HEADINGS,
        "groups": TABLE_GROUPS,
    }


def set_symbols(caption: str) -> Markup:
    """Caption with subscripts in its symbols."""
    return Markup(SUBSCRIPT.sub(r"\1<sub>\2</sub>", str(escape(caption))))


def rows_in(table: pd.DataFrame) -> list[list[tuple[str, bool]]]:
    """Texts of the rows of Table 1, each with True if it is bold."""
    return [printed(row) for row in table.to_dict("records")]


def scores_in(table: pd.DataFrame) -> dict[str, Any]:
    """Deviation of measured from computed speeds: a row for each modulus, with headings.

    Deviations are in per cent of the computed speed by amplitude, root mean squares in standard errors.
    """
    table, rows = table[table["source"] == "score"], []
    for modulus, points in table.groupby("modulus_MPa"):
        large = points["force_N"] >= LARGE_N
        rms = [np.sqrt((points["deviation_standard_errors"][which] ** 2).mean()) for which in (large, ~large)]
        deviations = [f"{value:+.1f}" for value in points["deviation_pct"]]
        rows.append([f"{modulus:g}", *deviations, *(f"{value:.1f}" for value in rms)])
    at = [f"{force:g} N" for force in table["force_N"].unique()]
    return {
        "headings": ["E, MPa", *at, f"from {LARGE_N:g} N", "below"],
        "groups": [("", 1), ("measured minus computed speed, %, at", len(at)), ("rms, standard errors", 2)],
        "rows": rows,
    }
