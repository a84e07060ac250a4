"""Parts of the page: stored results of chapters and of the paper's figures, each a JSON file with its digest.

The page is made from them alone; tables and pictures of the results folder are outputs for people. Figures are embedded
as images: a browser runs no script of an SVG inside an ``<img>`` and loads nothing from outside the file.
"""

from base64 import b64encode
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import pandas as pd

from drivers.base import paths
from drivers.base.errors import InputError
from drivers.base.files import digest_of_json, read_sealed, write_sealed
from drivers.scene.model import Scene
from postproc.draw.plot import write_figure, write_table
from validation.checks import FAIL, Check

PARTS = "parts"  # folder of the stored results, below that of tables and pictures
PX_PER_PT = 1.6  # scale that makes the figures' type as large as the page's


@dataclass(frozen=True)
class Shown:
    """A table of the page.

    A text of a column other than the first that begins with a verdict is marked by it. Lines after the first are small.

    Attributes:
        heading: the table is folded under it; a table without one is not folded.
        text: explanation above the table.
        table: texts; the first column names the row.
    """

    heading: str
    text: str
    table: pd.DataFrame


@dataclass(frozen=True)
class Chapter:
    """Results of a chapter, or of a figure of the paper.

    Attributes:
        tables: numbers, a CSV file each, by the name of the file; columns have the names and units of their quantities.
        findings: sentences, the most important first.
        figures: heading and matplotlib figure, by the name of the files.
        shown: tables of the page.
        checks: judged numbers; the chapter fails if one fails.
        short: True for the short study.
        files: names of the written tables and figures, of a stored chapter.
    """

    tables: Mapping[str, pd.DataFrame]
    findings: Sequence[str] = ()
    figures: Mapping[str, tuple[str, Any]] = field(default_factory=dict)
    shown: Sequence[Shown] = ()
    checks: Sequence[Check] = ()
    short: bool = False
    files: Sequence[str] = ()

    @property
    def failed(self) -> list[Check]:
        """Failed checks."""
        return [check for check in self.checks if check.verdict == FAIL]


def part_file(name: str, results: Path) -> Path:
    """File with the stored result of a chapter or figure."""
    return results / PARTS / f"{name}.json"


def prediction_part(scene: Scene) -> str:
    """Name of the stored prediction of a scene as it is now (``beads predict``)."""
    return f"predict-{scene.name}-{digest_of_json(scene.model_dump(mode='json'))[:8]}"


def write_part(name: str, chapter: Chapter, results: Path) -> list[Path]:
    """Write tables and figures, delete those of an earlier result that are no longer made, and store the part.

    The page shows the part as it was stored last, which is done at the end.

    Returns:
        The written tables and figures.
    """
    try:
        part = read_part(name, results)
    except (InputError, OSError):
        part = None  # a damaged one
    written = [write_table(table, stem, results) for stem, table in chapter.tables.items()]
    figures = {}
    for stem, (heading, figure) in chapter.figures.items():
        written += write_figure(figure, stem, results)
        figures[stem] = heading, (results / f"{stem}.svg").read_text(encoding="utf-8")
    files = [path.name for path in written]
    for left in {Path(file).name for file in part.files} - {*files} if part else ():
        (results / left).unlink(missing_ok=True)
    store_part(name, chapter, figures, results, files)
    return written


def store_part(
    name: str, chapter: Chapter, figures: Mapping[str, tuple[str, str]], results: Path, files: Iterable[str] = ()
) -> None:
    """Store what the page shows of a chapter or figure, with heading and SVG of each figure."""
    path = part_file(name, results)
    path.parent.mkdir(parents=True, exist_ok=True)
    stored = asdict(replace(chapter, tables={}, figures=figures, files=[*files])) | {"name": name}
    for item in stored["shown"]:
        item["table"] = item["table"].to_dict("split", index=False)
    write_sealed(path, stored)


def read_part(name: str, results: Path, command: str = "") -> Chapter | None:
    """Stored result of a chapter or figure, without its tables and with images as figures; None if it is not made.

    Args:
        name: chapter or figure.
        results: folder of its tables and pictures.
        command: makes it, for messages; empty for ``make NAME``.

    Raises:
        InputError: the file is not as it was written, or of another version.
    """
    path, command = part_file(name, results), command or f"make {name}"
    try:
        stored = read_sealed(path, f"the result that {command} stores")
    except FileNotFoundError:
        return None
    try:
        if stored["name"] != name:
            raise ValueError(f"the result of {stored['name']}")
        return Chapter(
            {},
            stored["findings"],
            {stem: (heading, image_of(svg)) for stem, (heading, svg) in stored["figures"].items()},
            [Shown(item["heading"], item["text"], pd.DataFrame(**item["table"])) for item in stored["shown"]],
            [Check(**check) for check in stored["checks"]],
            stored["short"],
            stored["files"],
        )
    except (ValueError, LookupError, TypeError, AttributeError, ElementTree.ParseError) as error:
        found = f"damaged file, or one of another version ({error}); {command} writes it again"
        raise InputError(paths.shown(path), "", found) from error


def image_of(svg: str) -> dict[str, Any]:
    """Embedded SVG written by matplotlib: ``address`` with its bytes, and its full width ``width_px``.

    Raises:
        ElementTree.ParseError, ValueError: the text is not an SVG with a width in points.
    """
    width = ElementTree.fromstring(svg.encode()).attrib.get("width", "")
    address = f"data:image/svg+xml;base64,{b64encode(svg.encode()).decode()}"
    return {"address": address, "width_px": round(PX_PER_PT * float(width.removesuffix("pt")))}
