"""Knobs, views and the worker process of the live page, without a browser."""

import os
import re
import signal
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any
from unittest.mock import patch

import psutil
import pytest

from drivers.base import paths
from drivers.base.errors import InputError
from drivers.chain.case import Case, build_case
from drivers.scene.read_scene import read_scene
from validation.explore import views
from validation.explore.desk import ENDED, PATIENCE_S, Desk
from validation.explore.knobs import knobs_of
from validation.explore.views import Question, View, errors_of, quick_view_of, view_of
from validation.tests.helpers.commands import beads
from validation.tests.helpers.live import until
from validation.tests.helpers.scenes import SceneWriter


def case_of(scene: str | Path, *settings: str) -> Case:
    return build_case(read_scene(scene, settings))


@pytest.mark.parametrize("scene", sorted(path.stem for path in paths.SCENES.glob("*.toml")))
def test_the_present_value_of_each_knob_gives_the_same_scene(scene: str) -> None:
    case = case_of(scene)
    for knob in knobs_of(case):
        if knob.text:
            settings = (f"{key}={text}" for key, text in knob.settings(knob.text, case.scene).items())
            turned = case_of(scene, *settings).scene
            apart: Any = {"file": True, "materials": {"__all__": {"source"}}, "chain": {"sensors"}}
            assert turned.model_dump(exclude=apart) == case.scene.model_dump(exclude=apart), knob.key
            masses = (
                [(place, each.mass) for place, each in scene.chain.sensor_at.items()] for scene in (turned, case.scene)
            )
            assert [*next(masses)] == [*next(masses)]


@pytest.mark.parametrize("scene", ["fig4", "driven-steel", "example-measured", "fig4-tube", "two-spheres"])
def test_a_slider_stays_within_the_range_of_its_key(scene: str) -> None:
    case = case_of(scene)
    for knob in (knob for knob in knobs_of(case) if knob.range):
        for place in (0.0, 0.31, 1.0):
            text = knob.text_at(place)
            settings = (f"{key}={value}" for key, value in knob.settings(text, case.scene).items())
            table = validated(scene, tuple(settings))
            assert f"{knob.key}: found" not in table, table


def validated(scene: str, settings: tuple[str, ...]) -> str:
    """Message on values that the model of scenes refuses, whatever the rules on several keys say."""
    with patch("drivers.scene.read_scene.problems_of", return_value=()):
        try:
            read_scene(scene, settings)
        except InputError as error:
            return str(error)
    return ""


def test_knobs_that_are_asked_for_come_first() -> None:
    first, second, *_ = knobs_of(case_of("fig4"), ["striker.speed=0.5..5", "chain.mass=0.1 g..0.2 g"])
    assert (first.key, first.text_at(0), first.text_at(1)) == ("striker.speed", "0.5 m/s", "5 m/s")
    assert (second.key, second.text_at(0), second.text_at(1)) == ("chain.mass", "0.1 g", "0.2 g")


@pytest.mark.parametrize(
    ("knob", "words"),
    [
        ("striker.sped=1..2", "--knob: found striker.sped"),
        ("striker.shape=1..2", "--knob"),
        ("contact.rotation=0..1", "--knob: found contact.rotation; allowed: a key of the scene with a number"),
        ("striker.speed=2..1", "--knob striker.speed: found 2..1; allowed: a lower bound, then an upper bound"),
        ("striker.speed=fast", "--knob striker.speed: found fast; allowed: bounds such as"),
    ],
)
def test_a_wrong_knob_ends_the_command(knob: str, words: str) -> None:
    done = beads("explore", "fig4", "--no-browser", "--knob", knob)
    assert (done.returncode, done.stderr.count("\n")) == (2, 1)
    assert words in done.stderr


def test_sensors_keep_their_masses() -> None:
    case = case_of("fig4", 'chain.sensors=[{ from_wall = 9, mass = "0.1 g" }, { from_wall = 5, mass = "0.2 g" }]')
    knob = next(knob for knob in knobs_of(case) if knob.key == "chain.sensors")
    (text,) = knob.settings("7, 5", case.scene).values()
    sensors = case_of("fig4", f"chain.sensors={text}").scene.chain.sensor_at
    assert {place: sensor.mass for place, sensor in sensors.items()} == {7: 1e-4, 5: 2e-4}


