"""Panel of knobs of the live page: fields with sliders that keep their range while a value is turned."""

from collections.abc import Callable, Iterable
from dataclasses import replace
from functools import partial
from html import escape
from itertools import groupby
from typing import Any

from bokeh import models

from validation.explore.knobs import Knob

STYLE = """:host { color: inherit; } h2 { font-size: 15px; margin: 12px 0 0; }
.bk-input, .bk-btn { color: inherit !important; background-color: light-dark(#fff, #23282d) !important;
border-color: light-dark(#bbb, #555) !important; }
.bk-btn.bk-active { background-color: light-dark(#ddd, #444) !important; }
[role=alert] { color: light-dark(#b00020, #ff9a90); } table { border-spacing: 12px 0; }
td { white-space: nowrap; } td:not(:first-child) { text-align: right; font-variant-numeric: tabular-nums; }"""


class Panel:
    """Column of knobs.

    Attributes:
        column: The widget.
        knobs: Knobs by key, with the ranges and choices that they had first.
    """

    def __init__(self, make: Callable[..., Any], turn: Callable[[str, str], None]) -> None:
        """``make`` makes widgets as ``widget`` does; ``turn`` gets the key and the text of a knob that is turned."""
        self._make, self._turn = make, turn
        self.column = make(models.Column)
        self.knobs: dict[str, Knob] = {}
        self._first: dict[str, Knob] = {}
        self._groups: dict[Any, Any] = {}  # widgets of a knob by its form, headings by the first widget below
        self._fields: dict[str, Any] = {}  # by key, as the sliders
        self._sliders: dict[str, Any] = {}
        self._turned = ""  # key of the slider that was turned last: it stays where it was put
        self._filling = False

    def forget(self) -> None:
        """Take new ranges and choices from the next knobs."""
        self._first, self._turned = {}, ""

    def show(self, knobs: Iterable[Knob]) -> None:
        """Show knobs with their present values; there are other widgets only for other knobs."""
        former, self.knobs = self.knobs, {}
        for knob in knobs:
            first = self._first.setdefault(knob.key, knob)
            if first.form != knob.form or (first.range and not first.range.low <= knob.value <= first.range.high):
                first = self._first[knob.key] = knob
            self.knobs[knob.key] = replace(knob, range=first.range, choices=first.choices)
        self._filling = True
        if [*former] != [*self.knobs]:
            children = []
            for table, group in groupby(self.knobs.values(), lambda knob: knob.key.partition(".")[0]):
                fields = [self._group(knob) for knob in group]
                head = self._groups.get(fields[0].id) or self._make(models.Div, text=f"<h2>{escape(table)}</h2>")
                self._groups[fields[0].id] = head
                children += [head, *fields]
            self.column.children = children
        for key, knob in self.knobs.items():
            self._fields[key].value = knob.text
            if key in self._sliders and key != self._turned:
                self._sliders[key].value = knob.place
        self._filling = False

    def _group(self, knob: Knob) -> Any:
        """Field of a knob, with a slider for a number."""
        if knob.form in self._groups:
            return self._groups[knob.form]
        key, title = knob.key, knob.title or knob.key.partition(".")[2] or knob.key
        kind, more = (models.Select, {"options": [*knob.choices]}) if knob.choices else (models.TextInput, {})
        field = self._make(kind, "value", partial(self._typed, key), name=key, title=title, value=knob.text, **more)
        self._fields[key] = self._groups[knob.form] = field
        if knob.range is not None:
            look = {"start": 0, "end": 1, "step": knob.step, "show_value": False, "tooltips": False}
            turn, name = partial(self._slid, key), f"{key} slider"
            self._sliders[key] = self._make(models.Slider, "value", turn, name=name, value=knob.place, **look)
            self._groups[knob.form] = self._make(models.Column, children=[field, self._sliders[key]])
        return self._groups[knob.form]

    def _slid(self, key: str) -> None:
        if not self._filling:
            self._turned = key
            self._fields[key].value = self.knobs[key].text_at(self._sliders[key].value)

    def _typed(self, key: str) -> None:
        if not self._filling:
            self._turn(key, self._fields[key].value.strip())


def widget(sheet: Any, kind: Any, changed: str = "", act: Callable[[], None] | None = None, **more: Any) -> Any:
    """A widget with a style sheet that calls a function when it is clicked or a property has changed."""
    wide = {} if kind in (models.Button, models.Toggle) else {"sizing_mode": "stretch_width"}
    made = kind(stylesheets=[sheet], margin=(3, 0), **wide, **more)
    if changed == "click":
        made.on_click(lambda _: act and act())
    elif act:
        made.on_change(changed, lambda attr, old, new: act())
    return made
