"""Tests of killed commands: no process outlives them."""

import os
import signal
import subprocess
import time
from pathlib import Path
from typing import Any

import psutil
import pytest

from drivers.base import paths
from drivers.run import execute
from validation.tests.helpers.commands import BEADS
from validation.tests.helpers.scenes import SPEEDS, EnginesWriter, StandIn, StudyWriter

GONE_S = 5.0


def started(folder: Path, *words: str, **options: Any) -> subprocess.Popen[str]:
    """Command in a session of its own, in a folder, with its temporary files in ``places`` there."""
    (folder / "places").mkdir()
    places = {"TMPDIR": str(folder / "places"), "PYTHONPATH": str(paths.ROOT)}
    command = [*BEADS, *words, "--runs", "runs"]
    return subprocess.Popen(command, start_new_session=True, env=os.environ | places, cwd=folder, text=True, **options)


def left_from(folder: Path) -> list[str]:
    """Command lines of the processes whose temporary files go into a folder, or one in it."""
    found = []
    for process in psutil.process_iter():
        try:
            if process.status() != psutil.STATUS_ZOMBIE and process.environ().get("TMPDIR", "").startswith(str(folder)):
                found.append(" ".join(process.cmdline()))
        except psutil.Error:
            continue
    return found


@pytest.mark.parametrize("words", [("run", "fig4"), ("batch", "study.toml")], ids=lambda words: words[0])
def test_a_code_behind_a_script_ends_with_its_parent(
    words: tuple[str, ...], engines_file: EnginesWriter, stand_in: StandIn, study_file: StudyWriter, tmp_path: Path
) -> None:
    """The script waits for the code that it starts, so the code is a child of a child."""
    stand_in("mine", 'case "$*" in *-h*) echo "Large-scale 1" ;; *) sleep 300; echo ;; esac\n')
    engines_file('[mine]\nadapter = "lammps"\ncommand = "mine"\n')
    study_file(SPEEDS.format(2), "mine")
    process, places = started(tmp_path, *words, "--engine", "mine"), tmp_path / "places"
    until = time.monotonic() + 30
    while not any("sleep 300" in line for line in left_from(places)):
        assert process.poll() is None
        assert time.monotonic() < until
        time.sleep(0.1)
    process.kill()
    process.wait()
    _assert_gone(places)


@pytest.mark.long
@pytest.mark.parametrize("moment_s", [1.0, 4.0], ids=["while workers start", "while they work"])
@pytest.mark.parametrize(
    "words",
    [("report", "fig4", "fig5", "--out", "page.html"), ("run", "fig4-tube", "--set", "run.duration=3 ms")],
    ids=lambda words: words[0],
)
def test_nothing_outlives_a_killed_command(words: tuple[str, ...], moment_s: float, tmp_path: Path) -> None:
    """Workers and codes end if the command alone is killed; of a report the page is whole, or there is none."""
    page, said = tmp_path / "page.html", tmp_path / "said"
    process = started(tmp_path, *words, stdout=subprocess.DEVNULL, stderr=said.open("w"))
    time.sleep(moment_s)
    assert process.poll() is None, (process.returncode, said.read_text())
    process.send_signal(signal.SIGKILL)  # to it alone, not its group
    process.wait()
    _assert_gone(tmp_path / "places")
    assert not page.exists() or page.read_text().rstrip().endswith("</html>")


def test_an_interrupted_start_of_workers_prints_no_traceback(study_file: StudyWriter, tmp_path: Path) -> None:
    """The workers have just started, and load libraries."""
    study = study_file(SPEEDS.format(2), "verlet")
    process = started(tmp_path, "batch", str(study), "--results", "results", stderr=subprocess.PIPE)
    while not any(execute.__name__ in line for line in left_from(tmp_path / "places")):
        assert process.poll() is None
        time.sleep(0.01)
    os.killpg(process.pid, signal.SIGINT)
    _, said = process.communicate()
    assert "Traceback" not in said
    assert process.returncode in (130, -signal.SIGINT)


def _assert_gone(places: Path) -> None:
    until = time.monotonic() + GONE_S
    while (left := left_from(places)) and time.monotonic() < until:
        time.sleep(0.05)
    assert left == []


CHIRP = ("form=chirp", "end_frequency=1e18 Hz", "cycles=", "force=", "displacement=1 um", "duration=30 us")
ENDLESS = ("run.duration=40 us", "drive.from_wall=4", *(f"drive.{key}" for key in CHIRP))


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT, None], ids=["TERM", "Ctrl-C", "time limit"])
def test_an_exact_motion_without_end_is_ended(
    number: signal.Signals | None, tmp_path: Path, request: pytest.FixtureRequest
) -> None:
    """Its steps get too small for a chirp to 1e18 Hz; velocity Verlet takes milliseconds."""
    settings = [word for setting in ENDLESS for word in ("--set", setting)]
    words = ("run", "driven-steel", *settings, "--engine", "verlet")
    process = started(tmp_path, *words, *(() if number else ("--time-limit", "1")))
    request.addfinalizer(process.kill)  # else it would go on without end when the test fails
    if number is None:
        assert process.wait(timeout=60) == 0
        (record,) = tmp_path.glob("runs/verlet/*/run.json")
        assert "not measured: the exact motion takes longer than 1 s" in record.read_text()
        return
    until = time.monotonic() + 60
    while not any(tmp_path.glob("runs/verlet/[!.]*/run.json")):  # then the exact motion is computed
        assert time.monotonic() < until
        time.sleep(0.1)
    time.sleep(1.0)
    assert process.poll() is None
    process.send_signal(number)
    assert process.wait(timeout=GONE_S) == 130
