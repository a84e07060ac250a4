"""The live page of a scene: its widgets, and what happens when one of them is turned."""

import gc
import shlex
import time
from collections.abc import Callable, Iterable, Sequence
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
from drivers.scene.settings import look_up, setting_text, unit_of
from postproc.draw.plot import MICRO
from postproc.read.observables import without_unit
from validation.calibration.fit import LAWS, PARAMETERS, Tables, digits, rows_of
from validation.checks import short
from validation.explore import plots, views
from validation.explore.desk import Desk
from validation.explore.knobs import Knob
from validation.explore.panel import STYLE, Panel, widget
from validation.explore.views import Question, View

KEPT: dict[str, Callable[[Any], Any]] = {  # functions of what is shown, by name of the file
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
ALERT = '<b role="alert">{}</b>'


class Page:
    """Page of a scene in one browser: its settings, what it shows of them, and its worker processes."""

    def __init__(
        self, document: Document, question: Question, ranges: tuple[str, ...], runs: Path, results: Path, keep: str
    ) -> None:
        scene = read_scene(question.scene, question.settings)
        self.document, self.ranges, self.runs, self.results, self.name = document, ranges, runs, results, scene.name
        self.tables = read_toml(find_scene(question.scene))
        self.measured = any("file" in entry for entry in self.tables.get("measured", ()))
        self.question = self.shown = question
        self.given = dict(text.split("=", 1) for text in question.settings)
        self.settings = {**self.given}
        self.view: View | None = None
        self.before: list[View] = []
        self.codes: list[str] = []  # that have run what is shown
        self.aligned: list[Knob] = []  # of triggers that were found
        self.tried = ""  # last of other keys
        self.playing: Any = None
        self.shown_s = 0.0
        self.found: list[tuple[str, str]] = []  # settings by a fit
        self.plots = plots.Plots()
        self.motions, self.judge, self.works = (Desk(document.add_next_tick_callback) for _ in range(3))
        self.make = partial(widget, models.InlineStyleSheet(css=STYLE))
        self.panel = Panel(self.make, self._turn)
        self.widgets = self._widgets()
        for name, model in (self.widgets | self.plots.figures).items():
            model.name = name
            document.add_root(model)
        self._paint()
        self.widgets["dark"].js_on_change("active", models.CustomJS(code=SCHEME))
        document.js_on_event("document_ready", models.CustomJS(args={"dark": self.widgets["dark"]}, code=DARK))
        document.on_event("document_ready", lambda _: self._compute())
        document.title = scene.title or scene.name
        document.template = Template((paths.TEMPLATES / "explore" / "page.html").read_text())
        document.template_variables.update(keep=keep, files=[*KEPT], measured=self.measured)

    def close(self) -> None:
        """End all work of the page."""
        for desk in (self.motions, self.judge, self.works):
            desk.close()

    def kept(self, name: str) -> Future[Any]:
        """Text of a file of what is shown, or an error."""
        return self.judge.result(KEPT[name], self.plots.curves if name.endswith("svg") else self.shown)

    # --- widgets ------------------------------------------------------------------------------------------------------

    def _widgets(self) -> dict[str, Any]:
        """All widgets but the knobs, by name; the template of the document has their places."""
        names, line = [*installed(codes())], {"start": 0, "end": 1}
        texts = ("problem", "table", "overlay", "command", "run_said", "fit_said")
        kinds: dict[str, tuple[Any, dict[str, Any], str, Callable[[], None] | None]] = {
            **{name: (models.Div, {"visible": name != "problem"}, "", None) for name in texts},
            "status": (models.Div, {"text": "computing; after a change of the code it is compiled first"}, "", None),
            "other": (models.TextInput, {"title": "any other key", "placeholder": "KEY=VALUE"}, "value", self._other),
            "engine": (models.Select, {"title": "computed by", "options": [views.AUTO, REFERENCE, VERLET],
                                       "value": views.AUTO}, "value", self._compute),
            "window": (models.RangeSlider, {"title": "shown (µs)", "value": (0, 1), **line}, "value", self._zoom),
            "gauges": (models.CheckboxGroup, {"inline": True}, "active", self._only),
            "time": (models.Slider, {"title": "time (µs)", "value": 0, **line}, "value", self._at),
            "play": (models.Toggle, {"label": "play"}, "active", self._play),
            "dark": (models.Toggle, {"label": "dark"}, "active", self._paint),
            "reset": (models.Button, {"label": "reset"}, "click", self._reset),
            "keep": (models.Button, {"label": "keep these curves"}, "click", self._keep),
            "drop": (models.Button, {"label": "drop kept curves"}, "click", self._drop),
            "code": (models.Select, {"title": "run it on", "options": names, "value": "".join(names[:1])}, "", None),
            "run": (models.Button, {"label": "run", "disabled": not names}, "click", self._run),
            "free": (models.CheckboxGroup, {}, "", None),
            "fit": (models.Button, {"label": "fit"}, "click", self._fit),
            "take": (models.Button, {"label": "take over the fit", "visible": False}, "click", self._take),
        }  # fmt: skip
        made = {name: self.make(kind, changed, act, **more) for name, (kind, more, changed, act) in kinds.items()}
        return made | {"knobs": self.panel.column}

    def _say(self, name: str, lines: Iterable[str], form: str = "{}") -> None:
        """Show lines of text."""
        self.widgets[name].text = form.format("<br>".join(map(escape, lines)))

    # --- turns --------------------------------------------------------------------------------------------------------

    def _turn(self, key: str, text: str) -> None:
        if self.view is not None:
            self._set(self.panel.knobs[key].settings(text, self.view.scene))

    def _other(self) -> None:
        self.settings.pop(self.tried, None)  # which was refused
        key, equals, text = self.widgets["other"].value.partition("=")
        if equals:
            self.tried = key.strip()
            self._set({self.tried: text.strip()})

    def _set(self, changed: dict[str, str]) -> None:
        """Apply settings; those that give the value of the scene file go."""
        for key, text in changed.items():
            self.settings.pop(key, None)
            value = look_up(self.tables, key)
            if not (text == "" and value is None) and read_value(text) != value:
                self.settings[key] = text
        self._compute()

    def _reset(self) -> None:
        self.settings, self.widgets["other"].value = {**self.given}, ""
        self.panel.forget()
        self._compute()

    def _only(self) -> None:
        gauges = self.widgets["gauges"]
        self.plots.only(gauges.labels[place] for place in gauges.active)

    def _paint(self) -> None:
        self.plots.paint(dark=self.widgets["dark"].active)

    def _zoom(self) -> None:
        start, end = self.widgets["window"].value
        self.plots.figures["forces"].x_range.update(start=start, end=end)

    def _at(self) -> None:
        if self.view is not None:
            self.plots.at(self.view, self.widgets["time"].value / MICRO)

    def _play(self) -> None:
        if self.playing is not None:
            self.document.remove_periodic_callback(self.playing)
        active = self.widgets["play"].active
        self.playing = self.document.add_periodic_callback(self._next_frame, FRAME_MS) if active else None

    def _next_frame(self) -> None:
        at = self.widgets["time"]
        at.value = 0 if at.value >= at.end else min(at.value + at.end / 100, at.end)

    def _fill(self, knobs: Iterable[Knob]) -> None:
        """Show knobs with their present values; free keys stay chosen."""
        self.panel.show(knobs)
        free, labels = self.widgets["free"], [key for key, knob in self.panel.knobs.items() if knob.free]
        if free.labels != labels:
            chosen = {free.labels[place] for place in free.active}
            free.update(labels=labels, active=[place for place, key in enumerate(labels) if key in chosen])

    # --- motions ------------------------------------------------------------------------------------------------------

    def _compute(self) -> None:
        """Compute the scene with its settings."""
        texts = tuple(f"{key}={text}" for key, text in self.settings.items())
        self.question = question = Question(self.question.scene, texts, self.widgets["engine"].value)
        self.motions.ask(views.quick_view_of, (question, self.ranges), partial(self._show, question))

    def _show(self, question: Question, answer: Any) -> None:
        """Show the forces of a motion, how long it takes, or why there is none."""
        if isinstance(answer, View):
            if question != self.question and time.monotonic() < self.shown_s + LEAST_S:
                return
            self.view, self.shown, self.shown_s, self.tried = answer, question, time.monotonic(), ""
            self.plots.show(answer)
            self.document.add_next_tick_callback(partial(self._show_all, question, answer))
        elif question == self.question and not isinstance(answer, Exception):
            self._say("status", [f"computing {answer}"])
            self.motions.ask(views.view_of, (question, self.ranges), partial(self._show, question))
        if question == self.question:
            self.widgets["problem"].visible = isinstance(answer, Exception)
            if isinstance(answer, Exception):
                self._say("status", [])
            self._say("problem", [str(answer)] if isinstance(answer, Exception) else [], ALERT)

    def _show_all(self, question: Question, view: View) -> None:
        """Show what else is known of a motion, then ask for what takes longer."""
        if view is not self.view:
            return
        self.plots.show_cells(view)
        if question == self.question:
            stated = {knob.key for knob in view.knobs}
            self._fill([*view.knobs, *(knob for knob in self.aligned if knob.key not in stated)])
        gauges, at, end_us = self.widgets["gauges"], self.widgets["time"], float(f"{view.time_s[-1] * MICRO:.9g}")
        if gauges.labels != [*view.signals]:
            gauges.update(labels=[*view.signals], active=[*range(len(view.signals))])
            self._show_before()
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
        while self.codes:
            self.plots.put(self.codes.pop(), {})
        command = ("beads", "run", *question.words, "--engine", view.engine)
        self._say("command", [shlex.join(command)], "<code>{}</code>")
        if self.measured:
            self._say("overlay", ["chi-square: being computed"])
            self.judge.ask(views.laid_over, question, partial(self._lay, question))
        else:
            self.document.add_timeout_callback(partial(self._rest, question), REST_MS)

    def _rest(self, question: Question) -> None:
        """Measure the errors if no knob was turned meanwhile."""
        if question == self.question:
            gc.collect()  # else the data of former motions wait for it, in circles with the models that showed them
            self.judge.ask(views.errors_of, question, partial(self._err, question))

    def _err(self, question: Question, answer: Any) -> None:
        if question == self.question:
            self._tabulate(*(({}, [str(answer)]) if isinstance(answer, Exception) else answer))

    def _lay(self, question: Question, answer: Any) -> None:
        """Show measured traces over the motion, above its static load, and residuals."""
        self.document.add_timeout_callback(partial(self._rest, question), REST_MS)
        if question != self.shown or self.view is None:
            return
        laid: dict[str, Any] = {} if isinstance(answer, Exception) else answer.gauges
        signals = self.view.signals
        dots = {name: (time_s * MICRO, force_N + signals[name][0]) for name, (time_s, force_N, *_) in laid.items()}
        self.plots.put(views.MEASURED, dots)
        self.plots.put(views.RESIDUAL, {name: (time_s * MICRO, left_N) for name, (*_, time_s, left_N) in laid.items()})
        if isinstance(answer, Exception):
            self._say("overlay", [str(answer)], ALERT)
            return
        words = f"chi-square {answer.chi_square:.5g} of {answer.readings} readings"
        self._say("overlay", [f"{words}, {answer.chi_square / answer.readings:.3g} each", *answer.remarks])
        if question == self.question and (answer.knobs or self.aligned):
            others = [knob for key, knob in self.panel.knobs.items() if key not in {each.key for each in answer.knobs}]
            self.aligned = answer.knobs
            self._fill([*others, *answer.knobs])

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
        self._say("table", notes, f"<table>{''.join(f'<tr>{line}</tr>' for line in lines)}</table>{{}}")

    # --- what is kept, run and fitted ---------------------------------------------------------------------------------

    def _keep(self) -> None:
        if self.view is not None:
            self.before.append(self.view)
        self._show_before()

    def _drop(self) -> None:
        self.before = []
        self._show_before()

    def _show_before(self) -> None:
        kept = self.before
        gauges = dict.fromkeys(name for view in kept for name in view.signals)
        curves = {
            name: [(view.time_s * MICRO, view.signals[name]) for view in kept if name in view.signals]
            for name in gauges
        }
        self.plots.put(views.BEFORE, {name: plots.joined(each) for name, each in curves.items()})

    def _run(self) -> None:
        self._work("run", views.on_code, (self.shown, self.widgets["code"].value, self.runs), self._ran)

    def _ran(self, question: Question, run: views.OnCode) -> list[str]:
        """Show the points of a run on a code, with what it says."""
        if question == self.shown:
            self.codes.append(run.engine)
            every = slice(None, None, max(len(run.time_s) // views.POINTS, 1))
            points = {name: (run.time_s[every] * MICRO, force_N[every]) for name, force_N in run.signals.items()}
            self.plots.put(run.engine, points)
        return [f"{run.engine}:", *run.said]

    def _fit(self) -> None:
        free = tuple(self.widgets["free"].labels[place] for place in self.widgets["free"].active)
        self._work("fit", views.fitted, (self.shown, free, self.results), self._fitted)

    def _fitted(self, _: Question, found: tuple[Path, Tables]) -> list[str]:
        """Show the parameters of a fit and how well it fits."""
        (law,) = rows_of(found[1][LAWS])
        fits = f"chi-square {law.chi_square:.5g} with {law.freedom:g} degrees of freedom"
        self.found, lines = [], [f"{paths.shown(found[0])}: {fits}, probability {short(law.probability)}"]
        for each in rows_of(found[1][PARAMETERS]):
            key = each.parameter.rpartition(": ")[2]
            (value, error), unit = digits((each.value, each.error), each.value, each.error, each.unit)
            lines.append(f"{key} = {value} ± {error} {unit}")
            number = float(f"{each.value:.7g}")
            if key not in {knob.key for knob in self.aligned}:  # which stay free
                self.found.append((key, setting_text(key, number) if unit_of(key) else f"{number:g} {each.unit}"))
        self.widgets["take"].visible = True
        return lines

    def _take(self) -> None:
        for key, text in self.found:
            shared = self.panel.knobs[key].shared if key in self.panel.knobs else ()
            self._set(dict.fromkeys((key, *shared), text.strip()))

    def _work(
        self, what: str, work: Callable[[Any], Any], item: Any, then: Callable[[Question, Any], list[str]]
    ) -> None:
        """Do work that takes seconds, and show what it says."""
        self.widgets[what].disabled = True
        self._say(f"{what}_said", ["under way"])

        def end(answer: Any) -> None:
            self.widgets[what].disabled = False
            self._say(f"{what}_said", [str(answer)] if isinstance(answer, Exception) else then(item[0], answer))

        self.works.result(work, item, end)
