"""Matplotlib's figures made fit to stand in the page: small, with ids of their own, and for dark screens too."""

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np

from drivers.base import paths
from drivers.base.errors import InputError
from drivers.chain.chain import Array
from postproc.draw.style import svg_of
from validation.report.foreign import foreign

# what is too dark for a dark screen (or too light), and what stands there instead
DARK = {
    "#ffffff": "var(--page)",
    "#000000": "var(--ink)",
    "#eeeeee": "var(--soft)",
    "#f2f2f2": "#262d35",
    "#dddddd": "#39414a",
    "#d9d9d9": "#39414a",
    "#cfe3f2": "#23405a",
    "#555555": "var(--dim)",
    "#b0b0b0": "#5b6570",
    "#0072b2": "#4aa8e0",
    "#d55e00": "#f0833a",
    "#009e73": "#2cc49a",
    "#440154": "#b583d6",
    "#463480": "#a391e0",
    "#414487": "#8f97dd",
    "#355f8d": "#74a3d6",
    "#2a788e": "#5cb0c8",
    "#7f4f00": "#cf9440",
}
# of words: what can be read on a light screen and on a dark one, where a line may be paler
WORDS = {
    "#d55e00": ("#a34800", "#f0833a"),
    "#22a884": ("#0d6b52", "#22a884"),
    "#7ad151": ("#3c7519", "#7ad151"),
    "#2a788e": ("#21647a", "#5cb0c8"),
}
NUMBER = re.compile(r"-?\d+\.\d{2,}")
PATH = re.compile(r' d="([^"]*)"')
LONG = 40  # points: shorter paths are markers and letters, and stay as they are
SEEN = 0.1  # of a point: what a line may be moved by
LINE = re.compile(r"[MLz\d\s.+-]*")
COLOUR = re.compile(r"#[0-9a-f]{6}\b")
USED = re.compile(r'(?:url\(|xlink:href=")#([^")]+)')
NAMED = re.compile(r' id="([^"]*)"')
STYLE = re.compile(r'style="([^"]*)"')
WORD = re.compile(r'(<(?:text|tspan)\b[^>]*style="[^"]*fill: )(#[0-9a-f]{6})')
SIZE = re.compile(r'(<svg[^>]*?) width="([\d.]+)pt" height="[^"]*"')
LARGER = 1.6  # px to the point: print's type, made as large as the page's
JUNK = re.compile(r"<metadata>.*?</metadata>|<style.*?</style>|<!--.*?-->|<\?xml.*?\?>|<!DOCTYPE.*?>", re.DOTALL)


def colour_of(colour: str) -> str:
    """A colour that follows the page into the dark."""
    return f"var(--c-{colour[1:]}, {colour})" if colour in DARK else colour


def _ink(colour: str) -> str:
    return f"var(--t-{colour[1:]})" if colour in WORDS else colour


def fit_for_page(text: str, salt: str) -> str:
    """An ``<svg>`` of matplotlib's to stand in the page.

    Args:
        text: the whole file.
        salt: keeps its ids apart from those of other figures.

    Raises:
        ValueError: it is no SVG, or holds what does not belong in the page (``validation.report.foreign``).
    """
    try:
        ElementTree.fromstring(text.encode())
    except ElementTree.ParseError as error:
        raise ValueError(str(error)) from error
    _refuse(text, drawn=False)
    text = JUNK.sub("", text)
    text = text[text.index("<svg") :]
    used = set(USED.findall(text))
    text = NAMED.sub(lambda found: f' id="{salt}-{found[1]}"' if found[1] in used else "", text)
    text = USED.sub(lambda found: found[0].replace(f"#{found[1]}", f"#{salt}-{found[1]}"), text)
    text = PATH.sub(lambda found: f' d="{_thin(found[1])}"', text)
    text = WORD.sub(lambda found: found[1] + _ink(found[2]), text)
    text = STYLE.sub(lambda found: f'style="{COLOUR.sub(lambda c: colour_of(c[0]), found[1])}"', text)
    text = re.sub(r"<defs>\s*</defs>", "", NUMBER.sub(lambda found: f"{float(found[0]):.2f}", text))
    text = SIZE.sub(
        lambda found: (
            f'{found[1]} style="max-width: {LARGER * float(found[2]):.0f}px" aria-hidden="true" focusable="false"'
        ),
        text,
        count=1,
    )
    text = re.sub(r">\s+<", "><", text).strip()
    _refuse(text, drawn=True)
    return text


def _refuse(text: str, *, drawn: bool) -> None:
    found = foreign(text, drawn=drawn)
    if found:
        raise ValueError(f"it holds {found}")


def read_svg(path: Path, salt: str) -> str:
    """A figure's file, fit for the page; empty where there is none.

    Raises:
        InputError: it is no figure, or holds what does not belong in the page.
    """
    try:
        return fit_for_page(path.read_text(), salt)
    except FileNotFoundError:
        return ""
    except (ValueError, OSError) as error:
        raise InputError(
            paths.shown(path), "", f"a damaged figure ({error})", "an SVG that this project made"
        ) from error


def stored_or_drawn(path: Path, table: Path, draw: Callable[[], Any], salt: str) -> str:
    """The figure that was stored with its table, fit for the page; drawn anew where there is none as new as the table.

    Raises:
        InputError: what is stored is no figure.
    """
    if path.exists() and path.stat().st_mtime >= table.stat().st_mtime:
        return read_svg(path, salt)
    return fit_for_page(svg_of(draw()), salt)


def thinned(x: Array, y: Array, seen: float = SEEN) -> tuple[Array, Array]:
    """A line without the points that nobody sees, and matplotlib's code of each; it breaks where it is no number."""
    from matplotlib.path import Path as Line

    line = Line(np.column_stack([x, y]))
    line.simplify_threshold = seen
    clean = line.cleaned(remove_nans=True, simplify=True)
    kept = np.asarray(clean.codes) != Line.STOP
    return np.asarray(clean.vertices)[kept], np.asarray(clean.codes)[kept]


def relative(points: Array, codes: Array, digits: int = 1) -> str:
    """A line's ``d`` in relative steps of so many digits; points are rounded first, so that steps do not drift."""
    scale = 10**digits
    whole = np.rint(scale * points).astype(int)
    steps = np.diff(whole, axis=0, prepend=np.zeros((1, 2), int))
    words = []
    for (dx, dy), code in zip(steps.tolist(), codes.tolist(), strict=True):
        first, second = f"{dx / scale:g}", f"{dy / scale:g}"
        words.append(f"{'m' if code == 1 else 'l'}{first}{'' if second[0] == '-' else ' '}{second}")
    return "".join(words)


def _thin(d: str) -> str:
    """A path with a tenth of a point at most lost."""
    if d.count("L") < LONG or not LINE.fullmatch(d) or d.count("M") > 1:
        return NUMBER.sub(lambda found: f"{float(found[0]):.2f}", " ".join(d.split()))
    points = np.array(re.sub(r"[MLz]", " ", d).split(), dtype=float).reshape(-1, 2)
    return relative(*thinned(points[:, 0], points[:, 1])) + ("z" if "z" in d else "")
