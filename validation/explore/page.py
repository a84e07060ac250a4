"""The live page of a scene: its widgets, and what happens when one of them is turned."""

import gc
import shlex
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import Future
from functools import partial
from html import escape
from math import nan
from pathlib import Path
from typing import Any

from bokeh import models
from bokeh.document import Document
from jinja2 import Template

from drivers.base import paths
from drivers.base.units import quantity
from drivers.engines import REFERENCE, VERLET, codes, installed
from drivers.scene.read_scene import find_scene, read_scene, read_toml, read_value
from drivers.scene.settings import look_up
from postproc.draw.plot import MICRO
from postproc.read.observables import without_unit
from validation.checks import short
from validation.commands.key_commands import key_tables
from validation.explore import plots, views
from validation.explore.desk import Desk
from validation.explore.knobs import Knob
from validation.explore.panel import Panel, widget
from validation.explore.views import Done, Question, View

FILES: dict[str, Callable[[Any], Any]] = {  # functions of what is shown, by name of the file
    "scene.toml": views.scene_file,
    "forces.csv": views.forces_csv,
    "forces.svg": views.figure_of,
}
REST_MS = 300  # after the last turn of a knob, before errors are measured
FRAME_MS = 80  # of the moving beads
LEAST_S = 0.1  # between motions of values that are outdated already, as those of a slider on its way
DARK = """const scheme = matchMedia('(prefers-color-scheme: dark)');
scheme.addEventListener('change', () => { dark.active = scheme.matches }); dark.active = scheme.matches"""
SCHEME = "document.documentElement.style.colorScheme = cb_obj.active ? 'dark' : 'light'"
ADDRESS = "history.replaceState(null, '', '?set=' + cb_obj.tags.map(encodeURIComponent).join('&set='))"
ALERT = '<b role="alert">{}</b>'


