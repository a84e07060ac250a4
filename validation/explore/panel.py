"""Panel of knobs of the live page: fields with sliders that keep their range while a value is turned."""

from collections.abc import Callable, Iterable
from dataclasses import replace
from functools import partial
from html import escape
from itertools import groupby
from typing import Any

from bokeh import models

from validation.explore.knobs import Knob


class Panel:
    """Column of knobs.

    Attributes:
        column: The widget.
        knobs: Knobs by key, with the ranges and choices that they had first.
    """

    def __init__(self, turn: Callable[[str, str], None]) -> None:
        """``turn`` gets the key and the text of a knob that is turned."""
        self._turn = turn
        self.column = models.Column()
        self.knobs: dict[str, Knob] = {}
        self._first: dict[str, Knob] = {}
        self._widgets: dict[str, list[Any]] = {}  # field by key, with a slider for a number
        self._heads: dict[str, Any] = {}  # by the key below
        self._turned = ""  # key of the slider that was turned last: it stays where it was put
        self._filling = False

    def forget(self) -> None:
        """Take new ranges and choices from the next knobs."""
        self._first, self._turned = {}, ""

    def show(self, knobs: Iterable[Knob]) -> None:
        """Show knobs with their present values; there are other widgets only for other knobs."""
        former, self.knobs = self.knobs, {knob.key: self._steady(knob) for knob in knobs}
        if [*former] != [*self.knobs]:
            children = []
            for table, group in groupby(self.knobs.values(), lambda knob: knob.key.partition(".")[0]):
                first, *others = group
                if first.key not in self._heads:
                    self._heads[first.key] = models.Div(text=f"<h2>{escape(table)}</h2>")
                children.append(self._heads[first.key])
                children += [each for knob in (first, *others) for each in self._widgets_of(knob)]
            self.column.children = children
        self._filling = True
        for key, knob in self.knobs.items():
            field, *sliders = self._widgets[key]
            if knob.choices:
                field.options = [*knob.choices]
            field.value = knob.text
            for slider in sliders if key != self._turned else ():
                slider.value = knob.place
        self._filling = False

    def _steady(self, knob: Knob) -> Knob:
        """Knob with the range that its key had first, if its value is in it, and the choices."""
        first = self._first.get(knob.key, knob)
        if knob.range and first.range:
            within = first.range.low <= knob.range.start <= first.range.high
            first = first if within and first.range.unit == knob.range.unit else knob
        self._first[knob.key] = first
        kept = replace(first.range, start=knob.range.start) if knob.range and first.range else None
        return replace(knob, range=kept, choices={**knob.choices, **first.choices})

    def _widgets_of(self, knob: Knob) -> list[Any]:
        """Field of a knob, and a slider for a number."""
        key, title = knob.key, knob.title or knob.key.partition(".")[2] or knob.key
        if key not in self._widgets:
            kind = models.Select if knob.choices else models.TextInput
            self._widgets[key] = [widget(kind, "value", partial(self._typed, key), name=key, title=title)]
            if knob.range is not None:
                look = {"start": 0, "end": 1, "step": knob.step, "show_value": False, "tooltips": False}
                turn, name = partial(self._slid, key), f"{key} slider"
                self._widgets[key].append(widget(models.Slider, "value", turn, name=name, value=0, **look))
        return self._widgets[key]

    def _slid(self, key: str) -> None:
        if not self._filling:
            field, slider = self._widgets[key]
            self._turned = key
            field.value = self.knobs[key].text_at(slider.value)

    def _typed(self, key: str) -> None:
        if not self._filling:
            self._turn(key, self._widgets[key][0].value.strip())


def widget(kind: Any, changed: str, act: Callable[[], None], **properties: Any) -> Any:
    """A widget that calls a function when it is clicked or a property has changed."""
    made = kind(**properties)
    if changed == "click":
        made.on_click(act)
    else:
        made.on_change(changed, lambda attr, old, new: act())
    return made
