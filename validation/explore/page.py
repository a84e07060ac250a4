"""The live page of a scene: its widgets, and what happens when one of them is turned."""

import gc
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from html import escape
from pathlib import Path
from typing import Any

from bokeh import models
from bokeh.document import Document
from jinja2 import Template

from drivers.base import paths
from drivers.base.units import quantity
from drivers.engines import REFERENCE, VERLET, codes, installed
from drivers.scene.read_scene import find_scene, read_scene, read_toml, read_value
from drivers.scene.settings import look_up, setting_texts
from postproc.draw.plot import MICRO
from validation.calibration.parameters import TRIGGER
from validation.explore import plots, views
from validation.explore.desk import Desk
from validation.explore.knobs import Knob
from validation.explore.views import Done, Question, View

FILES: dict[str, Callable[[Question], str]] = {"scene.toml": views.scene_file, "forces.csv": views.forces_csv}
REST_MS = 300  # after the last turn of a knob, before errors are measured
FRAME_MS = 80  # of the moving beads
LEAST_S = 0.1  # between motions of values that are outdated already, as those of a slider on its way
ADDRESS = "history.replaceState(null, '', '?set=' + cb_obj.tags.map(encodeURIComponent).join('&set='))"
SAVE = "save(cb_obj.name, cb_obj.tags[0])"
SAVE_PICTURE = "cb_context.index.find_one(forces).export('svg').to_blob().then((blob) => save('forces.svg', blob))"
TABLES = ("table", "overlay", "run_said", "fit_said")  # texts with columns


class Panel:
    """Column of knobs, by their keys: fields, with sliders for numbers."""

    def __init__(self, turn: Callable[[str, str], None]) -> None:
        """``turn`` gets the key and the text of a knob that is turned."""
        self._turn = turn
        self.column = models.Column()
        self.knobs: dict[str, Knob] = {}
        self.first: dict[str, Knob] = {}  # with the ranges and choices that stay while knobs are turned
        self._widgets: dict[str, list[Any]] = {}
        self._filling = False

    def show(self, knobs: Iterable[Knob], typed: Mapping[str, str]) -> None:
        """Show knobs with their present values; there are other widgets only for other knobs.

        A widget that shows its value already is left alone, since a user may be turning it on: numbers stay as they
        were typed, and sliders where they give these digits.
        """
        former, self.knobs = [*self.knobs], {knob.key: self._steady(knob) for knob in knobs}
        if former != [*self.knobs]:
            self.column.children = [each for knob in self.knobs.values() for each in self._widgets_of(knob)]
        self._filling = True
        for key, knob in self.knobs.items():
            field, *sliders = self._widgets[key]
            field.title = knob.title or key
            if knob.choices:
                field.options = [*knob.choices]
            field.value = typed.get(key, knob.text) if sliders else knob.text
            for slider in sliders:
                if abs(slider.value - knob.place) > 2 * slider.step:
                    slider.value = knob.place
        self._filling = False

    def _steady(self, knob: Knob) -> Knob:
        """Knob with the range and the choices that its key had first, as long as its value is among them."""
        first = self.first.setdefault(knob.key, knob)
        if not first.has(knob):
            first = self.first[knob.key] = knob
        kept = first.range and knob.range and replace(first.range, start=knob.range.start)
        return replace(knob, range=kept, choices=first.choices)

    def _widgets_of(self, knob: Knob) -> list[Any]:
        """Field of a knob, and a slider for a number."""
        key = knob.key
        if key not in self._widgets:
            kind = models.Select if knob.choices else models.TextInput
            act = partial(self._typed, key)
            self._widgets[key] = [widget(kind, "value", act, name=key)]
            if knob.range is not None:
                look = {"start": 0, "end": 1, "step": knob.step, "show_value": False, "tooltips": False}
                act = partial(self._slid, key)
                self._widgets[key].append(widget(models.Slider, "value", act, name=f"{key} slider", value=0, **look))
        return self._widgets[key]

    def _slid(self, key: str) -> None:
        if not self._filling:
            field, slider = self._widgets[key]
            field.value = self.knobs[key].text_at(slider.value) if slider.value or self.first[key].text else ""

    def _typed(self, key: str) -> None:
        if not self._filling:
            self._turn(key, self._widgets[key][0].value.strip())


