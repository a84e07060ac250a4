"""The live page of a scene: its widgets, and what happens when one of them is turned."""

import shlex
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import Future
from functools import partial
from html import escape
from itertools import groupby
from math import nan
from pathlib import Path
from typing import Any

import pandas as pd
from bokeh.document import Document
from bokeh.layouts import column
from bokeh.models import CustomJS, InlineStyleSheet
from bokeh.models.widgets import (
    Button,
    CheckboxGroup,
    Div,
    MultiChoice,
    RangeSlider,
    Select,
    Slider,
    TextInput,
    Toggle,
)
from jinja2 import Template

from drivers.base import paths
from drivers.base.units import quantity
from drivers.engines import REFERENCE, VERLET, codes, installed
from drivers.scene.read_scene import find_scene, read_scene, read_toml, read_value
from drivers.scene.settings import look_up, setting_text, unit_of
from postproc.draw.style import MICRO
from postproc.read.observables import without_unit
from validation.calibration.fit import digits
from validation.checks import short
from validation.explore.desk import Desk
from validation.explore.knobs import Knob
from validation.explore.plots import Plots
from validation.explore.views import (
    AUTO,
    Laid,
    OnCode,
    Question,
    View,
    errors_of,
    expected,
    figure_of,
    fitted,
    forces_csv,
    laid_over,
    on_code,
    scene_file,
    view_of,
)

KEPT = {"scene.toml": scene_file, "forces.csv": forces_csv, "forces.svg": figure_of}  # functions by name of the file
STEP = 0.002  # of a slider from 0 to 1
REST_MS = 300  # after the last turn of a knob, before errors are measured
SAID_S = 0.3  # expected time of a motion from which on it is said
FRAME_MS = 80  # of the moving beads
STYLE = """:host { color: inherit; } .bk-input, .bk-btn, .choices__inner, .choices__list { color: inherit !important;
background-color: light-dark(#fff, #23282d) !important; border-color: light-dark(#bbb, #555) !important; }
.bk-btn.bk-active { background-color: light-dark(#ddd, #444) !important; } table { border-spacing: 12px 0; }
td:not(:first-child) { text-align: right; font-variant-numeric: tabular-nums; }"""
DARK = "dark.active = matchMedia('(prefers-color-scheme: dark)').matches"
SCHEME = "document.documentElement.style.colorScheme = cb_obj.active ? 'dark' : 'light'"