def test_a_long_motion_is_announced() -> None:
    question = Question("fig4", ("chain.count=3000", "run.duration=5 ms"))
    assert isinstance(quick_view_of(Question("fig4")), View)
    assert re.fullmatch(r"by verlet: about 0\.\d+ s", str(quick_view_of(question)))


def error_of(question: Question, observable: str) -> float:
    """Error in the table of a motion."""
    (line,) = (line for line in errors_of(question).lines if line.startswith(observable))
    return float(line.split()[2])


def test_errors_are_those_of_the_engine() -> None:
    assert error_of(Question("fig4"), "wall_peak_N") < 1e-10
    assert 1e-6 < error_of(Question("fig4", engine="verlet"), "wall_peak_N") < 1e-4
    assert errors_of(Question("fig4")).lines[-1] == "the exact motion is known to 1e-13 of the largest change"


def test_a_kept_scene_runs_from_another_folder(scene_file: SceneWriter, tmp_path: Path) -> None:
    (tmp_path / "push.csv").write_text("time_us,force_N\n0,0\n10,-1\n20,0\n")
    source = scene_file(top='drive = { form = "file", file = "push.csv" }')
    kept = tmp_path / "elsewhere" / "kept.toml"
    kept.parent.mkdir()
    kept.write_text(views.scene_file(Question(str(source), ("chain.count=7",))))
    here, there = (view_of(asked) for asked in (Question(str(source), ("chain.count=7",)), Question(str(kept))))
    assert (here.signals["wall"] == there.signals["wall"]).all()


@pytest.fixture
def desk() -> Iterator[Desk]:
    """Desk of a page that calls at once."""
    desk = Desk(lambda call: call())
    yield desk
    desk.close()


def slow(seconds: float) -> float:
    """Work that takes a time."""
    time.sleep(seconds)
    return seconds


def pid(_: Any) -> int:
    """Work that tells its process."""
    return os.getpid()


@pytest.mark.long
def test_of_wishes_that_wait_the_newest_is_done(desk: Desk) -> None:
    done: list[float] = []
    for seconds in (0.3, 0.01, 0.02, 0.03):
        desk.ask(slow, seconds, done.append)
        until(lambda: desk._began_s < float("inf") or done)
    until(lambda: 0.03 in done)
    assert done == [0.3, 0.03]


@pytest.mark.long
def test_work_that_takes_long_is_ended_for_newer_work(desk: Desk) -> None:
    done: list[Any] = []
    desk.ask(slow, 1000.0, done.append)
    until(lambda: time.perf_counter() - desk._began_s > PATIENCE_S)
    desk.ask(slow, 0.01, done.append)
    until(lambda: done)
    assert done == [0.01]


@pytest.mark.long
@pytest.mark.parametrize("stop", [lambda _: None, lambda process: process.send_signal(signal.SIGSTOP)])
def test_a_process_that_hangs_ends_with_its_page(desk: Desk, stop: Callable[[psutil.Process], None]) -> None:
    process = psutil.Process(desk.result(pid, None).result())
    desk.ask(slow, 1000.0, print)
    stop(process)
    desk.close()
    until(lambda: not process.is_running() or process.status() == psutil.STATUS_ZOMBIE)


@pytest.mark.long
def test_a_killed_process_is_replaced(desk: Desk) -> None:
    first = desk.result(pid, None).result()
    os.kill(first, signal.SIGKILL)
    assert desk.result(pid, None).result() != first


@pytest.mark.long
def test_what_waits_ends_with_the_page(desk: Desk) -> None:
    done: list[Any] = []
    waiting = [desk.result(slow, seconds, done.append) for seconds in (1000.0, 0.01, 0.02)]
    until(lambda: desk._began_s < float("inf"))
    desk.close()
    assert waiting[0].result() is ENDED
    assert all(each.cancelled() for each in waiting[1:])
    assert not done