class Page:
    """Page of a scene in one browser: its settings, what it shows of them, and its worker processes."""

    def __init__(
        self, document: Document, question: Question, ranges: tuple[str, ...], runs: Path, results: Path, files: str
    ) -> None:
        """``files`` is the address of its ``FILES``, relative to that of the page."""
        scene = read_scene(question.scene, question.settings)
        self.document, self.ranges, self.runs, self.results = document, ranges, runs, results
        self.tables = read_toml(find_scene(question.scene))
        self.measured = any("file" in entry for entry in self.tables.get("measured", ()))
        self.question = self.shown = question
        self.given = settings_of(question.settings)
        kept = document.session_context.request.arguments.get("set")  # in the address of a page that is loaded again
        self.settings = self.given if kept is None else settings_of(text.decode(errors="replace") for text in kept)
        self.view: View | None = None
        self.shown_s = 0.0
        self.aligned: Sequence[Knob] = ()  # of triggers that were found
        self.found: Mapping[str, str] = {}  # settings by a fit
        self.plots = plots.Plots()
        self.motions, self.judge, self.works = (Desk(document.add_next_tick_callback) for _ in range(3))
        self.panel = Panel(self._turn)
        self.widgets = self._widgets()
        for name, model in (self.widgets | self.plots.figures).items():
            model.name = name
            document.add_root(model)
        self._paint()
        self.widgets["command"].js_on_change("tags", models.CustomJS(code=ADDRESS))
        self.widgets["dark"].js_on_change("active", models.CustomJS(code=SCHEME))
        for number, end in enumerate(("start", "end")):
            self.widgets["window"].js_link("value", self.plots.figures["forces"].x_range, end, attr_selector=number)
        document.js_on_event("document_ready", models.CustomJS(args={"dark": self.widgets["dark"]}, code=DARK))
        document.on_event("document_ready", lambda _: self._compute())
        document.title = scene.title or scene.name
        document.template = Template((paths.TEMPLATES / "explore" / "page.html").read_text())
        document.template_variables.update(keep=files, files=[*FILES], scene=scene.name, measured=self.measured)

    def close(self) -> None:
        """End all work of the page."""
        for desk in (self.motions, self.judge, self.works):
            desk.close()

    def file(self, name: str) -> Future[Any]:
        """Text of a file of what is shown, or an error."""
        return self.judge.result(FILES[name], self.plots.curves if name.endswith("svg") else self.shown)

    # --- widgets ------------------------------------------------------------------------------------------------------

    def _widgets(self) -> dict[str, Any]:
        """All widgets by name; the template of the document has their places."""
        names, line = [*installed(codes())], {"start": 0, "end": 1}
        engine = {"title": "computed by", "options": [views.AUTO, REFERENCE, VERLET], "value": views.AUTO}
        other: dict[str, Any] = {"title": "any other key (beads keys)", "placeholder": "KEY=VALUE", "restrict": False}
        other["completions"] = [key for key, *_ in key_tables()["scene"]]
        texts = ("problem", "table", "overlay", "command", "run_said", "fit_said")
        return {
            "knobs": self.panel.column,
            **{name: models.Div(visible=False) for name in texts},
            "status": models.Div(text="computing; after a change of the code it is compiled first"),
            "other": widget(models.AutocompleteInput, "value", self._other, **other),
            "engine": widget(models.Select, "value", self._compute, **engine),
            "window": models.RangeSlider(title="shown (µs)", value=(0, 1), **line),
            "gauges": widget(models.CheckboxGroup, "active", self._only, inline=True),
            "time": widget(models.Slider, "value", self._at, title="time (µs)", value=0, **line),
            "play": widget(models.Toggle, "active", self._play, label="play"),
            "dark": widget(models.Toggle, "active", self._paint, label="dark"),
            "reset": widget(models.Button, "click", self._reset, label="reset"),
            "keep": widget(models.Button, "click", self.plots.keep, label="keep these curves"),
            "drop": widget(models.Button, "click", self.plots.drop, label="drop kept curves"),
            "code": models.Select(title="run it on", options=names, value="".join(names[:1])),
            "run": widget(models.Button, "click", self._run, label="run", disabled=not names),
            "free": models.MultiSelect(size=8, title="free keys; gains and triggers that are not exact are free, too"),
            "fit": widget(models.Button, "click", self._fit, label="fit"),
            "take": widget(models.Button, "click", self._take, label="take over the fit", visible=False),
        }

    def _say(self, name: str, lines: Iterable[str], form: str = "{}") -> None:
        """Show lines of text, or hide their place without any."""
        text = "<br>".join(map(escape, lines))
        self.widgets[name].update(text=text and form.format(text), visible=bool(text))

    # --- turns --------------------------------------------------------------------------------------------------------

    def _turn(self, key: str, text: str) -> None:
        if self.view is not None:
            self._set(self.panel.knobs[key].settings(text, self.view.scene))

    def _other(self) -> None:
        key, equals, text = self.widgets["other"].value.partition("=")
        if self.widgets["problem"].visible:  # what was refused goes
            self.settings = settings_of(self.shown.settings)
        if equals:
            self._set({key.strip(): text.strip()})

    def _set(self, changed: Mapping[str, str]) -> None:
        """Apply settings; those that give the value of the scene file go."""
        self.settings = {key: text for key, text in self.settings.items() if key not in changed}
        for key, text in changed.items():
            value = look_up(self.tables, key)
            if not (text == "" and value is None) and read_value(text) != value:
                self.settings[key] = text
        self._compute()

    def _reset(self) -> None:
        self.settings, self.widgets["other"].value = self.given, ""
        self.panel.forget()
        self._compute()

    def _only(self) -> None:
        gauges = self.widgets["gauges"]
        self.plots.only(gauges.labels[place] for place in gauges.active)

    def _paint(self) -> None:
        self.document.theme = plots.theme(dark=self.widgets["dark"].active)

    def _at(self) -> None:
        if self.view is not None:
            self.plots.at(self.view, self.widgets["time"].value / MICRO)

    def _play(self) -> None:
        """Show the next frame, and so on until the toggle is released."""
        if self.widgets["play"].active:
            at = self.widgets["time"]
            at.value = 0 if at.value >= at.end else min(at.value + at.end / 100, at.end)
            self.document.add_timeout_callback(self._play, FRAME_MS)

    def _fill(self, knobs: Sequence[Knob]) -> None:
        """Show knobs with their present values, and those of triggers that were found."""
        stated = {knob.key for knob in knobs}
        self.panel.show([*knobs, *(knob for knob in self.aligned if knob.key not in stated)])
        self.widgets["free"].options = [key for key, knob in self.panel.knobs.items() if knob.free]

    # --- motions ------------------------------------------------------------------------------------------------------

    def _compute(self) -> None:
        """Compute the scene with its settings."""
        texts = tuple(f"{key}={text}" for key, text in self.settings.items())
        self.question = question = Question(self.question.scene, texts, self.widgets["engine"].value)
        self.motions.ask(views.quick_view_of, (question, self.ranges), partial(self._show, question))

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
                self.motions.ask(views.view_of, (question, self.ranges), partial(self._show, question))
        if newest:
            self._say("problem", [str(answer)] if failed else [], ALERT)

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
        self._tabulate({}, ["errors are being measured"])
        if not self.widgets["run"].disabled:
            self._say("run_said", [])
        for code in self.widgets["code"].options:
            self.plots.put(code, {})
        command = ("beads", "run", *question.words, "--engine", view.engine)
        self._say("command", [shlex.join(command)], "<code>{}</code>")
        if self.measured:
            self._say("overlay", ["chi-square: being computed"])
            self.judge.ask(views.laid_over, question, partial(self._lay, question))
        else:
            self.document.add_timeout_callback(partial(self._rest, question), REST_MS)

    def _rest(self, question: Question) -> None:
        """Measure the errors, and state the settings in the address, if no knob was turned meanwhile."""
        if question == self.question:
            self.widgets["command"].tags = [*question.settings]
            gc.collect()  # else the data of former motions wait for it, in circles with the models that showed them
            self.judge.ask(views.errors_of, question, partial(self._err, question))

    def _err(self, question: Question, answer: Any) -> None:
        if question == self.question:
            self._tabulate(*(({}, [str(answer)]) if isinstance(answer, Exception) else answer))

    def _lay(self, question: Question, answer: Any) -> None:
        """Show measured traces over the motion, and residuals."""
        self.document.add_timeout_callback(partial(self._rest, question), REST_MS)
        if question == self.shown and self.view is not None:
            for part in (views.MEASURED, views.RESIDUAL) if isinstance(answer, Exception) else ():
                self.plots.put(part, {})
            self._end("overlay", question, answer)
            if question == self.question:
                self.aligned = answer.knobs if isinstance(answer, Done) else self.aligned
                self._fill(self.view.knobs)

    def _end(self, place: str, question: Question, answer: Any) -> None:
        """Show what work has found: lines in a place, and curves if their motion is still shown; or its error."""
        failed = isinstance(answer, Exception)
        done = Done([str(answer)]) if failed else answer
        self._say(place, done.lines, ALERT if failed else "{}")
        for part, curves in done.curves.items() if question == self.shown else ():
            self.plots.put(part, curves)
        if done.settings:
            self.found, self.widgets["take"].visible = done.settings, True

    def _tabulate(self, errors: dict[str, tuple[float, float]], notes: Sequence[str]) -> None:
        """Table of observables with their errors."""
        assert self.view is not None
        heads = ["observable", "value", "relative error", f"of codes at {quantity(self.view.scene.time_step_s, 's')}"]
        rows = [heads, *(
            [name, f"{value:.6g}", *map(short, errors.get(without_unit(name), (nan, nan)))]
            for name, value in self.view.values.items()
        )]  # fmt: skip
        columns = 3 if self.view.engine == VERLET else 4
        lines = ("".join(f"<td>{escape(cell)}</td>" for cell in cells[:columns]) for cells in rows)
        table = "".join(f"<tr>{line}</tr>" for line in lines)
        self.widgets["table"].update(text=f"<table>{table}</table>{'<br>'.join(map(escape, notes))}", visible=True)

    # --- what is run and fitted ---------------------------------------------------------------------------------------

    def _run(self) -> None:
        self._work("run", views.on_code, (self.shown, self.widgets["code"].value, self.runs))

    def _fit(self) -> None:
        self._work("fit", views.fitted, (self.shown, (*self.widgets["free"].value,), self.results))

    def _take(self) -> None:
        self._set(self.found)

    def _work(self, what: str, work: Callable[[Any], Any], item: Any) -> None:
        """Do work that takes seconds, and show what it has found."""
        self.widgets[what].disabled = True
        self._say(f"{what}_said", ["under way"])

        def end(answer: Any) -> None:
            self.widgets[what].disabled = False
            self._end(f"{what}_said", item[0], answer)

        self.works.result(work, item, end)


def settings_of(texts: Iterable[str]) -> dict[str, str]:
    """Settings by key."""
    return dict(text.split("=", 1) for text in texts if "=" in text)
