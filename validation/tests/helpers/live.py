"""A live page: the server as a process, and its page in a browser, used by keys as a person uses it."""

import inspect
import subprocess
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, TypeVar
from urllib.error import HTTPError
from urllib.request import Request, urlopen

from selenium.webdriver import Chrome
from selenium.webdriver.common.keys import Keys

from validation.tests.helpers.commands import BEADS

Found = TypeVar("Found")
PATIENCE_S = 20.0
SCRIPT = """
function* within(view) { yield view; for (const child of view.children()) yield* within(child); }
const view = (name) => {
  for (const root of Bokeh.index) for (const each of within(root)) if (each.model.name === name) return each;
};
const model = (name) => view(name)?.model;
const input = (name) => view(name).shadow_el.querySelector("input, select, button, .noUi-handle-lower, .noUi-handle");
"""


@contextmanager
def served(*words: str | Path) -> Iterator[tuple[str, subprocess.Popen[str]]]:
    """Server of ``beads explore``: its address and its process, which Ctrl-C ends."""
    command = (*BEADS, "explore", *map(str, words), "--no-browser")
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        try:
            yield process.stdout.readline().strip(), process
        finally:
            process.terminate()


def status_of(address: str, **headers: str) -> int:
    """Status of the answer to a request."""
    try:
        with urlopen(Request(address, headers=headers), timeout=30) as answer:
            return int(answer.status)
    except HTTPError as error:
        return error.code


def until(ask: Callable[[], Found], limit_s: float = PATIENCE_S) -> Found:
    """First true answer of a function.

    Raises:
        AssertionError: there is none within the limit.
    """
    end_s = time.monotonic() + limit_s
    while not (found := ask()):
        assert time.monotonic() < end_s, inspect.getsource(ask)
        time.sleep(0.05)
    return found


class Live:
    """A live page in a browser."""

    def __init__(self, driver: Chrome, address: str) -> None:
        self.driver = driver
        driver.get(address)
        until(lambda: self.text("command"))

    def ask(self, question: str, *arguments: Any) -> Any:
        """Value of an expression in JavaScript."""
        return self.driver.execute_script(f"{SCRIPT} return {question};", *arguments)

    def text(self, name: str) -> str:
        """Text of a part of the page, as it is read."""
        shown = self.ask('model(arguments[0])?.text ?? ""', name)
        return str(self.ask('new DOMParser().parseFromString(arguments[0], "text/html").body.innerText', shown))

    def value(self, name: str) -> Any:
        """Value of a knob or another widget."""
        return self.ask("model(arguments[0]).value", name)

    def curve(self, gauge: str, part: str = "now") -> tuple[list[float], list[float]]:
        """Times in us and forces of a part of a gauge."""
        drawn = 'model("forces").renderers.find((each) => each.name === arguments[0])'
        data = self.ask(f"(({{ x, y }}) => [[...x], [...y]])({drawn}.data_source.data)", f"{gauge} {part}")
        return data[0], data[1]

    def press(self, name: str, *keys: str) -> None:
        """Press keys at a widget, by default Enter."""
        self.ask("input(arguments[0])", name).send_keys(*(keys or (Keys.ENTER,)))

    def type(self, name: str, text: str) -> None:
        """Type a value in place of the present one."""
        present = self.ask("input(arguments[0]).value", name)
        self.press(name, Keys.END, Keys.BACKSPACE * len(present), text, Keys.ENTER)

    def turn(self, name: str, text: str) -> None:
        """Type the value of a knob, and wait for the motion."""
        self.type(name, text)
        until(lambda: text in self.text("command"))
