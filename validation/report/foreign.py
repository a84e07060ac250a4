"""What a figure must not bring into the page: scripts, handlers, addresses outside it, and what holds such things.

Browsers read an SVG within a page as HTML and not as XML. What comes into the page is therefore read as HTML here, and
has to consist of what figures are made of; in the rest of the file nothing may run or be asked for either.
"""

import re
from html.parser import HTMLParser

# nothing among them has contents that HTML reads in another way
DRAWN = frozenset({
    "svg", "g", "a", "defs", "path", "rect", "circle", "ellipse", "line", "polyline", "polygon", "text", "tspan", "use",
    "clippath", "pattern", "image",
})  # fmt: skip
OUTSIDE = re.compile(r"url\(\s*[\"']?\s*(?!#|data:)|//|\\|image-set|@import", re.IGNORECASE)
INSIDE = re.compile(r"\s*(#|data:image/)", re.IGNORECASE)
UNREAD = re.compile(r"<!ENTITY|<!\[|<\?(?!xml )", re.IGNORECASE)  # XML and HTML see different things in them
ADDRESSES = ("href", "src")


def foreign(text: str, *, drawn: bool) -> str:
    """What does not belong in an SVG's text, in words; empty where all does.

    Args:
        text: of the whole file, or of what comes into the page of it.
        drawn: whether it comes into the page, so that only what draws may be in it.
    """
    if UNREAD.search(text):
        return "an entity, a section or an instruction"
    reader = _Reader(drawn=drawn)
    reader.feed(text)
    reader.close()
    return reader.found


class _Reader(HTMLParser):
    """Keeps the first thing that does not belong there."""

    def __init__(self, *, drawn: bool) -> None:
        super().__init__()
        self.drawn, self.found = drawn, ""

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        if tag == "script":
            self._keep("a script")
        elif self.drawn and tag not in DRAWN:
            self._keep("an element that draws nothing")
        for name, value in attrs:
            self._attribute(name, value or "")

    def handle_data(self, data: str) -> None:
        if self.lasttag == "style" and OUTSIDE.search(data):
            self._keep("an address outside the page")

    def _attribute(self, name: str, value: str) -> None:
        own = name.rpartition(":")[2]
        if name.startswith(("on", "xlink:on")):
            self._keep("a handler of events")
        elif own in ADDRESSES:
            if not INSIDE.match(value):
                self._keep("an address outside the page")
        elif not name.startswith(("xmlns", "rdf:")) and OUTSIDE.search(value):
            self._keep("an address outside the page")

    def _keep(self, words: str) -> None:
        self.found = self.found or words
