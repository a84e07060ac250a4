"""Tests of killed commands: no process outlives them."""

import os
import signal
import subprocess
import time
from pathlib import Path

import psutil
import pytest

from drivers.base import paths
from validation.tests.helpers.commands import BEADS
from validation.tests.helpers.scenes import SPEEDS, EnginesWriter, StandIn, StudyWriter

GONE_S = 5.0


def left_from(folder: Path) -> list[str]:
    """Command lines of the processes whose temporary files go into a folder."""
    found = []
    for process in psutil.process_iter():
        try:
            if process.status() != psutil.STATUS_ZOMBIE and process.environ().get("TMPDIR") == str(folder):
                found.append(" ".join(process.cmdline()))
        except psutil.Error:
            continue
    return found


@pytest.mark.parametrize("words", [("run", "fig4"), ("batch", "study.toml")], ids=lambda words: words[0])
def test_a_code_behind_a_script_ends_with_its_parent(
    words: tuple[str, ...], engines_file: EnginesWriter, stand_in: StandIn, study_file: StudyWriter, tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:  # fmt: skip
    """The script waits for the code that it starts, so the code is a child of a child."""
    stand_in("mine", 'case "$*" in *-h*) echo "Large-scale 1" ;; *) sleep 300; echo ;; esac\n')
    engines_file('[mine]\nadapter = "lammps"\ncommand = "mine"\n')
    study_file(SPEEDS.format(2), "mine")
    monkeypatch.chdir(tmp_path)
    places = tmp_path / "places"
    places.mkdir()
    process = subprocess.Popen(
        [*BEADS, *words, "--engine", "mine", "--runs", "runs"],
        start_new_session=True,
        env=os.environ | {"TMPDIR": str(places), "PYTHONPATH": str(paths.ROOT)},
    )
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
    [
        ("fit", "example-measured", "--free", "contact.restitution", "--free", "materials.ptfe.youngs_modulus"),
        ("report", "fig4", "fig5", "--out", "page.html"),
        ("run", "fig4-tube", "--set", "run.duration=3 ms"),
    ],
    ids=lambda words: words[0],
)
def test_nothing_outlives_a_killed_command(words: tuple[str, ...], moment_s: float, tmp_path: Path) -> None:
    """Workers and codes end if the command alone is killed; of a report the page is whole, or there is none."""
    places, page = tmp_path / "places", tmp_path / "page.html"
    places.mkdir()
    process = subprocess.Popen(
        [*BEADS, *words, "--runs", "runs", *(("--results", "results") if words[0] == "fit" else ())],
        start_new_session=True,
        stdout=subprocess.DEVNULL,
        stderr=(tmp_path / "said").open("w"),
        env=os.environ | {"TMPDIR": str(places), "PYTHONPATH": str(paths.ROOT)},
        cwd=tmp_path,
    )
    time.sleep(moment_s)
    assert process.poll() is None, (process.returncode, (tmp_path / "said").read_text())
    process.send_signal(signal.SIGKILL)  # to it alone, not its group
    process.wait()
    _assert_gone(places)
    assert not page.exists() or page.read_text().rstrip().endswith("</html>")


def test_an_interrupted_start_of_workers_prints_no_traceback(study_file: StudyWriter, tmp_path: Path) -> None:
    """The fork server has just started, and loads libraries."""
    words = ["batch", study_file(SPEEDS.format(2), "verlet"), "--runs", tmp_path / "runs", "--results", tmp_path]
    process = subprocess.Popen([*BEADS, *map(str, words)], start_new_session=True, stderr=subprocess.PIPE, text=True)
    while not any("forkserver" in " ".join(child.cmdline()) for child in psutil.Process(process.pid).children()):
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
