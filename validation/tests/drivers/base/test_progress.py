"""Tests of progress: a line for each step with its estimate, and further lines while it runs."""

import json
import os
import sys
import threading
import time
from pathlib import Path

import pytest

from drivers.base import paths, progress


@pytest.fixture(autouse=True)
def _here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(paths, "RUNS", tmp_path / "runs")


def test_a_step_has_a_line_and_an_estimate_from_the_last_run(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    for _ in range(2):
        with progress.step("waves counted", 2, 3):
            time.sleep(0.15)
    first, second = capsys.readouterr().err.splitlines()
    assert first == "step 2 of 3: waves counted"
    assert second == "step 2 of 3: waves counted (about 0.2 s, estimated from the last run)"
    assert list(json.loads((tmp_path / "runs" / progress.DURATIONS_FILE).read_text())) == ["waves counted"]


def test_a_single_step_has_no_line_until_it_takes_long(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(progress, "MAX_SILENCE_S", 0.3)
    monkeypatch.setattr(progress, "REFRESH_S", 0.1)
    for seconds in (0.0, 0.6):
        with progress.step("alone"):
            time.sleep(seconds)
    (line,) = capsys.readouterr().err.splitlines()[:1]
    assert line == "alone (about 0 s, estimated from the last run): 0 s so far"


def test_an_interrupted_step_leaves_no_duration(tmp_path: Path) -> None:
    with pytest.raises(ZeroDivisionError), progress.step("broken"):
        raise ZeroDivisionError
    assert not (tmp_path / "runs").exists()


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