class Page:
    """Page of a scene in one browser: its settings, what it shows of them, and its worker processes."""

    def __init__(
        self, document: Document, question: Question, ranges: tuple[str, ...], runs: Path, results: Path, keep: str
    ) -> None:
        scene = read_scene(question.scene, question.settings)
        self.document, self.ranges, self.runs, self.results, self.name = document, ranges, runs, results, scene.name
        self.tables = read_toml(find_scene(question.scene))
        self.question = self.shown = question
        self.settings = dict(text.split("=", 1) for text in question.settings)
        self.view: View | None = None
        self.before: list[tuple[Question, View]] = []
        self.codes: list[OnCode] = []
        self.errors: dict[str, tuple[float, float]] = {}
        self.knobs: dict[str, Knob] = {}
        self.fields: dict[str, Any] = {}
        self.sliders: dict[str, Slider] = {}
        self.turned, self.filling = "", False
        self.taken: list[tuple[str, str]] = []
        self.plots = Plots()
        call = document.add_next_tick_callback
        self.motions, self.judge, self.work = (Desk(call) for _ in range(3))
        self._build()
        document.title = scene.title or scene.name
        document.template = Template((paths.TEMPLATES / "explore" / "page.html").read_text())
        document.template_variables.update(keep=keep, files=[*KEPT], measured=self.measured)
        document.on_event("document_ready", lambda _: self._compute())

    def close(self) -> None:
        """End all work of the page."""
        for desk in (self.motions, self.judge, self.work):
            desk.close()

    def kept(self, name: str) -> Future[Any]:
        """Text of a file of what is shown, or an error."""
        former = tuple(question for question, _ in self.before)
        return self.judge.result(
            KEPT[name], (self.shown, former, tuple(self.codes)) if name.endswith("svg") else self.shown
        )

    # --- widgets --------------------------------------------------------------------------------------------------

    def _build(self) -> None:
        """Make all widgets, each a root of the document that its template places by name."""
        self.sheet = InlineStyleSheet(css=STYLE)
        texts, names = ("status", "problem", "table", "overlay", "command", "run_said", "fit_said"), [*installed(codes())]
        self.texts = {name: self._make(Div) for name in texts}
        self.texts["problem"].visible = False
        self.gauges = self._make(CheckboxGroup, self._only, "active", inline=True)
        self.window = self._make(RangeSlider, self._zoom, "value", title="shown (µs)", start=0, end=1, value=(0, 1))
        self.time = self._make(Slider, self._at, "value", title="time (µs)", start=0, end=1, value=0)
        self.play = self._make(Toggle, self._play, "active", label="play")
        self.dark = self._make(Toggle, self._paint, "active", label="dark")
        self.column = column(name="knobs", sizing_mode="stretch_width")
        self.other = self._make(TextInput, self._other, "value", title="any other key", placeholder="KEY=VALUE")
        how = [AUTO, REFERENCE, VERLET]
        self.engine = self._make(Select, self._compute, "value", title="computed by", options=how, value=AUTO)
        self.code = self._make(Select, title="run it on", options=names, value=names[0] if names else "")
        self.free = self._make(MultiChoice, title="fit from here: free keys")
        labels = {
            "reset": ("reset", self._reset), "keep": ("keep these curves", self._keep), "drop": ("drop kept curves", self._drop),
            "run": ("run", self._run), "fit": ("fit", self._fit), "take": ("take over the fit", self._take),
        }  # fmt: skip
        self.buttons = {name: self._make(Button, label=label) for name, (label, _) in labels.items()}
        for name, (_, act) in labels.items():
            self.buttons[name].on_click(act)
        self.buttons["take"].visible = False
        named = {
            name: getattr(self, name)
            for name in ("gauges", "window", "time", "play", "dark", "other", "engine", "code", "free")
        }
        for name, model in {**self.texts, **named, **self.buttons, "knobs": self.column, **self.plots.figures}.items():
            model.name = name
            self.document.add_root(model)
        self.dark.js_on_change("active", CustomJS(code=SCHEME))
        self.document.js_on_event("document_ready", CustomJS(args={"dark": self.dark}, code=DARK))
        self._paint()

    def _make(self, kind: Any, act: Callable[[], None] | None = None, changed: str = "", **more: Any) -> Any:
        """A widget; changes of a property call a function."""
        wide = {} if kind in (Button, Toggle, CheckboxGroup) else {"sizing_mode": "stretch_width"}
        made = kind(stylesheets=[self.sheet], **wide, **more)
        if act is not None:
            made.on_change(changed, lambda attr, old, new: act())
        return made

    @property
    def measured(self) -> bool:
        """True if the scene has measured traces."""
        return any("file" in entry for entry in self.tables.get("measured", ()))

    def _fill(self, knobs: Iterable[Knob]) -> None:
        """Show knobs with their present values; widgets are made anew if there are other knobs."""
        former, self.knobs = self.knobs, {knob.key: knob for knob in knobs}
        self.filling = True
        if [*map(_kind, former.values())] != [*map(_kind, self.knobs.values())]:
            self.fields, self.sliders, children = {}, {}, list[Any]()
            for table, group in groupby(self.knobs.values(), lambda knob: knob.key.partition(".")[0]):
                children += [
                    self._make(Div, text=f"<h2>{escape(table)}</h2>"),
                    *(widget for knob in group for widget in self._widgets(knob)),
                ]
            self.column.children = children
            self.free.options = [key for key, knob in self.knobs.items() if knob.free]
        for key, knob in self.knobs.items():
            self.fields[key].value = knob.text
            if key in self.sliders and key != self.turned:
                self.sliders[key].value = knob.place
        self.filling = False

    def _widgets(self, knob: Knob) -> list[Any]:
        """Field of a knob, and slider of a number."""
        key, kind, more = (
            knob.key,
            Select if knob.choices else TextInput,
            {"options": [*knob.choices]} if knob.choices else {},
        )
        title = key.partition(".")[2] or key
        self.fields[key] = self._make(kind, partial(self._typed, key), "value", title=title, value=knob.text, **more)
        if knob.range is None:
            return [self.fields[key]]
        look = {"start": 0, "end": 1, "step": STEP, "value": knob.place, "show_value": False, "tooltips": False}
        self.sliders[key] = self._make(Slider, partial(self._slid, key), "value", **look)
        return [self.fields[key], self.sliders[key]]

    # --- turns ----------------------------------------------------------------------------------------------------

    def _slid(self, key: str) -> None:
        if not self.filling:
            self.turned = key
            self.fields[key].value = self.knobs[key].text_at(self.sliders[key].value)

    def _typed(self, key: str) -> None:
        if not self.filling and self.view is not None:
            self._set(self.knobs[key].settings(self.fields[key].value.strip(), self.view.scene))

    def _other(self) -> None:
        key, equals, text = self.other.value.partition("=")
        if equals:
            self._set({key.strip(): text.strip()})

    def _set(self, changed: dict[str, str]) -> None:
        """Apply settings; those that give the value of the scene file go."""
        for key, text in changed.items():
            self.settings.pop(key, None)
            value = look_up(self.tables, key)
            if not (text == "" and value is None) and read_value(text) != value:
                self.settings[key] = text
        self._compute()

    def _reset(self) -> None:
        self.settings, self.turned, self.other.value = {}, "", ""
        self._compute()

    def _only(self) -> None:
        self.plots.only(self.gauges.labels[i] for i in self.gauges.active)

    def _paint(self) -> None:
        self.plots.paint(dark=self.dark.active)

    def _zoom(self) -> None:
        start, end = self.window.value
        self.plots.forces.x_range.update(start=start, end=end)

    def _at(self) -> None:
        if self.view is not None:
            self.plots.at(self.view, self.time.value / MICRO)

    def _play(self) -> None:
        if self.play.active:
            self.document.add_timeout_callback(self._next_frame, FRAME_MS)

    def _next_frame(self) -> None:
        self.time.value = (
            0 if self.time.value >= self.time.end else min(self.time.value + self.time.end / 100, self.time.end)
        )
        self._play()

    # --- motions --------------------------------------------------------------------------------------------------

    def _compute(self) -> None:
        """Compute the scene with its settings."""
        texts = tuple(f"{key}={text}" for key, text in self.settings.items())
        self.question = question = Question(self.question.scene, texts, self.engine.value)
        self.motions.ask(expected, question, partial(self._expect, question))

    def _expect(self, question: Question, answer: Any) -> None:
        """Show how long a motion takes, or why there is none."""
        if question != self.question:
            return
        self.texts["problem"].visible = isinstance(answer, Exception)
        if self.texts["problem"].visible:
            self.texts["problem"].text = f"<b role='alert'>{escape(str(answer))}</b>"
            return
        engine, takes_s = answer
        if takes_s > SAID_S:
            self.texts["status"].text = f"computing by {engine}: about {takes_s:.2g} s"
        self.motions.ask(view_of, (question, self.ranges), partial(self._show, question))

    def _show(self, question: Question, answer: Any) -> None:
        """Show a motion, then ask for what takes longer."""
        if isinstance(answer, Exception):
            self._expect(question, answer)
            return
        self.view, self.shown, view = answer, question, answer
        self.plots.show(view)
        if question == self.question:
            self._fill(view.knobs)
        labels = [*view.signals]
        if self.gauges.labels != labels:
            self.gauges.update(labels=labels, active=[*range(len(labels))])
            self.plots.show_before(former for _, former in self.before)
        end_us = float(view.time_s[-1]) * MICRO
        if self.time.end != end_us:
            self.time.update(end=end_us, value=min(self.time.value, end_us), step=end_us / 400)
            self.window.update(end=end_us, value=(0, end_us), step=end_us / 400)
        self._at()
        step = quantity(view.scene.time_step_s, "s")
        how = "exact motion" if view.engine == REFERENCE else f"velocity Verlet at {step}"
        self.texts["status"].text = f"{how} ({view.engine}), computed in {view.taken_s * 1e3:.0f} ms"
        self.errors = {}
        self._tabulate([])
        if self.codes:
            self.codes = []
            self.plots.show_codes([])
        command = ("beads", "run", *question.words, "--engine", view.engine)
        self.texts["command"].text = f"<code>{escape(shlex.join(command))}</code>"
        if self.measured:
            self.judge.ask(laid_over, question, partial(self._lay, question))
        self.document.add_timeout_callback(partial(self._rest, question), REST_MS)

    def _rest(self, question: Question) -> None:
        """Measure the errors if no knob was turned meanwhile."""
        if question == self.question:
            self.judge.ask(errors_of, question, partial(self._err, question))

    def _err(self, question: Question, answer: Any) -> None:
        if question == self.question:
            self.errors, notes = ({}, [str(answer)]) if isinstance(answer, Exception) else answer
            self._tabulate(notes)

    def _lay(self, question: Question, answer: Any) -> None:
        """Show measured traces over the motion."""
        if question != self.shown or self.view is None:
            return
        laid: Laid | None = None if isinstance(answer, Exception) else answer
        self.plots.show_measured(laid, self.view)
        if laid is None:
            self.texts["overlay"].text = escape(str(answer))
            return
        words = f"chi-square {laid.chi_square:.5g} of {laid.readings} readings"
        self.texts["overlay"].text = "<br>".join(map(escape, (words, *laid.remarks)))
        if question == self.question and not {knob.key for knob in laid.knobs} <= {*self.knobs}:
            self._fill([*self.knobs.values(), *laid.knobs])

    def _tabulate(self, notes: Sequence[str]) -> None:
        """Table of observables with their errors."""
        assert self.view is not None
        rows = []
        for name, value in self.view.values.items():
            errors = self.errors.get(without_unit(name), (nan, nan))
            rows.append((name, f"{value:.6g}", *map(short, errors[: 1 + (self.view.engine != VERLET)])))
        step = quantity(self.view.scene.time_step_s, "s")
        heads = ("observable", "value", "error", f"error of codes at {step}")
        self.texts["table"].text = table_of([heads[: len(rows[0])] if rows else heads, *rows]) + "<br>".join(
            map(escape, notes)
        )

    # --- what is kept, run and fitted -------------------------------------------------------------------------------

    def _keep(self) -> None:
        if self.view is not None:
            self.before.append((self.shown, self.view))
            self.plots.show_before(view for _, view in self.before)

    def _drop(self) -> None:
        self.before = []
        self.plots.show_before([])

    def _run(self) -> None:
        self._work("run", on_code, (self.shown, self.code.value, self.runs), self._ran)

    def _ran(self, question: Question, run: OnCode) -> list[str]:
        if question == self.shown:
            self.codes = [*(each for each in self.codes if each.engine != run.engine), run]
            self.plots.show_codes(self.codes)
        return [f"{run.engine}:", *run.said]

    def _fit(self) -> None:
        self._work("fit", fitted, (self.shown, tuple(self.free.value), self.results), self._fitted)

    def _fitted(self, _: Question, found: tuple[Path, pd.DataFrame]) -> list[str]:
        folder, table = found
        self.taken, lines = [], [f"{paths.shown(folder)}:"]
        for each in table.itertuples():
            key = str(each.parameter).rpartition(": ")[2]
            (value, error), unit = digits((each.value, each.error), each.value, each.error, each.unit)
            lines.append(f"{key} = {value} ± {error} {unit}")
            self.taken.append((key, setting_text(key, each.value) if unit_of(key) else f"{each.value:.9g} {each.unit}"))
        self.buttons["take"].visible = True
        return lines

    def _take(self) -> None:
        for key, text in self.taken:
            shared = self.knobs[key].shared if key in self.knobs else ()
            self._set(dict.fromkeys((key, *shared), text.strip()))

    def _work(
        self, what: str, function: Callable[[Any], Any], item: Any, then: Callable[[Question, Any], list[str]]
    ) -> None:
        """Do work that takes seconds, and show what it says."""
        button, said, question = self.buttons[what], self.texts[f"{what}_said"], item[0]
        button.disabled, said.text = True, "under way"

        def end(answer: Any) -> None:
            button.disabled = False
            lines = [str(answer)] if isinstance(answer, Exception) else then(question, answer)
            said.text = "<br>".join(map(escape, lines))

        def call(done: Future[Any]) -> None:
            self.document.add_next_tick_callback(partial(end, done.result()))

        self.work.result(function, item).add_done_callback(call)


def table_of(rows: Sequence[Sequence[str]]) -> str:
    """HTML of a table."""
    lines = ("".join(f"<td>{escape(cell)}</td>" for cell in cells) for cells in rows)
    return f"<table>{''.join(f'<tr>{line}</tr>' for line in lines)}</table>"


def _kind(knob: Knob) -> tuple[Any, ...]:
    return knob.key, knob.range is None, tuple(knob.choices)