class Page:
    """Page of a scene in one browser: its settings, what it shows of them, and its worker processes."""

    def __init__(self, document: Document, question: Question, keys: list[str], runs: Path, results: Path) -> None:
        """``keys`` are those of all scenes."""
        scene = read_scene(question.scene, question.settings)
        self.document, self.runs, self.results = document, runs, results
        self.tables = read_toml(find_scene(question.scene))
        self.measured = any("file" in entry for entry in self.tables.get("measured", ()))
        self.given, self.shown = settings_of(question.settings), question
        former = document.session_context.request.arguments.get("set")  # in the address of a page that is loaded again
        texts = question.settings if former is None else (text.decode(errors="replace") for text in former)
        self.question = question._replace(settings=tuple(filter(None, texts)))
        self.other = ""  # key in the field for any other key
        self.view: View | None = None
        self.shown_s = 0.0
        self.aligned: Sequence[Knob] = ()  # of triggers that were found
        self.playing: Any = None  # callback for the next frame
        self.kept: list[str] = []  # looks and command lines of kept curves
        self.found: Mapping[str, str] = {}  # settings by a fit
        self.plots = plots.Plots()
        self.panel = Panel(self._turn)
        self.motions, self.judge, self.works = (Desk(document.add_next_tick_callback) for _ in range(3))
        self.widgets = self._widgets(keys)
        for name, model in (self.widgets | self.plots.figures).items():
            model.name = name
            document.add_root(model)
        for name in FILES:
            self.widgets[name].js_on_change("tags", models.CustomJS(code=SAVE))
        forces = self.plots.figures["forces"]
        self.widgets["forces.svg"].js_on_click(models.CustomJS(args={"forces": forces}, code=SAVE_PICTURE))
        self.widgets["command"].tags = [*self.question.settings]
        self.widgets["command"].js_on_change("tags", models.CustomJS(code=ADDRESS))
        for number, end in enumerate(("start", "end")):
            self.widgets["window"].js_link("value", forces.x_range, end, attr_selector=number)
        document.on_event("document_ready", lambda _: self._compute())
        document.theme, document.title = plots.THEME, scene.title or scene.name
        document.template = Template((paths.TEMPLATES / "explore" / "page.html").read_text())
        marks = ", ".join(f"{code} ({plots.mark_of(code)})" for code in self.widgets["code"].options)
        document.template_variables.update(scene=scene.name, measured=self.measured, marks=marks)

    def close(self) -> None:
        """End all work of the page."""
        for desk in (self.motions, self.judge, self.works):
            desk.close()

    # --- widgets ------------------------------------------------------------------------------------------------------

    def _widgets(self, keys: list[str]) -> dict[str, Any]:
        """All widgets by name; the template of the document has their places."""
        names, line = [*installed(codes())], {"start": 0, "end": 1}
        engine = {"title": "computed by", "options": [views.AUTO, REFERENCE, VERLET], "value": views.AUTO}
        other = {"title": "any other key (beads keys)", "placeholder": "KEY=VALUE", "completions": keys}
        texts = ("problem", "table", "overlay", "command", "kept", "run_said", "fit_said")
        return {
            "knobs": self.panel.column,
            **{name: models.Div(visible=False) for name in texts},
            "status": models.Div(text="computing; after a change of the code it is compiled first"),
            "other": widget(models.AutocompleteInput, "value", self._other, restrict=False, **other),
            "engine": widget(models.Select, "value", self._compute, **engine),
            "window": models.RangeSlider(title="shown (µs)", value=(0, 1), **line),
            "gauges": widget(models.CheckboxGroup, "active", self._only, inline=True),
            "time": widget(models.Slider, "value", self._at, title="time (µs)", value=0, **line),
            "play": widget(models.Toggle, "active", self._play, label="play"),
            "reset": widget(models.Button, "click", self._reset, label="reset"),
            "keep": widget(models.Button, "click", self._keep, label="keep these curves"),
            "drop": widget(models.Button, "click", self._drop, label="drop kept curves"),
            **{name: widget(models.Button, "click", partial(self._save, name), label=f"save {name}") for name in FILES},
            "forces.svg": models.Button(label="save forces.svg"),
            "code": models.Select(title="run it on", options=names, value="".join(names[:1])),
            "run": widget(models.Button, "click", self._run, label="run", disabled=not names),
            "free": models.MultiSelect(size=8, title="free keys; gains and triggers that are not exact are free, too"),
            "fit": widget(models.Button, "click", self._fit, label="fit"),
            "take": widget(models.Button, "click", self._take, label="take over the fit", visible=False),
        }

    def _say(self, name: str, lines: Iterable[str], *, failed: bool = False) -> None:
        """Show lines of text, or of an error, or hide their place without any."""
        text = "\n".join(map(escape, lines))
        form = '<b role="alert">{}</b>' if failed else "<pre>{}</pre>" if name in TABLES else "{}"
        self.widgets[name].update(text=text and form.format(text), visible=bool(text))

    # --- turns --------------------------------------------------------------------------------------------------------

    def _turn(self, key: str, text: str) -> None:
        if self.view is not None:
            self._set(self.panel.knobs[key].settings(text, self.view.scene))

    def _other(self) -> None:
        key, equals, text = self.widgets["other"].value.partition("=")
        if self.widgets["problem"].visible:  # what may have been refused goes
            kept = (text for text in self.question.settings if not text.startswith(f"{self.other}="))
            self.question = self.question._replace(settings=tuple(kept))
        self.other = key.strip()
        if equals:
            self._set({self.other: text.strip()})
        elif key:
            self._say("problem", [f"found {key}; allowed: KEY=VALUE"], failed=True)
        else:
            self._compute()

    def _set(self, changed: Mapping[str, str]) -> None:
        """Apply settings; those that give the value of the scene file go."""
        settings = {key: text for key, text in settings_of(self.question.settings).items() if key not in changed}
        for key, text in changed.items():
            value = look_up(self.tables, key)
            if not (text == "" and value is None) and read_value(text) != value:
                settings[key] = text
        self._compute(settings)

    def _reset(self) -> None:
        self.widgets["other"].value = ""
        self.panel.first = {}
        self._compute(self.given)

    def _only(self) -> None:
        gauges = self.widgets["gauges"]
        self.plots.only(gauges.labels[place] for place in gauges.active)

    def _keep(self) -> None:
        self.kept.append(f"{self.plots.keep()}: {self.shown.command('run')}")
        self._say("kept", self.kept)

    def _drop(self) -> None:
        self.kept = []
        self.plots.drop()
        self._say("kept", [])

    def _at(self) -> None:
        if self.view is not None:
            self.plots.at(self.view, self.widgets["time"].value / MICRO)

    def _play(self) -> None:
        if self.widgets["play"].active:
            self.playing = self.document.add_periodic_callback(self._next_frame, FRAME_MS)
        else:
            self.document.remove_periodic_callback(self.playing)

    def _next_frame(self) -> None:
        at = self.widgets["time"]
        at.value = 0 if at.value >= at.end else min(at.value + at.end / 100, at.end)

    def _save(self, name: str) -> None:
        """Send a file of the present scene to the browser, which saves it."""
        self.judge.result(FILES[name], self.question, partial(self._send, name))

    def _send(self, name: str, answer: Any) -> None:
        failed = isinstance(answer, Exception)
        self._say("problem", [str(answer)] if failed else [], failed=failed)
        if not failed:
            self.widgets[name].tags = [answer, time.monotonic()]  # always other tags, which the browser acts on

    # --- motions ------------------------------------------------------------------------------------------------------

    def _compute(self, settings: Mapping[str, str] | None = None) -> None:
        """Compute the scene with settings, without them those that it has."""
        texts = self.question.settings if settings is None else setting_texts(settings)
        self.question = question = self.question._replace(settings=texts, engine=self.widgets["engine"].value)
        self.motions.ask(views.quick_view_of, question, partial(self._show, question))

    def _show(self, question: Question, answer: Any) -> None:
        """Show the forces of a motion, how long it takes, or why there is none."""
        newest, failed = question == self.question, isinstance(answer, Exception)
        if isinstance(answer, View):
            if not newest and time.monotonic() < self.shown_s + LEAST_S:
                return
            self.view, self.shown, self.shown_s = answer, question, time.monotonic()
            self.plots.show(answer)
            self.document.add_next_tick_callback(partial(self._show_all, question, answer))
        elif newest:
            self._say("status", [] if failed else [f"computing {answer}"])
            if not failed:
                self.motions.ask(views.view_of, question, partial(self._show, question))
        if newest:
            self._say("problem", [str(answer)] if failed else [], failed=failed)

    def _show_all(self, question: Question, view: View) -> None:
        """Show what else is known of a motion, then ask for what takes longer."""
        if view is not self.view:
            return
        self.plots.show_cells(view)
        if question == self.question:
            self._fill(view.knobs)
        gauges, at, end_us = self.widgets["gauges"], self.widgets["time"], float(f"{view.time_s[-1] * MICRO:.9g}")
        if gauges.labels != [*view.signals]:
            gauges.update(labels=[*view.signals], active=[*range(len(view.signals))])
            self._only()
        if at.end != end_us:
            at.update(end=end_us, value=min(at.value, end_us), step=end_us / 400)
            self.widgets["window"].update(end=end_us, value=(0, end_us), step=end_us / 400)
        self._at()
        step = quantity(view.scene.time_step_s, "s")
        how = "exact motion" if view.engine == REFERENCE else f"velocity Verlet at {step}"
        hint = "" if view.signals else "; no gauges: name beads in sensors"
        self._say("status", [f"{how} ({view.engine}), computed in {view.taken_s * 1e3:.0f} ms{hint}"])
        self._say("table", view.table)
        if not self.widgets["run"].disabled:
            self._say("run_said", [])
        for code in self.widgets["code"].options:
            self.plots.put(code, {})
        self._say("command", [question.command("run", ("--engine", view.engine))])
        if self.measured:
            self._say("overlay", ["chi-square: being computed"])
            self.judge.ask(views.laid_over, question, partial(self._lay, question))
        else:
            self.document.add_timeout_callback(partial(self._rest, question), REST_MS)

    def _fill(self, knobs: Sequence[Knob]) -> None:
        """Show knobs with their present values, and those of triggers that were found."""
        stated = {knob.key for knob in knobs}
        knobs = [*knobs, *(knob for knob in self.aligned if knob.key not in stated)]
        knobs = sorted(knobs, key=lambda knob: knob.key if knob.key.endswith(TRIGGER) else "")
        self.panel.show(knobs, settings_of(self.question.settings))
        self.widgets["free"].options = [(knob.free, key) for key, knob in self.panel.knobs.items() if knob.free]

    def _rest(self, question: Question) -> None:
        """Measure the errors, and state the settings in the address, if no knob was turned meanwhile."""
        if question == self.question:
            self.widgets["command"].tags = [*question.settings]
            gc.collect()  # else the data of former motions wait for it, in circles with the models that showed them
            self.judge.ask(views.errors_of, question, partial(self._err, question))

    def _err(self, question: Question, answer: Any) -> None:
        if question == self.question:
            self._end("table", question, answer)

    def _lay(self, question: Question, answer: Any) -> None:
        """Show measured traces over the motion, and residuals."""
        self.document.add_timeout_callback(partial(self._rest, question), REST_MS)
        if question == self.shown and self.view is not None:
            for part in (views.MEASURED, views.RESIDUAL) if isinstance(answer, Exception) else ():
                self.plots.put(part, {})
            self.aligned = self._end("overlay", question, answer).knobs or self.aligned
            if question == self.question:
                self._fill(self.view.knobs)

    def _end(self, place: str, question: Question, answer: Any) -> Done:
        """Show what work has found: lines in a place, and curves if their motion is still shown; or its error."""
        failed = isinstance(answer, Exception)
        done = Done([str(answer)]) if failed else answer
        self._say(place, done.lines, failed=failed)
        for part, curves in done.curves.items() if question == self.shown else ():
            self.plots.put(part, curves)
        if done.settings:
            self.found, self.widgets["take"].visible = done.settings, True
        return done

    # --- what is run and fitted ---------------------------------------------------------------------------------------

    def _run(self) -> None:
        self._work("run", views.on_code, (self.question, self.widgets["code"].value, self.runs))

    def _fit(self) -> None:
        self._work("fit", views.fitted, (self.question, (*self.widgets["free"].value,), self.results))

    def _take(self) -> None:
        self._set(self.found)

    def _work(self, what: str, work: Callable[[Any], Any], item: Any) -> None:
        """Do work that takes seconds, and show what it has found."""
        self.widgets[what].disabled = True
        self._say(f"{what}_said", ["under way"])
        if what == "fit":
            self.widgets["take"].visible = False

        def end(answer: Any) -> None:
            self.widgets[what].disabled = False
            self._end(f"{what}_said", item[0], answer)

        self.works.result(work, item, end)


def widget(kind: Any, changed: str, act: Callable[[], None], **properties: Any) -> Any:
    """A widget that calls a function when it is clicked or a property has changed."""
    made = kind(**properties)
    if changed == "click":
        made.on_click(act)
    else:
        made.on_change(changed, lambda attr, old, new: act())
    return made


def settings_of(texts: Iterable[str]) -> dict[str, str]:
    """Settings by key."""
    return dict(text.split("=", 1) for text in texts if "=" in text)
