"""Tests of progress: a line for each step, and further lines while it runs."""

import os
import sys
import threading
import time

import pytest

from drivers.base import progress


@pytest.mark.parametrize(
    ("seconds", "words"),
    [
        (0.00065, "0.65 ms"), (0.0994, "99 ms"), (0.0997, "0.1 s"), (12.3, "12 s"), (99.6, "2 min"), (300, "5 min"),
        (7200, "2.0 h"),
    ],
)  # fmt: skip
def test_a_duration_has_two_digits(seconds: float, words: str) -> None:
    assert progress.in_words(seconds) == words


def test_each_of_several_steps_has_a_line(capsys: pytest.CaptureFixture[str]) -> None:
    with progress.step("waves counted", 2, 3):
        pass
    assert capsys.readouterr().err == "step 2 of 3: waves counted\n"


def test_a_task_has_no_line_until_it_takes_long(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(progress, "MAX_SILENCE_S", 0.3)
    monkeypatch.setattr(progress, "REFRESH_S", 0.1)
    for seconds in (0.0, 0.6):
        with progress.counted("alone"):
            time.sleep(seconds)
    (line,) = capsys.readouterr().err.splitlines()[:1]
    assert line == "alone: 0 s so far"


def test_steps_that_take_long_are_not_silent(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(progress, "MAX_SILENCE_S", 0.3)
    monkeypatch.setattr(progress, "REFRESH_S", 0.1)
    with progress.step("outer", 1, 2):
        for number in progress.following(range(3), "inner", 3, "wave"):
            time.sleep(0.5 if number else 0.0)
        time.sleep(0.5)
    first, *inner, last = capsys.readouterr().err.splitlines()
    assert first == "step 1 of 2: outer"
    assert "  inner: 1 of 3 waves in 0 s, about" in inner[0]
    assert last.startswith("  outer: 1 s so far") or last.startswith("  outer: 2 s so far")


@pytest.mark.parametrize(("size", "bars"), [((0, 0), False), ((100, 0), False), ((100, 40), True)])
def test_a_terminal_without_a_size_gets_lines(
    size: tuple[int, int], bars: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(os, "get_terminal_size", lambda _: size)
    terminal, other = os.openpty()
    with open(other, "w") as shown:
        monkeypatch.setattr(sys, "stderr", shown)
        assert progress._watched() is bars
    os.close(terminal)


def test_a_command_without_output_gets_lines_also_on_a_terminal(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(progress, "MAX_SILENCE_S", 0.3)
    monkeypatch.setattr(progress, "REFRESH_S", 0.1)
    monkeypatch.setattr(os, "get_terminal_size", lambda _: (100, 40))
    terminal, other = os.openpty()
    with open(other, "w") as shown:
        monkeypatch.setattr(sys, "stderr", shown)
        with progress.counted("beads plan", bar=False):
            time.sleep(0.6)
    assert os.read(terminal, 999).startswith(b"beads plan: 0 s so far")
    os.close(terminal)


def test_threads_of_work_end_in_any_order(capsys: pytest.CaptureFixture[str]) -> None:
    def work(seconds: float) -> None:
        for _ in progress.following([seconds], "work"):
            time.sleep(seconds)

    threads = [threading.Thread(target=work, args=(seconds,)) for seconds in (0.3, 0.1, 0.2)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert progress._under_way == []
    assert capsys.readouterr().err == ""
