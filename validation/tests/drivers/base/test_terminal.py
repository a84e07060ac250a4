"""Tests of progress: one line that is rewritten on a terminal, few lines elsewhere."""

import os
import re
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress

import pytest

from drivers.base import terminal


@pytest.fixture(autouse=True)
def talkative(monkeypatch: pytest.MonkeyPatch) -> None:
    """A minute takes half a second; the thread of this test is the only one with tasks."""
    monkeypatch.setattr(terminal, "REFRESH_S", 0.1)
    monkeypatch.setattr(terminal, "SILENCE_S", 0.5)
    monkeypatch.setattr(terminal, "_under_way", [])
    terminal._keep_talking.cache_clear()


def test_a_duration_has_two_digits() -> None:
    seconds = (0.00065, 0.0994, 0.0997, 99.6, 7200)
    assert [*map(terminal.in_words, seconds)] == ["0.65 ms", "99 ms", "0.1 s", "2 min", "2.0 h"]


def test_few_lines_off_a_terminal_and_none_for_short_tasks(capsys: pytest.CaptureFixture[str]) -> None:
    with terminal.counted("short"):
        pass
    with terminal.counted("outer"):
        for _ in terminal.following(range(300), "inner", 300, "wave"):
            time.sleep(0.004)
    *inner, end, last = capsys.readouterr().err.splitlines()
    assert 1 <= len(inner) <= 5
    for line in inner:
        assert re.fullmatch(r"inner: [12]?\d\d of 300 waves in 00:0\d, \S+ left", line)
    assert re.fullmatch(r"inner: 300 of 300 waves in 00:0\d, 00:00 left", end)
    assert re.fullmatch(r"outer: 00:0\d", last)


def test_one_line_is_rewritten_on_a_terminal(monkeypatch: pytest.MonkeyPatch) -> None:
    window, other = os.openpty()  # without a size, as of some recorders
    with open(other, "w") as shown:
        monkeypatch.setattr(sys, "stderr", shown)
        with terminal.counted("outer"), terminal.counted("inner", 2, "wave") as count:
            time.sleep(0.3)
            count()
            time.sleep(0.3)
            terminal.say("a line")
    said = b""
    with suppress(OSError), open(window, "rb", buffering=0) as screen:
        while part := screen.read(999):
            said += part
    text = said.decode().replace("\r\n", "\n")
    assert re.search(r"\rinner: 0 of 2 waves in 00:00, \? le.*\rinner: 1 of 2 waves in 00:0\d", text)
    assert re.findall(r"[^\r\n]*\n", text) == ["a line\n"]
    assert text.endswith("\r")  # nothing is left of the tasks


def test_threads_of_work_end_in_any_order() -> None:
    def work(seconds: float) -> None:
        for _ in terminal.following([seconds], "work"):
            time.sleep(seconds)

    with ThreadPoolExecutor() as pool:
        assert [*pool.map(work, (0.06, 0.02, 0.04))] == [None] * 3
    assert terminal._under_way == []
