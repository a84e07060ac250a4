"""Tests of progress: a line for each step, and further lines while it runs."""

import os
import re
import sys
import time
from concurrent.futures import ThreadPoolExecutor

import pytest

from drivers.base import progress


@pytest.fixture
def talkative(monkeypatch: pytest.MonkeyPatch) -> None:
    """Tasks have a line soon."""
    monkeypatch.setattr(progress, "MAX_SILENCE_S", 0.1)
    monkeypatch.setattr(progress, "REFRESH_S", 0.05)


def test_a_duration_has_two_digits() -> None:
    seconds = (0.00065, 0.0994, 0.0997, 99.6, 7200)
    assert [*map(progress.in_words, seconds)] == ["0.65 ms", "99 ms", "0.1 s", "2 min", "2.0 h"]


@pytest.mark.usefixtures("talkative")
def test_steps_and_tasks_that_take_long_are_not_silent(capsys: pytest.CaptureFixture[str]) -> None:
    with progress.counted("short"):
        pass
    with progress.step("outer", 1, 2):
        for number in progress.following(range(3), "inner", 3, "wave"):
            time.sleep(0.3 if number else 0.0)
        time.sleep(0.3)
    first, *inner, last = capsys.readouterr().err.splitlines()
    assert first == "step 1 of 2: outer"
    assert re.match("  inner: [12] of 3 waves in [0-9] s, about ", inner[0])
    assert re.fullmatch("  outer: [0-9] s so far", last)


@pytest.mark.usefixtures("talkative")
@pytest.mark.parametrize(("size", "bar"), [((100, 0), True), ((100, 40), False)], ids=["no size", "no bar"])
def test_a_terminal_without_a_size_and_a_command_without_output_get_lines(
    size: tuple[int, int], bar: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(os, "get_terminal_size", lambda _: size)
    terminal, other = os.openpty()
    with open(other, "w") as shown:
        monkeypatch.setattr(sys, "stderr", shown)
        assert progress._watched() is (size == (100, 40))
        with progress.counted("beads plan", bar=bar):
            time.sleep(0.25)
    assert os.read(terminal, 999).startswith(b"beads plan: 0 s so far")
    os.close(terminal)


def test_threads_of_work_end_in_any_order(capsys: pytest.CaptureFixture[str]) -> None:
    def work(seconds: float) -> None:
        for _ in progress.following([seconds], "work"):
            time.sleep(seconds)

    with ThreadPoolExecutor() as pool:
        assert [*pool.map(work, (0.06, 0.02, 0.04))] == [None] * 3
    assert progress._under_way == []
    assert capsys.readouterr().err == ""
